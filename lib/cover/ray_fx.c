// Fixed-point rays: brought into the integers of struct canopy_ray_line, without loss but for the most uneven ones.

#include <stddef.h>

#include "lib/cover/ray.h"
#include "lib/num/fixed.h"

#define ROOM CANOPY_RAY_ROOM

static int64_t size_of(int64_t a) { return a < 0 ? -a : a; }

static int smaller(int a, int b) { return a < b ? a : b; }

// Bits by which a coordinate of up to `most` may grow to stay within 2^log2.
static int room(uint64_t most, int log2) { return log2 - (int)canopy_log2_ceil(most + 1); }

// x * 2^log2, rounded down.
static int64_t scaled(int64_t x, int log2, struct canopy_ray_line *line) {
    if (x == 0) {  // the one number that may be told to grow without end
        return 0;
    }
    if (log2 >= 0) {
        return x * ((int64_t)1 << log2);
    }
    line->rounded = 1;
    return canopy_shift_floor(x, log2 > -62 ? (unsigned)-log2 : 62);
}

// Units and start: as many bits below the quantum as there is room for. The two numbers per axis are the start and
// another place on the line.
static bool start_line(const struct canopy_frame *frame, const int64_t from[3], const int64_t far[3],
                       struct canopy_ray_line *line, int scale[3]) {
    *line = (struct canopy_ray_line){0};
    for (int a = 0; a < 3; a++) {
        const uint64_t most = (uint64_t)(size_of(from[a]) > size_of(far[a]) ? size_of(from[a]) : size_of(far[a]));
        if (most > (uint64_t)CANOPY_RAY_FX_MAX) {
            return false;
        }
        if (a < 2) {
            const uint64_t width = canopy_frame_width(frame, a);
            scale[a] = smaller(room(width, ROOM), room(most, ROOM));
            line->width[a] = (int64_t)(width << scale[a]);
        } else {
            // a unit is 2^-scale quanta, 2^(-scale - lsb_log2) steps
            scale[a] = smaller(room(most, ROOM), -CANOPY_RAY_HEIGHT_LEAST - frame->lsb_log2);
            scale[a] = scale[a] < 0 ? 0 : scale[a];
            line->height_log2 = (int16_t)(-scale[a] - frame->lsb_log2);
        }
        line->from[a] = from[a] * ((int64_t)1 << scale[a]);
    }
    return true;
}

enum canopy_ray_outcome canopy_ray_line_fx(const struct canopy_frame *frame, const int64_t from[3],
                                           const int32_t along[3], struct canopy_ray_line *line) {
    int scale[3];
    if (!start_line(frame, from, from, line, scale)) {
        return CANOPY_RAY_TOO_FAR;
    }
    int runs[3], log2, coarser;
    for (int a = 0; a < 3; a++) {
        runs[a] = along[a] == 0 ? CANOPY_RAY_NEVER
                                : CANOPY_RAY_FAST - scale[a] - (int)canopy_log2_ceil((uint64_t)size_of(along[a]));
    }
    if (along[0] == 0 && along[1] == 0 && along[2] == 0) {
        return CANOPY_RAY_NO_DIRECTION;
    }
    canopy_ray_reach(line, runs, &log2, &coarser);
    scale[2] -= coarser;
    line->height_log2 = (int16_t)(line->height_log2 + coarser);
    line->from[2] = scaled(from[2], scale[2], line);
    line->t_log2 = (int16_t)log2;
    for (int a = 0; a < 3; a++) {
        line->to[a] = line->from[a] + scaled(along[a], scale[a] + log2, line);
    }
    line->rounded = (uint8_t)(2 * line->rounded);
    return CANOPY_RAY_FREE;
}

enum canopy_ray_outcome canopy_ray_segment_fx(const struct canopy_frame *frame, const int64_t from[3],
                                              const int64_t to[3], struct canopy_ray_line *line) {
    int scale[3];
    if (!start_line(frame, from, to, line, scale)) {
        return CANOPY_RAY_TOO_FAR;
    }
    for (int a = 0; a < 3; a++) {
        line->to[a] = to[a] * ((int64_t)1 << scale[a]);
    }
    return CANOPY_RAY_FREE;
}

enum canopy_status canopy_ray_first_fx(const struct canopy_envelope *envelope, const int64_t from[3],
                                       const int32_t along[3], struct canopy_ray_hit *hit) {
    struct canopy_ray_line line;
    *hit = (struct canopy_ray_hit){.outcome = (uint8_t)canopy_ray_line_fx(&envelope->frame, from, along, &line)};
    return hit->outcome == CANOPY_RAY_FREE ? canopy_ray_cast(envelope, &line, hit) : CANOPY_ARGUMENT;
}

bool canopy_ray_is_free_fx(const struct canopy_envelope *envelope, const int64_t from[3], const int64_t to[3],
                           struct canopy_ray_hit *hit) {
    struct canopy_ray_line line;
    struct canopy_ray_hit mine = {0}, *found = hit != NULL ? hit : &mine;
    *found = (struct canopy_ray_hit){.outcome = (uint8_t)canopy_ray_segment_fx(&envelope->frame, from, to, &line)};
    return found->outcome == CANOPY_RAY_FREE && canopy_ray_cast(envelope, &line, found) == CANOPY_OK &&
           found->outcome <= CANOPY_RAY_BESIDE;
}
