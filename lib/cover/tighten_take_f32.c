// The program: points or a field in, the objective.

#include <string.h>

#include "lib/cover/cell_f32.h"
#include "lib/cover/tighten_f32.h"
#include "lib/num/fixed.h"

#define EDGE_LIMIT (1 << 24)  // edges of a float frame are whole quanta within +- this
#define RANGE_LEAST 64        // steps
#define FIELD_CELLS 256       // weighed in one unit of work

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
    const float limit = CANOPY_HEIGHT_REACH_F32, zero = ldexpf((float)frame->origin[2], frame->quantum_log2);
    const float scale = ldexpf(1.0f, -(frame->lsb_log2 + frame->quantum_log2));
    const float height = (p[2] - zero) * (frame->side == CANOPY_BELOW ? -scale : scale);
    if (!(height <= limit)) {
        return CANOPY_RANGE;
    }
    to->cell = h * (frame->size[1] - 1U) + w;
    // rounded up, the difference included
    to->height = height < -limit ? CANOPY_HEIGHT_LEAST_F32 : (int32_t)height + 2;
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

// What points are read from: an array of either scalar.
struct source {
    const float (*f32)[3];
    const int32_t (*fx)[3];
    size_t count;
};

static enum canopy_status place(const struct canopy_tighten *t, const struct source *from, size_t i, struct place *to) {
    return from->f32 != NULL ? place_f32(&t->frame, from->f32[i], to) : place_fx(&t->frame, from->fx[i], to);
}

static void set_range(struct canopy_tighten *t, int32_t low, int32_t high) {
    t->low = low;
    t->range = (float)(high - low < RANGE_LEAST ? RANGE_LEAST : high - low);
    t->per_step = 1.0f / t->range;
}

// First look: how many in each cell, and how high.
static enum canopy_status count_points(struct canopy_tighten *t, const struct source *from) {
    const uint32_t cells = canopy_tighten_cells(t);
    uint32_t *counts = t->first + 1;
    int32_t low = INT32_MAX, high = INT32_MIN;
    memset(t->first, 0, 4 * (cells + 1U));
    if (from->count > t->size.points) {
        return CANOPY_ARENA_SHORT;
    }
    for (size_t i = 0; i < from->count; i++) {
        struct place at;
        const enum canopy_status status = place(t, from, i, &at);
        if (status != CANOPY_OK) {
            return status;
        }
        counts[at.cell]++;
        low = at.height < low ? at.height : low;
        high = at.height > high ? at.height : high;
    }
    if (from->count == 0) {
        return CANOPY_EMPTY;
    }
    set_range(t, low, high);
    t->deepest = 0;
    for (uint32_t cell = 0; cell < cells; cell++) {
        const uint32_t blocks = (counts[cell] + LANES - 1) / LANES;
        t->live[cell] = counts[cell] > 0;
        t->deepest = blocks > t->deepest ? blocks : t->deepest;
        t->first[cell + 1] = t->first[cell] + blocks;
    }
    return CANOPY_OK;
}

// Second look: every point to its cell.
static void place_points(struct canopy_tighten *t, const struct source *from) {
    const uint32_t cells = canopy_tighten_cells(t);
    int32_t *taken = t->candidate;
    struct canopy_tighten_sum heights = {0, 0};
    memset(taken, 0, 4 * (size_t)cells);
    for (uint32_t k = 0; k < t->first[cells]; k++) {
        memset(&t->blocks[k], 0, sizeof t->blocks[k]);
        for (int l = 0; l < LANES; l++) {
            t->blocks[k].z[l] = CANOPY_TIGHTEN_NONE;
        }
    }
    for (uint32_t k = 0; k < 4 * cells; k++) {
        t->half_low[k] = CANOPY_TIGHTEN_NONE;
    }
    for (size_t i = 0; i < from->count; i++) {
        struct place at;
        if (place(t, from, i, &at) != CANOPY_OK) {
            continue;  // never: each was counted
        }
        const uint32_t slot = (uint32_t)taken[at.cell]++, l = slot % LANES;
        struct canopy_tighten_points *block = &t->blocks[t->first[at.cell] + slot / LANES];
        const float z = canopy_tighten_height(t, at.height);
        block->s[l] = at.s[0];
        block->t[l] = at.s[1];
        block->z[l] = z;
        canopy_tighten_add(&heights, z);
        float *half = &t->half_low[4 * at.cell + 2U * (at.s[0] >= 0.5f) + (at.s[1] >= 0.5f)];
        *half = *half <= CANOPY_TIGHTEN_NONE || z < *half ? z : *half;
    }
    t->points = (uint32_t)from->count;
    t->height_mean = (heights.high + heights.low) / (float)t->points;
}

// ---- The objective

// Adds weights of a patch to the objective, and marks its coefficients as seen.
static void add_cost(struct canopy_tighten *t, uint32_t cell, const float sum[4][4]) {
    struct canopy_tighten_patch patch;
    canopy_tighten_find_patch(t, cell, &patch);
    for (int a = 0; a < 16; a++) {
        t->cost[patch.index[a]] += sum[a / 4][a % 4];
        t->seen[patch.index[a]] = 1;
    }
}

// Sums over points are kept in lanes and folded after 16 blocks: rounding grows with the sixteenth of their number.
struct moments {
    float part[4][4][LANES], all[4][4];
};

static void fold(struct moments *sum) {
    for (int i = 0; i < 16; i++) {
        const float *p = sum->part[i / 4][i % 4];
        sum->all[i / 4][i % 4] += ((p[0] + p[4]) + (p[1] + p[5])) + ((p[2] + p[6]) + (p[3] + p[7]));
    }
    memset(sum->part, 0, sizeof sum->part);
}

static void add_moments(const struct canopy_tighten *t, struct moments *restrict sum,
                        const struct canopy_tighten_points *restrict block) {
    float u[4][LANES], v[4][LANES];
    canopy_tighten_lane_weights(t, 0, block->s, u);
    canopy_tighten_lane_weights(t, 1, block->t, v);
    for (int i = 0; i < 4; i++) {
        float one[LANES];
        for (int l = 0; l < LANES; l++) {
            one[l] = block->z[l] > CANOPY_TIGHTEN_NONE ? u[i][l] : 0.0f;
        }
        for (int j = 0; j < 4; j++) {
            for (int l = 0; l < LANES; l++) {
                sum->part[i][j][l] += one[l] * v[j][l];
            }
        }
    }
}

static void weigh_points(struct canopy_tighten *t) {
    for (uint32_t cell = 0; cell < canopy_tighten_cells(t); cell++) {
        struct moments sum;
        memset(&sum, 0, sizeof sum);
        for (uint32_t k = t->first[cell]; k < t->first[cell + 1]; k++) {
            add_moments(t, &sum, &t->blocks[k]);
            if ((k - t->first[cell]) % 16 == 15 || k + 1 == t->first[cell + 1]) {
                fold(&sum);
            }
        }
        if (t->live[cell]) {
            add_cost(t, cell, (const float(*)[4])sum.all);
        }
    }
}

static void begin_program(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    t->other = NULL;
    memset(t->cost, 0, 4 * count);
    memset(t->seen, 0, count);
}

static void finish_program(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        t->cost[j] /= (float)t->points;
    }
}

static enum canopy_status load(struct canopy_tighten *t, const struct source *from) {
    t->stage = CANOPY_TIGHTEN_IDLE;
    t->points = 0;
    t->field = NULL;
    t->certify = NULL;
    const enum canopy_status status = t->size.points == 0 ? CANOPY_ARENA_SHORT : count_points(t, from);
    if (status != CANOPY_OK) {
        return status;
    }
    place_points(t, from);
    begin_program(t);
    weigh_points(t);
    finish_program(t);
    return CANOPY_OK;
}

enum canopy_status canopy_tighten_points_f32(struct canopy_tighten *tighten, const float (*points)[3], size_t count) {
    const struct canopy_frame *frame = &tighten->frame;
    for (int a = 0; a < 2; a++) {
        if (frame->origin[a] < -EDGE_LIMIT || frame->origin[a] + (int64_t)canopy_frame_width(frame, a) > EDGE_LIMIT) {
            return CANOPY_ARGUMENT;
        }
    }
    return load(tighten, &(struct source){.f32 = points, .count = count});
}

enum canopy_status canopy_tighten_points_fx(struct canopy_tighten *tighten, const int32_t (*points)[3], size_t count) {
    return load(tighten, &(struct source){.fx = points, .count = count});
}

// ---- A field

// What its covered cells' heights are.
static enum canopy_status count_heights(struct canopy_tighten *t, const struct canopy_field *field) {
    const uint32_t count = field->axis[0].count * field->axis[1].count;
    int32_t low = INT32_MAX, high = INT32_MIN;
    uint32_t covered = 0;
    for (uint32_t k = 0; k < count; k++) {
        const int32_t height = canopy_field_height(field, k);
        if (height != CANOPY_NO_HEIGHT) {
            covered++;
            low = height < low ? height : low;
            high = height > high ? height : high;
        }
    }
    if (covered == 0) {
        return CANOPY_EMPTY;
    }
    set_range(t, low, high);
    t->points = covered;
    t->deepest = 0;
    return CANOPY_OK;
}

// The mean weights over each field cell of a knot interval: Simpson's rule is exact for cubics.
static void find_means(uint16_t cells, float mean[CANOPY_CELLS_MAX][4]) {
    const float q = (float)cells;
    for (uint16_t k = 0; k < cells; k++) {
        float from[4], middle[4], to[4];
        canopy_tighten_weights((float)k / q, from);
        canopy_tighten_weights(((float)k + 0.5f) / q, middle);
        canopy_tighten_weights((float)(k + 1) / q, to);
        for (int a = 0; a < 4; a++) {
            mean[k][a] = (from[a] + 4.0f * middle[a] + to[a]) * (1.0f / 6);
        }
    }
}

// Adds what the covered cells of one row of field cells in a knot cell weigh; true if there are any.
static bool weigh_row(const struct canopy_tighten *t, uint32_t at, const float v[CANOPY_CELLS_MAX][4], float row[4],
                      struct canopy_tighten_sum *sum) {
    bool any = false;
    for (uint16_t l = 0; l < t->size.cells[1]; l++) {
        const int32_t height = canopy_field_height(t->field, at + l);
        if (height != CANOPY_NO_HEIGHT) {
            any = true;
            canopy_tighten_add(sum, canopy_tighten_height(t, height));
            for (int b = 0; b < 4; b++) {
                row[b] += v[l][b];
            }
        }
    }
    return any;
}

// One knot cell's part of the objective.
static void weigh_cell(struct canopy_tighten *t, uint32_t cell, const float u[CANOPY_CELLS_MAX][4],
                       const float v[CANOPY_CELLS_MAX][4], struct canopy_tighten_sum *heights) {
    const struct canopy_field *field = t->field;
    const uint32_t across = t->frame.size[1] - 1U, columns = field->axis[1].count;
    const uint32_t cu = t->size.cells[0], cv = t->size.cells[1];
    uint32_t from = cell / across * cu * columns + cell % across * cv;
    float sum[4][4] = {{0}};
    t->live[cell] = 0;
    for (uint32_t k = 0; k < cu; k++, from += columns) {
        float row[4] = {0};
        if (weigh_row(t, from, v, row, heights)) {
            t->live[cell] = 1;
            for (int a = 0; a < 16; a++) {
                sum[a / 4][a % 4] += u[k][a / 4] * row[a % 4];
            }
        }
    }
    if (t->live[cell]) {
        add_cost(t, cell, (const float(*)[4])sum);
    }
}

enum canopy_status canopy_tighten_field_begin(struct canopy_tighten *tighten, const struct canopy_field *field,
                                              struct canopy_certify *certify) {
    struct canopy_tighten *t = tighten;
    t->stage = CANOPY_TIGHTEN_IDLE;
    t->points = 0;
    if (field->frame.size[0] != t->frame.size[0] || field->frame.size[1] != t->frame.size[1] ||
        field->axis[0].cells != t->size.cells[0] || field->axis[1].cells != t->size.cells[1] ||
        certify->field != field) {
        return CANOPY_ARGUMENT;
    }
    const enum canopy_status status = count_heights(t, field);
    if (status != CANOPY_OK) {
        return status;
    }
    t->field = field;
    t->certify = certify;
    begin_program(t);
    canopy_tighten_go(t, CANOPY_TIGHTEN_TAKE);
    return CANOPY_OK;
}

enum canopy_status canopy_tighten_field_step(struct canopy_tighten *tighten) {
    struct canopy_tighten *t = tighten;
    const uint32_t cells = canopy_tighten_cells(t), cu = t->size.cells[0], cv = t->size.cells[1];
    float u[CANOPY_CELLS_MAX][4], v[CANOPY_CELLS_MAX][4];
    struct canopy_tighten_sum heights = {t->sums[0], t->sums[1]};
    if (t->stage != CANOPY_TIGHTEN_TAKE) {
        return CANOPY_EMPTY;
    }
    find_means((uint16_t)cu, u);
    find_means((uint16_t)cv, v);
    for (uint32_t looked = 0; t->at < cells && looked < FIELD_CELLS; looked += cu * cv) {
        weigh_cell(t, t->at++, (const float(*)[4])u, (const float(*)[4])v, &heights);
    }
    t->sums[0] = heights.high;
    t->sums[1] = heights.low;
    if (t->at < cells) {
        return CANOPY_MORE;
    }
    t->height_mean = (heights.high + heights.low) / (float)t->points;
    finish_program(t);
    t->stage = CANOPY_TIGHTEN_IDLE;
    return CANOPY_OK;
}

enum canopy_status canopy_tighten_field(struct canopy_tighten *tighten, const struct canopy_field *field,
                                        struct canopy_certify *certify) {
    enum canopy_status status = canopy_tighten_field_begin(tighten, field, certify);
    if (status == CANOPY_OK) {
        while ((status = canopy_tighten_field_step(tighten)) == CANOPY_MORE) {}
    }
    return status;
}

// ---- Another surface

#define OVER_MOST 1.9f  // of the height range: another surface that there is still room above

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
    t->other = other;
    memset(t->seen, 1, count);
    memset(t->live, 1, canopy_tighten_cells(t));
    return CANOPY_OK;
}
