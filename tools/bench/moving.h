/// Two spherical scatter clouds that move: the paper's scene for its Tables 1 and 2 and its Fig. 9 and 10.
#ifndef CANOPY_TOOLS_BENCH_MOVING_H
#define CANOPY_TOOLS_BENCH_MOVING_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "tools/common/device.h"

/// Where the two clouds of a configuration are when they start, and how they move from one fit to the next.
struct canopy_moving {
    size_t count;  ///< points of both
    size_t first;  ///< of them, those of the first cloud
    float (*shape)[3];
    float centre[2][3];
    float velocity[2][3];
};

/// Draws configuration `number`: radii of 0.6 to 1.4, points scattered on each sphere with 1 % of radial noise, their
/// share 30 to 70 %, centres up to 2 apart along each axis, each cloud going 0.05 from fit to fit in some direction.
/// The same number draws the same. False: no memory, 12 bytes a point.
bool canopy_moving_open(struct canopy_moving *moving, size_t count, uint64_t number);
void canopy_moving_close(struct canopy_moving *moving);

/// The points at the time of fit `step`, as floats of unit 1 and, in fixed point, in units of 10^-5. Lists of other
/// points are filled anew; either needs canopy_device_list_free. False: no memory.
bool canopy_moving_at(const struct canopy_moving *moving, unsigned step, struct canopy_device_list lists[2]);

#define CANOPY_MOVING_UNIT_FX 1e-5

#endif
