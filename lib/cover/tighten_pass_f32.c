// Passes over the rows in use: slacks, directions, the matrix.

#include <string.h>

#include "lib/cover/tighten_f32.h"
#include "lib/num/fma_f32.h"

#define DUAL_LEAST 1e-30f
#define SHARE_LEAST 1e-6f  // of the largest of a knot cell: less is not felt in the matrix
#define BLOCKS 8           // in one unit of work …
#define MATRIX_BLOCKS 2    // … that does not add to the matrix, or does

static const uint8_t PAIR[4][4] = {{0, 1, 2, 3}, {1, 4, 5, 6}, {2, 5, 7, 8}, {3, 6, 8, 9}};
enum { PAIRS = 10, PAIRS_ROOM = 12 };  // products of two of an axis' four weights

// ---- The passes' arithmetic, eight constraints at a time. r: what goes into g[0] and g[1].

struct results {
    float r[2][LANES];
    float sums[3][LANES], comp[LANES], most[2][LANES];
};

static inline float on(float z) { return z > CANOPY_TIGHTEN_NONE ? 1.0f : 0.0f; }

static void pass_slacks(struct canopy_tighten_rows *restrict c, const float *restrict value,
                        struct results *restrict to) {
    for (int l = 0; l < LANES; l++) {
        const float slack = value[l] - c->z[l], inverse = on(c->z[l]) / larger(slack, 1e-3f);
        c->slack[l] = slack;
        to->sums[0][l] += inverse;
        to->most[0][l] = larger(to->most[0][l], inverse);
    }
}

// A row that has no dual yet gets that of the centre; and room, where there is none: what is proved with a lower bound
// is proved.
static void pass_measure(const struct canopy_tighten *restrict t, struct canopy_tighten_rows *restrict c,
                         const float *restrict value, struct results *restrict to) {
    const float alpha = t->alpha[1], mu = t->mu;
    for (int l = 0; l < LANES; l++) {
        const float active = on(c->z[l]);
        const bool fresh = !(c->dual[l] > 0.0f);
        c->z[l] = fresh ? smaller(c->z[l], value[l] - 0.5f * CANOPY_TIGHTEN_NOISE) : c->z[l];
        const float slack = larger(value[l] - c->z[l], CANOPY_TIGHTEN_LEAST);
        const float stepped = c->dual[l] + alpha * c->dual_by[l];
        const float dual = active * (fresh ? mu / slack : stepped);
        c->slack[l] = slack;
        c->dual[l] = dual;
        to->comp[l] += slack * dual;
        to->r[0][l] = dual;
        to->r[1][l] = dual / slack;
    }
}

static void pass_affine(struct canopy_tighten_rows *restrict c, const float *restrict value,
                        struct results *restrict to) {
    for (int l = 0; l < LANES; l++) {
        const float active = on(c->z[l]), s = c->slack[l], y = c->dual[l], inverse = active / s;
        const float ratio = value[l] * inverse, product = -value[l] * y * (1.0f + ratio);  // ds dy
        to->sums[0][l] += y * value[l];
        to->sums[1][l] -= y * (s + value[l]);
        to->sums[2][l] += product;
        to->most[0][l] = larger(to->most[0][l], -ratio);
        to->most[1][l] = larger(to->most[1][l], active * (1.0f + ratio));  // -dy / y
        to->r[0][l] = inverse;
        to->r[1][l] = -product * inverse;
        c->slack_by[l] = -product;
    }
}

static void pass_step(float tau, struct canopy_tighten_rows *restrict c, const float *restrict value,
                      struct results *restrict to) {
    for (int l = 0; l < LANES; l++) {
        const float active = on(c->z[l]), s = c->slack[l], y = c->dual[l], inverse = active / s;
        const float by = (tau + c->slack_by[l]) * inverse - y - y * value[l] * inverse;
        c->slack_by[l] = value[l];
        c->dual_by[l] = active * by;
        to->most[0][l] = larger(to->most[0][l], -value[l] * inverse);
        to->most[1][l] = larger(to->most[1][l], active * -by / larger(y, DUAL_LEAST));
    }
}

// How far a product is outside [least, most], limited.
static inline float correction(float product, float mu) {
    const float least = 0.1f * mu, most = 10.0f * mu;
    const float change = product < least ? least - product : product > most ? most - product : 0.0f;
    return change < -most ? -most : change;
}

static inline float change_of(const struct canopy_tighten *t, const struct canopy_tighten_rows *c, int l) {
    const float slack = c->slack[l] + t->aim[0] * c->slack_by[l], dual = c->dual[l] + t->aim[1] * c->dual_by[l];
    return on(c->z[l]) * correction(slack * dual, t->mu);
}

static void pass_centre(const struct canopy_tighten *restrict t, struct canopy_tighten_rows *restrict c,
                        struct results *restrict to) {
    for (int l = 0; l < LANES; l++) {
        to->r[0][l] = change_of(t, c, l) / c->slack[l];
    }
}

static void pass_try(const struct canopy_tighten *restrict t, struct canopy_tighten_rows *restrict c,
                     const float *restrict value, bool accepted, struct results *restrict to) {
    for (int l = 0; l < LANES; l++) {
        const float active = on(c->z[l]), s = c->slack[l], y = c->dual[l];
        const float more = (change_of(t, c, l) - y * value[l]) / s;
        const float slack_by = c->slack_by[l] + value[l], dual_by = c->dual_by[l] + active * more;
        to->most[0][l] = larger(to->most[0][l], active * -slack_by / s);
        to->most[1][l] = larger(to->most[1][l], active * -dual_by / larger(y, DUAL_LEAST));
        c->slack_by[l] = accepted ? slack_by : c->slack_by[l];
        c->dual_by[l] = accepted ? dual_by : c->dual_by[l];
    }
}

static void pass_lanes(const struct canopy_tighten *t, enum canopy_tighten_pass pass, struct canopy_tighten_rows *c,
                       const float *value, struct results *to) {
    switch (pass) {
    case CANOPY_TIGHTEN_PASS_SLACKS: pass_slacks(c, value, to); break;
    case CANOPY_TIGHTEN_PASS_MEASURE: pass_measure(t, c, value, to); break;
    case CANOPY_TIGHTEN_PASS_AFFINE: pass_affine(c, value, to); break;
    case CANOPY_TIGHTEN_PASS_STEP: pass_step(t->mu, c, value, to); break;
    case CANOPY_TIGHTEN_PASS_CENTRE: break;
    case CANOPY_TIGHTEN_PASS_TRY: pass_try(t, c, value, false, to); break;
    case CANOPY_TIGHTEN_PASS_ACCEPT: pass_try(t, c, value, true, to); break;
    }
}

static void add_results(struct canopy_tighten *t, const struct results *from) {
    for (int l = 0; l < LANES; l++) {
        t->comp += from->comp[l];
        for (int k = 0; k < 3; k++) {
            t->sums[k] += from->sums[k][l];
        }
        for (int k = 0; k < 2; k++) {
            t->most[k] = larger(t->most[k], from->most[k][l]);
        }
    }
}

// ---- Reading a surface at rows, and adding up over the rows of a knot cell

struct reading {
    const float *surface;
    uint32_t cell;
    struct canopy_tighten_patch patch;
};

struct sums {
    uint32_t cell;
    uint8_t wanted;                   // how many of the next
    bool squares;                     // whether the last is wanted
    bool ends[2][2];                  // whether the cell is at an end of an axis
    float sum[2][4][4];               // of r times weights
    float largest;                    // r[1] of the cell
    float square[PAIRS][PAIRS_ROOM];  // of r[1] times products of two weights
};

static float value_at(const struct canopy_tighten *t, struct reading *from, uint32_t cell, const float u[4],
                      const float v[4]) {
    if (cell != from->cell) {
        from->cell = cell;
        canopy_tighten_find_patch(t, cell, &from->patch);
        canopy_tighten_read_patch(&from->patch, from->surface);
    }
    float value = 0;
    for (int a = 0; a < 4; a++) {
        const float *c = from->patch.c[a];
        const float part =
            canopy_add_product_f32(c[0] * v[0], c[1], v[1]) + canopy_add_product_f32(c[2] * v[2], c[3], v[3]);
        value = canopy_add_product_f32(value, u[a], part);
    }
    return value;
}

// Four rows of the matrix, by four coefficients that begin with `first`; of those on the diagonal the lower triangle.
static void add_block(float *const row[4], const uint32_t *to, const float *sum, bool whole) {
    const uint32_t a = to[0], b = to[1], c = to[2], d = to[3];
    if (whole) {
        row[0][b] += sum[1];
        row[0][c] += sum[2];
        row[0][d] += sum[3];
        row[1][c] += sum[5];
        row[1][d] += sum[6];
        row[2][d] += sum[8];
    }
    row[0][a] += sum[0];
    row[1][a] += sum[1];
    row[1][b] += sum[4];
    row[2][a] += sum[2];
    row[2][b] += sum[5];
    row[2][c] += sum[7];
    row[3][a] += sum[3];
    row[3][b] += sum[6];
    row[3][c] += sum[8];
    row[3][d] += sum[9];
}

// The lower triangle: no weight is left on a coefficient that is repeated, so that two of a patch are never the same.
static void add_to_matrix(struct canopy_tighten *t, const struct sums *from, const uint32_t index[16]) {
    const size_t stride = CANOPY_TIGHTEN_BAND(t->frame.size[1]);
    for (int a = 0; a < 4; a++) {
        float *row[4];
        for (int b = 0; b < 4; b++) {
            const uint32_t i = index[4 * a + b];
            row[b] = t->matrix + (size_t)i * stride + (stride - 1) - i;
        }
        for (int k = 0; k <= a; k++) {
            add_block(row, &index[4 * k], from->square[PAIR[a][k]], k < a);
        }
    }
}

static void turn_sums(const struct canopy_tighten *t, struct sums *to, uint32_t cell) {
    const uint32_t down = t->frame.size[0] - 1U, across = t->frame.size[1] - 1U, h = cell / across;
    to->cell = cell;
    to->ends[0][0] = h == 0;
    to->ends[0][1] = h + 1 == down;
    to->ends[1][0] = cell == h * across;
    to->ends[1][1] = cell + 1 == (h + 1) * across;
}

// Hands over what was added up, and begins with another cell.
static void turn_to(struct canopy_tighten *t, struct sums *from, uint32_t cell) {
    struct canopy_tighten_patch patch;
    canopy_tighten_find_patch(t, from->cell, &patch);
    for (int k = 0; k < from->wanted; k++) {
        for (int a = 0; a < 16; a++) {
            t->g[k][patch.index[a]] += from->sum[k][a / 4][a % 4];
        }
    }
    memset(from->sum, 0, sizeof from->sum);
    if (from->squares) {
        add_to_matrix(t, from, patch.index);
        memset(from->square, 0, sizeof from->square);
        from->largest = 0;
    }
    turn_sums(t, from, cell);
}

// Where the first or the last coefficient of a patch is its neighbour again, that has the weight of both.
static void find_pairs(const float weight[4], const bool ends[2], float to[PAIRS_ROOM]) {
    float w[4];
    memcpy(w, weight, sizeof w);
    if (ends[0]) {
        w[1] += w[0];
        w[0] = 0;
    }
    if (ends[1]) {
        w[2] += w[3];
        w[3] = 0;
    }
    for (int a = 0; a < 4; a++) {
        for (int b = a; b < 4; b++) {
            to[PAIR[a][b]] = w[a] * w[b];
        }
    }
    to[PAIRS] = to[PAIRS + 1] = 0;
}

static void add_row(struct sums *to, const float u[4], const float v[4], float r0, float r1) {
    for (int k = 0; k < to->wanted; k++) {
        for (int a = 0; a < 4; a++) {
            const float r = (k == 0 ? r0 : r1) * u[a];
            for (int b = 0; b < 4; b++) {
                to->sum[k][a][b] = canopy_add_product_f32(to->sum[k][a][b], r, v[b]);
            }
        }
    }
    if (to->squares && r1 > SHARE_LEAST * to->largest) {
        to->largest = larger(to->largest, r1);
        float uu[PAIRS_ROOM], vv[PAIRS_ROOM];
        find_pairs(u, to->ends[0], uu);
        find_pairs(v, to->ends[1], vv);
        for (int a = 0; a < PAIRS; a++) {
            const float d = r1 * uu[a];
            for (int b = 0; b < PAIRS_ROOM; b++) {
                to->square[a][b] = canopy_add_product_f32(to->square[a][b], d, vv[b]);
            }
        }
    }
}

// ---- Blocks

// The four weights of each row along each axis, in the tables of the lattices or here.
struct weights {
    const float *u[LANES], *v[LANES];
    float room[2][LANES][4];
};

static bool are_tabled(const float place[LANES]) {
    float most = -1.0f;
    for (int l = 0; l < LANES; l++) {
        most = larger(place[l], most);
    }
    return most < 0.0f;
}

static void find_axis(const struct canopy_tighten *t, int axis, const float place[LANES], const float *at[LANES],
                      float room[LANES][4]) {
    if (are_tabled(place)) {
        for (int l = 0; l < LANES; l++) {
            at[l] = t->lattice[axis][(uint32_t)(-1.0f - place[l])];
        }
        return;
    }
    float w[4][LANES];
    canopy_tighten_lane_weights(t, axis, place, w);
    for (int l = 0; l < LANES; l++) {
        for (int a = 0; a < 4; a++) {
            room[l][a] = w[a][l];
        }
        at[l] = room[l];
    }
}

static void find_weights(const struct canopy_tighten *t, const struct canopy_tighten_rows *rows, struct weights *to) {
    find_axis(t, 0, rows->s, to->u, to->room[0]);
    find_axis(t, 1, rows->t, to->v, to->room[1]);
}

static bool is_nothing(const float *r) {
    float most = 0;
    for (int l = 0; l < LANES; l++) {
        most = larger(most, fabsf(r[l]));
    }
    return !(most > 0.0f);
}

static void pass_block(struct canopy_tighten *t, enum canopy_tighten_pass pass, struct canopy_tighten_rows *rows,
                       struct reading *from, struct sums *sums, struct results *to) {
    struct weights w;
    float value[LANES] = {0};
    if (pass == CANOPY_TIGHTEN_PASS_CENTRE) {  // knows no surface; most rows are as near to the centre as they should
        pass_centre(t, rows, to);
        if (is_nothing(to->r[0])) {
            return;
        }
        find_weights(t, rows, &w);
    } else {
        find_weights(t, rows, &w);
        for (int l = 0; l < LANES; l++) {
            value[l] = value_at(t, from, rows->cell[l], w.u[l], w.v[l]);
        }
        pass_lanes(t, pass, rows, value, to);
    }
    for (int l = 0; sums->wanted > 0 && l < LANES; l++) {
        if (rows->cell[l] != sums->cell) {
            turn_to(t, sums, rows->cell[l]);
        }
        add_row(sums, w.u[l], w.v[l], to->r[0][l], to->r[1][l]);
    }
}

bool canopy_tighten_pass(struct canopy_tighten *t, enum canopy_tighten_pass pass) {
    const float *const surface[] = {[CANOPY_TIGHTEN_PASS_SLACKS] = t->x,      [CANOPY_TIGHTEN_PASS_MEASURE] = t->x,
                                    [CANOPY_TIGHTEN_PASS_AFFINE] = t->affine, [CANOPY_TIGHTEN_PASS_STEP] = t->step,
                                    [CANOPY_TIGHTEN_PASS_CENTRE] = t->x,      [CANOPY_TIGHTEN_PASS_TRY] = t->affine,
                                    [CANOPY_TIGHTEN_PASS_ACCEPT] = t->affine};
    static const uint8_t wanted[] = {[CANOPY_TIGHTEN_PASS_MEASURE] = 1,
                                     [CANOPY_TIGHTEN_PASS_AFFINE] = 2,
                                     [CANOPY_TIGHTEN_PASS_CENTRE] = 1,
                                     [CANOPY_TIGHTEN_PASS_ACCEPT] = 0};
    const uint32_t blocks = (t->row_count + LANES - 1) / LANES;
    const uint32_t most = pass == CANOPY_TIGHTEN_PASS_MEASURE ? MATRIX_BLOCKS : BLOCKS;
    const uint32_t end = t->at + most < blocks ? t->at + most : blocks;
    struct results to = {{{0}}, {{0}}, {0}, {{0}}};
    struct reading from = {.surface = surface[pass], .cell = UINT32_MAX};
    struct sums sums = {.wanted = wanted[pass], .squares = pass == CANOPY_TIGHTEN_PASS_MEASURE};
    turn_sums(t, &sums, t->at < end ? t->rows[t->at].cell[0] : 0);
    for (; t->at < end; t->at++) {
        pass_block(t, pass, &t->rows[t->at], &from, &sums, &to);
    }
    turn_to(t, &sums, 0);
    add_results(t, &to);
    return t->at >= blocks;
}
