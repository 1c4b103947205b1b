/// A safe surface over device points in memory: frame, fit, exact certificate, file.
#ifndef CANOPY_TOOLS_CANOPY_SURFACE_H
#define CANOPY_TOOLS_CANOPY_SURFACE_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/cover/frame.h"
#include "tools/common/device.h"
#include "tools/common/exact.h"
#include "tools/common/fault.h"
#include "tools/common/surrogate.h"

/// How to fit.
struct canopy_surface_wish {
    uint16_t size[2];
    enum canopy_side side;
    enum canopy_scalar scalar;
    double unit;          ///< input units a device unit
    double direction[3];  ///< from the scene to the viewer, any length but 0
    uint16_t field;  ///< Q of the streaming field, as a device fits; 0: from the points, as tight as this method can
    uint16_t lines;  ///< with a field: lines a knot interval of u, a divisor of `field`; 0: one
    const struct canopy_surrogate *frame;  ///< whose frame to use; NULL: the smallest
};

/// What came out. Milliseconds are processor time of the calling thread.
struct canopy_surface_report {
    struct canopy_exact_result result;  ///< of the coefficients in the surrogate, over all points
    uint32_t iterations;                ///< banded solves
    uint32_t unsettled;                 ///< lines that did not end by themselves
    double fit_ms;
    double field_ms;        ///< of fit_ms: the field's own certificate
    double certificate_ms;  ///< the last exact pass
};

/// The frame's axes for a direction: axes[2] is the direction normalised, axes[0] the part of x orthogonal to it,
/// normalised (of y if the direction is within 26 degrees of x), axes[1] = axes[2] x axes[0]; components in multiples
/// of 2^-30. False for a direction without length.
bool canopy_surface_axes(const double direction[3], int32_t axes[3][3]);

/// Fits, certifies with exact.c, shifts the surface by what is missing (or more than needed) and certifies again. A
/// surface that is not safe in exact arithmetic is never returned. `surrogate` needs canopy_surrogate_free after
/// success. Memory: 12 bytes a point beside the list, for axes that are not along the coordinates; the field, at most
/// 64 MB.
bool canopy_surface_fit(const struct canopy_device_list *points, const struct canopy_surface_wish *wish,
                        struct canopy_surrogate *surrogate, struct canopy_surface_report *report,
                        struct canopy_fault *fault);

#endif
