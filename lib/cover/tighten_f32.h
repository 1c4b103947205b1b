/// Inside lib/cover/tighten: what its files share. Not for others.
///
///     tighten_f32.c          beginning and stepping: the order of the stages
///     tighten_take_f32.c     the program: points or a field in, the objective
///     tighten_rows_f32.c     the constraints in use: what a row is, adding, dropping
///     tighten_pass_f32.c     passes over the rows in use: slacks, directions, the matrix
///     tighten_look_f32.c     looks at every constraint there is: choosing rows, raising candidates
///     tighten_iterate_f32.c  the interior-point iteration
///     tighten_publish_f32.c  candidates: rounding, mending, publishing
///     tighten_bound_f32.c    what the duals prove
///     tighten_bend_f32.c     the free coefficients
///
/// The matrix is factorised by lib/num/cholesky.h.
#ifndef CANOPY_COVER_TIGHTEN_F32_H
#define CANOPY_COVER_TIGHTEN_F32_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/cover/tighten.h"

#define LANES CANOPY_TIGHTEN_LANES
#define SIDES 2  // of the reach: floor and ceiling
#define PITS 7   // Bernstein coefficients of a knot interval's two halves

// The program's unit is the range of heights, its zero the lowest. Coefficients stay within the reach.
#define CANOPY_TIGHTEN_FLOOR -1.0f
#define CANOPY_TIGHTEN_CEILING 2.0f
#define CANOPY_TIGHTEN_NONE -8.0f   // the bound of a constraint that is none; below all others
#define CANOPY_TIGHTEN_LEAST 1e-8f  // least slack: what rounding may take from a slack that is positive in truth

// What a constraint that comes into use may be below the surface, or lack: less than that is made good by raising what
// is published.
#define CANOPY_TIGHTEN_NOISE 4e-6f

// How far a surface evaluated here may be from the true one, coefficients within +-2.5 (else in proportion). Per axis:
// coefficients to floats 3 roundings, to Bernstein form 6, weights from s 4, the sum 8; times two axes less what they
// share, under 40 roundings of 2^-24 * 2.5: 100. A point's place is off by 3 * 2^-24 per axis, times a slope of up to
// 5: 30; z is rounded by 2. Together under 2^-16, with twice as much to spare below that.
#define CANOPY_TIGHTEN_ERROR 0x1p-16f
#define CANOPY_TIGHTEN_ERROR_REACH 2.5f

// Flags of knot cells in which something may have to be made good: at the present iterate, and where a step leads.
#define CANOPY_TIGHTEN_FLAG_HERE 1
#define CANOPY_TIGHTEN_FLAG_THERE 2

// The second where the first is no number.
static inline float larger(float a, float b) { return a > b ? a : b; }
static inline float smaller(float a, float b) { return a < b ? a : b; }

static inline size_t canopy_tighten_coefficients(const struct canopy_tighten *t) {
    return (size_t)t->frame.size[0] * t->frame.size[1];
}

static inline uint32_t canopy_tighten_cells(const struct canopy_tighten *t) {
    return (t->frame.size[0] - 1U) * (t->frame.size[1] - 1U);
}

static inline float canopy_tighten_height(const struct canopy_tighten *t, int32_t height) {
    return (float)(height - t->low) * t->per_step;
}

// A sum that does not lose the small beside the large (Neumaier).
struct canopy_tighten_sum {
    float high, low;
};

static inline void canopy_tighten_add(struct canopy_tighten_sum *sum, float x) {
    const float total = sum->high + x;
    sum->low += fabsf(sum->high) >= fabsf(x) ? (sum->high - total) + x : (x - total) + sum->high;
    sum->high = total;
}

// ---- Rows (tighten_rows_f32.c)

// The weights of b[h-1] … b[h+2] in a cubic B-spline at s of the knot interval. None is negative.
static inline void canopy_tighten_weights(float s, float w[4]) {
    const float r = 1.0f - s, c0 = r * r * r, c1 = r * r * s, c2 = r * s * s, c3 = s * s * s;
    w[0] = c0 * (1.0f / 6);
    w[1] = (4.0f * c0 + 12.0f * c1 + 6.0f * c2 + c3) * (1.0f / 6);
    w[2] = (c0 + 6.0f * c1 + 12.0f * c2 + 4.0f * c3) * (1.0f / 6);
    w[3] = c3 * (1.0f / 6);
}

// Places that are Bernstein coefficients: p = 0 … 6 of the halves of a knot cell, then 0 … 3q of the field's cells.
static inline float canopy_tighten_place(uint32_t p) { return -1.0f - (float)p; }

// The 4 x 4 coefficients of a knot cell: where they are, and their values.
struct canopy_tighten_patch {
    uint32_t index[16];
    float c[4][4];
};

void canopy_tighten_find_patch(const struct canopy_tighten *t, uint32_t cell, struct canopy_tighten_patch *patch);
void canopy_tighten_read_patch(struct canopy_tighten_patch *patch, const float *x);

// Fills the tables of the lattices.
void canopy_tighten_tables(struct canopy_tighten *t);

// The weights of eight rows' places along one axis.
void canopy_tighten_lane_weights(const struct canopy_tighten *t, int axis, const float place[LANES], float w[4][LANES]);

// Drops the furthest where there is little room for more.
void canopy_tighten_drop_rows(struct canopy_tighten *t);

// Offers a row to be added, in order of cells. What is offered stands in the matrix.
void canopy_tighten_offer(struct canopy_tighten *t, uint32_t cell, float s, float v, float z);

// Adds what was offered, as far as there is room: sift it before. A new row's slack is 1 and its dual 0.
void canopy_tighten_take_rows(struct canopy_tighten *t);

// Takes out of what is offered what is there.
void canopy_tighten_sift_rows(struct canopy_tighten *t);

// ---- The passes over the rows in use (tighten_pass_f32.c)

enum canopy_tighten_pass {
    CANOPY_TIGHTEN_PASS_SLACKS,   // slacks of x; sums[0]: sum of 1/slack; most[0]: largest 1/slack
    CANOPY_TIGHTEN_PASS_MEASURE,  // duals stepped, slacks of x, the matrix; comp; g[0]: A'y
    CANOPY_TIGHTEN_PASS_AFFINE,   // `affine`: sums of the products, steps, g[0]: A'(1/s), g[1]: A'(target/s)
    CANOPY_TIGHTEN_PASS_STEP,     // `step`: directions and steps
    CANOPY_TIGHTEN_PASS_CENTRE,   // g[0]: A'(change/s), the change that brings products towards the centre
    CANOPY_TIGHTEN_PASS_TRY,      // `affine` added to the directions: steps alone
    CANOPY_TIGHTEN_PASS_ACCEPT    // the same, and the directions are kept
};

// Blocks of rows from t->at on, a few; true when it was the last.
bool canopy_tighten_pass(struct canopy_tighten *t, enum canopy_tighten_pass pass);

// ---- Looks at every constraint (tighten_look_f32.c)

enum canopy_tighten_look {
    CANOPY_TIGHTEN_LOOK_CHOOSE,  // offers the nearest rows of every part of every cell, at x
    CANOPY_TIGHTEN_LOOK_STEP,    // where the step leads: offers what comes near; most[0]: largest part of a slack that
                                 // goes where more than all of it goes; flags the cells that must be raised
    CANOPY_TIGHTEN_LOOK_RAISE    // raises the whole coefficients `b` under what they lack, in cells that are flagged
};

// Goes on from t->at and t->part, a few hundred constraints. CANOPY_MORE, CANOPY_OK at the end; CANOPY_RANGE: a
// coefficient came to be larger than `reach`, which bounds those that any constraint sees before and after.
enum canopy_status canopy_tighten_look(struct canopy_tighten *t, enum canopy_tighten_look look, int32_t *b,
                                       float reach);

// ---- The iteration (tighten_iterate_f32.c): what follows each pass, and the vectors between

static inline float canopy_tighten_reach_slack(const struct canopy_tighten *t, int side, size_t j) {
    return larger(side == 0 ? t->x[j] - CANOPY_TIGHTEN_FLOOR : CANOPY_TIGHTEN_CEILING - t->x[j], CANOPY_TIGHTEN_LEAST);
}

void canopy_tighten_go(struct canopy_tighten *t, enum canopy_tighten_stage stage);
void canopy_tighten_first_iterate(struct canopy_tighten *t);
void canopy_tighten_first_duals(struct canopy_tighten *t);
void canopy_tighten_finish_measure(struct canopy_tighten *t);
void canopy_tighten_finish_predict(struct canopy_tighten *t);
void canopy_tighten_finish_affine(struct canopy_tighten *t);
void canopy_tighten_finish_combine(struct canopy_tighten *t);
void canopy_tighten_finish_step(struct canopy_tighten *t);
void canopy_tighten_finish_centre(struct canopy_tighten *t);
void canopy_tighten_finish_recentre(struct canopy_tighten *t);
void canopy_tighten_finish_try(struct canopy_tighten *t);
void canopy_tighten_finish_accept(struct canopy_tighten *t);
void canopy_tighten_finish_look(struct canopy_tighten *t);
void canopy_tighten_take_step(struct canopy_tighten *t);

// ---- What is published (tighten_publish_f32.c)

void canopy_tighten_publish_start(struct canopy_tighten *t);
void canopy_tighten_begin_start(struct canopy_tighten *t);
void canopy_tighten_raise_start(struct canopy_tighten *t);
void canopy_tighten_mend_start(struct canopy_tighten *t);
void canopy_tighten_consider(struct canopy_tighten *t);
void canopy_tighten_end(struct canopy_tighten *t);
void canopy_tighten_raise_candidate(struct canopy_tighten *t);
void canopy_tighten_mend_candidate(struct canopy_tighten *t);
float canopy_tighten_lid(const struct canopy_tighten *t);

// ---- What the duals prove (tighten_bound_f32.c)

void canopy_tighten_find_bound(struct canopy_tighten *t);

// ---- The free coefficients (tighten_bend_f32.c): their bending energy into matrix and `step`, a row at a time

void canopy_tighten_begin_bend(struct canopy_tighten *t);
void canopy_tighten_bend_row(struct canopy_tighten *t);
void canopy_tighten_finish_bend(struct canopy_tighten *t);

#endif
