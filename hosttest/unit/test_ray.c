// Products of 128 bits, the root finder, and what becomes of a ray: every outcome, both scalars and sides.

#include <math.h>

#include "hosttest/unit/unit.h"
#include "lib/cover/ray.h"
#include "lib/num/wide.h"

enum { M = 6, N = 5, PITCH = 1000, STEP = 16 };  // heights in 1/16 quanta

static uint32_t next_random(uint32_t *state) {
    *state = *state * 1664525U + 1013904223U;
    return *state >> 8;
}

// ---- 128 bits

UNIT(wide_quotients_are_exact) {
    uint32_t random = 1;
    for (int i = 0; i < 2000; i++) {
        const unsigned bits = next_random(&random) % 40;
        const uint64_t a = ((uint64_t)next_random(&random) << 24 | next_random(&random)) >> bits;
        const uint64_t c = ((uint64_t)next_random(&random) << 30 | next_random(&random) | 1) >> bits / 2;
        const uint64_t b = ((uint64_t)next_random(&random) << 32) % c, rest = next_random(&random) % c;
        // (b c + rest) / c = b; and a b / c is checked against the product of what it gives
        const struct canopy_wide_product bc = canopy_wide_by_digits(b, c);
        const struct canopy_wide_product sum = {bc.high + (bc.low + rest < rest), bc.low + rest};
        CHECK_EQ(canopy_wide_divide_by_digits(sum, c), b);
        CHECK_EQ(canopy_mul_div(b, c, c), b);
        const uint64_t quotient = canopy_mul_div(a, b, c);
        CHECK(!canopy_ratio_less(a, c, quotient, b > 0 ? b : 1) || b == 0);     // quotient <= a b / c
        CHECK(canopy_ratio_less(a, c, quotient + 1, b > 0 ? b : 1) || b == 0);  // and the next is not
    }
    // Where the first guess of a digit is too large by one and by two, and where its rest overflows: quotients known
    const uint64_t hard[4] = {0x8000000000000001U, 0x80000000FFFFFFFFU, 0xFFFFFFFF00000001U, 0xFFFFFFFFFFFFFFFFU};
    for (int i = 0; i < 16; i++) {
        for (uint64_t b = hard[i / 4] - 4; b != 0 && b >= hard[i / 4] - 4; b++) {
            const uint64_t c = hard[i % 4], rest = i % 2 == 0 ? 0 : c - 1, quotient = b % c;
            const struct canopy_wide_product bc = canopy_wide_by_digits(quotient, c);
            const struct canopy_wide_product sum = {bc.high + (bc.low + rest < rest), bc.low + rest};
            CHECK_EQ(canopy_wide_divide_by_digits(sum, c), quotient);
            if (b == hard[i / 4]) {
                break;
            }
        }
    }
    CHECK_EQ(canopy_mul_div(UINT64_MAX, UINT64_MAX, UINT64_MAX), UINT64_MAX);
    CHECK_EQ(canopy_mul_div(UINT64_MAX, 2, 1), UINT64_MAX);  // does not fit
    CHECK_EQ(canopy_wide_divide_by_digits((struct canopy_wide_product){UINT64_MAX - 1, 0}, UINT64_MAX), UINT64_MAX - 1);
}

UNIT(ratios_compare_exactly) {
    CHECK(canopy_ratio_less(1, UINT64_MAX, 1, UINT64_MAX - 1));
    CHECK(!canopy_ratio_less(1, UINT64_MAX - 1, 1, UINT64_MAX));
    CHECK(!canopy_ratio_less(3, 7, 3 * 12345678901ULL, 7 * 12345678901ULL));
    CHECK(canopy_ratio_less(0, 1, 1, UINT64_MAX));
}

// ---- Roots

static double bernstein(const int32_t *c, uint32_t degree, double s) {
    double w[CANOPY_ROOT_DEGREE_MAX + 1];
    for (uint32_t k = 0; k <= degree; k++) {
        w[k] = c[k];
    }
    for (uint32_t level = 1; level <= degree; level++) {
        for (uint32_t k = 0; k + level <= degree; k++) {
            w[k] += (w[k + 1] - w[k]) * s;
        }
    }
    return w[0];
}

// The nearest whole number. Not by floor(), which picolibc 1.8 has wrong: -134217727.5 becomes -134217664.
static int32_t nearest(double x) {
    const int32_t whole = (int32_t)(x + 0.5);
    return whole - (whole > x + 0.5);
}

// Coefficients of size * product (s - zero[i]) * sign, by multiplying Bernstein forms.
static void from_zeros(const double *zero, uint32_t degree, double size, int32_t *c) {
    double p[CANOPY_ROOT_DEGREE_MAX + 1] = {1};
    for (uint32_t d = 0; d < degree; d++) {
        double q[CANOPY_ROOT_DEGREE_MAX + 1];
        for (uint32_t k = 0; k <= d + 1; k++) {
            const double left = k <= d ? p[k] * (d + 1 - k) * (0 - zero[d]) : 0;
            const double right = k > 0 ? p[k - 1] * k * (1 - zero[d]) : 0;
            q[k] = (left + right) / (d + 1);
        }
        memcpy(p, q, sizeof p);
    }
    for (uint32_t k = 0; k <= degree; k++) {
        c[k] = nearest(p[k] * size);
    }
}

UNIT(a_simple_zero_is_found) {
    for (uint32_t degree = 1; degree <= CANOPY_ROOT_DEGREE_MAX; degree++) {
        for (int k = 1; k < 20; k++) {
            const double zero[6] = {k / 20.0, 1.5, 2.5, 3.5, 4.5, 5.5};  // the others are outside
            int32_t c[7];
            const double size = (degree % 2 == 0 ? -0x1p20 : 0x1p20) * (degree % 2 == 0 ? -1 : -1);
            from_zeros(zero, degree, size, c);
            if (c[0] < 0) {
                for (uint32_t i = 0; i <= degree; i++) {
                    c[i] = -c[i];
                }
            }
            const struct canopy_root root = canopy_root_first(c, degree, 16);
            CHECK(root.found && root.settled && root.steps <= 9);
            const double at = root.at / 1073741824.0;
            CHECK(at <= zero[0] + 1e-6);
            CHECK(bernstein(c, degree, at) >= -0.01);
            CHECK(bernstein(c, degree, at) <= 17 + CANOPY_ROOT_LOSS(6));
            CHECK_NEAR(at, zero[0], 3e-3);
        }
    }
}

// Before the first zero the polynomial comes down close to 0 once and twice: neither is taken for a zero, and the zero
// behind is not missed. A dip below 0 between two zeros is not jumped over.
UNIT(dips_are_told_from_zeros) {
    const double deep[6] = {0.31, 0.33, 0.6, 1.7, 2.0, 3.0};
    int32_t c[7], lifted[7];
    from_zeros(deep, 6, 0x1p29, c);
    const struct canopy_root first = canopy_root_first(c, 6, 16);
    CHECK(first.found && first.settled);
    CHECK_NEAR(first.at / 1073741824.0, 0.31, 1e-3);
    const double lowest = bernstein(c, 6, 0.32);
    CHECK(lowest < 0);
    for (int i = 0; i < 7; i++) {
        lifted[i] = c[i] + (int32_t)(-lowest) + 2000;  // now the dip stays above 0
    }
    const struct canopy_root second = canopy_root_first(lifted, 6, 16);
    CHECK(second.found && second.settled);
    CHECK_NEAR(second.at / 1073741824.0, 0.6, 0.02);
    CHECK(bernstein(lifted, 6, second.at / 1073741824.0) >= -0.01);
}

// Any polynomial, seen at many places: positive before the zero that is found, and everywhere if there is none.
static void check_first(const int32_t *c, uint32_t degree) {
    const struct canopy_root root = canopy_root_first(c, degree, 16);
    const double end = root.found ? root.at / 1073741824.0 : 1.0;
    for (int i = 0; i < 100; i++) {
        CHECK(bernstein(c, degree, end * i / 100) > -1e-3);
    }
    if (root.found && root.settled) {
        CHECK(bernstein(c, degree, end) <= 16 + CANOPY_ROOT_LOSS(6) + 64);  // `at` is rounded down: 64 for the slope
    }
}

UNIT(nothing_is_passed_over) {
    uint32_t random = 5;
    for (int round = 0; round < 400; round++) {
        int32_t c[7];
        double zero[6];
        for (int k = 0; k < 7; k++) {  // all signs
            c[k] = (int32_t)(next_random(&random) & 0xFFFFF) - (k == 0 ? 0 : 0x60000);
        }
        check_first(c, 6);
        for (int k = 0; k < 6; k++) {  // zeros in pairs, close or far, wherever
            const double any = (double)(next_random(&random) & 0xFFFF) / 0x10000;
            const double near = (double)(next_random(&random) & 0xFFFF) / 0x10000;
            zero[k] = k % 2 == 0 ? 1.5 * any : zero[k - 1] + near * near * near * near;
        }
        from_zeros(zero, 6, 0x1p26, c);
        check_first(c, 6);
        const int32_t lift = (int32_t)(next_random(&random) & 0xFFF);
        for (int k = 0; k < 7; k++) {
            c[k] += lift;
        }
        check_first(c, 6);
    }
}

UNIT(no_zero_is_proved_where_the_polygon_dips) {
    // 1 - 4 s (1 - s) (1 - e): least e at 1/2; its control polygon goes far below 0
    for (int e = 1; e < 1000; e *= 3) {
        const int32_t one = 1 << 24, dip = one - 2 * (one - e * 100);
        const int32_t c[3] = {one, dip, one};
        const struct canopy_root root = canopy_root_first(c, 2, 16);
        CHECK(!root.found);
    }
    const int32_t touching[3] = {1 << 24, -(1 << 24), 1 << 24};  // a double zero is one
    const struct canopy_root root = canopy_root_first(touching, 2, 16);
    CHECK(root.found);
    CHECK_NEAR(root.at / 1073741824.0, 0.5, 2e-3);
}

UNIT(zeros_of_high_order_are_not_passed) {
    for (uint32_t order = 2; order <= 6; order++) {
        const double zero[6] = {0.5, 0.5, 0.5, 0.5, 0.5, 0.5};
        int32_t c[7];
        from_zeros(zero, order, order % 2 == 0 ? 0x1p29 : -0x1p29, c);
        const struct canopy_root root = canopy_root_first(c, order, 64);
        CHECK(root.found && root.steps <= CANOPY_ROOT_STEPS);
        CHECK(root.at <= (1 << 29) + 1000);
        CHECK(bernstein(c, order, root.at / 1073741824.0) < 0x1p12);
    }
}

UNIT(ends_are_zeros_too) {
    const int32_t start[4] = {0, 5000, 5000, 5000}, under[2] = {-1, 1000000}, end[3] = {3000, 2000, 0};
    CHECK(canopy_root_first(start, 3, 16).found && canopy_root_first(start, 3, 16).at == 0);
    CHECK(canopy_root_first(under, 1, 16).found && canopy_root_first(under, 1, 16).at == 0);
    const struct canopy_root root = canopy_root_first(end, 2, 16);
    CHECK(root.found);
    CHECK_NEAR(root.at / 1073741824.0, 1.0, 0.02);
    const int32_t limits[7] = {CANOPY_ROOT_LIMIT, -CANOPY_ROOT_LIMIT, CANOPY_ROOT_LIMIT, -CANOPY_ROOT_LIMIT,
                               CANOPY_ROOT_LIMIT, -CANOPY_ROOT_LIMIT, CANOPY_ROOT_LIMIT};
    const struct canopy_root wild = canopy_root_first(limits, 6, 16);
    CHECK(wild.found && bernstein(limits, 6, wild.at / 1073741824.0) >= 0);
}

// ---- Rays

static int32_t coefficients[M * N];
static uint8_t coverage[CANOPY_COVERAGE_BYTES(M, N)];

// A plane: b[i][j] = 16 (100 + 10 i + 20 j) steps, which a spline with repeated ends follows inside.
static struct canopy_envelope plane(enum canopy_side side) {
    for (int i = 0; i < M; i++) {
        for (int j = 0; j < N; j++) {
            coefficients[i * N + j] = STEP * (100 + 10 * i + 20 * j);
        }
    }
    memset(coverage, 0, sizeof coverage);
    coverage[0] = 1U << (1 * (N - 1) + 1);  // the cell 1, 1
    return (struct canopy_envelope){
        .frame = {.pitch = {PITCH, PITCH},
                  .size = {M, N},
                  .cells = 4,
                  .lsb_log2 = -4,
                  .side = (uint8_t)side,
                  .axis = {{CANOPY_AXIS_ONE, 0, 0}, {0, CANOPY_AXIS_ONE, 0}, {0, 0, CANOPY_AXIS_ONE}}},
        .scalar = CANOPY_FX,
        .coefficients = coefficients,
        .coverage = coverage};
}

static struct canopy_ray_hit cast(const struct canopy_envelope *e, int64_t x, int64_t y, int64_t z, int32_t dx,
                                  int32_t dy, int32_t dz) {
    const int64_t from[3] = {x, y, z};
    const int32_t along[3] = {dx, dy, dz};
    struct canopy_ray_hit hit, single;
    const enum canopy_status status = canopy_ray_first_fx(e, from, along, &hit);
    CHECK_EQ(status, hit.outcome <= CANOPY_RAY_ENTERS_UNDER ? CANOPY_OK : CANOPY_ARGUMENT);
    // The same in float, which holds these numbers.
    const float start[3] = {(float)x, (float)y, (float)z}, way[3] = {(float)dx, (float)dy, (float)dz};
    CHECK_EQ(canopy_ray_first_f32(e, start, way, &single), status);
    CHECK_EQ(single.outcome, hit.outcome);
    if (canopy_ray_is_hit(&hit)) {
        CHECK_NEAR(canopy_ray_t_f32(&single), canopy_ray_t_f32(&hit), 1e-5 * (1.0 + (double)canopy_ray_t_f32(&hit)));
        CHECK_EQ(single.place[0].interval, hit.place[0].interval);
        CHECK_EQ(single.place[1].interval, hit.place[1].interval);
    }
    return hit;
}

UNIT(a_ray_down_hits_where_the_surface_is) {
    const struct canopy_envelope e = plane(CANOPY_ABOVE);
    struct canopy_ray_hit hit = cast(&e, 1500, 1500, 1000, 0, 0, -1);  // the surface is at 100 + 15 + 30
    CHECK_EQ(hit.outcome, CANOPY_RAY_HIT);
    CHECK(hit.covered && hit.settled);
    CHECK_EQ(hit.place[0].interval, 1);
    CHECK_EQ(hit.place[1].s, 1 << 29);
    CHECK_NEAR(hit.height, 145 * STEP, 1);
    CHECK_NEAR(canopy_ray_t_f32(&hit), 855.0, 1e-3);
    CHECK_EQ(hit.gradient[0], 10 * STEP);
    CHECK_EQ(hit.gradient[1], 20 * STEP);
    float normal[3];
    canopy_ray_normal_f32(&e.frame, &hit, normal);
    const double size = sqrt(1 + 0.01 * 0.01 + 0.02 * 0.02);
    CHECK_NEAR(normal[0], -0.01 / size, 1e-6);
    CHECK_NEAR(normal[1], -0.02 / size, 1e-6);
    CHECK_NEAR(normal[2], 1 / size, 1e-6);
    hit = cast(&e, 2500, 1500, 1000, 0, 0, -7);
    CHECK(hit.outcome == CANOPY_RAY_HIT && !hit.covered);
}

UNIT(a_slanting_ray_hits_where_the_surface_is) {
    const struct canopy_envelope e = plane(CANOPY_ABOVE);
    // z = 300 - x/10 at y = 2000, S = 140 + x/100: they meet at x = 160 / 0.11, where the spline is the plane
    const struct canopy_ray_hit hit = cast(&e, 0, 2000, 300, 10, 0, -1);
    CHECK_EQ(hit.outcome, CANOPY_RAY_HIT);
    const double x = 160 / 0.11;
    CHECK_NEAR(canopy_ray_t_f32(&hit), x / 10, 1e-3);
    CHECK_NEAR(((double)hit.place[0].interval + hit.place[0].s / 1073741824.0) * PITCH, x, 1e-2);
    CHECK((double)canopy_ray_t_f32(&hit) <= x / 10 + 1e-4);
}

UNIT(the_side_below_is_the_mirror) {
    const struct canopy_envelope e = plane(CANOPY_BELOW);
    struct canopy_ray_hit hit = cast(&e, 1500, 1500, -1000, 0, 0, 1);
    CHECK_EQ(hit.outcome, CANOPY_RAY_HIT);
    CHECK_NEAR(hit.height, 145 * STEP, 1);
    CHECK_NEAR(canopy_ray_t_f32(&hit), 1145.0, 1e-2);
    float normal[3];
    canopy_ray_normal_f32(&e.frame, &hit, normal);
    CHECK(normal[2] < 0.0f && normal[0] > 0.0f);
    hit = cast(&e, 1500, 1500, -1000, 0, 0, -1);
    CHECK_EQ(hit.outcome, CANOPY_RAY_FREE);
    hit = cast(&e, 1500, 1500, 1000, 1, 0, 0);
    CHECK_EQ(hit.outcome, CANOPY_RAY_STARTS_UNDER);
}

UNIT(every_outcome_has_its_ray) {
    struct canopy_envelope e = plane(CANOPY_ABOVE);
    CHECK_EQ(cast(&e, 0, 0, 1000, 1, 1, 0).outcome, CANOPY_RAY_FREE);       // level, above
    CHECK_EQ(cast(&e, -5, 100, 1000, 10, 0, 1).outcome, CANOPY_RAY_FREE);   // from beside, going up
    CHECK_EQ(cast(&e, -1, 100, 0, -1, 0, 0).outcome, CANOPY_RAY_BESIDE);    // away from the frame
    CHECK_EQ(cast(&e, -1, 100, 900, 0, 0, -1).outcome, CANOPY_RAY_BESIDE);  // down beside it
    CHECK_EQ(cast(&e, -1000, -10, 0, 1, 0, 0).outcome, CANOPY_RAY_BESIDE);  // past it
    CHECK_EQ(cast(&e, 1500, 1500, 0, 0, 0, 1).outcome, CANOPY_RAY_STARTS_UNDER);
    CHECK_EQ(cast(&e, 1500, 1500, 145, 0, 0, 1).outcome, CANOPY_RAY_STARTS_UNDER);  // on it
    CHECK_EQ(cast(&e, -1000, 1500, 0, 1, 0, 0).outcome, CANOPY_RAY_ENTERS_UNDER);
    CHECK_EQ(cast(&e, -1000, 1500, 900, 1, 0, -1).outcome, CANOPY_RAY_ENTERS_UNDER);
    CHECK_EQ(cast(&e, -1000, 1500, 900, 1, 0, -1000000).outcome, CANOPY_RAY_ENTERS_UNDER);  // far below by then
    CHECK_EQ(cast(&e, 1, 2, 3, 0, 0, 0).outcome, CANOPY_RAY_NO_DIRECTION);
    const int64_t far[3] = {CANOPY_RAY_FX_MAX + 1, 0, 0};
    const int32_t down[3] = {0, 0, -1};
    struct canopy_ray_hit hit;
    CHECK_EQ(canopy_ray_first_fx(&e, far, down, &hit), CANOPY_ARGUMENT);
    CHECK_EQ(hit.outcome, CANOPY_RAY_TOO_FAR);
    const float away[3] = {1e30f, 0.0f, 0.0f}, back[3] = {-1.0f, 0.0f, 0.0f};
    CHECK_EQ(canopy_ray_first_f32(&e, away, back, &hit), CANOPY_ARGUMENT);
    CHECK_EQ(hit.outcome, CANOPY_RAY_TOO_FAR);
    const float bad[3] = {0.0f, NAN, 0.0f}, wide[3] = {0.0f, 1.0f, INFINITY};
    CHECK_EQ(canopy_ray_first_f32(&e, bad, back, &hit), CANOPY_ARGUMENT);
    CHECK_EQ(hit.outcome, CANOPY_RAY_NOT_FINITE);
    CHECK_EQ(canopy_ray_first_f32(&e, back, wide, &hit), CANOPY_ARGUMENT);
    CHECK_EQ(hit.outcome, CANOPY_RAY_NOT_FINITE);
    coefficients[7] = CANOPY_COEFFICIENT_LIMIT + 1;
    CHECK_EQ(cast(&e, 1500, 1500, 1000, 0, 0, -1).outcome, CANOPY_RAY_BAD_ENVELOPE);
    coefficients[7] = INT32_MIN;
    CHECK_EQ(cast(&e, 1500, 1500, 300, 0, 0, -1).outcome, CANOPY_RAY_BAD_ENVELOPE);
    e.frame.size[0] = 3;
    CHECK_EQ(cast(&e, 1500, 1500, 1000, 0, 0, -1).outcome, CANOPY_RAY_BAD_ENVELOPE);
}

// Along knot lines, through corners, along the frame's edges, and on the plane itself.
UNIT(knot_lines_and_corners_are_no_gaps) {
    const struct canopy_envelope e = plane(CANOPY_ABOVE);
    for (int32_t k = 0; k < M; k++) {
        const struct canopy_ray_hit along = cast(&e, k * PITCH, -100, 1000, 0, 10, -6);
        CHECK_EQ(along.outcome, CANOPY_RAY_HIT);
    }
    for (int32_t k = 0; k < N; k++) {
        const struct canopy_ray_hit along = cast(&e, 5 * PITCH, k * PITCH, 1000, -10, 0, -6);
        CHECK_EQ(along.outcome, CANOPY_RAY_HIT);
    }
    const struct canopy_ray_hit corner = cast(&e, 0, 0, 1000, 1, 1, -1);  // through corners: 1000 - x = 100 + 0.03 x
    CHECK_EQ(corner.outcome, CANOPY_RAY_HIT);
    const struct canopy_ray_hit into = cast(&e, 2 * PITCH + 400, 2 * PITCH + 400, 160 + 400, -1, -1, -1);
    CHECK_EQ(into.outcome, CANOPY_RAY_HIT);  // the corner 2, 2 itself: S = 160
    CHECK_NEAR(canopy_ray_t_f32(&into), 388.0, 400.0 * 0.04);
    const struct canopy_ray_hit touch = cast(&e, 2500, 0, 126, 0, 50, 1);  // in the plane where that is straight
    CHECK(canopy_ray_is_hit(&touch));
}

UNIT(segments_end) {
    const struct canopy_envelope e = plane(CANOPY_ABOVE);
    const int64_t high[3] = {1500, 1500, 1000}, low[3] = {1500, 1500, 100}, just[3] = {1500, 1500, 146},
                  beside[3] = {-10, -10, 0}, away[3] = {-500, -10, -1000};
    struct canopy_ray_hit hit;
    CHECK(!canopy_ray_is_free_fx(&e, high, low, &hit));
    CHECK_EQ(hit.outcome, CANOPY_RAY_HIT);
    CHECK_NEAR(canopy_ray_t_f32(&hit), 855.0 / 900.0, 1e-5);
    CHECK(canopy_ray_is_free_fx(&e, high, just, &hit));
    CHECK(canopy_ray_is_free_fx(&e, high, just, NULL));
    CHECK(canopy_ray_is_free_fx(&e, high, high, &hit));  // a point
    CHECK(!canopy_ray_is_free_fx(&e, low, low, &hit));
    CHECK(canopy_ray_is_free_fx(&e, beside, away, &hit));
    CHECK_EQ(hit.outcome, CANOPY_RAY_BESIDE);
    const float from[3] = {1500.0f, 1500.0f, 1000.0f}, to[3] = {1500.0f, 1500.0f, 145.25f},
                under[3] = {1600.0f, 900.0f, 2.0f}, nan[3] = {0.0f, 0.0f, NAN};
    CHECK(canopy_ray_is_free_f32(&e, from, to, &hit));
    CHECK(!canopy_ray_is_free_f32(&e, from, under, &hit));
    CHECK(!canopy_ray_is_free_f32(&e, from, nan, &hit));
    CHECK_EQ(hit.outcome, CANOPY_RAY_NOT_FINITE);
}

// A ray that just misses a flat top, by less than can be told, is a hit; by more it is free.
UNIT(touching_is_decided_on_the_safe_side) {
    struct canopy_envelope e = plane(CANOPY_ABOVE);
    for (int i = 0; i < M * N; i++) {
        coefficients[i] = 1600;
    }
    const float level[3] = {1.0f, 0.3f, 0.0f};
    const float at[3] = {0.0f, 0.0f, 100.0f}, above[3] = {0.0f, 0.0f, 100.0625f},
                close[3] = {0.0f, 0.0f, 100.0f + 0x1p-17f};
    struct canopy_ray_hit hit;
    CHECK_EQ(canopy_ray_first_f32(&e, at, level, &hit), CANOPY_OK);
    CHECK_EQ(hit.outcome, CANOPY_RAY_STARTS_UNDER);
    CHECK_EQ(canopy_ray_first_f32(&e, above, level, &hit), CANOPY_OK);  // one step
    CHECK_EQ(hit.outcome, CANOPY_RAY_FREE);
    CHECK_EQ(canopy_ray_first_f32(&e, close, level, &hit), CANOPY_OK);
    CHECK(canopy_ray_is_hit(&hit));
    // A hill: a ray over its top by 16 steps is free, one through it by 16 is not
    coefficients[2 * N + 2] = 1600 + 16 * 600;
    int32_t height[2], gradient[2];
    CHECK_EQ(canopy_envelope_height(&e, 2 * PITCH, 2 * PITCH, &height[0], &height[1]), CANOPY_OK);
    (void)gradient;
    const double top = (double)(height[0] + height[1]) / 2 / STEP;
    const float over[3] = {-100.0f, 2000.0f, (float)(top + 1)}, through[3] = {-100.0f, 2000.0f, (float)(top - 1)};
    const float across[3] = {1.0f, 0.0f, 0.0f};
    CHECK_EQ(canopy_ray_first_f32(&e, over, across, &hit), CANOPY_OK);
    CHECK_EQ(hit.outcome, CANOPY_RAY_FREE);
    CHECK_EQ(canopy_ray_first_f32(&e, through, across, &hit), CANOPY_OK);
    CHECK_EQ(hit.outcome, CANOPY_RAY_HIT);
    CHECK(hit.settled);
}

UNIT_LIST(ray, wide_quotients_are_exact, ratios_compare_exactly, a_simple_zero_is_found, dips_are_told_from_zeros,
          nothing_is_passed_over, no_zero_is_proved_where_the_polygon_dips, zeros_of_high_order_are_not_passed,
          ends_are_zeros_too, a_ray_down_hits_where_the_surface_is, a_slanting_ray_hits_where_the_surface_is,
          the_side_below_is_the_mirror, every_outcome_has_its_ray, knot_lines_and_corners_are_no_gaps, segments_end,
          touching_is_decided_on_the_safe_side)
