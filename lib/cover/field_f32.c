#include <math.h>

#include "lib/cover/cell_f32.h"
#include "lib/cover/field.h"
#include "lib/inline.h"

static struct canopy_axis_f32 view_axis(const struct canopy_field *field, int a) {
    const struct canopy_field_axis *axis = &field->axis[a];
    const struct canopy_frame *frame = &field->frame;
    const float quantum = ldexpf(1.0f, frame->quantum_log2);
    const int32_t origin = axis->origin;
    return (struct canopy_axis_f32){
        .from = (float)origin * quantum,
        .to = (float)(origin + (int32_t)axis->extent) * quantum,
        .per_cell = (float)axis->cells / ((float)axis->pitch * quantum),
        .cell = (int32_t)axis->cell,
        .quantum = quantum,
        .origin = origin,
        .last = (int32_t)axis->count - 1,
    };
}

struct canopy_view_f32 canopy_view_of(const struct canopy_field *field) {
    const struct canopy_frame *frame = &field->frame;
    const float scale = ldexpf(1.0f, -(frame->lsb_log2 + frame->quantum_log2));
    const int32_t zero = canopy_axes_are_straight(frame->axis) ? frame->origin[2] : 0;
    return (struct canopy_view_f32){
        .axis = {view_axis(field, 0), view_axis(field, 1)},
        .zero = ldexpf((float)zero, frame->quantum_log2),
        .columns = field->axis[1].count,
        .scale = frame->side == CANOPY_BELOW ? -scale : scale,
    };
}

// Cell and height of a point in the frame with an ordinary height; false for any other. The height is never too low:
// the difference is off by half an ulp of at most 2^25 steps, which is 1, and the step up makes the whole number.
CANOPY_INLINE bool find(const struct canopy_view_f32 *view, const float p[3], bool exact,
                        struct canopy_field_hit *hit) {
    const struct canopy_axis_f32 *u = &view->axis[0], *v = &view->axis[1];
    const float height = (p[2] - view->zero) * view->scale;
    if (!canopy_is_within(p[0], u->from, u->to) || !canopy_is_within(p[1], v->from, v->to) ||
        !canopy_is_within(height, -CANOPY_HEIGHT_REACH_F32, CANOPY_HEIGHT_REACH_F32)) {
        return false;
    }
    hit->height = (int32_t)height + 2;
    hit->cell = canopy_cell_of_f32(u, p[0], exact) * view->columns + canopy_cell_of_f32(v, p[1], exact);
    return true;
}

// The same for every point.
static enum canopy_status find_any(const struct canopy_view_f32 *view, const float p[3], struct canopy_field_hit *hit) {
    const bool exact = view->axis[0].cell != 0 && view->axis[1].cell != 0;
    if (find(view, p, exact, hit)) {
        return CANOPY_OK;
    }
    const float there[3] = {p[0], p[1], view->zero};  // the same place with an ordinary height
    if (!isfinite(p[2]) || !find(view, there, exact, hit)) {
        return CANOPY_OUT_OF_FRAME;
    }
    hit->height = CANOPY_HEIGHT_LEAST_F32;
    return (p[2] - view->zero) * view->scale < 0 ? CANOPY_OK : CANOPY_RANGE;
}

enum canopy_status canopy_field_insert_f32(struct canopy_field *field, const float point[3],
                                           struct canopy_field_hit *hit) {
    const struct canopy_view_f32 view = canopy_view_of(field);
    const enum canopy_status status = find_any(&view, point, hit);
    if (status == CANOPY_OK) {
        hit->raised = canopy_field_raise_cell(field, hit->cell, hit->height);
    }
    return status;
}

CANOPY_INLINE size_t feed(const struct canopy_view_f32 view, int32_t *heights, const float (*points)[3], size_t count,
                          bool exact) {
    size_t refused = 0;
    for (size_t i = 0; i < count; i++) {
        struct canopy_field_hit hit;
        if (!find(&view, points[i], exact, &hit) && find_any(&view, points[i], &hit) != CANOPY_OK) {
            refused++;
            continue;
        }
        const int32_t before = heights[hit.cell];
        heights[hit.cell] = hit.height > before ? hit.height : before;  // a store is cheaper than a jump guessed wrong
    }
    return refused;
}

static size_t feed_packed(struct canopy_field *field, const float (*points)[3], size_t count) {
    const struct canopy_view_f32 view = canopy_view_of(field);
    size_t refused = 0;
    for (size_t i = 0; i < count; i++) {
        struct canopy_field_hit hit;
        if (find_any(&view, points[i], &hit) != CANOPY_OK) {
            refused++;
        } else {
            (void)canopy_field_raise_cell(field, hit.cell, hit.height);
        }
    }
    return refused;
}

size_t canopy_field_feed_f32(struct canopy_field *field, const float (*points)[3], size_t count) {
    if (field->heights == NULL) {
        return feed_packed(field, points, count);
    }
    return field->exact ? feed(canopy_view_of(field), field->heights, points, count, true)
                        : feed(canopy_view_of(field), field->heights, points, count, false);
}
