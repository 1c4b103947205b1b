/// Tightening: from any safe surface to nearly the tightest there is, by an interior-point method that can stop
/// anywhere.
///
/// The tightest safe surface solves a linear program over the m x n coefficients x (cover.md 4):
///
///     least mean of S(u_i, v_i) - z_i over the points, subject to
///       safe      S(u_i, v_i) >= z_i at every point;
///       no pits   on every half-knot cell that holds points, all 16 Bernstein coefficients of S are at least the
///                 lowest z in it: between two samples the surface does not dive below what was seen around them;
///       reach     every coefficient within one height range of the data's.
///
/// The method is Mehrotra's primal-dual predictor-corrector (SIAM J. Optim. 2, 1992) with centrality correctors as in
/// Gondzio (Comput. Optim. Appl. 6, 1996), in float. Its matrix is banded, half-bandwidth 3n + 3: one Cholesky an
/// iteration. Points are grouped by knot cell and taken eight at a time in the cell's Bernstein basis; what a cell
/// adds to the matrix is 7 x 7 moments of degree 6, all terms of one sign.
///
/// *Published* is what stands in the caller's coefficients, and it is always safe: an iterate is rounded to whole
/// steps, every constraint is recomputed from those whole coefficients with a bounded error, and where something is
/// missing the 4 x 4 coefficients of that knot cell are raised by it, which lowers the surface nowhere. Only then, and
/// only if its mean gap is smaller, does it replace what was published before, beginning with the caller's own start.
///
/// Any dual y >= 0 proves a lower bound of the optimum. With r = c - A'y and l <= x <= u the reach,
///     c x* >= b y + sum_j min(r_j l_j, r_j u_j) = c x - [ s y + sum_j max(r_j (x_j - l_j), r_j (x_j - u_j)) ],
/// s = A x - b: the first step because A x* >= b and y >= 0, the second because A x = b + s. Every iteration has such
/// a y. canopy_tighten_excess gives the best so far as "at most that far from the tightest possible".
///
/// A coefficient that no occupied knot cell can see is free and shapes nothing that is covered: it stays as the start
/// has it, and at the end all free ones take the values of least bending energy beside the others, kept within the
/// reach.
///
/// From a field (canopy_tighten_field) the points are the field's nodes, each as high as the highest cell around it.
/// That is no certificate of what lies between nodes, so canopy_certify mends every candidate before it counts.
/// Its bound leaves out convex bends, of which the tightest surfaces are full: so far the mend costs more than was
/// gained where the start is the fast method's (scans at Q = 4 and 8), which then stays as it is. Looser starts are
/// tightened.
///
/// Heights are steps in the library's orientation: above, mirrored for the side below. Stack: 4 KB.
#ifndef CANOPY_COVER_TIGHTEN_H
#define CANOPY_COVER_TIGHTEN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/arena.h"
#include "lib/cover/certify.h"
#include "lib/cover/field.h"
#include "lib/cover/frame.h"
#include "lib/status.h"

#define CANOPY_TIGHTEN_LANES 8        ///< points taken at a time; every knot cell's points are filled up to a multiple
#define CANOPY_TIGHTEN_ITERATIONS 30  ///< cap on the iterations of one tightening

/// Constraints side by side: bound, slack, dual, and the directions of the latter two. Of the arena, no business of
/// the caller.
struct canopy_tighten_lanes {
    float z[CANOPY_TIGHTEN_LANES], slack[CANOPY_TIGHTEN_LANES], dual[CANOPY_TIGHTEN_LANES];
    float slack_by[CANOPY_TIGHTEN_LANES], dual_by[CANOPY_TIGHTEN_LANES];
};

/// Points of one knot cell: where in it, and their constraints. 28 bytes a point.
struct canopy_tighten_block {
    float s[CANOPY_TIGHTEN_LANES], t[CANOPY_TIGHTEN_LANES];
    struct canopy_tighten_lanes lanes;
};

/// Rows of the matrix, with what the widest chunk may read beyond its end.
#define CANOPY_TIGHTEN_BAND(n) (3U * (size_t)(n) + 4U)

/// Bytes of arena to tighten m x n coefficients over at most `points` points: 28 a point, 1.2 KB a knot cell (224 bytes
/// of which because cells are filled up), and the matrix, 4 m n (3 n + 4).
#define CANOPY_TIGHTEN_ARENA(m, n, points)                                                                             \
    (((size_t)(points) / CANOPY_TIGHTEN_LANES + CANOPY_TIGHTEN_CELLS(m, n)) * sizeof(struct canopy_tighten_block) +    \
     CANOPY_TIGHTEN_CELLS(m, n) * 7U * sizeof(struct canopy_tighten_lanes) +                                           \
     CANOPY_ARENA_ROUND(4U * (CANOPY_TIGHTEN_CELLS(m, n) + 1U)) +                                                      \
     CANOPY_ARENA_ROUND(16U * CANOPY_TIGHTEN_CELLS(m, n)) +                                                            \
     CANOPY_ARENA_ROUND(4U * (size_t)(m) * (size_t)(n)*CANOPY_TIGHTEN_BAND(n)) +                                       \
     13U * CANOPY_ARENA_ROUND(4U * (size_t)(m) * (size_t)(n)) + CANOPY_ARENA_ROUND((size_t)(m) * (size_t)(n)))
#define CANOPY_TIGHTEN_CELLS(m, n) (((size_t)(m)-1U) * ((size_t)(n)-1U))

/// Points that a field of cu x cv cells a knot interval makes at most: its nodes.
#define CANOPY_TIGHTEN_NODES(m, n, cu, cv) (CANOPY_LINE_NODES(m, cu) * CANOPY_LINE_NODES(n, cv))

enum canopy_tighten_stage {
    CANOPY_TIGHTEN_IDLE,
    CANOPY_TIGHTEN_START,    // publishes the start, raised
    CANOPY_TIGHTEN_SLACKS,   // of the first iterate
    CANOPY_TIGHTEN_MEASURE,  // slacks of the present iterate, the matrix
    CANOPY_TIGHTEN_FACTOR,
    CANOPY_TIGHTEN_PREDICT,  // solves, each before its pass over the constraints
    CANOPY_TIGHTEN_AFFINE,
    CANOPY_TIGHTEN_COMBINE,
    CANOPY_TIGHTEN_STEP,
    CANOPY_TIGHTEN_CENTRE,
    CANOPY_TIGHTEN_RECENTRE,
    CANOPY_TIGHTEN_TRY,
    CANOPY_TIGHTEN_ACCEPT,
    CANOPY_TIGHTEN_PUBLISH,  // raises the candidate
    CANOPY_TIGHTEN_COMPARE,  // has it mended, and publishes it if it is better
    CANOPY_TIGHTEN_BEND,     // the free coefficients
    CANOPY_TIGHTEN_BEND_FACTOR,
    CANOPY_TIGHTEN_BEND_SOLVE,
    CANOPY_TIGHTEN_DONE
};

struct canopy_tighten {
    struct canopy_frame frame;
    uint8_t stage;       ///< enum canopy_tighten_stage
    uint8_t iterations;  ///< done so far
    uint32_t points;     ///< points taken
    uint32_t published;  ///< how often the caller's coefficients were replaced
    float mean_gap;      ///< of what is published, over the points, in steps
    float bound;         ///< certified: no surface of the program has a smaller mean gap, in steps

    size_t room;                       // points that the arena is for
    const struct canopy_field *field;  // NULL when from points
    struct canopy_certify *certify;    // mends candidates, or NULL
    int32_t *b;                        // the caller's coefficients: what is published
    int32_t low;                       // lowest height: 0 of the program's unit
    float range, per_step;             // of which 1 is the range of heights
    uint32_t row;                      // next row of knot cells, or of coefficients, of the present stage
    uint32_t *first;                   // first block of each knot cell, and the end
    struct canopy_tighten_block *blocks;
    struct canopy_tighten_lanes *pits;        // 7 x 8 Bernstein coefficients for each knot cell, the eighth not used
    float *half_low;                          // lowest height of each half-knot cell, 2 x 2 for each knot cell
    float *matrix;                            // lower band, 3n + 4 a row, the diagonal last
    float *cost;                              // c
    float *x, *step, *affine, *rhs, *g[2];    // iterate and directions; sums over constraints of A'(...)
    float *dual[2], *dual_by[2], *target[2];  // of the reach: low side, high side
    int32_t *candidate;
    uint8_t *seen;      // 1 where an occupied knot cell has the coefficient in its support
    float pair[10][8];  // products of two B-splines in degree 6 Bernstein form, binomials included
    float pit_pair[10][8];
    float height_mean;                 // of the points
    uint32_t constraints, deepest;     // how many there are in all; most blocks of a knot cell
    float mu, comp, sums[3], most[2];  // complementarity; what a pass adds up; largest -by/slack and -by/dual
    float alpha[2], aim[2];            // step lengths, primal and dual; those that a corrector aims at
    uint8_t corrections;               // centrality correctors of this iteration so far
    bool floored;                      // a surface to stay above: every knot cell has constraints
    bool lid;                          // the start was of no use as an iterate
    bool safe;
};

/// Prepares for tightening in `frame` over at most `points` points (nodes, from a field).
enum canopy_status canopy_tighten_init(struct canopy_tighten *tighten, const struct canopy_frame *frame, size_t points,
                                       void *arena, size_t bytes);

/// Takes the points, device units of the frame's scalar, its axes being x, y, z. Three looks at each. They may go away
/// afterwards. CANOPY_OUT_OF_FRAME, CANOPY_RANGE: one of them is not for canopy_field_insert either; CANOPY_EMPTY:
/// there are none; CANOPY_ARENA_SHORT: there are more than init was told. Nothing can be begun after a failure.
enum canopy_status canopy_tighten_points_f32(struct canopy_tighten *tighten, const float (*points)[3], size_t count);
enum canopy_status canopy_tighten_points_fx(struct canopy_tighten *tighten, const int32_t (*points)[3], size_t count);

/// Takes the nodes of a field of the same frame; a later rise of the field is not seen. Every candidate is mended by
/// `certify`, which is of the same field and is left in its last state.
enum canopy_status canopy_tighten_field(struct canopy_tighten *tighten, const struct canopy_field *field,
                                        struct canopy_certify *certify);

/// Asks to stay above another surface of the same frame, everywhere in it: on every half-knot cell, with or without
/// points, each of the 16 Bernstein coefficients of S is at least that of `other` (m x n steps in the library's
/// orientation: for the side below, the mirror of the surface above). What is published then keeps to it exactly, as it
/// does to the points, and no coefficient is free. After the points, before canopy_tighten_begin; `other` stays as it
/// is until the tightening has ended. CANOPY_EMPTY: no points; CANOPY_RANGE: `other` leaves no room within the reach,
/// having a coefficient further than 1.9 height ranges from the lowest point; nothing changed.
enum canopy_status canopy_tighten_over(struct canopy_tighten *tighten, const int32_t *other);

/// Begins from `coefficients`, m x n, where from now on always stands what is published; the caller changes them no
/// more. `safe`: they are known to be (the fast method's, certified), and stay until something better is found. Else
/// (the last envelope, with new points) they are raised first, where they must be; until the first step has returned
/// they are not safe, and tighten->published is 0.
enum canopy_status canopy_tighten_begin(struct canopy_tighten *tighten, int32_t *coefficients, bool safe);

/// Does at most `budget` units of work, each a row of n-1 knot cells in one pass, or n rows of the factorisation, or a
/// solve; the mend of a field's candidate is one unit. Every pass is m-1 units: an iteration is about 8 m of them.
/// CANOPY_MORE, or CANOPY_OK when nothing is left to be gained. It can end after any call: what is published is safe.
enum canopy_status canopy_tighten_step(struct canopy_tighten *tighten, uint32_t budget);

/// How far the published surface's mean gap is from the tightest possible at most, as a fraction of the latter: 0.02 is
/// 2 %. Rounding is on the safe side. 1e30 while nothing is known. 0 also where the start, being no solution of the
/// program (it has pits), is tighter than all that are. From a field: of the program on the nodes.
float canopy_tighten_excess(const struct canopy_tighten *tighten);

#endif
