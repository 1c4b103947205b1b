/// Cholesky factor of a symmetric positive definite band matrix, in place, a few rows at a time.
///
/// Of each row the matrix holds what is left of the diagonal, and that: `stride` floats, which is the half-bandwidth
/// and one. Entry (i, j), j <= i, is matrix[i * stride + stride - 1 - (i - j)]; entries that would reach in front of
/// the first column are not read. For bicubic B-splines on a grid with n columns, rows in order, stride is 3 n + 4.
///
/// There is no pivoting. A pivot that rounding has eaten takes its unknown out: the solution is 0 there. Sums go in
/// lanes in a fixed order, so that results do not depend on the machine's vectors (on whether it adds products in one
/// instruction they do: lib/num/fma_f32.h).
#ifndef CANOPY_NUM_CHOLESKY_H
#define CANOPY_NUM_CHOLESKY_H

#include <stddef.h>
#include <stdint.h>

/// Replaces rows from … to - 1 by those of the factor, its diagonal inverted; those before must be the factor's
/// already. Cost: stride^2 / 2 products a row.
void canopy_cholesky_factor_f32(float *matrix, size_t stride, uint32_t from, uint32_t to);

/// Solves for `rhs`, of `count` rows, in place, where the factor stands. Cost: 2 stride products a row.
void canopy_cholesky_solve_f32(const float *matrix, size_t stride, uint32_t count, float *rhs);

/// A piece of the same: steps from … to - 1 of 2 count, the first half down the factor, the second back up.
void canopy_cholesky_solve_rows_f32(const float *matrix, size_t stride, uint32_t count, float *rhs, uint32_t from,
                                    uint32_t to);

#endif
