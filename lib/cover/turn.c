#include "lib/cover/turn.h"

#include <string.h>

#include "lib/cover/cell.h"
#include "lib/inline.h"

// ---------------------------------------------------------------------------------------------------------------------
// Points

static int64_t along(const int32_t axis[3], const int32_t point[3]) {
    return (int64_t)axis[0] * point[0] + (int64_t)axis[1] * point[1] + (int64_t)axis[2] * point[2];
}

enum canopy_status canopy_turn_init_fx(struct canopy_turn_fx *turn, const struct canopy_frame *frame) {
    if (!canopy_axes_are_sound(frame->axis) || frame->quantum_log2 != 0 || frame->lsb_log2 < -30 ||
        frame->lsb_log2 > 10) {
        return CANOPY_ARGUMENT;
    }
    uint64_t limit[2];
    for (int a = 0; a < 2; a++) {
        const uint64_t width = canopy_frame_width(frame, a);
        if (width > UINT32_MAX && !canopy_axes_are_straight(frame->axis)) {
            return CANOPY_RANGE;
        }
        limit[a] = (width < UINT32_MAX ? width : UINT32_MAX) << 30;
    }
    *turn = (struct canopy_turn_fx){.limit = {limit[0], limit[1]}, .shift = (uint8_t)(30 + frame->lsb_log2)};
    for (int i = 0; i < 3; i++) {
        const int32_t sign = i == 2 && frame->side == CANOPY_BELOW ? -1 : 1;
        for (int k = 0; k < 3; k++) {
            turn->axis[i][k] = sign * frame->axis[i][k];
        }
        turn->start[i] = -along(turn->axis[i], frame->origin);
    }
    turn->top = ((int64_t)1 << turn->shift) - 1;
    // |top| < reach * 2^32 is |steps| < 2^25, the limit.
    turn->reach = turn->shift >= 7 && turn->shift < 32 ? 1U << (turn->shift - 7) : 0;
    return CANOPY_OK;
}

enum canopy_status canopy_turn_box_fx(const struct canopy_turn_fx *turn, const int64_t q[3],
                                      const uint32_t uncertainty[3], struct canopy_field_box_fx *box) {
    int64_t half[3] = {0};
    for (int k = 0; k < 3; k++) {
        if (uncertainty[k] > CANOPY_TURN_UNCERTAINTY_MAX) {
            return CANOPY_RANGE;
        }
        for (int i = 0; i < 3; i++) {
            const int32_t axis = turn->axis[i][k];
            half[i] += (int64_t)(axis < 0 ? -axis : axis) * uncertainty[k];
        }
    }
    for (int a = 0; a < 2; a++) {
        box->low[a] = q[a] - half[a];
        box->high[a] = q[a] + half[a];
    }
    box->top = q[2] + half[2];
    return CANOPY_OK;
}

// ---------------------------------------------------------------------------------------------------------------------
// Points into a field

// The height of any point; CANOPY_NO_HEIGHT if it is too high. `top`: times 2^30, with what rounds up.
static int32_t find_far_height(const struct canopy_turn_fx *turn, int64_t top) {
    const int64_t steps = top >> turn->shift;
    if (steps > CANOPY_HEIGHT_LIMIT) {
        return CANOPY_NO_HEIGHT;
    }
    return steps < -CANOPY_HEIGHT_LIMIT ? -CANOPY_HEIGHT_LIMIT : (int32_t)steps;
}

CANOPY_INLINE enum canopy_status find(const struct canopy_field *field, const struct canopy_turn_fx *turn,
                                      const int32_t point[3], bool exact, uint32_t *cell, int32_t *height) {
    int64_t q[3];
    canopy_turn_point_fx(turn, point, q);
    if (!canopy_turn_is_inside_fx(turn, q)) {
        return CANOPY_OUT_OF_FRAME;
    }
    const uint32_t row = canopy_cell_of_q30(&field->axis[0], q[0], exact);
    *cell = row * field->axis[1].count + canopy_cell_of_q30(&field->axis[1], q[1], exact);
    const int64_t top = q[2] + turn->top;
    const uint32_t high = (uint32_t)((uint64_t)top >> 32);
    if (high + turn->reach < 2 * turn->reach) {  // a shift of 7 to 31: the result is in the two words' middle
        *height = (int32_t)((uint32_t)top >> turn->shift | high << (32U - turn->shift));
        return CANOPY_OK;
    }
    *height = find_far_height(turn, top);
    return *height != CANOPY_NO_HEIGHT ? CANOPY_OK : CANOPY_RANGE;
}

enum canopy_status canopy_turn_insert_fx(struct canopy_field *field, const struct canopy_turn_fx *turn,
                                         const int32_t point[3], struct canopy_field_hit *hit) {
    const enum canopy_status status = find(field, turn, point, field->exact, &hit->cell, &hit->height);
    if (status == CANOPY_OK) {
        hit->raised = canopy_field_raise_cell(field, hit->cell, hit->height);
    }
    return status;
}

CANOPY_INLINE size_t feed(struct canopy_field *field, const struct canopy_turn_fx *turn, const int32_t (*points)[3],
                          size_t count, bool exact) {
    int32_t *heights = field->heights;
    size_t refused = 0;
    for (; count > 0; count--, points++) {
        uint32_t cell;
        int32_t height;
        if (find(field, turn, *points, exact, &cell, &height) != CANOPY_OK) {
            refused++;
        } else if (heights == NULL) {
            (void)field->packing->packed_raise(field, cell, height);
        } else if (height > heights[cell]) {
            heights[cell] = height;
        }
    }
    return refused;
}

size_t canopy_turn_feed_fx(struct canopy_field *field, const struct canopy_turn_fx *turn, const int32_t (*points)[3],
                           size_t count) {
    return field->exact ? feed(field, turn, points, count, true) : feed(field, turn, points, count, false);
}

// ---------------------------------------------------------------------------------------------------------------------
// A box and its frame

void canopy_turned_box_begin_fx(struct canopy_turned_box_fx *box) {
    for (int i = 0; i < 3; i++) {
        box->low[i] = INT64_MAX;
        box->high[i] = INT64_MIN;
    }
}

void canopy_turned_box_add_fx(struct canopy_turned_box_fx *box, const int32_t axes[3][3], const int32_t point[3]) {
    for (int i = 0; i < 3; i++) {
        const int64_t q = along(axes[i], point);
        box->low[i] = q < box->low[i] ? q : box->low[i];
        box->high[i] = q > box->high[i] ? q : box->high[i];
    }
}

#define FURTHEST ((int64_t)7 << 59)  // axes p of 32-bit points is below 1.7321 * 2^61 = 6.93 * 2^59

// axes o * 2^30 of an origin that need not fit 32 bits yet; |o| below 2^34.
static int64_t turned(const int32_t axis[3], const int64_t o[3]) {
    return axis[0] * o[0] + axis[1] * o[1] + axis[2] * o[2];
}

// The whole o with axes o near `target` (times 2^30): first by the transposed axes, which are nearly their inverse,
// from whole quanta; then what is left over once more, to 2^-16 of a quantum. Below 2^33 each, so nothing here
// overflows. False where it does not fit 32 bits.
static bool turn_back(const int32_t axes[3][3], const int64_t target[3], int32_t origin[3]) {
    int64_t o[3] = {0};
    for (int pass = 0; pass < 3; pass++) {
        const int bits = pass == 0 ? 0 : 16;
        int64_t rest[3];
        for (int i = 0; i < 3; i++) {
            rest[i] = (target[i] - turned(axes[i], o)) >> (30 - bits);
        }
        for (int k = 0; k < 3; k++) {
            const int64_t sum = axes[0][k] * rest[0] + axes[1][k] * rest[1] + axes[2][k] * rest[2];
            o[k] += (sum + ((int64_t)1 << (29 + bits))) >> (30 + bits);
        }
    }
    for (int k = 0; k < 3; k++) {
        if (o[k] > INT32_MAX || o[k] < INT32_MIN) {
            return false;
        }
        origin[k] = (int32_t)o[k];
    }
    return true;
}

// Rounding an origin to whole quanta moves it along an axis by no more than half the sum of the axis' magnitudes; and a
// little for what turn_back leaves.
static int64_t half_step(const int32_t axis[3]) {
    int64_t sum = 0;
    for (int k = 0; k < 3; k++) {
        sum += axis[k] < 0 ? -(int64_t)axis[k] : axis[k];
    }
    return sum / 2 + (1 << 20);
}

// An origin that is not beyond the box's low sides, sideways: at its corner, if that is a point of whole quanta; else
// as near as rounding allows.
static bool place_origin(const int32_t axes[3][3], const struct canopy_turned_box_fx *box, int32_t origin[3]) {
    int64_t target[3] = {box->low[0], box->low[1], box->low[2]};
    for (int attempt = 0; attempt < 2; attempt++) {
        if (!turn_back(axes, target, origin)) {
            return false;
        }
        if (along(axes[0], origin) <= box->low[0] && along(axes[1], origin) <= box->low[1]) {
            return true;
        }
        target[0] = box->low[0] - half_step(axes[0]);
        target[1] = box->low[1] - half_step(axes[1]);
    }
    return false;
}

// Whole quanta of a stretch that is not negative.
static uint64_t quanta_of(int64_t stretch) { return ((uint64_t)stretch + 0x3FFFFFFFU) >> 30; }

// How high the box is above the origin, or how deep below it, whichever is more.
static uint64_t reach_of(int64_t low, int64_t high, int64_t zero) {
    const uint64_t down = low < zero ? quanta_of(zero - low) : 0, up = high > zero ? quanta_of(high - zero) : 0;
    return down > up ? down : up;
}

enum canopy_status canopy_frame_around_turned_fx(struct canopy_frame *frame, const struct canopy_grid *grid,
                                                 const int32_t axes[3][3], const struct canopy_turned_box_fx *box) {
    int32_t origin[3], high[3];
    for (int i = 0; i < 3; i++) {
        if (box->low[i] > box->high[i] || box->low[i] < -FURTHEST || box->high[i] > FURTHEST) {
            return CANOPY_ARGUMENT;
        }
    }
    if (!canopy_axes_are_sound(axes)) {
        return CANOPY_ARGUMENT;
    }
    if (!place_origin(axes, box, origin)) {
        return CANOPY_RANGE;
    }
    // A box of these extents along the coordinates has the pitch and the steps.
    for (int i = 0; i < 3; i++) {
        const int64_t zero = along(axes[i], origin);
        const uint64_t extent = i < 2 ? quanta_of(box->high[i] - zero) : reach_of(box->low[2], box->high[2], zero);
        if (extent > UINT32_MAX) {
            return CANOPY_RANGE;
        }
        high[i] = (int32_t)(INT32_MIN + (int64_t)extent);
    }
    const int32_t low[3] = {INT32_MIN, INT32_MIN, INT32_MIN};
    struct canopy_frame made;
    const enum canopy_status status = canopy_frame_around_fx(&made, grid, low, high);
    if (status != CANOPY_OK) {
        return status;
    }
    memcpy(made.origin, origin, sizeof made.origin);
    memcpy(made.axis, axes, sizeof made.axis);
    const bool wide = canopy_frame_width(&made, 0) > UINT32_MAX || canopy_frame_width(&made, 1) > UINT32_MAX;
    if (wide && !canopy_axes_are_straight(axes)) {
        return CANOPY_RANGE;
    }
    *frame = made;
    return CANOPY_OK;
}
