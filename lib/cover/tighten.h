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
/// iteration.
///
/// Nearly all constraints are far away, so only those that can touch are in use (constraint reduction: A. Tits, P.-A.
/// Absil, W. Woessner, SIAM J. Optim. 17, 2006): from each of 4 x 4 parts of every knot cell the nearest at first, and
/// what comes near later. After every step *all* are looked at, where the step leads. One that was not in use and is in
/// the way shortens the step and is taken into use; so every iterate is above everything.
///
/// *Published* is what stands in the caller's coefficients, and it is always safe: an iterate is rounded to whole
/// steps, every constraint is recomputed from those whole coefficients with a bounded error, and where something is
/// missing the 4 x 4 coefficients of that knot cell are raised by it, which lowers the surface nowhere. Only then, and
/// only if its mean gap is smaller, does it replace what was published before, beginning with the caller's own start.
/// An iterate that would gain less than 3 % is not tried, unless it is the last.
///
/// Any dual y >= 0 proves a lower bound of the optimum. With r = c - A'y and l <= x <= u the reach,
///     c x* >= b y + sum_j min(r_j l_j, r_j u_j) = c x - [ s y + sum_j max(r_j (x_j - l_j), r_j (x_j - u_j)) ],
/// s = A x - b: the first step because A x* >= b and y >= 0, the second because A x = b + s. What is not in use has
/// y = 0. Every iteration has such a y. canopy_tighten_excess gives the best so far as "at most that far from the
/// tightest possible"; lib/cover/tighten_bound_f32.c has what rounding takes off.
///
/// A coefficient that no occupied knot cell can see is free and shapes nothing that is covered: it stays as the start
/// has it, and at the end all free ones take the values of least bending energy beside the others, kept within the
/// reach.
///
/// From a field (canopy_tighten_field) the program is
///
///     least volume between S and the field's covered cells, each as high as its highest point, subject to
///       safe      on every covered cell all 16 Bernstein coefficients of S over it are at least its height;
///       no pits   as above, with the lowest covered cell of the half-knot cell; and the reach,
///
/// and *published* is what canopy_certify has certified on whole steps, mended where it found something missing: the
/// exact integer certificate, in fixed point and in float alike. A field's height is a promise about points to come, so
/// this surface is looser than that from points by what the cells are coarse (docs/tightening.md). On a chip without
/// floating-point hardware the float part runs in software, as background work: nothing depends on its rounding.
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

#define CANOPY_TIGHTEN_LANES 8        ///< constraints taken at a time
#define CANOPY_TIGHTEN_GRAIN 4        ///< a look takes one constraint into use from each of 4 x 4 parts of a knot cell
#define CANOPY_TIGHTEN_ITERATIONS 30  ///< cap on the iterations of one tightening

/// Eight constraints in use, side by side: knot cell, place in it (0 to 1, or -1 less the index of a Bernstein
/// coefficient), bound, slack, dual, and the directions of the latter two. Of the arena, no business of the caller.
struct canopy_tighten_rows {
    uint32_t cell[CANOPY_TIGHTEN_LANES];
    float s[CANOPY_TIGHTEN_LANES], t[CANOPY_TIGHTEN_LANES], z[CANOPY_TIGHTEN_LANES];
    float slack[CANOPY_TIGHTEN_LANES], dual[CANOPY_TIGHTEN_LANES];
    float slack_by[CANOPY_TIGHTEN_LANES], dual_by[CANOPY_TIGHTEN_LANES];
};

/// Eight points of one knot cell: where in it, and how high.
struct canopy_tighten_points {
    float s[CANOPY_TIGHTEN_LANES], t[CANOPY_TIGHTEN_LANES], z[CANOPY_TIGHTEN_LANES];
};

/// What an arena is for.
struct canopy_tighten_size {
    size_t points;      ///< to tighten from points: at most so many; 0: from a field only
    uint16_t cells[2];  ///< to tighten from a field: its cells a knot interval in u and v; 0: from points only
    uint32_t rows;      ///< constraints in use at a time, CANOPY_TIGHTEN_ROWS or fewer, at least 2 m n
};

/// Constraints in use: as many as are ever of use, and as few as do well, with up to twice the iterations.
#define CANOPY_TIGHTEN_ROWS(m, n) ((uint32_t)32U * (m) * (n))
#define CANOPY_TIGHTEN_ROWS_FEW(m, n) ((uint32_t)4U * (m) * (n))

/// Floats of a row of the matrix: its band left of the diagonal, and that (lib/num/cholesky.h).
#define CANOPY_TIGHTEN_BAND(n) (3U * (size_t)(n) + 4U)
#define CANOPY_TIGHTEN_CELLS(m, n) (((size_t)(m)-1U) * ((size_t)(n)-1U))
#define CANOPY_TIGHTEN_LATTICE(q) (7U + 3U * (size_t)(q) + 1U)

/// Bytes of arena to tighten m x n coefficients with `rows` constraints in use: 32 a row; the matrix, 4 m n (3 n + 4);
/// 53 a coefficient; from at most `points` points, 12 a point and 116 a knot cell; from a field of cu x cv cells a knot
/// interval, 48 (cu + cv) in all. Points or cells are 0 where they are not wanted.
#define CANOPY_TIGHTEN_ARENA(m, n, cu, cv, points, rows)                                                               \
    (CANOPY_TIGHTEN_ARENA_POINTS(m, n, points) +                                                                       \
     ((size_t)(rows) + CANOPY_TIGHTEN_LANES - 1U) / CANOPY_TIGHTEN_LANES * sizeof(struct canopy_tighten_rows) +        \
     16U * (CANOPY_TIGHTEN_LATTICE(cu) + CANOPY_TIGHTEN_LATTICE(cv)) +                                                 \
     CANOPY_ARENA_ROUND(4U * (size_t)(m) * (size_t)(n)*CANOPY_TIGHTEN_BAND(n)) +                                       \
     13U * CANOPY_ARENA_ROUND(4U * (size_t)(m) * (size_t)(n)) + CANOPY_ARENA_ROUND((size_t)(m) * (size_t)(n)) +        \
     2U * CANOPY_ARENA_ROUND(CANOPY_TIGHTEN_CELLS(m, n)))
#define CANOPY_TIGHTEN_ARENA_POINTS(m, n, points)                                                                      \
    ((points) == 0 ? (size_t)0                                                                                         \
                   : ((size_t)(points) / CANOPY_TIGHTEN_LANES + CANOPY_TIGHTEN_CELLS(m, n)) *                          \
                             sizeof(struct canopy_tighten_points) +                                                    \
                         CANOPY_ARENA_ROUND(4U * (CANOPY_TIGHTEN_CELLS(m, n) + 1U)) +                                  \
                         CANOPY_ARENA_ROUND(16U * CANOPY_TIGHTEN_CELLS(m, n)))

/// What a look has found nearest in a part of a knot cell.
struct canopy_tighten_nearest {
    float slack, s, t, z;
};

enum canopy_tighten_stage {
    CANOPY_TIGHTEN_IDLE,
    CANOPY_TIGHTEN_TAKE,        // a field is being taken
    CANOPY_TIGHTEN_START,       // raises the start
    CANOPY_TIGHTEN_START_MEND,  // by the certificate, and publishes it
    CANOPY_TIGHTEN_CHOOSE,      // the first rows in use, at the first iterate
    CANOPY_TIGHTEN_SLACKS,      // and their slacks
    CANOPY_TIGHTEN_CLEAR,       // the matrix
    CANOPY_TIGHTEN_MEASURE,     // slacks of the present iterate, the matrix
    CANOPY_TIGHTEN_FACTOR,
    CANOPY_TIGHTEN_PREDICT,  // solves, each before its pass over the rows in use
    CANOPY_TIGHTEN_AFFINE,
    CANOPY_TIGHTEN_COMBINE,
    CANOPY_TIGHTEN_STEP,
    CANOPY_TIGHTEN_CENTRE,
    CANOPY_TIGHTEN_RECENTRE,
    CANOPY_TIGHTEN_TRY,
    CANOPY_TIGHTEN_ACCEPT,
    CANOPY_TIGHTEN_DROP,     // rows that are of no use, where there are too many
    CANOPY_TIGHTEN_LOOK,     // at every constraint, where the step leads
    CANOPY_TIGHTEN_ADD,      // rows that were found
    CANOPY_TIGHTEN_MOVE,     // to the next iterate
    CANOPY_TIGHTEN_PUBLISH,  // raises the candidate
    CANOPY_TIGHTEN_MEND,     // by the certificate, and publishes it if it is better
    CANOPY_TIGHTEN_BEND_CLEAR,
    CANOPY_TIGHTEN_BEND,  // the free coefficients
    CANOPY_TIGHTEN_BEND_FACTOR,
    CANOPY_TIGHTEN_BEND_SOLVE,
    CANOPY_TIGHTEN_DONE
};

struct canopy_tighten {
    struct canopy_frame frame;
    struct canopy_tighten_size size;
    uint8_t stage;       ///< enum canopy_tighten_stage
    uint8_t iterations;  ///< done so far
    uint32_t points;     ///< points taken; covered cells of a field
    uint32_t published;  ///< how often the caller's coefficients were replaced; 1 while a safe start stands
    float mean_gap;      ///< of what is published, in steps: over the points, or over the field's covered area
    float bound;         ///< certified: no surface of the program has a smaller mean gap, in steps

    const struct canopy_field *field;  // NULL when from points
    struct canopy_certify *certify;    // mends candidates, or NULL
    const int32_t *other;              // a surface to stay above, or NULL
    int32_t *b;                        // the caller's coefficients: what is published
    int32_t low;                       // lowest height: 0 of the program's unit
    float range, per_step;             // of which 1 is the range of heights
    uint32_t at, part;                 // what the present stage does next: knot cell and part of it, row, block
    uint32_t *first;                   // first block of points of each knot cell, and the end
    struct canopy_tighten_points *blocks;
    float *half_low;         // lowest height of each half-knot cell, 2 x 2 for each knot cell
    uint8_t *live;           // 1 where a knot cell has constraints
    uint8_t *flagged;        // where the candidate is to be looked at closely
    float (*lattice[2])[4];  // weights of Bernstein coefficients: 7 of half knot cells, then those of the field's cells
    struct canopy_tighten_rows *rows;
    uint32_t row_count, offered;  // in use; behind the end, backwards, those to be added
    uint32_t grain;               // G: of G x G parts of a knot cell each offers one row
    struct canopy_tighten_nearest nearest[CANOPY_TIGHTEN_GRAIN * CANOPY_TIGHTEN_GRAIN];
    float *matrix;                            // lower band, 3n + 4 a row, the diagonal last
    float *cost;                              // c
    float *x, *step, *affine, *g[2];          // iterate and directions; sums over rows of A'(...)
    float *dual[2], *dual_by[2], *target[2];  // of the reach: low side, high side
    int32_t *candidate;
    uint8_t *seen;                           // 1 where a knot cell with constraints has the coefficient in its support
    float height_mean;                       // of the points, or of the covered cells
    uint32_t deepest, crowded;               // most blocks of points, and most rows in use, of a knot cell
    float mu, mean, comp, sums[3], most[2];  // complementarity; what a pass adds up; largest -by/slack and -by/dual
    float reach;                             // of a candidate's coefficients, and what they may be raised by
    float least;                             // least slack that a look found
    float alpha[2], aim[2];                  // step lengths, primal and dual; those that a corrector aims at
    uint8_t corrections;                     // centrality correctors of this iteration so far
    float candidate_gap;                     // about what the candidate would have, before it is looked at
    bool pending;                            // it has not been looked at
    bool ending;                             // nothing comes after it
    bool lid;                                // the start was of no use as an iterate
    bool safe;
};

/// Prepares for tightening in `frame`. CANOPY_ARGUMENT, CANOPY_ARENA_SHORT, CANOPY_ARENA_ALIGN.
enum canopy_status canopy_tighten_init(struct canopy_tighten *tighten, const struct canopy_frame *frame,
                                       const struct canopy_tighten_size *size, void *arena, size_t bytes);

/// Takes the points, device units of the frame's scalar, its axes being x, y, z. Three looks at each. They may go away
/// afterwards. CANOPY_OUT_OF_FRAME, CANOPY_RANGE: one of them is not for canopy_field_insert either; CANOPY_EMPTY:
/// there are none; CANOPY_ARENA_SHORT: there are more than init was told. Nothing can be begun after a failure.
enum canopy_status canopy_tighten_points_f32(struct canopy_tighten *tighten, const float (*points)[3], size_t count);
enum canopy_status canopy_tighten_points_fx(struct canopy_tighten *tighten, const int32_t (*points)[3], size_t count);

/// Takes a field of the same frame, with the cells that init was told. It is looked at all the time: once it rises,
/// what was published is safe for what it was before, and this is to be called anew. Every candidate is certified and
/// mended by `certify`, which is of the same field, and is left in its last state. CANOPY_ARGUMENT: it is not;
/// CANOPY_EMPTY: no cell is covered.
enum canopy_status canopy_tighten_field(struct canopy_tighten *tighten, const struct canopy_field *field,
                                        struct canopy_certify *certify);

/// The same in pieces, for who must not be away for long: _begin looks at each cell's height once, some eight
/// instructions a cell; every _step weighs some 256 of them. CANOPY_MORE, or CANOPY_OK after the last.
enum canopy_status canopy_tighten_field_begin(struct canopy_tighten *tighten, const struct canopy_field *field,
                                              struct canopy_certify *certify);
enum canopy_status canopy_tighten_field_step(struct canopy_tighten *tighten);

/// Asks to stay above another surface of the same frame, everywhere in it: on every half-knot cell, with or without
/// points, each of the 16 Bernstein coefficients of S is at least that of `other` (m x n steps in the library's
/// orientation: for the side below, the mirror of the surface above). What is published then keeps to it exactly, as it
/// does to the points, and no coefficient is free. After the points, before canopy_tighten_begin; `other` stays as it
/// is until the tightening has ended. CANOPY_EMPTY: no points; CANOPY_RANGE: `other` leaves no room within the reach,
/// having a coefficient further than 1.9 height ranges from the lowest point; nothing changed.
enum canopy_status canopy_tighten_over(struct canopy_tighten *tighten, const int32_t *other);

/// Begins from `coefficients`, m x n, where from now on always stands what is published; the caller changes them no
/// more. `safe`: they are known to be (the fast method's, certified), and stay until something better is found. Else
/// (the last envelope, with new points) they are raised first, where they must be: safe, without pits, above the other
/// surface if there is one; until tighten->published is 1 they are not. A start that is known to be safe may have pits,
/// and keeps them as long as tighten->published is 1.
enum canopy_status canopy_tighten_begin(struct canopy_tighten *tighten, int32_t *coefficients, bool safe);

/// Does at most `budget` units of work. Each looks at some 300 constraints (at most 700 points of a knot cell), or
/// passes over 64 constraints in use (16 where they make the matrix), or does 4 rows of the matrix, 64 of a solution,
/// or a row of field cells of the certificate, or looks once at every coefficient or some times at every row in use.
/// CANOPY_MORE, or CANOPY_OK when nothing is left to be gained. It can end after any call: what is published is safe.
enum canopy_status canopy_tighten_step(struct canopy_tighten *tighten, uint32_t budget);

/// How far the published surface's mean gap is from the tightest possible at most, as a fraction of the latter: 0.02 is
/// 2 %. Rounding is on the safe side. 1e30 while nothing is known. 0 also where the start, being no solution of the
/// program (it has pits), is tighter than all that are: then tighten->published is 1 still. From a field: of the
/// field's program.
float canopy_tighten_excess(const struct canopy_tighten *tighten);

#endif
