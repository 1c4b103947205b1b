#include "lib/cover/frame.h"

#include <stdbool.h>
#include <string.h>

#include "lib/num/fixed.h"

// A flat scene gets room for heights of that many quanta on either side, and steps of 2^-16 quanta.
#define LEAST_RANGE 256

static bool grid_is_valid(const struct canopy_grid *grid) {
    for (int a = 0; a < 2; a++) {
        if (grid->size[a] < CANOPY_SIZE_MIN || grid->size[a] > CANOPY_SIZE_MAX) {
            return false;
        }
    }
    return grid->cells >= 1 && grid->cells <= CANOPY_CELLS_MAX && grid->side <= CANOPY_BELOW;
}

static void start(struct canopy_frame *frame, const struct canopy_grid *grid) {
    *frame = (struct canopy_frame){.size = {grid->size[0], grid->size[1]}, .cells = grid->cells, .side = grid->side};
    for (int a = 0; a < 3; a++) {
        frame->axis[a][a] = CANOPY_AXIS_ONE;
    }
}

// The smallest multiple of Q quanta that takes size - 1 intervals over the extent.
static uint64_t pitch_over(uint64_t extent, uint16_t size, uint16_t cells) {
    const uint64_t parts = (uint64_t)(size - 1U) * cells;
    const uint64_t cell = (extent + parts - 1) / parts;
    return (cell > 0 ? cell : 1) * cells;
}

enum canopy_status canopy_frame_around_fx(struct canopy_frame *frame, const struct canopy_grid *grid,
                                          const int32_t low[3], const int32_t high[3]) {
    if (!grid_is_valid(grid) || low[0] > high[0] || low[1] > high[1] || low[2] > high[2]) {
        return CANOPY_ARGUMENT;
    }
    start(frame, grid);
    for (int a = 0; a < 2; a++) {
        const uint64_t extent = (uint64_t)((int64_t)high[a] - low[a]);
        frame->pitch[a] = (uint32_t)pitch_over(extent, grid->size[a], grid->cells);
        frame->origin[a] = low[a];
    }
    const uint64_t told = (uint64_t)((int64_t)high[2] - low[2]), range = told > LEAST_RANGE ? told : LEAST_RANGE;
    frame->origin[2] = low[2];
    frame->lsb_log2 = (int16_t)((int)canopy_log2_ceil(range) - CANOPY_RANGE_LOG2);
    return CANOPY_OK;
}

enum canopy_difference canopy_frame_difference(const struct canopy_frame *a, const struct canopy_frame *b) {
    if (a->side != b->side) {
        return CANOPY_DIFFERENT_SIDE;
    }
    if (memcmp(a->size, b->size, sizeof a->size) != 0) {
        return CANOPY_DIFFERENT_SIZE;
    }
    if (a->cells != b->cells) {
        return CANOPY_DIFFERENT_CELLS;
    }
    if (a->quantum_log2 != b->quantum_log2) {
        return CANOPY_DIFFERENT_QUANTUM;
    }
    if (a->lsb_log2 != b->lsb_log2) {
        return CANOPY_DIFFERENT_STEP;
    }
    if (memcmp(a->pitch, b->pitch, sizeof a->pitch) != 0) {
        return CANOPY_DIFFERENT_PITCH;
    }
    if (memcmp(a->axis, b->axis, sizeof a->axis) != 0) {
        return CANOPY_DIFFERENT_AXES;
    }
    return memcmp(a->origin, b->origin, sizeof a->origin) != 0 ? CANOPY_DIFFERENT_ORIGIN : CANOPY_SAME;
}
