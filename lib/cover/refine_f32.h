/// Inside lib/cover/refine: what its float files share. Not for others.
///
///     refine_f32.c          beginning and stepping: the order of the stages
///     refine_take_f32.c     the program: points or a field in, the objective
///     refine_rows_f32.c     a constraint's row of the matrix
///     refine_iterate_f32.c  the interior-point iteration
///     refine_publish_f32.c  candidates: rounding, mending, publishing
///
/// It is lib/cover/tighten's iteration without what thousands of constraints ask for: all are in use all the time, and
/// no centrality correctors. They share the factorisation, lib/num/cholesky.h.
#ifndef CANOPY_COVER_REFINE_F32_H
#define CANOPY_COVER_REFINE_F32_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/cover/refine.h"

#define CANOPY_REFINE_FRESH 0.05f  // least slack of the first iterate

// Of all coefficients in sight: what a step of theirs moves is beyond any height format.
#define CANOPY_REFINE_NO_WEIGHT 1e-12f

// How far a sum over 16 coefficients, evaluated here, may be from the true one, relative to the largest: weights 8
// roundings, their products, scaling and sums 12, the coefficients and the unit 3, each 2^-24: below 2^-19, doubled.
#define CANOPY_REFINE_ERROR 0x1p-18f

static inline size_t canopy_refine_coefficients(const struct canopy_refine *r) {
    return (size_t)r->window.size[0] * r->window.size[1];
}

// Fine cells that the window reaches, along v.
static inline uint32_t canopy_refine_across(const struct canopy_refine *r) { return r->window.size[1] + 3U; }

// ---- Rows (refine_rows_f32.c)

// What of the window a fine cell has in sight.
struct canopy_refine_sight {
    uint32_t i, j;           // first coefficient in sight
    uint32_t rows, columns;  // how many
    uint32_t skip[2];        // how many of the four are not, before those
};

struct canopy_refine_sight canopy_refine_sight_of(const struct canopy_refine *r, uint32_t cell);

// The weights of b[h-1] … b[h+2] at s of the knot interval, or of its Bernstein coefficient p where s is -1-p.
void canopy_refine_axis_weights(float s, float w[4]);

// A constraint's row of the matrix: weights of the coefficients in sight, those along v divided by the sum of all.
struct canopy_refine_weights {
    struct canopy_refine_sight sight;
    float u[4], v[4], sum;
};

struct canopy_refine_weights canopy_refine_weights_of(const struct canopy_refine *r,
                                                      const struct canopy_refine_row *row);

// The row times a vector; `factor` times the row added to one, or its square to the lower band of the matrix.
float canopy_refine_times(const struct canopy_refine *r, const struct canopy_refine_weights *w, const float *x);
void canopy_refine_add_weights(const struct canopy_refine *r, const struct canopy_refine_weights *w, float factor,
                               float *to);
void canopy_refine_add_square(const struct canopy_refine *r, const struct canopy_refine_weights *w, float factor);

// ---- The program (refine_take_f32.c)

// Every occupied cell: what it has in sight is seen, with its reach; from points, what keeps pits out is added.
enum canopy_status canopy_refine_see_cells(struct canopy_refine *r);

// ---- The iteration (refine_iterate_f32.c): passes over the constraints, one row each, and what follows each pass

void canopy_refine_start_row(struct canopy_refine *r, struct canopy_refine_row *row);
void canopy_refine_measure_row(struct canopy_refine *r, struct canopy_refine_row *row);
void canopy_refine_affine_row(struct canopy_refine *r, struct canopy_refine_row *row);
void canopy_refine_step_row(struct canopy_refine *r, struct canopy_refine_row *row);

void canopy_refine_go(struct canopy_refine *r, enum canopy_refine_stage stage);
void canopy_refine_next(struct canopy_refine *r);  // after a candidate: the next iteration, or the end
void canopy_refine_finish_start(struct canopy_refine *r);
void canopy_refine_finish_measure(struct canopy_refine *r);
void canopy_refine_finish_affine(struct canopy_refine *r);
void canopy_refine_finish_step(struct canopy_refine *r);

// ---- What is published (refine_publish_f32.c)

void canopy_refine_begin_candidate(struct canopy_refine *r);
void canopy_refine_mend_row(struct canopy_refine *r, struct canopy_refine_row *row);
void canopy_refine_finish_mend(struct canopy_refine *r);
void canopy_refine_certify_candidate(struct canopy_refine *r);

#endif
