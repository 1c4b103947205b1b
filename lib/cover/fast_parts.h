/// What the fast method's files share: the fit of all lines and columns (fast.c), and of those that changed (refit.c).
#ifndef CANOPY_COVER_FAST_PARTS_H
#define CANOPY_COVER_FAST_PARTS_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/cover/fast.h"
#include "lib/num/bits.h"

/// How many lines there are.
static inline uint32_t canopy_fast_line_count(const struct canopy_fast *fast) {
    return (uint32_t)CANOPY_LINE_NODES(fast->field->frame.size[0], fast->lines);
}

/// Whether the line holds coefficient j: some covered cell that the line is above can see it.
static inline bool canopy_fast_is_held(const struct canopy_fast *fast, uint32_t line, uint32_t j) {
    return canopy_bit_get(fast->held + (size_t)line * CANOPY_FAST_HELD_BYTES(fast->field->frame.size[1]), j);
}

/// Whether some line whose cells may meet the support of b[i][j], two knot intervals to either side, holds j.
bool canopy_fast_is_seen(const struct canopy_fast *fast, uint32_t i, uint32_t j);

/// Begins line `index`: its nodes from the cells around it, what it holds, the fit. False if there is nothing on it.
bool canopy_fast_begin_line(struct canopy_fast *fast, uint32_t index);

/// Ends it: its coefficients go to `g`, raised by what the certificate may lose.
void canopy_fast_finish_line(struct canopy_fast *fast, uint32_t index);

#endif
