#include "tools/canopy/stream.h"

#include <stdlib.h>

#define CHUNK 65536

struct state {
    const struct canopy_surrogate *surrogate;
    struct canopy_stream_sink sink;
    struct canopy_device_list list;
};

static void flush(struct state *state) {
    const struct canopy_cloud cloud = canopy_device_list_cloud(&state->list);
    if (cloud.count > 0) {
        state->sink.take(state->sink.context, &cloud);
    }
    state->list.count = 0;
}

static bool take(void *context, const double point[3], uint64_t where, struct canopy_fault *fault) {
    struct state *state = context;
    union canopy_device_point device;
    (void)where;
    if (!canopy_device_point(state->surrogate->scalar, state->surrogate->unit, point, &device, fault)) {
        return false;
    }
    if (!canopy_device_list_add(&state->list, &device)) {
        return canopy_fault_set(fault, "out of memory: close other programs");
    }
    if (state->list.count == CHUNK) {
        flush(state);
    }
    return true;
}

bool canopy_stream_points(const char *path, const struct canopy_surrogate *surrogate, struct canopy_stream_sink sink,
                          struct canopy_points_info *info, struct canopy_fault *fault) {
    struct state state = {.surrogate = surrogate, .sink = sink, .list = {.scalar = surrogate->scalar}};
    const bool ok = canopy_points_read(path, (struct canopy_points_sink){&state, take}, info, fault);
    if (ok) {
        flush(&state);
    }
    canopy_device_list_free(&state.list);
    return ok;
}
