#include "lib/cover/certify.h"

#include <stdbool.h>

#include "lib/num/fixed.h"

// Q30 weights at s = k/q: s to nearest, the cubes rounded up because what they multiply is never positive.
static void make_weights(int32_t *table, uint16_t q) {
    const uint32_t cube = 6U * q * q * q;
    int32_t *s = table, *left = s + q + 1, *right = left + q + 1;
    for (uint32_t k = 0; k <= q; k++) {
        s[k] = (int32_t)((((uint64_t)k << 30) + q / 2U) / q);
        right[k] = (int32_t)canopy_div_up((uint64_t)(k * k * k) << 30, cube);
        left[q - k] = right[k];
    }
}

enum canopy_status canopy_certify_init(struct canopy_certify *certify, const struct canopy_field *field, void *arena,
                                       size_t bytes) {
    const uint16_t cu = field->axis[0].cells, cv = field->axis[1].cells;
    const size_t tables = CANOPY_CERTIFY_TABLES(cu, cv);
    struct canopy_arena cut;
    const enum canopy_status status =
        canopy_arena_open(&cut, arena, bytes, tables + CANOPY_CERTIFY_WORK(field->frame.size[1], cv));
    return status == CANOPY_OK ? canopy_certify_init_apart(certify, field, cut.next, cut.next + tables) : status;
}

enum canopy_status canopy_certify_init_apart(struct canopy_certify *certify, const struct canopy_field *field,
                                             void *tables, void *work) {
    if (!field->exact) {
        return CANOPY_ARGUMENT;
    }
    const uint16_t n = field->frame.size[1], cu = field->axis[0].cells, cv = field->axis[1].cells;
    *certify = (struct canopy_certify){.field = field};
    struct canopy_arena cut = {tables, SIZE_MAX};
    for (int a = 0; a < 2; a++) {
        const uint16_t q = field->axis[a].cells;
        if (a == 1 && cu == cv) {
            certify->weights[1] = certify->weights[0];
            certify->lattice[1] = certify->lattice[0];
            break;
        }
        certify->weights[a] = canopy_arena_take(&cut, 12 * (q + 1U));
        make_weights(certify->weights[a], q);
        certify->lattice[a] = canopy_arena_take(&cut, 12U * CANOPY_BEZIER_LATTICE(q));
        canopy_bezier_weights(certify->lattice[a], q);
    }
    cut = (struct canopy_arena){work, SIZE_MAX};
    certify->column = canopy_arena_take(&cut, 4U * n);
    certify->low = canopy_arena_take(&cut, 4 * CANOPY_LINE_NODES(n, cv));
    certify->high = canopy_arena_take(&cut, 4 * CANOPY_LINE_NODES(n, cv));
    return CANOPY_OK;
}

// One knot interval of a spline: what its bound is made of.
struct interval {
    int32_t from, step;   // b[h] and b[h+1] - b[h]
    int32_t left, right;  // min(D[h], 0) and min(D[h+1], 0)
};

static inline int32_t negative_part(int32_t before, int32_t here, int32_t after) {
    const int32_t second = before - 2 * here + after;  // fits: coefficients are within CANOPY_COEFFICIENT_LIMIT
    return second < 0 ? second : 0;
}

// The interval h of n coefficients that stand `stride` apart.
static inline struct interval interval_at(const int32_t *b, uint32_t n, uint32_t stride, uint32_t h) {
    const int32_t *here = b + (size_t)h * stride;
    const int32_t b0 = h > 0 ? here[-(ptrdiff_t)stride] : here[0], b1 = here[0], b2 = here[stride];
    const int32_t b3 = h + 2 < n ? here[2 * (size_t)stride] : b2;
    return (struct interval){b1, b2 - b1, negative_part(b0, b1, b2), negative_part(b1, b2, b3)};
}

// l at the interval's node k, rounded down. Every loss is on the low side: the cubes' weights are too large on what is
// not positive, the shift is a floor, and where k/q is not exact in Q30 the straight part is off by at most
// 2^-31 * 2^29 steps, for which one step is taken away.
static inline int32_t bound(const struct interval *i, const int32_t *weights, uint16_t q, uint32_t k) {
    const int64_t rise = canopy_wide(i->step, weights[k]) + canopy_wide(i->left, weights[q + 1U + k]) +
                         canopy_wide(i->right, weights[2U * (q + 1U) + k]);
    return i->from + (int32_t)canopy_shift_floor(rise, 30) - ((q & (q - 1U)) != 0);
}

// Node row k of the columns first … last: certify->column[j] = L[k][j].
static void bound_columns(struct canopy_certify *certify, uint32_t k, uint32_t first, uint32_t last) {
    const uint32_t m = certify->field->frame.size[0], n = certify->field->frame.size[1];
    const uint16_t q = certify->field->axis[0].cells;
    const uint32_t h = k / q < m - 1 ? k / q : m - 2;
    for (uint32_t j = first; j <= last; j++) {
        const struct interval i = interval_at(certify->b + j, m, n, h);
        certify->column[j] = bound(&i, certify->weights[0], q, k - h * q);
    }
}

// All nodes of node row k: to[l] = M[k][l].
static void bound_row(struct canopy_certify *certify, uint32_t k, int32_t *to) {
    const uint32_t n = certify->field->frame.size[1];
    const uint16_t q = certify->field->axis[1].cells;
    bound_columns(certify, k, 0, n - 1);
    for (uint32_t h = 0; h + 1 < n; h++) {
        const struct interval i = interval_at(certify->column, n, 1, h);
        for (uint32_t l = 0; l < q; l++) {
            *to++ = bound(&i, certify->weights[1], q, l);
        }
        if (h + 2 == n) {
            *to = bound(&i, certify->weights[1], q, q);
        }
    }
}

static bool are_within_limit(const struct canopy_frame *frame, const int32_t *b) {
    const uint32_t count = (uint32_t)frame->size[0] * frame->size[1];
    for (uint32_t i = 0; i < count; i++) {
        if (b[i] > CANOPY_COEFFICIENT_LIMIT || b[i] < -CANOPY_COEFFICIENT_LIMIT) {
            return false;
        }
    }
    return true;
}

void canopy_certify_begin(struct canopy_certify *certify, const int32_t *coefficients) {
    certify->b = are_within_limit(&certify->field->frame, coefficients) ? coefficients : NULL;
    canopy_certify_seek(certify, 0);
}

static inline int32_t least(int32_t a, int32_t b) { return a < b ? a : b; }

// ---- The second chance: Bernstein coefficients over the cell

static inline uint32_t clip(uint32_t i, uint32_t n) { return i < n ? i : n - 1; }

// The least Bernstein coefficient over cell k of a knot interval, of four splines.
static int32_t least_over(const int32_t rows[4][4], const int32_t *lattice, uint32_t k) {
    int32_t lowest = INT32_MAX;
    for (int p = 0; p < 4; p++) {
        for (int q = 0; q < 4; q++) {
            const int32_t *b = rows[p];
            lowest = least(lowest, canopy_bezier_floor(b[0], b[1], b[2], b[3], lattice + 3 * (3 * k + (uint32_t)q)));
        }
    }
    return lowest;
}

static int32_t least_bernstein(const struct canopy_certify *certify, uint32_t cell) {
    const struct canopy_field_axis *u = &certify->field->axis[0], *v = &certify->field->axis[1];
    const uint32_t m = certify->field->frame.size[0], n = certify->field->frame.size[1];
    const uint32_t row = cell / v->count, column = cell % v->count, h = row / u->cells, w = column / v->cells;
    const int32_t *lattice = certify->lattice[0] + 9 * (row - h * u->cells);
    int32_t rows[4][4];
    for (uint32_t c = 0; c < 4; c++) {
        const int32_t *b = certify->b + (w + c > 0 ? clip(w + c - 1, n) : 0);
        const int32_t b0 = b[n * (h > 0 ? h - 1 : 0)], b1 = b[n * h], b2 = b[n * (h + 1)], b3 = b[n * clip(h + 2, m)];
        for (uint32_t p = 0; p < 4; p++) {
            rows[p][c] = canopy_bezier_floor(b0, b1, b2, b3, lattice + 3 * p);
        }
    }
    return least_over(rows, certify->lattice[1], column - w * v->cells);
}

// Takes a cell's bound into account. False, with what is missing, where it is too low.
static inline bool settle(struct canopy_certify *certify, uint32_t cell, int32_t lowest) {
    const int32_t height = canopy_field_height(certify->field, cell);
    if (height == CANOPY_NO_HEIGHT) {
        return true;
    }
    if (lowest < height) {
        const int32_t second = least_bernstein(certify, cell);
        lowest = second > lowest ? second : lowest;
    }
    const int32_t margin = lowest - height;
    if (margin < 0) {
        certify->failed_cell = cell;
        certify->missing = -margin;
        return false;
    }
    certify->margin = least(certify->margin, margin);
    return true;
}

static bool certify_row(struct canopy_certify *certify, uint32_t row) {
    const uint32_t cells = certify->field->axis[1].count;
    const int32_t *low = certify->low, *high = certify->high;
    int32_t left = least(low[0], high[0]);
    for (uint32_t c = 0; c < cells; c++) {
        const int32_t right = least(low[c + 1], high[c + 1]);
        if (!settle(certify, row * cells + c, least(left, right))) {
            return false;
        }
        left = right;
    }
    return true;
}

enum canopy_status canopy_certify_step(struct canopy_certify *certify, uint32_t rows) {
    const uint32_t all = certify->field->axis[0].count;
    if (certify->b == NULL) {
        return CANOPY_RANGE;
    }
    for (; rows > 0 && certify->row < all; rows--) {
        if (!certify->have_low) {
            bound_row(certify, certify->row, certify->low);
        }
        bound_row(certify, certify->row + 1, certify->high);
        certify->have_low = certify_row(certify, certify->row);
        if (!certify->have_low) {  // coefficients will be raised
            return CANOPY_NOT_SAFE;
        }
        certify->row++;
        int32_t *spare = certify->low;
        certify->low = certify->high;
        certify->high = spare;
    }
    return certify->row < all ? CANOPY_MORE : CANOPY_OK;
}

enum canopy_status canopy_certify_cell(struct canopy_certify *certify, uint32_t cell) {
    const uint32_t cells = certify->field->axis[1].count, n = certify->field->frame.size[1];
    const uint16_t q = certify->field->axis[1].cells;
    const uint32_t row = cell / cells, column = cell % cells, h = column / q;
    const uint32_t first = h > 0 ? h - 1 : 0, last = h + 2 < n ? h + 2 : n - 1;
    int32_t lowest = INT32_MAX;
    if (certify->b == NULL) {
        return CANOPY_RANGE;
    }
    for (uint32_t k = row; k <= row + 1; k++) {
        bound_columns(certify, k, first, last);
        const struct interval i = interval_at(certify->column, n, 1, h);
        for (uint32_t l = column - h * q; l <= column - h * q + 1; l++) {
            lowest = least(lowest, bound(&i, certify->weights[1], q, l));
        }
    }
    return settle(certify, cell, lowest) ? CANOPY_OK : CANOPY_NOT_SAFE;
}
