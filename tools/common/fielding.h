/// The bounded streaming field of turned points, as a device fills it, in memory of its own.
#ifndef CANOPY_TOOLS_COMMON_FIELDING_H
#define CANOPY_TOOLS_COMMON_FIELDING_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/cover/field.h"
#include "tools/common/fault.h"
#include "tools/common/turn.h"

struct canopy_fielding {
    struct canopy_field field;
    void *arena;
};

/// Makes a field of cells[0] x cells[1] cells a knot interval, four bytes each or, `packed`, one (field.h), and
/// feeds it. A point that the field refuses, the exact certificate of the points still sees. After success it needs
/// canopy_fielding_close. Memory: CANOPY_FIELD_ARENA or CANOPY_FIELD_PACKED_ARENA.
bool canopy_fielding_open(struct canopy_fielding *fielding, const struct canopy_turned *turned,
                          const struct canopy_frame *frame, const uint16_t cells[2], bool packed,
                          struct canopy_fault *fault);
void canopy_fielding_close(struct canopy_fielding *fielding);

#endif
