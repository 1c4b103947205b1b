#include <math.h>

#include "lib/cover/field.h"

// The float image of an axis and of the heights, made once per batch: frames stay whole.
struct axis_f32 {
    float from, to, per_cell, cell, quantum;
    int32_t origin;
    uint32_t last;
    bool exact;
};

struct view_f32 {
    struct axis_f32 axis[2];
    float zero, scale;
};

static struct axis_f32 view_axis(const struct canopy_field *field, int a) {
    const struct canopy_field_axis *axis = &field->axis[a];
    const struct canopy_frame *frame = &field->frame;
    const float quantum = ldexpf(1.0f, frame->quantum_log2);
    const int32_t origin = frame->origin[a];
    return (struct axis_f32){
        .from = (float)origin * quantum,
        .to = (float)(origin + (int32_t)axis->extent) * quantum,
        .per_cell = (float)axis->cells / ((float)axis->pitch * quantum),
        .cell = (float)axis->cell,
        .quantum = quantum,
        .origin = origin,
        .last = axis->count - 1,
        .exact = axis->cell != 0,
    };
}

static struct view_f32 view_of(const struct canopy_field *field) {
    const struct canopy_frame *frame = &field->frame;
    const float scale = ldexpf(1.0f, -(frame->lsb_log2 + frame->quantum_log2));
    return (struct view_f32){
        .axis = {view_axis(field, 0), view_axis(field, 1)},
        .zero = ldexpf((float)frame->origin[2], frame->quantum_log2),
        .scale = frame->side == CANOPY_BELOW ? -scale : scale,
    };
}

// The cell of a coordinate within the axis. The estimate is off by at most one; where edges are floats, they decide.
static inline uint32_t cell_of(const struct axis_f32 *axis, const struct canopy_field_axis *whole, float x) {
    uint32_t cell = (uint32_t)((x - axis->from) * axis->per_cell);
    cell = cell < axis->last ? cell : axis->last;
    if (axis->exact) {
        const int32_t edge = axis->origin + (int32_t)(cell * whole->cell);
        if (x < (float)edge * axis->quantum) {
            cell--;
        } else if (cell < axis->last && x >= (float)(edge + (int32_t)whole->cell) * axis->quantum) {
            cell++;
        }
    }
    return cell;
}

// A height in steps, never too low: the difference is off by half an ulp of at most 2^25 steps, which is 1, and the
// step up makes the whole number.
static inline bool height_of(const struct view_f32 *view, float z, int32_t *steps) {
    const float height = (z - view->zero) * view->scale;
    const float limit = (float)(CANOPY_HEIGHT_LIMIT - 4);
    if (!(height <= limit)) {
        return false;
    }
    *steps = height < -limit ? -CANOPY_HEIGHT_LIMIT : (int32_t)height + 2;
    return true;
}

static inline enum canopy_status insert(struct canopy_field *field, const struct view_f32 *view, const float p[3],
                                        struct canopy_field_hit *hit) {
    const struct axis_f32 *u = &view->axis[0], *v = &view->axis[1];
    if (!(p[0] >= u->from && p[0] <= u->to && p[1] >= v->from && p[1] <= v->to) || p[2] != p[2]) {
        return CANOPY_OUT_OF_FRAME;
    }
    if (!height_of(view, p[2], &hit->height)) {
        return CANOPY_RANGE;
    }
    hit->cell = cell_of(u, &field->axis[0], p[0]) * field->axis[1].count + cell_of(v, &field->axis[1], p[1]);
    int32_t *height = &field->heights[hit->cell];
    hit->raised = hit->height > *height;
    if (hit->raised) {
        field->covered += *height == CANOPY_NO_HEIGHT;
        *height = hit->height;
    }
    return CANOPY_OK;
}

enum canopy_status canopy_field_insert_f32(struct canopy_field *field, const float point[3],
                                           struct canopy_field_hit *hit) {
    const struct view_f32 view = view_of(field);
    return insert(field, &view, point, hit);
}

size_t canopy_field_feed_f32(struct canopy_field *field, const float (*points)[3], size_t count) {
    const struct view_f32 view = view_of(field);
    size_t refused = 0;
    struct canopy_field_hit hit;
    for (size_t i = 0; i < count; i++) {
        refused += insert(field, &view, points[i], &hit) != CANOPY_OK;
    }
    return refused;
}
