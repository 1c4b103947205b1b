/// The code of a packed field: one byte a cell, fine where the field is high.
///
/// What a cell adds to the surface's gap falls with its size, and the surface touches few cells, the high ones of their
/// neighbourhood. So a byte a cell and four times the cells are tighter than four bytes a cell (docs/fields.md has
/// the gap against the bytes). Each knot cell keeps its *top*, and each of its cells how far below the top it is:
///
///     code 0 … 127      in steps of q              to 127 q below the top
///     code 128 … 191    in steps of 4 q            to 380 q
///     code 192 … 254    in steps of 16 q           to 1376 q; a cell that is lower counts as that high
///     code 255          nothing yet
///
/// q is 2^12 of the frame's steps, a 2048th to a 4096th of the data's range. Every height is rounded up to a whole
/// multiple of its step, the top to one of 16 q: the multiples are nested, and which step counts is decided by the
/// height rounded to the coarser one. So a field does not depend on the order in which points, or rises of the top,
/// came, and merging is associative, commutative and idempotent (hosttest/unit/test_packed.c).
///
/// Inside lib/cover: packed fields are filled and read through field.h.
#ifndef CANOPY_COVER_PACKED_H
#define CANOPY_COVER_PACKED_H

#include <stdbool.h>
#include <stdint.h>

#define CANOPY_PACKED_LOG2 12                             ///< q is 2^12 steps
#define CANOPY_PACKED_NONE 255                            ///< the code of a cell without data
#define CANOPY_PACKED_DEPTH (1376 << CANOPY_PACKED_LOG2)  ///< the deepest that a cell can be below the top, in steps

/// The least top of a knot cell that holds this height.
int32_t canopy_packed_top(int32_t height);

/// The code of a height that is not above `top`, a multiple of 16 q; and the height that a code stands for, never
/// below the one it was made of. `code` is not CANOPY_PACKED_NONE.
uint8_t canopy_packed_code(int32_t height, int32_t top);
int32_t canopy_packed_height(uint8_t code, int32_t top);

#endif
