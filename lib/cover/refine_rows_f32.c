// A constraint's row of the matrix: what it has in sight, weights, products.

#include "lib/cover/refine_f32.h"

struct canopy_refine_sight canopy_refine_sight_of(const struct canopy_refine *r, uint32_t cell) {
    const uint32_t at[2] = {cell / canopy_refine_across(r), cell % canopy_refine_across(r)};
    uint32_t first[2], count[2];
    struct canopy_refine_sight sight;
    for (int a = 0; a < 2; a++) {
        const uint32_t size = r->window.size[a], end = at[a] + 1 < size ? at[a] + 1 : size;
        first[a] = at[a] > 3 ? at[a] - 3 : 0;
        count[a] = end - first[a];
        sight.skip[a] = first[a] + 3 - at[a];
    }
    sight.i = first[0];
    sight.j = first[1];
    sight.rows = count[0];
    sight.columns = count[1];
    return sight;
}

// The weights of Bernstein coefficient p, in sixths.
static const float pits[4][4] = {{1, 4, 1, 0}, {0, 4, 2, 0}, {0, 2, 4, 0}, {0, 1, 4, 1}};

void canopy_refine_axis_weights(float s, float w[4]) {
    if (s >= 0) {
        canopy_basis_f32(s, w, NULL);
        return;
    }
    const float *sixths = pits[(int)(-1 - s)];
    for (int a = 0; a < 4; a++) {
        w[a] = sixths[a] * (1.0f / 6.0f);
    }
}

struct canopy_refine_weights canopy_refine_weights_of(const struct canopy_refine *r,
                                                      const struct canopy_refine_row *row) {
    struct canopy_refine_weights w = {.sight = canopy_refine_sight_of(r, row->cell)};
    float u[4], v[4], sum_u = 0, sum_v = 0;
    canopy_refine_axis_weights(row->s, u);
    canopy_refine_axis_weights(row->t, v);
    for (uint32_t a = 0; a < w.sight.rows; a++) {
        w.u[a] = u[w.sight.skip[0] + a];
        sum_u += w.u[a];
    }
    for (uint32_t e = 0; e < w.sight.columns; e++) {
        w.v[e] = v[w.sight.skip[1] + e];
        sum_v += w.v[e];
    }
    w.sum = sum_u * sum_v;
    const float scale = w.sum > CANOPY_REFINE_NO_WEIGHT ? 1.0f / w.sum : 0.0f;
    for (uint32_t e = 0; e < w.sight.columns; e++) {
        w.v[e] *= scale;
    }
    return w;
}

float canopy_refine_times(const struct canopy_refine *r, const struct canopy_refine_weights *w, const float *x) {
    const uint32_t n = r->window.size[1];
    float sum = 0;
    for (uint32_t a = 0; a < w->sight.rows; a++) {
        const float *row = x + (size_t)(w->sight.i + a) * n + w->sight.j;
        float inner = 0;
        for (uint32_t e = 0; e < w->sight.columns; e++) {
            inner += w->v[e] * row[e];
        }
        sum += w->u[a] * inner;
    }
    return sum;
}

void canopy_refine_add_weights(const struct canopy_refine *r, const struct canopy_refine_weights *w, float factor,
                               float *to) {
    const uint32_t n = r->window.size[1];
    for (uint32_t a = 0; a < w->sight.rows; a++) {
        float *row = to + (size_t)(w->sight.i + a) * n + w->sight.j;
        const float here = factor * w->u[a];
        for (uint32_t e = 0; e < w->sight.columns; e++) {
            row[e] += here * w->v[e];
        }
    }
}

void canopy_refine_add_square(const struct canopy_refine *r, const struct canopy_refine_weights *w, float factor) {
    const size_t n = r->window.size[1], stride = CANOPY_REFINE_BAND(n);
    for (uint32_t a = 0; a < w->sight.rows; a++) {
        for (uint32_t e = 0; e < w->sight.columns; e++) {
            const size_t i = (w->sight.i + a) * n + w->sight.j + e;
            const float here = factor * w->u[a] * w->v[e];
            for (uint32_t k = 0; k <= a; k++) {
                const uint32_t end = k == a ? e + 1 : w->sight.columns;
                const float by = here * w->u[k];
                float *band = r->matrix + i * stride + (stride - 1) - (a - k) * n - e;
                for (uint32_t l = 0; l < end; l++) {
                    band[l] += by * w->v[l];
                }
            }
        }
    }
}
