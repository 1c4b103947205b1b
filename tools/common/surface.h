/// A safe surface over device points, in memory or not: turned, framed, fitted, and proved.
#ifndef CANOPY_TOOLS_COMMON_SURFACE_H
#define CANOPY_TOOLS_COMMON_SURFACE_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/cover/frame.h"
#include "tools/common/crossing.h"
#include "tools/common/device.h"
#include "tools/common/exact.h"
#include "tools/common/fault.h"
#include "tools/common/fitting.h"
#include "tools/common/refining.h"
#include "tools/common/supply.h"
#include "tools/common/surrogate.h"

/// How to fit.
struct canopy_surface_wish {
    uint16_t size[2];
    enum canopy_side side;
    enum canopy_scalar scalar;  ///< that of the points
    double unit;                ///< input units a device unit
    double direction[3];        ///< from the scene to the viewer, any length but 0
    bool has_plane;             ///< then the axes are those of three points (canopy_turn_axes_plane) instead …
    double plane[9];            ///< … namely of these
    struct canopy_fitting fitting;
    const struct canopy_surrogate *frame;  ///< whose frame to use, of the same size; NULL: the smallest
    struct canopy_refining refining;       ///< windows, of one side alone; none of both
};

/// What came out. Milliseconds are processor time of the calling thread, or
/// elapsed where the points may use several.
struct canopy_surface_report {
    struct canopy_exact_result result;  ///< of the coefficients in the surrogate, over all points
    struct canopy_fitting_report fitting;
    double fit_ms;          ///< points in memory to coefficients, of both sides if both are wanted; the field's
                            ///< certificate included
    double certificate_ms;  ///< the last exact pass
    size_t windows;         ///< how many there are, and all coefficients, theirs included
    size_t coefficients;
};

/// Fits, certifies with exact.c, shifts the surface by what is missing (or more than needed) and certifies again. A
/// surface that is not safe in exact arithmetic is never returned. `surrogate` needs canopy_surrogate_free after
/// success. Memory: 12 bytes a point beside the list, for axes that are not along the coordinates; the field, at most
/// 64 MB.
bool canopy_surface_fit(const struct canopy_device_list *points, const struct canopy_surface_wish *wish,
                        struct canopy_surrogate *surrogate, struct canopy_surface_report *report,
                        struct canopy_fault *fault);

/// The same of a supply: points that are not held are read again for each of the passes (for axes that are not along
/// the coordinates, their box; the field; the exact certificate once or twice), and only what looks at points one by
/// one has them read into memory: tightening and windows without a field, a frame that is none of the library's.
bool canopy_surface_fit_supply(struct canopy_supply *points, const struct canopy_surface_wish *wish,
                               struct canopy_surrogate *surrogate, struct canopy_surface_report *report,
                               struct canopy_fault *fault);

/// Both sides (wish->side says nothing), in surrogate[side] and report[side]: each as above, and the two cross nowhere
/// in the frame, which is proved from what they hold; `crossing` says how far they are apart. Each needs
/// canopy_surrogate_free after success.
bool canopy_surface_fit_both_supply(struct canopy_supply *points, const struct canopy_surface_wish *wish,
                                    struct canopy_surrogate surrogate[2], struct canopy_surface_report report[2],
                                    struct canopy_crossing *crossing, struct canopy_fault *fault);

bool canopy_surface_fit_both(const struct canopy_device_list *points, const struct canopy_surface_wish *wish,
                             struct canopy_surrogate surrogate[2], struct canopy_surface_report report[2],
                             struct canopy_crossing *crossing, struct canopy_fault *fault);

#endif
