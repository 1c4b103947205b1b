/// Do two surrogates of one frame cross? Decided in whole numbers of any length, over the whole frame.
///
/// The difference of two surfaces of one frame is a bicubic polynomial on every cell of the finest level that either
/// has (knot cells without windows). Where all 16 Bernstein coefficients of it are at least 0 it is nowhere negative;
/// where it is negative at a corner of the cell, the surfaces cross. What neither decides is halved in both directions.
/// Shares nothing with lib/cover.
#ifndef CANOPY_TOOLS_COMMON_CROSSING_H
#define CANOPY_TOOLS_COMMON_CROSSING_H

#include <stdbool.h>

#include "tools/common/fault.h"
#include "tools/common/surrogate.h"

enum canopy_crossing_verdict {
    CANOPY_CROSSING_NONE,      ///< nowhere; they may touch
    CANOPY_CROSSING_FOUND,     ///< at `at` the surface above is below the other one
    CANOPY_CROSSING_UNDECIDED  ///< they touch, or nearly: not decided after CANOPY_CROSSING_HALVINGS
};

#define CANOPY_CROSSING_HALVINGS 12  ///< of a cell, in both directions

struct canopy_crossing {
    enum canopy_crossing_verdict verdict;
    double distance;  ///< the surfaces are at least so far apart everywhere, in device units along axes[2]: rounded
                      ///< down, and no more than 2 % from the truth or what the halvings leave; negative: crossing
    double at[2];     ///< where they come closest as far as has been seen, in knot intervals
};

/// Decides. False: the surrogates do not share unit, frame and size, or are not one above and one below. About 5 us a
/// knot cell, and a few ms for each on which they touch along a line.
bool canopy_crossing_find(const struct canopy_surrogate *above, const struct canopy_surrogate *below,
                          struct canopy_crossing *crossing, struct canopy_fault *fault);

#endif
