// tools/common/exact.c and rational.c against a naive evaluation in rational numbers that shares nothing with them: the
// B-spline as the piecewise cubic of |x|, summed over all coefficients, in mpq.

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <float.h>
#include <gmp.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tools/common/exact.h"
#include "tools/common/rational.h"

// ---------------------------------------------------------------------------------------------------------------------
// The naive evaluation

/// to = N(x), the uniform cubic B-spline centred on 0: (4 - 6 x^2 + 3 |x|^3)/6 up to 1, (2 - |x|)^3/6 up to 2.
static void naive_basis(mpq_t to, const mpq_t x) {
    mpq_t a, t, c;
    mpq_inits(a, t, c, NULL);
    mpq_abs(a, x);
    if (mpq_cmp_ui(a, 2, 1) >= 0) {
        mpq_set_ui(to, 0, 1);
    } else if (mpq_cmp_ui(a, 1, 1) >= 0) {
        mpq_set_ui(t, 2, 1);
        mpq_sub(t, t, a);
        mpq_mul(to, t, t);
        mpq_mul(to, to, t);
    } else {
        mpq_mul(t, a, a);
        mpq_set_ui(c, 6, 1);
        mpq_mul(c, c, t);
        mpq_mul(t, t, a);
        mpq_set_ui(to, 3, 1);
        mpq_mul(to, to, t);
        mpq_sub(to, to, c);
        mpq_set_ui(t, 4, 1);
        mpq_add(to, to, t);
    }
    mpq_set_ui(c, 6, 1);
    mpq_div(to, to, c);
    mpq_clears(a, t, c, NULL);
}

/// sum += (sum over rows first .. last of coefficient(i, j) N(step u - i0 - i) N(step v - j0 - j)) * lsb
static void naive_sum(mpq_t sum, const mpq_t u, const mpq_t v, int step, const int32_t first[2], const uint32_t size[2],
                      const double *coefficients, bool repeated) {
    mpq_t x, nu, nv, b;
    mpq_inits(x, nu, nv, b, NULL);
    const int edge = repeated ? 1 : 0;
    for (int i = -edge; i < (int)size[0] + edge; i++) {
        mpq_set_si(b, step, 1);
        mpq_mul(x, u, b);
        mpq_set_si(b, first[0] + i, 1);
        mpq_sub(x, x, b);
        naive_basis(nu, x);
        for (int j = -edge; mpq_sgn(nu) != 0 && j < (int)size[1] + edge; j++) {
            mpq_set_si(b, step, 1);
            mpq_mul(x, v, b);
            mpq_set_si(b, first[1] + j, 1);
            mpq_sub(x, x, b);
            naive_basis(nv, x);
            const int row = i < 0 ? 0 : i >= (int)size[0] ? (int)size[0] - 1 : i;
            const int column = j < 0 ? 0 : j >= (int)size[1] ? (int)size[1] - 1 : j;
            mpq_set_d(b, coefficients[row * (int)size[1] + column]);
            mpq_mul(b, b, nu);
            mpq_mul(b, b, nv);
            mpq_add(sum, sum, b);
        }
    }
    mpq_clears(x, nu, nv, b, NULL);
}

/// False outside the frame; else margin = sign (S lsb - height).
static bool naive_margin(const struct canopy_surrogate *s, const double point[3], mpq_t margin) {
    mpq_t q[3], d, a;
    mpq_inits(d, a, NULL);
    for (int i = 0; i < 3; i++) {
        mpq_init(q[i]);
        for (int k = 0; k < 3; k++) {
            mpq_set_d(d, point[k]);
            mpq_set_d(a, s->origin[k]);
            mpq_sub(d, d, a);
            mpq_set_d(a, s->axes[i][k]);
            mpq_mul(d, d, a);
            mpq_add(q[i], q[i], d);
        }
        if (i < 2) {
            mpq_set_d(a, s->pitch[i]);
            mpq_div(q[i], q[i], a);
        }
    }
    const bool inside = mpq_sgn(q[0]) >= 0 && mpq_sgn(q[1]) >= 0 && mpq_cmp_ui(q[0], s->size[0] - 1, 1) <= 0 &&
                        mpq_cmp_ui(q[1], s->size[1] - 1, 1) <= 0;
    if (inside) {
        static const int32_t zero[2] = {0, 0};
        mpq_set_ui(margin, 0, 1);
        naive_sum(margin, q[0], q[1], 1, zero, s->size, s->coefficients, true);
        for (size_t w = 0; w < s->window_count; w++) {
            const struct canopy_window *window = &s->windows[w];
            naive_sum(margin, q[0], q[1], 1 << window->level, window->first, window->size, window->coefficients, false);
        }
        mpq_set_d(a, s->lsb);
        mpq_mul(margin, margin, a);
        mpq_sub(margin, margin, q[2]);
        if (s->side == CANOPY_BELOW) {
            mpq_neg(margin, margin);
        }
    }
    mpq_clears(q[0], q[1], q[2], d, a, NULL);
    return inside;
}

// ---------------------------------------------------------------------------------------------------------------------
// Random surrogates and points

static uint64_t state = 1;

static uint64_t draw(void) {  // splitmix64
    uint64_t z = (state += UINT64_C(0x9e3779b97f4a7c15));
    z = (z ^ (z >> 30)) * UINT64_C(0xbf58476d1ce4e5b9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94d049bb133111eb);
    return z ^ (z >> 31);
}

static double uniform(double low, double high) { return low + (high - low) * ((double)(draw() >> 11) * 0x1p-53); }

static int below(int limit) { return (int)(draw() % (uint64_t)limit); }

struct scene {
    struct canopy_surrogate surrogate;
    double coefficients[64];
    double window_coefficients[2][36];
    struct canopy_window windows[2];
};

/// A rotation near enough to orthonormal, components in multiples of 2^-30, or signed coordinate axes.
static void draw_axes(double axes[3][3], int kind) {
    static const double ALONG[4][3][3] = {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}},
                                          {{0, 1, 0}, {0, 0, 1}, {1, 0, 0}},
                                          {{-1, 0, 0}, {0, 1, 0}, {0, 0, -1}},
                                          {{0, 0, -1}, {0, -1, 0}, {-1, 0, 0}}};
    if (kind < 4) {
        memcpy(axes, ALONG[kind], sizeof ALONG[kind]);
        return;
    }
    const double a = uniform(0, 6.2), b = uniform(0, 6.2);
    const double turned[3][3] = {
        {cos(a), sin(a), 0}, {-sin(a) * cos(b), cos(a) * cos(b), sin(b)}, {sin(a) * sin(b), -cos(a) * sin(b), cos(b)}};
    for (int i = 0; i < 9; i++) {
        axes[i / 3][i % 3] = rint(turned[i / 3][i % 3] * 0x1p30) * 0x1p-30;
    }
}

static void draw_scene(struct scene *scene, enum canopy_scalar scalar, int axes, double scale, int windows) {
    struct canopy_surrogate *s = &scene->surrogate;
    *s = (struct canopy_surrogate){.side = below(2) ? CANOPY_BELOW : CANOPY_ABOVE, .scalar = scalar, .unit = 1.0};
    s->size[0] = 4 + (uint32_t)below(5);
    s->size[1] = 4 + (uint32_t)below(5);
    s->lsb = below(2) ? 1.0 : 0.001;
    s->coefficients = scene->coefficients;
    for (int i = 0; i < 64; i++) {
        const double b = uniform(-scale, scale) / s->lsb;
        scene->coefficients[i] = scalar == CANOPY_FX ? rint(b) : b;
    }
    draw_axes(s->axes, axes);
    for (int k = 0; k < 3; k++) {
        s->origin[k] = below(2) ? rint(uniform(-scale, scale)) : uniform(-scale, scale);
    }
    s->pitch[0] = below(2) ? rint(uniform(4, 100)) : uniform(0.5, 40);
    s->pitch[1] = below(2) ? rint(uniform(4, 100)) : uniform(0.5, 40);
    s->window_count = (size_t)windows;
    s->windows = scene->windows;
    for (int w = 0; w < windows; w++) {
        scene->windows[w] = (struct canopy_window){.level = 1 + below(2),
                                                   .first = {below(20) - 5, below(20) - 5},
                                                   .size = {1 + (uint32_t)below(6), 1 + (uint32_t)below(6)},
                                                   .coefficients = scene->window_coefficients[w]};
        for (int i = 0; i < 36; i++) {
            scene->window_coefficients[w][i] = uniform(-scale, scale) / s->lsb;
        }
    }
}

#define POINTS 300  // more than one block, and a rest

struct points {
    struct canopy_cloud cloud;
    union {
        float f32[3 * POINTS];
        int32_t fx[3 * POINTS];
    } memory;
};

static void get_point(const struct points *points, size_t i, double p[3]) {
    for (size_t k = 0; k < 3; k++) {
        p[k] = points->cloud.scalar == CANOPY_F32 ? (double)points->memory.f32[3 * i + k]
                                                  : (double)points->memory.fx[3 * i + k];
    }
}

static void set_point(struct points *points, size_t i, const double p[3]) {
    for (size_t k = 0; k < 3; k++) {
        if (points->cloud.scalar == CANOPY_F32) {
            points->memory.f32[3 * i + k] = (float)p[k];
        } else {
            points->memory.fx[3 * i + k] = (int32_t)rint(p[k]);
        }
    }
}

static void begin_points(struct points *points, enum canopy_scalar scalar) {
    points->cloud = (struct canopy_cloud){.scalar = scalar, .count = POINTS, .stride = 3};
    for (size_t k = 0; k < 3; k++) {
        points->cloud.axis[k] =
            scalar == CANOPY_F32 ? (const void *)(points->memory.f32 + k) : (const void *)(points->memory.fx + k);
    }
}

/// Points over and a little beside the frame, most of them near the surface; some at its very edges and knots.
static void draw_points(struct points *points, const struct canopy_surrogate *s, double scale) {
    begin_points(points, s->scalar);
    for (size_t i = 0; i < POINTS; i++) {
        double q[3] = {uniform(-0.1, (double)s->size[0] - 0.9) * s->pitch[0],
                       uniform(-0.1, (double)s->size[1] - 0.9) * s->pitch[1], uniform(-1.0, 1.0) * scale};
        if (below(4) == 0) {
            q[0] = (double)below((int)s->size[0]) * s->pitch[0];
        }
        if (below(4) == 0) {
            q[1] = (double)below((int)s->size[1]) * s->pitch[1];
        }
        double p[3];
        for (int k = 0; k < 3; k++) {
            p[k] = s->origin[k] + s->axes[0][k] * q[0] + s->axes[1][k] * q[1] + s->axes[2][k] * q[2];
        }
        set_point(points, i, p);
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// The comparison

/// What double arithmetic may lose. On axes that are not along the coordinates u is off by rounding of the height too,
/// which steep surfaces (heights many times the pitch) turn back into height.
static double tolerance(const struct canopy_surrogate *s, double size) {
    const bool along = fabs(s->axes[2][0]) + fabs(s->axes[2][1]) + fabs(s->axes[2][2]) == 1.0;
    const double steep = along ? 0.0 : size * (1.0 / s->pitch[0] + 1.0 / s->pitch[1]);
    return size * (1e-11 + 1e-14 * steep) * (1.0 + (double)s->window_count);
}

/// Everything the module says about these points is what the naive evaluation says. Returns how many GMP had to decide.
static uint64_t compare(const struct canopy_surrogate *s, const struct points *points) {
    struct canopy_exact *exact = canopy_exact_open(s);
    assert_non_null(exact);
    struct canopy_exact_result r = canopy_exact_begin();
    canopy_exact_add(exact, &points->cloud, &r);
    static double heights[POINTS];
    canopy_exact_heights(exact, &points->cloud, heights);
    mpq_t margin, least, sum, t;
    mpq_inits(margin, least, sum, t, NULL);
    uint64_t wrong = 0, outside = 0, first_wrong = UINT64_MAX, first_outside = UINT64_MAX;
    double size = 0.0;
    for (size_t i = 0; i < (size_t)s->size[0] * s->size[1]; i++) {
        size = fmax(size, fabs(s->coefficients[i]) * s->lsb);
    }
    for (size_t i = 0; i < points->cloud.count; i++) {
        double p[3];
        get_point(points, i, p);
        if (!naive_margin(s, p, margin)) {
            assert_true(isnan(heights[i]));
            first_outside = outside++ == 0 ? i : first_outside;
            continue;
        }
        assert_false(isnan(heights[i]));
        if (mpq_sgn(margin) < 0) {
            first_wrong = wrong++ == 0 ? i : first_wrong;
        }
        if (i == outside || mpq_cmp(margin, least) < 0) {
            mpq_set(least, margin);
        }
        mpq_add(sum, sum, margin);
        double height = 0.0;
        for (int k = 0; k < 3; k++) {
            height += s->axes[2][k] * (p[k] - s->origin[k]);
            size = fmax(size, fabs(p[k]) + fabs(s->origin[k]));
        }
        const double signed_margin = s->side == CANOPY_ABOVE ? heights[i] - height : height - heights[i];
        assert_true(fabs(signed_margin - mpq_get_d(margin)) <= tolerance(s, size));
    }
    assert_int_equal(r.points, points->cloud.count);
    assert_int_equal(r.wrong, wrong);
    assert_int_equal(r.outside, outside);
    assert_int_equal(r.first_wrong, first_wrong);
    assert_int_equal(r.first_outside, first_outside);
    if (outside < points->cloud.count) {
        mpq_set_d(t, r.margin);
        assert_true(mpq_cmp(t, least) <= 0);                             // a true lower bound …
        assert_true(mpq_get_d(least) - r.margin <= tolerance(s, size));  // … and a close one
        assert_true(fabs(r.gap_sum - mpq_get_d(sum)) <= tolerance(s, size) * (double)points->cloud.count);
    }
    mpq_clears(margin, least, sum, t, NULL);
    canopy_exact_close(exact);
    return r.decided_by_gmp;
}

static void random_scenes(void **unused) {
    (void)unused;
    static struct scene scene;
    static struct points points;
    for (int trial = 0; trial < 90; trial++) {
        const double scale = trial % 3 == 0 ? 1.0 : trial % 3 == 1 ? 1000.0 : 1e6;
        const enum canopy_scalar scalar = trial % 2 ? CANOPY_FX : CANOPY_F32;
        draw_scene(&scene, scalar, below(7), scale, trial % 4 == 0 ? 1 + below(2) : 0);
        draw_points(&points, &scene.surrogate, scale);
        points.cloud.count = 1U + (size_t)below(POINTS);
        compare(&scene.surrogate, &points);
    }
}

/// The double nearest to the surface's height above the origin at a point, exactly computed.
static double surface_at(const struct canopy_surrogate *s, const double p[3]) {
    mpq_t margin, height;
    mpq_inits(margin, height, NULL);
    double result = nan("");
    if (naive_margin(s, p, margin)) {
        if (s->side == CANOPY_BELOW) {
            mpq_neg(margin, margin);
        }
        result = mpq_get_d(margin);  // S lsb - height
    }
    mpq_clears(margin, height, NULL);
    return result;
}

/// The origin is moved so that the surface passes within a few of the origin's ulps of one of the points, on either
/// side: such margins are far below what double evaluation can tell.
static void a_hair_beside_the_surface(void **unused) {
    (void)unused;
    static struct scene scene;
    static struct points points;
    uint64_t by_gmp = 0;
    for (int trial = 0; trial < 240; trial++) {
        struct canopy_surrogate *s = &scene.surrogate;
        draw_scene(&scene, trial % 2 ? CANOPY_FX : CANOPY_F32, below(7), 1000.0, trial % 5 == 0);
        draw_points(&points, s, 1000.0);
        points.cloud.count = 8;
        double p[3];
        get_point(&points, 3, p);
        const double off = surface_at(s, p);
        if (isnan(off)) {
            continue;
        }
        for (int k = 0; k < 3; k++) {
            s->origin[k] -= off * s->axes[2][k];
        }
        for (int step = below(5); step > 0; step--) {
            s->origin[2] = nextafter(s->origin[2], trial % 3 ? 1e9 : -1e9);
        }
        by_gmp += compare(s, &points);
    }
    assert_true(by_gmp >= 100);  // or the trials did not come close
}

/// Coefficients in multiples of 36 and points at knots: the surface is at whole heights there, which the points meet
/// exactly, miss by one unit (or one ulp of a float), on either side.
static void exact_ties(void **unused) {
    (void)unused;
    static struct scene scene;
    static struct points points;
    for (int trial = 0; trial < 60; trial++) {
        struct canopy_surrogate *s = &scene.surrogate;
        const enum canopy_scalar scalar = trial % 2 ? CANOPY_FX : CANOPY_F32;
        draw_scene(&scene, scalar, below(4), 1000.0, 0);
        s->lsb = 1.0;
        for (int i = 0; i < 64; i++) {
            scene.coefficients[i] = 36.0 * (below(2000) - 1000);
        }
        for (int k = 0; k < 3; k++) {
            s->origin[k] = below(2000) - 1000;
        }
        s->pitch[0] = 4 + below(50);
        s->pitch[1] = 4 + below(50);
        begin_points(&points, scalar);
        struct canopy_exact_result expected = canopy_exact_begin();
        for (size_t i = 0; i < POINTS; i++) {
            const double u = below((int)s->size[0]) * s->pitch[0], v = below((int)s->size[1]) * s->pitch[1];
            double p[3];
            for (int k = 0; k < 3; k++) {
                p[k] = s->origin[k] + s->axes[0][k] * u + s->axes[1][k] * v;
            }
            const double height = surface_at(s, p);
            assert_true(height == rint(height));
            for (int k = 0; k < 3; k++) {
                p[k] += height * s->axes[2][k];
            }
            set_point(&points, i, p);
            const int way = below(3) - 1;
            for (size_t k = 0; way != 0 && k < 3; k++) {
                const double up = s->axes[2][k] * way;
                if (up != 0.0 && scalar == CANOPY_FX) {
                    points.memory.fx[3 * i + k] += (int32_t)up;
                } else if (up != 0.0) {
                    points.memory.f32[3 * i + k] = nextafterf(points.memory.f32[3 * i + k], up > 0 ? 1e9F : -1e9F);
                }
            }
            expected.wrong += way == (s->side == CANOPY_ABOVE ? 1 : -1);
        }
        struct canopy_exact_result r;
        assert_true(canopy_exact_check(s, &points.cloud, &r));
        assert_int_equal(r.outside, 0);
        assert_int_equal(r.wrong, expected.wrong);
        compare(s, &points);
    }
}

/// A flat scene whose points lie in the surface: every point is a tie, none needs GMP, none is wrong.
static void flat_scene(void **unused) {
    (void)unused;
    static struct scene scene;
    static struct points points;
    draw_scene(&scene, CANOPY_F32, 0, 100.0, 0);
    struct canopy_surrogate *s = &scene.surrogate;
    s->lsb = 0.25;
    s->origin[2] = 12.0;
    for (int i = 0; i < 64; i++) {
        scene.coefficients[i] = 7.0;
    }
    draw_points(&points, s, 1.0);
    for (size_t i = 0; i < POINTS; i++) {
        points.memory.f32[3 * i + 2] = 13.75F;
    }
    assert_int_equal(compare(s, &points), 0);
    struct canopy_exact_result r;
    assert_true(canopy_exact_check(s, &points.cloud, &r));
    assert_int_equal(r.wrong, 0);
    assert_true(r.margin == 0.0);
    points.memory.f32[3 * 150 + 2] = nextafterf(13.75F, s->side == CANOPY_ABOVE ? 100.0F : 0.0F);
    points.memory.f32[3 * 150] = (float)(s->origin[0] + s->pitch[0]);
    points.memory.f32[3 * 150 + 1] = (float)(s->origin[1] + s->pitch[1]);
    assert_int_equal(compare(s, &points), 0);
    assert_true(canopy_exact_check(s, &points.cloud, &r));
    assert_int_equal(r.wrong, 1);
    assert_int_equal(r.first_wrong, 150);
}

/// Points on the frame's four edges are inside, one ulp beyond is outside; with an origin that makes p - o round, too.
static void frame_edges(void **unused) {
    (void)unused;
    static struct scene scene;
    static struct points points;
    for (int trial = 0; trial < 120; trial++) {
        struct canopy_surrogate *s = &scene.surrogate;
        draw_scene(&scene, CANOPY_F32, trial % 3 == 0 ? 4 : 0, 10.0, 0);
        if (trial % 2) {
            s->origin[0] = ldexp(uniform(0.5, 1.0), -20 - below(40));
            s->origin[1] = ldexp(-uniform(0.5, 1.0), -20 - below(40));
        }
        draw_points(&points, s, 10.0);
        for (size_t i = 0; i < 100; i++) {
            double p[3];
            const double u = (double)(i % 2) * ((double)s->size[0] - 1.0) * s->pitch[0];
            const double v = (double)(i / 2 % 2) * ((double)s->size[1] - 1.0) * s->pitch[1];
            for (int k = 0; k < 3; k++) {
                p[k] = s->origin[k] + s->axes[0][k] * u + s->axes[1][k] * v;
            }
            set_point(&points, i, p);
            for (size_t k = 0; k < 2; k++) {
                const int way = below(3) - 1;
                float *x = &points.memory.f32[3 * i + k];
                *x = way == 0 ? *x : nextafterf(*x, way > 0 ? 1e9F : -1e9F);
            }
        }
        compare(s, &points);
    }
}

/// Magnitudes for which the double bound is void: everything is decided by GMP, and right.
static void extreme_magnitudes(void **unused) {
    (void)unused;
    static struct scene scene;
    static struct points points;
    static const double SCALES[] = {1e-300, 1e300, 1e250};
    for (int trial = 0; trial < 6; trial++) {
        struct canopy_surrogate *s = &scene.surrogate;
        draw_scene(&scene, CANOPY_F32, 0, 1.0, 0);
        s->side = CANOPY_ABOVE;
        draw_points(&points, s, 1.0);
        for (int i = 0; i < 64; i++) {
            scene.coefficients[i] *= SCALES[trial / 2];
        }
        s->lsb = trial % 2 ? 1e-220 : 1.0;
        struct canopy_exact_result r;
        assert_true(canopy_exact_check(s, &points.cloud, &r));
        mpq_t margin;
        mpq_init(margin);
        uint64_t wrong = 0, outside = 0;
        for (size_t i = 0; i < POINTS; i++) {
            double p[3];
            get_point(&points, i, p);
            const bool inside = naive_margin(s, p, margin);
            outside += !inside;
            wrong += inside && mpq_sgn(margin) < 0;
        }
        mpq_clear(margin);
        assert_int_equal(r.wrong, wrong);
        assert_int_equal(r.outside, outside);
    }
}

/// Adding in pieces, separate arrays or triples: one result.
static void pieces_and_layouts(void **unused) {
    (void)unused;
    static struct scene scene;
    static struct points points;
    static float x[POINTS], y[POINTS], z[POINTS];
    draw_scene(&scene, CANOPY_F32, 0, 100.0, 0);
    draw_points(&points, &scene.surrogate, 100.0);
    for (size_t i = 0; i < POINTS; i++) {
        x[i] = points.memory.f32[3 * i];
        y[i] = points.memory.f32[3 * i + 1];
        z[i] = points.memory.f32[3 * i + 2];
    }
    struct canopy_exact_result whole, pieces = canopy_exact_begin();
    assert_true(canopy_exact_check(&scene.surrogate, &points.cloud, &whole));
    assert_true(whole.wrong > 0 && whole.outside > 0);
    struct canopy_exact *exact = canopy_exact_open(&scene.surrogate);
    assert_non_null(exact);
    for (size_t first = 0; first < POINTS; first += 77) {
        const size_t count = POINTS - first < 77 ? POINTS - first : 77;
        const struct canopy_cloud part = {
            .scalar = CANOPY_F32, .count = count, .stride = 1, .axis = {x + first, y + first, z + first}};
        canopy_exact_add(exact, &part, &pieces);
    }
    canopy_exact_close(exact);
    assert_int_equal(whole.points, pieces.points);
    assert_int_equal(whole.wrong, pieces.wrong);
    assert_int_equal(whole.outside, pieces.outside);
    assert_int_equal(whole.first_wrong, pieces.first_wrong);
    assert_int_equal(whole.first_outside, pieces.first_outside);
    assert_true(whole.margin == pieces.margin && whole.gap_max == pieces.gap_max);
    assert_true(whole.height_min == pieces.height_min && whole.height_max == pieces.height_max);
}

/// Coverage marks closed cells; heights are NaN where trim has no mark, and only there.
static void coverage_and_trim(void **unused) {
    (void)unused;
    static struct scene scene;
    static struct points points;
    static uint8_t covered[64], expected[64];
    static double heights[POINTS];
    for (int trial = 0; trial < 50; trial++) {
        struct canopy_surrogate *s = &scene.surrogate;
        draw_scene(&scene, CANOPY_F32, 0, 100.0, 0);
        draw_points(&points, s, 100.0);
        points.cloud.count = 5;
        memset(covered, 0, sizeof covered);
        memset(expected, 0, sizeof expected);
        struct canopy_rational *rational = canopy_rational_open(s);
        struct canopy_exact *exact = canopy_exact_open(s);
        assert_true(rational && exact);
        for (size_t i = 0; i < points.cloud.count; i++) {
            double p[3];
            int cell[2];
            get_point(&points, i, p);
            if (canopy_rational_inside(rational, p, cell)) {
                expected[cell[0] * (int)(s->size[1] - 1) + cell[1]] = 1;
            }
        }
        canopy_exact_coverage(exact, &points.cloud, covered);
        for (int i = 0; i < 64; i++) {
            assert_true(covered[i] >= expected[i]);  // the cells across a very close edge may be marked too
        }
        points.cloud.count = POINTS;
        s->trim = expected;
        canopy_exact_heights(exact, &points.cloud, heights);
        for (size_t i = 0; i < POINTS; i++) {
            double p[3];
            int cell[2];
            get_point(&points, i, p);
            const bool shown =
                canopy_rational_inside(rational, p, cell) && expected[cell[0] * (int)(s->size[1] - 1) + cell[1]];
            assert_int_equal(isnan(heights[i]) == 0, shown);
        }
        s->trim = NULL;
        canopy_rational_close(rational);
        canopy_exact_close(exact);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(random_scenes),      cmocka_unit_test(a_hair_beside_the_surface),
        cmocka_unit_test(exact_ties),         cmocka_unit_test(flat_scene),
        cmocka_unit_test(frame_edges),        cmocka_unit_test(extreme_magnitudes),
        cmocka_unit_test(pieces_and_layouts), cmocka_unit_test(coverage_and_trim),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
