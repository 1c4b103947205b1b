/// Inside lib/cover: a piece of a ray in one knot cell. Mirrored for the side below: the surface is below the ray.
#ifndef CANOPY_COVER_RAY_PARTS_H
#define CANOPY_COVER_RAY_PARTS_H

#include "lib/cover/ray.h"

#define CANOPY_RAY_PLACE_BITS 44   // positions within the frame: knot intervals in Q44
#define CANOPY_RAY_HEIGHT_BITS 20  // heights: steps in Q20

struct canopy_ray_piece {
    uint32_t cell[2];
    int32_t from[2], to[2];         // local parts of the ends, Q30
    int64_t height[2];              // of the ends, Q20
    uint64_t kappa_q40, fixed_q20;  // error bound: M kappa + fixed
    int64_t most_q20;               // the same for the largest M there can be
};

enum canopy_ray_meeting { CANOPY_RAY_NOT_MET, CANOPY_RAY_MET, CANOPY_RAY_BAD_CELL };

struct canopy_ray_found {
    uint8_t steps;  // most of all cells so far
    bool at_start, settled;
    int32_t place[2];  // local parts, Q30
    int64_t height;    // Q20
};

/// Looks for the first zero of the piece, after shortening it to where the cell's coefficients are. found: of MET only,
/// but for `steps`, which NOT_MET may raise too.
enum canopy_ray_meeting canopy_ray_in_cell(const struct canopy_envelope *envelope, const struct canopy_ray_piece *piece,
                                           struct canopy_ray_found *found);

#endif
