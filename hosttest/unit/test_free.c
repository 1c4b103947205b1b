// Two kinds of free: rows of a line without a node, which still shape the surface, and coefficients that nothing
// covered can see, which may be anything. Many random fields in exact arithmetic: hosttest/test_trim_properties.c.

#include "hosttest/unit/unit.h"
#include "lib/arena.h"
#include "lib/cover/certify.h"
#include "lib/cover/envelope.h"
#include "lib/cover/fast.h"
#include "lib/cover/free.h"
#include "lib/num/bits.h"
#include "lib/spline/surface.h"

enum { M = 9, N = 8, COUNT = M * N };

static const uint16_t size[2] = {M, N};
static uint8_t seen[CANOPY_FREE_SEEN_BYTES(M, N)];
static int32_t b[COUNT];

static uint32_t next_random(uint32_t *state) {
    *state = *state * 1664525U + 1013904223U;
    return *state >> 8;
}

static void mark(uint32_t i, uint32_t j) { (void)canopy_bit_set(seen, i * N + j); }

static bool is_marked(uint32_t i, uint32_t j) { return canopy_bit_get(seen, i * N + j); }

static void relax(struct canopy_free *work) {
    while (canopy_free_step(work, 1) == CANOPY_MORE) {}
}

// ---- Free rows: the paper's Figure 4

// A line over one value at each integer, of which those at `from` … `from + gap - 1` are missing.
static uint8_t fit_with_gap(enum canopy_scalar scalar, uint32_t from, uint32_t gap, int32_t *coefficients) {
    static CANOPY_ARENA_DECLARE(arena, CANOPY_LINE_ARENA(N, 1));
    static const int32_t values[N] = {90000, 40000, 70000, 10000, 60000, 20000, 80000, 30000};
    struct canopy_arena cut;
    struct canopy_line line;
    CHECK_EQ(canopy_arena_open(&cut, arena, sizeof arena, sizeof arena), CANOPY_OK);
    canopy_line_init(&line, N, 1, &cut);
    memcpy(line.nodes, values, sizeof values);
    for (uint32_t j = from; j < from + gap; j++) {
        line.nodes[j] = CANOPY_NO_HEIGHT;
    }
    const struct canopy_line_fit *fit = canopy_line_fit_of(scalar);
    fit->shape(&line, N, 1);
    CHECK(fit->begin(&line, -1000000, 1000000));
    while (fit->iterate(&line)) {}
    fit->finish(&line, coefficients);
    CHECK(line.settled && !line.singular);
    return line.solves;
}

UNIT(free_rows_have_no_second_difference_and_cost_nothing) {
    for (int scalar = CANOPY_F32; scalar <= CANOPY_FX; scalar++) {
        int32_t c[N];
        const uint8_t solves = fit_with_gap((enum canopy_scalar)scalar, 0, 0, c);
        for (uint32_t gap = 1; gap <= 3; gap++) {
            for (uint32_t from = 1; from + gap < N; from++) {
                CHECK(fit_with_gap((enum canopy_scalar)scalar, from, gap, c) <= solves + 1);
                for (uint32_t j = from; j < from + gap; j++) {
                    CHECK_NEAR(c[j - 1] - 2 * c[j] + c[j + 1], 0, 8);
                }
            }
            (void)fit_with_gap((enum canopy_scalar)scalar, N - gap, gap, c);  // beyond the last datum: a constant
            for (uint32_t j = N - gap; j < N; j++) {
                CHECK_NEAR(c[j], c[N - gap - 1], 8);
            }
        }
    }
}

// A free row's coefficient is not at will: the surface over covered cells follows it.
UNIT(a_free_row_still_shapes_what_is_covered) {
    int32_t c[N];
    (void)fit_with_gap(CANOPY_FX, 3, 1, c);
    int32_t grid[4 * N];
    const uint16_t small[2] = {4, N};
    for (int k = 0; k < 4 * N; k++) {
        grid[k] = c[k % N];
    }
    const struct canopy_place u = {1, 0}, v = {2, 0};  // at the datum beside the gap
    const int32_t before = canopy_surface_fx(grid, small, &u, &v, NULL);
    for (int i = 0; i < 4; i++) {
        grid[i * N + 3] += 6000;
    }
    CHECK_NEAR(canopy_surface_fx(grid, small, &u, &v, NULL) - before, 1000, 2);
}

// ---- Free coefficients: which they are

static bool is_near(uint32_t i, uint32_t j, uint32_t h, uint32_t w) {
    return i + 1 >= h && i <= h + 2 && j + 1 >= w && j <= w + 2;
}

UNIT(a_cell_sees_the_coefficients_that_shape_it) {
    memset(seen, 0xFF, sizeof seen);  // what was marked before does not matter
    for (uint32_t h = 0; h + 1 < M; h++) {
        for (uint32_t w = 0; w + 1 < N; w++) {
            uint8_t coverage[CANOPY_COVERAGE_BYTES(M, N)] = {0};
            (void)canopy_bit_set(coverage, h * (N - 1) + w);
            (void)canopy_bit_set(coverage, 7 * (N - 1) + 2);
            canopy_free_see(size, coverage, seen);
            for (uint32_t i = 0; i < M; i++) {
                for (uint32_t j = 0; j < N; j++) {
                    CHECK_EQ(is_marked(i, j), is_near(i, j, h, w) || is_near(i, j, 7, 2));
                }
            }
        }
    }
}

// ---- What they are set to

UNIT(nothing_seen_changes_nothing) {
    struct canopy_free work;
    memset(seen, 0, sizeof seen);
    b[5] = 77;
    CHECK_EQ(canopy_free_begin(&work, size, seen, b), CANOPY_EMPTY);
    CHECK_EQ(b[5], 77);
}

UNIT(nearest_is_that_of_the_column_then_that_of_the_nearest_column) {
    struct canopy_free work;
    memset(seen, 0, sizeof seen);
    for (uint32_t k = 0; k < COUNT; k++) {
        b[k] = -1;
    }
    mark(2, 3);
    mark(7, 3);
    mark(0, 6);
    b[2 * N + 3] = 200;
    b[7 * N + 3] = 700;
    b[6] = 60;
    CHECK_EQ(canopy_free_begin(&work, size, seen, b), CANOPY_OK);
    for (uint32_t i = 0; i < M; i++) {
        for (uint32_t j = 0; j < N; j++) {
            CHECK_EQ(b[i * N + j], j > 4 ? 60 : i <= 4 ? 200 : 700);  // of two as near, the lower index
        }
    }
    CHECK_EQ(canopy_free_step(&work, 1), CANOPY_OK);
}

UNIT(straight_is_a_line_over_a_gap_and_a_constant_beyond) {
    for (int along = 0; along < 2; along++) {
        struct canopy_free work;
        memset(seen, 0, sizeof seen);
        for (uint32_t i = 0; i < M; i++) {
            for (uint32_t j = 0; j < N; j++) {
                const uint32_t k = along == 0 ? i : j;
                b[i * N + j] = k == 1 ? 100000 : k == 5 ? 500000 : 12345678;
                if (k == 1 || k == 5) {
                    mark(i, j);
                }
            }
        }
        CHECK_EQ(canopy_free_begin(&work, size, seen, b), CANOPY_OK);
        canopy_free_straighten(&work);
        relax(&work);
        CHECK(work.sweeps < CANOPY_FREE_SWEEPS);
        for (uint32_t i = 0; i < M; i++) {
            for (uint32_t j = 0; j < N; j++) {
                const int32_t k = (int32_t)(along == 0 ? i : j), inside = k < 1 ? 1 : k > 5 ? 5 : k;
                CHECK_NEAR(b[i * N + j], 100000 * inside, 4000);  // to 1 % of the reach
            }
        }
    }
}

// A plane is without bending; over a hole the energy finds it again, and so do second differences. A slope that would
// go on beyond the reach does not.
UNIT(bent_goes_on_over_a_hole_and_stops_at_the_reach) {
    struct canopy_free work;
    memset(seen, 0, sizeof seen);
    for (uint32_t i = 0; i < M; i++) {
        for (uint32_t j = 0; j < N; j++) {
            b[i * N + j] = (int32_t)(i * 10000 + j * 20000);
            if (i < 2 || i > 4 || j < 3 || j > 5) {
                mark(i, j);
            } else {
                b[i * N + j] = -99999999;
            }
        }
    }
    CHECK_EQ(canopy_free_begin(&work, size, seen, b), CANOPY_OK);
    canopy_free_straighten(&work);
    relax(&work);
    canopy_free_bend(&work);
    relax(&work);
    CHECK(work.sweeps < CANOPY_FREE_BENT_SWEEPS);
    for (uint32_t i = 0; i < M; i++) {
        for (uint32_t j = 0; j < N; j++) {
            CHECK_NEAR(b[i * N + j], i * 10000 + j * 20000, 200);
        }
    }
    for (uint32_t k = 4 * N; k < COUNT; k++) {
        canopy_bit_clear(seen, k);
    }
    CHECK_EQ(canopy_free_begin(&work, size, seen, b), CANOPY_OK);
    canopy_free_bend(&work);
    relax(&work);
    int32_t highest = 0;
    for (uint32_t k = 0; k < COUNT; k++) {
        highest = b[k] > highest ? b[k] : highest;
    }
    CHECK_EQ(highest, 3 * 10000 + (N - 1) * 20000);
    CHECK(b[5 * N] > b[3 * N] + 10000);
}

// Any marks, any values: what is seen stays, the rest is within the reach after every step, and it ends.
UNIT(free_coefficients_stay_within_the_reach) {
    uint32_t random = 7;
    for (int round = 0; round < 40; round++) {
        struct canopy_free work;
        int32_t before[COUNT], low = INT32_MAX, high = INT32_MIN;
        memset(seen, 0, sizeof seen);
        for (uint32_t k = 0; k < COUNT; k++) {
            b[k] = (int32_t)(next_random(&random) % (1U << 24)) * 32 - (1 << 28);  // the whole format
            if (next_random(&random) % 5 == 0 || k == 3) {
                (void)canopy_bit_set(seen, k);
                low = b[k] < low ? b[k] : low;
                high = b[k] > high ? b[k] : high;
            }
        }
        memcpy(before, b, sizeof b);
        CHECK_EQ(canopy_free_begin(&work, size, seen, b), CANOPY_OK);
        for (int rule = 0; rule < 3; rule++) {
            if (rule == 1) {
                canopy_free_straighten(&work);
            } else if (rule == 2) {
                canopy_free_bend(&work);
            }
            enum canopy_status status;
            do {
                status = canopy_free_step(&work, 1);
                for (uint32_t k = 0; k < COUNT; k++) {
                    CHECK(b[k] >= low && b[k] <= high);
                    CHECK(!canopy_bit_get(seen, k) || b[k] == before[k]);
                }
            } while (status == CANOPY_MORE);
            CHECK_EQ(status, CANOPY_OK);
        }
    }
}

// ---- In the fast method

enum { CELLS = 2 };
static CANOPY_ARENA_DECLARE(field_arena, CANOPY_FIELD_ARENA(M, N, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(fast_arena, CANOPY_FAST_ARENA(M, N, CELLS, 1));
static CANOPY_ARENA_DECLARE(certify_arena, CANOPY_CERTIFY_ARENA(N, CELLS, CELLS));

static void fit_corner(struct canopy_field *field, struct canopy_fast *fast) {
    static const uint16_t cells[2] = {CELLS, CELLS};
    const struct canopy_grid grid = {{M, N}, CELLS, CANOPY_ABOVE};
    const int32_t low[3] = {0, 0, 0}, high[3] = {800, 700, 1000};
    struct canopy_frame frame;
    CHECK_EQ(canopy_frame_around_fx(&frame, &grid, low, high), CANOPY_OK);
    CHECK_EQ(canopy_field_init(field, &frame, cells, field_arena, sizeof field_arena), CANOPY_OK);
    uint32_t random = 3;
    for (int k = 0; k < 60; k++) {  // in one corner of 3 x 2 knot cells
        const int32_t point[1][3] = {{(int32_t)(next_random(&random) % 300), (int32_t)(next_random(&random) % 200),
                                      (int32_t)(next_random(&random) % 1000)}};
        CHECK_EQ(canopy_field_feed_fx(field, point, 1), 0);
    }
    CHECK_EQ(canopy_fast_init(fast, field, &canopy_line_fit_fx, 1, fast_arena, sizeof fast_arena), CANOPY_OK);
    CHECK_EQ(canopy_fast_begin(fast, b), CANOPY_OK);
}

UNIT(free_coefficients_influence_no_covered_cell) {
    struct canopy_field field;
    struct canopy_fast fast;
    struct canopy_certify certify;
    fit_corner(&field, &fast);
    while (canopy_fast_step(&fast, 1) == CANOPY_MORE) {}
    CHECK_EQ(canopy_fast_step(&fast, 0), CANOPY_OK);
    CHECK_EQ(canopy_certify_init(&certify, &field, certify_arena, sizeof certify_arena), CANOPY_OK);
    canopy_certify_begin(&certify, b);
    CHECK_EQ(canopy_certify_step(&certify, UINT32_MAX), CANOPY_OK);
    const int32_t margin = certify.margin;
    uint8_t coverage[CANOPY_COVERAGE_BYTES(M, N)];
    CHECK_EQ(canopy_field_coverage(&field, coverage), 6);
    canopy_free_see(size, coverage, seen);
    int32_t low = INT32_MAX, high = INT32_MIN, changed[COUNT];
    for (uint32_t k = 0; k < COUNT; k++) {
        if (canopy_bit_get(seen, k)) {
            low = b[k] < low ? b[k] : low;
            high = b[k] > high ? b[k] : high;
        }
        changed[k] = canopy_bit_get(seen, k) ? b[k] : (k % 2 == 0 ? 1 : -1) * CANOPY_COEFFICIENT_LIMIT;
    }
    for (uint32_t k = 0; k < COUNT; k++) {
        CHECK(b[k] >= low && b[k] <= high);
    }
    canopy_certify_begin(&certify, changed);
    CHECK_EQ(canopy_certify_step(&certify, UINT32_MAX), CANOPY_OK);
    CHECK_EQ(certify.margin, margin);
    uint32_t random = 11;
    for (int k = 0; k < 500; k++) {
        const struct canopy_place u = {next_random(&random) % 3, (int32_t)(next_random(&random) << 6)};
        const struct canopy_place v = {next_random(&random) % 2, (int32_t)(next_random(&random) << 6)};
        CHECK_EQ(canopy_surface_fx(b, size, &u, &v, NULL), canopy_surface_fx(changed, size, &u, &v, NULL));
    }
}

static void check_zero(void) {
    for (uint32_t k = 0; k < COUNT; k++) {
        CHECK_EQ(b[k], 0);
        b[k] = INT32_MIN;  // what the next fit leaves alone is seen
    }
}

UNIT(a_field_cleared_under_the_fit_leaves_nothing_wild) {
    struct canopy_field field;
    struct canopy_fast fast;
    memset(b, 0, sizeof b);
    check_zero();
    fit_corner(&field, &fast);
    CHECK_EQ(canopy_fast_step(&fast, 1), CANOPY_MORE);
    canopy_field_clear(&field);
    CHECK_EQ(canopy_fast_step(&fast, UINT32_MAX), CANOPY_OK);
    check_zero();
    fit_corner(&field, &fast);
    canopy_field_clear(&field);  // after it has begun; then data where no line looks any more
    while (fast.stage == CANOPY_FAST_LINES) {
        (void)canopy_fast_step(&fast, 1);
    }
    const int32_t point[1][3] = {{790, 690, 500}};
    CHECK_EQ(canopy_field_feed_fx(&field, point, 1), 0);
    CHECK_EQ(canopy_fast_step(&fast, UINT32_MAX), CANOPY_OK);
    check_zero();
}

UNIT_LIST(free, free_rows_have_no_second_difference_and_cost_nothing, a_free_row_still_shapes_what_is_covered,
          a_cell_sees_the_coefficients_that_shape_it, nothing_seen_changes_nothing,
          nearest_is_that_of_the_column_then_that_of_the_nearest_column,
          straight_is_a_line_over_a_gap_and_a_constant_beyond, bent_goes_on_over_a_hole_and_stops_at_the_reach,
          free_coefficients_stay_within_the_reach, free_coefficients_influence_no_covered_cell,
          a_field_cleared_under_the_fit_leaves_nothing_wild)
