/// A surrogate with refinement windows on one grid, as fine as its finest window: the least that questions about one
/// grid can be asked of.
///
/// Knots are inserted by the two-scale relation, exactly. What the fine grid cannot imitate is the coefficients outside
/// it, which are the last ones of the *old* grid repeated (and none of a window): there the fine surface is on a chosen
/// side of the true one, as close as can be (lib/cover/query_regrid.h has the argument; the smallest coefficient that
/// stands for c[-1] and c[0] is max(c[0], (c[-1] + 4 c[0])/5)).
#ifndef CANOPY_TOOLS_CANOPY_FLAT_H
#define CANOPY_TOOLS_CANOPY_FLAT_H

#include <stdbool.h>
#include <stdint.h>

#include "tools/common/surrogate.h"

/// The level of the finest window; 0 if there is none.
unsigned canopy_flat_level(const struct canopy_surrogate *surrogate);

/// Coefficients along an axis at a level: 2^level (size - 1) + 1.
static inline uint32_t canopy_flat_size(const struct canopy_surrogate *surrogate, int axis, unsigned level) {
    return ((surrogate->size[axis] - 1) << level) + 1;
}

/// Writes the coefficients of a surface on the grid of `level` (at least that of every window) that is nowhere below
/// (upward) or above the surrogate's. A coefficient counts coefficient * ratio steps; `doubt`: the product's relative
/// error. The steps of all, windows added up, must be below 2^28. Linear. False: no memory (32 bytes a coefficient).
bool canopy_flat_write(const struct canopy_surrogate *surrogate, unsigned level, double ratio, double doubt,
                       bool upward, int32_t *coefficients);

#endif
