// A surrogate to the table that its points are judged by.

#include <math.h>
#include <stdlib.h>

#include "tools/common/exact_parts.h"

#define SLACK_BASE 720.0
#define SLACK_SIZE 8.0
#define SLACK_LEAST 0x1p-800

/// 6 times the power-basis coefficients of x0 N(s+1) + x1 N(s) + x2 N(s-1) + x3 N(s-2).
static void to_powers(const double x[4], double c[4]) {
    c[0] = (x[0] + x[2]) + 4.0 * x[1];
    c[1] = 3.0 * (x[2] - x[0]);
    c[2] = 3.0 * ((x[0] - 2.0 * x[1]) + x[2]);
    c[3] = (x[3] - x[0]) + 3.0 * (x[1] - x[2]);
}

static void fill_cell(struct canopy_exact *e, int hu, int hv, double scale) {
    const struct canopy_surrogate *s = e->surrogate;
    const int m = (int)s->size[0];
    const int n = (int)s->size[1];
    double rows[4][4];
    for (int a = 0; a < 4; a++) {
        const double *row = s->coefficients + (size_t)canopy_exact_clamp(hu + a - 1, m) * (size_t)n;
        const double x[4] = {row[canopy_exact_clamp(hv - 1, n)], row[hv], row[hv + 1],
                             row[canopy_exact_clamp(hv + 2, n)]};
        to_powers(x, rows[a]);
    }
    struct canopy_exact_cell *cell = &e->cells[(size_t)hu * (size_t)(n - 1) + (size_t)hv];
    for (int l = 0; l < 4; l++) {
        const double x[4] = {rows[0][l], rows[1][l], rows[2][l], rows[3][l]};
        double c[4];
        to_powers(x, c);
        for (int k = 0; k < 4; k++) {
            cell->c[k][l / 2][l % 2] = c[k] * scale;
        }
    }
}

/// reach[hu][hv] = lsb * max |b| over rows hu-2 .. hu+3 and columns hv-2 .. hv+3, by rows and then by columns.
static bool fill_reach(struct canopy_exact *e) {
    const struct canopy_surrogate *s = e->surrogate;
    const int m = (int)s->size[0];
    const int n = (int)s->size[1];
    double *along = malloc((size_t)m * (size_t)(n - 1) * sizeof *along);
    if (!along) {
        return false;
    }
    for (int i = 0; i < m; i++) {
        for (int hv = 0; hv < n - 1; hv++) {
            double most = 0.0;
            for (int j = hv - 2; j <= hv + 3; j++) {
                most = fmax(most, fabs(s->coefficients[(size_t)i * (size_t)n + (size_t)canopy_exact_clamp(j, n)]));
            }
            along[(size_t)i * (size_t)(n - 1) + (size_t)hv] = most;
        }
    }
    for (int hu = 0; hu < m - 1; hu++) {
        for (int hv = 0; hv < n - 1; hv++) {
            double most = 0.0;
            for (int i = hu - 2; i <= hu + 3; i++) {
                most = fmax(most, along[(size_t)canopy_exact_clamp(i, m) * (size_t)(n - 1) + (size_t)hv]);
            }
            e->reach[(size_t)hu * (size_t)(n - 1) + (size_t)hv] = most * s->lsb;
        }
    }
    free(along);
    return true;
}

/// Whether a size is far from overflow and underflow: then no intermediate result overflows, and what underflow can do
/// stays below 2^-800 (absolute errors of 2^-1074, times slopes and inverse pitches below 2^250).
static bool is_ordinary(double size) { return size <= 0x1p200 && size >= 0x1p-200; }

static bool all_ordinary(const struct canopy_surrogate *s) {
    double most = 0.0;
    for (size_t i = 0; i < (size_t)s->size[0] * s->size[1]; i++) {
        most = fmax(most, fabs(s->coefficients[i]));
    }
    for (size_t w = 0; w < s->window_count; w++) {
        for (size_t i = 0; i < (size_t)s->windows[w].size[0] * s->windows[w].size[1]; i++) {
            most = fmax(most, fabs(s->windows[w].coefficients[i]));
        }
    }
    return is_ordinary(s->pitch[0]) && is_ordinary(s->pitch[1]) && is_ordinary(s->lsb) && most <= 0x1p200 &&
           most * s->lsb <= 0x1p200 && fabs(s->origin[0]) <= 0x1p200 && fabs(s->origin[1]) <= 0x1p200 &&
           fabs(s->origin[2]) <= 0x1p200;
}

static void find_alignment(struct canopy_exact *e) {
    e->aligned = true;
    for (int i = 0; i < 3; i++) {
        bool found = false;
        for (int k = 0; k < 3; k++) {
            const double a = e->surrogate->axes[i][k];
            if (fabs(a) == 1.0 && !found) {
                found = true;
                e->coordinate[i] = k;
                e->sign[i] = a;
            } else if (a != 0.0) {
                e->aligned = false;
            }
        }
        e->aligned = e->aligned && found;
    }
}

static void fill(struct canopy_exact *e) {
    const struct canopy_surrogate *s = e->surrogate;
    const double sign = s->side == CANOPY_ABOVE ? 1.0 : -1.0;
    find_alignment(e);
    for (int i = 0; i < 2; i++) {
        const double cells = (double)s->size[i] - 1.0;
        e->inverse[i] = 1.0 / s->pitch[i];
        e->limit[i] = s->pitch[i] * cells;
        e->limit_exact[i] = fma(s->pitch[i], cells, -e->limit[i]) == 0.0;
    }
    const double per_cell =
        CANOPY_EXACT_EPSILON * (SLACK_BASE + SLACK_SIZE * ((double)s->size[0] + (double)s->size[1]));
    const int columns = (int)s->size[1] - 1;
    for (int hu = 0; hu < (int)s->size[0] - 1; hu++) {
        for (int hv = 0; hv < columns; hv++) {
            fill_cell(e, hu, hv, sign * s->lsb / 36.0);
            const size_t at = (size_t)hu * (size_t)columns + (size_t)hv;
            e->slack[at] = e->reach[at] * per_cell + SLACK_LEAST;
        }
    }
    for (size_t w = 0; w < s->window_count; w++) {
        double most = 0.0;
        for (size_t i = 0; i < (size_t)s->windows[w].size[0] * s->windows[w].size[1]; i++) {
            most = fmax(most, fabs(s->windows[w].coefficients[i]));
        }
        e->windows_reach += most * s->lsb;
    }
}

struct canopy_exact *canopy_exact_open(const struct canopy_surrogate *surrogate) {
    struct canopy_exact *e = calloc(1, sizeof *e);
    if (!e) {
        return NULL;
    }
    const size_t count = (size_t)(surrogate->size[0] - 1) * (surrogate->size[1] - 1);
    e->surrogate = surrogate;
    e->rational = canopy_rational_open(surrogate);
    e->cells = aligned_alloc(64, count * sizeof *e->cells);
    e->slack = malloc(count * sizeof *e->slack);
    e->reach = malloc(count * sizeof *e->reach);
    e->ordinary = all_ordinary(surrogate);
    if (!e->rational || !e->cells || !e->slack || !e->reach || !fill_reach(e)) {
        canopy_exact_close(e);
        return NULL;
    }
    fill(e);
    return e;
}

void canopy_exact_close(struct canopy_exact *exact) {
    if (exact) {
        canopy_rational_close(exact->rational);
        free(exact->cells);
        free(exact->slack);
        free(exact->reach);
        free(exact);
    }
}
