#include "lib/cover/query_regrid.h"

#include <stddef.h>
#include <string.h>

#include "lib/num/bits.h"
#include "lib/num/fixed.h"

// ---- Finer

// The coefficient that stands for the last one and its repetition, rounded up; `next` is the one further inside.
static int32_t edge_of(int64_t last, int64_t next) {
    const int64_t inserted = canopy_shift_ceil(7 * last + next, 3), mixed = canopy_div_ceil(9 * last + next, 10);
    return (int32_t)(inserted > mixed ? inserted : mixed);
}

// One line of `size` coefficients, `stride` apart, to 2 * size - 1. Rounded up after the mirror of the side below.
// `from` may be `to`: the line is worked through from its end, and what is written lies behind what is still read.
static void halve_line(const int32_t *from, int32_t *to, uint32_t size, size_t stride, int32_t sign) {
    int64_t after = sign * from[(size - 1) * stride], here = after;
    for (uint32_t i = size; i-- > 0;) {
        const int64_t before = i > 0 ? sign * from[(i - 1) * stride] : here;
        if (i + 1 < size) {
            to[(2 * (size_t)i + 1) * stride] = sign * (int32_t)canopy_shift_ceil(here + after, 1);
        }
        int32_t knot = (int32_t)canopy_shift_ceil(before + 6 * here + after, 3);
        if (i + 1 == size) {
            knot = edge_of(here, before);
        } else if (i == 0) {
            knot = edge_of(here, after);
        }
        to[2 * (size_t)i * stride] = sign * knot;
        after = here;
        here = before;
    }
}

static void halve_coverage(const struct canopy_envelope *old, int axis, const uint16_t size[2], uint8_t *coverage) {
    const uint32_t rows = size[0] - 1U, columns = size[1] - 1U, old_columns = old->frame.size[1] - 1U;
    memset(coverage, 0, CANOPY_COVERAGE_BYTES(size[0], size[1]));
    for (uint32_t h = 0; h < rows; h++) {
        for (uint32_t w = 0; w < columns; w++) {
            const uint32_t row = axis == 0 ? h / 2 : h, column = axis == 1 ? w / 2 : w;
            if (canopy_bit_get(old->coverage, row * old_columns + column)) {
                (void)canopy_bit_set(coverage, h * columns + w);
            }
        }
    }
}

static bool are_within_limit(const struct canopy_envelope *envelope) {
    const uint32_t count = (uint32_t)envelope->frame.size[0] * envelope->frame.size[1];
    for (uint32_t i = 0; i < count; i++) {
        const int32_t b = envelope->coefficients[i];
        if (b > CANOPY_COEFFICIENT_LIMIT || b < -CANOPY_COEFFICIENT_LIMIT) {
            return false;
        }
    }
    return true;
}

static void halve_coefficients(const struct canopy_envelope *old, int axis, int32_t *to) {
    const uint32_t m = old->frame.size[0], n = old->frame.size[1];
    const int32_t sign = old->frame.side == CANOPY_BELOW ? -1 : 1;
    if (axis == 0) {
        for (uint32_t j = 0; j < n; j++) {
            halve_line(old->coefficients + j, to + j, m, n, sign);
        }
        return;
    }
    for (uint32_t i = 0; i < m; i++) {
        halve_line(old->coefficients + (size_t)i * n, to + (size_t)i * (2 * n - 1), n, 1, sign);
    }
}

enum canopy_status canopy_regrid_halve(const struct canopy_envelope *old, int axis, struct canopy_envelope *fine) {
    struct canopy_frame frame = old->frame;
    if (frame.pitch[axis] % 2 != 0 || 2 * (uint32_t)frame.size[axis] - 1 > CANOPY_SIZE_MAX) {
        return CANOPY_ARGUMENT;
    }
    if (!are_within_limit(old)) {
        return CANOPY_RANGE;
    }
    frame.pitch[axis] /= 2;
    frame.size[axis] = (uint16_t)(2U * frame.size[axis] - 1U);
    while (frame.pitch[0] % frame.cells != 0 || frame.pitch[1] % frame.cells != 0) {
        frame.cells--;  // ends at 1
    }
    halve_coefficients(old, axis, fine->coefficients);
    halve_coverage(old, axis, frame.size, fine->coverage);
    fine->frame = frame;
    fine->scalar = old->scalar;
    fine->points = old->points;
    fine->margin = old->margin;
    fine->first_row = axis == 0 ? 2 * old->first_row : old->first_row;
    return CANOPY_OK;
}

// ---- Another grid

enum canopy_status canopy_regrid_frame(const struct canopy_frame *old, const struct canopy_query_rect *box,
                                       const struct canopy_grid *grid, struct canopy_frame *frame) {
    struct canopy_frame made = *old;
    if (grid->cells < 1 || grid->cells > CANOPY_CELLS_MAX) {
        return CANOPY_ARGUMENT;
    }
    for (int axis = 0; axis < 2; axis++) {
        const uint32_t low = box->low[axis], high = box->high[axis];
        if (grid->size[axis] < CANOPY_SIZE_MIN || grid->size[axis] > CANOPY_SIZE_MAX || low > high) {
            return CANOPY_ARGUMENT;
        }
        if (high > canopy_frame_width(old, axis)) {
            return CANOPY_OUT_OF_FRAME;
        }
        if (low != 0 && old->axis[axis][axis] != CANOPY_AXIS_ONE) {
            return CANOPY_UNSUPPORTED;
        }
        const int64_t origin = (int64_t)old->origin[axis] + low;
        if (origin > INT32_MAX) {
            return CANOPY_RANGE;
        }
        const uint32_t parts = (grid->size[axis] - 1U) * grid->cells;
        const uint32_t cell = (uint32_t)(((uint64_t)(high - low) + parts - 1) / parts);
        made.origin[axis] = (int32_t)origin;
        made.pitch[axis] = (cell > 0 ? cell : 1) * grid->cells;
        made.size[axis] = grid->size[axis];
    }
    made.cells = grid->cells;
    *frame = made;
    return CANOPY_OK;
}

void canopy_regrid_begin(struct canopy_regrid *regrid, const struct canopy_envelope *old, const uint32_t corner[2],
                         uint32_t wide, uint32_t cuts, struct canopy_field *field) {
    regrid->old = old;
    regrid->field = field;
    regrid->corner[0] = corner[0];
    regrid->corner[1] = corner[1];
    regrid->wide = wide;
    regrid->cuts = cuts;
    regrid->next = 0;
    canopy_field_clear(field);
}

// The part of the old frame that cell `at` of the field's axis covers. False where there is none. The last cell has the
// field's far edge, too, and where that is a knot a place on it is of the old knot cell behind: a quantum more.
static bool find_part(const struct canopy_regrid *regrid, int axis, uint32_t at, uint32_t *low, uint32_t *high) {
    const uint64_t width = canopy_frame_width(&regrid->old->frame, axis), cell = regrid->field->axis[axis].cell;
    const bool last = at + 1 == regrid->field->axis[axis].count;
    const uint64_t from = regrid->corner[axis] + at * cell, to = from + cell + regrid->wide + (last ? 1 : 0);
    if (from >= width + regrid->wide) {
        return false;
    }
    *low = (uint32_t)(from > regrid->wide ? from - regrid->wide : 0);
    *high = (uint32_t)(to < width ? to : width);
    return true;
}

static enum canopy_status fill_cell(struct canopy_regrid *regrid, uint32_t cell) {
    const struct canopy_field *field = regrid->field;
    const bool below = regrid->old->frame.side == CANOPY_BELOW;
    struct canopy_query_rect rect;
    if (!find_part(regrid, 0, cell / field->axis[1].count, &rect.low[0], &rect.high[0]) ||
        !find_part(regrid, 1, cell % field->axis[1].count, &rect.low[1], &rect.high[1])) {
        return CANOPY_OK;
    }
    const struct canopy_query_subject subject = {.surface = regrid->old, .covered = true};
    struct canopy_extreme search;
    enum canopy_status status = canopy_extreme_begin(&search, &subject, &rect, below ? CANOPY_LOWEST : CANOPY_HIGHEST,
                                                     2, regrid->nodes, CANOPY_EXTREME_NODES);
    if (status == CANOPY_OK) {
        const uint32_t looks =
            (search.span[0].last - search.span[0].first + 1) * (search.span[1].last - search.span[1].first + 1);
        status = canopy_extreme_step(&search, looks + regrid->cuts);
    }
    if (status == CANOPY_EMPTY) {
        return CANOPY_OK;
    }
    if (status != CANOPY_OK && status != CANOPY_MORE) {
        return status;
    }
    const int32_t bound = canopy_extreme_answer(&search).bound, height = below ? -bound : bound;
    if (height > CANOPY_HEIGHT_LIMIT || height < -CANOPY_HEIGHT_LIMIT) {
        return CANOPY_RANGE;
    }
    (void)canopy_field_raise_cell(regrid->field, cell, height);
    return CANOPY_OK;
}

static bool is_empty(const struct canopy_field *field) {
    const uint32_t cells = field->axis[0].count * field->axis[1].count;
    for (uint32_t c = 0; c < cells; c++) {
        if (canopy_field_height(field, c) != CANOPY_NO_HEIGHT) {
            return false;
        }
    }
    return true;
}

enum canopy_status canopy_regrid_step(struct canopy_regrid *regrid, uint32_t cells) {
    const struct canopy_field *field = regrid->field;
    const uint32_t count = field->axis[0].count * field->axis[1].count;
    for (; cells > 0 && regrid->next < count; cells--) {
        const enum canopy_status status = fill_cell(regrid, regrid->next);
        if (status != CANOPY_OK) {
            return status;
        }
        regrid->next++;
    }
    if (regrid->next < count) {
        return CANOPY_MORE;
    }
    return is_empty(field) ? CANOPY_EMPTY : CANOPY_OK;
}
