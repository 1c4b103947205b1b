/// The same surface on another grid, on the safe side: above the old surface where that is an envelope above, below it
/// where that is one below, wherever the old one is covered. What was safe under the old one is safe under the new one,
/// with the old margin at least.
///
/// Finer, at half the pitch: knot insertion. The spline stays the same but for two things, both on the safe side: whole
/// steps (less than one step along each axis), and the outermost knot interval at each edge of the frame. There the
/// coefficient outside the grid is the last one repeated, on the old pitch b[-1] = b[0]; the inserted ones would be
/// b[0] and (7 b[0] + b[1])/8, which are not one number. The smallest one that stands for both is
///
///     max((7 b[0] + b[1])/8, (9 b[0] + b[1])/10),
///
/// because where their B-splines overlap the outer one is largest, 1 : 4, at the edge itself. It moves the surface by
/// at most 1/100 of |b[1] - b[0]| where b falls towards the inside, by 1/48 where it rises.
///
/// Any other grid, of the same box or a part of it: a new field is filled with what the old surface can be at most over
/// each of its cells (query_extreme.h), and canopy_fast and canopy_certify make a surface above that, as they do from
/// points. What it costs in tightness is what a field costs: more cells, less.
#ifndef CANOPY_COVER_QUERY_REGRID_H
#define CANOPY_COVER_QUERY_REGRID_H

#include <stdint.h>

#include "lib/cover/field.h"
#include "lib/cover/query_extreme.h"

/// Halves the pitch along axis 0 (u) or 1 (v). `fine` brings memory for the coefficients, 2 * size - 1 along that axis,
/// and the coverage; everything else of it is written: a knot cell's halves are covered as it was, certificate and
/// points are taken over, first_row counts the halved rows, frame.cells becomes the largest number up to the old one
/// that divides both pitches.
/// CANOPY_ARGUMENT: the pitch is odd, or the new size is beyond CANOPY_SIZE_MAX; CANOPY_RANGE: a coefficient is beyond
/// its limit. *fine is then unchanged but for its memory. Linear.
enum canopy_status canopy_regrid_halve(const struct canopy_envelope *old, int axis, struct canopy_envelope *fine);

/// The frame of another grid over a part of the old one: its corner is the part's, its pitch the smallest multiple of
/// grid->cells quanta that reaches the part's far side. Heights stay as they are; grid->side is not used.
/// CANOPY_ARGUMENT: the grid is out of range, or the box's corners are in the wrong order; CANOPY_OUT_OF_FRAME: the box
/// reaches beyond the old frame; CANOPY_RANGE: the corner is beyond 32 bits; CANOPY_UNSUPPORTED: the axes are not x, y,
/// z and the corner is not the old one (the origin would not be a whole quantum). *frame is then unchanged.
enum canopy_status canopy_regrid_frame(const struct canopy_frame *old, const struct canopy_query_rect *box,
                                       const struct canopy_grid *grid, struct canopy_frame *frame);

struct canopy_regrid {
    const struct canopy_envelope *old;
    struct canopy_field *field;
    uint32_t corner[2];  // of the field in the old frame, quanta
    uint32_t wide;       // quanta by which cells are widened
    uint32_t cuts;
    uint32_t next;
    struct canopy_extreme_node nodes[CANOPY_EXTREME_NODES];
};

/// Begins to fill `field`, whose frame is one of canopy_regrid_frame with box->low = corner, with the old surface.
/// Cells are widened by `wide` quanta of the old frame on every side before they are asked about (0, unless the origin
/// of the new frame is not exact); `cuts` is the most that is spent on a cell beyond one look at each knot cell it
/// meets (0 to 8 are of use). The field is cleared.
void canopy_regrid_begin(struct canopy_regrid *regrid, const struct canopy_envelope *old, const uint32_t corner[2],
                         uint32_t wide, uint32_t cuts, struct canopy_field *field);

/// Fills up to `cells` cells of the field. CANOPY_MORE; CANOPY_OK: it is full. CANOPY_RANGE: the surface leaves
/// +- CANOPY_HEIGHT_LIMIT or a coefficient its limit; CANOPY_EMPTY: it is full, and no cell is covered.
enum canopy_status canopy_regrid_step(struct canopy_regrid *regrid, uint32_t cells);

#endif
