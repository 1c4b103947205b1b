/// Solver for the pentadiagonal systems of one spline line, in place, without pivoting.
///
/// Row i reads  a[0] x[i-2] + a[1] x[i-1] + a[2] x[i] + a[3] x[i+1] + a[4] x[i+2] = value.  Entries that would reach
/// outside the line must be 0. Entries are at most 4 in size, values at most 2^24 (float) or 2^22 (fixed point).
///
/// Elimination keeps every pivot at 1, so a row costs one reciprocal and eleven products. There is no pivoting:
/// where a pivot falls below 1/32, where an entry grows beyond 64 or a value out of its format, the solver says so and
/// gives up. Paper S0's rows next to j + 1/2 make such matrices; their solutions are of no use (cover.md 2).
///
/// Both scalars stand in one program: rows and results are of type float (_f32) or int32_t (_fx).
#ifndef CANOPY_NUM_BAND_H
#define CANOPY_NUM_BAND_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct canopy_band_row_f32 {
    float a[5];   ///< entries of columns i-2 to i+2
    float value;  ///< right-hand side, replaced by x[i]
};

struct canopy_band_row_fx {
    int32_t a[5];   ///< entries in Q24
    int32_t value;  ///< right-hand side in whole steps, replaced by x[i]
};

/// Solves `count` >= 1 rows; x[i] is left in rows[i].value. False: close to singular, or out of range; the rows are
/// then spoilt. Fixed point is accurate to about 2^-20 of the largest value that turns up, times the condition.
bool canopy_band_solve_f32(struct canopy_band_row_f32 *rows, size_t count);
bool canopy_band_solve_fx(struct canopy_band_row_fx *rows, size_t count);

#endif
