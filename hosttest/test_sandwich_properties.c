// Both sides over many small clouds made to hurt, both scalars: each surface is safe and the two cross nowhere in the
// frame, in exact arithmetic, by code that shares nothing with the fits (tools/common/exact, tools/common/crossing):
// the fast pair when it is done, the tight one after every step. And two surfaces that know nothing of each other do
// cross on many of these clouds, so that what is tested here is not for nothing.
//
// CANOPY_CLOUDS sets how many clouds; a failure prints the seed, CANOPY_SEED=n runs that one alone.

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "hosttest/cloud.h"
#include "hosttest/seeds.h"
#include "lib/cover/envelope.h"
#include "lib/cover/free.h"
#include "lib/cover/sandwich.h"
#include "lib/num/bits.h"
#include "tools/common/crossing.h"
#include "tools/common/exact.h"
#include "tools/common/random.h"

enum { POINTS_MAX = 100, GRID_MAX = 9, CELLS_MAX = 5, COUNT_MAX = GRID_MAX * GRID_MAX };

struct scene {
    uint64_t seed, random;
    uint32_t kind;
    enum canopy_scalar scalar;
    struct canopy_grid grid;
    uint16_t lines;
    size_t count;
    float f32[POINTS_MAX][3];
    int32_t fx[POINTS_MAX][3];
};

static double uniform(struct scene *s) { return canopy_random_unit(&s->random); }

// ---- Clouds

enum { KINDS = 12 };

// A point of the unit square, and a height.
static void make_point(struct scene *s, size_t i, double p[3]) {
    p[0] = uniform(s);
    p[1] = uniform(s);
    p[2] = uniform(s);
    const double r = hypot(p[0] - 0.5, p[1] - 0.5);
    switch (s->kind) {
    case 0: break;                                                         // scattered
    case 1: p[2] = 0.25; break;                                            // flat: the two may touch
    case 2: p[2] = 0.5 * p[0] + 0.25 * p[1]; break;                        // all on one plane
    case 3: p[2] = p[1] < 0.47 ? 0 : 1; break;                             // cliff
    case 4: p[2] = r < 0.35 ? sqrt(0.1225 - r * r) + 0.5 : 0; break;       // ball on a floor: steep silhouette
    case 5: p[0] = p[0] < 0.5 ? 0.2 * p[0] : 1 - 0.1 * (1 - p[0]); break;  // a hole in the middle
    case 6: p[0] = p[1] = 0.5; break;                                      // one column
    case 7: p[1] = 0.3 + 0.5 * p[0]; break;                                // on one line
    case 8: p[2] = i % 2 == 0 ? 0 : 1; break;                              // two floors
    case 9: p[2] = (p[0] - 0.5) * (p[1] - 0.5) * 40; break;                // saddle
    case 10: p[2] = canopy_random_chance(&s->random, 0.1) ? 1 - 2 * p[2] : 0; break;  // spikes both ways
    default:                                                                          // on knots
        for (int a = 0; a < 2; a++) {
            p[a] = rint(p[a] * (s->grid.size[a] - 1)) / (s->grid.size[a] - 1);
        }
        break;
    }
}

// To device units: plain, extreme aspect, an offset that eats the mantissa, full scale, tiny; some points twice, with
// another height.
static void place_points(struct scene *s) {
    static const double SCALES[][3] = {{1000, 1000, 300}, {1e6, 3, 300},   {20, 1000, 1e6},
                                       {1000, 1000, 300}, {4e9, 4e9, 4e9}, {7, 7, 7}};
    static const double OFFSETS[][3] = {{0, 0, 0},          {0, 0, 0}, {0, 0, 0}, {16777216, -16777000, 8388608},
                                        {-2e9, -2e9, -2e9}, {0, 0, 0}};
    const uint32_t how = canopy_random_below(&s->random, 6);
    const bool doubled = canopy_random_chance(&s->random, 0.3);
    const double tiny =
        s->scalar == CANOPY_F32 && uniform(s) < 0.3 ? ldexp(1, (int)canopy_random_below(&s->random, 160) - 100) : 1;
    double p[3] = {0, 0, 0};
    for (size_t i = 0; i < s->count; i++) {
        if (doubled && i % 2 == 1) {
            p[2] = uniform(s);
        } else {
            make_point(s, i, p);
        }
        for (int a = 0; a < 3; a++) {
            const double q = tiny * (OFFSETS[how][a] + SCALES[how][a] * p[a]);
            s->f32[i][a] = (float)q;
            s->fx[i][a] = (int32_t)fmax(-2147483648.0, fmin(2147483647.0, rint(q)));
        }
    }
}

static struct scene make_scene(uint64_t seed) {
    struct scene s = {.seed = seed, .random = seed};
    s.grid.size[0] = (uint16_t)(4 + canopy_random_below(&s.random, GRID_MAX - 3));
    s.grid.size[1] = (uint16_t)(4 + canopy_random_below(&s.random, GRID_MAX - 3));
    s.grid.cells = (uint16_t)(1 + canopy_random_below(&s.random, CELLS_MAX));
    s.lines = canopy_random_chance(&s.random, 0.5) ? 1 : s.grid.cells;
    s.scalar = canopy_random_below(&s.random, 2) == 0 ? CANOPY_F32 : CANOPY_FX;
    s.kind = canopy_random_below(&s.random, KINDS);
    s.count = 1 + canopy_random_below(&s.random, canopy_random_chance(&s.random, 0.2) ? 4 : POINTS_MAX);
    place_points(&s);
    return s;
}

static struct canopy_frame frame_of(const struct scene *s, enum canopy_side side) {
    struct canopy_grid grid = s->grid;
    struct canopy_frame frame;
    grid.side = (uint8_t)side;
    assert_int_equal(
        cloud_frame(s->scalar, &grid, (const float(*)[3])s->f32, (const int32_t(*)[3])s->fx, s->count, &frame),
        CANOPY_OK);
    return frame;
}

// ---- What is under test

#define FIELD_BYTES CANOPY_FIELD_ARENA(GRID_MAX, GRID_MAX, CELLS_MAX, CELLS_MAX)
static CANOPY_ARENA_DECLARE(above_arena, FIELD_BYTES);
static CANOPY_ARENA_DECLARE(below_arena, FIELD_BYTES);
static CANOPY_ARENA_DECLARE(sandwich_arena, CANOPY_SANDWICH_ARENA(GRID_MAX, GRID_MAX, CELLS_MAX, CELLS_MAX, CELLS_MAX));
#define ROWS_MAX CANOPY_TIGHTEN_ROWS(GRID_MAX, GRID_MAX)
static CANOPY_ARENA_DECLARE(tighten_arena,
                            CANOPY_TIGHTEN_ARENA(GRID_MAX, GRID_MAX, CELLS_MAX, CELLS_MAX, POINTS_MAX, ROWS_MAX));
static CANOPY_ARENA_DECLARE(certify_arena, CANOPY_CERTIFY_ARENA(GRID_MAX, CELLS_MAX, CELLS_MAX));

struct subject {
    struct canopy_field field[2];
    struct canopy_sandwich sandwich;
    struct canopy_certify certify;
    int32_t b[2][COUNT_MAX], mirror[COUNT_MAX];
};

static size_t count_of(const struct subject *x) {
    return (size_t)x->field[0].frame.size[0] * x->field[0].frame.size[1];
}

static void fill_fields(const struct scene *s, struct subject *x) {
    const uint16_t cells[2] = {s->grid.cells, s->grid.cells};
    uint64_t *const arenas[2] = {above_arena, below_arena};
    for (int side = 0; side < 2; side++) {
        const struct canopy_frame frame = frame_of(s, (enum canopy_side)side);
        assert_int_equal(canopy_field_init(&x->field[side], &frame, cells, arenas[side], FIELD_BYTES), CANOPY_OK);
    }
    assert_int_equal(s->scalar == CANOPY_F32
                         ? canopy_sandwich_feed_f32(&x->field[0], &x->field[1], (const float(*)[3])s->f32, s->count)
                         : canopy_sandwich_feed_fx(&x->field[0], &x->field[1], (const int32_t(*)[3])s->fx, s->count),
                     0);
}

static void fit_fast(struct scene *s, struct subject *x) {
    struct canopy_sandwich *w = &x->sandwich;
    fill_fields(s, x);
    assert_int_equal(canopy_sandwich_init(w, &x->field[0], &x->field[1], canopy_line_fit_of(s->scalar), s->lines,
                                          sandwich_arena, sizeof sandwich_arena),
                     CANOPY_OK);
    assert_int_equal(canopy_sandwich_begin(w, x->b[0], x->b[1]), CANOPY_OK);
    enum canopy_status status;
    while ((status = canopy_sandwich_step(w, 1 + canopy_random_below(&s->random, 9))) == CANOPY_MORE) {}
    assert_int_equal(status, CANOPY_OK);
}

// ---- The referees

// The side as it would be published.
static struct canopy_surrogate publish(const struct scene *s, const struct subject *x, int side, const int32_t *b,
                                       double *coefficients) {
    const struct canopy_frame *frame = &x->field[side].frame;
    return cloud_surrogate(frame, s->scalar, b, cloud_mirror(frame), coefficients);
}

static struct canopy_crossing cross(const struct scene *s, const struct subject *x, const int32_t *upper,
                                    const int32_t *lower) {
    double coefficients[2][COUNT_MAX];
    const struct canopy_surrogate above = publish(s, x, CANOPY_ABOVE, upper, coefficients[0]);
    const struct canopy_surrogate below = publish(s, x, CANOPY_BELOW, lower, coefficients[1]);
    struct canopy_crossing crossing;
    struct canopy_fault fault;
    assert_true(canopy_crossing_find(&above, &below, &crossing, &fault));
    return crossing;
}

// Fails if a point is on the wrong side; returns the least margin in steps.
static double judge(const struct scene *s, const struct subject *x, int side) {
    double coefficients[COUNT_MAX];
    const struct canopy_surrogate surrogate = publish(s, x, side, x->b[side], coefficients);
    const struct canopy_cloud cloud =
        cloud_of(s->scalar, (const float(*)[3])s->f32, (const int32_t(*)[3])s->fx, s->count);
    struct canopy_exact_result result;
    assert_true(canopy_exact_check(&surrogate, &cloud, &result));
    if (!canopy_exact_is_safe(&result)) {
        fail_msg("seed %llu, kind %u, side %d: %llu wrong, margin %g", (unsigned long long)s->seed, s->kind, side,
                 (unsigned long long)result.wrong, result.margin);
    }
    return result.margin / surrogate.lsb;
}

static struct canopy_crossing must_be_apart(const struct scene *s, const struct subject *x) {
    const struct canopy_crossing crossing = cross(s, x, x->b[0], x->b[1]);
    if (crossing.verdict != CANOPY_CROSSING_NONE) {
        fail_msg("seed %llu, kind %u, %ux%u: crossing at %g, %g by %g", (unsigned long long)s->seed, s->kind,
                 s->grid.size[0], s->grid.size[1], crossing.at[0], crossing.at[1], -crossing.distance);
    }
    return crossing;
}

// ---- Fast

static void check_fast(uint64_t seed) {
    struct scene s = make_scene(seed);
    static struct subject x;
    fit_fast(&s, &x);
    const double lsb = ldexp(1, x.field[0].frame.lsb_log2 + x.field[0].frame.quantum_log2);
    for (int side = 0; side < 2; side++) {
        const double margin = judge(&s, &x, side);
        assert_true(x.sandwich.margin[side] >= 0 && x.sandwich.margin[side] <= margin + 1);
    }
    // what the device proves is true, and both find the same where the surfaces touch
    const struct canopy_crossing crossing = must_be_apart(&s, &x);
    const double least = (double)x.sandwich.least / CANOPY_SANDWICH_UNITS;
    assert_true(x.sandwich.least >= 0);
    assert_true(crossing.distance / lsb >= least * 63 / 64 - 1e-6);
}

static void fast_pairs_are_safe_and_never_cross(void **state) {
    (void)state;
    seeds_run(2500, check_fast);
}

// ---- Tight

static void take_points(const struct scene *s, const struct subject *x, int side, struct canopy_tighten *t) {
    const struct canopy_tighten_size size = {.points = POINTS_MAX, .rows = ROWS_MAX};
    assert_int_equal(canopy_tighten_init(t, &x->field[side].frame, &size, tighten_arena, sizeof tighten_arena),
                     CANOPY_OK);
    assert_int_equal(s->scalar == CANOPY_F32 ? canopy_tighten_points_f32(t, (const float(*)[3])s->f32, s->count)
                                             : canopy_tighten_points_fx(t, (const int32_t(*)[3])s->fx, s->count),
                     CANOPY_OK);
}

static void take_field(struct subject *x, int side, struct canopy_tighten *t) {
    const uint16_t cells = x->field[side].axis[0].cells;
    const struct canopy_tighten_size size = {.cells = {cells, cells}, .rows = ROWS_MAX};
    assert_int_equal(canopy_tighten_init(t, &x->field[side].frame, &size, tighten_arena, sizeof tighten_arena),
                     CANOPY_OK);
    assert_int_equal(canopy_certify_init(&x->certify, &x->field[side], certify_arena, sizeof certify_arena), CANOPY_OK);
    assert_int_equal(canopy_tighten_field(t, &x->field[side], &x->certify), CANOPY_OK);
}

// One side, the other staying where it is: a sandwich after every step. Returns how often something was published.
static uint32_t tighten_side(struct scene *s, struct subject *x, int side, bool from_field) {
    struct canopy_tighten t;
    if (from_field) {
        take_field(x, side, &t);
    } else {
        take_points(s, x, side, &t);
    }
    assert_int_equal(canopy_sandwich_over(&t, x->b[1 - side], x->mirror), CANOPY_OK);
    assert_int_equal(canopy_tighten_begin(&t, x->b[side], true), CANOPY_OK);
    uint32_t published = 0;
    for (enum canopy_status status = CANOPY_MORE; status == CANOPY_MORE;) {
        status = canopy_tighten_step(&t, 1 + canopy_random_below(&s->random, 20));
        if (t.published != published || status == CANOPY_OK) {
            published = t.published;
            (void)judge(s, x, side);
            (void)judge(s, x, 1 - side);
            (void)must_be_apart(s, x);
        }
    }
    return published - 1;
}

// What is free may be wished to be anything: what is taken of it never crosses, and nothing else has changed.
static void ease(struct scene *s, struct subject *x) {
    static int32_t wishes[2][COUNT_MAX];
    uint8_t coverage[CANOPY_COVERAGE_BYTES(GRID_MAX, GRID_MAX)], seen[CANOPY_FREE_SEEN_BYTES(GRID_MAX, GRID_MAX)];
    const uint16_t *size = s->grid.size;
    const bool wild = canopy_random_chance(&s->random, 0.5);
    memset(seen, 0, sizeof seen);
    (void)canopy_field_coverage(&x->field[0], coverage);
    canopy_free_see(size, coverage, seen);
    for (int side = 0; side < 2; side++) {
        struct canopy_free work;
        memcpy(wishes[side], x->b[side], sizeof wishes[side]);
        assert_int_equal(canopy_free_begin(&work, size, seen, wishes[side]), CANOPY_OK);
        for (uint32_t j = 0; wild && j < count_of(x); j++) {
            wishes[side][j] = canopy_bit_get(seen, j) ? wishes[side][j]
                                                      : (int32_t)canopy_random_below(&s->random, 1 << 25) - (1 << 24);
        }
    }
    struct canopy_sandwich_ease easing;
    canopy_sandwich_ease_begin(&easing, size, (const int32_t *const[2]){x->b[0], x->b[1]},
                               (int32_t *const[2]){wishes[0], wishes[1]});
    while (canopy_sandwich_ease_step(&easing, 1 + canopy_random_below(&s->random, 9)) == CANOPY_MORE) {}
    for (int side = 0; side < 2; side++) {
        for (uint32_t j = 0; j < count_of(x); j++) {
            assert_true(!canopy_bit_get(seen, j) || wishes[side][j] == x->b[side][j]);
        }
        memcpy(x->b[side], wishes[side], sizeof wishes[side]);
        (void)judge(s, x, side);
    }
    (void)must_be_apart(s, x);
}

static uint32_t tightened[2];  // from points, from fields

static void check_tight(uint64_t seed) {
    struct scene s = make_scene(seed);
    static struct subject x;
    fit_fast(&s, &x);
    const bool from_field = canopy_random_chance(&s.random, 0.4);
    tightened[from_field] += tighten_side(&s, &x, CANOPY_BELOW, from_field) > 0;
    tightened[from_field] += tighten_side(&s, &x, CANOPY_ABOVE, from_field) > 0;
    ease(&s, &x);
}

static void tight_pairs_are_safe_and_never_cross_at_any_time(void **state) {
    (void)state;
    seeds_run(120, check_tight);
    print_message("tightened %u sides from points and %u from fields\n", tightened[0], tightened[1]);
}

// ---- Without any of this

static void fit_one(const struct scene *s, struct subject *x, int side, bool tight) {
    struct canopy_fast fast;
    assert_int_equal(canopy_fast_init(&fast, &x->field[side], canopy_line_fit_of(s->scalar), s->lines, sandwich_arena,
                                      sizeof sandwich_arena),
                     CANOPY_OK);
    assert_int_equal(canopy_fast_begin(&fast, x->b[side]), CANOPY_OK);
    while (canopy_fast_step(&fast, 100) == CANOPY_MORE) {}
    if (tight) {
        struct canopy_tighten t;
        take_points(s, x, side, &t);
        assert_int_equal(canopy_tighten_begin(&t, x->b[side], false), CANOPY_OK);
        while (canopy_tighten_step(&t, 100) == CANOPY_MORE) {}
    }
    (void)judge(s, x, side);
}

static uint32_t naive_crossings(bool tight) {
    uint32_t crossings = 0;
    for (uint64_t seed = 1; seed <= 100; seed++) {
        const struct scene s = make_scene(seed);
        static struct subject x;
        fill_fields(&s, &x);
        fit_one(&s, &x, CANOPY_ABOVE, tight);
        fit_one(&s, &x, CANOPY_BELOW, tight);
        crossings += cross(&s, &x, x.b[0], x.b[1]).verdict == CANOPY_CROSSING_FOUND;
    }
    return crossings;
}

static void pairs_that_know_nothing_of_each_other_cross(void **state) {
    (void)state;
    const uint32_t fast = naive_crossings(false), tight = naive_crossings(true);
    print_message("of 100 clouds, fast pairs cross on %u, tight ones on %u\n", fast, tight);
    assert_true(fast >= 10);
    assert_true(tight >= 10);
}

// ---- The referee

// Two surfaces made up: random coefficients, the lower ones a distance below.
static void make_up(uint64_t *random, const struct scene *s, struct subject *x, int32_t apart) {
    for (int side = 0; side < 2; side++) {
        x->field[side].frame = frame_of(s, (enum canopy_side)side);
    }
    for (size_t j = 0; j < count_of(x); j++) {
        x->b[0][j] = (int32_t)canopy_random_below(random, 1 << 20);
        x->b[1][j] = apart - x->b[0][j];  // mirrored
    }
}

static void the_referee_sees_one_step(void **state) {
    (void)state;
    static struct subject x;
    for (uint64_t seed = 1; seed <= 100; seed++) {
        const struct scene s = make_scene(seed);
        uint64_t random = seed;
        make_up(&random, &s, &x, 0);
        assert_int_equal(cross(&s, &x, x.b[0], x.b[1]).verdict, CANOPY_CROSSING_NONE);
        assert_true(cross(&s, &x, x.b[0], x.b[1]).distance == 0);
        make_up(&random, &s, &x, 0);
        const size_t one = canopy_random_below(&random, (uint32_t)count_of(&x));
        x.b[0][one]--;  // one coefficient, one step
        assert_int_equal(cross(&s, &x, x.b[0], x.b[1]).verdict, CANOPY_CROSSING_FOUND);
        for (size_t j = 0; j < count_of(&x); j++) {
            x.b[0][j]++;
        }
        assert_int_equal(cross(&s, &x, x.b[0], x.b[1]).verdict, CANOPY_CROSSING_NONE);
    }
}

// A cubic by its definition: sums of truncated powers.
static double spline(double x) {
    double sum = 0;
    static const double BINOMIAL[] = {1, -4, 6, -4, 1};
    for (int k = 0; k < 5; k++) {
        const double t = x + 2 - k;
        sum += t > 0 ? BINOMIAL[k] * t * t * t : 0;
    }
    return sum / 6;
}

static double difference_at(const struct subject *x, double u, double v) {
    const int m = x->field[0].frame.size[0], n = x->field[0].frame.size[1];
    double sum = 0;
    for (int i = -1; i <= m; i++) {
        for (int j = -1; j <= n; j++) {
            const int k = (i < 0 ? 0 : i < m ? i : m - 1) * n + (j < 0 ? 0 : j < n ? j : n - 1);
            sum += ((double)x->b[0][k] + x->b[1][k]) * spline(u - i) * spline(v - j);
        }
    }
    return sum;
}

// Six times the Bernstein coefficients of half a knot interval, by de Casteljau: exact in double.
static void half_of(const double b[4], int right, double to[4]) {
    double p[4] = {b[0] + 4 * b[1] + b[2], 4 * b[1] + 2 * b[2], 2 * b[1] + 4 * b[2], b[1] + 4 * b[2] + b[3]};
    for (int k = 0; k < 4; k++) {
        to[right ? 3 - k : k] = p[right ? 3 : 0];
        for (int i = 0; i < 3; i++) {
            if (right) {
                p[3 - i] = (p[3 - i] + p[2 - i]) / 2;
            } else {
                p[i] = (p[i] + p[i + 1]) / 2;
            }
        }
    }
}

// 36 times the least Bernstein coefficient of the difference over a half-knot cell.
static double least_over(const struct subject *x, int u, int v) {
    const int m = x->field[0].frame.size[0], n = x->field[0].frame.size[1];
    double rows[4][4], column[4], least = HUGE_VAL;
    for (int a = 0; a < 4; a++) {
        const int i = u / 2 + a - 1;
        double from[4];
        for (int b = 0; b < 4; b++) {
            const int j = v / 2 + b - 1, k = (i < 0 ? 0 : i < m ? i : m - 1) * n + (j < 0 ? 0 : j < n ? j : n - 1);
            from[b] = (double)x->b[0][k] + x->b[1][k];
        }
        half_of(from, v % 2, rows[a]);
    }
    for (int b = 0; b < 4; b++) {
        half_of((const double[4]){rows[0][b], rows[1][b], rows[2][b], rows[3][b]}, u % 2, column);
        for (int a = 0; a < 4; a++) {
            least = fmin(least, column[a]);
        }
    }
    return least;
}

static void what_the_library_calls_least_is_exact(void **state) {
    (void)state;
    static struct subject x;
    for (uint64_t seed = 1; seed <= 200; seed++) {
        const struct scene s = make_scene(seed);
        uint64_t random = seed;
        make_up(&random, &s, &x, 0);
        for (size_t j = 0; j < count_of(&x); j++) {
            x.b[1][j] += (int32_t)canopy_random_below(&random, 2000) - 1000;
        }
        for (uint32_t row = 0; row + 1U < s.grid.size[0]; row++) {
            double least = HUGE_VAL;
            for (int u = 0; u < 2; u++) {
                for (int v = 0; v < 2 * (s.grid.size[1] - 1); v++) {
                    least = fmin(least, least_over(&x, 2 * (int)row + u, v));
                }
            }
            assert_true((double)canopy_sandwich_least(x.b[0], x.b[1], s.grid.size, row) ==
                        least * CANOPY_SANDWICH_UNITS / 36);
        }
    }
}

// What it says is least, no sample is below, and about the least one is as low; so is what the library says.
static void the_referee_finds_the_least_distance(void **state) {
    (void)state;
    static struct subject x;
    for (uint64_t seed = 1; seed <= 40; seed++) {
        struct scene s = make_scene(seed);
        uint64_t random = seed;
        make_up(&random, &s, &x, 0);
        for (size_t j = 0; j < count_of(&x); j++) {
            x.b[0][j] += (int32_t)canopy_random_below(&random, 1000) - (seed % 2 == 0 ? 100 : 500);
        }
        const struct canopy_crossing crossing = cross(&s, &x, x.b[0], x.b[1]);
        const double lsb = ldexp(1, x.field[0].frame.lsb_log2 + x.field[0].frame.quantum_log2);
        double lowest = HUGE_VAL;
        for (double u = 0; u <= s.grid.size[0] - 1; u += 0.125) {
            for (double v = 0; v <= s.grid.size[1] - 1; v += 0.125) {
                lowest = fmin(lowest, difference_at(&x, u, v));
            }
        }
        int64_t proved = INT64_MAX;
        for (uint32_t row = 0; row + 1U < s.grid.size[0]; row++) {
            const int64_t here = canopy_sandwich_least(x.b[0], x.b[1], s.grid.size, row);
            proved = here < proved ? here : proved;
        }
        const double distance = crossing.distance / lsb, least = (double)proved / CANOPY_SANDWICH_UNITS;
        assert_true(distance <= lowest + 1e-3);
        assert_true(least <= lowest + 1e-3);
        assert_true(fabs(difference_at(&x, crossing.at[0], crossing.at[1]) - distance) <= 0.02 * fabs(distance) + 1e-3);
        assert_true(crossing.verdict == (distance < 0 ? CANOPY_CROSSING_FOUND : CANOPY_CROSSING_NONE));
    }
}

// x^2 (1-x)^2-like: a difference that is 0 in a point off every halving, by doubles that are no whole steps.
static void what_touches_is_not_called_crossing(void **state) {
    (void)state;
    static struct subject x;
    const struct scene s = make_scene(3);
    uint64_t random = 3;
    make_up(&random, &s, &x, 0);
    double coefficients[2][COUNT_MAX];
    struct canopy_surrogate above = publish(&s, &x, CANOPY_ABOVE, x.b[0], coefficients[0]);
    const struct canopy_surrogate below = publish(&s, &x, CANOPY_BELOW, x.b[1], coefficients[1]);
    // (u - 3/2 - 1/3)^2 has B-spline coefficients (i - 11/6)^2 - 1/3: rounded to doubles below or above
    const int n = x.field[0].frame.size[1];
    for (int shift = -1; shift <= 1; shift++) {
        for (size_t j = 0; j < count_of(&x); j++) {
            const size_t row = j / (size_t)n;
            const double i = (double)row;
            coefficients[0][j] = coefficients[1][j] + (i - 11.0 / 6) * (i - 11.0 / 6) - 1.0 / 3 + 1e-3 * shift;
        }
        struct canopy_crossing crossing;
        struct canopy_fault fault;
        assert_true(canopy_crossing_find(&above, &below, &crossing, &fault));
        if (shift != 0) {
            assert_int_equal(crossing.verdict, shift < 0 ? CANOPY_CROSSING_FOUND : CANOPY_CROSSING_NONE);
        }
        assert_true(fabs(crossing.distance / above.lsb - 1e-3 * shift) < 1e-4);
    }
    above.origin[0] += 1;
    struct canopy_crossing crossing;
    struct canopy_fault fault;
    assert_false(canopy_crossing_find(&above, &below, &crossing, &fault));
    assert_non_null(strstr(fault.text, "frame"));
    assert_false(canopy_crossing_find(&below, &below, &crossing, &fault));
    assert_non_null(strstr(fault.text, "one above and one below"));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_referee_sees_one_step),
        cmocka_unit_test(the_referee_finds_the_least_distance),
        cmocka_unit_test(what_the_library_calls_least_is_exact),
        cmocka_unit_test(what_touches_is_not_called_crossing),
        cmocka_unit_test(pairs_that_know_nothing_of_each_other_cross),
        cmocka_unit_test(fast_pairs_are_safe_and_never_cross),
        cmocka_unit_test(tight_pairs_are_safe_and_never_cross_at_any_time),
    };
    return cmocka_run_group_tests_name("sandwich properties", tests, NULL, NULL);
}
