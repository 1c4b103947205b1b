/// Refinement windows on a host: what a user asked for, where that is, and the windows of a surface, from its points or
/// from the field that it was fitted from. lib/cover/refine.h says what a window is.
#ifndef CANOPY_TOOLS_COMMON_REFINING_H
#define CANOPY_TOOLS_COMMON_REFINING_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/cover/refine.h"
#include "tools/common/exact.h"
#include "tools/common/fault.h"
#include "tools/common/surrogate.h"
#include "tools/common/turn.h"

/// One request: a rectangle, or windows to be placed where the gap is largest.
struct canopy_refining_request {
    const char *text;    ///< as it was given, for faults
    unsigned level;      ///< 1: half pitch; 2: quarter
    bool everywhere;     ///< unused rectangle: choose
    uint32_t windows;    ///< then: how many …
    uint32_t span[2];    ///< … of how many knot intervals; 0: a quarter of the grid, 3 at least
    double corner[2];    ///< else: input units along the frame's first and second axis …
    double opposite[2];  ///< … of the opposite corner
};

struct canopy_refining {
    uint32_t count;
    struct canopy_refining_request requests[CANOPY_REFINEMENTS_MAX];
};

/// Reads "WHERE[@LEVEL]" and adds it; WHERE: N, N:RxC, or X0,Y0,X1,Y1.
bool canopy_refining_read(const char *text, struct canopy_refining *refining, struct canopy_fault *fault);

/// Adds windows to a surrogate that is safe over the points and has none, whose coefficients are whole: each is fitted
/// to the surface with those before it, coarse levels first. The result is safe but for the rounding of places, which
/// exact.h measures. A request that cannot be met is a fault that names it; the surrogate may have windows then.
/// The surrogate's trim plays no part. Memory: for each window CANOPY_REFINE_ARENA, 32 bytes a point in it.
bool canopy_refining_points(const struct canopy_refining *refining, const struct canopy_cloud *cloud,
                            struct canopy_surrogate *surrogate, struct canopy_fault *fault);

/// The same as a device does it, from the field with `cells` x `cells` cells a knot interval of turned points, in the
/// turned frame that the surrogate was fitted in: certified for every cell of the field, and of points to come. Its
/// coefficients are, by canopy_certify. Memory: the field, and for each window CANOPY_REFINE_ARENA.
bool canopy_refining_field(const struct canopy_refining *refining, const struct canopy_turned *turned,
                           const struct canopy_frame *frame, uint16_t cells, bool packed,
                           struct canopy_surrogate *surrogate, struct canopy_fault *fault);

#endif
