/// Rays and segments in input coordinates against a surrogate, by lib/cover/ray.
///
/// A ray in doubles is taken as what it says: it is brought into the frame in rational numbers and rounded once, to
/// 2^-39 of the frame or of its distance, which the library's bound knows of.
#ifndef CANOPY_TOOLS_CANOPY_BEAM_H
#define CANOPY_TOOLS_CANOPY_BEAM_H

#include <gmp.h>
#include <stdbool.h>

#include "lib/cover/ray.h"
#include "tools/canopy/queried.h"

/// A surrogate made ready. Its own, but `envelope`.
struct canopy_beam_target {
    const struct canopy_queried *queried;
    const struct canopy_envelope *envelope;  ///< the one of the two that is on the safe side
    double step;                             // device units
    mpq_t row[3][4];                         // knots, of the frame's width, and steps: row * (x, y, z, 1)
};

/// `queried` has been read. Needs canopy_beam_close after success. False: no memory for its windows' fine grid.
bool canopy_beam_open(struct canopy_beam_target *target, struct canopy_queried *queried);
void canopy_beam_close(struct canopy_beam_target *target);

/// What became of a ray.
struct canopy_beam {
    struct canopy_ray_hit hit;      ///< of the envelope, which may have a finer grid than the surrogate
    uint32_t cell[2];               ///< the surrogate's knot cell
    double local[2];                ///< and the place in it
    double t, point[3], normal[3];  ///< of hits; t is not after the hit; normal: unit, towards the free side
};

/// The ray from[] + t * second[], or with `segment` the way from[] + t * (second[] - from[]) to t = 1. All finite.
/// About 6 us, which is what rational numbers cost.
void canopy_beam_cast(struct canopy_beam_target *target, const double from[3], const double second[3], bool segment,
                      struct canopy_beam *beam);

#endif
