#include "tools/common/fielding.h"

#include <stdlib.h>

static enum canopy_status make(struct canopy_fielding *fielding, const struct canopy_frame *frame,
                               const uint16_t cells[2], bool packed) {
    const size_t m = frame->size[0], n = frame->size[1];
    const size_t bytes =
        packed ? CANOPY_FIELD_PACKED_ARENA(m, n, cells[0], cells[1]) : CANOPY_FIELD_ARENA(m, n, cells[0], cells[1]);
    fielding->arena = malloc(bytes);
    if (!fielding->arena) {
        return CANOPY_ARENA_SHORT;
    }
    return packed ? canopy_field_init_packed(&fielding->field, frame, cells, fielding->arena, bytes)
                  : canopy_field_init(&fielding->field, frame, cells, fielding->arena, bytes);
}

bool canopy_fielding_open(struct canopy_fielding *fielding, const struct canopy_turned *turned,
                          const struct canopy_frame *frame, const uint16_t cells[2], bool packed,
                          struct canopy_fault *fault) {
    if (make(fielding, frame, cells, packed) != CANOPY_OK) {
        const bool memory = fielding->arena == NULL;
        canopy_fielding_close(fielding);
        return memory ? canopy_fault_no_memory(fault)
                      : canopy_fault_set(fault, "the frame has no room for this many cells: choose a smaller --unit or "
                                                "--field");
    }
    // The union's two members share their representation with the arrays that the library takes.
    if (turned->scalar == CANOPY_F32) {
        canopy_field_feed_f32(&fielding->field, (const float(*)[3]) & turned->points[0].f32, turned->count);
    } else {
        canopy_field_feed_fx(&fielding->field, (const int32_t(*)[3]) & turned->points[0].fx, turned->count);
    }
    return true;
}

void canopy_fielding_close(struct canopy_fielding *fielding) {
    free(fielding->arena);
    fielding->arena = NULL;
}
