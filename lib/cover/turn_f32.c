#include <math.h>
#include <string.h>

#include "lib/cover/cell_f32.h"
#include "lib/cover/turn.h"

#define EDGE_BITS 24  // what a float holds exactly
#define LEAST -100    // quanta are at least 2^LEAST, as in frame_f32.c

// ---------------------------------------------------------------------------------------------------------------------
// Points

// axes d with its bound: the whole argument is at CANOPY_TURN_ERROR_F32.
static float turn_difference(const float axis[3][3], const float d[3], float q[3]) {
    for (int i = 0; i < 3; i++) {
        q[i] = axis[i][0] * d[0] + axis[i][1] * d[1] + axis[i][2] * d[2];
    }
    return CANOPY_TURN_ERROR_F32 * (fabsf(d[0]) + fabsf(d[1]) + fabsf(d[2])) + CANOPY_TURN_LEAST_F32;
}

static void load_axes(const int32_t axes[3][3], float to[3][3]) {
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            to[i][k] = (float)axes[i][k] * (1.0f / CANOPY_AXIS_ONE);
        }
    }
}

// Whether whole quanta are floats.
static bool is_short(int64_t quanta) { return quanta >= -(1 << EDGE_BITS) && quanta <= 1 << EDGE_BITS; }

enum canopy_status canopy_turn_init_f32(struct canopy_turn_f32 *turn, const struct canopy_frame *frame) {
    const bool straight = canopy_axes_are_straight(frame->axis);
    if (!canopy_axes_are_sound(frame->axis)) {
        return CANOPY_ARGUMENT;
    }
    for (int k = 0; k < 3 && !straight; k++) {
        if (!is_short(frame->origin[k]) || (k < 2 && !is_short((int64_t)canopy_frame_width(frame, k)))) {
            return CANOPY_ARGUMENT;
        }
    }
    *turn = (struct canopy_turn_f32){.straight = straight};
    load_axes(frame->axis, turn->axis);
    for (int k = 0; k < 3; k++) {
        turn->origin[k] = straight ? 0.0f : ldexpf((float)frame->origin[k], frame->quantum_log2);
        turn->axis[2][k] = frame->side == CANOPY_BELOW ? -turn->axis[2][k] : turn->axis[2][k];
    }
    return CANOPY_OK;
}

// sum |axis| * uncertainty, rounded up: five roundings and their products' underflow.
static float half_width(const float axis[3], const float uncertainty[3]) {
    const float sum =
        fabsf(axis[0]) * uncertainty[0] + fabsf(axis[1]) * uncertainty[1] + fabsf(axis[2]) * uncertainty[2];
    return sum * (1.0f + 0x1p-20f) + (sum > 0.0f ? CANOPY_TURN_LEAST_F32 : 0.0f);
}

void canopy_turn_box_f32(const struct canopy_turn_f32 *turn, const float point[3], const float uncertainty[3],
                         struct canopy_field_box_f32 *box) {
    static const float none[3] = {0.0f, 0.0f, 0.0f};
    const float d[3] = {point[0] - turn->origin[0], point[1] - turn->origin[1], point[2] - turn->origin[2]};
    float q[3], half[3], error = turn_difference(turn->axis, d, q);
    for (int i = 0; i < 3; i++) {
        half[i] = half_width(turn->axis[i], uncertainty != NULL ? uncertainty : none);
        // A straight frame has no error but that of adding the uncertainty: one rounding, which the point's own bound
        // is more than enough for.
        half[i] = turn->straight && half[i] <= 0.0f ? 0.0f : half[i] + error;
    }
    for (int a = 0; a < 2; a++) {
        box->low[a] = q[a] - half[a];
        box->high[a] = q[a] + half[a];
    }
    box->top = q[2] + half[2];
}

// Sure to be inside, edges included.
static bool is_inside(const struct canopy_view_f32 *view, const struct canopy_field_box_f32 *box) {
    for (int a = 0; a < 2; a++) {
        if (!(box->low[a] >= view->axis[a].from && box->high[a] <= view->axis[a].to)) {
            return false;
        }
    }
    return true;
}

size_t canopy_turn_feed_f32(struct canopy_field *field, const struct canopy_turn_f32 *turn, const float (*points)[3],
                            size_t count) {
    const struct canopy_view_f32 view = canopy_view_of(field);
    size_t refused = 0;
    for (; count > 0; count--, points++) {
        struct canopy_field_box_f32 box;
        struct canopy_field_patch patch;
        canopy_turn_box_f32(turn, *points, NULL, &box);
        refused += !is_inside(&view, &box) || canopy_view_insert(field, &view, &box, &patch) != CANOPY_OK;
    }
    return refused;
}

// ---------------------------------------------------------------------------------------------------------------------
// A box and its frame

void canopy_turned_box_begin_f32(struct canopy_turned_box_f32 *box) {
    *box = (struct canopy_turned_box_f32){.any = false};
}

void canopy_turned_box_add_f32(struct canopy_turned_box_f32 *box, const int32_t axes[3][3], const float point[3]) {
    float axis[3][3], q[3];
    if (!box->any) {
        memcpy(box->anchor, point, sizeof box->anchor);
        box->any = true;
    }
    load_axes(axes, axis);
    const float d[3] = {point[0] - box->anchor[0], point[1] - box->anchor[1], point[2] - box->anchor[2]};
    const float error = turn_difference((const float(*)[3])axis, d, q);
    for (int i = 0; i < 3; i++) {
        box->low[i] = fminf(q[i] - error, box->low[i]);  // the anchor is 0
        box->high[i] = fmaxf(q[i] + error, box->high[i]);
        box->bad = box->bad || !(fabsf(q[i]) + error <= CANOPY_FRAME_F32_MAX);
    }
}

// What places a frame: the box's sides, grown by what the error of a point in the frame may be, relative to the anchor.
struct place {
    float axis[3][3], low[3], high[3];
    const float *anchor;
    float most;  // no coordinate of a corner is larger
};

// A point of the cloud is no further from the origin than sqrt(3) times the sides' sum, counted along the coordinates.
// Its computed interval is within twice the bound of where it is; 2^-18 of `most` is more than what placing the origin
// may add to the sides.
static bool load_place(struct place *place, const int32_t axes[3][3], const struct canopy_turned_box_f32 *box) {
    load_axes(axes, place->axis);
    place->anchor = box->anchor;
    float far = 0.0f, sides = 0.0f;
    for (int i = 0; i < 3; i++) {
        if (!(box->low[i] <= box->high[i])) {
            return false;
        }
        far += fmaxf(fabsf(box->low[i]), fabsf(box->high[i]));
        sides += box->high[i] - box->low[i];
    }
    const float from = fmaxf(fabsf(box->anchor[0]), fmaxf(fabsf(box->anchor[1]), fabsf(box->anchor[2])));
    place->most = from + far;
    if (!(place->most <= CANOPY_FRAME_F32_MAX / 4.0f)) {
        return false;
    }
    const float grow = 2.0f * CANOPY_TURN_ERROR_F32 * 1.7321f * (sides + 0x1p-18f * place->most) * 1.01f +
                       4.0f * CANOPY_TURN_LEAST_F32;
    for (int i = 0; i < 3; i++) {
        place->low[i] = (box->low[i] - grow) - fabsf(box->low[i]) * 0x1p-22f;
        place->high[i] = (box->high[i] + grow) + fabsf(box->high[i]) * 0x1p-22f;
    }
    return true;
}

// The origin at `target`, relative to the anchor and along the axes, on the quantum. *q: where it came to stand for
// sure, give or take *error. False where it needs more than 24 bits.
static bool put_origin(const struct place *place, const float target[3], int log2, int32_t origin[3], float q[3],
                       float *error) {
    float d[3];
    for (int k = 0; k < 3; k++) {
        const float x = place->anchor[k] +
                        (place->axis[0][k] * target[0] + place->axis[1][k] * target[1] + place->axis[2][k] * target[2]);
        const float quanta = rintf(ldexpf(x, -log2));
        if (!(fabsf(quanta) <= (float)(1 << EDGE_BITS))) {
            return false;
        }
        origin[k] = (int32_t)quanta;
        d[k] = ldexpf(quanta, log2) - place->anchor[k];
    }
    *error = turn_difference(place->axis, d, q);
    return true;
}

// The pitch that takes one axis from `from` over its far side. False where an edge needs more than 24 bits.
static bool set_pitch(struct canopy_frame *frame, int a, float from, float to, int log2) {
    const float extent = ceilf(ldexpf((to - from) * (1.0f + 0x1p-22f), -log2));
    const uint32_t parts = (frame->size[a] - 1U) * frame->cells;
    if (!(extent <= (float)(1 << EDGE_BITS))) {
        return false;
    }
    const uint32_t cell = ((uint32_t)extent + parts - 1) / parts, least = cell > 0 ? cell : 1;
    frame->pitch[a] = least * frame->cells;
    return (uint64_t)least * parts <= 1U << EDGE_BITS;
}

static void set_lsb(struct canopy_frame *frame, const struct place *place, float zero, float error, int log2) {
    const float reach = fmaxf(fabsf(place->high[2] - zero), fabsf(place->low[2] - zero)) + error;
    int exponent = LEAST;
    (void)frexpf(reach, &exponent);
    frame->lsb_log2 = (int16_t)((exponent > LEAST ? exponent : LEAST) - CANOPY_RANGE_LOG2 - log2);
}

// Tries a quantum: the origin goes back by what is missing until it is beyond the low sides for sure.
static bool place_frame(struct canopy_frame *frame, const struct place *place, int log2) {
    const float quantum = ldexpf(1.0f, log2);
    float target[3] = {place->low[0], place->low[1], place->low[2]}, q[3], error;
    for (int attempt = 0; attempt < 8; attempt++) {
        if (!put_origin(place, target, log2, frame->origin, q, &error)) {
            return false;
        }
        const float u = q[0] + error - place->low[0], v = q[1] + error - place->low[1];
        if (q[0] + error <= place->low[0] && q[1] + error <= place->low[1]) {
            frame->quantum_log2 = (int16_t)log2;
            set_lsb(frame, place, q[2], error, log2);
            return set_pitch(frame, 0, q[0] - error, place->high[0], log2) &&
                   set_pitch(frame, 1, q[1] - error, place->high[1], log2);
        }
        target[0] -= u > 0.0f ? u + 0.25f * quantum : 0.0f;
        target[1] -= v > 0.0f ? v + 0.25f * quantum : 0.0f;
    }
    return false;
}

// Axes x, y and z need none of this: the box is one of coordinates.
static enum canopy_status frame_straight(struct canopy_frame *frame, const struct canopy_grid *grid,
                                         const struct place *place) {
    float low[3], high[3];
    for (int k = 0; k < 3; k++) {
        const float from = place->anchor[k] + place->low[k], to = place->anchor[k] + place->high[k];
        low[k] = from - fabsf(from) * 0x1p-23f;
        high[k] = to + fabsf(to) * 0x1p-23f;
    }
    return canopy_frame_around_f32(frame, grid, low, high);
}

enum canopy_status canopy_frame_around_turned_f32(struct canopy_frame *frame, const struct canopy_grid *grid,
                                                  const int32_t axes[3][3], const struct canopy_turned_box_f32 *box) {
    static const int32_t nothing[3] = {0, 0, 0};
    struct place place;
    struct canopy_frame made;
    if (!box->any || box->bad || !canopy_axes_are_sound(axes) || !load_place(&place, axes, box)) {
        return CANOPY_ARGUMENT;
    }
    const enum canopy_status status = canopy_frame_around_fx(&made, grid, nothing, nothing);
    if (status != CANOPY_OK) {
        return status;
    }
    if (canopy_axes_are_straight(axes)) {
        return frame_straight(frame, grid, &place);
    }
    int log2 = LEAST;
    (void)frexpf(place.most, &log2);
    log2 = log2 - EDGE_BITS - 1 > LEAST ? log2 - EDGE_BITS - 1 : LEAST;
    while (!place_frame(&made, &place, log2)) {
        log2++;  // a few times: the sides are at most 2 * most, the pitch's rounding less than parts quanta
    }
    memcpy(made.axis, axes, sizeof made.axis);
    *frame = made;
    return CANOPY_OK;
}
