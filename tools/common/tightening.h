/// Tightening of a surface that has been fitted: from the points, or from the bounded field as a device does it.
#ifndef CANOPY_TOOLS_COMMON_TIGHTENING_H
#define CANOPY_TOOLS_COMMON_TIGHTENING_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/cover/frame.h"
#include "tools/common/fault.h"
#include "tools/common/turn.h"

struct canopy_tightening_report {
    uint32_t iterations;
    double excess;  ///< the mean gap is proved to be within this part of the least possible
};

/// Tightens `coefficients`, in the library's orientation, as far as it goes: with `field` > 0 from a field of that many
/// cells a knot interval, which the frame's pitches must be multiples of, of one byte each if it is `packed`; else from
/// the points. They need not be safe: they are raised first where they must be. `opposite`, if not NULL, is the other
/// side's surface in its own orientation, which is kept clear of; it is lowered where it leaves no room. Memory: 12
/// bytes a point or the field, and CANOPY_TIGHTEN_ARENA with CANOPY_TIGHTEN_ROWS beside it.
bool canopy_tightening_run(const struct canopy_turned *turned, const struct canopy_frame *frame, uint16_t field,
                           bool packed, int32_t *coefficients, int32_t *opposite,
                           struct canopy_tightening_report *report, struct canopy_fault *fault);

#endif
