#include "lib/spline/refined.h"

#include <stddef.h>

#include "lib/num/fixed.h"

// A fine cell of one level holds 2^(difference) cells of a finer one along each axis.
static int32_t coarser(uint32_t g, unsigned from, unsigned to) { return (int32_t)(g >> (from - to)); }

bool canopy_refinement_meets(const struct canopy_refinement *window, unsigned level, const uint32_t g[2]) {
    for (int a = 0; a < 2; a++) {
        const int32_t cell = coarser(g[a], level, window->level) - window->first[a];
        if (cell + 2 < 0 || cell - 1 >= window->size[a]) {
            return false;
        }
    }
    return true;
}

// ---- Knot insertion

// The four coefficients of a cell to those of its lower or upper half, times 8.
static void halve(const int64_t c[4], bool upper, int64_t to[4]) {
    const int64_t even = c[0] + 6 * c[1] + c[2], odd = 4 * (c[1] + c[2]), next = c[1] + 6 * c[2] + c[3];
    to[0] = upper ? even : 4 * (c[0] + c[1]);
    to[1] = upper ? odd : even;
    to[2] = upper ? next : odd;
    to[3] = upper ? 4 * (c[2] + c[3]) : next;
}

static void halve_both(int64_t c[4][4], bool upper_u, bool upper_v) {
    for (int a = 0; a < 4; a++) {
        const int64_t row[4] = {c[a][0], c[a][1], c[a][2], c[a][3]};
        halve(row, upper_v, c[a]);
    }
    for (int e = 0; e < 4; e++) {
        const int64_t column[4] = {c[0][e], c[1][e], c[2][e], c[3][e]};
        int64_t to[4];
        halve(column, upper_u, to);
        for (int a = 0; a < 4; a++) {
            c[a][e] = to[a];
        }
    }
}

// From `own` to `level`, then in units of 64^-level, and added.
static void descend(int64_t c[4][4], unsigned own, unsigned level, const uint32_t g[2], int64_t sum[4][4]) {
    for (unsigned k = own; k < level; k++) {
        const unsigned bit = level - 1 - k;
        halve_both(c, (g[0] >> bit & 1U) != 0, (g[1] >> bit & 1U) != 0);
    }
    for (int a = 0; a < 4; a++) {
        for (int e = 0; e < 4; e++) {
            sum[a][e] += c[a][e] * ((int64_t)1 << 6 * own);
        }
    }
}

// One of the four around a knot interval, the end ones repeated.
static uint32_t repeated(uint32_t interval, uint32_t a, uint32_t size) {
    const uint32_t i = interval + a > 0 ? interval + a - 1 : 0;
    return i < size ? i : size - 1;
}

static void gather_base(const int32_t *b, const uint16_t size[2], const uint32_t h[2], int64_t c[4][4]) {
    for (uint32_t a = 0; a < 4; a++) {
        const int32_t *row = b + (size_t)repeated(h[0], a, size[0]) * size[1];
        for (uint32_t e = 0; e < 4; e++) {
            c[a][e] = row[repeated(h[1], e, size[1])];
        }
    }
}

// The window's coefficients around its own fine cell, 0 outside.
static void gather_window(const struct canopy_refinement *window, const int32_t cell[2], int32_t c[4][4]) {
    for (int32_t a = 0; a < 4; a++) {
        for (int32_t e = 0; e < 4; e++) {
            const int32_t i = cell[0] - 1 + a - window->first[0], j = cell[1] - 1 + e - window->first[1];
            const bool inside = i >= 0 && i < window->size[0] && j >= 0 && j < window->size[1];
            c[a][e] = inside ? window->d[(size_t)i * window->size[1] + (size_t)j] : 0;
        }
    }
}

static void add_window(const struct canopy_refinement *window, unsigned level, const uint32_t g[2], int64_t sum[4][4]) {
    const int32_t cell[2] = {coarser(g[0], level, window->level), coarser(g[1], level, window->level)};
    int32_t d[4][4];
    int64_t c[4][4];
    gather_window(window, cell, d);
    for (int a = 0; a < 4; a++) {
        for (int e = 0; e < 4; e++) {
            c[a][e] = d[a][e];
        }
    }
    descend(c, window->level, level, g, sum);
}

bool canopy_refined_cell(const int32_t *b, const uint16_t size[2], const struct canopy_refinement *windows,
                         uint32_t count, unsigned level, const uint32_t g[2], int32_t c[4][4]) {
    const uint32_t h[2] = {g[0] >> level, g[1] >> level};
    int64_t base[4][4], sum[4][4] = {{0}};
    gather_base(b, size, h, base);
    descend(base, 0, level, g, sum);
    for (uint32_t k = 0; k < count; k++) {
        if (canopy_refinement_meets(&windows[k], level, g)) {
            add_window(&windows[k], level, g, sum);
        }
    }
    bool within = true;
    for (int a = 0; a < 4; a++) {
        for (int e = 0; e < 4; e++) {
            const int64_t floor = canopy_shift_floor(sum[a][e], 6 * level);
            within = within && floor >= -CANOPY_REFINED_LIMIT && floor <= CANOPY_REFINED_LIMIT;
            c[a][e] = within ? (int32_t)floor : 0;
        }
    }
    return within;
}

// ---- Evaluation

// sum w[i] c[i], Q30 weights: that sum to one, taken from c[1]; or to zero.
static int32_t mix(const int32_t c[4], const int32_t w[4]) {
    const int64_t rise =
        canopy_wide(c[0] - c[1], w[0]) + canopy_wide(c[2] - c[1], w[2]) + canopy_wide(c[3] - c[1], w[3]);
    return (int32_t)canopy_shift_floor(rise, 30);
}

int32_t canopy_refinement_fx(const struct canopy_refinement *window, const struct canopy_place *u,
                             const struct canopy_place *v, int32_t gradient[2]) {
    const struct canopy_place *const places[2] = {u, v};
    const unsigned k = window->level;
    int32_t weight[2][4], slope[2][4], cell[2], c[4][4], row[4], by_v[4];
    for (int a = 0; a < 2; a++) {
        const uint64_t fine = (uint64_t)(uint32_t)places[a]->s << k;
        cell[a] = (int32_t)((places[a]->interval << k) + (uint32_t)(fine >> 30));
        canopy_basis_fx((int32_t)(fine & (CANOPY_UNIT_Q30 - 1U)), weight[a], slope[a]);
    }
    gather_window(window, cell, c);
    for (int a = 0; a < 4; a++) {
        row[a] = c[a][1] + mix(c[a], weight[1]);
        by_v[a] = mix(c[a], slope[1]);
    }
    if (gradient != NULL) {
        bool saturated = false;
        gradient[0] = canopy_narrow((int64_t)mix(row, slope[0]) * (1 << k), &saturated);
        gradient[1] = canopy_narrow(((int64_t)by_v[1] + mix(by_v, weight[0])) * (1 << k), &saturated);
    }
    return row[1] + mix(row, weight[0]);
}

int32_t canopy_refined_fx(const int32_t *b, const uint16_t size[2], const struct canopy_refinement *windows,
                          uint32_t count, const struct canopy_place *u, const struct canopy_place *v,
                          int32_t gradient[2]) {
    int32_t by[2] = {0, 0};
    int64_t height = canopy_surface_fx(b, size, u, v, gradient);
    bool saturated = false;
    for (uint32_t k = 0; k < count; k++) {
        height += canopy_refinement_fx(&windows[k], u, v, gradient != NULL ? by : NULL);
        for (int a = 0; gradient != NULL && a < 2; a++) {
            gradient[a] = canopy_narrow((int64_t)gradient[a] + by[a], &saturated);
        }
    }
    return canopy_narrow(height, &saturated);
}
