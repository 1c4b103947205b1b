/// The gradient and the normal of a surrogate at a place, in double.
#ifndef CANOPY_TOOLS_CANOPY_SLOPE_H
#define CANOPY_TOOLS_CANOPY_SLOPE_H

#include "tools/common/surrogate.h"

struct canopy_slope {
    double gradient[2];  ///< of the height along the first and second axis: height per length
    double normal[3];    ///< unit vector in the coordinates of the input, on the side of the third axis
};

/// At (u, v) in knot intervals, inside the frame. Refinement windows are taken in. A direct sum over the 4 x 4
/// coefficients around the place and those of each window: the gradient is off by less than 1e-13 of the largest
/// coefficient (windows added) over the pitch, and by 1e-15 of u and v times the second derivative.
struct canopy_slope canopy_slope_at(const struct canopy_surrogate *surrogate, double u, double v);

#endif
