// Cells and local parameters to heights of the surface, each with a bound of its error.

#include <math.h>

#include "tools/common/exact_parts.h"

static double horner(const struct canopy_exact_cell *cell, double s, double t) {
    const canopy_pair ss = {s, s};
    const canopy_pair low = ((cell->c[3][0] * ss + cell->c[2][0]) * ss + cell->c[1][0]) * ss + cell->c[0][0];
    const canopy_pair high = ((cell->c[3][1] * ss + cell->c[2][1]) * ss + cell->c[1][1]) * ss + cell->c[0][1];
    return ((high[1] * t + high[0]) * t + low[1]) * t + low[0];
}

static void evaluate_cells(const struct canopy_exact *e, struct canopy_exact_block *b) {
    const int32_t columns = (int32_t)e->surrogate->size[1] - 1;
    for (size_t p = 0; p < b->count; p++) {
        const int32_t at = b->hu[p] * columns + b->hv[p];
        b->surface[p] = horner(&e->cells[at], b->s[p], b->t[p]);
        b->slack[p] = e->slack[at] + 0x1p-51 * fabs(b->q[2][p]);
    }
}

/// The four B-spline weights of a local parameter.
static void weigh(double s, double w[4]) {
    const double r = 1.0 - s;
    w[0] = r * r * r / 6.0;
    w[1] = ((3.0 * s - 6.0) * (s * s) + 4.0) / 6.0;
    w[2] = ((3.0 * r - 6.0) * (r * r) + 4.0) / 6.0;
    w[3] = s * s * s / 6.0;
}

static double window_height(const struct canopy_window *w, double x, double y) {
    const double rows = (double)w->size[0];
    const double columns = (double)w->size[1];
    if (!(x > -2.0 && x < rows + 1.0 && y > -2.0 && y < columns + 1.0)) {
        return 0.0;
    }
    const int gu = (int)floor(x);
    const int gv = (int)floor(y);
    double wu[4];
    double wv[4];
    weigh(x - gu, wu);
    weigh(y - gv, wv);
    double sum = 0.0;
    for (int a = 0; a < 4; a++) {
        for (int c = 0; c < 4; c++) {
            const int i = gu + a - 1;
            const int j = gv + c - 1;
            if (i >= 0 && i < (int)w->size[0] && j >= 0 && j < (int)w->size[1]) {
                sum += wu[a] * wv[c] * w->coefficients[(size_t)i * w->size[1] + (size_t)j];
            }
        }
    }
    return sum;
}

static void add_windows(const struct canopy_exact *e, struct canopy_exact_block *b) {
    const struct canopy_surrogate *s = e->surrogate;
    const double scale = s->side == CANOPY_ABOVE ? s->lsb : -s->lsb;
    for (size_t p = 0; p < b->count; p++) {
        const double u = (double)b->hu[p] + b->s[p];
        const double v = (double)b->hv[p] + b->t[p];
        double sum = 0.0;
        double across = 0.0;
        for (size_t i = 0; i < s->window_count; i++) {
            const struct canopy_window *w = &s->windows[i];
            const double step = w->level == 1 ? 2.0 : 4.0;
            const double x = u * step - w->first[0];
            const double y = v * step - w->first[1];
            sum += window_height(w, x, y);
            across = fmax(across, fabs(x) + fabs(y));
        }
        b->surface[p] += sum * scale;
        // Term by term in exact_parts.h.
        const double argument = 4.1 * ((double)s->size[0] + (double)s->size[1]) +
                                (e->aligned ? 0.0 : 6.2 * b->g[p]) * (e->inverse[0] + e->inverse[1]);
        b->slack[p] += CANOPY_EXACT_EPSILON * e->windows_reach *
                       (800.0 + 4.0 * (double)s->window_count + 8.0 * argument + 4.0 * across);
    }
}

void canopy_exact_evaluate(const struct canopy_exact *e, struct canopy_exact_block *b) {
    evaluate_cells(e, b);
    if (e->surrogate->window_count > 0) {
        add_windows(e, b);
    }
}

void canopy_exact_add_turned_slack(const struct canopy_exact *e, struct canopy_exact_block *b) {
    const int32_t columns = (int32_t)e->surrogate->size[1] - 1;
    for (size_t p = 0; p < b->count; p++) {
        const double reach = e->reach[b->hu[p] * columns + b->hv[p]];
        b->slack[p] += CANOPY_EXACT_EPSILON * b->g[p] * (16.0 * reach * (e->inverse[0] + e->inverse[1]) + 8.0);
    }
}
