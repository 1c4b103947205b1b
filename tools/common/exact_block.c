// Points to knot cells and local parameters, and which of them are inside the frame.

#include <math.h>

#include "tools/common/exact_parts.h"

/// to[] = (p - origin) * sign for one coordinate of CANOPY_EXACT_BLOCK points.
static void load_coordinate(const struct canopy_cloud *cloud, int k, size_t first, double origin, double sign,
                            double *restrict to) {
    const size_t stride = cloud->stride;
    if (cloud->scalar == CANOPY_F32) {
        const float *from = (const float *)cloud->axis[k] + first * stride;
        for (size_t i = 0; i < CANOPY_EXACT_BLOCK; i++) {
            to[i] = ((double)from[i * stride] - origin) * sign;
        }
    } else {
        const int32_t *from = (const int32_t *)cloud->axis[k] + first * stride;
        for (size_t i = 0; i < CANOPY_EXACT_BLOCK; i++) {
            to[i] = ((double)from[i * stride] - origin) * sign;
        }
    }
}

static void load_aligned(const struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first,
                         struct canopy_exact_block *b) {
    const double side = e->surrogate->side == CANOPY_ABOVE ? 1.0 : -1.0;
    for (int i = 0; i < 3; i++) {
        const int k = e->coordinate[i];
        load_coordinate(cloud, k, first, e->surrogate->origin[k], i == 2 ? side * e->sign[i] : e->sign[i], b->q[i]);
    }
}

static void load_turned(const struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first,
                        struct canopy_exact_block *b) {
    double d[3][CANOPY_EXACT_BLOCK];
    for (int k = 0; k < 3; k++) {
        load_coordinate(cloud, k, first, e->surrogate->origin[k], 1.0, d[k]);
    }
    const double side = e->surrogate->side == CANOPY_ABOVE ? 1.0 : -1.0;
    for (int i = 0; i < 3; i++) {
        const double sign = i == 2 ? side : 1.0;
        const double *axis = e->surrogate->axes[i];
        for (size_t p = 0; p < CANOPY_EXACT_BLOCK; p++) {
            b->q[i][p] = sign * (axis[0] * d[0][p] + axis[1] * d[1][p] + axis[2] * d[2][p]);
        }
    }
    for (size_t p = 0; p < CANOPY_EXACT_BLOCK; p++) {
        b->g[p] = fabs(d[0][p]) + fabs(d[1][p]) + fabs(d[2][p]);
    }
}

/// Cell and local parameter along one direction. Arguments outside (or NaN) land in a cell all the same: such points
/// are sorted out by `drop_outside`.
static void find_cell(const struct canopy_exact *e, int i, const double *restrict q, int32_t *restrict h,
                      double *restrict local) {
    const double inverse = e->inverse[i];
    const double most = (double)e->surrogate->size[i] - 1.0;
    const int32_t last = (int32_t)e->surrogate->size[i] - 2;
    for (size_t p = 0; p < CANOPY_EXACT_BLOCK; p++) {
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
static bool clearly_inside(const struct canopy_exact *e, const struct canopy_exact_block *b, size_t p, int i) {
    const double q = b->q[i][p];
    if (e->aligned) {
        return q >= 0.0 && (e->limit_exact[i] ? q < e->limit[i] : q < e->limit[i] * (1.0 - 4.0 * CANOPY_EXACT_EPSILON));
    }
    const double room = 8.0 * CANOPY_EXACT_EPSILON * b->g[p] + 4.0 * CANOPY_EXACT_EPSILON * e->limit[i];
    return q > room && q < e->limit[i] - room;
}

/// On the far edge exactly.
static bool on_far_edge(const struct canopy_exact *e, const struct canopy_exact_block *b, size_t p, int i,
                        const double point[3]) {
    const int k = e->coordinate[i];
    return e->aligned && e->limit_exact[i] && b->q[i][p] == e->limit[i] &&
           canopy_exact_subtracts(point[k], e->surrogate->origin[k]);
}

static bool is_inside(const struct canopy_exact *e, const struct canopy_exact_block *b, size_t p,
                      const double point[3]) {
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
static size_t count_doubtful(const struct canopy_exact *e, const struct canopy_exact_block *b) {
    size_t doubtful = 0;
    if (!e->ordinary) {
        return CANOPY_EXACT_BLOCK;
    }
    if (e->aligned) {
        const double far[2] = {e->limit_exact[0] ? e->limit[0] : e->limit[0] * (1.0 - 4.0 * CANOPY_EXACT_EPSILON),
                               e->limit_exact[1] ? e->limit[1] : e->limit[1] * (1.0 - 4.0 * CANOPY_EXACT_EPSILON)};
        for (size_t p = 0; p < CANOPY_EXACT_BLOCK; p++) {
            doubtful += !((b->q[0][p] >= 0.0) & (b->q[0][p] < far[0]) & (b->q[1][p] >= 0.0) & (b->q[1][p] < far[1]));
        }
        return doubtful;
    }
    for (size_t p = 0; p < CANOPY_EXACT_BLOCK; p++) {
        doubtful += !(clearly_inside(e, b, p, 0) && clearly_inside(e, b, p, 1));
    }
    return doubtful;
}

/// Counts what is outside and moves the rest together.
static void drop_outside(const struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first, uint64_t before,
                         struct canopy_exact_block *b, struct canopy_exact_result *result) {
    size_t kept = 0;
    for (size_t p = 0; p < b->count; p++) {
        double point[3];
        canopy_exact_point(cloud, first + p, point);
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

void canopy_exact_load(const struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first,
                       struct canopy_exact_block *b) {
    if (e->aligned) {
        load_aligned(e, cloud, first, b);
    } else {
        load_turned(e, cloud, first, b);
    }
    find_cell(e, 0, b->q[0], b->hu, b->s);
    find_cell(e, 1, b->q[1], b->hv, b->t);
    for (size_t p = 0; p < CANOPY_EXACT_BLOCK; p++) {
        b->origin[p] = (uint32_t)p;
    }
}

void canopy_exact_keep_inside(const struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first,
                              uint64_t before, struct canopy_exact_block *b, struct canopy_exact_result *result) {
    if (count_doubtful(e, b) > 0) {
        drop_outside(e, cloud, first, before, b, result);
    }
}
