#include "tools/common/turn.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lib/cover/frame.h"

// ---------------------------------------------------------------------------------------------------------------------
// Axes

static bool normalise(double v[3]) {
    const double most = fmax(fabs(v[0]), fmax(fabs(v[1]), fabs(v[2])));
    if (!(most > 0.0 && isfinite(most))) {
        return false;
    }
    for (int k = 0; k < 3; k++) {
        v[k] /= most;  // so that squares neither overflow nor vanish
    }
    const double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (int k = 0; k < 3; k++) {
        v[k] /= length;
    }
    return true;
}

static void cross(const double a[3], const double b[3], double to[3]) {
    for (int k = 0; k < 3; k++) {
        const int p = (k + 1) % 3;
        const int q = (k + 2) % 3;
        to[k] = a[p] * b[q] - a[q] * b[p];
    }
}

static void round_axes(double a[3][3], int32_t axes[3][3]) {
    cross(a[2], a[0], a[1]);
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            axes[i][k] = (int32_t)lrint(a[i][k] * CANOPY_AXIS_ONE);
        }
    }
}

bool canopy_turn_axes(const double direction[3], int32_t axes[3][3]) {
    double a[3][3] = {{0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}, {direction[0], direction[1], direction[2]}};
    if (!normalise(a[2])) {
        return false;
    }
    const int start = fabs(a[2][0]) > 0.9 ? 1 : 0;
    for (int k = 0; k < 3; k++) {
        a[0][k] = (k == start ? 1.0 : 0.0) - a[2][start] * a[2][k];
    }
    normalise(a[0]);
    round_axes(a, axes);
    return true;
}

bool canopy_turn_axes_plane(const double points[9], int32_t axes[3][3]) {
    double a[3][3];
    double beside[3];
    for (int k = 0; k < 3; k++) {
        a[0][k] = points[3 + k] - points[k];
        beside[k] = points[6 + k] - points[k];
    }
    if (!normalise(a[0]) || !normalise(beside)) {
        return false;
    }
    cross(a[0], beside, a[2]);
    if (fmax(fabs(a[2][0]), fmax(fabs(a[2][1]), fabs(a[2][2]))) < 1e-12) {
        return false;
    }
    normalise(a[2]);
    round_axes(a, axes);
    return true;
}

static bool are_along(int32_t axes[3][3]) {
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            if (axes[i][k] != 0 && abs(axes[i][k]) != CANOPY_AXIS_ONE) {
                return false;
            }
        }
    }
    return true;
}

/// A diagonal of ones is not enough: a direction within 2^-15 of z has one, rounded, and still moves what is far away.
static bool are_identity(int32_t axes[3][3]) {
    return are_along(axes) && axes[0][0] == CANOPY_AXIS_ONE && axes[1][1] == CANOPY_AXIS_ONE &&
           axes[2][2] == CANOPY_AXIS_ONE;
}

// ---------------------------------------------------------------------------------------------------------------------
// Points

static bool turn_point(const struct canopy_turned *turned, const union canopy_device_point *p,
                       union canopy_device_point *to, struct canopy_fault *fault) {
    const bool f32 = turned->scalar == CANOPY_F32;
    for (int i = 0; i < 3; i++) {
        double sum = 0.0;
        for (int k = 0; k < 3; k++) {
            sum += (double)turned->axes[i][k] / CANOPY_AXIS_ONE * (f32 ? (double)p->f32[k] : (double)p->fx[k]);
        }
        if (f32) {
            to->f32[i] = (float)sum;
        } else if (fabs(rint(sum)) < 0x1p31) {
            to->fx[i] = (int32_t)rint(sum);
        } else {
            return canopy_fault_set(fault,
                                    "coordinates turned to --dir overflow 32-bit fixed point: choose a larger --unit");
        }
    }
    return true;
}

bool canopy_turn(const struct canopy_device_list *points, int32_t axes[3][3], struct canopy_turned *turned,
                 struct canopy_fault *fault) {
    *turned = (struct canopy_turned){
        .along = are_along(axes), .scalar = points->scalar, .count = points->count, .points = points->points};
    memcpy(turned->axes, axes, sizeof turned->axes);
    if (are_identity(axes)) {
        return true;
    }
    turned->memory = malloc(points->count * sizeof *turned->memory);
    if (!turned->memory) {
        return canopy_fault_no_memory(fault);
    }
    for (size_t i = 0; i < points->count; i++) {
        if (!turn_point(turned, &points->points[i], &turned->memory[i], fault)) {
            return false;
        }
    }
    turned->points = turned->memory;
    return true;
}

void canopy_turned_free(struct canopy_turned *turned) {
    free(turned->memory);
    turned->memory = NULL;
}

// ---------------------------------------------------------------------------------------------------------------------
// Their box

// Four points a turn, coordinate lane % 3 in each lane: what compilers make vectors of.
#define LANES 12

#define BOX(name) name##_f32
#define box_t float
#include "tools/common/box.inc"
#undef BOX
#undef box_t
#define BOX(name) name##_fx
#define box_t int32_t
#include "tools/common/box.inc"

static void swap(union canopy_device_point *p) {
    const int32_t first = p->fx[0];  // the bits of either scalar
    p->fx[0] = p->fx[1];
    p->fx[1] = first;
}

void canopy_turned_box(const struct canopy_turned *turned, union canopy_device_point *low,
                       union canopy_device_point *high) {
    if (!turned->points) {
        *low = turned->low;
        *high = turned->high;
        if (turned->exchanged) {
            swap(low);
            swap(high);
        }
        return;
    }
    if (turned->scalar == CANOPY_F32) {
        box_f32(turned->points[0].f32, turned->count, low->f32, high->f32);
    } else {
        box_fx(turned->points[0].fx, turned->count, low->fx, high->fx);
    }
}

void canopy_turned_widen(enum canopy_scalar scalar, union canopy_device_point box[2],
                         const union canopy_device_point part[2]) {
    for (int k = 0; k < 3; k++) {
        if (scalar == CANOPY_F32) {
            box[0].f32[k] = fminf(box[0].f32[k], part[0].f32[k]);
            box[1].f32[k] = fmaxf(box[1].f32[k], part[1].f32[k]);
        } else {
            box[0].fx[k] = part[0].fx[k] < box[0].fx[k] ? part[0].fx[k] : box[0].fx[k];
            box[1].fx[k] = part[1].fx[k] > box[1].fx[k] ? part[1].fx[k] : box[1].fx[k];
        }
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// Points that are not held

struct pass {
    const struct canopy_turned *turned;
    const struct canopy_flow *flow;
    bool identity;
};

static bool turn_batch(void *context, unsigned thread, struct canopy_batch *batch, size_t *bad,
                       struct canopy_fault *fault) {
    const struct pass *pass = context;
    for (size_t i = 0; !pass->identity && i < batch->count; i++) {
        const union canopy_device_point point = batch->points[i];
        if (!turn_point(pass->turned, &point, &batch->points[i], fault)) {
            *bad = i;
            return false;
        }
    }
    for (size_t i = 0; pass->turned->exchanged && i < batch->count; i++) {
        swap(&batch->points[i]);
    }
    return !pass->flow->work || pass->flow->work(pass->flow->context, thread, batch, bad, fault);
}

static bool gather_turned(void *context, struct canopy_batch *batch, struct canopy_fault *fault) {
    const struct pass *pass = context;
    return !pass->flow->gather || pass->flow->gather(pass->flow->context, batch, fault);
}

bool canopy_turned_pass(const struct canopy_turned *turned, const struct canopy_flow *flow,
                        struct canopy_fault *fault) {
    int32_t axes[3][3];
    memcpy(axes, turned->axes, sizeof axes);
    struct pass pass = {turned, flow, are_identity(axes)};
    struct canopy_flow own = *flow;
    own.context = &pass;
    own.work = turn_batch;
    own.gather = gather_turned;
    return canopy_supply_pass(turned->supply, &own, fault);
}

struct boxing {
    struct canopy_turned *turned;
    bool any;
};

static bool box_batch(void *context, unsigned thread, struct canopy_batch *batch, size_t *bad,
                      struct canopy_fault *fault) {
    const struct boxing *boxing = context;
    (void)thread;
    (void)bad;
    (void)fault;
    const struct canopy_turned part = {
        .scalar = boxing->turned->scalar, .count = batch->count, .points = batch->points};
    union canopy_device_point *box = batch->result;
    canopy_turned_box(&part, &box[0], &box[1]);
    return true;
}

static bool gather_box(void *context, struct canopy_batch *batch, struct canopy_fault *fault) {
    struct boxing *boxing = context;
    const union canopy_device_point *part = batch->result;
    union canopy_device_point box[2] = {boxing->any ? boxing->turned->low : part[0],
                                        boxing->any ? boxing->turned->high : part[1]};
    (void)fault;
    canopy_turned_widen(boxing->turned->scalar, box, part);
    boxing->turned->low = box[0];
    boxing->turned->high = box[1];
    boxing->any = true;
    return true;
}

bool canopy_turn_supply(const struct canopy_supply *supply, int32_t axes[3][3], struct canopy_turned *turned,
                        struct canopy_fault *fault) {
    if (canopy_supply_is_held(supply)) {
        return canopy_turn(&supply->list, axes, turned, fault);
    }
    *turned = (struct canopy_turned){.along = are_along(axes),
                                     .scalar = supply->scalar,
                                     .count = (size_t)supply->count,
                                     .supply = supply,
                                     .low = supply->low,
                                     .high = supply->high};
    memcpy(turned->axes, axes, sizeof turned->axes);
    if (are_identity(axes)) {
        return true;
    }
    struct boxing boxing = {turned, false};
    const struct canopy_flow flow = {.stage = "turning",
                                     .result_size = 2 * sizeof turned->low,
                                     .context = &boxing,
                                     .work = box_batch,
                                     .gather = gather_box};
    return canopy_turned_pass(turned, &flow, fault);
}
