// No point on the wrong side, in exact arithmetic, over many small clouds made to hurt: both scalars, both sides.
//
// Every cloud goes the device's way (frame, field, fit, certificate, mended where the certificate says so) and is then
// judged by tools/common/exact, which shares nothing with lib/cover. CANOPY_CLOUDS sets how many (default 60,000
// in each program that runs this, other ones by each compiler); a failure prints the seed, CANOPY_SEED=n runs that one
// alone.

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
#include "lib/cover/certify.h"
#include "lib/cover/envelope.h"
#include "lib/cover/fast.h"
#include "lib/cover/field.h"
#include "tools/common/exact.h"
#include "tools/common/random.h"

enum { POINTS_MAX = 64, GRID_MAX = 10, CELLS_MAX = 8 };

struct cloud {
    enum canopy_scalar scalar;
    size_t count;
    float f32[POINTS_MAX][3];
    int32_t fx[POINTS_MAX][3];
};

struct scene {
    uint64_t seed, random;
    const char *kind;
    struct canopy_grid grid;
    uint16_t lines;
    struct cloud cloud;
};

// ---- Clouds, in the unit square times a height; `at` says how a coordinate comes about

static double uniform(struct scene *s) { return canopy_random_unit(&s->random); }

static void put(struct scene *s, double x, double y, double z) {
    if (s->cloud.count < POINTS_MAX) {
        const double p[3] = {x, y, z};
        for (int a = 0; a < 3; a++) {
            s->cloud.f32[s->cloud.count][a] = (float)p[a];
        }
        s->cloud.count++;
    }
}

static void one_point(struct scene *s) { put(s, uniform(s), uniform(s), uniform(s)); }

static void all_equal(struct scene *s) {
    const double x = uniform(s), y = uniform(s), z = uniform(s);
    for (int i = 0; i < 10; i++) {
        put(s, x, y, z);
    }
}

static void collinear(struct scene *s) {
    for (int i = 0; i < 20; i++) {
        const double t = uniform(s);
        put(s, t, 0.3 + 0.5 * t, 1 - t);
    }
}

static void one_column(struct scene *s) {
    for (int i = 0; i < 20; i++) {
        put(s, 0.5, 0.5, uniform(s));
    }
}

static void scattered(struct scene *s) {
    for (int i = 0; i < 40; i++) {
        put(s, uniform(s), uniform(s), uniform(s));
    }
}

static void duplicates(struct scene *s) {
    for (int i = 0; i < 15; i++) {
        const double x = uniform(s), y = uniform(s);
        put(s, x, y, uniform(s));
        put(s, x, y, uniform(s));
    }
}

// Pairs next to j + 1/2, on both sides: rows of the system that are nearly the same.
static void pairs_at_halves(struct scene *s) {
    const double columns = s->grid.size[1] - 1;
    put(s, 0, 0, 0);
    put(s, 1, 1, 0.1);
    for (int i = 0; i < 20; i++) {
        const double middle = ((double)canopy_random_below(&s->random, (uint32_t)columns) + 0.5) / columns;
        const double x = uniform(s);
        put(s, x, fmax(0, middle - 1e-4), uniform(s));
        put(s, x, fmin(1, middle + 1e-4), uniform(s));
    }
}

static void cliff(struct scene *s) {
    for (int i = 0; i < 50; i++) {
        const double x = uniform(s), y = uniform(s);
        put(s, x, y, y < 0.47 ? 0 : 1);
    }
}

static void spikes(struct scene *s) {
    for (int i = 0; i < 45; i++) {
        put(s, uniform(s), uniform(s), canopy_random_chance(&s->random, 0.1) ? 1 : 1e-3 * uniform(s));
    }
}

static void gaps(struct scene *s) {
    for (int i = 0; i < 40; i++) {
        const double x = uniform(s);
        put(s, x < 0.5 ? 0.2 * x : 1 - 0.1 * (1 - x), uniform(s), uniform(s));
    }
}

static void corners(struct scene *s) {
    for (int i = 0; i < 4; i++) {
        put(s, i % 2, i / 2, uniform(s));  // NOLINT(bugprone-integer-division)
    }
}

static void on_knots(struct scene *s) {
    for (int i = 0; i < 40; i++) {
        const uint32_t u = canopy_random_below(&s->random, s->grid.size[0]),
                       v = canopy_random_below(&s->random, s->grid.size[1]);
        put(s, (double)u / (s->grid.size[0] - 1), (double)v / (s->grid.size[1] - 1), uniform(s));
    }
}

static void saddle(struct scene *s) {
    for (int i = 0; i < 60; i++) {
        const double x = uniform(s), y = uniform(s);
        put(s, x, y, (x - 0.5) * (y - 0.5) * 40);
    }
}

static const struct {
    const char *name;
    void (*make)(struct scene *s);
} kinds[] = {
    {"one point", one_point},
    {"all equal", all_equal},
    {"collinear", collinear},
    {"one column", one_column},
    {"scattered", scattered},
    {"duplicates", duplicates},
    {"pairs at j +- 1/2", pairs_at_halves},
    {"cliff", cliff},
    {"spikes", spikes},
    {"gaps", gaps},
    {"corners", corners},
    {"on knots", on_knots},
    {"saddle", saddle},
};

// Stretches the unit cube to device units: plain, extreme aspect, an offset that eats the mantissa, full scale, tiny.
static void stretch(struct scene *s) {
    double scale[3] = {1000, 1000, 300}, offset[3] = {0, 0, 0};
    switch (canopy_random_below(&s->random, 7)) {
    case 0:
        scale[0] = 1e6;
        scale[1] = 3;
        break;
    case 1:
        scale[2] = 1e6;
        scale[0] = 20;
        break;
    case 2:
        offset[0] = 16777216;
        offset[1] = -16777000;
        offset[2] = 8388608;
        break;
    case 3:
        for (int a = 0; a < 3; a++) {
            scale[a] = 4294967295.0;
            offset[a] = -2147483648.0;
        }
        break;
    case 4: scale[0] = scale[1] = scale[2] = 7; break;
    case 5:
        scale[2] = 1;
        offset[2] = -2147483000.0;
        break;
    default: break;
    }
    if (s->cloud.scalar == CANOPY_F32 && canopy_random_chance(&s->random, 0.3)) {
        const double tiny = ldexp(1, (int)canopy_random_below(&s->random, 160) - 100);
        for (int a = 0; a < 3; a++) {
            scale[a] *= tiny;
            offset[a] *= tiny;
        }
    }
    for (size_t i = 0; i < s->cloud.count; i++) {
        for (int a = 0; a < 3; a++) {
            const double p = offset[a] + scale[a] * (double)s->cloud.f32[i][a];
            s->cloud.f32[i][a] = (float)p;
            s->cloud.fx[i][a] = (int32_t)fmax(-2147483648.0, fmin(2147483647.0, rint(p)));
        }
    }
}

static struct scene make_scene(uint64_t seed) {
    static const uint16_t cells[] = {1, 2, 3, 4, 5, 8};
    struct scene s = {.seed = seed, .random = seed};
    s.grid.size[0] = (uint16_t)(4 + canopy_random_below(&s.random, GRID_MAX - 3));
    s.grid.size[1] = (uint16_t)(4 + canopy_random_below(&s.random, GRID_MAX - 3));
    s.grid.cells = cells[canopy_random_below(&s.random, 6)];
    s.grid.side = (uint8_t)canopy_random_below(&s.random, 2);
    s.lines = canopy_random_chance(&s.random, 0.5) ? 1 : s.grid.cells;
    s.cloud.scalar = canopy_random_below(&s.random, 2) == 0 ? CANOPY_F32 : CANOPY_FX;
    const uint32_t kind = canopy_random_below(&s.random, sizeof kinds / sizeof kinds[0]);
    s.kind = kinds[kind].name;
    kinds[kind].make(&s);
    stretch(&s);
    return s;
}

// ---- The device's way

static CANOPY_ARENA_DECLARE(field_arena, CANOPY_FIELD_ARENA(GRID_MAX, GRID_MAX, CELLS_MAX, CELLS_MAX));
static CANOPY_ARENA_DECLARE(fast_arena, CANOPY_FAST_ARENA(GRID_MAX, GRID_MAX, CELLS_MAX, CELLS_MAX));
static CANOPY_ARENA_DECLARE(certify_arena, CANOPY_CERTIFY_ARENA(GRID_MAX, CELLS_MAX, CELLS_MAX));

static enum canopy_status make_frame(const struct scene *s, struct canopy_frame *frame) {
    const struct cloud *c = &s->cloud;
    return cloud_frame(c->scalar, &s->grid, (const float(*)[3])c->f32, (const int32_t(*)[3])c->fx, c->count, frame);
}

// What is no number, or no place in the frame, never enters a field: not as a height, not as coverage.
static void feed_what_is_no_reading(const struct canopy_frame *frame, struct canopy_field *field) {
    static const float bad[] = {NAN, INFINITY, -INFINITY};
    const float inside[3] = {ldexpf((float)frame->origin[0], frame->quantum_log2),
                             ldexpf((float)frame->origin[1], frame->quantum_log2),
                             ldexpf((float)frame->origin[2], frame->quantum_log2)};
    for (size_t i = 0; i < 9; i++) {
        float point[3] = {inside[0], inside[1], inside[2]};
        point[i % 3] = bad[i / 3];
        assert_int_equal(canopy_field_feed_f32(field, (const float(*)[3]) & point, 1), 1);
    }
    const size_t cells = (size_t)field->axis[0].count * field->axis[1].count;
    for (size_t c = 0; c < cells; c++) {
        assert_int_equal(field->heights[c], CANOPY_NO_HEIGHT);
    }
}

// Fits and certifies; returns the certified margin in steps.
static int32_t fit(const struct scene *s, const struct canopy_frame *frame, int32_t *b) {
    struct canopy_field field;
    struct canopy_fast fast;
    struct canopy_certify certify;
    const uint16_t cells[2] = {frame->cells, frame->cells};
    assert_int_equal(canopy_field_init(&field, frame, cells, field_arena, sizeof field_arena), CANOPY_OK);
    assert_true(field.exact);
    if (s->cloud.scalar == CANOPY_F32) {
        feed_what_is_no_reading(frame, &field);
    }
    const size_t refused = s->cloud.scalar == CANOPY_F32
                               ? canopy_field_feed_f32(&field, (const float(*)[3])s->cloud.f32, s->cloud.count)
                               : canopy_field_feed_fx(&field, (const int32_t(*)[3])s->cloud.fx, s->cloud.count);
    assert_int_equal(refused, 0);
    assert_int_equal(
        canopy_fast_init(&fast, &field, canopy_line_fit_of(s->cloud.scalar), s->lines, fast_arena, sizeof fast_arena),
        CANOPY_OK);
    assert_int_equal(canopy_fast_begin(&fast, b), CANOPY_OK);
    while (canopy_fast_step(&fast, 3) == CANOPY_MORE) {}
    assert_int_equal(canopy_certify_init(&certify, &field, certify_arena, sizeof certify_arena), CANOPY_OK);
    canopy_certify_begin(&certify, b);
    enum canopy_status status;
    while ((status = canopy_certify_step(&certify, 2)) != CANOPY_OK) {
        if (status == CANOPY_NOT_SAFE) {
            assert_int_equal(canopy_fast_raise(&field, b, certify.failed_cell, certify.missing), CANOPY_OK);
        }
    }
    canopy_fast_orient(frame, b);
    return certify.margin;
}

static struct canopy_cloud judged_cloud(const struct cloud *c) {
    return cloud_of(c->scalar, (const float(*)[3])c->f32, (const int32_t(*)[3])c->fx, c->count);
}

static void check_scene(uint64_t seed) {
    const struct scene s = make_scene(seed);
    struct canopy_frame frame;
    int32_t b[GRID_MAX * GRID_MAX];
    double coefficients[GRID_MAX * GRID_MAX];
    assert_int_equal(make_frame(&s, &frame), CANOPY_OK);
    const int32_t margin = fit(&s, &frame, b);
    const struct canopy_surrogate surrogate = cloud_surrogate(&frame, s.cloud.scalar, b, 1, coefficients);
    const struct canopy_cloud cloud = judged_cloud(&s.cloud);
    struct canopy_exact_result result;
    assert_true(canopy_exact_check(&surrogate, &cloud, &result));
    // the certificate may promise less than there is, never more (the referee's own bound is 1e-12 of the heights off)
    const double slack = 1e-9 * (fabs(result.height_max) + fabs(result.height_min)) + surrogate.lsb * 1e-3;
    if (!canopy_exact_is_safe(&result) || margin < 0 || result.margin < margin * surrogate.lsb - slack) {
        fail_msg("seed %llu, %s, %s, side %d, %ux%u, Q %u, lines %u: %llu wrong, %llu outside, margin %g, certified %g",
                 (unsigned long long)seed, s.kind, s.cloud.scalar == CANOPY_F32 ? "f32" : "fx", s.grid.side,
                 s.grid.size[0], s.grid.size[1], s.grid.cells, s.lines, (unsigned long long)result.wrong,
                 (unsigned long long)result.outside, result.margin, margin * surrogate.lsb);
    }
}

static void no_point_is_on_the_wrong_side(void **state) {
    (void)state;
    seeds_run(60000, check_scene);
}

// What the referee of this file says when a surface is one step too low somewhere: it must notice.
static void the_referee_notices_one_step(void **state) {
    (void)state;
    int noticed = 0;
    for (uint64_t seed = 1; seed <= 200; seed++) {
        const struct scene s = make_scene(seed);
        struct canopy_frame frame;
        int32_t b[GRID_MAX * GRID_MAX];
        double coefficients[GRID_MAX * GRID_MAX];
        assert_int_equal(make_frame(&s, &frame), CANOPY_OK);
        (void)fit(&s, &frame, b);
        struct canopy_surrogate surrogate = cloud_surrogate(&frame, s.cloud.scalar, b, 1, coefficients);
        const struct canopy_cloud cloud = judged_cloud(&s.cloud);
        struct canopy_exact_result result;
        assert_true(canopy_exact_check(&surrogate, &cloud, &result));
        const double down = result.margin / surrogate.lsb + 1;
        for (size_t i = 0; i < CANOPY_COEFFICIENTS(frame.size[0], frame.size[1]); i++) {
            coefficients[i] += frame.side == CANOPY_ABOVE ? -down : down;
        }
        assert_true(canopy_exact_check(&surrogate, &cloud, &result));
        noticed += result.wrong > 0;
    }
    assert_int_equal(noticed, 200);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_referee_notices_one_step),
        cmocka_unit_test(no_point_is_on_the_wrong_side),
    };
    return cmocka_run_group_tests_name("cover properties", tests, NULL, NULL);
}
