#include <math.h>

#include "lib/cover/tighten_f32.h"

#define PIVOT_LEAST 3e-7f  // of its own diagonal: below that rounding has eaten it

// Sums in lanes, so that it does not depend on the machine's vectors.
static float dot(const float *restrict a, const float *restrict b, uint32_t count) {
    float lanes[LANES] = {0};
    uint32_t k = 0;
    for (; k + LANES <= count; k += LANES) {
        for (uint32_t l = 0; l < LANES; l++) {
            lanes[l] += a[k + l] * b[k + l];
        }
    }
    float sum = ((lanes[0] + lanes[4]) + (lanes[1] + lanes[5])) + ((lanes[2] + lanes[6]) + (lanes[3] + lanes[7]));
    for (; k < count; k++) {
        sum += a[k] * b[k];
    }
    return sum;
}

static void subtract(float *restrict to, const float *restrict row, float factor, uint32_t count) {
    uint32_t k = 0;
    for (; k + LANES <= count; k += LANES) {
        for (uint32_t l = 0; l < LANES; l++) {
            to[k + l] -= factor * row[k + l];
        }
    }
    for (; k < count; k++) {
        to[k] -= factor * row[k];
    }
}

void canopy_tighten_factor(float *matrix, uint32_t n, uint32_t from, uint32_t to) {
    const uint32_t stride = (uint32_t)CANOPY_TIGHTEN_BAND(n), width = stride - 1;
    for (uint32_t i = from; i < to; i++) {
        float *row = matrix + (size_t)i * stride;
        const uint32_t start = i > width ? i - width : 0;
        const float *begin = row + (width - (i - start));
        const float diagonal = row[width];
        for (uint32_t j = start; j < i; j++) {
            const float *other = matrix + (size_t)j * stride;
            const float sum = dot(begin, other + (width - (j - start)), j - start);
            row[width - (i - j)] = (row[width - (i - j)] - sum) * other[width];
        }
        const float pivot = diagonal - dot(begin, begin, i - start);
        row[width] = pivot > PIVOT_LEAST * diagonal ? 1.0f / sqrtf(pivot) : 0.0f;  // the inverse is kept
    }
}

// Row `at` of the first half, which goes down the factor, or of the second, which comes back up.
void canopy_tighten_solve_rows(const float *matrix, uint32_t n, uint32_t count, float *rhs, uint32_t from,
                               uint32_t to) {
    const uint32_t stride = (uint32_t)CANOPY_TIGHTEN_BAND(n), width = stride - 1;
    for (uint32_t at = from; at < to; at++) {
        const bool down = at < count;
        const uint32_t i = down ? at : 2 * count - 1 - at;
        const float *row = matrix + (size_t)i * stride;
        const uint32_t start = i > width ? i - width : 0;
        const float *begin = row + (width - (i - start));
        if (down) {
            rhs[i] = (rhs[i] - dot(begin, rhs + start, i - start)) * row[width];
        } else {
            rhs[i] *= row[width];
            subtract(rhs + start, begin, rhs[i], i - start);
        }
    }
}

void canopy_tighten_solve(const float *matrix, uint32_t n, uint32_t count, float *rhs) {
    canopy_tighten_solve_rows(matrix, n, count, rhs, 0, 2 * count);
}
