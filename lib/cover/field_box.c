#include "lib/cover/cell.h"
#include "lib/cover/field.h"
#include "lib/num/fixed.h"

enum canopy_status canopy_field_raise(struct canopy_field *field, struct canopy_field_patch *patch) {
    const uint32_t rows = patch->last[0] - patch->first[0] + 1, columns = patch->last[1] - patch->first[1] + 1;
    // Each is at most 2^15, so their product does not overflow.
    if (rows * columns > CANOPY_FIELD_BOX_CELLS) {
        return CANOPY_ARGUMENT;
    }
    patch->raised = 0;
    uint32_t row = patch->first[0] * field->axis[1].count + patch->first[1];
    for (uint32_t r = 0; r < rows; r++, row += field->axis[1].count) {
        for (uint32_t c = 0; c < columns; c++) {
            patch->raised += canopy_field_raise_cell(field, row + c, patch->height);
        }
    }
    return CANOPY_OK;
}

// The cells that an interval meets; false where it is beside the axis, or none.
static bool find_cells(const struct canopy_field_axis *axis, int64_t low, int64_t high, bool exact, uint32_t *first,
                       uint32_t *last, bool *partly) {
    const int64_t limit = (int64_t)((uint64_t)axis->extent << 30);
    if (!(low <= high && high >= 0 && low <= limit)) {
        return false;
    }
    *partly = *partly || low < 0 || high > limit;
    *first = canopy_cell_of_q30(axis, low > 0 ? low : 0, exact);
    *last = canopy_cell_of_q30(axis, high < limit ? high : limit, exact);
    return true;
}

// A height times 2^30 to steps, rounded up; false where it is too high. Steps finer than 2^-30 quanta are as good as
// none: a quantum is too high then.
static bool find_steps(const struct canopy_frame *frame, int64_t top, int32_t *height) {
    const int down = 30 + frame->lsb_log2;
    int64_t steps = top;
    if (down >= 0) {
        const unsigned shift = down < 62 ? (unsigned)down : 62;
        steps = (top >> shift) + ((top & (((int64_t)1 << shift) - 1)) != 0);
    } else if (top > CANOPY_HEIGHT_LIMIT || top < -CANOPY_HEIGHT_LIMIT || down < -30) {
        steps = top > 0 ? INT64_MAX : top < 0 ? INT64_MIN : 0;
    } else {
        steps = top * ((int64_t)1 << -down);
    }
    *height = steps < -CANOPY_HEIGHT_LIMIT ? -CANOPY_HEIGHT_LIMIT : (int32_t)steps;
    return steps <= CANOPY_HEIGHT_LIMIT;
}

enum canopy_status canopy_field_insert_box_fx(struct canopy_field *field, const struct canopy_field_box_fx *box,
                                              struct canopy_field_patch *patch) {
    struct canopy_field_patch made = {.partly = false};
    for (int a = 0; a < 2; a++) {
        if (!find_cells(&field->axis[a], box->low[a], box->high[a], field->exact, &made.first[a], &made.last[a],
                        &made.partly)) {
            return CANOPY_OUT_OF_FRAME;
        }
    }
    if (!find_steps(&field->frame, box->top, &made.height)) {
        return CANOPY_RANGE;
    }
    const enum canopy_status status = canopy_field_raise(field, &made);
    if (status == CANOPY_OK) {
        *patch = made;
    }
    return status;
}
