// Surfaces with windows in exact arithmetic, over many small scenes: both scalars, both sides, both levels, windows
// that touch the edge of the grid, overlap and nest, fits that are stopped anywhere.
//
// The judge is tools/common/exact and rational, which share nothing with lib/. CANOPY_CLOUDS sets how many scenes; a
// failure prints the seed, CANOPY_SEED=n runs that one alone.

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
#include "lib/cover/fast.h"
#include "lib/cover/refine.h"
#include "tools/common/exact.h"
#include "tools/common/random.h"
#include "tools/common/rational.h"

enum { POINTS = 60, GRID = 8, CELLS = 8, WINDOWS = 3, FINE = 4 * (GRID - 1) + 3 };

struct scene {
    uint64_t seed, random;
    enum canopy_scalar scalar;
    struct canopy_frame frame;
    struct canopy_field field;
    struct canopy_certify base;
    struct canopy_refine_certify certify;
    int32_t b[GRID * GRID], d[WINDOWS][FINE * FINE];
    struct canopy_refinement windows[WINDOWS];
    uint32_t count;
    size_t points;
    float f32[POINTS][3];
    int32_t fx[POINTS][3];
};

static CANOPY_ARENA_DECLARE(field_arena, CANOPY_FIELD_ARENA(GRID, GRID, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(fast_arena, CANOPY_FAST_ARENA(GRID, GRID, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(certify_arena, CANOPY_CERTIFY_ARENA(GRID, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(windows_arena, CANOPY_REFINE_CERTIFY_ARENA(CELLS, CELLS));
static CANOPY_ARENA_DECLARE(refine_arena,
                            CANOPY_REFINE_ARENA(FINE, FINE, CANOPY_REFINE_NODES(FINE, FINE, CELLS, CELLS, 1)));

static double uniform(struct scene *s) { return canopy_random_unit(&s->random); }
static uint32_t below(struct scene *s, uint32_t limit) { return canopy_random_below(&s->random, limit); }

// ---- Scenes

static double height(struct scene *s, uint32_t kind, double x, double y) {
    switch (kind) {
    case 0: return uniform(s);
    case 1: return y < 0.47 ? 0 : 1;                               // a cliff
    case 2: return canopy_random_chance(&s->random, 0.1) ? 1 : 0;  // spikes
    case 3: return (x - 0.5) * (y - 0.5) * 4;                      // a saddle
    default: return 0.3;                                           // flat
    }
}

static void make_points(struct scene *s) {
    const uint32_t kind = below(s, 5);
    const bool knots = below(s, 3) == 0;
    const double scale = below(s, 4) == 0 ? 30 : 100000, tall = below(s, 4) == 0 ? 1 : 5000;
    s->points = 1 + below(s, POINTS);
    for (size_t i = 0; i < s->points; i++) {
        const double x = knots ? below(s, 33) / 32.0 : uniform(s), y = knots ? below(s, 33) / 32.0 : uniform(s);
        const double p[3] = {x * scale, y * scale * 2, height(s, kind, x, y) * tall};
        for (int a = 0; a < 3; a++) {
            s->f32[i][a] = (float)p[a];
            s->fx[i][a] = (int32_t)rint(p[a]);
        }
    }
}

static void make_frame(struct scene *s, uint16_t cells) {
    const struct canopy_grid grid = {.size = {(uint16_t)(4 + below(s, GRID - 3)), (uint16_t)(4 + below(s, GRID - 3))},
                                     .cells = cells,
                                     .side = (uint8_t)below(s, 2)};
    assert_int_equal(
        cloud_frame(s->scalar, &grid, (const float(*)[3])s->f32, (const int32_t(*)[3])s->fx, s->points, &s->frame),
        CANOPY_OK);
}

// Random points in a field; no coefficients yet. `level`: what the field's cells can be halved to.
static unsigned make_scene(struct scene *s, uint64_t seed, bool packed) {
    static const uint16_t cells[] = {2, 4, 6, 8};
    *s = (struct scene){.seed = seed, .random = seed};
    const uint16_t q = cells[below(s, 4)];
    const uint16_t both[2] = {q, q};
    s->scalar = below(s, 2) ? CANOPY_F32 : CANOPY_FX;
    make_points(s);
    make_frame(s, q);
    assert_int_equal((packed ? canopy_field_init_packed : canopy_field_init)(&s->field, &s->frame, both, field_arena,
                                                                             sizeof field_arena),
                     CANOPY_OK);
    const size_t refused = s->scalar == CANOPY_F32
                               ? canopy_field_feed_f32(&s->field, (const float(*)[3])s->f32, s->points)
                               : canopy_field_feed_fx(&s->field, (const int32_t(*)[3])s->fx, s->points);
    assert_int_equal(refused, 0);
    assert_int_equal(canopy_certify_init(&s->base, &s->field, certify_arena, sizeof certify_arena), CANOPY_OK);
    assert_int_equal(canopy_refine_certify_init(&s->certify, &s->field, &s->base, windows_arena, sizeof windows_arena),
                     CANOPY_OK);
    return q % 4 == 0 ? 2 : 1;
}

// One more window, somewhere.
static void add_window(struct scene *s, unsigned level) {
    int32_t low[2], high[2];
    struct canopy_refinement *window = &s->windows[s->count];
    do {
        for (int a = 0; a < 2; a++) {
            const uint32_t end = (s->frame.size[a] - 1U) << level;
            low[a] = (int32_t)below(s, end);
            high[a] = low[a] + 1 + (int32_t)below(s, end - (uint32_t)low[a]);
        }
    } while (canopy_refine_place(&s->frame, level, low, high, window) != CANOPY_OK);
    window->d = s->d[s->count++];
}

static void fit_base(struct scene *s) {
    struct canopy_fast fast;
    enum canopy_status status;
    assert_int_equal(
        canopy_fast_init(&fast, &s->field, canopy_line_fit_of(s->scalar), 1, fast_arena, sizeof fast_arena), CANOPY_OK);
    assert_int_equal(canopy_fast_begin(&fast, s->b), CANOPY_OK);
    while (canopy_fast_step(&fast, 99) == CANOPY_MORE) {}
    canopy_certify_begin(&s->base, s->b);
    while ((status = canopy_certify_step(&s->base, 99)) != CANOPY_OK) {
        if (status == CANOPY_NOT_SAFE) {
            assert_int_equal(canopy_fast_raise(&s->field, s->b, s->base.failed_cell, s->base.missing), CANOPY_OK);
        }
    }
}

static enum canopy_status certify(struct scene *s) {
    enum canopy_status status = canopy_refine_certify_begin(&s->certify, s->b, s->windows, s->count);
    assert_int_equal(status, CANOPY_OK);
    while ((status = canopy_refine_certify_step(&s->certify, 100)) == CANOPY_MORE) {}
    return status;
}

// ---- As the judge has it

struct judged {
    struct canopy_surrogate surrogate;
    double b[GRID * GRID], d[WINDOWS][FINE * FINE];
    struct canopy_window windows[WINDOWS];
};

static void give(const struct scene *s, struct judged *to) {
    const double sign = cloud_mirror(&s->frame);
    to->surrogate = cloud_surrogate(&s->frame, s->scalar, s->b, sign, to->b);
    to->surrogate.window_count = s->count;
    to->surrogate.windows = to->windows;
    for (uint32_t k = 0; k < s->count; k++) {
        const struct canopy_refinement *w = &s->windows[k];
        to->windows[k] =
            (struct canopy_window){w->level, {w->first[0], w->first[1]}, {w->size[0], w->size[1]}, to->d[k]};
        for (size_t i = 0; i < (size_t)w->size[0] * w->size[1]; i++) {
            to->d[k][i] = sign * w->d[i];
        }
    }
}

// The surface over knots (u, v) in steps, rounded down to a double: exact to 2^-20 of a step.
static double surface(const struct canopy_surrogate *s, struct canopy_rational *rational, double u, double v) {
    const double point[3] = {s->origin[0] + u * s->pitch[0], s->origin[1] + v * s->pitch[1], s->origin[2]};
    double floor;
    (void)canopy_rational_margin(rational, point, &floor);
    return floor / s->lsb;
}

// ---- Windows that were fitted

static void fit_window(struct scene *s) {
    struct canopy_refine refine;
    assert_int_equal(canopy_refine_init(&refine, &s->frame, s->b, s->windows, s->count,
                                        CANOPY_REFINE_NODES(FINE, FINE, CELLS, CELLS, 1), refine_arena,
                                        sizeof refine_arena),
                     CANOPY_OK);
    assert_int_equal(canopy_refine_field(&refine, &s->certify), CANOPY_OK);
    if (canopy_refine_begin(&refine) == CANOPY_EMPTY) {
        return;
    }
    const uint32_t budget = below(s, 2) ? UINT32_MAX : 1 + below(s, 400);
    (void)canopy_refine_step(&refine, budget);
    assert_true(refine.after <= refine.before);
}

static void check_fitted(uint64_t seed) {
    struct scene s;
    struct judged judged;
    struct canopy_exact_result result;
    unsigned level = 1;
    const unsigned finest = make_scene(&s, seed, seed % 4 == 0);
    fit_base(&s);
    for (uint32_t k = 1 + below(&s, WINDOWS); k > 0; k--) {
        level = level < finest ? level + below(&s, 2) : level;
        add_window(&s, level);
        fit_window(&s);
    }
    const enum canopy_status status = certify(&s);
    const int32_t margin = s.certify.margin < s.base.margin ? s.certify.margin : s.base.margin;
    give(&s, &judged);
    const struct canopy_cloud cloud = cloud_of(s.scalar, (const float(*)[3])s.f32, (const int32_t(*)[3])s.fx, s.points);
    assert_true(canopy_exact_check(&judged.surrogate, &cloud, &result));
    const double slack = 1e-9 * (fabs(result.height_max) + fabs(result.height_min)) + judged.surrogate.lsb * 1e-3;
    if (status != CANOPY_OK || !canopy_exact_is_safe(&result) || margin < 0 ||
        result.margin < margin * judged.surrogate.lsb - slack) {
        fail_msg("seed %llu: status %d, %llu wrong, %llu outside, margin %g, certified %g", (unsigned long long)seed,
                 (int)status, (unsigned long long)result.wrong, (unsigned long long)result.outside, result.margin,
                 margin * judged.surrogate.lsb);
    }
}

static void no_point_is_on_the_wrong_side(void **state) {
    (void)state;
    seeds_run(1000, check_fitted);
}

// ---- Windows that are anything

static void random_coefficients(struct scene *s) {
    const int32_t size = 1 << (4 + below(s, 23));
    const bool raising = below(s, 4) == 0;
    for (int i = 0; i < GRID * GRID; i++) {
        s->b[i] = (int32_t)below(s, 2U * (uint32_t)size) - size;
    }
    for (uint32_t k = 0; k < s->count; k++) {
        for (int i = 0; i < FINE * FINE; i++) {
            s->d[k][i] = (int32_t)below(s, (raising ? 1U : 2U) * (uint32_t)size) - (raising ? 0 : size);
        }
    }
}

// Every cell as high as the certificates let it be.
static void raise_field(struct scene *s) {
    for (uint32_t c = 0; c < s->field.axis[0].count * s->field.axis[1].count; c++) {
        s->field.heights[c] = canopy_random_chance(&s->random, 0.8) ? CANOPY_HEIGHT_LIMIT : CANOPY_NO_HEIGHT;
    }
    canopy_certify_begin(&s->base, s->b);
    while (canopy_certify_step(&s->base, UINT32_MAX) == CANOPY_NOT_SAFE) {
        s->field.heights[s->base.failed_cell] -= s->base.missing;
    }
    assert_int_equal(canopy_refine_certify_begin(&s->certify, s->b, s->windows, s->count), CANOPY_OK);
    while (canopy_refine_certify_step(&s->certify, UINT32_MAX) == CANOPY_NOT_SAFE) {
        s->field.heights[s->certify.failed_cell] -= s->certify.missing;
    }
}

static void check_certificate(uint64_t seed) {
    struct scene s;
    struct judged judged;
    const unsigned finest = make_scene(&s, seed, false);
    s.frame.side = CANOPY_ABOVE;
    for (uint32_t k = 1 + below(&s, WINDOWS); k > 0; k--) {
        add_window(&s, 1 + below(&s, finest));
    }
    random_coefficients(&s);
    raise_field(&s);
    assert_int_equal(certify(&s), CANOPY_OK);
    give(&s, &judged);
    struct canopy_rational *rational = canopy_rational_open(&judged.surrogate);
    const double q = s.frame.cells;
    for (uint32_t c = 0; c < s.field.axis[0].count * s.field.axis[1].count; c++) {
        if (s.field.heights[c] == CANOPY_NO_HEIGHT || below(&s, 4) != 0) {
            continue;
        }
        const uint32_t row = c / s.field.axis[1].count, column = c % s.field.axis[1].count;
        for (int i = 0; i < 4; i++) {
            const double x = i < 2 ? below(&s, 2) : uniform(&s), y = i < 2 ? below(&s, 2) : uniform(&s);
            const double u = (row + x) / q, v = (column + y) / q;
            if (surface(&judged.surrogate, rational, u, v) < s.field.heights[c] - 1e-3) {
                fail_msg("seed %llu: cell %u is %d, the surface at %.17g, %.17g is %g", (unsigned long long)seed, c,
                         s.field.heights[c], u, v, surface(&judged.surrogate, rational, u, v));
            }
        }
    }
    canopy_rational_close(rational);
}

static void certificate_never_claims_what_is_not(void **state) {
    (void)state;
    seeds_run(1000, check_certificate);
}

// Rests on the test above: heights that it lets stand are the certificate's bounds, so that a step more is refused.
static void certificate_is_exact_about_its_own_bound(void **state) {
    (void)state;
    for (uint64_t seed = 1; seed <= 100; seed++) {
        struct scene s;
        make_scene(&s, seed, false);
        add_window(&s, 1);
        random_coefficients(&s);
        raise_field(&s);
        assert_int_equal(certify(&s), CANOPY_OK);
        if (s.certify.margin == 0) {
            for (int i = 0; i < GRID * GRID; i++) {
                s.b[i]--;
            }
            canopy_certify_begin(&s.base, s.b);
            assert_int_equal(certify(&s), CANOPY_NOT_SAFE);
            assert_true(s.certify.missing >= 1);
        }
    }
}

// ---- Knots and evaluation

static void check_evaluation(uint64_t seed) {
    struct scene s;
    struct judged judged;
    (void)make_scene(&s, seed, false);
    s.frame.side = CANOPY_ABOVE;
    for (uint32_t k = below(&s, WINDOWS + 1); k > 0; k--) {
        add_window(&s, 1 + below(&s, 2));
    }
    random_coefficients(&s);
    give(&s, &judged);
    struct canopy_rational *rational = canopy_rational_open(&judged.surrogate);
    for (int i = 0; i < 40; i++) {
        struct canopy_place at[2];
        uint32_t g[2];
        double knots[2], fraction[2];
        for (int a = 0; a < 2; a++) {
            const uint32_t quanta = below(&s, (uint32_t)canopy_frame_width(&s.frame, a) + 1);
            at[a] = canopy_place_of(quanta, s.frame.pitch[a], s.frame.size[a]);
            knots[a] = (double)quanta / s.frame.pitch[a];
            g[a] = (uint32_t)fmin(floor(knots[a] * 4), 4.0 * s.frame.size[a] - 5);
            fraction[a] = knots[a] * 4 - g[a];
        }
        const double truth = surface(&judged.surrogate, rational, knots[0], knots[1]);
        const double fx = canopy_refined_fx(s.b, s.frame.size, s.windows, s.count, &at[0], &at[1], NULL);
        const double error = CANOPY_SURFACE_FX_ERROR + s.count * (double)CANOPY_REFINEMENT_FX_ERROR;
        int32_t c[4][4];
        double sum = 0;
        assert_true(canopy_refined_cell(s.b, s.frame.size, s.windows, s.count, 2, g, c));
        for (int a = 0; a < 4; a++) {
            for (int e = 0; e < 4; e++) {
                const double u = fraction[0], v = fraction[1];
                const double w[2][4] = {
                    {(1 - u) * (1 - u) * (1 - u), ((3 * u - 6) * u * u + 4), ((-3 * u + 3) * u + 3) * u + 1, u * u * u},
                    {(1 - v) * (1 - v) * (1 - v), ((3 * v - 6) * v * v + 4), ((-3 * v + 3) * v + 3) * v + 1,
                     v * v * v}};
                sum += w[0][a] * w[1][e] * c[a][e] / 36;
            }
        }
        if (fabs(fx - truth) > error + 1e-3 || sum > truth + 1e-3 || sum < truth - 1 - 1e-3) {
            fail_msg("seed %llu: %g by fixed point, %g from inserted knots, in truth %g", (unsigned long long)seed, fx,
                     sum, truth);
        }
    }
    canopy_rational_close(rational);
}

static void evaluation_is_within_its_error(void **state) {
    (void)state;
    seeds_run(1000, check_evaluation);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(evaluation_is_within_its_error),
        cmocka_unit_test(certificate_never_claims_what_is_not),
        cmocka_unit_test(certificate_is_exact_about_its_own_bound),
        cmocka_unit_test(no_point_is_on_the_wrong_side),
    };
    return cmocka_run_group_tests_name("refine properties", tests, NULL, NULL);
}
