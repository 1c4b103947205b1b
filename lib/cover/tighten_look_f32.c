// Looks at every constraint there is: choosing rows, raising candidates.

#include <string.h>

#include "lib/cover/tighten_f32.h"
#include "lib/num/fma_f32.h"

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
    float far;                          // nor is it known any closer what is surely above that
    float least;                        // least slack, or what it is at least where it is far
    float bend[2];                      // largest second difference along each axis, not below 0
};

static float value_at(const float c[4][4], const float u[4], const float v[4]) {
    float value = 0;
    for (int a = 0; a < 4; a++) {
        value += u[a] * ((c[a][0] * v[0] + c[a][1] * v[1]) + (c[a][2] * v[2] + c[a][3] * v[3]));
    }
    return value;
}

// Whether all of something is so far above its bounds, by `least` or more, that it need not be looked at.
static bool is_far(struct visit *v, float least) {
    if (!(least > v->far)) {
        return false;
    }
    v->least = smaller(least, v->least);
    return true;
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
    const uint32_t cu = t->field->axis[0].cells, cv = t->field->axis[1].cells;
    uint32_t at = field_of(t, cell);
    int32_t lowest[4] = {INT32_MAX, INT32_MAX, INT32_MAX, INT32_MAX};
    for (uint32_t i = 0; i < cu; i++, at += t->field->axis[1].count) {
        int32_t row[2] = {INT32_MAX, INT32_MAX};
        for (uint32_t j = 0; j < cv; j++) {
            const int32_t found = canopy_field_height(t->field, at + j);
            const int32_t height = found != CANOPY_NO_HEIGHT ? found : INT32_MAX;
            row[0] = 2 * j < cv && height < row[0] ? height : row[0];
            row[1] = 2 * j + 2 > cv && height < row[1] ? height : row[1];
        }
        for (uint32_t k = 0; k < 4; k++) {
            const bool within = k < 2 ? 2 * i < cu : 2 * i + 2 > cu;
            lowest[k] = within && row[k % 2] < lowest[k] ? row[k % 2] : lowest[k];
        }
    }
    for (uint32_t k = 0; k < 4; k++) {
        half[k] = lowest[k] == INT32_MAX ? CANOPY_TIGHTEN_NONE : canopy_tighten_height(t, lowest[k]);
    }
}

// Bernstein coefficient p of two halves belongs to the first (0), to both (1), or to the second (2).
static const uint8_t PART_OF_TWO[PITS] = {0, 0, 0, 1, 2, 2, 2};

// The bounds of those that belong to this along u and to that along v.
static void find_pits(const float half[4], float pit[3][3]) {
    for (uint32_t i = 0; i < 3; i++) {
        const float left = i == 1 ? larger(half[0], half[2]) : half[i],
                    right = i == 1 ? larger(half[1], half[3]) : half[i + 1];
        pit[i][0] = left;
        pit[i][1] = larger(left, right);
        pit[i][2] = right;
    }
}

static inline float sum_of_four(const float w[4], float a, float b, float c, float d) {
    return canopy_add_product_f32(w[0] * a, w[1], b) + canopy_add_product_f32(w[2] * c, w[3], d);
}

// The surface's values on a part of a lattice.
static void lattice_row(const float c[4][4], const float u[4], float row[4]) {
    for (int b = 0; b < 4; b++) {
        row[b] = sum_of_four(u, c[0][b], c[1][b], c[2][b], c[3][b]);
    }
}

static inline float along(const float row[4], const float v[4]) {
    return sum_of_four(v, row[0], row[1], row[2], row[3]);
}

static void read_whole(const struct canopy_tighten *t, const int32_t *b, struct canopy_tighten_patch *patch) {
    for (int a = 0; a < 16; a++) {
        patch->c[a / 4][a % 4] = canopy_tighten_height(t, b[patch->index[a]]);
    }
}

// On a part of a knot cell, 1 / along u by 1 / across v, no Bernstein coefficient is further below the lowest of the
// four corners: along either axis those of a cubic are below its chord by a sixth of its largest second derivative, and
// that is one of the second differences of the coefficients or between them.
static inline float below_corners(const struct visit *v, uint32_t along_u, uint32_t along_v) {
    return (v->bend[0] / (float)(along_u * along_u) + v->bend[1] / (float)(along_v * along_v)) * (1.0f / 6);
}

// Whether the surface is far above what the halves must not dive below.
static bool are_pits_far(struct visit *v, const float half[4]) {
    const struct canopy_tighten *t = v->t;
    float corner[3][3], least = 1e30f;
    for (uint32_t i = 0; i < 3; i++) {
        float row[4];
        lattice_row((const float(*)[4])v->patch.c, t->lattice[0][3 * i], row);
        for (uint32_t j = 0; j < 3; j++) {
            corner[i][j] = along(row, t->lattice[1][3 * j]);
        }
    }
    for (uint32_t k = 0; k < 4; k++) {
        const float *a = &corner[k / 2][k % 2], *b = &corner[k / 2 + 1][k % 2];
        least = smaller(smaller(smaller(a[0], a[1]), smaller(b[0], b[1])) - half[k], least);
    }
    return is_far(v, least - below_corners(v, 2, 2));
}

static void visit_pits(struct visit *v) {
    const struct canopy_tighten *t = v->t;
    float half[4], pit[3][3];
    struct canopy_tighten_patch other;
    if (t->field != NULL) {
        find_halves(t, v->cell, half);
    } else {
        memcpy(half, &t->half_low[4 * (size_t)v->cell], sizeof half);
    }
    if (t->other != NULL) {
        other = v->patch;
        read_whole(t, t->other, &other);
    } else if (are_pits_far(v, half)) {
        return;
    }
    find_pits(half, pit);
    for (uint32_t p = 0; p < PITS; p++) {
        float row[4], under[4], slack[PITS], z[PITS], least = 1e30f;
        lattice_row((const float(*)[4])v->patch.c, t->lattice[0][p], row);
        for (uint32_t q = 0; q < PITS; q++) {
            z[q] = pit[PART_OF_TWO[p]][PART_OF_TWO[q]];
        }
        if (t->other != NULL) {
            lattice_row((const float(*)[4])other.c, t->lattice[0][p], under);
            for (uint32_t q = 0; q < PITS; q++) {
                z[q] = larger(along(under, t->lattice[1][q]) + CANOPY_TIGHTEN_ERROR, z[q]);
            }
        }
        for (uint32_t q = 0; q < PITS; q++) {
            slack[q] = along(row, t->lattice[1][q]) - z[q];
            least = smaller(slack[q], least);
        }
        v->least = smaller(least, v->least);
        for (uint32_t q = 0; least < v->limit && q < PITS; q++) {
            if (slack[q] < v->limit && z[q] > CANOPY_TIGHTEN_NONE) {
                const struct canopy_tighten_nearest found = {slack[q], canopy_tighten_place(p), canopy_tighten_place(q),
                                                             z[q]};
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

// The surface over one row of field cells in a knot cell: 4 x (3 cv + 1) coefficients, and the least of each column.
struct strip {
    float value[LATTICE_MOST][4], least[LATTICE_MOST];
};

// One covered cell: the least of its 4 x 4 coefficients counts.
static void visit_cell(struct visit *v, uint32_t k, uint32_t l, int32_t height, const struct strip *strip) {
    const struct canopy_tighten *t = v->t;
    const float *column = &strip->least[3 * l];
    const float least = smaller(smaller(column[0], column[1]), smaller(column[2], column[3]));
    const float slack = least - canopy_tighten_height(t, height);
    v->least = smaller(slack, v->least);
    if (!(slack < v->limit)) {
        return;
    }
    uint32_t p = 0, q = 0;
    while (column[q] > least) {
        q++;
    }
    while (strip->value[3 * l + q][p] > least) {
        p++;
    }
    const uint32_t u = 3 * k + p, w = 3 * l + q, cu = t->field->axis[0].cells, cv = t->field->axis[1].cells;
    const float z = canopy_tighten_height(t, bound_of(t, field_of(t, v->cell), u, w));
    const struct canopy_tighten_nearest found = {least - z, canopy_tighten_place(PITS + u),
                                                 canopy_tighten_place(PITS + w), z};
    const float before = value_at((const float(*)[4])v->from, t->lattice[0][PITS + u], t->lattice[1][PITS + w]);
    consider(v, k * t->grain / cu, l * t->grain / cv, &found, before);
}

// One row of field cells in the knot cell.
static void visit_row(struct visit *v, uint32_t k) {
    const struct canopy_tighten *t = v->t;
    const uint32_t cv = t->field->axis[1].cells;
    float row[4][4];
    struct strip strip;
    for (uint32_t i = 0; i < 4; i++) {
        lattice_row((const float(*)[4])v->patch.c, t->lattice[0][PITS + 3 * k + i], row[i]);
    }
    for (uint32_t q = 0; q <= 3 * cv; q++) {
        const float *w = t->lattice[1][PITS + q];
        const float a = along(row[0], w), b = along(row[1], w), c = along(row[2], w), d = along(row[3], w);
        strip.value[q][0] = a;
        strip.value[q][1] = b;
        strip.value[q][2] = c;
        strip.value[q][3] = d;
        strip.least[q] = smaller(smaller(a, b), smaller(c, d));
    }
    const uint32_t at = field_of(t, v->cell) + k * t->field->axis[1].count;
    for (uint32_t l = 0; l < cv; l++) {
        const int32_t height = canopy_field_height(t->field, at + l);
        if (height != CANOPY_NO_HEIGHT) {
            visit_cell(v, k, l, height, &strip);
        }
    }
}

// ---- Visits

// Rows of field cells in one visit.
static uint32_t rows_of(const struct canopy_tighten *t) {
    const uint32_t cu = t->field->axis[0].cells, rows = UNIT / (9U * t->field->axis[1].cells);
    return rows == 0 ? 1 : rows < cu ? rows : cu;
}

// How many visits a cell takes: its points in pieces, or its rows of field cells; the first sees the halves too.
static uint32_t parts_of(const struct canopy_tighten *t, uint32_t cell) {
    if (!t->live[cell]) {
        return 0;
    }
    if (t->field != NULL) {
        return (t->field->axis[0].cells + rows_of(t) - 1) / rows_of(t);
    }
    const uint32_t blocks = t->first[cell + 1] - t->first[cell];
    return blocks > BLOCKS ? (blocks + BLOCKS - 1) / BLOCKS : 1;
}

// The surface at the corners of a row of field cells.
static void find_corners(const struct visit *v, uint32_t k, float corner[CANOPY_CELLS_MAX + 1]) {
    const struct canopy_tighten *t = v->t;
    float row[4];
    lattice_row((const float(*)[4])v->patch.c, t->lattice[0][PITS + 3 * k], row);
    for (uint32_t l = 0; l <= t->field->axis[1].cells; l++) {
        corner[l] = along(row, t->lattice[1][PITS + 3 * l]);
    }
}

// Whether the surface, with its corners on both sides and `below` them, is far above a row of field cells.
static bool is_row_far(struct visit *v, uint32_t k, const float *low, const float *high, float below) {
    const struct canopy_tighten *t = v->t;
    const uint32_t cv = t->field->axis[1].cells;
    uint32_t at = field_of(t, v->cell) + k * t->field->axis[1].count;
    float least = 1e30f, left = smaller(low[0], high[0]);
    for (uint32_t l = 0; l < cv; l++, at++) {
        const float right = smaller(low[l + 1], high[l + 1]);
        const int32_t height = canopy_field_height(t->field, at);
        if (height != CANOPY_NO_HEIGHT) {
            least = smaller(smaller(left, right) - canopy_tighten_height(t, height), least);
        }
        left = right;
    }
    return is_far(v, least - below);
}

static void visit_rows(struct visit *v, uint32_t first, uint32_t end) {
    const struct canopy_tighten *t = v->t;
    const float below = below_corners(v, t->field->axis[0].cells, t->field->axis[1].cells);
    float corner[2][CANOPY_CELLS_MAX + 1];
    find_corners(v, first, corner[first % 2]);
    for (uint32_t k = first; k < end; k++) {
        find_corners(v, k + 1, corner[(k + 1) % 2]);
        if (!is_row_far(v, k, corner[0], corner[1], below)) {
            visit_row(v, k);
        }
    }
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
        const uint32_t cu = t->field->axis[0].cells, first = part * rows_of(t), end = first + rows_of(t);
        visit_rows(v, first, end < cu ? end : cu);
        return looked + 9 * t->field->axis[1].cells * rows_of(t);
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

// What a cell may lack by rounding, coefficients within `reach`.
static float error_of(float reach) { return CANOPY_TIGHTEN_ERROR * larger(reach / CANOPY_TIGHTEN_ERROR_REACH, 1.0f); }

// A step is flagged where its rounding to whole steps, or the error of having looked, might have to be made good. What
// a candidate is twice as far from, its iterate is far from, too: the two are a few steps apart.
static float flag_of(const struct canopy_tighten *t) { return 4.0f * CANOPY_TIGHTEN_ERROR + 32.0f * t->per_step; }

static void find_bend(struct visit *v) {
    const float(*c)[4] = (const float(*)[4])v->patch.c;
    float u = 0, w = 0;
    for (int i = 0; i < 4; i++) {
        u = larger((c[0][i] - c[1][i]) - (c[1][i] - c[2][i]), u);
        u = larger((c[1][i] - c[2][i]) - (c[2][i] - c[3][i]), u);
        w = larger((c[i][0] - c[i][1]) - (c[i][1] - c[i][2]), w);
        w = larger((c[i][1] - c[i][2]) - (c[i][2] - c[i][3]), w);
    }
    v->bend[0] = u;
    v->bend[1] = w;
}

static void begin_visit(struct visit *v, struct canopy_tighten *t, enum canopy_tighten_look look, const int32_t *b,
                        float reach) {
    v->t = t;
    v->cell = t->at;
    v->look = look;
    v->least = 1e30f;
    canopy_tighten_find_patch(t, v->cell, &v->patch);
    switch (look) {
    case CANOPY_TIGHTEN_LOOK_CHOOSE:
        canopy_tighten_read_patch(&v->patch, t->x);
        v->limit = 1e9f;
        v->far = 1e9f;
        break;
    case CANOPY_TIGHTEN_LOOK_STEP:
        for (int a = 0; a < 16; a++) {
            const float x = t->x[v->patch.index[a]];
            v->from[a / 4][a % 4] = x;
            v->patch.c[a / 4][a % 4] = x + t->alpha[0] * t->step[v->patch.index[a]];
        }
        v->limit = near_of(t) * t->comp;
        v->far = larger(v->limit, flag_of(t)) + CANOPY_TIGHTEN_ERROR;
        break;
    case CANOPY_TIGHTEN_LOOK_RAISE:
        read_whole(t, b, &v->patch);
        v->limit = -1e9f;
        v->far = larger(2.0f * error_of(reach), 2.0f * flag_of(t));
        break;
    }
    find_bend(v);
    for (int k = 0; t->part == 0 && k < CANOPY_TIGHTEN_GRAIN * CANOPY_TIGHTEN_GRAIN; k++) {
        t->nearest[k].slack = v->limit;
    }
}

// Raises the 4 x 4 coefficients by what a part of the cell lacks.
static bool raise(const struct visit *v, int32_t *b, float reach) {
    struct canopy_tighten *t = v->t;
    const float missing = error_of(reach) - v->least;
    if (missing <= 0.0f) {
        return true;
    }
    if (missing > 2.0f * reach) {
        return false;
    }
    const int32_t by = (int32_t)ceilf(missing * t->range) + 1;
    t->sums[0] += (float)by * t->per_step;
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

// A cell of which no part needs its flag loses it: at the iterate, which was not raised as other cells' coefficients
// were.
static void settle_flag(const struct visit *v, bool last) {
    uint8_t *flags = &v->t->flagged[v->cell];
    if (v->least - v->t->sums[0] < 2.0f * flag_of(v->t)) {
        *flags |= CANOPY_TIGHTEN_FLAG_THERE;
    }
    if (last) {
        *flags = (*flags & CANOPY_TIGHTEN_FLAG_THERE) != 0 ? CANOPY_TIGHTEN_FLAG_HERE : 0;
    }
}

static bool end_visit(struct visit *v, int32_t *b, float reach) {
    struct canopy_tighten *t = v->t;
    t->least = smaller(v->least, t->least);
    const bool last = t->part == parts_of(t, v->cell);
    if (v->look == CANOPY_TIGHTEN_LOOK_RAISE) {
        settle_flag(v, last);
        return raise(v, b, reach);
    }
    if (v->least < flag_of(t)) {
        t->flagged[v->cell] |= CANOPY_TIGHTEN_FLAG_THERE;
    }
    if (last) {
        offer(v);
    }
    return true;
}

enum canopy_status canopy_tighten_look(struct canopy_tighten *t, enum canopy_tighten_look look, int32_t *b,
                                       float reach) {
    const uint32_t cells = canopy_tighten_cells(t);
    for (uint32_t looked = 0; t->at < cells && looked < UNIT;) {
        const bool wanted = look != CANOPY_TIGHTEN_LOOK_RAISE || (t->flagged[t->at] & CANOPY_TIGHTEN_FLAG_HERE) != 0;
        if (!wanted || t->part >= parts_of(t, t->at)) {
            t->at++;
            t->part = 0;
            looked++;
            continue;
        }
        struct visit v;
        begin_visit(&v, t, look, b, reach);
        looked += visit_part(&v, t->part++);
        if (!end_visit(&v, b, reach)) {
            return CANOPY_RANGE;
        }
    }
    return t->at < cells ? CANOPY_MORE : CANOPY_OK;
}
