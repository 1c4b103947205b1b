/// Inside lib/cover: the cell of a place along one axis of a field, in fixed point.
#ifndef CANOPY_COVER_CELL_H
#define CANOPY_COVER_CELL_H

#include "lib/cover/field.h"
#include "lib/inline.h"
#include "lib/num/product.h"

/// The cell of an offset of up to `extent` quanta; the far edge may give one too many. The product with the reciprocal,
/// which was rounded down, is the quotient or one less; the remainder tells. exact: every cell edge is a whole quantum.
CANOPY_INLINE uint32_t canopy_cell_of(const struct canopy_field_axis *axis, uint32_t offset, bool exact) {
    const uint32_t cell = canopy_product_high(offset, axis->reciprocal);
    if (exact) {
        return cell + (offset - cell * axis->cell >= axis->cell);
    }
    return cell + ((uint64_t)(cell + 1) * axis->pitch <= (uint64_t)offset * axis->cells);
}

/// The same of an offset q * 2^-30, 0 <= q <= extent * 2^30, and within the field: the far edge is the last cell's.
/// Where edges are whole, so is the floor's cell. Elsewhere the part below a quantum may lie beyond an edge (not beyond
/// two, but the estimate may be one less).
CANOPY_INLINE uint32_t canopy_cell_of_q30(const struct canopy_field_axis *axis, int64_t q, bool exact) {
    const uint32_t offset = (uint32_t)((uint64_t)q >> 30);
    uint32_t cell = canopy_cell_of(axis, offset, exact);
    if (!exact) {
        const uint64_t part = ((uint64_t)q & 0x3FFFFFFFU) * axis->cells >> 30;
        while ((uint64_t)(cell + 1) * axis->pitch <= (uint64_t)offset * axis->cells + part) {
            cell++;
        }
    }
    return cell < axis->count ? cell : axis->count - 1;
}

#endif
