/// Bernstein coefficients of a uniform cubic spline over parts of its knot intervals, rounded down.
///
/// A knot interval is cut into q cells. The Bernstein coefficients of the spline over cell k are its polar form
/// (blossom) at (a, a, a), (a, a, c), (a, c, c), (c, c, c), a = k/q, c = (k+1)/q (L. Ramshaw, Blossoming: A
/// Connect-the-Dots Approach to Splines, 1987). Neighbouring cells share one, so an interval has 3q + 1 of them: its
/// *lattice*. The spline over a cell lies above the least of the cell's four. Unlike the bound l (bound.h) they follow
/// convex bends: what the least lacks of the spline's own minimum falls with the square of 1/q.
///
/// With T(i; a, b, c) the weight of b[h-1+i], for arguments from 0 to 1:
///
///     T0 = (1-a)(1-b)(1-c)/6,                    T1 = (4 - 2(ab+bc+ca) + 3abc)/6,
///     T2 = (1 + (a+b+c) + (ab+bc+ca) - 3abc)/6,  T3 = abc/6;
///
/// none is negative and they sum to one: coefficients that rise lower no Bernstein coefficient, and four that rise
/// alike raise all by as much.
#ifndef CANOPY_SPLINE_BEZIER_H
#define CANOPY_SPLINE_BEZIER_H

#include <stdint.h>

#include "lib/num/fixed.h"

/// Lattice points of a knot interval of q cells. Those of cell k are 3k to 3k + 3.
#define CANOPY_BEZIER_LATTICE(q) (3U * (q) + 1U)

/// Fills a table of 3 * CANOPY_BEZIER_LATTICE(q) weights: T0, T2 and T3 of each lattice point, Q30, to nearest.
/// q: 1 to 32.
void canopy_bezier_weights(int32_t *table, uint16_t q);

/// One Bernstein coefficient, rounded down, from b[h-1] … b[h+2] and the lattice point's three weights. The b within
/// +- (2^28 + 4). Low by less than 3: a weight is off by at most 2^-31 and multiplies a difference of at most 2^29 +
/// 8, three times; for that one step is taken away, and the shift is a floor.
static inline int32_t canopy_bezier_floor(int32_t b0, int32_t b1, int32_t b2, int32_t b3, const int32_t weight[3]) {
    const int64_t rise =
        canopy_wide(b0 - b1, weight[0]) + canopy_wide(b2 - b1, weight[1]) + canopy_wide(b3 - b1, weight[2]);
    return b1 + (int32_t)canopy_shift_floor(rise, 30) - 1;
}

#endif
