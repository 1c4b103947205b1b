/// The first zero of a polynomial in Bernstein form, found from its control polygon, and proved to be the first.
///
/// K. Moerken and M. Reimers, "An unconditionally convergent method for computing zeros of splines and polynomials",
/// Math. Comp. 76 (2007): insert the first zero x of the control polygon as a knot, and repeat. Here x is inserted at
/// full multiplicity: the polynomial is split at x and stays in Bernstein form on one interval, which needs no division
/// but the one that gives x and only convex combinations, each rounded down.
///
/// Let [a, b] be the interval in hand, p > 0 on [0, a] proved. After the split at x:
/// - all coefficients left of x are positive: p > 0 on [a, x], because a polynomial lies in the convex hull of its
///   coefficients. a moves to x.
/// - else the first zero may be left of x: b moves to x.
/// Unconditional: if b moves for ever, x decreases to an x' at which the polygon over [a, x'] has its first zero at its
/// end, so p > 0 before x' and p(x') = 0. If a moves for ever, x - a would stay above (b - a)/d * p(a)/(|c| + p(a))
/// unless p(a) -> 0. Quadratic: at a simple zero the polygon crosses on its first or its last leg once the interval
/// is short or one end is close; those legs are tangents of p, and their zero is Newton's. To a double zero Newton's
/// steps only halve the way, so after such a step the next goes twice as far: which side is kept is decided by the
/// coefficients as ever, so that costs no safety, and every other step is the plain one.
///
/// In integers, and one-sided: what is found is never behind the true first zero, because every rounding lowers p. The
/// sole purpose of `tolerance` is to end: p has come down to it where the search stops.
#ifndef CANOPY_SPLINE_ROOTS_H
#define CANOPY_SPLINE_ROOTS_H

#include <stdbool.h>
#include <stdint.h>

#define CANOPY_ROOT_DEGREE_MAX 6                  ///< what a ray through a bicubic patch gives
#define CANOPY_ROOT_STEPS 12                      ///< cap on the splits of one search
#define CANOPY_ROOT_LIMIT (1 << 30)               ///< coefficients are within +- this
#define CANOPY_ROOT_ONE (1 << 30)                 ///< the interval's end: positions are Q30
#define CANOPY_ROOT_LOSS(degree) (13 * (degree))  ///< what all roundings of a search lower p by, at most, in units

struct canopy_root {
    bool found;     ///< false: p > 0 on [0, 1], proved
    bool settled;   ///< found, and p <= tolerance there; false: the steps ran out first (close to a multiple zero)
    uint8_t steps;  ///< splits done
    int32_t at;     ///< found: Q30; p > 0 on [0, at), proved; 0 where p(0) <= 0
    int32_t value;  ///< found: a lower bound of p there (before `at` was rounded down), off by CANOPY_ROOT_LOSS at most
};

/// c[0] ... c[degree]: Bernstein coefficients over [0, 1], within +- CANOPY_ROOT_LIMIT; degree 1 to
/// CANOPY_ROOT_DEGREE_MAX; tolerance at least 2 degree, in units of the coefficients. A polynomial that is between 0
/// and tolerance somewhere may be reported as having a zero there: the side that is safe for a ray.
/// Work: at most CANOPY_ROOT_STEPS + 1 splits of degree (degree + 1)/2 products of 32 bits and one division each.
struct canopy_root canopy_root_first(const int32_t *c, uint32_t degree, int32_t tolerance);

/// Splits at x (Q30, 0 to 1): left gets the coefficients of [0, x], c those of [x, 1]. Each is at most `degree` units
/// below the true one, never above.
void canopy_root_split(int32_t *c, int32_t *left, uint32_t degree, int32_t x);

#endif
