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

/// The union's two members share their representation with the arrays that the library takes.
static void feed(struct canopy_field *field, enum canopy_scalar scalar, const union canopy_device_point *points,
                 size_t count) {
    if (scalar == CANOPY_F32) {
        canopy_field_feed_f32(field, (const float(*)[3]) & points[0].f32, count);
    } else {
        canopy_field_feed_fx(field, (const int32_t(*)[3]) & points[0].fx, count);
    }
}

struct feeding {
    struct canopy_field *field;
    enum canopy_scalar scalar;
};

/// In the order of the file, by one thread: it takes 3 ns a point, a tenth or less of what reading it does, and a
/// packed field depends on the order.
static bool feed_batch(void *context, struct canopy_batch *batch, struct canopy_fault *fault) {
    const struct feeding *feeding = context;
    (void)fault;
    feed(feeding->field, feeding->scalar, batch->points, batch->count);
    return true;
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
    if (!turned->points) {
        struct feeding feeding = {&fielding->field, turned->scalar};
        const struct canopy_flow flow = {.stage = "reading into the field", .context = &feeding, .gather = feed_batch};
        if (!canopy_turned_pass(turned, &flow, fault)) {
            canopy_fielding_close(fielding);
            return false;
        }
        return true;
    }
    feed(&fielding->field, turned->scalar, turned->points, turned->count);
    return true;
}

void canopy_fielding_close(struct canopy_fielding *fielding) {
    free(fielding->arena);
    fielding->arena = NULL;
}
