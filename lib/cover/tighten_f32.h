/// Inside lib/cover/tighten: what its files share. Not for others.
#ifndef CANOPY_COVER_TIGHTEN_F32_H
#define CANOPY_COVER_TIGHTEN_F32_H

#include <stddef.h>
#include <stdint.h>

#include "lib/cover/tighten.h"

// The program's unit is the range of heights, its zero the lowest. Coefficients stay within the reach.
#define CANOPY_TIGHTEN_FLOOR -1.0f
#define CANOPY_TIGHTEN_CEILING 2.0f
#define CANOPY_TIGHTEN_NONE -8.0f   // the bound of a constraint that is none; below all others
#define CANOPY_TIGHTEN_LEAST 1e-8f  // least slack: what rounding may take from a slack that is positive in truth

// How far a surface evaluated here may be from the true one, coefficients within +-2.5 (else in proportion). Per axis:
// coefficients to floats 3 roundings, to Bernstein form 6, weights from s 4, the sum 8; times two axes less what they
// share, under 40 roundings of 2^-24 * 2.5: 100. A point's place is off by 3 * 2^-24 per axis, times a slope of up to
// 5: 30; z is rounded by 2. Together under 2^-16, with twice as much to spare below that.
#define CANOPY_TIGHTEN_ERROR 0x1p-16f
#define CANOPY_TIGHTEN_ERROR_REACH 2.5f

static inline size_t canopy_tighten_coefficients(const struct canopy_tighten *t) {
    return (size_t)t->frame.size[0] * t->frame.size[1];
}

// The matrix, in tighten_band_f32.c. Rows in order; a pivot that rounding has eaten takes its unknown out.
void canopy_tighten_factor(float *matrix, uint32_t n, uint32_t from, uint32_t to);
void canopy_tighten_solve(const float *matrix, uint32_t n, uint32_t count, float *rhs);

// The passes, in tighten_rows_f32.c, each over one row of knot cells.
enum canopy_tighten_pass {
    CANOPY_TIGHTEN_PASS_SLACKS,   // slacks of x; sums[0]: sum of 1/slack; most[0]: largest 1/slack
    CANOPY_TIGHTEN_PASS_MEASURE,  // duals stepped, slacks of x, the matrix; comp; g[0]: A'y
    CANOPY_TIGHTEN_PASS_AFFINE,   // `affine`: sums of the products, steps, g[0]: A'(1/s), g[1]: A'(target/s)
    CANOPY_TIGHTEN_PASS_STEP,     // `step`: directions and steps
    CANOPY_TIGHTEN_PASS_CENTRE,   // g[0]: A'(change/s), the change that brings products towards the centre
    CANOPY_TIGHTEN_PASS_TRY,      // `affine` added to the directions: steps alone
    CANOPY_TIGHTEN_PASS_ACCEPT    // the same, and the directions are kept
};
void canopy_tighten_pass(struct canopy_tighten *t, enum canopy_tighten_pass pass, uint32_t row);

// Tables of products; the objective from the points, one row of knot cells at a time.
void canopy_tighten_tables(struct canopy_tighten *t);
void canopy_tighten_weigh(struct canopy_tighten *t, uint32_t row);

// Raises the bounds of the Bernstein coefficients of a row of knot cells to those of another surface, rounded up.
void canopy_tighten_over_row(struct canopy_tighten *t, const int32_t *other, uint32_t row);

// Looks at every constraint of a row of knot cells from whole coefficients and raises what is missing. `reach` bounds
// the coefficients of all occupied cells, before and after; false if one came to be larger.
bool canopy_tighten_raise_row(const struct canopy_tighten *t, int32_t *b, float reach, uint32_t row);

// The bending energy of the free coefficients, x holding the others: a row of it into matrix and `step`, which are
// zero before the first; then what makes it regular. Its minimum is what canopy_tighten_solve then gives.
void canopy_tighten_bend_row(struct canopy_tighten *t, uint32_t i);
void canopy_tighten_bend_finish(struct canopy_tighten *t);

#endif
