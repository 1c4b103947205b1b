/// The envelope: a certified surrogate as it is published, the same for both scalars.
///
/// It is what a PLC reads and what a surrogate file holds: whole coefficients times 2^lsb_log2, and the frame.
/// The height a coefficient b stands for is b * 2^lsb_log2 quanta above frame.origin[2], for both sides.
#ifndef CANOPY_COVER_ENVELOPE_H
#define CANOPY_COVER_ENVELOPE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/cover/frame.h"

struct canopy_envelope {
    struct canopy_frame frame;
    uint8_t scalar;         ///< enum canopy_scalar: which kind of point the certificate is about
    uint32_t points;        ///< the certificate covers exactly the first `points` accepted readings
    int32_t margin;         ///< certified distance to the nearest covered cell or point, in lsb; never negative
    int64_t first_row;      ///< of a scene that moves: the number of knot row 0 (ring.h); else 0
    int32_t *coefficients;  ///< size[0] x size[1], row (u) order; memory belongs to whoever declared it
    uint8_t *coverage;      ///< one bit a knot cell, (size[0]-1) x (size[1]-1), row order, bit i at byte i/8 bit i%8
};

#define CANOPY_COEFFICIENTS(m, n) ((size_t)(m) * (size_t)(n))
#define CANOPY_COVERAGE_BYTES(m, n) ((((size_t)(m)-1U) * ((size_t)(n)-1U) + 7U) / 8U)

/// Whether the knot cell that holds (u, v), quanta from the origin, has data. The point must be inside the frame.
bool canopy_envelope_covers(const struct canopy_envelope *envelope, uint32_t u, uint32_t v);

/// Bounds of the surface's height at (u, v), quanta from the frame's origin along its axes, in steps: low <= S <= high,
/// high - low = 2 * CANOPY_SURFACE_FX_ERROR, 24 of the 2^24 steps that the data's range takes. A point no higher than
/// `low` is under an envelope above for sure; a point higher than `high` is beyond it for sure; below is mirrored.
/// CANOPY_OUT_OF_FRAME: beside the frame; the bounds are unchanged.
enum canopy_status canopy_envelope_height(const struct canopy_envelope *envelope, uint32_t u, uint32_t v, int32_t *low,
                                          int32_t *high);

/// Bounds of the surface over a box, ends included, in quanta times 2^30 from the frame's origin along its axes: low <=
/// S <= high wherever the box and the frame meet. With from = to it is one place, which need not be a whole quantum,
/// and the bounds are those of canopy_envelope_height. Else they are wider by half the box's widths times the steepest
/// the surface can be there (the largest differences of neighbouring coefficients that shape it), each way.
/// CANOPY_OUT_OF_FRAME: they do not meet; the bounds are unchanged. Cost: an evaluation and the box's coefficients.
enum canopy_status canopy_envelope_over(const struct canopy_envelope *envelope, const int64_t from[2],
                                        const int64_t to[2], int32_t *low, int32_t *high);

#endif
