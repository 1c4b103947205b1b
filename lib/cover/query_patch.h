/// One knot cell of what is asked about, as a bicubic Bernstein patch in integers. Of the query room, not for users.
///
/// Patch units are 1/36 step, in which the Bernstein coefficients of a knot cell are whole: along one axis they are
/// (b0 + 4 b1 + b2)/6, (4 b1 + 2 b2)/6, (2 b1 + 4 b2)/6 and (b1 + 4 b2 + b3)/6. A plane's are its values at the thirds
/// of the cell, without the repeated coefficients at the frame's edge, which planes do not have.
///
/// |coefficients| are below 3 * 2^28 steps: two surfaces and a plane of at most 2^28 each; times 36, below 2^35.
#ifndef CANOPY_COVER_QUERY_PATCH_H
#define CANOPY_COVER_QUERY_PATCH_H

#include <stdint.h>

#include "lib/cover/query.h"

#define CANOPY_PATCH_STEP 36  ///< patch units a step
#define CANOPY_PATCH_BITS 26  ///< places inside a knot interval have that many bits
#define CANOPY_PATCH_LOSS 7   ///< a plane costs less than 1 unit, a cut less than 3 along each axis, all downward

/// The part of one axis that a window takes, in knot cells: from `from` of cell `first` to `to` of cell `last`, both
/// 2^-26, rounded outward.
struct canopy_patch_span {
    uint32_t first, last;
    uint32_t from, to;
};

/// The cells that share more than an edge with `low` … `high` (of a window without width: the cell that holds it).
struct canopy_patch_span canopy_patch_span_of(uint32_t low, uint32_t high, uint32_t pitch, uint32_t size);

/// What the span takes of cell `at`, which is one of its own.
static inline void canopy_patch_part(const struct canopy_patch_span *span, uint32_t at, uint32_t *from, uint32_t *to) {
    *from = at == span->first ? span->from : 0;
    *to = at == span->last ? span->to : (uint32_t)1 << CANOPY_PATCH_BITS;
}

/// The 4 x 4 differences surface - minus around a cell, row (u) order, the coefficients at the edge repeated.
/// CANOPY_RANGE: a coefficient is beyond its limit.
enum canopy_status canopy_patch_gather(const struct canopy_query_subject *subject, uint32_t row, uint32_t column,
                                       int32_t d[16]);

/// From those to the Bernstein coefficients of the whole cell, row (u) order, of sign * subject: rounded down, by less
/// than one unit, and exact without a plane. sign is 1 or -1.
void canopy_patch_cell(const struct canopy_query_subject *subject, int32_t sign, uint32_t row, uint32_t column,
                       const int32_t d[16], int64_t c[16]);

/// From the coefficients over a cell to those over its part from … to, 2^-bits, along axis 0 or 1: polar forms
/// (blossoms) at from and to, three straight mixtures one after the other, each rounded down by less than one unit.
/// Differences of coefficients times 2^bits must be below 2^63.
void canopy_patch_cut(int64_t c[16], int axis, uint32_t from, uint32_t to, unsigned bits);

#endif
