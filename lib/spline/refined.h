/// The surface with knots where they matter: a base grid and *windows* of a second level on half or quarter pitch,
///
///     S(u,v) = sum b[i][j] N(u-i) N(v-j) + sum over windows, d[i][j] N(2^k u - i0 - i) N(2^k v - j0 - j),
///
/// N the uniform cubic B-spline. Each summand has two continuous derivatives everywhere, also across the edge of its
/// window, so S has them. The coefficients of a window are not repeated outside. (Hierarchical B-splines: D. Forsey and
/// R. Bartels, Hierarchical B-Spline Refinement, SIGGRAPH 1988.)
#ifndef CANOPY_SPLINE_REFINED_H
#define CANOPY_SPLINE_REFINED_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/spline/surface.h"

#define CANOPY_REFINEMENT_LEVELS 2
#define CANOPY_REFINED_LIMIT (1 << 28)  ///< base coefficients, those of windows and their sums are within +- this

/// One window. Fine knots are counted from the frame's origin, 2^level of them to a knot interval.
struct canopy_refinement {
    uint8_t level;     ///< k: 1 or 2
    int16_t first[2];  ///< i0, j0: fine knots of d[0][0]; -1 where it begins at the grid's edge
    uint16_t size[2];  ///< rows and columns
    int32_t *d;        ///< size[0] x size[1], row (u) order, in steps; memory of the caller
};

/// Whether any coefficient of the window shapes the fine cell g = {gu, gv} of 2^-level knot intervals.
bool canopy_refinement_meets(const struct canopy_refinement *window, unsigned level, const uint32_t g[2]);

/// The base and `count` windows as one spline on the pitch of `level` (at least that of every window) over one of its
/// cells: S = sum c[a][e] N(x - gu + 1 - a) N(y - gv + 1 - e) there, x = 2^level u. Knots are inserted by the two-scale
/// relation N(u) = sum (1 4 6 4 1)/8 N(2u - i), in integers; at the end each c is rounded down, by less than one step,
/// which moves S down by less than one step and nowhere up. False: some c is beyond CANOPY_REFINED_LIMIT.
bool canopy_refined_cell(const int32_t *b, const uint16_t size[2], const struct canopy_refinement *windows,
                         uint32_t count, unsigned level, const uint32_t g[2], int32_t c[4][4]);

/// How far canopy_refinement_fx may be from the window's sum, in steps, either way: per axis the weights' errors times
/// differences of up to 2^29 (below 4, see CANOPY_SURFACE_FX_ERROR), the place rounded down by 2^-30, which is 2^-28 of
/// a fine interval, times a slope of up to 2^29 (2), and one floor: below 7.
#define CANOPY_REFINEMENT_FX_ERROR 14

/// What a window adds at a place, in steps; 0 where it does not reach. gradient (may be NULL): by u and by v, steps a
/// knot interval of the base, at most the largest number there is.
int32_t canopy_refinement_fx(const struct canopy_refinement *window, const struct canopy_place *u,
                             const struct canopy_place *v, int32_t gradient[2]);

/// The whole surface: off by at most CANOPY_SURFACE_FX_ERROR + count * CANOPY_REFINEMENT_FX_ERROR.
int32_t canopy_refined_fx(const int32_t *b, const uint16_t size[2], const struct canopy_refinement *windows,
                          uint32_t count, const struct canopy_place *u, const struct canopy_place *v,
                          int32_t gradient[2]);

#endif
