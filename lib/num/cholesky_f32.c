#include "lib/num/cholesky.h"

#include <math.h>
#include <stdbool.h>

#define LANES 8
#define PIVOT_LEAST 3e-7f  // of its own diagonal: below that rounding has eaten it

// Sums in lanes, so that it does not depend on the machine's vectors. Each lane a variable of its own, and the pointers
// advance: compilers then keep all of it in registers.
static float dot(const float *restrict a, const float *restrict b, size_t count) {
    float s0 = 0, s1 = 0, s2 = 0, s3 = 0, s4 = 0, s5 = 0, s6 = 0, s7 = 0;
    for (; count >= LANES; count -= LANES, a += LANES, b += LANES) {
        s0 += a[0] * b[0];
        s1 += a[1] * b[1];
        s2 += a[2] * b[2];
        s3 += a[3] * b[3];
        s4 += a[4] * b[4];
        s5 += a[5] * b[5];
        s6 += a[6] * b[6];
        s7 += a[7] * b[7];
    }
    float sum = ((s0 + s4) + (s1 + s5)) + ((s2 + s6) + (s3 + s7));
    for (; count > 0; count--) {
        sum += *a++ * *b++;
    }
    return sum;
}

static void subtract(float *restrict to, const float *restrict row, float factor, size_t count) {
    for (; count >= LANES; count -= LANES, to += LANES, row += LANES) {
        for (int l = 0; l < LANES; l++) {
            to[l] -= factor * row[l];
        }
    }
    for (; count > 0; count--) {
        *to++ -= factor * *row++;
    }
}

void canopy_cholesky_factor_f32(float *matrix, size_t stride, uint32_t from, uint32_t to) {
    const uint32_t width = (uint32_t)stride - 1;
    for (uint32_t i = from; i < to; i++) {
        float *row = matrix + i * stride;
        const uint32_t start = i > width ? i - width : 0;
        const float *begin = row + (width - (i - start));
        const float diagonal = row[width];
        for (uint32_t j = start; j < i; j++) {
            const float *other = matrix + j * stride;
            const float sum = dot(begin, other + (width - (j - start)), j - start);
            row[width - (i - j)] = (row[width - (i - j)] - sum) * other[width];
        }
        const float pivot = diagonal - dot(begin, begin, i - start);
        row[width] = pivot > PIVOT_LEAST * diagonal ? 1.0f / sqrtf(pivot) : 0.0f;  // the inverse is kept
    }
}

// Row `at` of the first half, which goes down the factor, or of the second, which comes back up.
void canopy_cholesky_solve_rows_f32(const float *matrix, size_t stride, uint32_t count, float *rhs, uint32_t from,
                                    uint32_t to) {
    const uint32_t width = (uint32_t)stride - 1;
    for (uint32_t at = from; at < to; at++) {
        const bool down = at < count;
        const uint32_t i = down ? at : 2 * count - 1 - at;
        const float *row = matrix + i * stride;
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

void canopy_cholesky_solve_f32(const float *matrix, size_t stride, uint32_t count, float *rhs) {
    canopy_cholesky_solve_rows_f32(matrix, stride, count, rhs, 0, 2 * count);
}
