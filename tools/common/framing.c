#include "tools/common/framing.h"

#include <math.h>
#include <stdlib.h>

// ---------------------------------------------------------------------------------------------------------------------
// One's own

static enum canopy_status frame_around(enum canopy_scalar scalar, const struct canopy_grid *grid,
                                       const union canopy_device_point *low, const union canopy_device_point *high,
                                       struct canopy_frame *frame) {
    return scalar == CANOPY_F32 ? canopy_frame_around_f32(frame, grid, low->f32, high->f32)
                                : canopy_frame_around_fx(frame, grid, low->fx, high->fx);
}

/// The box grown sideways by `by` quanta on each side.
static bool grow(enum canopy_scalar scalar, int quantum_log2, int by, union canopy_device_point *low,
                 union canopy_device_point *high) {
    for (int a = 0; a < 2; a++) {
        if (scalar == CANOPY_F32) {
            const float width = ldexpf((float)by, quantum_log2);
            low->f32[a] -= width;
            high->f32[a] += width;
            if (!isfinite(low->f32[a]) || !isfinite(high->f32[a])) {
                return false;
            }
        } else {
            if (low->fx[a] < INT32_MIN + by || high->fx[a] > INT32_MAX - by) {
                return false;
            }
            low->fx[a] -= by;
            high->fx[a] += by;
        }
    }
    return true;
}

bool canopy_framing_own(const struct canopy_turned *turned, const struct canopy_grid *grid, int quanta,
                        struct canopy_frame *frame, struct canopy_fault *fault) {
    union canopy_device_point low;
    union canopy_device_point high;
    canopy_turned_box(turned, &low, &high);
    enum canopy_status status = frame_around(turned->scalar, grid, &low, &high, frame);
    if (status == CANOPY_OK && quanta > 0) {
        status = grow(turned->scalar, frame->quantum_log2, quanta, &low, &high)
                     ? frame_around(turned->scalar, grid, &low, &high, frame)
                     : CANOPY_RANGE;
        // Publishing moves the origin by up to a quantum. Of points at one height a step would be so much finer that
        // coefficients would not be whole in a double any more.
        frame->lsb_log2 = frame->lsb_log2 < -CANOPY_RANGE_LOG2 ? -CANOPY_RANGE_LOG2 : frame->lsb_log2;
    }
    return status == CANOPY_OK ||
           canopy_fault_set(fault,
                            "no frame of this --grid and --field holds the points: grids are 4x4 to %dx%d, fields 1 "
                            "to %d, coordinates below 2^31 units in fx, 2^126 in f32",
                            CANOPY_SIZE_MAX, CANOPY_SIZE_MAX, CANOPY_CELLS_MAX);
}

void canopy_framing_publish(const struct canopy_frame *frame, const struct canopy_turned *turned,
                            struct canopy_surrogate *surrogate) {
    const double quantum = ldexp(1.0, frame->quantum_log2);
    for (int k = 0; k < 3; k++) {
        double quanta = 0.0;
        for (int i = 0; i < 3; i++) {
            quanta += (double)turned->axes[i][k] / CANOPY_AXIS_ONE * (double)frame->origin[i];
        }
        surrogate->origin[k] = rint(quanta) * quantum;
    }
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            surrogate->axes[i][k] = (double)turned->axes[i][k] / CANOPY_AXIS_ONE;
        }
    }
    surrogate->pitch[0] = (double)frame->pitch[0] * quantum;
    surrogate->pitch[1] = (double)frame->pitch[1] * quantum;
}

// ---------------------------------------------------------------------------------------------------------------------
// A file's

/// The largest power of two that divides a double (a large one for zero).
static int divisor_log2(double x) {
    int exponent = 0;
    double mantissa = frexp(fabs(x), &exponent);
    if (x == 0.0) {
        return 1024;
    }
    while (mantissa != floor(mantissa)) {
        mantissa *= 2.0;
        exponent--;
    }
    while (fmod(mantissa, 2.0) == 0.0) {
        mantissa /= 2.0;
        exponent++;
    }
    return exponent;
}

static int smaller(int a, int b) { return a < b ? a : b; }

/// The origin in the coordinates of the surrogate's axes.
static void turned_origin(const struct canopy_surrogate *s, double origin[3]) {
    for (int i = 0; i < 3; i++) {
        origin[i] = 0.0;
        for (int k = 0; k < 3; k++) {
            origin[i] += s->axes[i][k] * s->origin[k];
        }
    }
}

/// The quantum: what divides the pitch of a cell and the origin. In fixed point 1.
static int quantum_log2(const struct canopy_surrogate *like, enum canopy_scalar scalar, uint16_t cells,
                        const double origin[3]) {
    const int pitch = smaller(divisor_log2(like->pitch[0] / cells), divisor_log2(like->pitch[1] / cells));
    return scalar == CANOPY_F32 ? smaller(pitch, smaller(divisor_log2(origin[0]), divisor_log2(origin[1]))) : 0;
}

/// Where heights begin, and the step that the points' heights ask for.
static void set_heights(const struct canopy_turned *turned, double origin, struct canopy_frame *frame) {
    const int log2 = frame->quantum_log2;
    const double base = ldexp(origin, -log2);
    frame->origin[2] = fabs(base) < 0x1p30 ? (int32_t)floor(base) : 0;
    const double zero = ldexp((double)frame->origin[2], log2);
    union canopy_device_point from;
    union canopy_device_point to;
    canopy_turned_box(turned, &from, &to);
    const bool f32 = turned->scalar == CANOPY_F32;
    const double low = f32 ? (double)from.f32[2] : (double)from.fx[2];
    const double high = f32 ? (double)to.f32[2] : (double)to.fx[2];
    int highest = -100;  // as lib/cover/frame_f32.c has it
    frexp(fmax(fabs(high - zero), fabs(low - zero)), &highest);
    frame->lsb_log2 = (int16_t)((highest > -100 ? highest : -100) - CANOPY_RANGE_LOG2 - log2);
}

static void start(const struct canopy_grid *grid, int log2, struct canopy_frame *frame) {
    *frame = (struct canopy_frame){.size = {grid->size[0], grid->size[1]},
                                   .cells = grid->cells,
                                   .side = grid->side,
                                   .quantum_log2 = (int16_t)log2};
    for (int i = 0; i < 3; i++) {
        frame->axis[i][i] = CANOPY_AXIS_ONE;
    }
}

/// The file's frame as it is, if the points' coordinates are the file's and the library can have it: pitches and origin
/// on a quantum, in float with edges of 24 bits.
static bool take_exactly(const struct canopy_surrogate *like, const struct canopy_turned *turned,
                         const struct canopy_grid *grid, struct canopy_frame *frame) {
    double origin[3];
    turned_origin(like, origin);
    const bool f32 = turned->scalar == CANOPY_F32;
    const int log2 = quantum_log2(like, turned->scalar, grid->cells, origin);
    if (!turned->along || log2 < -100 || log2 > 1000) {
        return false;
    }
    start(grid, log2, frame);
    for (int a = 0; a < 2; a++) {
        const double pitch = ldexp(like->pitch[a], -log2);
        const double corner = ldexp(origin[a], -log2);
        const double edge = fmax(fabs(corner), fabs(corner + (grid->size[a] - 1.0) * pitch));
        // In fixed point the far edge may be beyond 32 bits, as it is where our own frame holds the largest
        // coordinates.
        if (!(pitch >= grid->cells && pitch == floor(pitch) && pitch <= UINT32_MAX && corner == floor(corner) &&
              corner >= INT32_MIN && corner <= INT32_MAX && (!f32 || edge <= 0x1p24))) {
            return false;
        }
        frame->pitch[a] = (uint32_t)pitch;
        frame->origin[a] = (int32_t)corner;
    }
    set_heights(turned, origin[2], frame);
    return true;
}

/// A pitch in quanta that the library likes: in proportion to the file's, a multiple of the cells.
static uint32_t likely_pitch(double pitch, double quantum, const struct canopy_grid *grid, int a, double most) {
    const double limit = floor(most / (grid->size[a] - 1.0) / grid->cells);
    return (uint32_t)(fmin(fmax(rint(pitch / quantum / grid->cells), 1.0), limit) * grid->cells);
}

static double within(double x, double most) { return x > 0.0 ? fmin(x, most) : 0.0; }

/// Turns a point anew, to coordinates of the frame: from its origin, in its pitches. Rounding leaves none outside. In
/// fixed point the height stays what turning made it, because it need not fit when it is counted from elsewhere.
static void measure_point(const struct canopy_surrogate *like, const struct canopy_frame *frame,
                          const union canopy_device_point *p, bool f32, int32_t height, union canopy_device_point *to) {
    double q[3] = {0.0, 0.0, 0.0};
    for (int k = 0; k < 3; k++) {
        const double d = (f32 ? (double)p->f32[k] : (double)p->fx[k]) - like->origin[k];
        for (int i = 0; i < 3; i++) {
            q[i] += like->axes[i][k] * d;
        }
    }
    for (int a = 0; a < 2; a++) {
        q[a] = within(q[a] / like->pitch[a] * frame->pitch[a], (double)canopy_frame_width(frame, a));
    }
    for (int i = 0; i < 3 && f32; i++) {
        to->f32[i] = (float)(i < 2 ? ldexp(q[i], frame->quantum_log2) : q[i]);
    }
    if (!f32) {
        *to = (union canopy_device_point){.fx = {(int32_t)rint(q[0]), (int32_t)rint(q[1]), height}};
    }
}

/// Any other file's frame: the points are measured in it, so that its pitches may be what they like. The spline does
/// not know the difference. In float the quantum goes with the heights, since the pitches do not mind.
static bool measure(const struct canopy_surrogate *like, const struct canopy_device_list *points,
                    const struct canopy_grid *grid, struct canopy_turned *turned, struct canopy_frame *frame,
                    struct canopy_fault *fault) {
    const bool f32 = turned->scalar == CANOPY_F32;
    const double wide = fmax((grid->size[0] - 1.0) * like->pitch[0], (grid->size[1] - 1.0) * like->pitch[1]);
    if (!turned->memory) {
        turned->memory = malloc(turned->count * sizeof *turned->memory);
        if (!turned->memory) {
            return canopy_fault_no_memory(fault);
        }
    }
    union canopy_device_point low;
    union canopy_device_point high;
    canopy_turned_box(turned, &low, &high);
    int log2 = 0;
    if (f32) {
        frexp(fmax((double)high.f32[2] - (double)low.f32[2], 0x1p-70), &log2);
        log2 = smaller(log2 - CANOPY_RANGE_LOG2, 100);
    }
    start(grid, log2, frame);
    for (int a = 0; a < 2; a++) {
        frame->pitch[a] = likely_pitch(like->pitch[a], f32 ? wide * 0x1p-23 : 1.0, grid, a, f32 ? 0x1p24 : 0x1p30);
    }
    for (size_t i = 0; i < turned->count; i++) {
        const int32_t height = f32 ? 0 : turned->points[i].fx[2];
        measure_point(like, frame, &points->points[i], f32, height, &turned->memory[i]);
    }
    turned->points = turned->memory;
    double origin[3];
    turned_origin(like, origin);
    set_heights(turned, f32 ? 0.0 : origin[2], frame);
    return true;
}

bool canopy_framing_is_exact(const struct canopy_surrogate *like, const struct canopy_turned *turned,
                             const struct canopy_grid *grid) {
    struct canopy_frame unused;
    return take_exactly(like, turned, grid, &unused);
}

bool canopy_framing_like(const struct canopy_surrogate *like, const struct canopy_device_list *points,
                         const struct canopy_grid *grid, struct canopy_turned *turned, struct canopy_frame *frame,
                         struct canopy_fault *fault) {
    return take_exactly(like, turned, grid, frame) || measure(like, points, grid, turned, frame, fault);
}
