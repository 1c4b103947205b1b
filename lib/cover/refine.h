/// Knots where they matter: a window of half or quarter pitch that brings a safe surface nearer to what is under it.
///
/// The surface so far (base and earlier windows, lib/spline/refined.h) is safe. A window adds
/// sum d[i][j] N(2^k u - i0 - i) N(2^k v - j0 - j) to it: twice continuously differentiable also across its edge,
/// because the d are not repeated outside. Its d solve the linear program
///
///     least mean gap over the window's points, subject to
///       safe      the surface stays above every point;
///       no pits   (points only) on every fine cell that holds points, all 16 Bernstein coefficients of the surface are
///                 at least the lowest of them, or where they were if that is lower;
///       reach     every coefficient, with the surface so far on the fine knots, stays within one height range of the
///                 data's.
///
/// d may have either sign. Were it d <= 0, so that the surface rises nowhere, every point that the surface touches
/// already would hold all 16 coefficients around it at zero, and a tight surface touches points nearly everywhere:
/// docs/refine.md has what that costs. What is promised instead: the mean gap falls, or the window stays zero.
///
/// The method is Mehrotra's primal-dual predictor-corrector (SIAM J. Optim. 2, 1992) in float on a banded matrix,
/// half-bandwidth 3 columns + 3, as in tighten.h. It may be stopped after any step:
///
/// *Published* is what stands in the window's d, and it is always safe. Every few iterations an iterate is rounded up
/// to whole steps and every constraint is looked at again, from those. Where something is missing the 4 x 4 d of that
/// fine cell are raised by it; where the window's edge cuts some off and that is not enough, negative ones are brought
/// nearer to zero until it is, at the latest at zero, where the window lowers nothing. From a field,
/// canopy_refine_certify is the judge. From points it is a bounded float evaluation, and the promise is: where the
/// surface so far was above a point, it still is, but for what the float error of the *place* of a point moves; a host
/// then decides exactly (tools/common/exact.h). The result replaces what was published if its mean gap is smaller.
///
/// Heights are steps in the library's orientation: above, mirrored for the side below. Stack: 2 KB.
///
/// Non-uniform knot vectors are left out on purpose: the pitch of each axis is its own number, but it is one number, in
/// the frame, in the registers and in the file; windows put knots where they matter without a new format.
#ifndef CANOPY_COVER_REFINE_H
#define CANOPY_COVER_REFINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/arena.h"
#include "lib/cover/field.h"
#include "lib/cover/frame.h"
#include "lib/cover/refine_certify.h"
#include "lib/spline/refined.h"
#include "lib/status.h"

#define CANOPY_REFINEMENTS_MAX 8     ///< windows of one surface
#define CANOPY_REFINE_ITERATIONS 30  ///< cap on the iterations of one window
#define CANOPY_REFINE_CHUNK 32       ///< constraints of one unit of work

// ---- Where

/// The window of `level` that changes the surface between the fine knots low and high of each axis and nowhere else:
/// its `first` and `size`; d is left alone. Where it reaches the edge of the grid it has the coefficients beyond the
/// edge, too. Fine knots: 0 to 2^level (size - 1). CANOPY_ARGUMENT: no such level, or less than 4 fine knot intervals
/// (1 where it reaches an edge of the grid). CANOPY_OUT_OF_FRAME: beside the grid. *window is then unchanged.
enum canopy_status canopy_refine_place(const struct canopy_frame *frame, unsigned level, const int32_t low[2],
                                       const int32_t high[2], struct canopy_refinement *window);

/// Whether a list of windows is one: CANOPY_ARGUMENT: more than CANOPY_REFINEMENTS_MAX, or a level that is none, or
/// no coefficients; CANOPY_OUT_OF_FRAME: coefficients whose support is beside the grid, or beyond its edge by more than
/// one; CANOPY_RANGE: a coefficient beyond CANOPY_REFINED_LIMIT. *which: the first window of which this is true; count
/// if there are too many. Windows may overlap and nest: they add up.
enum canopy_status canopy_refine_check(const struct canopy_frame *frame, const struct canopy_refinement *windows,
                                       uint32_t count, uint32_t *which);

/// Where it matters most: the place of a window of span[0] x span[1] knot intervals, not meeting any of `taken` that is
/// not of a coarser level, with the largest sum of `gaps`, one for each knot cell, row order, in any unit.
/// CANOPY_EMPTY: nowhere, or nowhere is a gap; CANOPY_ARGUMENT, CANOPY_OUT_OF_FRAME: as canopy_refine_place.
/// Cost: (m-1)(n-1) times 2 span[0] additions.
enum canopy_status canopy_refine_choose(const struct canopy_frame *frame, const uint32_t *gaps, unsigned level,
                                        const uint16_t span[2], const struct canopy_refinement *taken, uint32_t count,
                                        struct canopy_refinement *window);

/// Gaps for canopy_refine_choose from a field: the height over the middle of each cell less the cell's.
void canopy_refine_gaps(const struct canopy_field *field, const int32_t *b, const struct canopy_refinement *windows,
                        uint32_t count, uint32_t *gaps);

// ---- How

/// One constraint: where it is, how high, and what the method knows of it. Of the arena, no business of the caller.
struct canopy_refine_row {
    uint32_t cell;  // fine cell, counted from the window's corner
    float s, t;     // place in it; -1-p, -1-q for a Bernstein coefficient of it
    float bound, slack, dual, slack_by, dual_by;
};

/// Fine cells that a window of r x c coefficients reaches.
#define CANOPY_REFINE_CELLS(r, c) (((size_t)(r) + 3U) * ((size_t)(c) + 3U))

/// Constraints at most: from points, and from a field of cu x cv cells a knot interval for a window of `level`.
#define CANOPY_REFINE_ROWS(r, c, points) ((size_t)(points) + 16U * CANOPY_REFINE_CELLS(r, c))
#define CANOPY_REFINE_NODES(r, c, cu, cv, level)                                                                       \
    ((((size_t)(cu) >> (level)) * ((size_t)(r) + 3U) + 1U) * (((size_t)(cv) >> (level)) * ((size_t)(c) + 3U) + 1U))

/// Floats of a row of the matrix: its band left of the diagonal, and that (lib/num/cholesky.h).
#define CANOPY_REFINE_BAND(c) (3U * (size_t)(c) + 4U)

/// Bytes of arena for a window of r x c coefficients and `rows` constraints: 32 each, the matrix of 4 r c (3 c + 4),
/// and 49 for each coefficient.
#define CANOPY_REFINE_ARENA(r, c, rows)                                                                                \
    (CANOPY_ARENA_ROUND((size_t)(rows) * sizeof(struct canopy_refine_row)) +                                           \
     CANOPY_ARENA_ROUND(4U * CANOPY_REFINE_CELLS(r, c)) +                                                              \
     CANOPY_ARENA_ROUND(4U * (size_t)(r) * (size_t)(c)*CANOPY_REFINE_BAND(c)) +                                        \
     12U * CANOPY_ARENA_ROUND(4U * (size_t)(r) * (size_t)(c)) + CANOPY_ARENA_ROUND((size_t)(r) * (size_t)(c)))

enum canopy_refine_stage {
    CANOPY_REFINE_FILLING,
    CANOPY_REFINE_START,    // slacks of the first iterate
    CANOPY_REFINE_MEASURE,  // slacks of the present iterate, the matrix
    CANOPY_REFINE_MEND,     // a candidate raised, from points
    CANOPY_REFINE_CERTIFY,  // or from a field
    CANOPY_REFINE_FACTOR,
    CANOPY_REFINE_PREDICT,
    CANOPY_REFINE_AFFINE,
    CANOPY_REFINE_COMBINE,
    CANOPY_REFINE_STEP,
    CANOPY_REFINE_DONE
};

struct canopy_refine {
    struct canopy_frame frame;
    const int32_t *b;
    struct canopy_refinement list[CANOPY_REFINEMENTS_MAX];  // as the surface has them; the last with the candidate
    uint32_t count;
    struct canopy_refinement window;  // the one that is fitted: its d are published
    uint8_t stage;                    ///< enum canopy_refine_stage
    uint8_t iterations;               ///< done so far
    uint32_t rows;                    ///< constraints
    uint32_t points;                  ///< points or nodes among them
    uint32_t published;               ///< how often the window's d were replaced
    float before, after;              ///< mean gap over the window's points in steps, without and with the window

    struct canopy_refine_certify *certify;  // NULL when from points
    size_t room;
    struct canopy_refine_row *row;
    int32_t *low;          // lowest point of each fine cell
    int32_t height[2];     // lowest and highest point
    uint32_t cached;       // fine cell of `c`
    int32_t c[4][4];       // the surface so far over it
    float unit, per_step;  // of which 1 is the range of heights
    float *matrix, *cost, *x, *step, *affine, *rhs, *g[2];
    float *reach[2], *dual[2];  // floor and ceiling of x
    int32_t *candidate;
    uint8_t *seen;                           // 1 where a fine cell with points has the coefficient in sight
    uint32_t at;                             // next constraint, or row of the matrix, of the present stage
    float comp, sums[3], most[2], alpha[2];  // complementarity; what a pass adds up; largest -by/slack, -by/dual
    float gap, best;                         // mean gap: so far, published; in units
    uint32_t tried, tries;                   // the field's cell that was mended last, and how often in a row
    bool raised, last;
};

/// Prepares to fit windows[count-1]; those before it are part of the surface so far, like the base b. All must pass
/// canopy_refine_check, but the d of the last count as zero, are set to zero, and from now on are what is published.
/// `rows`: constraints at most. The coefficients and windows stay where they are and as they are.
enum canopy_status canopy_refine_init(struct canopy_refine *refine, const struct canopy_frame *frame, const int32_t *b,
                                      const struct canopy_refinement *windows, uint32_t count, size_t rows, void *arena,
                                      size_t bytes);

/// Takes a point: knot interval and place in it, 0 to 1, along each axis, and its height in steps, rounded up. Points
/// that the window does not reach are passed over. CANOPY_ARGUMENT: beside the grid, or no number; CANOPY_RANGE: the
/// height is beyond CANOPY_HEIGHT_LIMIT, or the surface beyond its own; CANOPY_ARENA_SHORT: no more room.
enum canopy_status canopy_refine_add(struct canopy_refine *refine, const uint32_t interval[2], const float s[2],
                                     int32_t height);

/// Or takes the nodes of a field of the same frame, each as high as the highest cell around it. Every candidate is
/// judged by `certify`, which is of the same field and is left in its last state; the surface so far is certified.
/// CANOPY_ARGUMENT: another frame, or cells that are no multiple of 2^level.
enum canopy_status canopy_refine_field(struct canopy_refine *refine, struct canopy_refine_certify *certify);

/// Ends the filling. CANOPY_EMPTY: the window reaches no point; CANOPY_ARENA_SHORT: no room for what keeps pits out.
enum canopy_status canopy_refine_begin(struct canopy_refine *refine);

/// Does at most `budget` units of work: CANOPY_REFINE_CHUNK constraints in one pass, a row of the window's coefficients
/// in the factorisation, a solve, or in a certificate as many fine cells. CANOPY_MORE, or CANOPY_OK when nothing is
/// left to be gained. It can end after any call: what is published is safe.
enum canopy_status canopy_refine_step(struct canopy_refine *refine, uint32_t budget);

#endif
