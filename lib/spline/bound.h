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

#include "lib/num/product.h"

/// min(D[i], 0), exact for |b| <= 2^28.
static inline int32_t canopy_bend(const int32_t *b, uint32_t n, uint32_t i) {
    const int32_t before = b[i > 0 ? i - 1 : 0], after = b[i + 1 < n ? i + 1 : i];
    const int32_t second = before - 2 * b[i] + after;
    return second < 0 ? second : 0;
}

/// l at h + k/q, exact, in units of 1/(6 q^3): for |b| <= 2^28 and q <= 32 it has at most 48 bits.
/// `left` and `right` are canopy_bend of h and of h + 1.
static inline int64_t canopy_bound_exact(const int32_t *b, uint32_t h, int32_t left, int32_t right, int32_t k,
                                         int32_t q) {
    const int32_t r = q - k, s = k, straight = 6 * q * q;
    return canopy_wide(straight * r, b[h]) + canopy_wide(straight * s, b[h + 1]) + canopy_wide(r * r * r, left) +
           canopy_wide(s * s * s, right);
}

#endif
