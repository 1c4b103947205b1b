#include <math.h>
#include <stdbool.h>

#include "lib/cover/frame.h"
#include "lib/num/fixed.h"

#define EDGE_BITS 24  // what a float holds exactly
#define LEAST -100    // quanta and height ranges are at least 2^LEAST, so that their reciprocals are floats

// x / 2^log2 to the whole number below and above; what is too small for a float then is still not nothing.
static float quanta_below(float x, int log2) {
    const float quanta = ldexpf(x, -log2);
    return quanta == 0.0f && x < 0.0f ? -1.0f : floorf(quanta);
}

static float quanta_above(float x, int log2) { return -quanta_below(-x, log2); }

// Origin and pitch of one axis on the quantum 2^log2. False where an edge needs more than EDGE_BITS.
static bool place_axis(struct canopy_frame *frame, int a, float low, float high, int log2) {
    const float from = quanta_below(low, log2), to = quanta_above(high, log2);
    const float limit = (float)(1 << EDGE_BITS);
    if (!(from >= -limit && to <= limit)) {
        return false;
    }
    const uint32_t parts = (frame->size[a] - 1U) * frame->cells;
    const uint32_t extent = (uint32_t)((int32_t)to - (int32_t)from);
    const uint32_t cell = extent > 0 ? (extent + parts - 1) / parts : 1;
    if ((int64_t)(int32_t)from + (int64_t)cell * parts > 1 << EDGE_BITS) {
        return false;
    }
    frame->origin[a] = (int32_t)from;
    frame->pitch[a] = cell * frame->cells;
    return true;
}

// The exponent e of |x| < 2^e; of 0 a very small one.
static int exponent(float x) {
    int e = -149;
    if (x != 0.0f) {
        (void)frexpf(x, &e);
    }
    return e;
}

static int larger(int a, int b) { return a > b ? a : b; }

enum canopy_status canopy_frame_around_f32(struct canopy_frame *frame, const struct canopy_grid *grid,
                                           const float low[3], const float high[3]) {
    int sideways = -149;
    for (int a = 0; a < 3; a++) {
        if (!(low[a] <= high[a] && low[a] >= -CANOPY_FRAME_F32_MAX && high[a] <= CANOPY_FRAME_F32_MAX)) {
            return CANOPY_ARGUMENT;
        }
        if (a < 2) {
            sideways = larger(sideways, larger(exponent(low[a]), exponent(high[a])));
        }
    }
    struct canopy_frame made;
    const int32_t unit_box[3] = {0, 0, 0};
    enum canopy_status status = canopy_frame_around_fx(&made, grid, unit_box, unit_box);
    if (status != CANOPY_OK) {
        return status;
    }
    // The smallest quantum that could do, then up until both axes fit: the pitch's rounding costs a few steps at most.
    int quantum = larger(sideways - EDGE_BITS, LEAST);
    while (!place_axis(&made, 0, low[0], high[0], quantum) || !place_axis(&made, 1, low[1], high[1], quantum)) {
        quantum++;
    }
    made.quantum_log2 = (int16_t)quantum;
    // origin[2] is a whole number of quanta where one fits 31 bits; else heights count from 0, which loses nothing,
    // since such heights have fewer bits than a step has.
    const float base = floorf(ldexpf(low[2], -quantum));
    made.origin[2] = fabsf(base) < 1073741824.0f ? (int32_t)base : 0;
    const float zero = made.origin[2] == 0 ? 0.0f : ldexpf(base, quantum);
    const int reach = larger(exponent(high[2] - zero), exponent(low[2] - zero));
    // 2^-100 keeps the scale to steps a finite float.
    made.lsb_log2 = (int16_t)(larger(reach, -100) - CANOPY_RANGE_LOG2 - quantum);
    *frame = made;
    return CANOPY_OK;
}
