#include "boards/linux/frame.h"

#include <math.h>

#include "lib/cover/axes.h"
#include "lib/plc/plc.h"
#include "tools/common/surrogate.h"

// Whole and in range, to `to`.
static bool whole(double value, double low, double high, double *to) {
    *to = value;
    return value >= low && value <= high && rint(value) == value;
}

// Whole multiples of 2^-30, as canopy fit writes them and registers carry them.
static bool take_axes(const struct canopy_surrogate *surrogate, struct canopy_frame *frame,
                      struct canopy_fault *fault) {
    for (int i = 0; i < 9; i++) {
        double value;
        if (!whole(surrogate->axes[i / 3][i % 3] * CANOPY_AXIS_ONE, INT32_MIN, INT32_MAX, &value)) {
            return canopy_fault_set(fault, "axes[%d][%d] is no multiple of 2^-30: give a frame made by canopy fit",
                                    i / 3, i % 3);
        }
        frame->axis[i / 3][i % 3] = (int32_t)value;
    }
    return canopy_axes_are_sound((const int32_t(*)[3])frame->axis) ||
           canopy_fault_set(fault, "its axes are no rotation within 2^-20: give a frame made by canopy fit");
}

static bool take_box(const struct canopy_surrogate *surrogate, struct canopy_frame *frame, struct canopy_fault *fault) {
    double value;
    for (int i = 0; i < 3; i++) {
        if (!whole(surrogate->origin[i], INT32_MIN, INT32_MAX, &value)) {
            return canopy_fault_set(fault, "origin %.17g is no whole number of 32 bits: give a frame in fixed point",
                                    surrogate->origin[i]);
        }
        frame->origin[i] = (int32_t)value;
    }
    for (int i = 0; i < 2; i++) {
        if (!whole(surrogate->pitch[i], frame->cells, UINT32_MAX, &value) || (uint32_t)value % frame->cells != 0) {
            return canopy_fault_set(fault,
                                    "pitch %.17g is no multiple of the %u cells of --field: choose another --field",
                                    surrogate->pitch[i], frame->cells);
        }
        frame->pitch[i] = (uint32_t)value;
    }
    return true;
}

static bool take_step(const struct canopy_surrogate *surrogate, struct canopy_frame *frame,
                      struct canopy_fault *fault) {
    int exponent;
    const double fraction = frexp(surrogate->lsb, &exponent);
    if (fraction < 0.5 || fraction > 0.5 || exponent < -30 || exponent > 31) {
        return canopy_fault_set(fault, "lsb %.17g is no power of two from 2^-31 to 2^30: give a frame in fixed point",
                                surrogate->lsb);
    }
    frame->lsb_log2 = (int16_t)(exponent - 1);
    frame->quantum_log2 = 0;
    return true;
}

static bool take_size(const struct canopy_surrogate *surrogate, const uint16_t asked[2], struct canopy_frame *frame,
                      struct canopy_fault *fault) {
    const uint32_t *size = surrogate->size;
    if (size[0] > CANOPY_SIZE_MAX || size[1] > CANOPY_SIZE_MAX || size[0] * size[1] > CANOPY_PLC_CAPACITY_MAX) {
        return canopy_fault_set(fault, "its %u x %u coefficients do not fit the registers: at most %d", size[0],
                                size[1], CANOPY_PLC_CAPACITY_MAX);
    }
    if (asked[0] != 0 && (asked[0] != size[0] || asked[1] != size[1])) {
        return canopy_fault_set(fault, "its grid is %ux%u: give the same --grid or none", size[0], size[1]);
    }
    frame->size[0] = (uint16_t)size[0];
    frame->size[1] = (uint16_t)size[1];
    return true;
}

static bool take(const struct canopy_surrogate *surrogate, const uint16_t asked[2], struct canopy_frame *frame,
                 struct canopy_fault *fault) {
    if (surrogate->scalar != CANOPY_FX) {
        return canopy_fault_set(fault, "its scalar is f32: give one made with canopy fit --scalar fx");
    }
    return take_axes(surrogate, frame, fault) && take_size(surrogate, asked, frame, fault) &&
           take_box(surrogate, frame, fault) && take_step(surrogate, frame, fault);
}

bool canopyd_frame_read(const char *path, const uint16_t asked[2], struct canopy_grid *grid, struct canopy_frame *frame,
                        double *unit, struct canopy_fault *fault) {
    struct canopy_surrogate surrogate;
    if (!canopy_surrogate_read(path, &surrogate, fault)) {
        return false;
    }
    *frame = (struct canopy_frame){.cells = grid->cells, .side = grid->side};
    const bool good = take(&surrogate, asked, frame, fault) || canopy_fault_prefix(fault, "%s", path);
    grid->size[0] = frame->size[0];
    grid->size[1] = frame->size[1];
    *unit = surrogate.unit;
    canopy_surrogate_free(&surrogate);
    return good;
}
