#include "lib/num/cholesky.h"

#include <math.h>
#include <stdbool.h>

#include "lib/num/fma_f32.h"

#define LANES 8
#define TILE_LANES 4
#define PIVOT_LEAST 3e-7f  // of its own diagonal: below that rounding has eaten it

// Sums in lanes, so that it does not depend on the machine's vectors. Each lane a variable of its own, and the pointers
// advance: compilers then keep all of it in registers.
static float dot(const float *restrict a, const float *restrict b, size_t count) {
    float s0 = 0, s1 = 0, s2 = 0, s3 = 0, s4 = 0, s5 = 0, s6 = 0, s7 = 0;
    for (; count >= LANES; count -= LANES, a += LANES, b += LANES) {
        s0 = canopy_add_product_f32(s0, a[0], b[0]);
        s1 = canopy_add_product_f32(s1, a[1], b[1]);
        s2 = canopy_add_product_f32(s2, a[2], b[2]);
        s3 = canopy_add_product_f32(s3, a[3], b[3]);
        s4 = canopy_add_product_f32(s4, a[4], b[4]);
        s5 = canopy_add_product_f32(s5, a[5], b[5]);
        s6 = canopy_add_product_f32(s6, a[6], b[6]);
        s7 = canopy_add_product_f32(s7, a[7], b[7]);
    }
    float sum = ((s0 + s4) + (s1 + s5)) + ((s2 + s6) + (s3 + s7));
    for (; count > 0; count--) {
        sum = canopy_add_product_f32(sum, *a++, *b++);
    }
    return sum;
}

static void subtract(float *restrict to, const float *restrict row, float factor, size_t count) {
    for (; count >= LANES; count -= LANES, to += LANES, row += LANES) {
        for (int l = 0; l < LANES; l++) {
            to[l] = canopy_add_product_f32(to[l], -factor, row[l]);
        }
    }
    for (; count > 0; count--) {
        *to = canopy_add_product_f32(*to, -factor, *row++);
        to++;
    }
}

// Products of two rows with two others: every number that is read serves twice, in a lane of each of four sums.
struct tile {
    float aa, ab, ba, bb;  // first with first, first with second …
};

#define ADD_LANE(l)                                                                                                    \
    do {                                                                                                               \
        const float a = a0[l], b = a1[l], c = b0[l], d = b1[l];                                                        \
        aa##l = canopy_add_product_f32(aa##l, a, c);                                                                   \
        ab##l = canopy_add_product_f32(ab##l, a, d);                                                                   \
        ba##l = canopy_add_product_f32(ba##l, b, c);                                                                   \
        bb##l = canopy_add_product_f32(bb##l, b, d);                                                                   \
    } while (0)

static struct tile dot_tile(const float *restrict a0, const float *restrict a1, const float *restrict b0,
                            const float *restrict b1, size_t count) {
    float aa0 = 0, aa1 = 0, aa2 = 0, aa3 = 0, ab0 = 0, ab1 = 0, ab2 = 0, ab3 = 0;
    float ba0 = 0, ba1 = 0, ba2 = 0, ba3 = 0, bb0 = 0, bb1 = 0, bb2 = 0, bb3 = 0;
    for (; count >= TILE_LANES; count -= TILE_LANES) {
        ADD_LANE(0);
        ADD_LANE(1);
        ADD_LANE(2);
        ADD_LANE(3);
        a0 += TILE_LANES;
        a1 += TILE_LANES;
        b0 += TILE_LANES;
        b1 += TILE_LANES;
    }
    for (; count > 0; count--) {
        ADD_LANE(0);
        a0++;
        a1++;
        b0++;
        b1++;
    }
    return (struct tile){(aa0 + aa2) + (aa1 + aa3), (ab0 + ab2) + (ab1 + ab3), (ba0 + ba2) + (ba1 + ba3),
                         (bb0 + bb2) + (bb1 + bb3)};
}

// The part of a band matrix that is being factorised.
struct band {
    float *matrix;
    size_t stride;
    uint32_t width;
};

static inline float *entry(const struct band *m, uint32_t i, uint32_t j) {
    return m->matrix + i * m->stride + (m->width - (i - j));
}

static inline uint32_t start_of(const struct band *m, uint32_t i) { return i > m->width ? i - m->width : 0; }

// Entry (i, j) of the factor; `from` is where row i begins, or that behind what has been taken off already.
static inline void factor_entry(const struct band *m, uint32_t i, uint32_t j, uint32_t from) {
    float *it = entry(m, i, j);
    *it = (*it - dot(entry(m, i, from), entry(m, j, from), j - from)) * *entry(m, j, j);
}

static void factor_diagonal(const struct band *m, uint32_t i, float diagonal) {
    const uint32_t start = start_of(m, i);
    const float *begin = entry(m, i, start);
    const float pivot = diagonal - dot(begin, begin, i - start);
    *entry(m, i, i) = pivot > PIVOT_LEAST * diagonal ? 1.0f / sqrtf(pivot) : 0.0f;  // the inverse is kept
}

static void factor_row(const struct band *m, uint32_t i) {
    const uint32_t start = start_of(m, i);
    for (uint32_t j = start; j < i; j++) {
        factor_entry(m, i, j, start);
    }
    factor_diagonal(m, i, *entry(m, i, i));
}

// Rows i and i + 1 by columns j and j + 1, of which j + 1 <= i.
static void factor_tile(const struct band *m, uint32_t i, uint32_t j, uint32_t start, uint32_t next) {
    struct tile sum =
        dot_tile(entry(m, i, next), entry(m, i + 1, next), entry(m, j, next), entry(m, j + 1, next), j - next);
    if (start < next) {  // row i begins a column earlier
        const float first = *entry(m, i, start);
        sum.aa = canopy_add_product_f32(sum.aa, first, *entry(m, j, start));
        sum.ab = canopy_add_product_f32(sum.ab, first, *entry(m, j + 1, start));
    }
    float *up = entry(m, i, j), *down = entry(m, i + 1, j);
    const float left = *entry(m, j, j), right = *entry(m, j + 1, j + 1), beside = *entry(m, j + 1, j);
    up[0] = (up[0] - sum.aa) * left;
    down[0] = (down[0] - sum.ba) * left;
    up[1] = (up[1] - canopy_add_product_f32(sum.ab, up[0], beside)) * right;
    down[1] = (down[1] - canopy_add_product_f32(sum.bb, down[0], beside)) * right;
}

static void factor_two_rows(const struct band *m, uint32_t i) {
    const uint32_t start = start_of(m, i), next = start_of(m, i + 1);
    uint32_t j = start;
    for (; j < next; j++) {
        factor_entry(m, i, j, start);
    }
    for (; j + 1 < i; j += 2) {
        factor_tile(m, i, j, start, next);
    }
    for (; j < i; j++) {
        factor_entry(m, i, j, start);
        factor_entry(m, i + 1, j, next);
    }
    factor_diagonal(m, i, *entry(m, i, i));
    factor_entry(m, i + 1, i, next);
    factor_diagonal(m, i + 1, *entry(m, i + 1, i + 1));
}

void canopy_cholesky_factor_f32(float *matrix, size_t stride, uint32_t from, uint32_t to) {
    const struct band m = {matrix, stride, (uint32_t)stride - 1};
    uint32_t i = from;
    for (; i + 1 < to; i += 2) {
        factor_two_rows(&m, i);
    }
    if (i < to) {
        factor_row(&m, i);
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
