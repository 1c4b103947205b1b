#include <math.h>
#include <string.h>

#include "lib/cover/tighten_f32.h"

#define LANES CANOPY_TIGHTEN_LANES
#define DUAL_LEAST 1e-30f
#define PITS 7  // distinct Bernstein coefficients of two half intervals

// From B-spline coefficients b[h-1] … b[h+2] to the Bernstein form of the knot interval, and to that of its two halves.
static const float BEZIER[4][4] = {{1.0f / 6, 4.0f / 6, 1.0f / 6, 0},
                                   {0, 4.0f / 6, 2.0f / 6, 0},
                                   {0, 2.0f / 6, 4.0f / 6, 0},
                                   {0, 1.0f / 6, 4.0f / 6, 1.0f / 6}};
static const float HALVES[PITS][4] = {{1, 0, 0, 0},
                                      {0.5f, 0.5f, 0, 0},
                                      {0.25f, 0.5f, 0.25f, 0},
                                      {0.125f, 0.375f, 0.375f, 0.125f},
                                      {0, 0.25f, 0.5f, 0.25f},
                                      {0, 0, 0.5f, 0.5f},
                                      {0, 0, 0, 1}};
static const uint8_t PAIR[4][4] = {{0, 1, 2, 3}, {1, 4, 5, 6}, {2, 5, 7, 8}, {3, 6, 8, 9}};

void canopy_tighten_tables(struct canopy_tighten *t) {
    static const float BINOMIAL[4] = {1, 3, 3, 1};
    memset(t->pair, 0, sizeof t->pair);
    memset(t->pit_pair, 0, sizeof t->pit_pair);
    for (int a = 0; a < 4; a++) {
        for (int b = a; b < 4; b++) {
            float *pair = t->pair[PAIR[a][b]], *pits = t->pit_pair[PAIR[a][b]];
            for (int i = 0; i < 4; i++) {
                for (int j = 0; j < 4; j++) {
                    pair[i + j] += BEZIER[i][a] * BEZIER[j][b] * BINOMIAL[i] * BINOMIAL[j];
                }
            }
            for (int r = 0; r < PITS; r++) {
                float left = 0, right = 0;
                for (int i = 0; i < 4; i++) {
                    left += HALVES[r][i] * BEZIER[i][a];
                    right += HALVES[r][i] * BEZIER[i][b];
                }
                pits[r] = left * right;
            }
        }
    }
}

// ---- One knot cell

// The index of coefficient a = 0 … 3 of knot interval h: the ends are repeated.
static inline uint32_t clamped(uint32_t h, uint32_t a, uint32_t size) {
    const uint32_t i = h + a > 0 ? h + a - 1 : 0;
    return i < size ? i : size - 1;
}

// Whether a knot cell has constraints.
static inline bool is_live(const struct canopy_tighten *t, uint32_t index) {
    return t->floored || t->first[index] < t->first[index + 1];
}

struct cell {
    uint32_t index[16];  // of its coefficients
    float c[4][4];       // Bernstein form of a surface
};

static void find_cell(const struct canopy_tighten *t, uint32_t h, uint32_t w, struct cell *cell) {
    const uint32_t n = t->frame.size[1];
    for (uint32_t a = 0; a < 4; a++) {
        const uint32_t i = clamped(h, a, t->frame.size[0]) * n;
        for (uint32_t b = 0; b < 4; b++) {
            cell->index[4 * a + b] = i + clamped(w, b, n);
        }
    }
}

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

static void read_cell(struct cell *cell, const float *x) {
    float from[4][4];
    for (int a = 0; a < 16; a++) {
        from[a / 4][a % 4] = x[cell->index[a]];
    }
    to_bernstein((const float(*)[4])from, cell->c);
}

// Adds to g what sums over Bernstein coefficients are for B-spline coefficients: the transpose of read_cell.
static void add_cell(const struct cell *cell, const float sum[4][4], float *g) {
    float half[4][4];
    for (int a = 0; a < 4; a++) {
        for (int j = 0; j < 4; j++) {
            half[a][j] = BEZIER[0][a] * sum[0][j] + BEZIER[1][a] * sum[1][j] + BEZIER[2][a] * sum[2][j] +
                         BEZIER[3][a] * sum[3][j];
        }
    }
    for (int a = 0; a < 4; a++) {
        for (int b = 0; b < 4; b++) {
            g[cell->index[4 * a + b]] += half[a][0] * BEZIER[0][b] + half[a][1] * BEZIER[1][b] +
                                         half[a][2] * BEZIER[2][b] + half[a][3] * BEZIER[3][b];
        }
    }
}

// ---- Eight points

static void weights(const float *restrict s, float w[restrict 4][LANES]) {
    for (int l = 0; l < LANES; l++) {
        const float x = s[l], r = 1.0f - x, rr = r * r, xx = x * x;
        w[0][l] = rr * r;
        w[1][l] = 3.0f * rr * x;
        w[2][l] = 3.0f * xx * r;
        w[3][l] = xx * x;
    }
}

struct basis {
    float u[4][LANES], v[4][LANES];
};

static void find_basis(const struct canopy_tighten_block *block, struct basis *to) {
    weights(block->s, to->u);
    weights(block->t, to->v);
}

static void evaluate(const struct cell *restrict cell, const struct basis *restrict w, float *restrict value) {
    float sum[LANES] = {0};
    for (int i = 0; i < 4; i++) {
        const float c0 = cell->c[i][0], c1 = cell->c[i][1], c2 = cell->c[i][2], c3 = cell->c[i][3];
        for (int l = 0; l < LANES; l++) {
            sum[l] += w->u[i][l] * ((c0 * w->v[0][l] + c1 * w->v[1][l]) + (c2 * w->v[2][l] + c3 * w->v[3][l]));
        }
    }
    memcpy(value, sum, sizeof sum);
}

// Sums over points for each Bernstein coefficient, kept in lanes; folded into `all` after 16 blocks, so that rounding
// grows with the sixteenth of their number.
struct moments {
    float part[4][4][LANES], all[4][4];
    int blocks;
};

static void fold(struct moments *sum) {
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            const float *p = sum->part[i][j];
            sum->all[i][j] += ((p[0] + p[4]) + (p[1] + p[5])) + ((p[2] + p[6]) + (p[3] + p[7]));
        }
    }
    memset(sum->part, 0, sizeof sum->part);
    sum->blocks = 0;
}

static void add_moments(struct moments *restrict sum, const struct basis *restrict w, const float *restrict r) {
    for (int i = 0; i < 4; i++) {
        float ru[LANES];
        for (int l = 0; l < LANES; l++) {
            ru[l] = r[l] * w->u[i][l];
        }
        for (int j = 0; j < 4; j++) {
            for (int l = 0; l < LANES; l++) {
                sum->part[i][j][l] += ru[l] * w->v[j][l];
            }
        }
    }
    if (++sum->blocks == 16) {
        fold(sum);
    }
}

// ---- The Bernstein coefficients of half-knot cells

static void evaluate_pits(const struct cell *cell, float value[PITS][LANES]) {
    float half[PITS][4];
    for (int p = 0; p < PITS; p++) {
        for (int j = 0; j < 4; j++) {
            half[p][j] = HALVES[p][0] * cell->c[0][j] + HALVES[p][1] * cell->c[1][j] + HALVES[p][2] * cell->c[2][j] +
                         HALVES[p][3] * cell->c[3][j];
        }
    }
    for (int p = 0; p < PITS; p++) {
        for (int q = 0; q < PITS; q++) {
            value[p][q] = half[p][0] * HALVES[q][0] + half[p][1] * HALVES[q][1] + half[p][2] * HALVES[q][2] +
                          half[p][3] * HALVES[q][3];
        }
        value[p][PITS] = 0;
    }
}

static void add_pits(float sum[4][4], const float r[PITS][LANES]) {
    for (int p = 0; p < PITS; p++) {
        float row[4];
        for (int j = 0; j < 4; j++) {
            row[j] = 0;
            for (int q = 0; q < PITS; q++) {
                row[j] += r[p][q] * HALVES[q][j];
            }
        }
        for (int i = 0; i < 4; i++) {
            for (int j = 0; j < 4; j++) {
                sum[i][j] += HALVES[p][i] * row[j];
            }
        }
    }
}

// ---- The passes' arithmetic, eight constraints at a time. r: what goes into g[0] and g[1].

struct results {
    float r[2][LANES];
    float sums[3][LANES], comp[LANES], most[2][LANES];
};

static inline float on(float z) { return z > CANOPY_TIGHTEN_NONE ? 1.0f : 0.0f; }
static inline float larger(float a, float b) { return a > b ? a : b; }

static void pass_slacks(struct canopy_tighten_lanes *restrict c, const float *restrict value,
                        struct results *restrict to) {
    for (int l = 0; l < LANES; l++) {
        const float slack = value[l] - c->z[l], inverse = on(c->z[l]) / larger(slack, 1e-3f);
        c->slack[l] = slack;
        to->sums[0][l] += inverse;
        to->most[0][l] = larger(to->most[0][l], inverse);
    }
}

static void pass_measure(const struct canopy_tighten *restrict t, struct canopy_tighten_lanes *restrict c,
                         const float *restrict value, struct results *restrict to) {
    const float alpha = t->alpha[1], mu = t->iterations == 0 ? t->mu : 0.0f;
    for (int l = 0; l < LANES; l++) {
        const float active = on(c->z[l]);
        const float slack = larger(value[l] - c->z[l], CANOPY_TIGHTEN_LEAST);
        const float dual = active * (c->dual[l] + alpha * c->dual_by[l] + mu / slack);
        c->slack[l] = slack;
        c->dual[l] = dual;
        to->comp[l] += slack * dual;
        to->r[0][l] = dual;
        to->r[1][l] = dual / slack;
    }
}

static void pass_affine(struct canopy_tighten_lanes *restrict c, const float *restrict value,
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

static void pass_step(float tau, struct canopy_tighten_lanes *restrict c, const float *restrict value,
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

static inline float change_of(const struct canopy_tighten *t, const struct canopy_tighten_lanes *c, int l) {
    const float slack = c->slack[l] + t->aim[0] * c->slack_by[l], dual = c->dual[l] + t->aim[1] * c->dual_by[l];
    return on(c->z[l]) * correction(slack * dual, t->mu);
}

static void pass_centre(const struct canopy_tighten *restrict t, struct canopy_tighten_lanes *restrict c,
                        struct results *restrict to) {
    for (int l = 0; l < LANES; l++) {
        to->r[0][l] = change_of(t, c, l) / c->slack[l];
    }
}

static void pass_try(const struct canopy_tighten *restrict t, struct canopy_tighten_lanes *restrict c,
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

static void pass_lanes(const struct canopy_tighten *t, enum canopy_tighten_pass pass, struct canopy_tighten_lanes *c,
                       const float *value, struct results *to) {
    switch (pass) {
    case CANOPY_TIGHTEN_PASS_SLACKS: pass_slacks(c, value, to); break;
    case CANOPY_TIGHTEN_PASS_MEASURE: pass_measure(t, c, value, to); break;
    case CANOPY_TIGHTEN_PASS_AFFINE: pass_affine(c, value, to); break;
    case CANOPY_TIGHTEN_PASS_STEP: pass_step(t->mu, c, value, to); break;
    case CANOPY_TIGHTEN_PASS_CENTRE: pass_centre(t, c, to); break;
    case CANOPY_TIGHTEN_PASS_TRY: pass_try(t, c, value, false, to); break;
    case CANOPY_TIGHTEN_PASS_ACCEPT: pass_try(t, c, value, true, to); break;
    }
}

// ---- The matrix

// Moments of degree 6 in both directions: sum of d (1-s)^(6-k) s^k (1-t)^(6-l) t^l.
struct hessian {
    float moment[7][8], pits[PITS][LANES];
};

static void powers(float s, float to[8]) {
    const float r = 1.0f - s, r2 = r * r, s2 = s * s, r4 = r2 * r2, s4 = s2 * s2;
    to[0] = r4 * r2;
    to[1] = r4 * r * s;
    to[2] = r4 * s2;
    to[3] = r2 * r * s2 * s;
    to[4] = r2 * s4;
    to[5] = r * s4 * s;
    to[6] = s4 * s2;
    to[7] = 0;
}

// A point whose share is too small to be felt beside the cell's largest is left out: most are.
static void add_hessian(struct hessian *restrict to, const struct canopy_tighten_block *restrict block,
                        const float *restrict d, float least) {
    for (int l = 0; l < LANES; l++) {
        if (d[l] <= least) {
            continue;
        }
        float u[8], v[8];
        powers(block->s[l], u);
        powers(block->t[l], v);
        for (int i = 0; i < 7; i++) {
            const float du = d[l] * u[i];
            for (int j = 0; j < 8; j++) {
                to->moment[i][j] += du * v[j];
            }
        }
    }
}

// table * from * table' added to `to`.
static void sandwich(const float table[10][8], const float from[7][8], float to[10][10]) {
    for (int a = 0; a < 10; a++) {
        float row[8] = {0};
        for (int i = 0; i < 7; i++) {
            for (int j = 0; j < 8; j++) {
                row[j] += table[a][i] * from[i][j];
            }
        }
        for (int b = 0; b < 10; b++) {
            float sum = 0;
            for (int j = 0; j < 7; j++) {
                sum += table[b][j] * row[j];
            }
            to[a][b] += sum;
        }
    }
}

static void add_to_matrix(struct canopy_tighten *t, const struct cell *cell, const struct hessian *h) {
    const size_t stride = CANOPY_TIGHTEN_BAND(t->frame.size[1]);
    float sum[10][10] = {{0}};
    sandwich((const float(*)[8])t->pair, h->moment, sum);
    sandwich((const float(*)[8])t->pit_pair, h->pits, sum);
    for (int p = 0; p < 16; p++) {
        const uint32_t i = cell->index[p];
        float *diagonal = t->matrix + (size_t)i * stride + (stride - 1);
        for (int q = 0; q < 16; q++) {
            const uint32_t j = cell->index[q];
            if (j <= i) {
                *(diagonal - (i - j)) += sum[PAIR[p / 4][q / 4]][PAIR[p % 4][q % 4]];
            }
        }
    }
}

// ---- A pass over one row of knot cells

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

#define SHARE_LEAST 1e-4f  // of the largest d of a cell, all points together

static void pass_cell(struct canopy_tighten *t, enum canopy_tighten_pass pass, uint32_t index, struct cell *cell) {
    const bool measures = pass == CANOPY_TIGHTEN_PASS_MEASURE, twice = pass == CANOPY_TIGHTEN_PASS_AFFINE;
    const bool gathers = measures || twice || pass == CANOPY_TIGHTEN_PASS_CENTRE;
    const uint32_t first = t->first[index], end = t->first[index + 1];
    struct results to = {{{0}}, {{0}}, {0}, {{0}}};
    struct moments sum[2];
    struct hessian h;
    memset(sum, 0, sizeof sum);
    float value[PITS][LANES], r[2][PITS][LANES];
    evaluate_pits(cell, value);
    float largest = 0;
    for (int p = 0; p < PITS; p++) {
        pass_lanes(t, pass, &t->pits[PITS * (size_t)index + (size_t)p], value[p], &to);
        memcpy(r[0][p], to.r[0], sizeof to.r[0]);
        memcpy(r[1][p], to.r[1], sizeof to.r[1]);
    }
    if (measures) {
        memset(h.moment, 0, sizeof h.moment);
        memcpy(h.pits, r[1], sizeof h.pits);
    }
    const float share = SHARE_LEAST / (float)(LANES * (end - first));
    for (uint32_t k = first; k < end; k++) {
        struct canopy_tighten_block *block = &t->blocks[k];
        struct basis w;
        float at[LANES];
        find_basis(block, &w);
        evaluate(cell, &w, at);
        pass_lanes(t, pass, &block->lanes, at, &to);
        if (gathers) {
            add_moments(&sum[0], &w, to.r[0]);
        }
        if (twice) {
            add_moments(&sum[1], &w, to.r[1]);
        }
        if (measures) {
            for (int l = 0; l < LANES; l++) {
                largest = larger(largest, to.r[1][l]);
            }
            add_hessian(&h, block, to.r[1], share * largest);
        }
    }
    add_results(t, &to);
    for (int k = 0; gathers && k < 1 + twice; k++) {
        fold(&sum[k]);
        add_pits(sum[k].all, (const float(*)[LANES])r[k]);
        add_cell(cell, (const float(*)[4])sum[k].all, t->g[k]);
    }
    if (measures) {
        add_to_matrix(t, cell, &h);
    }
}

void canopy_tighten_pass(struct canopy_tighten *t, enum canopy_tighten_pass pass, uint32_t row) {
    const uint32_t cells = t->frame.size[1] - 1U;
    const float *const surface[] = {[CANOPY_TIGHTEN_PASS_SLACKS] = t->x,      [CANOPY_TIGHTEN_PASS_MEASURE] = t->x,
                                    [CANOPY_TIGHTEN_PASS_AFFINE] = t->affine, [CANOPY_TIGHTEN_PASS_STEP] = t->step,
                                    [CANOPY_TIGHTEN_PASS_CENTRE] = t->x,      [CANOPY_TIGHTEN_PASS_TRY] = t->affine,
                                    [CANOPY_TIGHTEN_PASS_ACCEPT] = t->affine};
    for (uint32_t w = 0; w < cells; w++) {
        const uint32_t index = row * cells + w;
        if (is_live(t, index)) {
            struct cell cell;
            find_cell(t, row, w, &cell);
            read_cell(&cell, surface[pass]);
            pass_cell(t, pass, index, &cell);
        }
    }
}

void canopy_tighten_weigh(struct canopy_tighten *t, uint32_t row) {
    const uint32_t cells = t->frame.size[1] - 1U;
    for (uint32_t w = 0; w < cells; w++) {
        const uint32_t index = row * cells + w;
        struct cell cell;
        find_cell(t, row, w, &cell);
        struct moments sum;
        memset(&sum, 0, sizeof sum);
        for (uint32_t k = t->first[index]; k < t->first[index + 1]; k++) {
            struct basis basis;
            float one[LANES];
            find_basis(&t->blocks[k], &basis);
            for (int l = 0; l < LANES; l++) {
                one[l] = on(t->blocks[k].lanes.z[l]);
            }
            add_moments(&sum, &basis, one);
        }
        if (t->first[index] < t->first[index + 1]) {
            fold(&sum);
            add_cell(&cell, (const float(*)[4])sum.all, t->cost);
            for (int a = 0; a < 16; a++) {
                t->seen[cell.index[a]] = 1;
            }
        }
    }
}

// ---- Whole coefficients

static void read_whole(const struct canopy_tighten *t, struct cell *cell, const int32_t *b) {
    float from[4][4];
    for (int a = 0; a < 16; a++) {
        from[a / 4][a % 4] = (float)(b[cell->index[a]] - t->low) * t->per_step;
    }
    to_bernstein((const float(*)[4])from, cell->c);
}

void canopy_tighten_over_row(struct canopy_tighten *t, const int32_t *other, uint32_t row) {
    const uint32_t cells = t->frame.size[1] - 1U;
    for (uint32_t w = 0; w < cells; w++) {
        struct cell cell;
        float value[PITS][LANES];
        find_cell(t, row, w, &cell);
        read_whole(t, &cell, other);
        evaluate_pits(&cell, value);
        for (int p = 0; p < PITS; p++) {
            struct canopy_tighten_lanes *pit = &t->pits[PITS * (size_t)(row * cells + w) + (size_t)p];
            for (int q = 0; q < PITS; q++) {
                pit->z[q] = larger(pit->z[q], value[p][q] + CANOPY_TIGHTEN_ERROR);
            }
        }
    }
}

static float missing_in(const struct canopy_tighten *t, uint32_t index, const struct cell *cell) {
    float missing = CANOPY_TIGHTEN_NONE, value[PITS][LANES];
    evaluate_pits(cell, value);
    for (int p = 0; p < PITS; p++) {
        const struct canopy_tighten_lanes *pit = &t->pits[PITS * (size_t)index + (size_t)p];
        for (int q = 0; q < PITS; q++) {
            missing = larger(missing, pit->z[q] - value[p][q]);
        }
    }
    float lanes[LANES];
    for (int l = 0; l < LANES; l++) {
        lanes[l] = missing;
    }
    for (uint32_t k = t->first[index]; k < t->first[index + 1]; k++) {
        const struct canopy_tighten_block *block = &t->blocks[k];
        struct basis w;
        float at[LANES];
        find_basis(block, &w);
        evaluate(cell, &w, at);
        for (int l = 0; l < LANES; l++) {
            lanes[l] = larger(lanes[l], block->lanes.z[l] - at[l]);
        }
    }
    for (int l = 0; l < LANES; l++) {
        missing = larger(missing, lanes[l]);
    }
    return missing;
}

bool canopy_tighten_raise_row(const struct canopy_tighten *t, int32_t *b, float reach, uint32_t row) {
    const uint32_t cells = t->frame.size[1] - 1U;
    const float error = CANOPY_TIGHTEN_ERROR * larger(reach / CANOPY_TIGHTEN_ERROR_REACH, 1.0f);
    for (uint32_t w = 0; w < cells; w++) {
        const uint32_t index = row * cells + w;
        if (!is_live(t, index)) {
            continue;
        }
        struct cell cell;
        find_cell(t, row, w, &cell);
        read_whole(t, &cell, b);
        const float missing = missing_in(t, index, &cell) + error;
        if (missing <= 0) {
            continue;
        }
        if (missing > 2.0f * reach) {
            return false;
        }
        const int32_t by = (int32_t)ceilf(missing * t->range) + 1;
        for (int a = 0; a < 16; a++) {
            bool again = false;  // a repeated end coefficient is raised once
            for (int c = 0; c < a; c++) {
                again = again || cell.index[c] == cell.index[a];
            }
            b[cell.index[a]] += again ? 0 : by;
            if (b[cell.index[a]] > CANOPY_COEFFICIENT_LIMIT ||
                (float)(b[cell.index[a]] - t->low) * t->per_step > reach) {
                return false;
            }
        }
    }
    return true;
}
