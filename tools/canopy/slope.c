#include "tools/canopy/slope.h"

#include <math.h>

/// The uniform cubic B-spline centred on 0 and its derivative.
static double spline(double x) {
    const double a = fabs(x);
    if (a >= 2.0) {
        return 0.0;
    }
    const double r = 2.0 - a;
    return a >= 1.0 ? r * r * r / 6.0 : (4.0 - 6.0 * a * a + 3.0 * a * a * a) / 6.0;
}

static double slope(double x) {
    const double a = fabs(x), r = 2.0 - a;
    const double size = a >= 2.0 ? 0.0 : a >= 1.0 ? r * r / 2.0 : a * (2.0 - 1.5 * a);
    return x > 0.0 ? -size : size;
}

struct grid {
    const double *b;
    double first[2];  ///< place of the first coefficient, in its own knots
    int64_t size[2];
    bool repeated;  ///< the outermost coefficients are repeated once; else there are none outside
};

static int64_t clip(int64_t i, int64_t n) { return i < 0 ? 0 : i < n ? i : n - 1; }

/// Adds the derivatives of one grid by its own knots, times `by`.
static void add(const struct grid *grid, double u, double v, double by, double gradient[2]) {
    const double x = u - grid->first[0], y = v - grid->first[1];
    const int64_t edge = grid->repeated ? 1 : 0, h = (int64_t)floor(x), w = (int64_t)floor(y);
    for (int64_t i = h - 1; i <= h + 2; i++) {
        for (int64_t j = w - 1; j <= w + 2; j++) {
            if (i < -edge || j < -edge || i >= grid->size[0] + edge || j >= grid->size[1] + edge) {
                continue;
            }
            const double b = by * grid->b[clip(i, grid->size[0]) * grid->size[1] + clip(j, grid->size[1])];
            gradient[0] += b * slope(x - (double)i) * spline(y - (double)j);
            gradient[1] += b * spline(x - (double)i) * slope(y - (double)j);
        }
    }
}

struct canopy_slope canopy_slope_at(const struct canopy_surrogate *s, double u, double v) {
    struct canopy_slope result = {.gradient = {0.0, 0.0}};
    const struct grid base = {s->coefficients, {0.0, 0.0}, {s->size[0], s->size[1]}, true};
    add(&base, u, v, s->lsb, result.gradient);
    for (size_t k = 0; k < s->window_count; k++) {
        const struct canopy_window *w = &s->windows[k];
        const double fine = ldexp(1.0, w->level);
        const struct grid window = {w->coefficients, {w->first[0], w->first[1]}, {w->size[0], w->size[1]}, false};
        add(&window, u * fine, v * fine, s->lsb * fine, result.gradient);
    }
    for (int axis = 0; axis < 2; axis++) {
        result.gradient[axis] /= s->pitch[axis];
    }
    const double length = hypot(hypot(result.gradient[0], result.gradient[1]), 1.0);
    for (int k = 0; k < 3; k++) {
        result.normal[k] =
            (s->axes[2][k] - result.gradient[0] * s->axes[0][k] - result.gradient[1] * s->axes[1][k]) / length;
    }
    return result;
}
