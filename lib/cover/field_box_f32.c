#include <math.h>

#include "lib/cover/cell_f32.h"
#include "lib/cover/field.h"

// The cells that an interval meets; false where it is beside the axis, or none.
static bool find_cells(const struct canopy_axis_f32 *axis, float low, float high, bool exact, uint32_t *first,
                       uint32_t *last, bool *partly) {
    if (!(low <= high && high >= axis->from && low <= axis->to)) {
        return false;
    }
    *partly = *partly || low < axis->from || high > axis->to;
    *first = canopy_cell_of_f32(axis, fmaxf(low, axis->from), exact);
    *last = canopy_cell_of_f32(axis, fminf(high, axis->to), exact);
    return true;
}

enum canopy_status canopy_view_insert(struct canopy_field *field, const struct canopy_view_f32 *view,
                                      const struct canopy_field_box_f32 *box, struct canopy_field_patch *patch) {
    struct canopy_field_patch made = {.partly = false};
    for (int a = 0; a < 2; a++) {
        if (!find_cells(&view->axis[a], box->low[a], box->high[a], field->exact, &made.first[a], &made.last[a],
                        &made.partly)) {
            return CANOPY_OUT_OF_FRAME;
        }
    }
    // As for a point: the difference is off by one step at most, the whole number by less than another.
    const float zero = field->frame.side == CANOPY_BELOW ? -view->zero : view->zero;
    const float height = (box->top - zero) * fabsf(view->scale);
    if (!(height <= CANOPY_HEIGHT_REACH_F32)) {
        return isnan(height) ? CANOPY_OUT_OF_FRAME : CANOPY_RANGE;
    }
    made.height = height < -CANOPY_HEIGHT_REACH_F32 ? CANOPY_HEIGHT_LEAST_F32 : (int32_t)height + 2;
    const enum canopy_status status = canopy_field_raise(field, &made);
    if (status == CANOPY_OK) {
        *patch = made;
    }
    return status;
}

enum canopy_status canopy_field_insert_box_f32(struct canopy_field *field, const struct canopy_field_box_f32 *box,
                                               struct canopy_field_patch *patch) {
    const struct canopy_view_f32 view = canopy_view_of(field);
    return canopy_view_insert(field, &view, box, patch);
}
