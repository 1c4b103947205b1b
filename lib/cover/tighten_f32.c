#include "lib/cover/tighten_f32.h"

#include <math.h>
#include <string.h>

#include "lib/cover/fast.h"
#include "lib/num/fixed.h"

#define PITS 7
#define SIDES 2               // of the reach: floor and ceiling
#define FRESH 0.2f            // the first iterate stands this much above the start
#define LID 1.1f              // or it is this flat one …
#define LID_OVER 1.95f        // … above another surface
#define RIDGE 1e-6f           // added to the matrix, of its mean diagonal
#define CORRECTORS 2          // centrality correctors an iteration, at most
#define AIM 0.3f              // by how much longer a step a corrector aims at …
#define WORTH 0.1f            // … and which part of it makes it worth taking
#define SHORT 0.95f           // how much of the way to the boundary is gone
#define ENOUGH 5e-4f          // of the mean gap: complementarity at which it ends
#define STALLED 1e-4f         // as do steps that are both shorter
#define SPARE 0.5f            // how far a candidate may be raised
#define START_SPARE 4.0f      // and a start
#define OVER_MOST 1.9f        // of the height range: another surface that there is still room above
#define EDGE_LIMIT (1 << 24)  // edges of a float frame are whole quanta within +- this

// The second where the first is no number.
static float larger(float a, float b) { return a > b ? a : b; }
static float smaller(float a, float b) { return a < b ? a : b; }

// ---- Init

enum canopy_status canopy_tighten_init(struct canopy_tighten *tighten, const struct canopy_frame *frame, size_t points,
                                       void *arena, size_t bytes) {
    const uint16_t m = frame->size[0], n = frame->size[1];
    if (m < CANOPY_SIZE_MIN || n < CANOPY_SIZE_MIN || m > CANOPY_SIZE_MAX || n > CANOPY_SIZE_MAX || points == 0 ||
        points > UINT32_MAX / 2) {
        return CANOPY_ARGUMENT;
    }
    struct canopy_arena cut;
    const enum canopy_status status = canopy_arena_open(&cut, arena, bytes, CANOPY_TIGHTEN_ARENA(m, n, points));
    if (status != CANOPY_OK) {
        return status;
    }
    struct canopy_tighten *t = tighten;
    *t = (struct canopy_tighten){.frame = *frame, .room = points};
    const size_t cells = CANOPY_TIGHTEN_CELLS(m, n), unknowns = 4U * (size_t)m * n;
    t->blocks = canopy_arena_take(&cut, (points / CANOPY_TIGHTEN_LANES + cells) * sizeof *t->blocks);
    t->pits = canopy_arena_take(&cut, PITS * cells * sizeof *t->pits);
    t->first = canopy_arena_take(&cut, 4 * (cells + 1));
    t->half_low = canopy_arena_take(&cut, 16 * cells);
    t->matrix = canopy_arena_take(&cut, unknowns * CANOPY_TIGHTEN_BAND(n));
    float **const vectors[] = {&t->cost,    &t->x,       &t->step,       &t->affine,     &t->g[0],      &t->g[1],
                               &t->dual[0], &t->dual[1], &t->dual_by[0], &t->dual_by[1], &t->target[0], &t->target[1]};
    for (size_t k = 0; k < sizeof vectors / sizeof vectors[0]; k++) {
        *vectors[k] = canopy_arena_take(&cut, unknowns);
    }
    t->candidate = canopy_arena_take(&cut, unknowns);
    t->seen = canopy_arena_take(&cut, unknowns / 4);
    canopy_tighten_tables(t);
    return CANOPY_OK;
}

// ---- Points in

// Where a point is, and how high.
struct place {
    uint32_t cell;
    float s[2];
    int32_t height;
};

static bool place_axis_f32(const struct canopy_frame *frame, int a, float x, uint32_t *interval, float *s) {
    const float quantum = ldexpf(1.0f, frame->quantum_log2), pitch = (float)frame->pitch[a] * quantum;
    const int32_t origin = frame->origin[a], last = frame->size[a] - 2, step = (int32_t)frame->pitch[a];
    if (!(x >= (float)origin * quantum && x <= (float)(origin + (last + 1) * step) * quantum)) {
        return false;
    }
    int32_t h = (int32_t)((x - (float)origin * quantum) / pitch);  // off by one at most: edges are floats and decide
    h = h < last ? h : last;
    h -= x < (float)(origin + h * step) * quantum;
    h += h < last && x >= (float)(origin + (h + 1) * step) * quantum;
    *interval = (uint32_t)h;
    *s = smaller((x - (float)(origin + h * step) * quantum) / pitch, 1.0f);
    return true;
}

static enum canopy_status place_f32(const struct canopy_frame *frame, const float p[3], struct place *to) {
    uint32_t h, w;
    if (!place_axis_f32(frame, 0, p[0], &h, &to->s[0]) || !place_axis_f32(frame, 1, p[1], &w, &to->s[1]) ||
        !isfinite(p[2])) {
        return CANOPY_OUT_OF_FRAME;
    }
    const float limit = (float)(CANOPY_HEIGHT_LIMIT - 4), zero = ldexpf((float)frame->origin[2], frame->quantum_log2);
    const float scale = ldexpf(1.0f, -(frame->lsb_log2 + frame->quantum_log2));
    const float height = (p[2] - zero) * (frame->side == CANOPY_BELOW ? -scale : scale);
    if (!(height <= limit)) {
        return CANOPY_RANGE;
    }
    to->cell = h * (frame->size[1] - 1U) + w;
    to->height = height < -limit ? -CANOPY_HEIGHT_LIMIT : (int32_t)height + 2;  // rounded up, the difference included
    return CANOPY_OK;
}

static bool place_axis_fx(const struct canopy_frame *frame, int a, int32_t x, uint32_t *interval, float *s) {
    const int64_t offset = (int64_t)x - frame->origin[a];
    if (offset < 0 || (uint64_t)offset > canopy_frame_width(frame, a)) {
        return false;
    }
    const uint32_t last = frame->size[a] - 2U, whole = (uint32_t)offset / frame->pitch[a];
    *interval = whole < last ? whole : last;
    *s = (float)((uint32_t)offset - *interval * frame->pitch[a]) / (float)frame->pitch[a];
    *s = smaller(*s, 1.0f);
    return true;
}

static enum canopy_status place_fx(const struct canopy_frame *frame, const int32_t p[3], struct place *to) {
    uint32_t h, w;
    if (!place_axis_fx(frame, 0, p[0], &h, &to->s[0]) || !place_axis_fx(frame, 1, p[1], &w, &to->s[1])) {
        return CANOPY_OUT_OF_FRAME;
    }
    int64_t steps = (int64_t)p[2] - frame->origin[2];
    steps = frame->side == CANOPY_BELOW ? -steps : steps;
    steps = frame->lsb_log2 <= 0 ? steps * ((int64_t)1 << -frame->lsb_log2)
                                 : canopy_shift_ceil(steps, (unsigned)frame->lsb_log2);
    if (steps > CANOPY_HEIGHT_LIMIT) {
        return CANOPY_RANGE;
    }
    to->cell = h * (frame->size[1] - 1U) + w;
    to->height = steps < -CANOPY_HEIGHT_LIMIT ? -CANOPY_HEIGHT_LIMIT : (int32_t)steps;
    return CANOPY_OK;
}

// What points are read from: an array of either scalar, or a field's nodes.
struct source {
    const float (*f32)[3];
    const int32_t (*fx)[3];
    const struct canopy_field *field;
    size_t count;
};

// The node as high as the highest cell around it, in that cell's knot cell. CANOPY_EMPTY: no cell around has data.
static enum canopy_status place_node(const struct canopy_field *field, size_t node, struct place *to) {
    const uint32_t columns = field->axis[1].count, rows = field->axis[0].count;
    const uint32_t r = (uint32_t)(node / (columns + 1U)), c = (uint32_t)(node % (columns + 1U));
    uint32_t row = 0, column = 0;
    to->height = CANOPY_NO_HEIGHT;
    for (uint32_t i = r > 0 ? r - 1 : 0; i <= r && i < rows; i++) {
        for (uint32_t j = c > 0 ? c - 1 : 0; j <= c && j < columns; j++) {
            const int32_t height = field->heights[i * columns + j];
            if (height > to->height) {
                to->height = height;
                row = i;
                column = j;
            }
        }
    }
    if (to->height == CANOPY_NO_HEIGHT) {
        return CANOPY_EMPTY;
    }
    const uint32_t cu = field->axis[0].cells, cv = field->axis[1].cells;
    to->cell = row / cu * (columns / cv) + column / cv;
    const uint32_t down = r - row / cu * cu, across = c - column / cv * cv;
    to->s[0] = (float)down / (float)cu;
    to->s[1] = (float)across / (float)cv;
    return CANOPY_OK;
}

static enum canopy_status place(const struct canopy_tighten *t, const struct source *from, size_t i, struct place *to) {
    if (from->field != NULL) {
        return place_node(from->field, i, to);
    }
    return from->f32 != NULL ? place_f32(&t->frame, from->f32[i], to) : place_fx(&t->frame, from->fx[i], to);
}

static uint32_t cell_count(const struct canopy_tighten *t) { return (t->frame.size[0] - 1U) * (t->frame.size[1] - 1U); }

// First look: how many in each cell, and how high.
static enum canopy_status count_points(struct canopy_tighten *t, const struct source *from) {
    const uint32_t cells = cell_count(t);
    uint32_t *counts = t->first + 1;
    int32_t low = INT32_MAX, high = INT32_MIN;
    memset(t->first, 0, 4 * (cells + 1U));
    t->points = 0;
    for (size_t i = 0; i < from->count; i++) {
        struct place at;
        const enum canopy_status status = place(t, from, i, &at);
        if (status == CANOPY_EMPTY) {
            continue;
        }
        if (status != CANOPY_OK) {
            return status;
        }
        if (t->points == t->room) {
            return CANOPY_ARENA_SHORT;
        }
        t->points++;
        counts[at.cell]++;
        low = at.height < low ? at.height : low;
        high = at.height > high ? at.height : high;
    }
    if (t->points == 0) {
        return CANOPY_EMPTY;
    }
    t->low = low;
    t->range = (float)(high - low < 64 ? 64 : high - low);
    t->per_step = 1.0f / t->range;
    t->deepest = 0;
    for (uint32_t cell = 0; cell < cells; cell++) {
        const uint32_t blocks = (counts[cell] + CANOPY_TIGHTEN_LANES - 1) / CANOPY_TIGHTEN_LANES;
        t->deepest = blocks > t->deepest ? blocks : t->deepest;
        t->first[cell + 1] = t->first[cell] + blocks;
    }
    return CANOPY_OK;
}

static void clear_lanes(struct canopy_tighten_lanes *lanes) {
    memset(lanes, 0, sizeof *lanes);
    for (int l = 0; l < CANOPY_TIGHTEN_LANES; l++) {
        lanes->z[l] = CANOPY_TIGHTEN_NONE;
        lanes->slack[l] = 1.0f;
    }
}

static float height_of(const struct canopy_tighten *t, int32_t height) {
    return (float)(height - t->low) * t->per_step;
}

// A sum that does not lose the small beside the large (Neumaier).
struct sum {
    float high, low;
};

static void add(struct sum *sum, float x) {
    const float total = sum->high + x;
    sum->low += fabsf(sum->high) >= fabsf(x) ? (sum->high - total) + x : (x - total) + sum->high;
    sum->high = total;
}

// Second look: every point to its cell.
static void place_points(struct canopy_tighten *t, const struct source *from) {
    const uint32_t cells = cell_count(t);
    int32_t *taken = t->candidate;
    struct sum heights = {0, 0};
    memset(taken, 0, 4 * (size_t)cells);
    for (uint32_t k = 0; k < t->first[cells]; k++) {
        memset(&t->blocks[k], 0, sizeof t->blocks[k]);
        clear_lanes(&t->blocks[k].lanes);
    }
    for (uint32_t k = 0; k < 4 * cells; k++) {
        t->half_low[k] = CANOPY_TIGHTEN_NONE;
    }
    for (size_t i = 0; i < from->count; i++) {
        struct place at;
        if (place(t, from, i, &at) != CANOPY_OK) {
            continue;
        }
        const uint32_t slot = (uint32_t)taken[at.cell]++;
        struct canopy_tighten_block *block = &t->blocks[t->first[at.cell] + slot / CANOPY_TIGHTEN_LANES];
        const uint32_t l = slot % CANOPY_TIGHTEN_LANES;
        const float z = height_of(t, at.height);
        block->s[l] = at.s[0];
        block->t[l] = at.s[1];
        block->lanes.z[l] = z;
        add(&heights, z);
        float *half = &t->half_low[4 * at.cell + 2U * (at.s[0] >= 0.5f) + (at.s[1] >= 0.5f)];
        *half = from->field == NULL && (*half <= CANOPY_TIGHTEN_NONE || z < *half) ? z : *half;
    }
    t->height_mean = (heights.high + heights.low) / (float)t->points;
}

// The lowest of the field's cells that reach into a half-knot cell.
static void halves_of_field(struct canopy_tighten *t, const struct canopy_field *field) {
    const uint32_t columns = field->axis[1].count, across = t->frame.size[1] - 1U;
    const uint32_t cu = field->axis[0].cells, cv = field->axis[1].cells;
    for (uint32_t k = 0; k < 4 * cell_count(t); k++) {
        const uint32_t hu = k / 2 % 2, hv = k % 2, row = k / 4 / across * cu, column = k / 4 % across * cv;
        for (uint32_t i = hu * cu / 2; i < (hu + 1) * cu / 2 + (cu % 2 && hu == 0); i++) {
            for (uint32_t j = hv * cv / 2; j < (hv + 1) * cv / 2 + (cv % 2 && hv == 0); j++) {
                const int32_t height = field->heights[(row + i) * columns + column + j];
                if (height != CANOPY_NO_HEIGHT) {
                    const float z = height_of(t, height);
                    t->half_low[k] = t->half_low[k] <= CANOPY_TIGHTEN_NONE || z < t->half_low[k] ? z : t->half_low[k];
                }
            }
        }
    }
}

// Bernstein coefficient p of two halves belongs to the first, to both (3), or to the second.
static float pit_bound(const float half[4], int p, int q) {
    float z = CANOPY_TIGHTEN_NONE;
    for (int i = p > 3; i <= (p >= 3); i++) {
        for (int j = q > 3; j <= (q >= 3); j++) {
            z = larger(z, half[2 * i + j]);
        }
    }
    return z;
}

static void place_pits(struct canopy_tighten *t) {
    t->constraints = t->points;
    for (uint32_t cell = 0; cell < cell_count(t); cell++) {
        for (int p = 0; p < PITS; p++) {
            struct canopy_tighten_lanes *lanes = &t->pits[PITS * (size_t)cell + (size_t)p];
            clear_lanes(lanes);
            for (int q = 0; q < PITS; q++) {
                lanes->z[q] = pit_bound(&t->half_low[4 * (size_t)cell], p, q);
                t->constraints += lanes->z[q] > CANOPY_TIGHTEN_NONE;
            }
        }
    }
}

static enum canopy_status load(struct canopy_tighten *t, const struct source *from) {
    const size_t count = canopy_tighten_coefficients(t);
    t->stage = CANOPY_TIGHTEN_IDLE;
    const enum canopy_status status = count_points(t, from);
    if (status != CANOPY_OK) {
        t->points = 0;
        return status;
    }
    place_points(t, from);
    if (from->field != NULL) {
        halves_of_field(t, from->field);
    }
    place_pits(t);
    t->floored = false;
    memset(t->cost, 0, 4 * count);
    memset(t->seen, 0, count);
    for (uint32_t row = 0; row + 1 < t->frame.size[0]; row++) {
        canopy_tighten_weigh(t, row);
    }
    for (size_t j = 0; j < count; j++) {
        t->cost[j] /= (float)t->points;
        t->constraints += 2U * t->seen[j];
    }
    return CANOPY_OK;
}

enum canopy_status canopy_tighten_points_f32(struct canopy_tighten *tighten, const float (*points)[3], size_t count) {
    const struct canopy_frame *frame = &tighten->frame;
    for (int a = 0; a < 2; a++) {
        if (frame->origin[a] < -EDGE_LIMIT || frame->origin[a] + (int64_t)canopy_frame_width(frame, a) > EDGE_LIMIT) {
            return CANOPY_ARGUMENT;
        }
    }
    tighten->field = NULL;
    tighten->certify = NULL;
    return load(tighten, &(struct source){.f32 = points, .count = count});
}

enum canopy_status canopy_tighten_points_fx(struct canopy_tighten *tighten, const int32_t (*points)[3], size_t count) {
    tighten->field = NULL;
    tighten->certify = NULL;
    return load(tighten, &(struct source){.fx = points, .count = count});
}

enum canopy_status canopy_tighten_field(struct canopy_tighten *tighten, const struct canopy_field *field,
                                        struct canopy_certify *certify) {
    if (field->frame.size[0] != tighten->frame.size[0] || field->frame.size[1] != tighten->frame.size[1] ||
        certify->field != field) {
        return CANOPY_ARGUMENT;
    }
    tighten->field = field;
    tighten->certify = certify;
    const size_t nodes =
        CANOPY_TIGHTEN_NODES(field->frame.size[0], field->frame.size[1], field->axis[0].cells, field->axis[1].cells);
    return load(tighten, &(struct source){.field = field, .count = nodes});
}

enum canopy_status canopy_tighten_over(struct canopy_tighten *tighten, const int32_t *other) {
    struct canopy_tighten *t = tighten;
    const size_t count = canopy_tighten_coefficients(t);
    if (t->points == 0) {
        return CANOPY_EMPTY;
    }
    for (size_t j = 0; j < count; j++) {
        if (!(fabsf((float)other[j] - (float)t->low) * t->per_step <= OVER_MOST)) {
            return CANOPY_RANGE;
        }
    }
    t->floored = true;
    memset(t->seen, 1, count);
    for (uint32_t row = 0; row + 1 < t->frame.size[0]; row++) {
        canopy_tighten_over_row(t, other, row);
    }
    t->constraints = t->points + (uint32_t)(2 * count);
    for (size_t k = 0; k < PITS * (size_t)cell_count(t); k++) {
        for (int q = 0; q < PITS; q++) {
            t->constraints += t->pits[k].z[q] > CANOPY_TIGHTEN_NONE;
        }
    }
    return CANOPY_OK;
}

// ---- What is published

static float coefficient_of(const struct canopy_tighten *t, int32_t b) { return (float)(b - t->low) * t->per_step; }

// Mean gap of whole coefficients, in the program's unit.
static float gap_of(const struct canopy_tighten *t, const int32_t *b) {
    const size_t count = canopy_tighten_coefficients(t);
    struct sum gap = {-t->height_mean, 0};
    for (size_t j = 0; j < count; j++) {
        add(&gap, t->cost[j] * coefficient_of(t, b[j]));
    }
    return gap.high + gap.low;
}

// The largest coefficient that an occupied cell can see, and something to rise by.
static float reach_of(const struct canopy_tighten *t, const int32_t *b, float spare) {
    const size_t count = canopy_tighten_coefficients(t);
    float most = 0;
    for (size_t j = 0; j < count; j++) {
        most = t->seen[j] ? larger(most, fabsf(coefficient_of(t, b[j]))) : most;
    }
    return most + spare;
}

static void publish(struct canopy_tighten *t, float gap) {
    t->mean_gap = larger(gap, 0.0f) * t->range;
    t->published++;
}

static void to_candidate(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        t->candidate[j] = t->seen[j] ? t->low + (int32_t)floorf(t->x[j] * t->range) : t->b[j];
    }
}

// ---- The reach: floor and ceiling of every coefficient, as constraints like the others

static inline float reach_slack(const struct canopy_tighten *t, int side, size_t j) {
    return larger(side == 0 ? t->x[j] - CANOPY_TIGHTEN_FLOOR : CANOPY_TIGHTEN_CEILING - t->x[j], CANOPY_TIGHTEN_LEAST);
}

static inline float sign_of(int side) { return side == 0 ? 1.0f : -1.0f; }

// ---- Stages

static void begin_pass(struct canopy_tighten *t, enum canopy_tighten_stage stage) {
    const size_t bytes = 4 * canopy_tighten_coefficients(t);
    t->stage = (uint8_t)stage;
    t->row = 0;
    if (stage == CANOPY_TIGHTEN_FACTOR || stage == CANOPY_TIGHTEN_PUBLISH) {
        return;
    }
    memset(t->g[0], 0, bytes);
    memset(t->g[1], 0, bytes);
    memset(t->most, 0, sizeof t->most);
    memset(t->sums, 0, sizeof t->sums);
    if (stage == CANOPY_TIGHTEN_MEASURE) {
        memset(t->matrix, 0, bytes * CANOPY_TIGHTEN_BAND(t->frame.size[1]));
        t->comp = 0;
    }
}

static float lid_of(const struct canopy_tighten *t) { return t->floored ? LID_OVER : LID; }

static void first_iterate(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        const float x = coefficient_of(t, t->b[j]) + FRESH;
        t->x[j] = t->lid ? lid_of(t) : smaller(larger(x, CANOPY_TIGHTEN_FLOOR + 0.1f), CANOPY_TIGHTEN_CEILING - 0.1f);
    }
    begin_pass(t, CANOPY_TIGHTEN_SLACKS);
}

enum canopy_status canopy_tighten_begin(struct canopy_tighten *tighten, int32_t *coefficients, bool safe) {
    struct canopy_tighten *t = tighten;
    const size_t count = canopy_tighten_coefficients(t);
    if (t->points == 0) {
        return CANOPY_EMPTY;
    }
    for (size_t j = 0; j < count; j++) {
        if (coefficients[j] > CANOPY_COEFFICIENT_LIMIT || coefficients[j] < -CANOPY_COEFFICIENT_LIMIT) {
            return CANOPY_ARGUMENT;
        }
    }
    t->b = coefficients;
    t->safe = safe;
    t->lid = false;
    t->iterations = 0;
    t->published = 0;
    t->bound = 0;
    t->row = 0;
    t->stage = CANOPY_TIGHTEN_START;
    if (safe) {
        publish(t, gap_of(t, t->b));
        first_iterate(t);
    }
    return CANOPY_OK;
}

// A start that a safe one was not made of: a lid above everything.
static void publish_lid(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        t->b[j] = t->low + (int32_t)(lid_of(t) * t->range);
    }
}

// Mends coefficients by the field's certificate; false if it cannot be had.
static bool mend(struct canopy_tighten *t, int32_t *b) {
    if (t->field == NULL) {
        return true;
    }
    canopy_certify_begin(t->certify, b);
    enum canopy_status status;
    while ((status = canopy_certify_step(t->certify, UINT32_MAX)) == CANOPY_NOT_SAFE) {
        if (canopy_fast_raise(t->field, b, t->certify->failed_cell, t->certify->missing) != CANOPY_OK) {
            return false;
        }
    }
    return status == CANOPY_OK;
}

static void step_start(struct canopy_tighten *t) {
    const uint32_t rows = t->frame.size[0] - 1U;
    if (!canopy_tighten_raise_row(t, t->b, reach_of(t, t->b, START_SPARE), t->row++)) {
        publish_lid(t);
        t->row = rows;
    }
    if (t->row == rows) {
        if (!mend(t, t->b)) {
            publish_lid(t);
        }
        publish(t, gap_of(t, t->b));
        first_iterate(t);
    }
}

static void finish_slacks(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    if (t->most[0] > 200.0f && !t->lid) {
        t->lid = true;
        first_iterate(t);
        return;
    }
    for (size_t j = 0; j < count; j++) {
        t->sums[0] += t->seen[j] ? 1.0f / reach_slack(t, 0, j) + 1.0f / reach_slack(t, 1, j) : 0.0f;
    }
    t->mu = 1.0f / t->sums[0];
    for (size_t j = 0; j < count; j++) {
        for (int k = 0; k < SIDES; k++) {
            t->dual[k][j] = t->seen[j] ? t->mu / reach_slack(t, k, j) : 0.0f;
        }
    }
    t->alpha[0] = t->alpha[1] = 0;
    begin_pass(t, CANOPY_TIGHTEN_MEASURE);
}

// The lower bound that the duals prove (tighten.h), rounding taken off. Every sum here is of terms of one sign, in
// pieces of 16 blocks; a dual or cost sum is off by `rounding` of itself, a slack by the evaluation's error.
static void find_bound(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    const uint32_t depth = 80 + t->deepest / 16;
    const float rounding = 0x1p-24f * (float)depth;
    struct sum lost = {0, 0}, gap = {-t->height_mean, 0}, duals = {0, 0};
    for (size_t j = 0; j < count; j++) {
        const float c = t->cost[j], y = t->g[0][j], r = c - y;
        const float down = t->x[j] - CANOPY_TIGHTEN_FLOOR, up = CANOPY_TIGHTEN_CEILING - t->x[j];
        add(&lost, larger(r * down, -r * up) + rounding * (c + y) * larger(down, up));
        add(&gap, c * t->x[j]);
        add(&duals, y);
    }
    // the complementarity is added up lane by lane and cell by cell
    const uint32_t length = 160 + t->deepest + CANOPY_TIGHTEN_LANES * cell_count(t);
    const float slack = t->comp + 0x1p-24f * (float)length * t->comp + rounding + CANOPY_TIGHTEN_ERROR * duals.high;
    const float bound = ((gap.high - lost.high) - slack) + (gap.low - lost.low);
    t->bound = bound * t->range > t->bound ? bound * t->range : t->bound;  // also where it is no number
}

static void finish_measure(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t), stride = CANOPY_TIGHTEN_BAND(t->frame.size[1]);
    float trace = 0;
    find_bound(t);
    for (size_t j = 0; j < count; j++) {
        float *diagonal = t->matrix + j * stride + (stride - 1);
        for (int k = 0; k < SIDES && t->seen[j]; k++) {
            const float slack = reach_slack(t, k, j);
            t->comp += slack * t->dual[k][j];
            *diagonal += t->dual[k][j] / slack;
        }
        trace += *diagonal;
    }
    for (size_t j = 0; j < count; j++) {
        float *diagonal = t->matrix + j * stride + (stride - 1);
        *diagonal = t->seen[j] ? *diagonal + RIDGE * trace / (float)count : 1.0f;
    }
    t->mu = t->comp / (float)t->constraints;
    begin_pass(t, CANOPY_TIGHTEN_FACTOR);
}

static void solve(struct canopy_tighten *t, float *rhs) {
    canopy_tighten_solve(t->matrix, t->frame.size[1], (uint32_t)canopy_tighten_coefficients(t), rhs);
}

static void predict(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        t->affine[j] = t->seen[j] ? -t->cost[j] : 0.0f;
    }
    solve(t, t->affine);
    begin_pass(t, CANOPY_TIGHTEN_AFFINE);
}

static float longest(float most) { return most > 1.0f ? 1.0f / most : 1.0f; }

static void finish_affine(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        for (int k = 0; k < SIDES && t->seen[j]; k++) {
            const float s = reach_slack(t, k, j), y = t->dual[k][j], by = sign_of(k) * t->affine[j], ratio = by / s;
            const float product = -by * y * (1.0f + ratio);
            t->sums[0] += y * by;
            t->sums[1] -= y * (s + by);
            t->sums[2] += product;
            t->most[0] = larger(t->most[0], -ratio);
            t->most[1] = larger(t->most[1], 1.0f + ratio);
            t->target[k][j] = -product;
        }
    }
    const float primal = longest(t->most[0]), dual = longest(t->most[1]);
    const float left = t->comp + primal * t->sums[0] + dual * t->sums[1] + primal * dual * t->sums[2];
    const float ratio = smaller(larger(left / t->comp, 0.0f), 1.0f);
    t->mu *= larger(ratio * ratio * ratio, 1e-4f);
    for (size_t j = 0; j < count; j++) {
        float rhs = -t->cost[j] + t->mu * t->g[0][j] + t->g[1][j];
        for (int k = 0; k < SIDES && t->seen[j]; k++) {
            rhs += sign_of(k) * (t->mu + t->target[k][j]) / reach_slack(t, k, j);
        }
        t->step[j] = t->seen[j] ? rhs : 0.0f;
    }
    t->corrections = 0;
    t->stage = CANOPY_TIGHTEN_COMBINE;
}

static void step_reach(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        for (int k = 0; k < SIDES && t->seen[j]; k++) {
            const float s = reach_slack(t, k, j), y = t->dual[k][j], by = sign_of(k) * t->step[j];
            const float dual_by = (t->mu + t->target[k][j]) / s - y - y * by / s;
            t->dual_by[k][j] = dual_by;
            t->most[0] = larger(t->most[0], -by / s);
            t->most[1] = larger(t->most[1], -dual_by / larger(y, 1e-30f));
        }
    }
}

// ---- The end: what is free is bent as little as possible

static void begin_bend(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    memset(t->matrix, 0, 4 * count * CANOPY_TIGHTEN_BAND(t->frame.size[1]));
    memset(t->step, 0, 4 * count);
    bool any = false;
    for (size_t j = 0; j < count; j++) {
        t->x[j] = coefficient_of(t, t->b[j]);
        any = any || !t->seen[j];
    }
    t->row = 0;
    t->stage = any ? CANOPY_TIGHTEN_BEND : CANOPY_TIGHTEN_DONE;
}

static void bend_row(struct canopy_tighten *t) {
    canopy_tighten_bend_row(t, t->row);
    if (++t->row == t->frame.size[0]) {
        canopy_tighten_bend_finish(t);
        t->row = 0;
        t->stage = CANOPY_TIGHTEN_BEND_FACTOR;
    }
}

static void finish_bend(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    canopy_tighten_solve(t->matrix, t->frame.size[1], (uint32_t)count, t->step);
    for (size_t j = 0; j < count; j++) {
        if (!t->seen[j]) {
            const float x = smaller(larger(t->step[j], CANOPY_TIGHTEN_FLOOR), CANOPY_TIGHTEN_CEILING);
            t->b[j] = t->low + (int32_t)(x * t->range);
        }
    }
    t->stage = CANOPY_TIGHTEN_DONE;
}

// ---- The step

// False where rounding has eaten the step: it leads out of the reach, or nowhere.
static bool is_sound(const struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        const float x = t->x[j] + t->alpha[0] * t->step[j];
        if (!(x >= CANOPY_TIGHTEN_FLOOR && x <= CANOPY_TIGHTEN_CEILING)) {
            return false;
        }
    }
    return true;
}

// The iterate after the step. The points' duals follow when they are measured.
static void take_step(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    if (!is_sound(t)) {
        begin_bend(t);
        return;
    }
    for (size_t j = 0; j < count; j++) {
        t->x[j] += t->alpha[0] * t->step[j];
        for (int k = 0; k < SIDES; k++) {
            t->dual[k][j] += t->seen[j] ? t->alpha[1] * t->dual_by[k][j] : 0.0f;
        }
    }
    t->iterations++;
    to_candidate(t);
    begin_pass(t, CANOPY_TIGHTEN_PUBLISH);
}

static void begin_centre(struct canopy_tighten *t) {
    for (int k = 0; k < 2; k++) {
        t->aim[k] = smaller(t->alpha[k] + AIM, 1.0f);
    }
    begin_pass(t, CANOPY_TIGHTEN_CENTRE);
}

static float shortened(float most) { return most > SHORT ? SHORT / most : 1.0f; }

static void finish_step(struct canopy_tighten *t) {
    step_reach(t);
    for (int k = 0; k < 2; k++) {
        t->alpha[k] = shortened(t->most[k]);
    }
    begin_centre(t);
}

// What brings the product of slack and dual after a step into reach of the centre, limited (Gondzio).
static float reach_change(const struct canopy_tighten *t, int side, size_t j) {
    const float slack = reach_slack(t, side, j) + t->aim[0] * sign_of(side) * t->step[j];
    const float product = slack * (t->dual[side][j] + t->aim[1] * t->dual_by[side][j]);
    const float least = 0.1f * t->mu, most = 10.0f * t->mu;
    const float change = product < least ? least - product : product > most ? most - product : 0.0f;
    return larger(change, -most);
}

static void finish_centre(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        t->affine[j] = t->seen[j] ? t->g[0][j] : 0.0f;
        for (int k = 0; k < SIDES && t->seen[j]; k++) {
            t->target[k][j] = reach_change(t, k, j);
            t->affine[j] += sign_of(k) * t->target[k][j] / reach_slack(t, k, j);
        }
    }
    t->stage = CANOPY_TIGHTEN_RECENTRE;
}

static void recentre(struct canopy_tighten *t) {
    solve(t, t->affine);
    begin_pass(t, CANOPY_TIGHTEN_TRY);
}

// A correction is taken if it lengthens the steps by a tenth of what it aimed at.
static void finish_try(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        for (int k = 0; k < SIDES && t->seen[j]; k++) {
            const float s = reach_slack(t, k, j), y = t->dual[k][j], by = sign_of(k) * t->affine[j];
            t->target[k][j] = t->dual_by[k][j] + (t->target[k][j] - y * by) / s;  // the dual's direction if it is taken
            t->most[0] = larger(t->most[0], -(sign_of(k) * t->step[j] + by) / s);
            t->most[1] = larger(t->most[1], -t->target[k][j] / larger(y, 1e-30f));
        }
    }
    const float primal = shortened(t->most[0]), dual = shortened(t->most[1]);
    if (!(primal + dual >= t->alpha[0] + t->alpha[1] + WORTH * (t->aim[0] + t->aim[1] - t->alpha[0] - t->alpha[1]) &&
          primal >= 0.9f * t->alpha[0] && dual >= 0.9f * t->alpha[1])) {
        take_step(t);
        return;
    }
    t->alpha[0] = primal;
    t->alpha[1] = dual;
    begin_pass(t, CANOPY_TIGHTEN_ACCEPT);
}

static void finish_accept(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        t->step[j] += t->affine[j];
        for (int k = 0; k < SIDES; k++) {
            t->dual_by[k][j] = t->seen[j] ? t->target[k][j] : 0.0f;
        }
    }
    t->corrections++;
    if (t->corrections < CORRECTORS) {
        begin_centre(t);
    } else {
        take_step(t);
    }
}

static void compare(struct canopy_tighten *t) {
    const float gap = gap_of(t, t->candidate);
    if (gap * t->range < t->mean_gap && mend(t, t->candidate)) {
        const float mended = t->field == NULL ? gap : gap_of(t, t->candidate);
        if (mended * t->range < t->mean_gap) {
            memcpy(t->b, t->candidate, 4 * canopy_tighten_coefficients(t));
            publish(t, mended);
        }
    }
    const bool ends = t->iterations >= CANOPY_TIGHTEN_ITERATIONS || t->comp * t->range < ENOUGH * t->mean_gap ||
                      (t->alpha[0] < STALLED && t->alpha[1] < STALLED);
    if (ends) {
        begin_bend(t);
    } else {
        begin_pass(t, CANOPY_TIGHTEN_MEASURE);
    }
}

// One row of a pass; true after the last.
static bool pass_row(struct canopy_tighten *t, enum canopy_tighten_pass pass) {
    canopy_tighten_pass(t, pass, t->row++);
    return t->row + 1U == t->frame.size[0];
}

static void factor_row(struct canopy_tighten *t) {
    const uint32_t n = t->frame.size[1];
    canopy_tighten_factor(t->matrix, n, t->row * n, (t->row + 1) * n);
    if (++t->row == t->frame.size[0]) {
        t->stage = t->stage == CANOPY_TIGHTEN_FACTOR ? CANOPY_TIGHTEN_PREDICT : CANOPY_TIGHTEN_BEND_SOLVE;
    }
}

static void raise_candidate(struct canopy_tighten *t) {
    if (!canopy_tighten_raise_row(t, t->candidate, reach_of(t, t->candidate, SPARE), t->row++)) {
        memcpy(t->candidate, t->b, 4 * canopy_tighten_coefficients(t));  // not this one
        t->row = t->frame.size[0] - 1U;
    }
    if (t->row + 1U == t->frame.size[0]) {
        t->stage = CANOPY_TIGHTEN_COMPARE;
    }
}

static void combine(struct canopy_tighten *t) {
    solve(t, t->step);
    begin_pass(t, CANOPY_TIGHTEN_STEP);
}

static void step_once(struct canopy_tighten *t) {
    switch (t->stage) {
    case CANOPY_TIGHTEN_START: step_start(t); break;
    case CANOPY_TIGHTEN_SLACKS: pass_row(t, CANOPY_TIGHTEN_PASS_SLACKS) ? finish_slacks(t) : (void)0; break;
    case CANOPY_TIGHTEN_MEASURE: pass_row(t, CANOPY_TIGHTEN_PASS_MEASURE) ? finish_measure(t) : (void)0; break;
    case CANOPY_TIGHTEN_BEND_FACTOR:
    case CANOPY_TIGHTEN_FACTOR: factor_row(t); break;
    case CANOPY_TIGHTEN_PREDICT: predict(t); break;
    case CANOPY_TIGHTEN_AFFINE: pass_row(t, CANOPY_TIGHTEN_PASS_AFFINE) ? finish_affine(t) : (void)0; break;
    case CANOPY_TIGHTEN_COMBINE: combine(t); break;
    case CANOPY_TIGHTEN_STEP: pass_row(t, CANOPY_TIGHTEN_PASS_STEP) ? finish_step(t) : (void)0; break;
    case CANOPY_TIGHTEN_CENTRE: pass_row(t, CANOPY_TIGHTEN_PASS_CENTRE) ? finish_centre(t) : (void)0; break;
    case CANOPY_TIGHTEN_RECENTRE: recentre(t); break;
    case CANOPY_TIGHTEN_TRY: pass_row(t, CANOPY_TIGHTEN_PASS_TRY) ? finish_try(t) : (void)0; break;
    case CANOPY_TIGHTEN_ACCEPT: pass_row(t, CANOPY_TIGHTEN_PASS_ACCEPT) ? finish_accept(t) : (void)0; break;
    case CANOPY_TIGHTEN_PUBLISH: raise_candidate(t); break;
    case CANOPY_TIGHTEN_COMPARE: compare(t); break;
    case CANOPY_TIGHTEN_BEND: bend_row(t); break;
    case CANOPY_TIGHTEN_BEND_SOLVE: finish_bend(t); break;
    default: break;
    }
}

enum canopy_status canopy_tighten_step(struct canopy_tighten *tighten, uint32_t budget) {
    if (tighten->stage == CANOPY_TIGHTEN_IDLE) {
        return CANOPY_EMPTY;
    }
    for (; budget > 0 && tighten->stage != CANOPY_TIGHTEN_DONE; budget--) {
        step_once(tighten);
    }
    return tighten->stage == CANOPY_TIGHTEN_DONE ? CANOPY_OK : CANOPY_MORE;
}

float canopy_tighten_excess(const struct canopy_tighten *tighten) {
    if (!(tighten->bound > 0)) {
        return 1e30f;
    }
    // the published mean gap is a sum of 16 roundings a coefficient of weights that are off as those of the bound are
    const uint32_t depth = 160 + tighten->deepest / 8;
    const float off = 0x1p-24f * (float)depth * tighten->range;
    return larger((tighten->mean_gap + off - tighten->bound) / tighten->bound, 0.0f);
}
