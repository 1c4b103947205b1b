/// The piecewise linear lower bound of a uniform cubic spline: paper S0, Lemmas 4.1 and 5.1.
///
/// Coefficients b[0] … b[n-1] at 0 … n-1, the end ones repeated once outside; D[i] = b[i-1] - 2 b[i] + b[i+1]. Then
///
///     l(h + s) = (1-s) b[h] + s b[h+1] + (1-s)^3 min(D[h], 0)/6 + s^3 min(D[h+1], 0)/6   <=   f(h + s),
///
/// and between two breakpoints of one knot interval f stays above the straight line through the values of l there,
/// because (1-s)^3 and s^3 are convex. At a knot (s = 0) this is Lemma 4.1. l falls nowhere when a coefficient rises.
#ifndef CANOPY_SPLINE_BOUND_H
#define CANOPY_SPLINE_BOUND_H

#include <stdint.h>

/// min(D[i], 0), exact.
static inline int64_t canopy_bend(const int32_t *b, uint32_t n, uint32_t i) {
    const int32_t before = b[i > 0 ? i - 1 : 0], after = b[i + 1 < n ? i + 1 : i];
    const int64_t second = (int64_t)before - 2 * (int64_t)b[i] + after;
    return second < 0 ? second : 0;
}

/// l at h + k/q, exact, in units of 1/(6 q^3): for |b| <= 2^28 and q <= 32 it has at most 48 bits.
/// `left` and `right` are canopy_bend of h and of h + 1.
static inline int64_t canopy_bound_exact(const int32_t *b, uint32_t h, int64_t left, int64_t right, uint32_t k,
                                         uint32_t q) {
    const int64_t r = (int64_t)q - k, s = k, straight = 6 * (int64_t)q * q;
    return straight * (r * b[h] + s * b[h + 1]) + r * r * r * left + s * s * s * right;
}

#endif
