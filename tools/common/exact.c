// The error bound. Let e = 2^-53, B = lsb * the largest |coefficient| that reaches the point's knot cell or one of its
// eight neighbours, and g_n = n e / (1 - n e).
//
// Table. Along one direction the power-basis coefficients of 6 N are whole combinations of four b's with absolute
// weight sums 6 W, W = (1, 1, 2, 4/3), at most 4 roundings each; twice, then times fl(lsb / 36): each c_kl is within
// g_11 W_k W_l B. Horner in s, then in t, s and t in [0, 1]: at most 12 roundings on any path. Together g_23 (1 + 1 + 2
// + 4/3)^2 B < 656 e B.
//
// Argument, axes along the coordinates. d = fl(p - o) has one rounding, 1/pitch one, their product one: u is off by at
// most 3.001 e (m - 1); clamping into [0, m-1] does not move it away from a true u inside. (s = u - cell is exact.) A
// slope of S is a convex combination of differences of neighbouring coefficients, so at most 2 B, in this cell and the
// next, where u may truly be. Both directions: 6.01 e (m + n - 2) B.
//
// Height and difference. w = fl(p - o) is off by e |w| (1 + e); fl(S - w) and the last subtraction of the slack add at
// most 2 e (B (1 + ...) + |w|) each ... all in all the slack
//
//     SLACK_BASE e B + SLACK_SIZE e (m + n) B + 2^-51 |w| + 2^-800,   SLACK_BASE = 720, SLACK_SIZE = 8
//
// leaves room for the roundings of the slack itself. 2^-800 covers underflow: see `is_ordinary`.
//
// Other axes: each q = a . d has error at most 4.01 e g with g = |d0| + |d1| + |d2| (|a| <= 1 + 1e-6), so u is off by
// at most 6.1 e g / pitch, and the slack is SLACK_BASE e B + e g (16 B (1/pu + 1/pv) + 8) + 2^-800.
//
// Windows: level k, coefficients at most B' in height: x = 2^k u - i0 is off by 2^k times u's error plus e |x|, slopes
// are at most 2 B', and 16 products of weights are summed directly (weights: 8 roundings of sums at most 4; products
// and sums 18): below 700 e B', and for the argument 2 B' (2^k (error of u + of v) + e (|x| + |y|)).
//
// Points that this leaves open (margin within the slack, frame edge in doubt) go to rational.c.

#include "tools/common/exact.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>

#include "tools/common/rational.h"

#if FLT_EVAL_METHOD != 0 || defined(__FAST_MATH__)
#error "The error bound needs IEEE double arithmetic: no x87, no -ffast-math."
#endif

#define BLOCK 256
#define EPSILON 0x1p-53
#define SLACK_BASE 720.0
#define SLACK_SIZE 8.0
#define SLACK_LEAST 0x1p-800

/// Two doubles that the compiler keeps in one register.
typedef double pair __attribute__((vector_size(16)));

/// Power-basis coefficients of one knot cell in height units, sign turned so that bigger is safer:
/// S(s, t) = sum_k s^k (c[k][0] + c[k][1] t + c[k][2] t^2 + c[k][3] t^3), a row as two pairs.
struct cell {
    pair c[4][2];
};

struct canopy_exact {
    const struct canopy_surrogate *surrogate;
    struct canopy_rational *rational;
    struct cell *cells;
    double *slack;      ///< a cell: what of the slack does not depend on the point
    double *reach;      ///< a cell: B
    bool ordinary;      ///< magnitudes are such that the bound holds; otherwise every point goes to GMP
    bool aligned;       ///< each axis is plus or minus a coordinate axis
    int coordinate[3];  ///< then: which
    double sign[3];     ///< and its sign
    double inverse[2];  ///< 1 / pitch
    double limit[2];    ///< (m-1) pitch rounded
    bool limit_exact[2];
    double windows_reach;
};

/// A block on its way through the stages.
struct block {
    double q[3][BLOCK];  ///< along the axes; q[2] with the side's sign
    double g[BLOCK];     ///< |d0| + |d1| + |d2|, for axes of any direction
    double s[BLOCK];
    double t[BLOCK];
    int32_t hu[BLOCK];
    int32_t hv[BLOCK];
    double surface[BLOCK];
    double slack[BLOCK];
    uint32_t origin[BLOCK];  ///< index within the block as it was loaded
    size_t count;
};

// ---------------------------------------------------------------------------------------------------------------------
// Preparation

static int clamp(int i, int limit) { return i < 0 ? 0 : i < limit ? i : limit - 1; }

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
        const double *row = s->coefficients + (size_t)clamp(hu + a - 1, m) * (size_t)n;
        const double x[4] = {row[clamp(hv - 1, n)], row[hv], row[hv + 1], row[clamp(hv + 2, n)]};
        to_powers(x, rows[a]);
    }
    struct cell *cell = &e->cells[(size_t)hu * (size_t)(n - 1) + (size_t)hv];
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
                most = fmax(most, fabs(s->coefficients[(size_t)i * (size_t)n + (size_t)clamp(j, n)]));
            }
            along[(size_t)i * (size_t)(n - 1) + (size_t)hv] = most;
        }
    }
    for (int hu = 0; hu < m - 1; hu++) {
        for (int hv = 0; hv < n - 1; hv++) {
            double most = 0.0;
            for (int i = hu - 2; i <= hu + 3; i++) {
                most = fmax(most, along[(size_t)clamp(i, m) * (size_t)(n - 1) + (size_t)hv]);
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
    const double per_cell = EPSILON * (SLACK_BASE + SLACK_SIZE * ((double)s->size[0] + (double)s->size[1]));
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

struct canopy_exact_result canopy_exact_begin(void) {
    return (struct canopy_exact_result){.first_wrong = UINT64_MAX,
                                        .first_outside = UINT64_MAX,
                                        .margin = HUGE_VAL,
                                        .gap_max = -HUGE_VAL,
                                        .height_min = HUGE_VAL,
                                        .height_max = -HUGE_VAL};
}

// ---------------------------------------------------------------------------------------------------------------------
// Stages. Loops run over BLOCK, a constant, so that compilers make vectors of them; what lies behind `count` is a copy
// of the last point and is not counted.

static double coordinate_of(const struct canopy_cloud *cloud, int k, size_t index) {
    const size_t at = index * cloud->stride;
    return cloud->scalar == CANOPY_F32 ? (double)((const float *)cloud->axis[k])[at]
                                       : (double)((const int32_t *)cloud->axis[k])[at];
}

static void load_point(const struct canopy_cloud *cloud, size_t index, double point[3]) {
    for (int k = 0; k < 3; k++) {
        point[k] = coordinate_of(cloud, k, index);
    }
}

/// to[] = (p - origin) * sign for one coordinate of BLOCK points.
static void load_coordinate(const struct canopy_cloud *cloud, int k, size_t first, double origin, double sign,
                            double *restrict to) {
    const size_t stride = cloud->stride;
    if (cloud->scalar == CANOPY_F32) {
        const float *from = (const float *)cloud->axis[k] + first * stride;
        for (size_t i = 0; i < BLOCK; i++) {
            to[i] = ((double)from[i * stride] - origin) * sign;
        }
    } else {
        const int32_t *from = (const int32_t *)cloud->axis[k] + first * stride;
        for (size_t i = 0; i < BLOCK; i++) {
            to[i] = ((double)from[i * stride] - origin) * sign;
        }
    }
}

static void load_aligned(const struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first,
                         struct block *b) {
    const double side = e->surrogate->side == CANOPY_ABOVE ? 1.0 : -1.0;
    for (int i = 0; i < 3; i++) {
        const int k = e->coordinate[i];
        load_coordinate(cloud, k, first, e->surrogate->origin[k], i == 2 ? side * e->sign[i] : e->sign[i], b->q[i]);
    }
}

static void load_turned(const struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first, struct block *b) {
    double d[3][BLOCK];
    for (int k = 0; k < 3; k++) {
        load_coordinate(cloud, k, first, e->surrogate->origin[k], 1.0, d[k]);
    }
    const double side = e->surrogate->side == CANOPY_ABOVE ? 1.0 : -1.0;
    for (int i = 0; i < 3; i++) {
        const double sign = i == 2 ? side : 1.0;
        const double *axis = e->surrogate->axes[i];
        for (size_t p = 0; p < BLOCK; p++) {
            b->q[i][p] = sign * (axis[0] * d[0][p] + axis[1] * d[1][p] + axis[2] * d[2][p]);
        }
    }
    for (size_t p = 0; p < BLOCK; p++) {
        b->g[p] = fabs(d[0][p]) + fabs(d[1][p]) + fabs(d[2][p]);
    }
}

/// Cell and local parameter along one direction. Arguments outside (or NaN) land in a cell all the same: such points
/// are sorted out by `keep_inside`.
static void find_cell(const struct canopy_exact *e, int i, const double *restrict q, int32_t *restrict h,
                      double *restrict local) {
    const double inverse = e->inverse[i];
    const double most = (double)e->surrogate->size[i] - 1.0;
    const int32_t last = (int32_t)e->surrogate->size[i] - 2;
    for (size_t p = 0; p < BLOCK; p++) {
        double u = q[p] * inverse;
        u = u > 0.0 ? u : 0.0;
        u = u < most ? u : most;
        int32_t cell = (int32_t)u;
        cell = cell < last ? cell : last;
        h[p] = cell;
        local[p] = u - (double)cell;
    }
}

/// Whether coordinate i of a point is inside beyond doubt. Subtraction never rounds across zero or across another
/// double, so for axes along the coordinates d < limit decides, if limit is the exact far edge or the comparison is not
/// that close.
static bool clearly_inside(const struct canopy_exact *e, const struct block *b, size_t p, int i) {
    const double q = b->q[i][p];
    if (e->aligned) {
        return q >= 0.0 && (e->limit_exact[i] ? q < e->limit[i] : q < e->limit[i] * (1.0 - 4.0 * EPSILON));
    }
    const double room = 8.0 * EPSILON * b->g[p] + 4.0 * EPSILON * e->limit[i];
    return q > room && q < e->limit[i] - room;
}

/// Whether p - o has no rounding error. With |p| >= |o| the difference p - d is exact (Dekker 1971), so comparing it
/// with o tells; with |p| < |o| the same holds of o + d and p.
static bool subtracts_exactly(double p, double o) {
    const double d = p - o;
    return d + o == p && p - d == o;
}

/// On the far edge exactly.
static bool on_far_edge(const struct canopy_exact *e, const struct block *b, size_t p, int i, const double point[3]) {
    const int k = e->coordinate[i];
    return e->aligned && e->limit_exact[i] && b->q[i][p] == e->limit[i] &&
           subtracts_exactly(point[k], e->surrogate->origin[k]);
}

static bool is_inside(const struct canopy_exact *e, const struct block *b, size_t p, const double point[3]) {
    bool known = e->ordinary;
    for (int i = 0; i < 2; i++) {
        known = known && (clearly_inside(e, b, p, i) || on_far_edge(e, b, p, i, point));
    }
    if (known) {
        return true;
    }
    return isfinite(point[0]) && isfinite(point[1]) && isfinite(point[2]) &&
           canopy_rational_inside(e->rational, point, NULL);
}

/// How many of the block may be on or beyond an edge: the quick test that nearly every block passes.
static size_t count_doubtful(const struct canopy_exact *e, const struct block *b) {
    size_t doubtful = 0;
    if (!e->ordinary) {
        return BLOCK;
    }
    if (e->aligned) {
        const double far[2] = {e->limit_exact[0] ? e->limit[0] : e->limit[0] * (1.0 - 4.0 * EPSILON),
                               e->limit_exact[1] ? e->limit[1] : e->limit[1] * (1.0 - 4.0 * EPSILON)};
        for (size_t p = 0; p < BLOCK; p++) {
            doubtful += !((b->q[0][p] >= 0.0) & (b->q[0][p] < far[0]) & (b->q[1][p] >= 0.0) & (b->q[1][p] < far[1]));
        }
        return doubtful;
    }
    for (size_t p = 0; p < BLOCK; p++) {
        doubtful += !(clearly_inside(e, b, p, 0) && clearly_inside(e, b, p, 1));
    }
    return doubtful;
}

/// Counts what is outside and moves the rest together.
static void keep_inside(const struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first, uint64_t before,
                        struct block *b, struct canopy_exact_result *result) {
    size_t kept = 0;
    for (size_t p = 0; p < b->count; p++) {
        double point[3];
        load_point(cloud, first + p, point);
        if (!is_inside(e, b, p, point)) {
            result->outside++;
            if (result->first_outside == UINT64_MAX) {
                result->first_outside = before + first + p;
            }
            continue;
        }
        for (int i = 0; i < 3; i++) {
            b->q[i][kept] = b->q[i][p];
        }
        b->g[kept] = e->aligned ? 0.0 : b->g[p];
        b->s[kept] = b->s[p];
        b->t[kept] = b->t[p];
        b->hu[kept] = b->hu[p];
        b->hv[kept] = b->hv[p];
        b->origin[kept++] = (uint32_t)p;
    }
    b->count = kept;
}

static double horner(const struct cell *cell, double s, double t) {
    const pair ss = {s, s};
    const pair low = ((cell->c[3][0] * ss + cell->c[2][0]) * ss + cell->c[1][0]) * ss + cell->c[0][0];
    const pair high = ((cell->c[3][1] * ss + cell->c[2][1]) * ss + cell->c[1][1]) * ss + cell->c[0][1];
    return ((high[1] * t + high[0]) * t + low[1]) * t + low[0];
}

static void evaluate(const struct canopy_exact *e, struct block *b) {
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

static void add_windows(const struct canopy_exact *e, struct block *b) {
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
        // (1 + count) roundings of the running sum, the argument's error of the two kinds of axes, and of x and y.
        const double argument = 4.0 * ((double)s->size[0] + (double)s->size[1]) +
                                (e->aligned ? 0.0 : 6.1 * b->g[p]) * (e->inverse[0] + e->inverse[1]);
        b->slack[p] +=
            EPSILON * e->windows_reach * (800.0 + 4.0 * (double)s->window_count + 8.0 * argument + 4.0 * across);
    }
}

/// The point's share of the slack with axes of any direction.
static void add_turned_slack(const struct canopy_exact *e, struct block *b) {
    const int32_t columns = (int32_t)e->surrogate->size[1] - 1;
    for (size_t p = 0; p < b->count; p++) {
        const double reach = e->reach[b->hu[p] * columns + b->hv[p]];
        b->slack[p] += EPSILON * b->g[p] * (16.0 * reach * (e->inverse[0] + e->inverse[1]) + 8.0);
    }
}

/// A tie on a flat cell whose numbers are exact in double: whole scenes can be of this kind, so GMP is spared.
static bool decide_flat(const struct canopy_exact *e, const struct block *b, size_t p, const double point[3],
                        double *margin) {
    if (!e->aligned || e->surrogate->window_count > 0 || !e->ordinary) {
        return false;
    }
    const struct canopy_surrogate *s = e->surrogate;
    const int m = (int)s->size[0];
    const int n = (int)s->size[1];
    const double first = s->coefficients[(size_t)b->hu[p] * (size_t)n + (size_t)b->hv[p]];
    for (int i = b->hu[p] - 1; i <= b->hu[p] + 2; i++) {
        for (int j = b->hv[p] - 1; j <= b->hv[p] + 2; j++) {
            if (s->coefficients[(size_t)clamp(i, m) * (size_t)n + (size_t)clamp(j, n)] != first) {
                return false;
            }
        }
    }
    const int k = e->coordinate[2];
    const double height = first * s->lsb;
    if (!subtracts_exactly(point[k], s->origin[k]) || fma(first, s->lsb, -height) != 0.0) {
        return false;
    }
    *margin = (s->side == CANOPY_ABOVE ? height : -height) - b->q[2][p];
    if (*margin != 0.0) {
        *margin = nextafter(*margin, -HUGE_VAL);
    }
    return true;
}

/// A point whose margin the slack leaves open, or that is wrong; or any, where the bound does not hold.
static void decide(const struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first, uint64_t before,
                   const struct block *b, size_t p, struct canopy_exact_result *result) {
    const double margin = b->surface[p] - b->q[2][p];
    const size_t index = first + b->origin[p];
    double floor = margin - b->slack[p];
    bool wrong = true;
    if (!(e->ordinary && margin + b->slack[p] < 0.0)) {
        double point[3];
        load_point(cloud, index, point);
        if (!decide_flat(e, b, p, point, &floor)) {
            result->decided_by_gmp++;
            wrong = canopy_rational_margin(e->rational, point, &floor) < 0;
        } else {
            wrong = floor < 0.0;
        }
    }
    result->wrong += wrong;
    if (wrong && result->first_wrong == UINT64_MAX) {
        result->first_wrong = before + index;
    }
    result->margin = fmin(result->margin, floor);
}

/// Margins, gaps and heights of the block.
static void judge(const struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first, uint64_t before,
                  const struct block *b, struct canopy_exact_result *result) {
    double sum = 0.0;
    double lowest = HUGE_VAL;
    double most = result->gap_max;
    double height_min = HUGE_VAL;
    double height_max = -HUGE_VAL;
    for (size_t p = 0; p < b->count; p++) {
        const double w = b->q[2][p];
        const double margin = b->surface[p] - w;
        const double floor = margin - b->slack[p];
        sum += margin;
        most = most > margin ? most : margin;
        lowest = lowest < floor ? lowest : floor;
        height_min = height_min < w ? height_min : w;
        height_max = height_max > w ? height_max : w;
    }
    result->gap_sum += sum;
    result->gap_max = most;
    const bool above = e->surrogate->side == CANOPY_ABOVE;
    result->height_min = fmin(result->height_min, above ? height_min : -height_max);
    result->height_max = fmax(result->height_max, above ? height_max : -height_min);
    if (e->ordinary && lowest >= 0.0) {
        result->margin = fmin(result->margin, lowest);
        return;
    }
    for (size_t p = 0; p < b->count; p++) {
        const double floor = b->surface[p] - b->q[2][p] - b->slack[p];
        if (e->ordinary && floor >= 0.0) {
            result->margin = fmin(result->margin, floor);
        } else {
            decide(e, cloud, first, before, b, p, result);
        }
    }
}

/// Heights of the block's points that are inside; the others keep what is there.
static void write_heights(const struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first,
                          const struct block *b, double *heights) {
    const struct canopy_surrogate *s = e->surrogate;
    for (size_t p = 0; p < b->count; p++) {
        const double height = s->side == CANOPY_ABOVE ? b->surface[p] : -b->surface[p];
        int cell[2] = {b->hu[p], b->hv[p]};
        const double off = fmin(fmin(b->s[p], 1.0 - b->s[p]), fmin(b->t[p], 1.0 - b->t[p]));
        if (s->trim && off < 1e-9) {
            double point[3];
            load_point(cloud, first + b->origin[p], point);
            canopy_rational_inside(e->rational, point, cell);
        }
        if (!s->trim || s->trim[(size_t)cell[0] * (s->size[1] - 1) + (size_t)cell[1]]) {
            heights[b->origin[p]] = height;
        }
    }
}

/// Marks the cells of the block's points, and those across an edge that is very close.
static void mark_cells(const struct canopy_exact *e, const struct block *b, uint8_t *covered) {
    const int rows = (int)e->surrogate->size[0] - 1;
    const int columns = (int)e->surrogate->size[1] - 1;
    for (size_t p = 0; p < b->count; p++) {
        const int u0 = clamp(b->hu[p] - (b->s[p] < 1e-9), rows);
        const int u1 = clamp(b->hu[p] + (b->s[p] > 1.0 - 1e-9), rows);
        const int v0 = clamp(b->hv[p] - (b->t[p] < 1e-9), columns);
        const int v1 = clamp(b->hv[p] + (b->t[p] > 1.0 - 1e-9), columns);
        for (int u = u0; u <= u1; u++) {
            for (int v = v0; v <= v1; v++) {
                covered[(size_t)u * (size_t)columns + (size_t)v] = 1;
            }
        }
    }
}

/// What is wanted of a block: heights if `heights` is set, cells if `covered` is, else a verdict.
struct purpose {
    struct canopy_exact_result *result;
    double *heights;
    uint8_t *covered;
};

/// A whole block of memory, of which the first `count` points are meant.
static void add_block(struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first, size_t count,
                      uint64_t before, const struct purpose *purpose) {
    struct block b;
    b.count = count;
    if (e->aligned) {
        load_aligned(e, cloud, first, &b);
    } else {
        load_turned(e, cloud, first, &b);
    }
    find_cell(e, 0, b.q[0], b.hu, b.s);
    find_cell(e, 1, b.q[1], b.hv, b.t);
    for (size_t p = 0; p < BLOCK; p++) {
        b.origin[p] = (uint32_t)p;
    }
    if (count_doubtful(e, &b) > 0) {
        keep_inside(e, cloud, first, before, &b, purpose->result);
    }
    if (purpose->covered) {
        mark_cells(e, &b, purpose->covered);
        return;
    }
    evaluate(e, &b);
    if (e->surrogate->window_count > 0) {
        add_windows(e, &b);
    }
    if (purpose->heights) {
        write_heights(e, cloud, first, &b, purpose->heights + before + first);
    } else if (b.count > 0) {
        if (!e->aligned) {
            add_turned_slack(e, &b);
        }
        judge(e, cloud, first, before, &b, purpose->result);
    }
}

/// The last points, filled up with copies to a whole block.
static void add_rest(struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first, uint64_t before,
                     const struct purpose *purpose) {
    union {
        float f32[3][BLOCK];
        int32_t fx[3][BLOCK];
    } copy;
    const size_t count = cloud->count - first;
    for (int k = 0; k < 3; k++) {
        for (size_t p = 0; p < BLOCK; p++) {
            const size_t at = (first + (p < count ? p : count - 1)) * cloud->stride;
            if (cloud->scalar == CANOPY_F32) {
                copy.f32[k][p] = ((const float *)cloud->axis[k])[at];
            } else {
                copy.fx[k][p] = ((const int32_t *)cloud->axis[k])[at];
            }
        }
    }
    const struct canopy_cloud rest = {
        .scalar = cloud->scalar, .count = count, .stride = 1, .axis = {copy.fx[0], copy.fx[1], copy.fx[2]}};
    add_block(e, &rest, 0, count, before + first, purpose);
}

static void add(struct canopy_exact *e, const struct canopy_cloud *cloud, const struct purpose *purpose) {
    const uint64_t before = purpose->result->points;
    size_t first = 0;
    for (; first + BLOCK <= cloud->count; first += BLOCK) {
        add_block(e, cloud, first, BLOCK, before, purpose);
    }
    if (first < cloud->count) {
        add_rest(e, cloud, first, before, purpose);
    }
    purpose->result->points += cloud->count;
}

void canopy_exact_add(struct canopy_exact *exact, const struct canopy_cloud *cloud,
                      struct canopy_exact_result *result) {
    add(exact, cloud, &(struct purpose){.result = result});
}

void canopy_exact_heights(struct canopy_exact *exact, const struct canopy_cloud *cloud, double *heights) {
    for (size_t i = 0; i < cloud->count; i++) {
        heights[i] = nan("");
    }
    struct canopy_exact_result unused = canopy_exact_begin();
    add(exact, cloud, &(struct purpose){.result = &unused, .heights = heights});
}

void canopy_exact_coverage(struct canopy_exact *exact, const struct canopy_cloud *cloud, uint8_t *covered) {
    struct canopy_exact_result unused = canopy_exact_begin();
    add(exact, cloud, &(struct purpose){.result = &unused, .covered = covered});
}

bool canopy_exact_check(const struct canopy_surrogate *surrogate, const struct canopy_cloud *cloud,
                        struct canopy_exact_result *result) {
    struct canopy_exact *exact = canopy_exact_open(surrogate);
    if (!exact) {
        return false;
    }
    *result = canopy_exact_begin();
    canopy_exact_add(exact, cloud, result);
    canopy_exact_close(exact);
    return true;
}

static double height_range(const struct canopy_exact_result *result) {
    const double range = result->height_max - result->height_min;
    return range > 0.0 ? range : 1.0;
}

double canopy_exact_mean_gap(const struct canopy_exact_result *result) {
    const uint64_t inside = result->points - result->outside;
    return inside ? 100.0 * result->gap_sum / (double)inside / height_range(result) : 0.0;
}

double canopy_exact_max_gap(const struct canopy_exact_result *result) {
    return result->points > result->outside ? 100.0 * result->gap_max / height_range(result) : 0.0;
}
