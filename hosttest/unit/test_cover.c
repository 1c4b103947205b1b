// The safe surface piece by piece: frame, field, line, surface, certificate, on the host and on the device.
// Many random clouds in exact arithmetic: hosttest/test_cover_properties.c.

#include <math.h>

#include "hosttest/unit/unit.h"
#include "lib/cover/certify.h"
#include "lib/cover/envelope.h"
#include "lib/cover/fast.h"
#include "lib/cover/field.h"
#include "lib/cover/frame.h"
#include "lib/cover/line.h"
#include "lib/spline/bound.h"

enum { M = 6, N = 7, CELLS = 4 };

static uint32_t next_random(uint32_t *state) {
    *state = *state * 1664525U + 1013904223U;
    return *state >> 8;
}

static const struct canopy_grid grid = {{M, N}, CELLS, CANOPY_ABOVE};

// ---- Frame

UNIT(frame_is_the_smallest_that_holds_the_box) {
    const int32_t low[3] = {-100, 7, 50}, high[3] = {400, 7, 90};
    struct canopy_frame f;
    CHECK_EQ(canopy_frame_around_fx(&f, &grid, low, high), CANOPY_OK);
    CHECK_EQ(f.origin[0], -100);
    CHECK_EQ(f.origin[1], 7);
    CHECK_EQ(f.pitch[0], 100);    // 500 over 5 intervals
    CHECK_EQ(f.pitch[1], CELLS);  // no extent: Q quanta
    const int32_t wider[3] = {401, 7, 90};
    CHECK_EQ(canopy_frame_around_fx(&f, &grid, low, wider), CANOPY_OK);
    CHECK_EQ(f.pitch[0], 104);  // the next multiple of Q
    CHECK(canopy_frame_width(&f, 0) >= 501);
}

UNIT(frame_takes_the_whole_range_of_coordinates) {
    const int32_t low[3] = {INT32_MIN, INT32_MIN, INT32_MIN}, high[3] = {INT32_MAX, INT32_MAX, INT32_MAX};
    struct canopy_frame f;
    CHECK_EQ(canopy_frame_around_fx(&f, &grid, low, high), CANOPY_OK);
    CHECK(canopy_frame_width(&f, 0) >= UINT32_MAX);
    CHECK(canopy_frame_width(&f, 1) >= UINT32_MAX);
    CHECK_EQ(f.lsb_log2, 32 - CANOPY_RANGE_LOG2);
}

UNIT(frame_of_a_flat_scene_has_room_for_heights) {
    const int32_t low[3] = {0, 0, 70}, high[3] = {1000, 1000, 70};
    struct canopy_frame f;
    CHECK_EQ(canopy_frame_around_fx(&f, &grid, low, high), CANOPY_OK);
    CHECK_EQ((int64_t)CANOPY_HEIGHT_LIMIT >> -f.lsb_log2, 512);
}

UNIT(frame_refuses_what_is_no_grid_or_box) {
    const int32_t low[3] = {0, 0, 0}, high[3] = {9, 9, 9};
    struct canopy_frame f = {.cells = 99};
    struct canopy_grid bad = grid;
    bad.size[0] = 3;
    CHECK_EQ(canopy_frame_around_fx(&f, &bad, low, high), CANOPY_ARGUMENT);
    bad = grid;
    bad.size[1] = CANOPY_SIZE_MAX + 1;
    CHECK_EQ(canopy_frame_around_fx(&f, &bad, low, high), CANOPY_ARGUMENT);
    bad = grid;
    bad.cells = 0;
    CHECK_EQ(canopy_frame_around_fx(&f, &bad, low, high), CANOPY_ARGUMENT);
    bad.cells = CANOPY_CELLS_MAX + 1;
    CHECK_EQ(canopy_frame_around_fx(&f, &bad, low, high), CANOPY_ARGUMENT);
    bad = grid;
    bad.side = 2;
    CHECK_EQ(canopy_frame_around_fx(&f, &bad, low, high), CANOPY_ARGUMENT);
    CHECK_EQ(canopy_frame_around_fx(&f, &grid, high, low), CANOPY_ARGUMENT);
    const float zero[3] = {0, 0, 0}, nan[3] = {0, NAN, 1}, infinite[3] = {0, INFINITY, 1};
    CHECK_EQ(canopy_frame_around_f32(&f, &grid, zero, nan), CANOPY_ARGUMENT);
    CHECK_EQ(canopy_frame_around_f32(&f, &grid, zero, infinite), CANOPY_ARGUMENT);
    CHECK_EQ(f.cells, 99);  // untouched
}

UNIT(frame_in_float_has_exact_edges) {
    uint32_t random = 3;
    for (int i = 0; i < 200; i++) {
        const float size = ldexpf(1.0f, (int)(next_random(&random) % 200) - 100);
        float low[3], high[3];
        for (int a = 0; a < 3; a++) {
            low[a] = size * ((float)next_random(&random) - 8388608.0f);
            high[a] = low[a] + size * (float)(next_random(&random) % 1000);
        }
        struct canopy_frame f;
        CHECK_EQ(canopy_frame_around_f32(&f, &grid, low, high), CANOPY_OK);
        for (int a = 0; a < 2; a++) {
            const int64_t far = f.origin[a] + (int64_t)canopy_frame_width(&f, a);
            CHECK(f.origin[a] >= -(1 << 24) && far <= 1 << 24);
            CHECK(ldexpf((float)f.origin[a], f.quantum_log2) <= low[a]);
            CHECK(ldexpf((float)far, f.quantum_log2) >= high[a]);
            CHECK_EQ(f.pitch[a] % CELLS, 0);
        }
    }
}

// Differences of the extents beyond what a float's exponent spans, and coordinates whose differences would be infinite.
UNIT(frame_in_float_holds_its_corners) {
    struct canopy_frame f;
    const float low[3] = {-1e-30f, -1e20f, 0}, high[3] = {-1e-31f, 1e20f, 0};
    CHECK_EQ(canopy_frame_around_f32(&f, &grid, low, high), CANOPY_OK);
    CHECK_EQ(f.origin[0], -1);
    const float from[3] = {-ldexpf(1, 50), 0, 0}, to[3] = {1e-30f, 1e20f, 0};
    CHECK_EQ(canopy_frame_around_f32(&f, &grid, from, to), CANOPY_OK);
    CHECK(f.origin[0] + (int64_t)canopy_frame_width(&f, 0) > 0);
    const float most = CANOPY_FRAME_F32_MAX, least[3] = {-most, -most, -most}, far[3] = {most, most, most};
    CHECK_EQ(canopy_frame_around_f32(&f, &grid, least, far), CANOPY_OK);
    CHECK(isfinite(ldexpf((float)(f.origin[0] + (int64_t)canopy_frame_width(&f, 0)), f.quantum_log2)));
    for (int a = 0; a < 3; a++) {
        float beyond[3] = {most, most, most};
        beyond[a] = nextafterf(most, INFINITY);
        CHECK_EQ(canopy_frame_around_f32(&f, &grid, least, beyond), CANOPY_ARGUMENT);
        beyond[a] = -beyond[a];
        CHECK_EQ(canopy_frame_around_f32(&f, &grid, beyond, far), CANOPY_ARGUMENT);
    }
}

// ---- Field

static CANOPY_ARENA_DECLARE(field_arena, CANOPY_FIELD_ARENA(M, N, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(fast_arena, CANOPY_FAST_ARENA(M, N, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(certify_arena, CANOPY_CERTIFY_ARENA(N, CELLS, CELLS));

static struct canopy_frame frame_of(uint8_t side, int32_t extent_u, int32_t extent_v, int32_t height) {
    const int32_t low[3] = {0, 0, 0}, high[3] = {extent_u, extent_v, height};
    struct canopy_grid g = grid;
    g.side = side;
    struct canopy_frame f;
    CHECK_EQ(canopy_frame_around_fx(&f, &g, low, high), CANOPY_OK);
    return f;
}

static struct canopy_field field_in(const struct canopy_frame *frame) {
    static const uint16_t cells[2] = {CELLS, CELLS};
    struct canopy_field field;
    CHECK_EQ(canopy_field_init(&field, frame, cells, field_arena, sizeof field_arena), CANOPY_OK);
    return field;
}

UNIT(field_asks_for_its_arena) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE, 1000, 1000, 100);
    const uint16_t cells[2] = {CELLS, CELLS}, many[2] = {CANOPY_CELLS_MAX + 1, 1};
    struct canopy_field f;
    char *bytes = (char *)field_arena;
    CHECK_EQ(canopy_field_init(&f, &frame, cells, bytes, sizeof field_arena - 1), CANOPY_ARENA_SHORT);
    CHECK_EQ(canopy_field_init(&f, &frame, cells, bytes + 4, sizeof field_arena), CANOPY_ARENA_ALIGN);
    CHECK_EQ(canopy_field_init(&f, &frame, cells, NULL, sizeof field_arena), CANOPY_ARENA_ALIGN);
    CHECK_EQ(canopy_field_init(&f, &frame, many, bytes, sizeof field_arena), CANOPY_ARGUMENT);
}

// The cell of every integer point of an axis is the one whose closed edges hold it, by plain division.
UNIT(field_finds_the_cell_of_every_point) {
    for (int32_t extent = 0; extent < 300; extent += 7) {
        const struct canopy_frame frame = frame_of(CANOPY_ABOVE, extent, 3 * extent, 10);
        struct canopy_field field = field_in(&frame);
        CHECK(field.exact);
        const int32_t width = (int32_t)canopy_frame_width(&frame, 0);
        for (int32_t x = 0; x <= width; x++) {
            const int32_t p[3] = {x, 0, 1};
            struct canopy_field_hit hit;
            CHECK_EQ(canopy_field_insert_fx(&field, p, &hit), CANOPY_OK);
            const uint32_t cell = frame.pitch[0] / CELLS;
            uint32_t row = (uint32_t)x / cell;
            row = row < field.axis[0].count ? row : field.axis[0].count - 1;
            CHECK_EQ(hit.cell / field.axis[1].count, row);
        }
        const int32_t outside[4][3] = {{-1, 0, 1}, {width + 1, 0, 1}, {0, INT32_MIN, 1}, {INT32_MAX, 0, 1}};
        for (int i = 0; i < 4; i++) {
            struct canopy_field_hit hit;
            CHECK_EQ(canopy_field_insert_fx(&field, outside[i], &hit), CANOPY_OUT_OF_FRAME);
        }
    }
}

// Points that are fed take the quotient from a product: at both ends of every cell, for cells of all sizes, powers of
// two and their neighbours among them, up to axes of 2^31.
UNIT(field_fed_finds_the_cell_at_every_edge) {
    uint32_t random = 9;
    for (uint32_t round = 0; round < 400; round++) {
        const uint32_t most = (uint32_t)INT32_MAX / ((M - 1) * CELLS), bits = next_random(&random) % 26;
        const uint32_t near = (UINT32_C(1) << bits) + next_random(&random) % 3 - 1;
        const uint32_t d = round % 4 == 0 ? most : round % 2 == 0 ? near : next_random(&random) >> bits;
        struct canopy_frame frame = frame_of(CANOPY_ABOVE, 1000, 1000, 1000);
        frame.pitch[0] = CELLS * (d < 1 ? 1 : d > most ? most : d);
        struct canopy_field field = field_in(&frame);
        const int32_t cell = (int32_t)(frame.pitch[0] / CELLS), rows = (int32_t)field.axis[0].count;
        for (int32_t i = 0; i < 2 * rows; i++) {
            const int32_t row = i / 2, x = row * cell + (i % 2) * (cell - 1);
            const int32_t point[1][3] = {{x, 0, i + 1}};
            CHECK_EQ(canopy_field_feed_fx(&field, point, 1), 0);
            CHECK_EQ(field.heights[(uint32_t)row * field.axis[1].count], (i + 1) * (1 << -frame.lsb_log2));
        }
    }
}

UNIT(field_finds_cells_over_the_whole_range) {
    const int32_t low[3] = {INT32_MIN, INT32_MAX - 50, 0}, high[3] = {INT32_MAX, INT32_MAX, 0};
    struct canopy_frame frame;
    CHECK_EQ(canopy_frame_around_fx(&frame, &grid, low, high), CANOPY_OK);
    struct canopy_field field = field_in(&frame);
    uint32_t random = 5;
    for (int i = 0; i < 3000; i++) {
        const int64_t x = INT32_MIN + (int64_t)(((uint64_t)next_random(&random) << 8) + next_random(&random) % 256);
        const int32_t p[3] = {(int32_t)x, INT32_MAX - (int32_t)(next_random(&random) % 51), 0};
        struct canopy_field_hit hit;
        CHECK_EQ(canopy_field_insert_fx(&field, p, &hit), CANOPY_OK);
        const uint64_t row = (uint64_t)(x - INT32_MIN) / (frame.pitch[0] / CELLS);
        const uint64_t column = (uint64_t)((int64_t)p[1] - frame.origin[1]) / (frame.pitch[1] / CELLS);
        CHECK_EQ(hit.cell, row * field.axis[1].count + column);
    }
    const int32_t below[3] = {0, INT32_MIN, 0};  // wraps to a small offset modulo 2^32
    struct canopy_field_hit hit;
    CHECK_EQ(canopy_field_insert_fx(&field, below, &hit), CANOPY_OUT_OF_FRAME);
}

UNIT(field_keeps_the_highest_and_says_so) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE, 1000, 1000, 100);
    struct canopy_field field = field_in(&frame);
    struct canopy_field_hit hit;
    const int32_t first[3] = {10, 10, 40}, lower[3] = {11, 10, 39}, higher[3] = {10, 11, 41};
    CHECK_EQ(canopy_field_insert_fx(&field, first, &hit), CANOPY_OK);
    CHECK(hit.raised);
    CHECK_EQ(canopy_field_insert_fx(&field, lower, &hit), CANOPY_OK);
    CHECK(!hit.raised);
    CHECK_EQ(canopy_field_insert_fx(&field, higher, &hit), CANOPY_OK);
    CHECK(hit.raised);
    CHECK_EQ(field.heights[hit.cell], 41 * (1 << -frame.lsb_log2));
    canopy_field_clear(&field);
    CHECK_EQ(field.heights[hit.cell], CANOPY_NO_HEIGHT);
}

UNIT(field_below_keeps_the_lowest) {
    const struct canopy_frame frame = frame_of(CANOPY_BELOW, 1000, 1000, 100);
    struct canopy_field field = field_in(&frame);
    struct canopy_field_hit hit;
    const int32_t first[3] = {10, 10, 40}, lower[3] = {11, 10, 39}, higher[3] = {10, 11, 41};
    CHECK_EQ(canopy_field_insert_fx(&field, first, &hit), CANOPY_OK);
    CHECK_EQ(canopy_field_insert_fx(&field, higher, &hit), CANOPY_OK);
    CHECK(!hit.raised);
    CHECK_EQ(canopy_field_insert_fx(&field, lower, &hit), CANOPY_OK);
    CHECK(hit.raised);
    CHECK_EQ(field.heights[hit.cell], -39 * (1 << -frame.lsb_log2));
}

UNIT(field_refuses_heights_it_cannot_hold) {
    const struct canopy_frame above = frame_of(CANOPY_ABOVE, 100, 100, 100),
                              below = frame_of(CANOPY_BELOW, 100, 100, 100);
    struct canopy_field_hit hit;
    const int32_t high[3] = {10, 10, 1000}, low[3] = {10, 10, -1000}, most[3] = {10, 10, INT32_MAX},
                  least[3] = {10, 10, INT32_MIN};
    struct canopy_field field = field_in(&above);
    CHECK_EQ(canopy_field_insert_fx(&field, high, &hit), CANOPY_RANGE);
    CHECK_EQ(canopy_field_insert_fx(&field, most, &hit), CANOPY_RANGE);
    CHECK_EQ(canopy_field_insert_fx(&field, low, &hit), CANOPY_OK);  // higher than it is: safe
    CHECK_EQ(hit.height, -CANOPY_HEIGHT_LIMIT);
    CHECK_EQ(canopy_field_insert_fx(&field, least, &hit), CANOPY_OK);
    field = field_in(&below);
    CHECK_EQ(canopy_field_insert_fx(&field, high, &hit), CANOPY_OK);
    CHECK_EQ(canopy_field_insert_fx(&field, low, &hit), CANOPY_RANGE);
    CHECK_EQ(canopy_field_insert_fx(&field, least, &hit), CANOPY_RANGE);
}

UNIT(field_rounds_heights_up_where_a_step_is_more_than_a_quantum) {
    const int32_t low[3] = {0, 0, 0}, high[3] = {100, 100, INT32_MAX};
    struct canopy_frame frame;
    CHECK_EQ(canopy_frame_around_fx(&frame, &grid, low, high), CANOPY_OK);
    CHECK(frame.lsb_log2 > 0);
    struct canopy_field field = field_in(&frame);
    const int64_t step = (int64_t)1 << frame.lsb_log2;
    for (int32_t z = 0; z < 1000; z += 37) {
        const int32_t p[3] = {1, 1, z};
        struct canopy_field_hit hit;
        CHECK_EQ(canopy_field_insert_fx(&field, p, &hit), CANOPY_OK);
        CHECK(hit.height * step >= z && (hit.height - 1) * step < z);
    }
}

// Frames from elsewhere may have any step.
UNIT(field_takes_any_step) {
    struct canopy_frame frame = frame_of(CANOPY_ABOVE, 1000, 1000, 100);
    const int32_t at[3] = {1, 1, frame.origin[2]}, above[3] = {1, 1, INT32_MAX}, below[3] = {1, 1, INT32_MIN};
    static const int16_t steps[] = {INT16_MIN, -63, -31, 63, 64, INT16_MAX};
    for (size_t i = 0; i < sizeof steps / sizeof steps[0]; i++) {
        frame.lsb_log2 = steps[i];
        struct canopy_field field = field_in(&frame);
        struct canopy_field_hit hit;
        CHECK_EQ(canopy_field_insert_fx(&field, below, &hit), CANOPY_OK);
        CHECK_EQ(hit.height, steps[i] < 0 ? -CANOPY_HEIGHT_LIMIT : 0);
        CHECK_EQ(canopy_field_insert_fx(&field, at, &hit), CANOPY_OK);
        CHECK_EQ(hit.height, 0);
        CHECK_EQ(canopy_field_insert_fx(&field, above, &hit), steps[i] < 0 ? CANOPY_RANGE : CANOPY_OK);
        CHECK(steps[i] < 0 || hit.height == 1);
    }
}

UNIT(field_in_float_agrees_with_exact_edges) {
    const float low[3] = {-3.7f, 100.1f, 0.0f}, high[3] = {5.3f, 100.7f, 1.0f};
    struct canopy_frame frame;
    CHECK_EQ(canopy_frame_around_f32(&frame, &grid, low, high), CANOPY_OK);
    struct canopy_field field = field_in(&frame);
    CHECK(field.exact);
    uint32_t random = 11;
    for (int i = 0; i < 2000; i++) {
        const float p[3] = {-3.7f + 9.0f * (float)next_random(&random) / 16777216.0f, 100.4f, 0.5f};
        struct canopy_field_hit hit;
        CHECK_EQ(canopy_field_insert_f32(&field, p, &hit), CANOPY_OK);
        const int32_t row = (int32_t)(hit.cell / field.axis[1].count), cell = (int32_t)(frame.pitch[0] / CELLS);
        const double quanta = ldexp((double)p[0], -frame.quantum_log2);  // exact
        CHECK(quanta >= frame.origin[0] + row * cell && quanta <= frame.origin[0] + (row + 1) * cell);
        CHECK(ldexp(hit.height, frame.lsb_log2 + frame.quantum_log2) + ldexp(frame.origin[2], frame.quantum_log2) >=
              0.5);
    }
    const float bad[5][3] = {{NAN, 100.4f, 0}, {0, NAN, 0}, {0, 100.4f, NAN}, {INFINITY, 100.4f, 0}, {6.0f, 100.4f, 0}};
    for (int i = 0; i < 5; i++) {
        struct canopy_field_hit hit;
        CHECK_EQ(canopy_field_insert_f32(&field, bad[i], &hit), CANOPY_OUT_OF_FRAME);
    }
    const float infinite[2][3] = {{0, 100.4f, INFINITY}, {0, 100.4f, -INFINITY}};
    const float high_up[3] = {0, 100.4f, 1e30f}, far_down[3] = {0, 100.4f, -1e30f};
    struct canopy_field_hit hit;
    CHECK_EQ(canopy_field_insert_f32(&field, infinite[0], &hit), CANOPY_OUT_OF_FRAME);
    CHECK_EQ(canopy_field_insert_f32(&field, infinite[1], &hit), CANOPY_OUT_OF_FRAME);
    CHECK_EQ(canopy_field_insert_f32(&field, high_up, &hit), CANOPY_RANGE);
    CHECK_EQ(canopy_field_insert_f32(&field, far_down, &hit), CANOPY_OK);
}

// What is further down than a float's whole steps reach counts as the lowest height; one just beyond must not become
// lower than it is.
UNIT(field_in_float_lowers_no_point) {
    const float low[3] = {0.0f, 0.0f, 0.0f}, high[3] = {1.0f, 1.0f, 1.0f};
    for (int side = CANOPY_ABOVE; side <= CANOPY_BELOW; side++) {
        struct canopy_frame frame;
        CHECK_EQ(canopy_frame_around_f32(&frame, &grid, low, high), CANOPY_OK);
        frame.side = (uint8_t)side;
        struct canopy_field field = field_in(&frame);
        for (int32_t steps = -CANOPY_HEIGHT_LIMIT - 16; steps <= -CANOPY_HEIGHT_LIMIT + 16; steps += 2) {
            const float z = ldexpf((float)steps, frame.lsb_log2 + frame.quantum_log2);  // exact, but for the last ones
            const float p[3] = {0.5f, 0.5f, side == CANOPY_BELOW ? -z : z};
            const struct canopy_field_box_f32 box = {{0.5f, 0.5f}, {0.5f, 0.5f}, z};
            struct canopy_field_hit hit;
            struct canopy_field_patch patch;
            CHECK_EQ(canopy_field_insert_f32(&field, p, &hit), CANOPY_OK);
            CHECK_EQ(canopy_field_insert_box_f32(&field, &box, &patch), CANOPY_OK);
            const double truth = ldexp((double)z, -(frame.lsb_log2 + frame.quantum_log2));
            CHECK(hit.height >= truth && patch.height >= truth);
        }
    }
}

UNIT(fields_merge_by_maximum) {
    static CANOPY_ARENA_DECLARE(other_arena, CANOPY_FIELD_ARENA(M, N, CELLS, CELLS));
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE, 1000, 1000, 100);
    const uint16_t cells[2] = {CELLS, CELLS};
    struct canopy_field a = field_in(&frame), b;
    CHECK_EQ(canopy_field_init(&b, &frame, cells, other_arena, sizeof other_arena), CANOPY_OK);
    const int32_t p[3] = {10, 10, 40}, q[3] = {10, 10, 60}, r[3] = {900, 900, 5};
    struct canopy_field_hit hit;
    CHECK_EQ(canopy_field_insert_fx(&a, p, &hit), CANOPY_OK);
    CHECK_EQ(canopy_field_insert_fx(&b, q, &hit), CANOPY_OK);
    CHECK_EQ(canopy_field_insert_fx(&b, r, &hit), CANOPY_OK);
    CHECK_EQ(canopy_field_merge(&a, &b), CANOPY_OK);
    CHECK_EQ(a.heights[hit.cell], b.heights[hit.cell]);
    b.frame.origin[0]++;
    CHECK_EQ(canopy_field_merge(&a, &b), CANOPY_ARGUMENT);
}

UNIT(coverage_is_one_bit_a_knot_cell) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE, 500, 600, 100);  // pitch 100
    struct canopy_field field = field_in(&frame);
    uint8_t bits[CANOPY_COVERAGE_BYTES(M, N)];
    CHECK_EQ(canopy_field_coverage(&field, bits), 0);
    struct canopy_field_hit hit;
    const int32_t p[3] = {250, 399, 1};
    CHECK_EQ(canopy_field_insert_fx(&field, p, &hit), CANOPY_OK);
    CHECK_EQ(canopy_field_coverage(&field, bits), 1);
    const struct canopy_envelope envelope = {.frame = frame, .coverage = bits};
    CHECK(canopy_envelope_covers(&envelope, 250, 399));
    CHECK(canopy_envelope_covers(&envelope, 201, 301));
    CHECK(!canopy_envelope_covers(&envelope, 199, 399));
    CHECK(!canopy_envelope_covers(&envelope, 250, 401));
}

// ---- Line

static CANOPY_ARENA_DECLARE(line_arena, CANOPY_LINE_ARENA(N, CELLS));

static struct canopy_line line_of(void) {
    struct canopy_arena cut;
    CHECK_EQ(canopy_arena_open(&cut, line_arena, sizeof line_arena, CANOPY_LINE_ARENA(N, CELLS)), CANOPY_OK);
    struct canopy_line line;
    canopy_line_init(&line, N, CELLS, &cut);
    return line;
}

static bool is_above(const int32_t *b, uint16_t q, const int32_t *nodes) {
    for (uint16_t k = 0; k < CANOPY_LINE_NODES(N, q); k++) {
        uint32_t h = (uint32_t)k / q, s = (uint32_t)k % q;
        if (h == N - 1) {
            h--;
            s = q;
        }
        const int64_t bound =
            canopy_bound_exact(b, h, canopy_bend(b, N, h), canopy_bend(b, N, h + 1), (int32_t)s, (int32_t)q);
        if (nodes[k] != CANOPY_NO_HEIGHT && bound < 6 * (int64_t)q * q * q * nodes[k]) {
            return false;
        }
    }
    return true;
}

// Coefficients beyond +-limit count as exploded.
static void fit_line_within(struct canopy_line *line, enum canopy_scalar scalar, uint16_t q, int32_t limit,
                            int32_t *b) {
    const struct canopy_line_fit *fit = canopy_line_fit_of(scalar);
    fit->shape(line, N, q);
    CHECK(fit->begin(line, -limit, limit));
    while (fit->iterate(line)) {}
    fit->finish(line, b);
}

static void fit_line(struct canopy_line *line, enum canopy_scalar scalar, uint16_t q, int32_t *b) {
    fit_line_within(line, scalar, q, 1 << 28, b);
}

UNIT(line_is_above_every_node_in_both_scalars) {
    for (uint32_t seed = 1; seed <= 300; seed++) {
        struct canopy_line line = line_of();
        uint32_t random = seed;
        const uint16_t q = seed % 3 == 0 ? 1 : CELLS;
        const uint32_t holes = seed % 4, size = seed % 5 == 0 ? 1U << 25 : 1000;
        bool any = false;
        for (size_t k = 0; k < CANOPY_LINE_NODES(N, q); k++) {
            const bool hole = next_random(&random) % 4 < holes;
            line.nodes[k] = hole ? CANOPY_NO_HEIGHT : (int32_t)(next_random(&random) % size) - (int32_t)(size / 2);
            any |= !hole;
        }
        if (!any) {
            continue;
        }
        int32_t b[N];
        fit_line(&line, CANOPY_F32, q, b);
        CHECK(is_above(b, q, line.nodes));
        fit_line(&line, CANOPY_FX, q, b);
        CHECK(is_above(b, q, line.nodes));
        CHECK(line.solves <= CANOPY_LINE_SOLVES);
    }
}

UNIT(line_through_a_straight_slope_is_that_slope) {
    struct canopy_line line = line_of();
    for (size_t k = 0; k < CANOPY_LINE_NODES(N, CELLS); k++) {
        line.nodes[k] = (int32_t)k * 250;
    }
    int32_t b[N];
    fit_line(&line, CANOPY_FX, CELLS, b);
    CHECK(line.settled);
    for (int j = 2; j < N - 2; j++) {
        CHECK_NEAR(b[j], 1000 * j, 12);
    }
}

UNIT(line_without_data_says_so) {
    struct canopy_line line = line_of();
    for (size_t k = 0; k < CANOPY_LINE_NODES(N, CELLS); k++) {
        line.nodes[k] = CANOPY_NO_HEIGHT;
    }
    canopy_line_shape_fx(&line, N, CELLS);
    CHECK(!canopy_line_begin_fx(&line, -100, 100));
}

// Pairs of nodes beside j + 1/2 make rows that are nearly the same, cliffs make choices that come back: whatever
// ends the iteration, what comes out is safe; that it settles, gives up on a matrix and repeats itself is all met.
enum { FINE = 32 };
static CANOPY_ARENA_DECLARE(fine_arena, CANOPY_LINE_ARENA(N, FINE));

UNIT(line_is_safe_however_its_iteration_ends) {
    for (int scalar = CANOPY_F32; scalar <= CANOPY_FX; scalar++) {
        uint32_t settled = 0, singular = 0, repeated = 0;
        for (uint32_t seed = 1; seed <= 600; seed++) {
            struct canopy_arena cut;
            struct canopy_line line;
            CHECK_EQ(canopy_arena_open(&cut, fine_arena, sizeof fine_arena, sizeof fine_arena), CANOPY_OK);
            canopy_line_init(&line, N, FINE, &cut);
            uint32_t random = seed;
            for (size_t k = 0; k < CANOPY_LINE_NODES(N, FINE); k++) {
                const size_t place = k % FINE;
                const bool beside = place + 1 == FINE / 2 || place == FINE / 2;
                const bool here = seed % 2 == 0 ? beside : next_random(&random) % 8 == 0;
                const int32_t height = (int32_t)(next_random(&random) % 100000);
                line.nodes[k] = here ? (next_random(&random) % 2 == 0 ? height : height / 1000) : CANOPY_NO_HEIGHT;
            }
            int32_t b[N];
            const int32_t limit = seed % 3 == 0 ? 200000 : 1 << 28;  // the data's range, once more either way; or none
            fit_line_within(&line, (enum canopy_scalar)scalar, FINE, limit, b);
            CHECK(is_above(b, FINE, line.nodes));
            CHECK(line.solves <= CANOPY_LINE_SOLVES);
            settled += line.settled;
            singular += line.singular;
            repeated += !line.settled && !line.singular && line.solves < CANOPY_LINE_SOLVES;
        }
        CHECK(settled > 0);
        CHECK(singular > 0);
        CHECK(repeated > 0);
    }
}

UNIT(line_is_safe_wherever_it_is_stopped) {
    for (uint32_t seed = 1; seed <= 60; seed++) {
        for (int stop = 0; stop < 6; stop++) {
            struct canopy_line line = line_of();
            uint32_t random = seed;
            for (size_t k = 0; k < CANOPY_LINE_NODES(N, CELLS); k++) {
                line.nodes[k] = (int32_t)(next_random(&random) % 100000);
            }
            canopy_line_shape_fx(&line, N, CELLS);
            CHECK(canopy_line_begin_fx(&line, -1000000, 1000000));
            for (int i = 0; i < stop && canopy_line_iterate_fx(&line); i++) {}
            int32_t b[N];
            canopy_line_finish_fx(&line, b);
            CHECK(is_above(b, CELLS, line.nodes));
        }
    }
}

UNIT(lift_looks_at_vertices_and_clears_every_node) {
    for (uint32_t seed = 1; seed <= 300; seed++) {
        int32_t nodes[CANOPY_LINE_NODES(N, CELLS)], b[N];
        uint16_t vertices[CANOPY_LINE_NODES(N, CELLS)];
        uint32_t random = seed;
        for (size_t k = 0; k < CANOPY_LINE_NODES(N, CELLS); k++) {
            nodes[k] = next_random(&random) % 3 == 0 ? CANOPY_NO_HEIGHT : (int32_t)(next_random(&random) % 1000);
        }
        for (int j = 0; j < N; j++) {
            b[j] = (int32_t)(next_random(&random) % 1000);
        }
        const uint16_t count = canopy_line_hull(nodes, N, CELLS, vertices);
        (void)canopy_line_lift(b, N, CELLS, nodes, vertices, count);
        CHECK(is_above(b, CELLS, nodes));
        CHECK_EQ(canopy_line_lift(b, N, CELLS, nodes, vertices, count), 0);
    }
}

// ---- Surface and certificate

static void fill(struct canopy_field *field, uint32_t seed, int points) {
    uint32_t random = seed;
    for (int i = 0; i < points; i++) {
        const int32_t p[3] = {(int32_t)(next_random(&random) % 1001), (int32_t)(next_random(&random) % 1001),
                              (int32_t)(next_random(&random) % 101)};
        struct canopy_field_hit hit;
        CHECK_EQ(canopy_field_insert_fx(field, p, &hit), CANOPY_OK);
    }
}

static void fit_surface(const struct canopy_field *field, enum canopy_scalar scalar, uint16_t lines, int32_t *b) {
    struct canopy_fast fast;
    CHECK_EQ(canopy_fast_init(&fast, field, canopy_line_fit_of(scalar), lines, fast_arena, sizeof fast_arena),
             CANOPY_OK);
    CHECK_EQ(canopy_fast_begin(&fast, b), CANOPY_OK);
    while (canopy_fast_step(&fast, 1) == CANOPY_MORE) {}
}

static enum canopy_status certify_surface(struct canopy_certify *certify, const struct canopy_field *field,
                                          const int32_t *b) {
    CHECK_EQ(canopy_certify_init(certify, field, certify_arena, sizeof certify_arena), CANOPY_OK);
    canopy_certify_begin(certify, b);
    enum canopy_status status;
    while ((status = canopy_certify_step(certify, 1)) == CANOPY_MORE) {}
    return status;
}

// The surface, in double; a second way to the same number than the library's.
static double height_at(const int32_t *b, double u, double v) {
    const int h = u < M - 1 ? (int)u : M - 2, w = v < N - 1 ? (int)v : N - 2;
    double sum = 0;
    for (int i = h - 1; i <= h + 2; i++) {
        for (int j = w - 1; j <= w + 2; j++) {
            const int ci = i < 0 ? 0 : i < M ? i : M - 1, cj = j < 0 ? 0 : j < N ? j : N - 1;
            const double x = fabs(u - i), y = fabs(v - j);
            const double p = x < 1 ? 4 - 6 * x * x + 3 * x * x * x : (2 - x) * (2 - x) * (2 - x);
            const double q = y < 1 ? 4 - 6 * y * y + 3 * y * y * y : (2 - y) * (2 - y) * (2 - y);
            sum += p * q / 36 * b[ci * N + cj];
        }
    }
    return sum;
}

// Places of a cell along each axis; where a double costs hundreds of instructions the corners alone.
#ifdef __ARM_ARCH_6M__
enum { PLACES = 2 };
#else
enum { PLACES = 4 };
#endif

// The least of surface minus height over these places of every covered cell, rounded up to 1/1000.
static double lowest_excess(const struct canopy_field *field, const int32_t *b) {
    double lowest = 1e30;
    for (uint32_t cell = 0; cell < field->axis[0].count * field->axis[1].count; cell++) {
        const uint32_t row = cell / field->axis[1].count, column = cell % field->axis[1].count;
        for (int k = 0; k < PLACES * PLACES && field->heights[cell] != CANOPY_NO_HEIGHT; k++) {
            const double u = (row + k % PLACES / (PLACES - 1.0)) / CELLS;
            const double v = (column + k / PLACES / (PLACES - 1.0)) / CELLS;
            lowest = fmin(lowest, height_at(b, u, v) - field->heights[cell] + 0.001);
        }
    }
    return lowest;
}

UNIT(surface_is_certified_in_both_scalars) {
    for (uint32_t seed = 1; seed <= 40; seed++) {
        const struct canopy_frame frame = frame_of(seed % 2, 1000, 1000, 100);
        struct canopy_field field = field_in(&frame);
        fill(&field, seed, (int)(seed * seed));
        for (uint16_t lines = 1; lines <= CELLS; lines = (uint16_t)(lines * 2)) {
            int32_t b[M * N];
            struct canopy_certify certify;
            fit_surface(&field, seed % 3 == 0 ? CANOPY_F32 : CANOPY_FX, lines, b);
            CHECK_EQ(certify_surface(&certify, &field, b), CANOPY_OK);
            CHECK(certify.margin >= 0);
        }
    }
}

UNIT(certificate_notices_what_is_too_low) {
    for (uint32_t seed = 1; seed <= 20; seed++) {
        const struct canopy_frame frame = frame_of(CANOPY_ABOVE, 1000, 1000, 100);
        struct canopy_field field = field_in(&frame);
        fill(&field, seed, 300);
        int32_t b[M * N];
        struct canopy_certify certify;
        fit_surface(&field, CANOPY_FX, 1, b);
        CHECK_EQ(certify_surface(&certify, &field, b), CANOPY_OK);
        // the margin may be the cheaper bound's, so lower and lower until the other one refuses, too
        for (int32_t by = certify.margin + 1; certify_surface(&certify, &field, b) == CANOPY_OK; by *= 2) {
            CHECK(seed > PLACES / 2 || lowest_excess(&field, b) >= 0);  // slow on a device, and there the fewer
            for (int i = 0; i < M * N; i++) {
                b[i] -= by;
            }
        }
        CHECK(certify.missing > 0);
        // and a raise there mends it, for the row and for the cell alone
        const uint32_t cell = certify.failed_cell;
        CHECK_EQ(canopy_certify_cell(&certify, cell), CANOPY_NOT_SAFE);
        CHECK_EQ(canopy_fast_raise(&field, b, cell, certify.missing), CANOPY_OK);
        CHECK_EQ(canopy_certify_cell(&certify, cell), CANOPY_OK);
    }
}

// A bowl: every line is convex, where the bound of Lemma 5.1 leaves out all there is.
UNIT(certificate_follows_convex_bends) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE, 1000, 1000, 100);
    int32_t b[M * N];
    for (int i = 0; i < M * N; i++) {
        const int u = 2 * (i / N) - (M - 1), v = 2 * (i % N) - (N - 1);
        b[i] = 300000 * (u * u + v * v);
    }
    struct canopy_field field = field_in(&frame);
    struct canopy_certify certify;
    CHECK_EQ(canopy_certify_init(&certify, &field, certify_arena, sizeof certify_arena), CANOPY_OK);
    canopy_certify_begin(&certify, b);
    double lost = 0;
    for (uint32_t cell = 0; cell < field.axis[0].count * field.axis[1].count; cell++) {
        int32_t *height = &field.heights[cell];
        *height = CANOPY_HEIGHT_LIMIT;
        CHECK_EQ(canopy_certify_cell(&certify, cell), CANOPY_NOT_SAFE);
        *height -= certify.missing;  // the highest that is proved
        CHECK_EQ(canopy_certify_cell(&certify, cell), CANOPY_OK);
        const double excess = lowest_excess(&field, b);
        CHECK(excess >= 0);
        lost = fmax(lost, excess);
        *height = CANOPY_NO_HEIGHT;
    }
    CHECK(lost < 300000);  // l alone loses a sixth of each bend: 2 x 2400000 / 6
}

UNIT(raising_mends_any_surface_in_one_pass) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE, 1000, 1000, 100);
    struct canopy_field field = field_in(&frame);
    fill(&field, 77, 200);
    int32_t b[M * N] = {0};
    struct canopy_certify certify;
    CHECK_EQ(canopy_certify_init(&certify, &field, certify_arena, sizeof certify_arena), CANOPY_OK);
    canopy_certify_begin(&certify, b);
    enum canopy_status status;
    int raises = 0;
    while ((status = canopy_certify_step(&certify, 1)) != CANOPY_OK) {
        if (status == CANOPY_NOT_SAFE) {
            CHECK_EQ(canopy_fast_raise(&field, b, certify.failed_cell, certify.missing), CANOPY_OK);
            CHECK(++raises < 10000);
        }
    }
    CHECK_EQ(certify_surface(&certify, &field, b), CANOPY_OK);
}

UNIT(certificate_refuses_an_approximate_field) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE, 1000, 1000, 100);
    struct canopy_field field = field_in(&frame);
    field.exact = false;
    struct canopy_certify certify;
    CHECK_EQ(canopy_certify_init(&certify, &field, certify_arena, sizeof certify_arena), CANOPY_ARGUMENT);
}

UNIT(certificate_refuses_what_its_numbers_cannot_hold) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE, 1000, 1000, 100);
    struct canopy_field field = field_in(&frame);
    static const int32_t point[1][3] = {{500, 500, 50}};
    CHECK_EQ(canopy_field_feed_fx(&field, point, 1), 0);
    struct canopy_certify certify;
    CHECK_EQ(canopy_certify_init(&certify, &field, certify_arena, sizeof certify_arena), CANOPY_OK);
    int32_t b[M * N];
    for (int i = 0; i < M * N; i++) {
        b[i] = CANOPY_COEFFICIENT_LIMIT;
    }
    canopy_certify_begin(&certify, b);
    CHECK_EQ(canopy_certify_step(&certify, UINT32_MAX), CANOPY_OK);
    for (int i = 0; i < M * N; i += M * N - 1) {
        for (int sign = -1; sign <= 1; sign += 2) {
            b[i] = sign * (CANOPY_COEFFICIENT_LIMIT + 1);
            canopy_certify_begin(&certify, b);
            CHECK_EQ(canopy_certify_step(&certify, UINT32_MAX), CANOPY_RANGE);
            CHECK_EQ(canopy_certify_cell(&certify, 0), CANOPY_RANGE);
            b[i] = CANOPY_COEFFICIENT_LIMIT;
        }
    }
}

UNIT(surface_says_what_is_wrong_with_its_arguments) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE, 1000, 1000, 100);
    struct canopy_field field = field_in(&frame);
    struct canopy_fast fast;
    int32_t b[M * N];
    char *bytes = (char *)fast_arena;
    CHECK_EQ(canopy_fast_init(&fast, &field, &canopy_line_fit_fx, 3, bytes, sizeof fast_arena), CANOPY_ARGUMENT);
    CHECK_EQ(canopy_fast_init(&fast, &field, NULL, 1, bytes, sizeof fast_arena), CANOPY_ARGUMENT);
    CHECK_EQ(canopy_fast_init(&fast, &field, &canopy_line_fit_fx, 0, bytes, sizeof fast_arena), CANOPY_ARGUMENT);
    CHECK_EQ(canopy_fast_init(&fast, &field, &canopy_line_fit_fx, CELLS, bytes, sizeof fast_arena - 8),
             CANOPY_ARENA_SHORT);
    CHECK_EQ(canopy_fast_init(&fast, &field, &canopy_line_fit_fx, CELLS, bytes + 1, sizeof fast_arena),
             CANOPY_ARENA_ALIGN);
    CHECK_EQ(canopy_fast_init(&fast, &field, &canopy_line_fit_fx, CELLS, bytes, sizeof fast_arena), CANOPY_OK);
    CHECK_EQ(canopy_fast_begin(&fast, b), CANOPY_EMPTY);
}

UNIT(raise_keeps_within_the_format) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE, 1000, 1000, 100);
    struct canopy_field field = field_in(&frame);
    int32_t b[M * N] = {0};
    CHECK_EQ(canopy_fast_raise(&field, b, 0, CANOPY_COEFFICIENT_LIMIT), CANOPY_OK);
    CHECK_EQ(canopy_fast_raise(&field, b, 0, 1), CANOPY_RANGE);
    CHECK_EQ(b[0], CANOPY_COEFFICIENT_LIMIT);
    CHECK_EQ(b[M * N - 1], 0);
}

UNIT(envelope_bounds_its_height) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE, 1000, 1000, 100);
    int32_t b[M * N];
    uint8_t coverage[CANOPY_COVERAGE_BYTES(M, N)] = {0};
    for (int i = 0; i < M * N; i++) {
        b[i] = 12345;
    }
    const struct canopy_envelope envelope = {.frame = frame, .coefficients = b, .coverage = coverage};
    int32_t low = 0, high = 0;
    CHECK_EQ(canopy_envelope_height(&envelope, 333, 777, &low, &high), CANOPY_OK);
    CHECK(low <= 12345 && high >= 12345 && high - low <= 24);
    CHECK_EQ(canopy_envelope_height(&envelope, (uint32_t)canopy_frame_width(&frame, 0) + 1, 0, &low, &high),
             CANOPY_OUT_OF_FRAME);
}

UNIT_LIST(cover, frame_is_the_smallest_that_holds_the_box, frame_of_a_flat_scene_has_room_for_heights,
          frame_takes_the_whole_range_of_coordinates, frame_refuses_what_is_no_grid_or_box,
          frame_in_float_has_exact_edges, frame_in_float_holds_its_corners, field_asks_for_its_arena,
          field_finds_the_cell_of_every_point, field_fed_finds_the_cell_at_every_edge,
          field_finds_cells_over_the_whole_range, field_keeps_the_highest_and_says_so, field_below_keeps_the_lowest,
          field_refuses_heights_it_cannot_hold, field_rounds_heights_up_where_a_step_is_more_than_a_quantum,
          field_takes_any_step, field_in_float_agrees_with_exact_edges, field_in_float_lowers_no_point,
          fields_merge_by_maximum, coverage_is_one_bit_a_knot_cell, line_is_above_every_node_in_both_scalars,
          line_through_a_straight_slope_is_that_slope, line_without_data_says_so,
          line_is_safe_however_its_iteration_ends, line_is_safe_wherever_it_is_stopped,
          lift_looks_at_vertices_and_clears_every_node, surface_is_certified_in_both_scalars,
          certificate_notices_what_is_too_low, certificate_follows_convex_bends, raising_mends_any_surface_in_one_pass,
          certificate_refuses_an_approximate_field, certificate_refuses_what_its_numbers_cannot_hold,
          surface_says_what_is_wrong_with_its_arguments, raise_keeps_within_the_format, envelope_bounds_its_height)
