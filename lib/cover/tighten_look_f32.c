// Looks at every constraint there is: choosing rows, raising candidates.

#include <string.h>

#include "lib/cover/tighten_f32.h"

#define BLOCKS 64    // of points, in one visit to a cell
#define UNIT 256     // constraints in one unit of work, before the visit that ends it
#define NEAR 0.2f    // of the complementarity: what is nearer than that after a step is offered
#define CHOICE 0.4f  // of the height range above the nearest of a cell: what is further is not chosen at first
#define LATTICE_MOST (3 * CANOPY_CELLS_MAX + 1)

// ---- A visit to a knot cell: the surface there, and what is found

struct visit {
    struct canopy_tighten *t;
    uint32_t cell;
    enum canopy_tighten_look look;
    struct canopy_tighten_patch patch;  // the surface looked at
    float from[4][4];                   // and where the step began
    float limit;                        // of slacks: above it nothing is of interest
    float least;                        // least slack
};

static float value_at(const float c[4][4], const float u[4], const float v[4]) {
    float value = 0;
    for (int a = 0; a < 4; a++) {
        value += u[a] * ((c[a][0] * v[0] + c[a][1] * v[1]) + (c[a][2] * v[2] + c[a][3] * v[3]));
    }
    return value;
}

// What a step over the boundary is shortened by.
static void shorten(struct visit *v, float slack, float before) {
    struct canopy_tighten *t = v->t;
    before = larger(before + CANOPY_TIGHTEN_NOISE, 0.5f * CANOPY_TIGHTEN_NOISE);
    t->most[0] = larger(t->most[0], (before - (slack + CANOPY_TIGHTEN_NOISE)) / before);
}

// A constraint below the limit, at part (i, j) of the cell, where the surface was `before`.
static void consider(struct visit *v, uint32_t i, uint32_t j, const struct canopy_tighten_nearest *found,
                     float before) {
    if (v->look == CANOPY_TIGHTEN_LOOK_STEP && found->slack < -CANOPY_TIGHTEN_NOISE) {
        shorten(v, found->slack, before - found->z);
    }
    struct canopy_tighten_nearest *nearest = &v->t->nearest[CANOPY_TIGHTEN_GRAIN * i + j];
    if (found->slack < nearest->slack) {
        *nearest = *found;
    }
}

// At the end of a cell: what is nearest in each of its parts.
static void offer(const struct visit *v) {
    const struct canopy_tighten_nearest *nearest = v->t->nearest;
    float most = v->limit;
    if (v->look == CANOPY_TIGHTEN_LOOK_CHOOSE) {
        for (int k = 0; k < CANOPY_TIGHTEN_GRAIN * CANOPY_TIGHTEN_GRAIN; k++) {
            most = smaller(nearest[k].slack + CHOICE, most);
        }
    }
    for (int k = 0; k < CANOPY_TIGHTEN_GRAIN * CANOPY_TIGHTEN_GRAIN; k++) {
        if (nearest[k].slack < most) {
            canopy_tighten_offer(v->t, v->cell, nearest[k].s, nearest[k].t, nearest[k].z);
        }
    }
}

// ---- Points

// From B-spline coefficients b[h-1] … b[h+2] to the Bernstein form of the knot interval.
static const float BEZIER[4][4] = {{1.0f / 6, 4.0f / 6, 1.0f / 6, 0},
                                   {0, 4.0f / 6, 2.0f / 6, 0},
                                   {0, 2.0f / 6, 4.0f / 6, 0},
                                   {0, 1.0f / 6, 4.0f / 6, 1.0f / 6}};

static void to_bernstein(const float from[4][4], float to[4][4]) {
    float half[4][4];
    for (int i = 0; i < 4; i++) {
        for (int b = 0; b < 4; b++) {
            half[i][b] = BEZIER[i][0] * from[0][b] + BEZIER[i][1] * from[1][b] + BEZIER[i][2] * from[2][b] +
                         BEZIER[i][3] * from[3][b];
        }
    }
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            to[i][j] = half[i][0] * BEZIER[j][0] + half[i][1] * BEZIER[j][1] + half[i][2] * BEZIER[j][2] +
                       half[i][3] * BEZIER[j][3];
        }
    }
}

static void bernstein_weights(const float *restrict s, float w[restrict 4][LANES]) {
    for (int l = 0; l < LANES; l++) {
        const float x = s[l], r = 1.0f - x, rr = r * r, xx = x * x;
        w[0][l] = rr * r;
        w[1][l] = 3.0f * rr * x;
        w[2][l] = 3.0f * xx * r;
        w[3][l] = xx * x;
    }
}

static void slacks_of(const float c[4][4], const struct canopy_tighten_points *restrict block, float *restrict slack) {
    float u[4][LANES], v[4][LANES], sum[LANES];
    bernstein_weights(block->s, u);
    bernstein_weights(block->t, v);
    for (int l = 0; l < LANES; l++) {
        sum[l] = -block->z[l];
    }
    for (int i = 0; i < 4; i++) {
        const float c0 = c[i][0], c1 = c[i][1], c2 = c[i][2], c3 = c[i][3];
        for (int l = 0; l < LANES; l++) {
            sum[l] += u[i][l] * ((c0 * v[0][l] + c1 * v[1][l]) + (c2 * v[2][l] + c3 * v[3][l]));
        }
    }
    memcpy(slack, sum, sizeof sum);
}

static inline uint32_t part_of(float s, uint32_t grain) {
    const uint32_t part = (uint32_t)(s * (float)grain);
    return part < grain ? part : grain - 1;
}

static void consider_block(struct visit *v, const struct canopy_tighten_points *block, const float slack[LANES]) {
    const uint32_t grain = v->t->grain;
    for (int l = 0; l < LANES; l++) {
        if (slack[l] < v->limit && block->z[l] > CANOPY_TIGHTEN_NONE) {
            float before = 0, wu[4], wv[4];
            if (slack[l] < -CANOPY_TIGHTEN_NOISE && v->look == CANOPY_TIGHTEN_LOOK_STEP) {
                canopy_tighten_weights(block->s[l], wu);
                canopy_tighten_weights(block->t[l], wv);
                before = value_at((const float(*)[4])v->from, wu, wv);
            }
            const struct canopy_tighten_nearest found = {slack[l], block->s[l], block->t[l], block->z[l]};
            consider(v, part_of(block->s[l], grain), part_of(block->t[l], grain), &found, before);
        }
    }
}

static void visit_points(struct visit *v, uint32_t first, uint32_t end) {
    float c[4][4];
    to_bernstein((const float(*)[4])v->patch.c, c);
    for (uint32_t k = first; k < end; k++) {
        const struct canopy_tighten_points *block = &v->t->blocks[k];
        float slack[LANES], least = v->least;
        slacks_of((const float(*)[4])c, block, slack);
        for (int l = 0; l < LANES; l++) {
            least = slack[l] < least ? slack[l] : least;
        }
        v->least = least;
        float near = v->limit;
        for (int l = 0; l < LANES; l++) {
            near = slack[l] < near ? slack[l] : near;
        }
        if (near < v->limit) {
            consider_block(v, block, slack);
        }
    }
}

// ---- Bernstein coefficients of the halves of a knot cell

// The first field cell of a knot cell.
static uint32_t field_of(const struct canopy_tighten *t, uint32_t cell) {
    const struct canopy_field *field = t->field;
    const uint32_t across = t->frame.size[1] - 1U;
    return cell / across * field->axis[0].cells * field->axis[1].count + cell % across * field->axis[1].cells;
}

// The lowest of the field's cells that reach into each half.
static void find_halves(const struct canopy_tighten *t, uint32_t cell, float half[4]) {
    const uint32_t at = field_of(t, cell);
    const uint32_t cu = t->field->axis[0].cells, cv = t->field->axis[1].cells, columns = t->field->axis[1].count;
    for (uint32_t k = 0; k < 4; k++) {
        const uint32_t hu = k / 2, hv = k % 2;
        int32_t lowest = INT32_MAX;
        for (uint32_t i = hu * cu / 2; i < (hu + 1) * cu / 2 + (cu % 2 && hu == 0); i++) {
            for (uint32_t j = hv * cv / 2; j < (hv + 1) * cv / 2 + (cv % 2 && hv == 0); j++) {
                const int32_t height = canopy_field_height(t->field, at + i * columns + j);
                lowest = height != CANOPY_NO_HEIGHT && height < lowest ? height : lowest;
            }
        }
        half[k] = lowest == INT32_MAX ? CANOPY_TIGHTEN_NONE : canopy_tighten_height(t, lowest);
    }
}

// Bernstein coefficient p of two halves belongs to the first, to both (3), or to the second.
static float pit_bound(const float half[4], uint32_t p, uint32_t q) {
    float z = CANOPY_TIGHTEN_NONE;
    for (uint32_t i = p > 3; i <= (p >= 3); i++) {
        for (uint32_t j = q > 3; j <= (q >= 3); j++) {
            z = larger(z, half[2 * i + j]);
        }
    }
    return z;
}

// The surface's values on a part of a lattice.
static void lattice_row(const float c[4][4], const float u[4], float row[4]) {
    for (int b = 0; b < 4; b++) {
        row[b] = (u[0] * c[0][b] + u[1] * c[1][b]) + (u[2] * c[2][b] + u[3] * c[3][b]);
    }
}

static inline float along(const float row[4], const float v[4]) {
    return (row[0] * v[0] + row[1] * v[1]) + (row[2] * v[2] + row[3] * v[3]);
}

static void read_whole(const struct canopy_tighten *t, const int32_t *b, struct canopy_tighten_patch *patch) {
    for (int a = 0; a < 16; a++) {
        patch->c[a / 4][a % 4] = canopy_tighten_height(t, b[patch->index[a]]);
    }
}

static void visit_pits(struct visit *v) {
    const struct canopy_tighten *t = v->t;
    float half[4];
    struct canopy_tighten_patch other = v->patch;
    if (t->field != NULL) {
        find_halves(t, v->cell, half);
    } else {
        memcpy(half, &t->half_low[4 * (size_t)v->cell], sizeof half);
    }
    if (t->other != NULL) {
        read_whole(t, t->other, &other);
    }
    for (uint32_t p = 0; p < PITS; p++) {
        float row[4], under[4] = {0};
        lattice_row((const float(*)[4])v->patch.c, t->lattice[0][p], row);
        lattice_row((const float(*)[4])other.c, t->lattice[0][p], under);
        for (uint32_t q = 0; q < PITS; q++) {
            const float bound = pit_bound(half, p, q);
            const float over =
                t->other != NULL ? along(under, t->lattice[1][q]) + CANOPY_TIGHTEN_ERROR : CANOPY_TIGHTEN_NONE;
            const float z = larger(bound, over), slack = along(row, t->lattice[1][q]) - z;
            v->least = smaller(slack, v->least);
            if (slack < v->limit && z > CANOPY_TIGHTEN_NONE) {
                const struct canopy_tighten_nearest found = {slack, canopy_tighten_place(p), canopy_tighten_place(q),
                                                             z};
                const float before = value_at((const float(*)[4])v->from, t->lattice[0][p], t->lattice[1][q]);
                consider(v, p * t->grain / PITS, q * t->grain / PITS, &found, before);
            }
        }
    }
}

// ---- A field

// The bound of a Bernstein coefficient is the highest of the cells around it in this knot cell.
static int32_t bound_of(const struct canopy_tighten *t, uint32_t at, uint32_t p, uint32_t q) {
    const uint32_t cu = t->field->axis[0].cells, cv = t->field->axis[1].cells, columns = t->field->axis[1].count;
    int32_t highest = CANOPY_NO_HEIGHT;
    for (uint32_t i = p % 3 == 0 && p > 0 ? p / 3 - 1 : p / 3; i <= p / 3 && i < cu; i++) {
        for (uint32_t j = q % 3 == 0 && q > 0 ? q / 3 - 1 : q / 3; j <= q / 3 && j < cv; j++) {
            const int32_t height = canopy_field_height(t->field, at + i * columns + j);
            highest = height > highest ? height : highest;
        }
    }
    return highest;
}

// One covered cell: the least of its 4 x 4 coefficients counts.
static void visit_cell(struct visit *v, uint32_t k, uint32_t l, float value[4][LATTICE_MOST]) {
    const struct canopy_tighten *t = v->t;
    const uint32_t at = field_of(t, v->cell);
    const int32_t height = canopy_field_height(t->field, at + k * t->field->axis[1].count + l);
    if (height == CANOPY_NO_HEIGHT) {
        return;
    }
    float least = value[0][3 * l];
    uint32_t p = 0, q = 0;
    for (uint32_t i = 0; i < 4; i++) {
        for (uint32_t j = 0; j < 4; j++) {
            if (value[i][3 * l + j] < least) {
                least = value[i][3 * l + j];
                p = i;
                q = j;
            }
        }
    }
    const float slack = least - canopy_tighten_height(t, height);
    v->least = smaller(slack, v->least);
    if (slack < v->limit) {
        const uint32_t u = 3 * k + p, w = 3 * l + q, cu = t->field->axis[0].cells, cv = t->field->axis[1].cells;
        const float z = canopy_tighten_height(t, bound_of(t, at, u, w));
        const struct canopy_tighten_nearest found = {least - z, canopy_tighten_place(PITS + u),
                                                     canopy_tighten_place(PITS + w), z};
        const float before = value_at((const float(*)[4])v->from, t->lattice[0][PITS + u], t->lattice[1][PITS + w]);
        consider(v, k * t->grain / cu, l * t->grain / cv, &found, before);
    }
}

// One row of field cells in the knot cell.
static void visit_field(struct visit *v, uint32_t k) {
    const struct canopy_tighten *t = v->t;
    const uint32_t cv = t->field->axis[1].cells;
    float value[4][LATTICE_MOST];
    for (uint32_t i = 0; i < 4; i++) {
        float row[4];
        lattice_row((const float(*)[4])v->patch.c, t->lattice[0][PITS + 3 * k + i], row);
        for (uint32_t q = 0; q <= 3 * cv; q++) {
            value[i][q] = along(row, t->lattice[1][PITS + q]);
        }
    }
    for (uint32_t l = 0; l < cv; l++) {
        visit_cell(v, k, l, value);
    }
}

// ---- Visits

// How many visits a cell takes: its points in pieces, or its rows of field cells; the first sees the halves too.
static uint32_t parts_of(const struct canopy_tighten *t, uint32_t cell) {
    if (!t->live[cell]) {
        return 0;
    }
    if (t->field != NULL) {
        return t->field->axis[0].cells;
    }
    const uint32_t blocks = t->first[cell + 1] - t->first[cell];
    return blocks > BLOCKS ? (blocks + BLOCKS - 1) / BLOCKS : 1;
}

// How many constraints that were.
static uint32_t visit_part(struct visit *v, uint32_t part) {
    const struct canopy_tighten *t = v->t;
    uint32_t looked = 0;
    if (part == 0) {
        visit_pits(v);
        looked = PITS * PITS;
    }
    if (t->field != NULL) {
        visit_field(v, part);
        return looked + 9 * t->field->axis[1].cells;
    }
    const uint32_t first = t->first[v->cell] + part * BLOCKS, last = t->first[v->cell + 1];
    const uint32_t end = last - first < BLOCKS ? last : first + BLOCKS;
    visit_points(v, first, end);
    return looked + LANES * (end - first);
}

// Less where there is less room for rows.
static float near_of(const struct canopy_tighten *t) {
    const uint32_t taken = t->row_count + t->offered;
    return taken < t->size.rows / 2 ? NEAR : taken < t->size.rows / 8 * 7 ? NEAR / 4 : 0.0f;
}

static void begin_visit(struct visit *v, struct canopy_tighten *t, enum canopy_tighten_look look, const int32_t *b) {
    v->t = t;
    v->cell = t->at;
    v->look = look;
    v->least = 1e30f;
    canopy_tighten_find_patch(t, v->cell, &v->patch);
    switch (look) {
    case CANOPY_TIGHTEN_LOOK_CHOOSE:
        canopy_tighten_read_patch(&v->patch, t->x);
        v->limit = 1e9f;
        break;
    case CANOPY_TIGHTEN_LOOK_STEP:
        for (int a = 0; a < 16; a++) {
            const float x = t->x[v->patch.index[a]];
            v->from[a / 4][a % 4] = x;
            v->patch.c[a / 4][a % 4] = x + t->alpha[0] * t->step[v->patch.index[a]];
        }
        v->limit = near_of(t) * t->comp;
        break;
    case CANOPY_TIGHTEN_LOOK_RAISE:
        read_whole(t, b, &v->patch);
        v->limit = -1e9f;
        break;
    }
    for (int k = 0; t->part == 0 && k < CANOPY_TIGHTEN_GRAIN * CANOPY_TIGHTEN_GRAIN; k++) {
        t->nearest[k].slack = v->limit;
    }
}

// Raises the 4 x 4 coefficients by what a part of the cell lacks.
static bool raise(const struct visit *v, int32_t *b, float reach) {
    const struct canopy_tighten *t = v->t;
    const float missing = CANOPY_TIGHTEN_ERROR * larger(reach / CANOPY_TIGHTEN_ERROR_REACH, 1.0f) - v->least;
    if (missing <= 0.0f) {
        return true;
    }
    if (missing > 2.0f * reach) {
        return false;
    }
    const int32_t by = (int32_t)ceilf(missing * t->range) + 1;
    for (int a = 0; a < 16; a++) {
        bool again = false;  // a repeated end coefficient is raised once
        for (int c = 0; c < a; c++) {
            again = again || v->patch.index[c] == v->patch.index[a];
        }
        int32_t *coefficient = &b[v->patch.index[a]];
        *coefficient += again ? 0 : by;
        if (*coefficient > CANOPY_COEFFICIENT_LIMIT || canopy_tighten_height(t, *coefficient) > reach) {
            return false;
        }
    }
    return true;
}

static bool end_visit(struct visit *v, int32_t *b, float reach) {
    struct canopy_tighten *t = v->t;
    t->least = smaller(v->least, t->least);
    if (v->look == CANOPY_TIGHTEN_LOOK_RAISE) {
        return raise(v, b, reach);
    }
    // A step is flagged where its rounding to whole steps, or the error of having looked, might have to be made good.
    if (v->least < 4.0f * (CANOPY_TIGHTEN_ERROR + t->per_step)) {
        t->flagged[v->cell] = 1;
    }
    if (t->part == parts_of(t, v->cell)) {
        offer(v);
    }
    return true;
}

enum canopy_status canopy_tighten_look(struct canopy_tighten *t, enum canopy_tighten_look look, int32_t *b,
                                       float reach) {
    const uint32_t cells = canopy_tighten_cells(t);
    for (uint32_t looked = 0; t->at < cells && looked < UNIT;) {
        const bool wanted = look != CANOPY_TIGHTEN_LOOK_RAISE || t->flagged[t->at];
        if (!wanted || t->part >= parts_of(t, t->at)) {
            t->at++;
            t->part = 0;
            looked++;
            continue;
        }
        struct visit v;
        begin_visit(&v, t, look, b);
        looked += visit_part(&v, t->part++);
        if (!end_visit(&v, b, reach)) {
            return CANOPY_RANGE;
        }
    }
    return t->at < cells ? CANOPY_MORE : CANOPY_OK;
}
