// The sandwich on the host and on the device. Many random clouds in exact arithmetic:
// hosttest/test_sandwich_properties.c; the command: hosttest/test_sandwich.py.

#include "hosttest/unit/unit.h"
#include "lib/cover/sandwich.h"

enum { M = 5, N = 4, CELLS = 2, COUNT = M * N, POINTS = 40 };

#define FIELD_BYTES CANOPY_FIELD_ARENA(M, N, CELLS, CELLS)
#define BYTES CANOPY_SANDWICH_ARENA(M, N, CELLS, CELLS, 1)
static CANOPY_ARENA_DECLARE(above_arena, FIELD_BYTES);
static CANOPY_ARENA_DECLARE(below_arena, FIELD_BYTES);
static CANOPY_ARENA_DECLARE(arena, BYTES);
static struct canopy_field above, below;
static struct canopy_sandwich sandwich;
static int32_t upper[COUNT], lower[COUNT];
static const uint16_t SIZE[2] = {M, N}, SQUARE[2] = {CELLS, CELLS};

static struct canopy_frame frame_of(uint8_t side) {
    const struct canopy_grid grid = {{M, N}, CELLS, side};
    const int32_t low[3] = {0, 0, 0}, high[3] = {4000, 3000, 1000};
    struct canopy_frame frame;
    CHECK_EQ(canopy_frame_around_fx(&frame, &grid, low, high), CANOPY_OK);
    return frame;
}

static void make_fields(void) {
    const struct canopy_frame frames[2] = {frame_of(CANOPY_ABOVE), frame_of(CANOPY_BELOW)};
    CHECK_EQ(canopy_field_init(&above, &frames[0], SQUARE, above_arena, sizeof above_arena), CANOPY_OK);
    CHECK_EQ(canopy_field_init(&below, &frames[1], SQUARE, below_arena, sizeof below_arena), CANOPY_OK);
}

// A cliff with a hole behind it: surfaces that are fitted to one side alone cross here.
static void feed(void) {
    uint32_t random = 103;
    for (int i = 0; i < POINTS; i++) {
        int32_t point[1][3];
        for (int a = 0; a < 3; a++) {
            random = random * 1664525U + 1013904223U;
            point[0][a] = (int32_t)((random >> 8) % (uint32_t)(a == 0 ? 2001 : a == 1 ? 3001 : 50));
        }
        point[0][0] = point[0][0] > 1000 ? point[0][0] + 1900 : point[0][0];
        point[0][2] += point[0][1] > 1200 ? 900 : 0;
        CHECK_EQ(canopy_sandwich_feed_fx(&above, &below, (const int32_t(*)[3])point, 1), 0);
    }
}

static enum canopy_status init(void *memory, size_t bytes) {
    return canopy_sandwich_init(&sandwich, &above, &below, &canopy_line_fit_fx, 1, memory, bytes);
}

static enum canopy_status run(uint32_t budget) {
    enum canopy_status status;
    while ((status = canopy_sandwich_step(&sandwich, budget)) == CANOPY_MORE) {}
    return status;
}

UNIT(asks_for_its_arena_to_the_byte) {
    make_fields();
    CHECK_EQ(BYTES % 8, 0);
    CHECK_EQ(init(arena, BYTES - 1), CANOPY_ARENA_SHORT);
    CHECK_EQ(init((char *)arena + 4, BYTES), CANOPY_ARENA_ALIGN);
    CHECK_EQ(init(NULL, BYTES), CANOPY_ARENA_ALIGN);
    CHECK_EQ(init(arena, BYTES), CANOPY_OK);
}

UNIT(takes_two_fields_of_one_frame) {
    make_fields();
    CHECK_EQ(canopy_sandwich_init(&sandwich, &below, &above, &canopy_line_fit_fx, 1, arena, BYTES), CANOPY_ARGUMENT);
    CHECK_EQ(canopy_sandwich_init(&sandwich, &above, &above, &canopy_line_fit_fx, 1, arena, BYTES), CANOPY_ARGUMENT);
    CHECK_EQ(canopy_sandwich_init(&sandwich, &above, &below, &canopy_line_fit_fx, 3, arena, BYTES), CANOPY_ARGUMENT);
    CHECK_EQ(canopy_sandwich_init(&sandwich, &above, &below, &canopy_line_fit_fx, 0, arena, BYTES), CANOPY_ARGUMENT);
    CHECK_EQ(canopy_sandwich_init(&sandwich, &above, &below, NULL, 1, arena, BYTES), CANOPY_ARGUMENT);
    below.exact = false;
    CHECK_EQ(init(arena, BYTES), CANOPY_ARGUMENT);
    make_fields();
    below.frame.origin[2]++;
    CHECK_EQ(init(arena, BYTES), CANOPY_ARGUMENT);
    make_fields();
    below.axis[1].cells = 1;
    CHECK_EQ(init(arena, BYTES), CANOPY_ARGUMENT);
}

UNIT(a_field_without_points_is_empty) {
    make_fields();
    CHECK_EQ(init(arena, BYTES), CANOPY_OK);
    CHECK_EQ(canopy_sandwich_step(&sandwich, 1), CANOPY_EMPTY);
    CHECK_EQ(canopy_sandwich_begin(&sandwich, upper, lower), CANOPY_EMPTY);
    CHECK_EQ(canopy_sandwich_step(&sandwich, 1), CANOPY_EMPTY);
    struct canopy_field_hit hit;
    CHECK_EQ(canopy_field_insert_fx(&above, (const int32_t[3]){5, 5, 5}, &hit), CANOPY_OK);
    CHECK_EQ(canopy_sandwich_begin(&sandwich, upper, lower), CANOPY_OK);
    CHECK_EQ(run(1), CANOPY_EMPTY);  // the one below has none
    CHECK_EQ(run(1), CANOPY_EMPTY);
    const int32_t outside[2][3] = {{-1, 0, 0}, {1, 1, 1}};
    CHECK_EQ(canopy_sandwich_feed_fx(&above, &below, outside, 2), 1);
    const float no_number[1][3] = {{1, 1, 1e30f * 1e30f}};
    CHECK_EQ(canopy_sandwich_feed_f32(&above, &below, no_number, 1), 1);
}

// Fitted and certified like one side alone, then nothing is below: by coefficients, and so by their Bernstein form.
static void check_pair(uint32_t budget) {
    CHECK_EQ(canopy_sandwich_begin(&sandwich, upper, lower), CANOPY_OK);
    CHECK_EQ(run(budget), CANOPY_OK);
    CHECK_EQ(canopy_sandwich_step(&sandwich, 1), CANOPY_OK);
    for (int j = 0; j < COUNT; j++) {
        CHECK(upper[j] + lower[j] >= 0);
    }
    CHECK(sandwich.least >= 0);
    CHECK(sandwich.margin[CANOPY_ABOVE] >= 0 && sandwich.margin[CANOPY_BELOW] >= 0);
}

UNIT(both_are_certified_and_do_not_cross) {
    static int32_t again[2][COUNT];
    make_fields();
    feed();
    CHECK_EQ(init(arena, BYTES), CANOPY_OK);
    check_pair(UINT32_MAX);
    CHECK(sandwich.raised > 0);  // alone they would
    memcpy(again[0], upper, sizeof upper);
    memcpy(again[1], lower, sizeof lower);
    check_pair(1);  // however small the steps
    CHECK_BYTES(again[0], upper, sizeof upper);
    CHECK_BYTES(again[1], lower, sizeof lower);
    // the certificates hold
    struct canopy_certify certify;
    for (int side = 0; side < 2; side++) {
        CHECK_EQ(canopy_certify_init(&certify, side == CANOPY_ABOVE ? &above : &below, arena, BYTES), CANOPY_OK);
        canopy_certify_begin(&certify, side == CANOPY_ABOVE ? upper : lower);
        CHECK_EQ(canopy_certify_step(&certify, UINT32_MAX), CANOPY_OK);
        CHECK_EQ(certify.margin, sandwich.margin[side]);
    }
}

UNIT(one_point_is_between_two_planes) {
    make_fields();
    const int32_t point[1][3] = {{1700, 1100, 500}};
    CHECK_EQ(canopy_sandwich_feed_fx(&above, &below, point, 1), 0);
    CHECK_EQ(init(arena, BYTES), CANOPY_OK);
    check_pair(7);
    CHECK(sandwich.least < 200 * CANOPY_SANDWICH_UNITS);  // of 2^24 steps
}

// What the least Bernstein coefficient is, by hand.
UNIT(the_least_distance_is_exact) {
    for (int j = 0; j < COUNT; j++) {
        upper[j] = 1000 + 7 * j;
        lower[j] = 5 - upper[j];
    }
    for (uint32_t row = 0; row + 1 < M; row++) {
        CHECK_EQ(canopy_sandwich_least(upper, lower, SIZE, row), 5 * CANOPY_SANDWICH_UNITS);
    }
    // one coefficient inside, one step: its own knot has 32/48 of it in both directions
    lower[2 * N + 2]--;
    const int64_t all = 5 * CANOPY_SANDWICH_UNITS;
    CHECK_EQ(canopy_sandwich_least(upper, lower, SIZE, 1), all - 32 * 32);
    CHECK_EQ(canopy_sandwich_least(upper, lower, SIZE, 2), all - 32 * 32);
    CHECK_EQ(canopy_sandwich_least(upper, lower, SIZE, 0), all - 8 * 32);
    // a corner coefficient is repeated: it is worth 40/48 there
    lower[2 * N + 2]++;
    upper[0] -= 3;
    CHECK_EQ(canopy_sandwich_least(upper, lower, SIZE, 0), all - 3 * 40 * 40);
    CHECK_EQ(canopy_sandwich_least(upper, lower, SIZE, 2), all);
    // the largest there are do not overflow
    for (int j = 0; j < COUNT; j++) {
        upper[j] = lower[j] = -CANOPY_COEFFICIENT_LIMIT;
    }
    CHECK_EQ(canopy_sandwich_least(upper, lower, SIZE, 1),
             -2 * (int64_t)CANOPY_COEFFICIENT_LIMIT * CANOPY_SANDWICH_UNITS);
}

UNIT(raising_touches_what_is_below_alone) {
    for (int j = 0; j < COUNT; j++) {
        upper[j] = 10;
        lower[j] = -j;
    }
    CHECK_EQ(canopy_sandwich_raise(upper, lower, COUNT), COUNT - 11);
    for (int j = 0; j < COUNT; j++) {
        CHECK_EQ(upper[j], j > 10 ? j : 10);
    }
    CHECK_EQ(canopy_sandwich_raise(upper, lower, COUNT), 0);
}

// Two flat surfaces apart, and a wish for one corner that would cross: it is taken as far as it goes.
UNIT(a_wish_is_taken_as_far_as_they_stay_apart) {
    static int32_t wish[2][COUNT];
    for (int round = 0; round < 2; round++) {
        for (int j = 0; j < COUNT; j++) {
            upper[j] = wish[0][j] = 1000;
            lower[j] = wish[1][j] = 0;
        }
        wish[0][0] = round == 0 ? 400 : -9000000;  // one that does not cross, and one that does
        struct canopy_sandwich_ease ease;
        canopy_sandwich_ease_begin(&ease, SIZE, (const int32_t *const[2]){upper, lower},
                                   (int32_t *const[2]){wish[0], wish[1]});
        uint32_t rows = 1;
        for (; canopy_sandwich_ease_step(&ease, 1) == CANOPY_MORE; rows++) {
            CHECK(rows < 64 * M);
        }
        CHECK_EQ(canopy_sandwich_ease_step(&ease, 1), CANOPY_OK);
        CHECK(canopy_sandwich_least(wish[0], wish[1], SIZE, 0) >= 0);
        CHECK(round == 0 ? wish[0][0] == 400 && rows == M - 1 : wish[0][0] > -9000000 && wish[0][0] <= 1000);
        for (int j = 1; j < COUNT; j++) {
            CHECK_EQ(wish[0][j], 1000);
            CHECK_EQ(upper[j], 1000);
        }
    }
}

UNIT_LIST(sandwich, asks_for_its_arena_to_the_byte, takes_two_fields_of_one_frame, a_field_without_points_is_empty,
          both_are_certified_and_do_not_cross, one_point_is_between_two_planes, the_least_distance_is_exact,
          raising_touches_what_is_below_alone, a_wish_is_taken_as_far_as_they_stay_apart)
