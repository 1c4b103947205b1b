#include "tools/canopy/flat.h"

#include <math.h>
#include <stdlib.h>

#include "lib/num/fixed.h"

unsigned canopy_flat_level(const struct canopy_surrogate *surrogate) {
    int level = 0;
    for (size_t i = 0; i < surrogate->window_count; i++) {
        level = surrogate->windows[i].level > level ? surrogate->windows[i].level : level;
    }
    return (unsigned)level;
}

/// Coefficients -1 to size along both axes, times 64^level, times -1 where the surface from below is wanted: everything
/// is rounded up. 2^28 steps at level 2 come to 2^40.
struct grid {
    int64_t *b;
    uint32_t size[2];
};

static int64_t *at(const struct grid *grid, int64_t i, int64_t j) {
    return grid->b + (i + 1) * ((int64_t)grid->size[1] + 2) + j + 1;
}

static bool open(struct grid *grid, uint32_t m, uint32_t n) {
    *grid = (struct grid){.b = malloc(((size_t)m + 2) * ((size_t)n + 2) * sizeof *grid->b), .size = {m, n}};
    return grid->b != NULL;
}

struct steps {
    double ratio, doubt;
    bool upward;
};

static int64_t in_steps(const struct steps *steps, double coefficient) {
    const double x = (steps->upward ? coefficient : -coefficient) * steps->ratio;
    return (int64_t)ceil(x + fabs(x) * steps->doubt);
}

static void fill(const struct canopy_surrogate *s, const struct steps *steps, struct grid *grid) {
    const int64_t m = grid->size[0], n = grid->size[1];
    for (int64_t i = -1; i <= m; i++) {
        const int64_t row = i < 0 ? 0 : i < m ? i : m - 1;
        for (int64_t j = -1; j <= n; j++) {
            const int64_t column = j < 0 ? 0 : j < n ? j : n - 1;
            *at(grid, i, j) = in_steps(steps, s->coefficients[row * n + column]);
        }
    }
}

/// One coefficient of half the pitch from coarse ones `stride` apart, of which `b` is number 0, times 8.
static int64_t halved(const int64_t *b, int64_t stride, int64_t fine) {
    const int64_t i = canopy_shift_floor(fine, 1);
    b += i * stride;
    return (fine & 1) != 0 ? 4 * (b[0] + b[stride]) : b[-stride] + 6 * b[0] + b[stride];
}

/// Halves the pitch along both axes; the old memory is freed.
static bool refine(struct grid *grid) {
    struct grid rows, all;
    const uint32_t m = 2 * grid->size[0] - 1, n = 2 * grid->size[1] - 1;
    const bool ok = open(&rows, m, grid->size[1]);
    for (int64_t i = -1; ok && i <= m; i++) {
        for (int64_t j = -1; j <= grid->size[1]; j++) {
            *at(&rows, i, j) = halved(at(grid, 0, j), (int64_t)grid->size[1] + 2, i);
        }
    }
    free(grid->b);
    *grid = rows;
    if (!ok || !open(&all, m, n)) {
        return false;
    }
    for (int64_t i = -1; i <= m; i++) {
        for (int64_t j = -1; j <= n; j++) {
            *at(&all, i, j) = halved(at(grid, i, 0), 1, j);
        }
    }
    free(grid->b);
    *grid = all;
    return true;
}

/// Adds the windows of a level. What lies further out shapes nothing of the frame.
static void add_windows(const struct canopy_surrogate *s, const struct steps *steps, unsigned level,
                        struct grid *grid) {
    for (size_t k = 0; k < s->window_count; k++) {
        const struct canopy_window *w = &s->windows[k];
        for (int64_t r = 0; w->level == (int)level && r < w->size[0]; r++) {
            for (int64_t c = 0; c < w->size[1]; c++) {
                const int64_t i = w->first[0] + r, j = w->first[1] + c;
                if (i >= -1 && i <= grid->size[0] && j >= -1 && j <= grid->size[1]) {
                    const double d = w->coefficients[r * w->size[1] + c];
                    *at(grid, i, j) += in_steps(steps, d) * ((int64_t)1 << (6 * level));
                }
            }
        }
    }
}

/// The coefficient that stands for one outside the grid and the last one in it.
static int64_t edge_of(int64_t outside, int64_t last) {
    const int64_t both = canopy_div_ceil(outside + 4 * last, 5);
    return both > last ? both : last;
}

/// Leaves out the coefficients outside the grid: first along u, of all columns, then along v.
static void close_edges(struct grid *grid) {
    const int64_t m = grid->size[0], n = grid->size[1];
    for (int64_t j = -1; j <= n; j++) {
        *at(grid, 0, j) = edge_of(*at(grid, -1, j), *at(grid, 0, j));
        *at(grid, m - 1, j) = edge_of(*at(grid, m, j), *at(grid, m - 1, j));
    }
    for (int64_t i = 0; i < m; i++) {
        *at(grid, i, 0) = edge_of(*at(grid, i, -1), *at(grid, i, 0));
        *at(grid, i, n - 1) = edge_of(*at(grid, i, n), *at(grid, i, n - 1));
    }
}

bool canopy_flat_write(const struct canopy_surrogate *surrogate, unsigned level, double ratio, double doubt,
                       bool upward, int32_t *coefficients) {
    const struct steps steps = {ratio, doubt, upward};
    struct grid grid;
    bool ok = open(&grid, surrogate->size[0], surrogate->size[1]);
    if (ok) {
        fill(surrogate, &steps, &grid);
    }
    for (unsigned k = 1; ok && k <= level; k++) {
        ok = refine(&grid);
        if (ok) {
            add_windows(surrogate, &steps, k, &grid);
        }
    }
    if (ok) {
        close_edges(&grid);
        for (int64_t i = 0; i < grid.size[0]; i++) {
            for (int64_t j = 0; j < grid.size[1]; j++) {
                const int32_t steps_up = (int32_t)canopy_shift_ceil(*at(&grid, i, j), 6 * level);
                *coefficients++ = upward ? steps_up : -steps_up;
            }
        }
    }
    free(grid.b);
    return ok;
}
