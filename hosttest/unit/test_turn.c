// Frames in any direction, on the host and on the device: axes, turned points, boxes, what is refused. Against exact
// rational arithmetic: hosttest/test_turn_properties.c.

#include <math.h>

#include "hosttest/unit/unit.h"
#include "lib/cover/turn.h"

enum { M = 5, N = 6, CELLS = 2, ROWS = (M - 1) * CELLS, COLUMNS = (N - 1) * CELLS };

static const struct canopy_grid grid = {{M, N}, CELLS, CANOPY_ABOVE};
static const int32_t straight[3][3] = {{CANOPY_AXIS_ONE, 0, 0}, {0, CANOPY_AXIS_ONE, 0}, {0, 0, CANOPY_AXIS_ONE}};
static CANOPY_ARENA_DECLARE(arena, CANOPY_FIELD_ARENA(M, N, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(other_arena, CANOPY_FIELD_ARENA(M, N, CELLS, CELLS));

static void open(struct canopy_field *field, const struct canopy_frame *frame) {
    const uint16_t cells[2] = {CELLS, CELLS};
    CHECK_EQ(canopy_field_init(field, frame, cells, arena, sizeof arena), CANOPY_OK);
}

static uint32_t count_covered(const struct canopy_field *field) {
    uint32_t covered = 0;
    for (uint32_t c = 0; c < ROWS * COLUMNS; c++) {
        covered += field->heights[c] != CANOPY_NO_HEIGHT;
    }
    return covered;
}

static void check_axes(const int32_t axes[3][3], const int32_t expected[3][3]) {
    for (int i = 0; i < 9; i++) {
        CHECK_EQ(axes[i / 3][i % 3], expected[i / 3][i % 3]);
    }
}

// ---- Axes

UNIT(direction_to_axes) {
    int32_t axes[3][3];
    const int32_t up[3] = {0, 0, 7}, zero[3] = {0, 0, 0}, side[3] = {INT32_MIN, 0, 0};
    CHECK_EQ(canopy_axes_from_direction_fx(up, axes), CANOPY_OK);
    check_axes((const int32_t(*)[3])axes, straight);
    CHECK_EQ(canopy_axes_from_direction_fx(zero, axes), CANOPY_ARGUMENT);
    check_axes((const int32_t(*)[3])axes, straight);  // unchanged
    CHECK_EQ(canopy_axes_from_direction_fx(side, axes), CANOPY_OK);
    const int32_t minus_x[3][3] = {{0, CANOPY_AXIS_ONE, 0}, {0, 0, -CANOPY_AXIS_ONE}, {-CANOPY_AXIS_ONE, 0, 0}};
    check_axes((const int32_t(*)[3])axes, minus_x);
    const int32_t slant[3] = {3, 0, 4};  // 0.6, 0, 0.8
    CHECK_EQ(canopy_axes_from_direction_fx(slant, axes), CANOPY_OK);
    const int32_t a = 644245094, b = 858993459;
    const int32_t slanted[3][3] = {{b, 0, -a}, {0, CANOPY_AXIS_ONE, 0}, {a, 0, b}};
    for (int i = 0; i < 9; i++) {
        CHECK_NEAR(axes[i / 3][i % 3], slanted[i / 3][i % 3], 2);
    }
}

UNIT(points_to_axes) {
    int32_t axes[3][3];
    const int32_t floor_plan[3][3] = {{10, 20, 30}, {60, 20, 30}, {0, 21, 30}};
    CHECK_EQ(canopy_axes_from_points_fx(floor_plan, axes), CANOPY_OK);
    check_axes((const int32_t(*)[3])axes, straight);
    const int32_t from_below[3][3] = {{60, 20, 30}, {10, 20, 30}, {0, 21, 30}};
    CHECK_EQ(canopy_axes_from_points_fx(from_below, axes), CANOPY_OK);
    CHECK_EQ(axes[2][2], -CANOPY_AXIS_ONE);
    CHECK_EQ(axes[0][0], -CANOPY_AXIS_ONE);
    const int32_t line[3][3] = {
        {INT32_MIN, INT32_MIN, INT32_MIN}, {-1, -1, -1}, {INT32_MAX - 1, INT32_MAX - 1, INT32_MAX - 1}};
    CHECK_EQ(canopy_axes_from_points_fx(line, axes), CANOPY_ARGUMENT);
    const int32_t twice[3][3] = {{1, 2, 3}, {1, 2, 3}, {5, 5, 5}};
    CHECK_EQ(canopy_axes_from_points_fx(twice, axes), CANOPY_ARGUMENT);
    // The flattest triangle there is: one unit beside a line of 2^33, seen exactly.
    const int32_t sliver[3][3] = {{INT32_MIN, INT32_MIN, 0}, {INT32_MAX, INT32_MAX, 0}, {-1, 0, 0}};
    CHECK_EQ(canopy_axes_from_points_fx(sliver, axes), CANOPY_OK);
    CHECK_EQ(axes[2][2], CANOPY_AXIS_ONE);
    CHECK(canopy_axes_are_sound((const int32_t(*)[3])axes));
}

UNIT(float_axes_are_the_same) {
    int32_t axes[3][3], expected[3][3];
    const float d[3] = {-3e20f, 5e20f, 1e20f}, bad[3] = {0, NAN, 1}, none[3] = {0, 0, 0};
    const int32_t whole[3] = {-3, 5, 1};
    CHECK_EQ(canopy_axes_from_direction_f32(d, axes), CANOPY_OK);
    CHECK_EQ(canopy_axes_from_direction_fx(whole, expected), CANOPY_OK);
    for (int i = 0; i < 9; i++) {
        CHECK_NEAR(axes[i / 3][i % 3], expected[i / 3][i % 3], 128);
    }
    CHECK_EQ(canopy_axes_from_direction_f32(bad, axes), CANOPY_ARGUMENT);
    CHECK_EQ(canopy_axes_from_direction_f32(none, axes), CANOPY_ARGUMENT);
    const float p[3][3] = {{1e-3f, 0, 0}, {2e-3f, 0, 0}, {0, 5e-3f, 0}};
    CHECK_EQ(canopy_axes_from_points_f32(p, axes), CANOPY_OK);
    check_axes((const int32_t(*)[3])axes, straight);
}

UNIT(axes_that_are_no_rotation) {
    int32_t axes[3][3];
    memcpy(axes, straight, sizeof axes);
    CHECK(canopy_axes_are_straight((const int32_t(*)[3])axes));
    axes[0][1] = CANOPY_AXES_TOLERANCE;
    CHECK(canopy_axes_are_sound((const int32_t(*)[3])axes));
    CHECK(!canopy_axes_are_straight((const int32_t(*)[3])axes));
    axes[0][1]++;
    CHECK(!canopy_axes_are_sound((const int32_t(*)[3])axes));
    axes[0][1] = 0;
    axes[2][2] = -CANOPY_AXIS_ONE;  // left-handed
    CHECK(!canopy_axes_are_sound((const int32_t(*)[3])axes));
    axes[2][2] = INT32_MIN;
    CHECK(!canopy_axes_are_sound((const int32_t(*)[3])axes));
    const struct canopy_frame frame = {.size = {M, N}, .pitch = {100, 100}, .cells = CELLS};
    struct canopy_turn_fx turn;
    struct canopy_turn_f32 turn_f32;
    CHECK_EQ(canopy_turn_init_fx(&turn, &frame), CANOPY_ARGUMENT);
    CHECK_EQ(canopy_turn_init_f32(&turn_f32, &frame), CANOPY_ARGUMENT);
}

// ---- Points

// With axes x, y, z the turned way is the straight one.
UNIT(straight_axes_change_nothing) {
    struct canopy_turned_box_fx box;
    const int32_t low[3] = {-100, 7, 50}, high[3] = {401, 90, 1000};
    struct canopy_frame frame, plain;
    canopy_turned_box_begin_fx(&box);
    canopy_turned_box_add_fx(&box, straight, low);
    canopy_turned_box_add_fx(&box, straight, high);
    CHECK_EQ(canopy_frame_around_turned_fx(&frame, &grid, straight, &box), CANOPY_OK);
    CHECK_EQ(canopy_frame_around_fx(&plain, &grid, low, high), CANOPY_OK);
    CHECK_BYTES(&frame, &plain, sizeof frame);
    struct canopy_field field, other;
    struct canopy_turn_fx turn;
    const uint16_t cells[2] = {CELLS, CELLS};
    open(&field, &frame);
    CHECK_EQ(canopy_field_init(&other, &frame, cells, other_arena, sizeof other_arena), CANOPY_OK);
    CHECK_EQ(canopy_turn_init_fx(&turn, &frame), CANOPY_OK);
    for (int32_t i = 0; i < 40; i++) {
        const int32_t p[3] = {-110 + 13 * i, 5 + 2 * i, 40 + 30 * i};
        struct canopy_field_hit a = {0}, b = {0};
        CHECK_EQ(canopy_field_insert_fx(&field, p, &a), canopy_turn_insert_fx(&other, &turn, p, &b));
        CHECK_EQ(a.cell, b.cell);
        CHECK_EQ(a.height, b.height);
    }
    CHECK_BYTES(field.heights, other.heights, sizeof(int32_t) * ROWS * COLUMNS);
}

// 45 degrees about y: the height is (x + z) / sqrt 2, up to the next step.
UNIT(a_diagonal_view) {
    for (uint8_t side = CANOPY_ABOVE; side <= CANOPY_BELOW; side++) {
        int32_t axes[3][3];
        const int32_t diagonal[3] = {1, 0, 1};
        const struct canopy_grid of = {{M, N}, CELLS, side};
        const int32_t points[3][3] = {{0, 0, 0}, {1000, 500, -1000}, {700, 100, 700}};
        struct canopy_turned_box_fx box;
        struct canopy_frame frame;
        struct canopy_field field;
        struct canopy_turn_fx turn;
        CHECK_EQ(canopy_axes_from_direction_fx(diagonal, axes), CANOPY_OK);
        canopy_turned_box_begin_fx(&box);
        for (int i = 0; i < 3; i++) {
            canopy_turned_box_add_fx(&box, (const int32_t(*)[3])axes, points[i]);
        }
        CHECK_EQ(canopy_frame_around_turned_fx(&frame, &of, (const int32_t(*)[3])axes, &box), CANOPY_OK);
        open(&field, &frame);
        CHECK_EQ(canopy_turn_init_fx(&turn, &frame), CANOPY_OK);
        for (int i = 0; i < 3; i++) {
            struct canopy_field_hit hit;
            CHECK_EQ(canopy_turn_insert_fx(&field, &turn, points[i], &hit), CANOPY_OK);
            const double sum = (double)points[i][0] + points[i][2] - frame.origin[0] - frame.origin[2];
            const double height = (side == CANOPY_ABOVE ? sum : -sum) * 0.70710678118654752;
            const double steps = ldexp(height, -frame.lsb_log2);
            CHECK(hit.height >= steps - 0.01 && hit.height <= steps + 1.01);
            CHECK(hit.raised);
        }
        CHECK_EQ(count_covered(&field), 3);
        const int32_t beside[3] = {2000, 0, -2000};
        struct canopy_field_hit hit;
        CHECK_EQ(canopy_turn_insert_fx(&field, &turn, beside, &hit), CANOPY_OUT_OF_FRAME);
        const int32_t far = side == CANOPY_ABOVE ? INT32_MAX / 2 : INT32_MIN / 2, high[3] = {far, 0, far};
        CHECK_EQ(canopy_turn_insert_fx(&field, &turn, high, &hit), CANOPY_RANGE);
        CHECK_EQ(canopy_turn_feed_fx(&field, &turn, points, 3), 0);
        CHECK_EQ(canopy_turn_feed_fx(&field, &turn, &high, 1), 1);
        CHECK_EQ(count_covered(&field), 3);
    }
}

// The corners of what 32 bits hold: exact where a frame is possible, a status where not.
UNIT(coordinates_at_their_limits) {
    int32_t axes[3][3];
    const int32_t diagonal[3] = {1, 1, 1};
    struct canopy_turned_box_fx box;
    struct canopy_frame frame = {.cells = 77};
    CHECK_EQ(canopy_axes_from_direction_fx(diagonal, axes), CANOPY_OK);
    const int32_t(*a)[3] = (const int32_t(*)[3])axes;
    canopy_turned_box_begin_fx(&box);
    CHECK_EQ(canopy_frame_around_turned_fx(&frame, &grid, a, &box), CANOPY_ARGUMENT);  // empty
    for (int i = 0; i < 8; i++) {
        const int32_t corner[3] = {i & 1 ? INT32_MAX : INT32_MIN, i & 2 ? INT32_MAX : INT32_MIN,
                                   i & 4 ? INT32_MAX : INT32_MIN};
        canopy_turned_box_add_fx(&box, a, corner);
    }
    CHECK_EQ(canopy_frame_around_turned_fx(&frame, &grid, a, &box), CANOPY_RANGE);
    CHECK_EQ(frame.cells, 77);
    const int32_t low[3] = {INT32_MIN, INT32_MIN, INT32_MIN};
    canopy_turned_box_begin_fx(&box);
    canopy_turned_box_add_fx(&box, a, low);
    const enum canopy_status status = canopy_frame_around_turned_fx(&frame, &grid, a, &box);
    CHECK(status == CANOPY_OK || status == CANOPY_RANGE);  // its origin would have to be below the least integer
    const struct canopy_frame wide = {
        .size = {M, N},
        .pitch = {1U << 30, 1000},
        .cells = CELLS,
        .axis = {{0, CANOPY_AXIS_ONE, 0}, {0, 0, CANOPY_AXIS_ONE}, {CANOPY_AXIS_ONE, 0, 0}}};
    struct canopy_turn_fx turn;
    CHECK_EQ(canopy_turn_init_fx(&turn, &wide), CANOPY_RANGE);  // 2^32
}

// ---- Boxes

static const int32_t cyclic[3][3] = {{0, CANOPY_AXIS_ONE, 0}, {0, 0, CANOPY_AXIS_ONE}, {CANOPY_AXIS_ONE, 0, 0}};

// u is y, v is z, the height is x: a box that everything about is known of.
static struct canopy_frame cyclic_frame(void) {
    struct canopy_frame frame = {
        .origin = {0, 100, 200}, .pitch = {20, 20}, .size = {M, N}, .cells = CELLS, .lsb_log2 = -8};
    memcpy(frame.axis, cyclic, sizeof frame.axis);
    return frame;
}

static enum canopy_status insert(struct canopy_field *field, const int32_t point[3], const uint32_t half[3],
                                 struct canopy_field_patch *patch) {
    const struct canopy_frame frame = cyclic_frame();
    struct canopy_turn_fx turn;
    struct canopy_field_box_fx box;
    int64_t q[3];
    CHECK_EQ(canopy_turn_init_fx(&turn, &frame), CANOPY_OK);
    canopy_turn_point_fx(&turn, point, q);
    const enum canopy_status status = canopy_turn_box_fx(&turn, q, half, &box);
    return status == CANOPY_OK ? canopy_field_insert_box_fx(field, &box, patch) : status;
}

UNIT(a_box_raises_every_cell_it_meets) {
    const struct canopy_frame frame = cyclic_frame();
    struct canopy_field field;
    struct canopy_field_patch patch;
    open(&field, &frame);
    const int32_t point[3] = {50, 125, 235};  // u = 25, v = 35: row 2, column 3
    const uint32_t none[3] = {0, 0, 0}, half[3] = {7, 5, 6}, too_much[3] = {0, 0, CANOPY_TURN_UNCERTAINTY_MAX + 1};
    CHECK_EQ(insert(&field, point, none, &patch), CANOPY_OK);
    CHECK(patch.first[0] == 2 && patch.last[0] == 2 && patch.first[1] == 3 && patch.last[1] == 3);
    CHECK_EQ(patch.height, 50 << 8);
    CHECK_EQ(patch.raised, 1);
    CHECK(!patch.partly);
    CHECK_EQ(insert(&field, point, half, &patch), CANOPY_OK);  // u 20 … 30, v 29 … 41
    CHECK(patch.first[0] == 2 && patch.last[0] == 3 && patch.first[1] == 2 && patch.last[1] == 4);
    CHECK_EQ(patch.height, 57 << 8);
    CHECK_EQ(patch.raised, 6);
    CHECK_EQ(count_covered(&field), 6);
    CHECK_EQ(insert(&field, point, half, &patch), CANOPY_OK);
    CHECK_EQ(patch.raised, 0);
    CHECK_EQ(insert(&field, point, too_much, &patch), CANOPY_RANGE);
}

UNIT(a_box_beyond_the_frame) {
    const struct canopy_frame frame = cyclic_frame();
    struct canopy_field field;
    struct canopy_field_patch patch;
    open(&field, &frame);
    const int32_t outside[3] = {50, 95, 300}, corner[3] = {50, 180, 300}, high[3] = {1 << 20, 125, 235};
    const uint32_t less[3] = {0, 4, 0}, edge[3] = {0, 5, 0}, more[3] = {0, 8, 0}, all[3] = {0, 1000, 1000};
    CHECK_EQ(insert(&field, outside, less, &patch), CANOPY_OUT_OF_FRAME);
    CHECK_EQ(count_covered(&field), 0);
    CHECK_EQ(insert(&field, outside, edge, &patch), CANOPY_OK);  // the edge is inside
    CHECK(patch.partly && patch.first[0] == 0 && patch.last[0] == 0);
    CHECK(patch.first[1] == COLUMNS - 1 && patch.last[1] == COLUMNS - 1);
    CHECK_EQ(insert(&field, corner, more, &patch), CANOPY_OK);
    CHECK(patch.partly && patch.first[0] == ROWS - 1 && patch.last[0] == ROWS - 1);
    CHECK_EQ(insert(&field, high, less, &patch), CANOPY_RANGE);
    CHECK_EQ(count_covered(&field), 2);
    CHECK_EQ(insert(&field, corner, all, &patch), CANOPY_OK);
    CHECK_EQ(count_covered(&field), ROWS * COLUMNS);
}

UNIT(a_box_has_a_limit) {
    const struct canopy_frame frame = cyclic_frame();
    struct canopy_field field;
    open(&field, &frame);
    field.axis[0].count = field.axis[1].count = 40;  // as large a field as would be too much; nothing is written
    struct canopy_field_patch patch = {.last = {31, 32}, .height = 5, .raised = 9};
    CHECK_EQ(canopy_field_raise(&field, &patch), CANOPY_ARGUMENT);
    CHECK_EQ(count_covered(&field), 0);
}

// ---- Float

UNIT(float_points_are_boxes) {
    int32_t axes[3][3];
    const float direction[3] = {1, 2, 2}, points[3][3] = {{0, 0, 0}, {10, 5, -3}, {-4, 8, 1}};
    struct canopy_turned_box_f32 box;
    struct canopy_frame frame;
    struct canopy_field field;
    struct canopy_turn_f32 turn;
    CHECK_EQ(canopy_axes_from_direction_f32(direction, axes), CANOPY_OK);
    const int32_t(*a)[3] = (const int32_t(*)[3])axes;
    canopy_turned_box_begin_f32(&box);
    CHECK_EQ(canopy_frame_around_turned_f32(&frame, &grid, a, &box), CANOPY_ARGUMENT);
    for (int i = 0; i < 3; i++) {
        canopy_turned_box_add_f32(&box, a, points[i]);
    }
    CHECK_EQ(canopy_frame_around_turned_f32(&frame, &grid, a, &box), CANOPY_OK);
    open(&field, &frame);
    CHECK_EQ(canopy_turn_init_f32(&turn, &frame), CANOPY_OK);
    CHECK_EQ(canopy_turn_feed_f32(&field, &turn, points, 3), 0);
    CHECK(count_covered(&field) >= 3);
    struct canopy_field_box_f32 place;
    canopy_turn_box_f32(&turn, points[1], NULL, &place);
    for (int k = 0; k < 2; k++) {
        CHECK(place.low[k] < place.high[k] && place.high[k] - place.low[k] < 1e-4f);
    }
    const float quantum = ldexpf(1.0f, frame.quantum_log2);
    const double origin =
        ((double)frame.origin[0] + 2.0 * frame.origin[1] + 2.0 * frame.origin[2]) / 3 * (double)quantum;
    CHECK_NEAR(place.top, (10 + 2 * 5 - 2 * 3) / 3.0 - origin, 1e-4);
    const float bad[3][3] = {{NAN, 0, 0}, {0, INFINITY, 0}, {100, 0, 0}};
    CHECK_EQ(canopy_turn_feed_f32(&field, &turn, bad, 3), 3);
    canopy_turned_box_add_f32(&box, a, bad[0]);
    canopy_turned_box_add_f32(&box, a, points[0]);
    CHECK_EQ(canopy_frame_around_turned_f32(&frame, &grid, a, &box), CANOPY_ARGUMENT);
}

UNIT(float_boxes_of_a_straight_frame) {
    const float low[3] = {100, 200, 0}, high[3] = {180, 300, 50}, point[3] = {125, 235, 50}, half[3] = {5, 6, 7};
    struct canopy_frame frame;
    struct canopy_field field;
    struct canopy_turn_f32 turn;
    struct canopy_field_box_f32 box;
    struct canopy_field_patch patch;
    CHECK_EQ(canopy_frame_around_f32(&frame, &grid, low, high), CANOPY_OK);
    open(&field, &frame);
    CHECK_EQ(canopy_turn_init_f32(&turn, &frame), CANOPY_OK);
    canopy_turn_box_f32(&turn, high, NULL, &box);
    CHECK(box.low[0] >= high[0] && box.high[0] <= high[0]);  // exactly the point: nothing was rounded
    CHECK_EQ(canopy_field_insert_box_f32(&field, &box, &patch), CANOPY_OK);
    CHECK(!patch.partly && patch.first[0] == ROWS - 1 && patch.first[1] == COLUMNS - 1);
    canopy_turn_box_f32(&turn, point, half, &box);
    CHECK_EQ(canopy_field_insert_box_f32(&field, &box, &patch), CANOPY_OK);  // 120 … 130, 229 … 241
    CHECK(patch.first[0] <= 2 && patch.last[0] >= 2 && patch.first[1] == 2 && patch.last[1] == 4);
    CHECK(ldexpf((float)patch.height, frame.lsb_log2 + frame.quantum_log2) >= 57);
    const float too_high[3] = {125, 235, 1e30f};
    canopy_turn_box_f32(&turn, too_high, NULL, &box);
    CHECK_EQ(canopy_field_insert_box_f32(&field, &box, &patch), CANOPY_RANGE);
    box.low[0] = NAN;
    CHECK_EQ(canopy_field_insert_box_f32(&field, &box, &patch), CANOPY_OUT_OF_FRAME);
}

UNIT_LIST(turn, direction_to_axes, points_to_axes, float_axes_are_the_same, axes_that_are_no_rotation,
          straight_axes_change_nothing, a_diagonal_view, coordinates_at_their_limits, a_box_raises_every_cell_it_meets,
          a_box_beyond_the_frame, a_box_has_a_limit, float_points_are_boxes, float_boxes_of_a_straight_frame)
