/// The trim of a surrogate file, as lib/cover/trim.h draws it from the mask of covered knot cells.
#ifndef CANOPY_TOOLS_COMMON_OUTLINE_H
#define CANOPY_TOOLS_COMMON_OUTLINE_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/cover/trim.h"
#include "tools/common/fault.h"
#include "tools/common/surrogate.h"

struct canopy_outline {
    uint16_t size[2];
    uint8_t *coverage;  ///< one bit a knot cell, as struct canopy_envelope has it
    struct canopy_trim_outline trace;
    void *arena;
};

/// The mask of the file, one bit a knot cell; every cell where the file has no trim. NULL: no memory. The caller frees.
uint8_t *canopy_outline_coverage(const struct canopy_surrogate *surrogate);

/// Traces the outline of the mask, `close`: with holes of one cell closed first, `clean`: then without cells that stand
/// alone. A file whose trim covers nothing has an outline without polygons. Needs canopy_outline_free after success.
bool canopy_outline_make(const struct canopy_surrogate *surrogate, bool close, bool clean,
                         struct canopy_outline *outline, struct canopy_fault *fault);
void canopy_outline_free(struct canopy_outline *outline);

/// Whether (u, v), in knots, is inside: covered, or in the triangle of a cell that is cut. What is within 1e-9 of a
/// knot interval of an edge counts as inside.
bool canopy_outline_holds(const struct canopy_outline *outline, double u, double v);

#endif
