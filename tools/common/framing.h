/// The frame of a fit in turned coordinates, and the same frame as it is published.
#ifndef CANOPY_TOOLS_COMMON_FRAMING_H
#define CANOPY_TOOLS_COMMON_FRAMING_H

#include <stdbool.h>

#include "lib/cover/frame.h"
#include "tools/common/fault.h"
#include "tools/common/surrogate.h"
#include "tools/common/turn.h"

/// The smallest frame that holds the turned points' box grown sideways by `quanta` on each side: turned points are
/// rounded, so that a point may be outside a frame that holds what it was rounded to.
bool canopy_framing_own(const struct canopy_turned *turned, const struct canopy_grid *grid, int quanta,
                        struct canopy_frame *frame, struct canopy_fault *fault);

/// The frame of a surrogate whose axes the points have been turned to, and which holds them all. Where that is no frame
/// of the library's (its axes are not along the coordinates, or its numbers have too many bits), the points are
/// measured in it anew, each to a float or an integer: `turned` then holds what the fit needs, which says the same of
/// the coefficients, and the frame stands in for the file's. Only the heights come from the points. False: no memory.
bool canopy_framing_like(const struct canopy_surrogate *like, const struct canopy_device_list *points,
                         const struct canopy_grid *grid, struct canopy_turned *turned, struct canopy_frame *frame,
                         struct canopy_fault *fault);

/// Whether it is one of the library's as it is; else canopy_framing_like needs the points in memory.
bool canopy_framing_is_exact(const struct canopy_surrogate *like, const struct canopy_turned *turned,
                             const struct canopy_grid *grid);

/// The published frame of one's own: origin turned back and put on the quantum, axes, pitch.
void canopy_framing_publish(const struct canopy_frame *frame, const struct canopy_turned *turned,
                            struct canopy_surrogate *surrogate);

#endif
