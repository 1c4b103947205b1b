/// The fit: turned points and a frame to coefficients, with lib/cover as a device uses it. What comes out is not proved
/// yet; surface.h does that.
#ifndef CANOPY_TOOLS_COMMON_FITTING_H
#define CANOPY_TOOLS_COMMON_FITTING_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/cover/frame.h"
#include "tools/common/fault.h"
#include "tools/common/turn.h"

/// What to fit from.
struct canopy_fitting {
    uint16_t field;    ///< Q of the streaming field, as a device fits; 0: from the points, as tight as this method can
    bool packed;       ///< the field has one byte a cell, not four (lib/cover/field.h)
    uint16_t lines;    ///< with a field: lines a knot interval of u, a divisor of `field`; 0: one
    unsigned threads;  ///< that fit the lines of large grids; 0: one
    bool tight;        ///< what `fast` gives is tightened as far as it goes
};

struct canopy_fitting_report {
    uint32_t iterations;  ///< banded solves, or iterations of the tightening
    uint32_t unsettled;   ///< lines that did not end by themselves
    double field_ms;      ///< the field's own certificate
    double excess;        ///< tightened: the mean gap is proved to be within this part of the least possible …
    bool paired;          ///< … of all surfaces that do not cross the other side's
};

/// Fits into coefficients[size[0] * size[1]]: heights in the frame's steps, for either side. Memory: the field, at most
/// 64 MB unless it is wished larger; what tightening takes stands in tightening.h.
bool canopy_fitting_run(const struct canopy_turned *turned, const struct canopy_frame *frame,
                        const struct canopy_fitting *fitting, int32_t *coefficients,
                        struct canopy_fitting_report *report, struct canopy_fault *fault);

/// Fits both sides, frame[side] differing in nothing but the side, into coefficients[side]. Tight, what comes out does
/// not cross: from the two fast surfaces the lower one is tightened under the upper one, then the upper one over the
/// lower one (lib/cover/sandwich.h). Fast, each is as canopy_fitting_run fits it.
bool canopy_fitting_run_both(const struct canopy_turned *turned, const struct canopy_frame frame[2],
                             const struct canopy_fitting *fitting, int32_t *const coefficients[2],
                             struct canopy_fitting_report report[2], struct canopy_fault *fault);

#endif
