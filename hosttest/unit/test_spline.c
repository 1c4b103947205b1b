// The basis, the surface with its gradient, and the bound of Lemmas 4.1 and 5.1, in both scalars.

#include "hosttest/unit/unit.h"
#include "lib/num/fixed.h"
#include "lib/spline/bezier.h"
#include "lib/spline/bound.h"
#include "lib/spline/surface.h"

enum { M = 5, N = 6 };

static uint32_t next_random(uint32_t *state) {
    *state = *state * 1664525U + 1013904223U;
    return *state >> 8;
}

static void random_grid(uint32_t seed, int32_t *b, size_t count, int32_t size) {
    for (size_t i = 0; i < count; i++) {
        b[i] = (int32_t)(next_random(&seed) % (2U * (uint32_t)size + 1U)) - size;
    }
}

// The four B-splines in double, from their textbook form.
static void reference_basis(double s, double w[4]) {
    w[0] = (1 - s) * (1 - s) * (1 - s) / 6;
    w[1] = (3 * s * s * s - 6 * s * s + 4) / 6;
    w[2] = (-3 * s * s * s + 3 * s * s + 3 * s + 1) / 6;
    w[3] = s * s * s / 6;
}

static double reference_surface(const int32_t *b, double u, double v) {
    int h = (int)u, k = (int)v;
    h = h < M - 1 ? h : M - 2;
    k = k < N - 1 ? k : N - 2;
    double wu[4], wv[4], sum = 0;
    reference_basis(u - h, wu);
    reference_basis(v - k, wv);
    for (int a = 0; a < 4; a++) {
        for (int c = 0; c < 4; c++) {
            int i = h + a - 1, j = k + c - 1;
            i = i < 0 ? 0 : i < M ? i : M - 1;
            j = j < 0 ? 0 : j < N ? j : N - 1;
            sum += wu[a] * wv[c] * b[i * N + j];
        }
    }
    return sum;
}

UNIT(basis_is_a_partition_of_one) {
    for (int32_t k = 0; k <= 64; k++) {
        const int32_t s = (int32_t)(((int64_t)k << 30) / 64);
        int32_t w[4], d[4];
        canopy_basis_fx(s, w, d);
        CHECK_EQ((int64_t)w[0] + w[1] + w[2] + w[3], CANOPY_UNIT_Q30);
        CHECK_EQ((int64_t)d[0] + d[1] + d[2] + d[3], 0);
        double expected[4];
        reference_basis(k / 64.0, expected);
        float wf[4], df[4];
        canopy_basis_f32((float)k / 64.0f, wf, df);
        for (int i = 0; i < 4; i++) {
            CHECK_NEAR(w[i] / 1073741824.0, expected[i], 5.3 / 1073741824.0);
            CHECK_NEAR(wf[i], expected[i], 1e-6);
            CHECK_NEAR(d[i] / 1073741824.0, df[i], 1e-6);
        }
    }
}

UNIT(places_are_inside_their_interval) {
    for (uint32_t pitch = 1; pitch < 4000000000U; pitch = pitch * 7 + 3) {
        for (uint32_t k = 0; k <= 12; k++) {
            const uint64_t offset = (uint64_t)pitch * k / 4;
            if (offset > UINT32_MAX) {
                break;
            }
            const struct canopy_place p = canopy_place_of((uint32_t)offset, pitch, 4);
            CHECK(p.interval <= 2 && p.s >= 0 && p.s <= CANOPY_UNIT_Q30);
            const double back = (double)p.interval + p.s / 1073741824.0;
            CHECK_NEAR(back, (double)offset / pitch, 1.0 / 1073741824.0);
        }
    }
    const struct canopy_place end = canopy_place_of(300, 100, 4);
    CHECK_EQ(end.interval, 2);
    CHECK_EQ(end.s, CANOPY_UNIT_Q30);
}

UNIT(surface_is_within_its_stated_error) {
    const uint16_t size[2] = {M, N};
    int32_t b[M * N];
    for (uint32_t seed = 1; seed <= 40; seed++) {
        random_grid(seed, b, M * N, seed % 2 == 0 ? 1 << 28 : 1000);
        uint32_t random = seed;
        for (int i = 0; i < 25; i++) {
            const uint32_t pitch = 1 + next_random(&random) % 100000;
            const uint32_t x = next_random(&random) % (pitch * (M - 1) + 1),
                           y = next_random(&random) % (pitch * (N - 1) + 1);
            const struct canopy_place u = canopy_place_of(x, pitch, M), v = canopy_place_of(y, pitch, N);
            const int32_t got = canopy_surface_fx(b, size, &u, &v, NULL);
            const double expected = reference_surface(b, (double)x / pitch, (double)y / pitch);
            CHECK_NEAR(got, expected, CANOPY_SURFACE_FX_ERROR);
            const uint32_t interval[2] = {u.interval, v.interval};
            const float s[2] = {(float)u.s / 1073741824.0f, (float)v.s / 1073741824.0f};
            const float value = canopy_surface_f32(b, size, interval, s, NULL);
            CHECK_NEAR(value, expected, seed % 2 == 0 ? 256.0 : 0.001);
        }
    }
}

UNIT(gradient_is_the_slope) {
    const uint16_t size[2] = {M, N};
    int32_t b[M * N];
    random_grid(7, b, M * N, 1 << 24);
    const double step = 1.0 / 4096;
    for (int32_t k = 1; k < 60; k++) {
        const double u = k * (M - 1) / 60.0 + 1e-3, v = (60 - k) * (N - 1) / 60.0 + 1e-3;
        const double by_u = (reference_surface(b, u + step, v) - reference_surface(b, u - step, v)) / (2 * step);
        const double by_v = (reference_surface(b, u, v + step) - reference_surface(b, u, v - step)) / (2 * step);
        const uint32_t h = (uint32_t)u, l = (uint32_t)v;
        const struct canopy_place pu = {h, (int32_t)((u - h) * 1073741824.0)};
        const struct canopy_place pv = {l, (int32_t)((v - l) * 1073741824.0)};
        int32_t gradient[2];
        (void)canopy_surface_fx(b, size, &pu, &pv, gradient);
        CHECK_NEAR(gradient[0], by_u, 64.0);
        CHECK_NEAR(gradient[1], by_v, 64.0);
        const uint32_t interval[2] = {h, l};
        const float s[2] = {(float)(u - h), (float)(v - l)};
        float slope[2];
        (void)canopy_surface_f32(b, size, interval, s, slope);
        CHECK_NEAR(slope[0], by_u, 64.0);
        CHECK_NEAR(slope[1], by_v, 64.0);
    }
}

// f at h + k/q in units of 1/(6 q^3), from the B-splines themselves: exact.
static int64_t spline_exact(const int32_t *b, int n, int h, int64_t k, int64_t q) {
    const int64_t r = q - k;
    const int64_t w[4] = {r * r * r, 3 * k * k * k - 6 * k * k * q + 4 * q * q * q,
                          -3 * k * k * k + 3 * k * k * q + 3 * k * q * q + q * q * q, k * k * k};
    int64_t sum = 0;
    for (int a = 0; a < 4; a++) {
        const int i = h + a - 1;
        sum += w[a] * b[i < 0 ? 0 : i < n ? i : n - 1];
    }
    return sum;
}

static int64_t bound_at(const int32_t *b, int n, int h, int64_t k, int64_t q) {
    const uint32_t at = (uint32_t)h;
    return canopy_bound_exact(b, at, canopy_bend(b, (uint32_t)n, at), canopy_bend(b, (uint32_t)n, at + 1), (int32_t)k,
                              (int32_t)q);
}

// Lemma 5.1 with breakpoints at k/4, seen at 1/32: the straight line between neighbouring breakpoints is below f.
UNIT(bound_is_below_the_spline_between_breakpoints) {
    int32_t b[N];
    for (uint32_t seed = 1; seed <= 100; seed++) {
        random_grid(seed, b, N, 1 << 28);
        for (int h = 0; h + 1 < N; h++) {
            for (int64_t k = 0; k < 4; k++) {
                const int64_t from = bound_at(b, N, h, k, 4), to = bound_at(b, N, h, k + 1, 4);  // 1/(6 * 64)
                for (int64_t i = 0; i <= 8; i++) {
                    const int64_t line = (8 - i) * from + i * to;                         // 1/(6 * 64 * 8)
                    CHECK(spline_exact(b, N, h, 8 * k + i, 32) >= line * (32768 / 512));  // 1/(6 * 32768)
                }
            }
        }
    }
}

UNIT(bound_never_falls_when_a_coefficient_rises) {
    int32_t b[N];
    for (uint32_t seed = 1; seed <= 100; seed++) {
        random_grid(seed, b, N, 1000);
        for (int i = 0; i < N; i++) {
            int32_t raised[N];
            memcpy(raised, b, sizeof b);
            raised[i] += 77;
            for (int h = 0; h + 1 < N; h++) {
                for (int64_t k = 0; k <= 4; k++) {
                    CHECK(bound_at(raised, N, h, k, 4) >= bound_at(b, N, h, k, 4));
                }
            }
        }
    }
}

// De Casteljau's scheme over cell k of q, against the spline itself.
UNIT(bernstein_coefficients_are_those_of_the_spline) {
    uint32_t random = 5;
    for (uint16_t q = 1; q <= 32; q++) {
        static int32_t table[3 * CANOPY_BEZIER_LATTICE(32)];
        int32_t b[4];
        canopy_bezier_weights(table, q);
        random_grid(random++, b, 4, q % 2 == 0 ? 1 << 28 : 1000);
        for (uint32_t k = 0; k < q; k++) {
            double c[4];
            for (uint32_t i = 0; i < 4; i++) {
                c[i] = canopy_bezier_floor(b[0], b[1], b[2], b[3], table + 3 * (3 * k + i));
            }
            for (int i = 0; i <= 8; i++) {
                const double t = i / 8.0, r = 1 - t;
                double w[4];
                reference_basis((k + t) / q, w);
                const double there = w[0] * b[0] + w[1] * b[1] + w[2] * b[2] + w[3] * b[3];
                const double low = r * r * r * c[0] + 3 * r * r * t * c[1] + 3 * r * t * t * c[2] + t * t * t * c[3];
                CHECK(low <= there + 1e-6 && there < low + 3);
            }
        }
    }
}

UNIT(bernstein_coefficients_rise_with_the_spline) {
    static int32_t table[3 * CANOPY_BEZIER_LATTICE(8)];
    canopy_bezier_weights(table, 8);
    for (uint32_t p = 0; p < CANOPY_BEZIER_LATTICE(8); p++) {
        const int32_t *w = table + 3 * p, high = 1 << 28;
        CHECK(w[0] >= 0 && w[1] >= 0 && w[2] >= 0 && w[0] + w[1] + w[2] <= CANOPY_UNIT_Q30);
        CHECK_EQ(canopy_bezier_floor(-high, -high, -high, -high, w), -high - 1);
        CHECK_EQ(canopy_bezier_floor(high, high, high, high, w), high - 1);
        CHECK_EQ(canopy_bezier_floor(11, 7, -5, 3, w) + 1000, canopy_bezier_floor(1011, 1007, 995, 1003, w));
    }
}

UNIT_LIST(spline, basis_is_a_partition_of_one, places_are_inside_their_interval, surface_is_within_its_stated_error,
          gradient_is_the_slope, bound_is_below_the_spline_between_breakpoints,
          bound_never_falls_when_a_coefficient_rises, bernstein_coefficients_are_those_of_the_spline,
          bernstein_coefficients_rise_with_the_spline)
