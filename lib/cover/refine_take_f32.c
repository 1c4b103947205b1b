// The program: points or a field in; the objective, and what each coefficient may be.

#include "lib/cover/refine_f32.h"

#define REACH 7.5f  // no coefficient is farther from zero, in units

// The surface so far over a fine cell: r->c.
static enum canopy_status look(struct canopy_refine *r, const uint32_t g[2], uint32_t cell) {
    if (cell == r->cached) {
        return CANOPY_OK;
    }
    r->cached = UINT32_MAX;
    if (!canopy_refined_cell(r->b, r->frame.size, r->list, r->count - 1, r->window.level, g, r->c)) {
        return CANOPY_RANGE;
    }
    r->cached = cell;
    return CANOPY_OK;
}

static void take_height(struct canopy_refine *r, uint32_t cell, int32_t height) {
    int32_t *low = &r->low[cell];
    *low = *low == CANOPY_NO_HEIGHT || height < *low ? height : *low;
    r->height[0] = height < r->height[0] ? height : r->height[0];
    r->height[1] = height > r->height[1] ? height : r->height[1];
}

// How far the surface so far is above a height at (s, t) of the cell that was looked at, rounded down.
static float gap_at(const struct canopy_refine *r, float s, float t, int32_t height) {
    float u[4], v[4], sum = 0, most = 0;
    canopy_refine_axis_weights(s, u);
    canopy_refine_axis_weights(t, v);
    for (int a = 0; a < 4; a++) {
        for (int e = 0; e < 4; e++) {
            const float over = (float)(r->c[a][e] - height);
            sum += u[a] * v[e] * over;
            most = fmaxf(most, fabsf(over));
        }
    }
    return sum - CANOPY_REFINE_ERROR * most;
}

// A constraint that the window can do something about; its bound is in steps until the filling ends.
static enum canopy_status add_constraint(struct canopy_refine *r, uint32_t cell, float s, float t, int32_t height) {
    struct canopy_refine_row row = {.cell = cell, .s = s, .t = t};
    const struct canopy_refine_weights w = canopy_refine_weights_of(r, &row);
    if (!(w.sum > CANOPY_REFINE_NO_WEIGHT)) {
        return CANOPY_OK;
    }
    if (r->rows == r->room) {
        return CANOPY_ARENA_SHORT;
    }
    const float gap = fmaxf(gap_at(r, s, t, height), 0.0f);
    row.bound = -gap / w.sum;
    r->row[r->rows++] = row;
    if (s >= 0) {  // a point
        r->points++;
        r->gap += (gap - r->gap) / (float)r->points;
        canopy_refine_add_weights(r, &w, w.sum, r->cost);
    }
    return CANOPY_OK;
}

// Fine knot interval and place in it; false beside the grid.
static bool place_on(const struct canopy_refine *r, int axis, uint32_t interval, float s, uint32_t *g,
                     float *fraction) {
    if (interval + 1U >= r->frame.size[axis] || !(s >= 0 && s <= 1)) {
        return false;
    }
    const uint32_t step = 1U << r->window.level;
    const float fine = s * (float)step;
    const uint32_t part = (uint32_t)fine < step ? (uint32_t)fine : step - 1;
    *g = interval * step + part;
    *fraction = fine - (float)part;
    return true;
}

enum canopy_status canopy_refine_add(struct canopy_refine *refine, const uint32_t interval[2], const float s[2],
                                     int32_t height) {
    struct canopy_refine *r = refine;
    uint32_t g[2];
    float at[2];
    if (r->stage != CANOPY_REFINE_FILLING || !place_on(r, 0, interval[0], s[0], &g[0], &at[0]) ||
        !place_on(r, 1, interval[1], s[1], &g[1], &at[1])) {
        return CANOPY_ARGUMENT;
    }
    if (height < -CANOPY_HEIGHT_LIMIT || height > CANOPY_HEIGHT_LIMIT) {
        return CANOPY_RANGE;
    }
    if (!canopy_refinement_meets(&r->window, r->window.level, g)) {
        return CANOPY_OK;
    }
    const int32_t row = (int32_t)g[0] - r->window.first[0] + 2, column = (int32_t)g[1] - r->window.first[1] + 2;
    const uint32_t cell = (uint32_t)row * canopy_refine_across(r) + (uint32_t)column;
    enum canopy_status status = look(r, g, cell);
    if (status == CANOPY_OK) {
        status = add_constraint(r, cell, at[0], at[1], height);
    }
    if (status == CANOPY_OK) {
        take_height(r, cell, height);
    }
    return status;
}

// The highest cell around node (row, column) of a field.
static int32_t node_height(const struct canopy_field *field, uint32_t row, uint32_t column) {
    const uint32_t rows = field->axis[0].count, columns = field->axis[1].count;
    int32_t height = CANOPY_NO_HEIGHT;
    for (uint32_t i = row > 0 ? row - 1 : 0; i <= row && i < rows; i++) {
        for (uint32_t j = column > 0 ? column - 1 : 0; j <= column && j < columns; j++) {
            const int32_t here = canopy_field_height(field, i * columns + j);
            height = here > height ? here : height;
        }
    }
    return height;
}

// First and last node of a field that the window reaches.
static void nodes_of(const struct canopy_refine *r, const struct canopy_field *field, int axis, uint32_t nodes[2]) {
    const int32_t step = field->axis[axis].cells >> r->window.level, first = r->window.first[axis];
    const int32_t low = (first - 2) * step, high = (first + r->window.size[axis] + 1) * step;
    const int32_t count = (int32_t)field->axis[axis].count;
    nodes[0] = (uint32_t)(low > 0 ? low : 0);
    nodes[1] = (uint32_t)(high < count ? high : count);
}

static void node_place(const struct canopy_field_axis *axis, uint32_t node, uint32_t *interval, float *s) {
    const uint32_t h = node / axis->cells, last = axis->count / axis->cells - 1;
    *interval = h < last ? h : last;
    *s = (float)(node - *interval * axis->cells) / (float)axis->cells;
}

enum canopy_status canopy_refine_field(struct canopy_refine *refine, struct canopy_refine_certify *certify) {
    const struct canopy_field *field = certify->field;
    uint32_t rows[2], columns[2], interval[2];
    float s[2];
    if (canopy_frame_difference(&field->frame, &refine->frame) != CANOPY_SAME || refine->rows > 0) {
        return CANOPY_ARGUMENT;
    }
    for (int a = 0; a < 2; a++) {
        if (field->axis[a].cells % (1U << refine->window.level) != 0) {
            return CANOPY_ARGUMENT;
        }
    }
    refine->certify = certify;
    nodes_of(refine, field, 0, rows);
    nodes_of(refine, field, 1, columns);
    for (uint32_t i = rows[0]; i <= rows[1]; i++) {
        node_place(&field->axis[0], i, &interval[0], &s[0]);
        for (uint32_t j = columns[0]; j <= columns[1]; j++) {
            const int32_t height = node_height(field, i, j);
            if (height != CANOPY_NO_HEIGHT) {
                node_place(&field->axis[1], j, &interval[1], &s[1]);
                const enum canopy_status status = canopy_refine_add(refine, interval, s, height);
                if (status != CANOPY_OK) {
                    return status;
                }
            }
        }
    }
    return CANOPY_OK;
}

// ---- What the occupied cells have in sight

// The fine cell of the grid that a cell of the window is; false beside the grid.
static bool grid_cell(const struct canopy_refine *r, uint32_t cell, uint32_t g[2]) {
    const int32_t at[2] = {(int32_t)(cell / canopy_refine_across(r)), (int32_t)(cell % canopy_refine_across(r))};
    for (int a = 0; a < 2; a++) {
        const int32_t here = r->window.first[a] - 2 + at[a];
        if (here < 0 || here >= (int32_t)((r->frame.size[a] - 1U) << r->window.level)) {
            return false;
        }
        g[a] = (uint32_t)here;
    }
    return true;
}

// Constraints on the Bernstein coefficients over an occupied cell, which are 36 times at most what they are here.
static enum canopy_status add_pits(struct canopy_refine *r, uint32_t cell) {
    for (int p = 0; p < 16; p++) {
        const enum canopy_status status =
            add_constraint(r, cell, (float)(-1 - p / 4), (float)(-1 - p % 4), r->low[cell]);  // NOLINT
        if (status != CANOPY_OK) {
            return status;
        }
    }
    return CANOPY_OK;
}

// What an occupied cell has in sight is seen, and reaches from floor to ceiling, zero included.
static void see(struct canopy_refine *r, uint32_t cell) {
    const struct canopy_refine_sight sight = canopy_refine_sight_of(r, cell);
    const uint32_t n = r->window.size[1];
    const float floor = (float)r->height[0] - r->unit, ceiling = (float)r->height[1] + r->unit;
    const float limit = fminf(REACH, 0.5f * (float)CANOPY_REFINED_LIMIT * r->per_step);
    for (uint32_t a = 0; a < sight.rows; a++) {
        for (uint32_t e = 0; e < sight.columns; e++) {
            const size_t i = (size_t)(sight.i + a) * n + sight.j + e;
            const float here = (float)r->c[sight.skip[0] + a][sight.skip[1] + e];
            r->seen[i] = 1;
            r->reach[0][i] = fmaxf(fminf((floor - here) * r->per_step, -CANOPY_REFINE_FRESH), -limit);
            r->reach[1][i] = fminf(fmaxf((ceiling - here) * r->per_step, CANOPY_REFINE_FRESH), limit);
        }
    }
}

enum canopy_status canopy_refine_see_cells(struct canopy_refine *r) {
    const uint32_t cells = (uint32_t)CANOPY_REFINE_CELLS(r->window.size[0], r->window.size[1]);
    for (uint32_t cell = 0; cell < cells; cell++) {
        uint32_t g[2];
        if (r->low[cell] == CANOPY_NO_HEIGHT || !grid_cell(r, cell, g)) {
            continue;
        }
        enum canopy_status status = look(r, g, cell);
        if (status == CANOPY_OK && r->certify == NULL) {
            status = add_pits(r, cell);
        }
        if (status != CANOPY_OK) {
            return status;
        }
        see(r, cell);
    }
    return CANOPY_OK;
}
