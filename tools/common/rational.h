/// One point against one surrogate in whole numbers of any length: slow, exact, without any case of doubt.
#ifndef CANOPY_TOOLS_COMMON_RATIONAL_H
#define CANOPY_TOOLS_COMMON_RATIONAL_H

#include <stdbool.h>

#include "tools/common/surrogate.h"

struct canopy_rational;

/// Working numbers for canopy_rational_margin; NULL if there is no memory. The surrogate must stay unchanged.
struct canopy_rational *canopy_rational_open(const struct canopy_surrogate *surrogate);
void canopy_rational_close(struct canopy_rational *rational);

/// Whether the point (device units, finite) is inside the frame, exactly. `cell` receives the knot cell, if not NULL.
bool canopy_rational_inside(struct canopy_rational *rational, const double point[3], int cell[2]);

/// The sign of the point's margin, exactly: negative on the wrong side. The point must be inside the frame.
/// `*floor` is the margin in device units, rounded towards minus infinity. A few microseconds.
int canopy_rational_margin(struct canopy_rational *rational, const double point[3], double *floor);

#endif
