/// Inside lib/cover: a field as float code sees it, and the cell of a place along one axis.
#ifndef CANOPY_COVER_CELL_F32_H
#define CANOPY_COVER_CELL_F32_H

#include <math.h>

#include "lib/cover/axes.h"
#include "lib/cover/field.h"
#include "lib/inline.h"

// The float image of an axis and of the heights, made once per batch: frames stay whole.
struct canopy_axis_f32 {
    float from, to, per_cell, quantum;
    int32_t origin, cell, last;
};

struct canopy_view_f32 {
    struct canopy_axis_f32 axis[2];
    float zero, scale;
    uint32_t columns;
};

struct canopy_view_f32 canopy_view_of(const struct canopy_field *field);

/// canopy_field_insert_box_f32 with the field's view at hand.
enum canopy_status canopy_view_insert(struct canopy_field *field, const struct canopy_view_f32 *view,
                                      const struct canopy_field_box_f32 *box, struct canopy_field_patch *patch);

// The cell of a coordinate within the axis. The estimate is off by at most one; where edges are floats, they decide.
CANOPY_INLINE uint32_t canopy_cell_of_f32(const struct canopy_axis_f32 *axis, float x, bool exact) {
    int32_t cell = (int32_t)((x - axis->from) * axis->per_cell);
    cell = cell < axis->last ? cell : axis->last;
    if (exact) {
        const int32_t edge = axis->origin + cell * axis->cell;
        if (x < (float)edge * axis->quantum) {
            cell--;
        } else if (cell < axis->last && x >= (float)(edge + axis->cell) * axis->quantum) {
            cell++;
        }
    }
    return (uint32_t)cell;
}

// Heights beyond the reach are none, or, far down, count as the lowest there is. What is found to be lower than that is
// so in truth: the next float is 2 steps further down, and off by 1.
#define CANOPY_HEIGHT_REACH_F32 ((float)(CANOPY_HEIGHT_LIMIT - 4))
#define CANOPY_HEIGHT_LEAST_F32 (4 - CANOPY_HEIGHT_LIMIT)

// NaN is not.
static inline bool canopy_is_within(float x, float low, float high) { return x >= low && x <= high; }

#endif
