// Float rays: brought into the integers of struct canopy_ray_line, and hits back.

#include <math.h>
#include <stddef.h>

#include "lib/cover/ray.h"
#include "lib/num/fixed.h"

#define ROOM CANOPY_RAY_ROOM

static int larger(int a, int b) { return a > b ? a : b; }
static int smaller(int a, int b) { return a < b ? a : b; }

// The exponent e of |x| < 2^e; of 0 a very small one.
static int exponent(float x) {
    int e = -1000;
    if (x != 0.0f) {
        (void)frexpf(x, &e);
    }
    return e;
}

static bool are_finite(const float x[3]) {
    for (int a = 0; a < 3; a++) {
        if (!(fabsf(x[a]) <= 0x1.fffffep127f)) {
            return false;
        }
    }
    return true;
}

// x * 2^log2 to the nearest whole number; the line then says that it was rounded.
static int64_t whole(float x, int log2, struct canopy_ray_line *line) {
    const float scaled = ldexpf(x, log2), near = rintf(scaled);
    if (near != scaled || (scaled == 0.0f && x != 0.0f)) {
        line->rounded = 1;
    }
    return (int64_t)near;
}

// Units and start. A unit of axis a is 2^-scale[a] device units.
static bool start_line(const struct canopy_frame *frame, const float from[3], const float far[3],
                       struct canopy_ray_line *line, int scale[3]) {
    *line = (struct canopy_ray_line){0};
    for (int a = 0; a < 3; a++) {
        const int most = larger(exponent(from[a]), exponent(far[a])), quantum = frame->quantum_log2;
        if (a < 2) {
            const uint64_t width = canopy_frame_width(frame, a);
            const int up = smaller(ROOM - (int)canopy_log2_ceil(width + 1), ROOM - (most - quantum));
            if (up < 0) {
                return false;
            }
            line->width[a] = (int64_t)(width << up);
            scale[a] = up - quantum;
        } else {
            const int step = frame->lsb_log2 + quantum;
            const int log2 = larger(CANOPY_RAY_HEIGHT_LEAST, most - step - ROOM);
            if (log2 > CANOPY_RAY_HEIGHT_MOST) {
                return false;
            }
            line->height_log2 = (int16_t)log2;
            scale[a] = -log2 - step;
        }
        line->from[a] = whole(from[a], scale[a], line);
    }
    return true;
}

enum canopy_ray_outcome canopy_ray_line_f32(const struct canopy_frame *frame, const float from[3], const float along[3],
                                            struct canopy_ray_line *line) {
    int scale[3], runs[3], log2, coarser;
    if (!are_finite(from) || !are_finite(along)) {
        return CANOPY_RAY_NOT_FINITE;
    }
    if (along[0] == 0.0f && along[1] == 0.0f && along[2] == 0.0f) {
        return CANOPY_RAY_NO_DIRECTION;
    }
    if (!start_line(frame, from, from, line, scale)) {
        return CANOPY_RAY_TOO_FAR;
    }
    for (int a = 0; a < 3; a++) {
        runs[a] = along[a] == 0.0f ? CANOPY_RAY_NEVER : CANOPY_RAY_FAST - scale[a] - exponent(along[a]);
    }
    canopy_ray_reach(line, runs, &log2, &coarser);
    scale[2] -= coarser;
    line->height_log2 = (int16_t)(line->height_log2 + coarser);
    line->from[2] = whole(from[2], scale[2], line);
    line->t_log2 = (int16_t)log2;
    for (int a = 0; a < 3; a++) {
        line->to[a] = line->from[a] + whole(along[a], scale[a] + log2, line);
    }
    return CANOPY_RAY_FREE;
}

enum canopy_ray_outcome canopy_ray_segment_f32(const struct canopy_frame *frame, const float from[3], const float to[3],
                                               struct canopy_ray_line *line) {
    int scale[3];
    if (!are_finite(from) || !are_finite(to)) {
        return CANOPY_RAY_NOT_FINITE;
    }
    if (!start_line(frame, from, to, line, scale)) {
        return CANOPY_RAY_TOO_FAR;
    }
    for (int a = 0; a < 3; a++) {
        line->to[a] = whole(to[a], scale[a], line);
    }
    return CANOPY_RAY_FREE;
}

enum canopy_status canopy_ray_first_f32(const struct canopy_envelope *envelope, const float from[3],
                                        const float along[3], struct canopy_ray_hit *hit) {
    struct canopy_ray_line line;
    *hit = (struct canopy_ray_hit){.outcome = (uint8_t)canopy_ray_line_f32(&envelope->frame, from, along, &line)};
    return hit->outcome == CANOPY_RAY_FREE ? canopy_ray_cast(envelope, &line, hit) : CANOPY_ARGUMENT;
}

bool canopy_ray_is_free_f32(const struct canopy_envelope *envelope, const float from[3], const float to[3],
                            struct canopy_ray_hit *hit) {
    struct canopy_ray_line line;
    struct canopy_ray_hit mine = {0}, *found = hit != NULL ? hit : &mine;
    *found = (struct canopy_ray_hit){.outcome = (uint8_t)canopy_ray_segment_f32(&envelope->frame, from, to, &line)};
    return found->outcome == CANOPY_RAY_FREE && canopy_ray_cast(envelope, &line, found) == CANOPY_OK &&
           found->outcome <= CANOPY_RAY_BESIDE;
}

float canopy_ray_t_f32(const struct canopy_ray_hit *hit) { return ldexpf((float)hit->t, hit->t_log2); }

void canopy_ray_normal_f32(const struct canopy_frame *frame, const struct canopy_ray_hit *hit, float normal[3]) {
    const float up = frame->side == CANOPY_ABOVE ? 1.0f : -1.0f;
    float size = 1.0f;
    for (int a = 0; a < 2; a++) {
        normal[a] = -ldexpf((float)hit->gradient[a] / (float)frame->pitch[a], frame->lsb_log2);
        size += normal[a] * normal[a];
    }
    normal[2] = 1.0f;
    for (int a = 0; a < 3; a++) {
        normal[a] *= up / sqrtf(size);
    }
}
