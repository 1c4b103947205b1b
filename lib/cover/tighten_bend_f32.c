// The free coefficients: bent as little as possible beside the others.

#include <string.h>

#include "lib/cover/tighten_f32.h"

#define RIDGE 1e-5f  // where nothing holds a plane

// Adds one second difference of coefficients, squared, to the energy: what is free to the matrix, what is not to `rhs`.
static void add_difference(struct canopy_tighten *t, const uint32_t index[4], const float weight[4]) {
    const size_t stride = CANOPY_TIGHTEN_BAND(t->frame.size[1]);
    for (int p = 0; p < 4; p++) {
        const uint32_t i = index[p];
        for (int q = 0; q < 4 && !t->seen[i]; q++) {
            const uint32_t j = index[q];
            const float product = weight[p] * weight[q];
            if (t->seen[j]) {
                t->step[i] -= product * t->x[j];
            } else if (j <= i) {
                t->matrix[i * stride + (stride - 1) - (i - j)] += product;
            }
        }
    }
}

static inline uint32_t clamped(uint32_t i, uint32_t by, uint32_t size) {  // i + by - 1, ends repeated
    const uint32_t j = i + by > 0 ? i + by - 1 : 0;
    return j < size ? j : size - 1;
}

void canopy_tighten_begin_bend(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    memset(t->step, 0, 4 * count);
    bool any = false;
    for (size_t j = 0; j < count; j++) {
        t->x[j] = canopy_tighten_height(t, t->b[j]);
        any = any || !t->seen[j];
    }
    canopy_tighten_go(t, any ? CANOPY_TIGHTEN_BEND_CLEAR : CANOPY_TIGHTEN_DONE);
}

static void bend_at(struct canopy_tighten *t, uint32_t i) {
    static const float second[4] = {1, -2, 1, 0};
    static const float mixed[4] = {1.4142136f, -1.4142136f, -1.4142136f, 1.4142136f};
    const uint32_t m = t->frame.size[0], n = t->frame.size[1], before = clamped(i, 0, m) * n,
                   after = clamped(i, 2, m) * n;
    for (uint32_t j = 0; j < n; j++) {
        const uint32_t here = i * n + j, left = clamped(j, 0, n), right = clamped(j, 2, n);
        const uint32_t u[4] = {before + j, here, after + j, here};
        const uint32_t v[4] = {i * n + left, here, i * n + right, here};
        const uint32_t uv[4] = {here, i * n + right, after + j, after + right};
        add_difference(t, u, second);
        add_difference(t, v, second);
        add_difference(t, uv, mixed);
    }
}

// What makes it regular.
static void finish_energy(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t), stride = CANOPY_TIGHTEN_BAND(t->frame.size[1]);
    for (size_t j = 0; j < count; j++) {
        t->matrix[j * stride + (stride - 1)] += t->seen[j] ? 1.0f : RIDGE;
        t->step[j] = t->seen[j] ? 0.0f : t->step[j] + RIDGE * t->x[j];
    }
}

void canopy_tighten_bend_row(struct canopy_tighten *t) {
    bend_at(t, t->at);
    if (++t->at == t->frame.size[0]) {
        finish_energy(t);
        canopy_tighten_go(t, CANOPY_TIGHTEN_BEND_FACTOR);
    }
}

void canopy_tighten_finish_bend(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        if (!t->seen[j]) {
            const float x = smaller(larger(t->step[j], CANOPY_TIGHTEN_FLOOR), CANOPY_TIGHTEN_CEILING);
            t->b[j] = t->low + (int32_t)(x * t->range);
        }
    }
    t->stage = CANOPY_TIGHTEN_DONE;
}
