#include <math.h>
#include <string.h>

#include "lib/cover/refine.h"
#include "lib/cover/tighten_f32.h"

#define FRESH 0.05f       // least slack of the first iterate
#define RIDGE 1e-6f       // added to the matrix, of its mean diagonal
#define SHORT 0.95f       // how much of the way to the boundary is gone
#define ENOUGH 5e-4f      // of the mean gap: complementarity at which it ends
#define STALLED 1e-3f     // as do steps that are both shorter
#define PUBLISH 4         // iterations between candidates
#define REACH 7.5f        // no coefficient is farther from zero, in units
#define LOOSE -8.0f       // a constraint below is none
#define NO_WEIGHT 1e-12f  // of all coefficients in sight: what a step of theirs moves is beyond any height format
#define UNIT_LEAST 64
#define TRIES 6            // to mend a cell by raising all that is in sight
#define FRACTION_RAISED 4  // afterwards a negative coefficient goes this part of its way to zero, at least

// How far a sum over 16 coefficients, evaluated here, may be from the true one, relative to the largest: weights 8
// roundings, their products, scaling and sums 12, the coefficients and the unit 3, each 2^-24: below 2^-19, doubled.
#define ERROR 0x1p-18f

// ---- What of the window a fine cell has in sight

struct sight {
    uint32_t i, j;           // first coefficient in sight
    uint32_t rows, columns;  // how many
    uint32_t skip[2];        // how many of the four are not, before those
};

static uint32_t across(const struct canopy_refine *r) { return r->window.size[1] + 3U; }

static struct sight sight_of(const struct canopy_refine *r, uint32_t cell) {
    const uint32_t at[2] = {cell / across(r), cell % across(r)};
    uint32_t first[2], count[2];
    struct sight sight;
    for (int a = 0; a < 2; a++) {
        const uint32_t size = r->window.size[a], end = at[a] + 1 < size ? at[a] + 1 : size;
        first[a] = at[a] > 3 ? at[a] - 3 : 0;
        count[a] = end - first[a];
        sight.skip[a] = first[a] + 3 - at[a];
    }
    sight.i = first[0];
    sight.j = first[1];
    sight.rows = count[0];
    sight.columns = count[1];
    return sight;
}

// The weights of Bernstein coefficient p, in sixths.
static const float pits[4][4] = {{1, 4, 1, 0}, {0, 4, 2, 0}, {0, 2, 4, 0}, {0, 1, 4, 1}};

static void axis_weights(float s, float w[4]) {
    if (s >= 0) {
        canopy_basis_f32(s, w, NULL);
        return;
    }
    const float *sixths = pits[(int)(-1 - s)];
    for (int a = 0; a < 4; a++) {
        w[a] = sixths[a] * (1.0f / 6.0f);
    }
}

// A constraint's row of the matrix: weights of the coefficients in sight, those along v divided by the sum of all.
struct weights {
    struct sight sight;
    float u[4], v[4], sum;
};

static struct weights weights_of(const struct canopy_refine *r, const struct canopy_refine_row *row) {
    struct weights w = {.sight = sight_of(r, row->cell)};
    float u[4], v[4], sum_u = 0, sum_v = 0;
    axis_weights(row->s, u);
    axis_weights(row->t, v);
    for (uint32_t a = 0; a < w.sight.rows; a++) {
        w.u[a] = u[w.sight.skip[0] + a];
        sum_u += w.u[a];
    }
    for (uint32_t e = 0; e < w.sight.columns; e++) {
        w.v[e] = v[w.sight.skip[1] + e];
        sum_v += w.v[e];
    }
    w.sum = sum_u * sum_v;
    const float scale = w.sum > NO_WEIGHT ? 1.0f / w.sum : 0.0f;
    for (uint32_t e = 0; e < w.sight.columns; e++) {
        w.v[e] *= scale;
    }
    return w;
}

static float times(const struct canopy_refine *r, const struct weights *w, const float *x) {
    const uint32_t n = r->window.size[1];
    float sum = 0;
    for (uint32_t a = 0; a < w->sight.rows; a++) {
        const float *row = x + (size_t)(w->sight.i + a) * n + w->sight.j;
        float inner = 0;
        for (uint32_t e = 0; e < w->sight.columns; e++) {
            inner += w->v[e] * row[e];
        }
        sum += w->u[a] * inner;
    }
    return sum;
}

static void add_row(const struct canopy_refine *r, const struct weights *w, float factor, float *to) {
    const uint32_t n = r->window.size[1];
    for (uint32_t a = 0; a < w->sight.rows; a++) {
        float *row = to + (size_t)(w->sight.i + a) * n + w->sight.j;
        const float here = factor * w->u[a];
        for (uint32_t e = 0; e < w->sight.columns; e++) {
            row[e] += here * w->v[e];
        }
    }
}

// factor times the row's square into the lower band.
static void add_square(const struct canopy_refine *r, const struct weights *w, float factor) {
    const size_t n = r->window.size[1], stride = CANOPY_TIGHTEN_BAND(n);
    for (uint32_t a = 0; a < w->sight.rows; a++) {
        for (uint32_t e = 0; e < w->sight.columns; e++) {
            const size_t i = (w->sight.i + a) * n + w->sight.j + e;
            const float here = factor * w->u[a] * w->v[e];
            for (uint32_t k = 0; k <= a; k++) {
                const uint32_t end = k == a ? e + 1 : w->sight.columns;
                const float by = here * w->u[k];
                float *band = r->matrix + i * stride + (stride - 1) - (a - k) * n - e;
                for (uint32_t l = 0; l < end; l++) {
                    band[l] += by * w->v[l];
                }
            }
        }
    }
}

// ---- Init and filling

static size_t coefficients(const struct canopy_refine *r) { return (size_t)r->window.size[0] * r->window.size[1]; }

enum canopy_status canopy_refine_init(struct canopy_refine *refine, const struct canopy_frame *frame, const int32_t *b,
                                      const struct canopy_refinement *windows, uint32_t count, size_t rows, void *arena,
                                      size_t bytes) {
    struct canopy_refine *r = refine;
    uint32_t which;
    if (count == 0 || count > CANOPY_REFINEMENTS_MAX || rows == 0 || rows > UINT32_MAX / 2) {
        return CANOPY_ARGUMENT;
    }
    const struct canopy_refinement *window = &windows[count - 1];
    const size_t size = (size_t)window->size[0] * window->size[1];
    struct canopy_arena cut;
    enum canopy_status status =
        canopy_arena_open(&cut, arena, bytes, CANOPY_REFINE_ARENA(window->size[0], window->size[1], rows));
    if (status == CANOPY_OK && window->d != NULL) {
        memset(window->d, 0, 4 * size);
    }
    status = status == CANOPY_OK ? canopy_refine_check(frame, windows, count, &which) : status;
    if (status != CANOPY_OK) {
        return status;
    }
    for (uint32_t k = 0; k < count; k++) {
        if (windows[k].level > window->level) {
            return CANOPY_ARGUMENT;
        }
    }
    *r = (struct canopy_refine){.frame = *frame, .b = b, .count = count, .window = *window, .room = rows};
    memcpy(r->list, windows, count * sizeof *windows);
    r->row = canopy_arena_take(&cut, rows * sizeof *r->row);
    r->low = canopy_arena_take(&cut, 4 * CANOPY_REFINE_CELLS(window->size[0], window->size[1]));
    r->matrix = canopy_arena_take(&cut, 4 * size * CANOPY_TIGHTEN_BAND(window->size[1]));
    float **const vectors[] = {&r->cost, &r->x,        &r->step,     &r->affine,  &r->rhs,    &r->g[0],
                               &r->g[1], &r->reach[0], &r->reach[1], &r->dual[0], &r->dual[1]};
    for (size_t k = 0; k < sizeof vectors / sizeof vectors[0]; k++) {
        *vectors[k] = canopy_arena_take(&cut, 4 * size);
        memset(*vectors[k], 0, 4 * size);
    }
    r->candidate = canopy_arena_take(&cut, 4 * size);
    memset(r->candidate, 0, 4 * size);
    r->seen = canopy_arena_take(&cut, size);
    memset(r->seen, 0, size);
    r->list[count - 1].d = r->candidate;
    for (size_t k = 0; k < CANOPY_REFINE_CELLS(window->size[0], window->size[1]); k++) {
        r->low[k] = CANOPY_NO_HEIGHT;
    }
    r->height[0] = INT32_MAX;
    r->height[1] = INT32_MIN;
    r->cached = UINT32_MAX;
    return CANOPY_OK;
}

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
    axis_weights(s, u);
    axis_weights(t, v);
    for (int a = 0; a < 4; a++) {
        for (int e = 0; e < 4; e++) {
            const float over = (float)(r->c[a][e] - height);
            sum += u[a] * v[e] * over;
            most = fmaxf(most, fabsf(over));
        }
    }
    return sum - ERROR * most;
}

// A constraint that the window can do something about; its bound is in steps until the filling ends.
static enum canopy_status add_constraint(struct canopy_refine *r, uint32_t cell, float s, float t, int32_t height) {
    struct canopy_refine_row row = {.cell = cell, .s = s, .t = t};
    const struct weights w = weights_of(r, &row);
    if (!(w.sum > NO_WEIGHT)) {
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
        add_row(r, &w, w.sum, r->cost);
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
    const uint32_t cell = (uint32_t)row * across(r) + (uint32_t)column;
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

// ---- Begin

// The fine cell of the grid that a cell of the window is; false beside the grid.
static bool grid_cell(const struct canopy_refine *r, uint32_t cell, uint32_t g[2]) {
    const int32_t at[2] = {(int32_t)(cell / across(r)), (int32_t)(cell % across(r))};
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
    const struct sight sight = sight_of(r, cell);
    const uint32_t n = r->window.size[1];
    const float floor = (float)r->height[0] - r->unit, ceiling = (float)r->height[1] + r->unit;
    const float limit = fminf(REACH, 0.5f * (float)CANOPY_REFINED_LIMIT * r->per_step);
    for (uint32_t a = 0; a < sight.rows; a++) {
        for (uint32_t e = 0; e < sight.columns; e++) {
            const size_t i = (size_t)(sight.i + a) * n + sight.j + e;
            const float here = (float)r->c[sight.skip[0] + a][sight.skip[1] + e];
            r->seen[i] = 1;
            r->reach[0][i] = fmaxf(fminf((floor - here) * r->per_step, -FRESH), -limit);
            r->reach[1][i] = fminf(fmaxf((ceiling - here) * r->per_step, FRESH), limit);
        }
    }
}

static enum canopy_status see_cells(struct canopy_refine *r) {
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

// Bounds to units; those that no window within its reach can come near are left out.
static void scale_bounds(struct canopy_refine *r) {
    uint32_t kept = 0;
    for (uint32_t k = 0; k < r->rows; k++) {
        struct canopy_refine_row row = r->row[k];
        row.bound *= r->per_step;
        if (row.bound > LOOSE) {
            r->row[kept++] = row;
        }
    }
    r->rows = kept;
}

enum canopy_status canopy_refine_begin(struct canopy_refine *refine) {
    struct canopy_refine *r = refine;
    if (r->stage != CANOPY_REFINE_FILLING) {
        return CANOPY_ARGUMENT;
    }
    if (r->points == 0) {
        return CANOPY_EMPTY;
    }
    const int32_t range = r->height[1] - r->height[0];
    r->unit = fmaxf((float)(range > UNIT_LEAST ? range : UNIT_LEAST), r->gap);
    r->per_step = 1.0f / r->unit;
    const enum canopy_status status = see_cells(r);
    if (status != CANOPY_OK) {
        return status;
    }
    scale_bounds(r);
    const float each = 1.0f / (float)r->points;
    for (size_t i = 0; i < coefficients(r); i++) {
        r->cost[i] *= each;
    }
    r->before = r->gap;
    r->after = r->gap;
    r->gap *= r->per_step;
    r->best = r->gap;
    r->stage = CANOPY_REFINE_START;
    return CANOPY_OK;
}

// ---- Passes over the constraints, a chunk at a time

static void ratio(float *most, float by, float of) { *most = fmaxf(*most, -by / of); }

static void start_row(struct canopy_refine *r, struct canopy_refine_row *row) {
    row->slack = fmaxf(-row->bound, FRESH);
    row->dual = 1.0f / row->slack;
    r->sums[0] += row->dual;
}

static void measure_row(struct canopy_refine *r, struct canopy_refine_row *row) {
    const struct weights w = weights_of(r, row);
    row->slack += r->alpha[0] * row->slack_by;
    row->dual = row->dual * r->sums[2] + r->alpha[1] * row->dual_by;
    const float off = times(r, &w, r->x) - row->slack - row->bound, ratio_here = row->dual / row->slack;
    r->comp += row->slack * row->dual;
    add_square(r, &w, ratio_here);
    add_row(r, &w, -ratio_here * off, r->rhs);
}

static void affine_row(struct canopy_refine *r, struct canopy_refine_row *row) {
    const struct weights w = weights_of(r, row);
    const float off = times(r, &w, r->x) - row->slack - row->bound;
    const float slack_by = times(r, &w, r->affine) + off, inverse = 1.0f / row->slack;
    const float dual_by = -row->dual - row->dual * inverse * slack_by;
    row->slack_by = slack_by;
    row->dual_by = dual_by;
    ratio(&r->most[0], slack_by, row->slack);
    ratio(&r->most[1], dual_by, row->dual);
    r->sums[0] += row->slack * dual_by;
    r->sums[1] += row->dual * slack_by;
    r->sums[2] += slack_by * dual_by;
    add_row(r, &w, inverse, r->g[0]);
    add_row(r, &w, slack_by * dual_by * inverse, r->g[1]);
}

// r->comp: the complementarity to aim at.
static void step_row(struct canopy_refine *r, struct canopy_refine_row *row) {
    const struct weights w = weights_of(r, row);
    const float off = times(r, &w, r->x) - row->slack - row->bound;
    const float slack_by = times(r, &w, r->step) + off;
    const float product = r->comp - row->slack_by * row->dual_by;
    row->dual_by = (product - row->dual * slack_by) / row->slack - row->dual;
    row->slack_by = slack_by;
    ratio(&r->most[0], slack_by, row->slack);
    ratio(&r->most[1], row->dual_by, row->dual);
}

// ---- The reach: constraints on single coefficients

// Side 0: x - floor >= 0; side 1: ceiling - x >= 0.
struct side {
    float slack, dual, sign;
};

static struct side side_of(const struct canopy_refine *r, int side, size_t i) {
    const float sign = side == 0 ? 1.0f : -1.0f;
    return (struct side){sign * (r->x[i] - r->reach[side][i]), r->dual[side][i], sign};
}

static float affine_dual(const struct canopy_refine *r, const struct side *s, size_t i) {
    return -s->dual - s->dual / s->slack * s->sign * r->affine[i];
}

static float step_dual(const struct canopy_refine *r, const struct side *s, size_t i) {
    const float product = r->comp - s->sign * r->affine[i] * affine_dual(r, s, i);
    return (product - s->dual * s->sign * r->step[i]) / s->slack - s->dual;
}

// ---- Stages

static void enter(struct canopy_refine *r, enum canopy_refine_stage stage) {
    r->stage = (uint8_t)stage;
    r->at = 0;
    r->most[0] = r->most[1] = 1e-6f;
    if (stage != CANOPY_REFINE_MEASURE) {
        r->sums[0] = r->sums[1] = r->sums[2] = 0;
    }
}

static void enter_measure(struct canopy_refine *r, float dual_scale) {
    const size_t count = coefficients(r);
    memset(r->matrix, 0, 4 * count * CANOPY_TIGHTEN_BAND(r->window.size[1]));
    for (size_t i = 0; i < count; i++) {
        r->rhs[i] = -r->cost[i];
    }
    enter(r, CANOPY_REFINE_MEASURE);
    r->comp = 0;
    r->sums[2] = dual_scale;
}

static void end_start(struct canopy_refine *r) {
    float sum = r->sums[0];
    for (size_t i = 0; i < coefficients(r); i++) {
        for (int side = 0; side < 2 && r->seen[i]; side++) {
            sum += 1.0f / side_of(r, side, i).slack;
        }
    }
    const float scale = 1.0f / sum;  // duals that sum to what the objective's weights do
    for (size_t i = 0; i < coefficients(r); i++) {
        for (int side = 0; side < 2 && r->seen[i]; side++) {
            r->dual[side][i] = scale / side_of(r, side, i).slack;
        }
    }
    r->alpha[0] = r->alpha[1] = 0;
    enter_measure(r, scale);
}

// The window's share of the mean gap, in units, for whole coefficients.
static float share(const struct canopy_refine *r, const int32_t *d) {
    float sum = 0;
    for (size_t i = 0; i < coefficients(r); i++) {
        sum += r->cost[i] * ((float)d[i] * r->per_step);
    }
    return sum;
}

static void next_iteration(struct canopy_refine *r) { enter(r, r->last ? CANOPY_REFINE_DONE : CANOPY_REFINE_FACTOR); }

static void enter_candidate(struct canopy_refine *r) {
    for (size_t i = 0; i < coefficients(r); i++) {
        r->candidate[i] = r->seen[i] ? (int32_t)ceilf(r->x[i] * r->unit) : 0;
    }
    if (!(r->gap + share(r, r->candidate) < r->best)) {
        next_iteration(r);
        return;
    }
    r->raised = false;
    r->tries = 0;
    r->tried = UINT32_MAX;
    enter(r, CANOPY_REFINE_MEND);
    if (r->certify != NULL) {
        enter(r, CANOPY_REFINE_CERTIFY);
        if (canopy_refine_certify_begin(r->certify, r->b, r->list, r->count) != CANOPY_OK) {
            next_iteration(r);
        }
    }
}

// The diagonal: reach, and what makes it regular. True: near enough to the end.
static bool end_measure(struct canopy_refine *r) {
    const size_t stride = CANOPY_TIGHTEN_BAND(r->window.size[1]);
    float trace = 0, gap = r->gap;
    uint32_t seen = 0;
    for (size_t i = 0; i < coefficients(r); i++) {
        float *diagonal = &r->matrix[i * stride + stride - 1];
        for (int side = 0; side < 2 && r->seen[i]; side++) {
            const struct side s = side_of(r, side, i);
            *diagonal += s.dual / s.slack;
            r->comp += s.dual * s.slack;
        }
        trace += *diagonal;
        seen += r->seen[i];
        gap += r->cost[i] * r->x[i];
    }
    const float ridge = RIDGE * trace / (float)seen;
    for (size_t i = 0; i < coefficients(r); i++) {
        r->matrix[i * stride + stride - 1] += r->seen[i] ? ridge : 1.0f;
        r->rhs[i] = r->seen[i] ? r->rhs[i] : 0.0f;
    }
    const bool stalled = r->iterations > 0 && fmaxf(r->alpha[0], r->alpha[1]) < STALLED;
    return !(r->comp > ENOUGH * gap) || stalled || r->iterations == CANOPY_REFINE_ITERATIONS;
}

static void after_measure(struct canopy_refine *r) {
    r->last = end_measure(r);
    if (r->last || (r->iterations > 0 && r->iterations % PUBLISH == 0)) {
        enter_candidate(r);
    } else {
        next_iteration(r);
    }
}

static float step_length(float most) { return fminf(1.0f, SHORT / most); }

static void end_affine(struct canopy_refine *r) {
    const float count = (float)(2 * coefficients(r) + r->rows);
    for (size_t i = 0; i < coefficients(r); i++) {
        for (int side = 0; side < 2 && r->seen[i]; side++) {
            const struct side s = side_of(r, side, i);
            const float slack_by = s.sign * r->affine[i], dual_by = affine_dual(r, &s, i);
            ratio(&r->most[0], slack_by, s.slack);
            ratio(&r->most[1], dual_by, s.dual);
            r->sums[0] += s.slack * dual_by;
            r->sums[1] += s.dual * slack_by;
            r->sums[2] += slack_by * dual_by;
            r->g[0][i] += s.sign / s.slack;
            r->g[1][i] += s.sign * slack_by * dual_by / s.slack;
        }
    }
    const float primal = fminf(1.0f, 1.0f / r->most[0]), dual = fminf(1.0f, 1.0f / r->most[1]);
    const float after = r->comp + dual * r->sums[0] + primal * r->sums[1] + primal * dual * r->sums[2];
    const float part = fmaxf(after, 0.0f) / r->comp;
    r->comp *= part * part * part / count;
    for (size_t i = 0; i < coefficients(r); i++) {
        r->step[i] = r->seen[i] ? r->rhs[i] + r->comp * r->g[0][i] - r->g[1][i] : 0.0f;
    }
}

static void end_step(struct canopy_refine *r) {
    for (size_t i = 0; i < coefficients(r); i++) {
        for (int side = 0; side < 2 && r->seen[i]; side++) {
            const struct side s = side_of(r, side, i);
            ratio(&r->most[0], s.sign * r->step[i], s.slack);
            ratio(&r->most[1], step_dual(r, &s, i), s.dual);
        }
    }
    for (int a = 0; a < 2; a++) {
        r->alpha[a] = step_length(r->most[a]);
    }
    for (size_t i = 0; i < coefficients(r); i++) {
        for (int side = 0; side < 2 && r->seen[i]; side++) {
            const struct side s = side_of(r, side, i);
            r->dual[side][i] += r->alpha[1] * step_dual(r, &s, i);
        }
        r->x[i] += r->seen[i] ? r->alpha[0] * r->step[i] : 0.0f;
    }
    r->iterations++;
    enter_measure(r, 1.0f);
}

static void solve(struct canopy_refine *r, float *rhs) {
    canopy_tighten_solve(r->matrix, r->window.size[1], (uint32_t)coefficients(r), rhs);
}

// ---- Candidates

// Raises what is in sight of a cell by as much as `by`, at the tries-th try at it. The first few raise all alike: that
// is enough where the window's edge cuts nothing off. Afterwards negative ones go towards zero, where the window lowers
// nothing.
static void raise(struct canopy_refine *r, const struct sight *sight, int32_t by, uint32_t tries) {
    const uint32_t n = r->window.size[1];
    for (uint32_t a = 0; a < sight->rows; a++) {
        int32_t *d = r->candidate + (size_t)(sight->i + a) * n + sight->j;
        for (uint32_t e = 0; e < sight->columns; e++) {
            if (tries < TRIES) {
                d[e] += by;
            } else if (d[e] < 0) {
                const int32_t rise = -d[e] / FRACTION_RAISED + 1;
                d[e] = d[e] + rise < 0 ? d[e] + rise : 0;
            }
        }
    }
}

static float largest(const struct canopy_refine *r, const struct sight *sight, bool *lowers) {
    const uint32_t n = r->window.size[1];
    float most = 0;
    *lowers = false;
    for (uint32_t a = 0; a < sight->rows; a++) {
        const int32_t *d = r->candidate + (size_t)(sight->i + a) * n + sight->j;
        for (uint32_t e = 0; e < sight->columns; e++) {
            *lowers = *lowers || d[e] < 0;
            most = fmaxf(most, fabsf((float)d[e]));
        }
    }
    return most;
}

static void mend_row(struct canopy_refine *r, struct canopy_refine_row *row) {
    const struct weights w = weights_of(r, row);
    const uint32_t n = r->window.size[1];
    bool lowers;
    const float most = largest(r, &w.sight, &lowers);
    if (!lowers) {
        return;
    }
    float sum = 0;
    for (uint32_t a = 0; a < w.sight.rows; a++) {
        const int32_t *d = r->candidate + (size_t)(w.sight.i + a) * n + w.sight.j;
        float inner = 0;
        for (uint32_t e = 0; e < w.sight.columns; e++) {
            inner += w.v[e] * (float)d[e];
        }
        sum += w.u[a] * inner;
    }
    const float bound = row->bound * r->unit * (1.0f - 0x1p-20f), missing = bound - (sum - ERROR * most);
    if (missing > 0) {
        raise(r, &w.sight, (int32_t)ceilf(missing) + 1, r->tries);
        r->raised = true;
    }
}

static void publish(struct canopy_refine *r) {
    const float gap = r->gap + share(r, r->candidate);
    if (gap < r->best) {
        memcpy(r->window.d, r->candidate, 4 * coefficients(r));
        r->best = gap;
        r->after = gap * r->unit;
        r->published++;
    }
    next_iteration(r);
}

// Raises what the certificate misses. False: the window cannot mend it.
static bool mend_field(struct canopy_refine *r) {
    const struct canopy_field *field = r->certify->field;
    const uint32_t columns = field->axis[1].count, cell = r->certify->failed_cell;
    const uint32_t at[2] = {cell / columns / ((uint32_t)field->axis[0].cells >> r->window.level),
                            cell % columns / ((uint32_t)field->axis[1].cells >> r->window.level)};
    if (!canopy_refinement_meets(&r->window, r->window.level, at)) {
        return false;
    }
    const uint32_t row = (uint32_t)((int32_t)at[0] - r->window.first[0] + 2);
    const uint32_t column = (uint32_t)((int32_t)at[1] - r->window.first[1] + 2);
    const struct sight sight = sight_of(r, row * across(r) + column);
    bool lowers;
    (void)largest(r, &sight, &lowers);
    if (!lowers) {
        return false;
    }
    r->tries = cell == r->tried ? r->tries + 1 : 0;
    r->tried = cell;
    const int32_t most = CANOPY_REFINED_LIMIT >> (TRIES + 4);
    raise(r, &sight, (r->certify->missing < most ? r->certify->missing : most) << r->tries % TRIES, r->tries);
    return true;
}

static void certify(struct canopy_refine *r) {
    const enum canopy_status status = canopy_refine_certify_step(r->certify, CANOPY_REFINE_CHUNK);
    if (status == CANOPY_OK) {
        publish(r);
    } else if (status != CANOPY_MORE && (status != CANOPY_NOT_SAFE || !mend_field(r))) {
        next_iteration(r);
    }
}

// ---- Steps

typedef void pass(struct canopy_refine *r, struct canopy_refine_row *row);

// A chunk of a pass; true when that was the last.
static bool go_on(struct canopy_refine *r, pass *each) {
    const uint32_t left = r->rows - r->at, count = left < CANOPY_REFINE_CHUNK ? left : CANOPY_REFINE_CHUNK;
    for (uint32_t k = 0; k < count; k++) {
        each(r, &r->row[r->at + k]);
    }
    r->at += count;
    return r->at == r->rows;
}

static void mend(struct canopy_refine *r) {
    if (go_on(r, mend_row)) {
        if (r->raised) {
            r->raised = false;
            r->tries++;
            enter(r, CANOPY_REFINE_MEND);
        } else {
            publish(r);
        }
    }
}

static void factor(struct canopy_refine *r) {
    const uint32_t n = r->window.size[1];
    canopy_tighten_factor(r->matrix, n, r->at, r->at + n);
    r->at += n;
    if (r->at == coefficients(r)) {
        enter(r, CANOPY_REFINE_PREDICT);
    }
}

static void predict(struct canopy_refine *r) {
    memcpy(r->affine, r->rhs, 4 * coefficients(r));
    solve(r, r->affine);
    memset(r->g[0], 0, 4 * coefficients(r));
    memset(r->g[1], 0, 4 * coefficients(r));
    enter(r, CANOPY_REFINE_AFFINE);
}

static void do_unit(struct canopy_refine *r) {
    switch ((enum canopy_refine_stage)r->stage) {
    case CANOPY_REFINE_START:
        if (go_on(r, start_row)) {
            end_start(r);
        }
        break;
    case CANOPY_REFINE_MEASURE:
        if (go_on(r, measure_row)) {
            after_measure(r);
        }
        break;
    case CANOPY_REFINE_MEND: mend(r); break;
    case CANOPY_REFINE_CERTIFY: certify(r); break;
    case CANOPY_REFINE_FACTOR: factor(r); break;
    case CANOPY_REFINE_PREDICT: predict(r); break;
    case CANOPY_REFINE_AFFINE:
        if (go_on(r, affine_row)) {
            end_affine(r);
            enter(r, CANOPY_REFINE_COMBINE);
        }
        break;
    case CANOPY_REFINE_COMBINE:
        solve(r, r->step);
        enter(r, CANOPY_REFINE_STEP);
        break;
    case CANOPY_REFINE_STEP:
        if (go_on(r, step_row)) {
            end_step(r);
        }
        break;
    case CANOPY_REFINE_FILLING:
    case CANOPY_REFINE_DONE: break;
    }
}

enum canopy_status canopy_refine_step(struct canopy_refine *refine, uint32_t budget) {
    if (refine->stage == CANOPY_REFINE_FILLING) {
        return CANOPY_EMPTY;
    }
    for (; budget > 0 && refine->stage != CANOPY_REFINE_DONE; budget--) {
        do_unit(refine);
    }
    return refine->stage == CANOPY_REFINE_DONE ? CANOPY_OK : CANOPY_MORE;
}
