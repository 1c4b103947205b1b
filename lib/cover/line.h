/// One line: a uniform cubic spline above scattered heights, paper S0 Section 5, Heuristic(sigma, b, lambda).
///
/// A line has n coefficients at 0, 1 … n-1, the end ones repeated once outside, and *nodes* at k/q, k = 0 … q(n-1),
/// each with a height or with none. The fit makes the lower bound of Lemma 5.1,
///
///     l(h + s) = (1-s) b[h] + s b[h+1] + (1-s)^3 min(D[h], 0)/6 + s^3 min(D[h+1], 0)/6, D[i] = b[i-1]-2b[i]+b[i+1],
///
/// at least the height of every node; the spline is then above the polyline through the nodes of any two neighbours.
/// With q = 1 this is the paper's Heuristic(sigma, b) for uniform data (Section 4).
///
/// Every row j of the system holds one node, the *chosen* one among those that round to j. Where the paper exchanges
/// the one worst violator of the line and solves again, all rows here exchange theirs at once, and the signs sigma with
/// them, as Remez's multiple exchange does: 5 solves a line instead of 27 on a range scan, to the same surface. A row
/// without nodes is free, D[j] = 0. The iteration is capped; a repeated state (choice and signs) ends it; where the
/// matrix is close to singular or the coefficients explode, each row's node moves to its integer, where the matrix is
/// diagonally dominant. In every case the best iterate is taken and canopy_line_lift finishes it: safe by construction.
///
/// On a knot interval l is concave: (1-s)^3 and s^3 are convex and what multiplies them is not positive. So what a
/// height lacks of l is largest at a vertex of the upper convex hull of the nodes, on any part of the interval, and the
/// fit looks at those *vertices* only (per half interval, because that is what rounds to one row).
///
/// Some rows may be *pinned*, each at a coefficient that is given: so a part of a line is fitted while the rest stays
/// as it is (refit.h). A pinned row chooses no node; canopy_line_lift may raise it like any other.
///
/// The scalar lives in here only: heights in and coefficients out are whole steps, and so is all that is proved.
/// Float and fixed point give coefficients that differ by rounding; both are lifted by the same exact integers.
///
/// Cost of one iteration: one banded solve of n rows and a look at every node. On a Cortex-M3, fixed point, n = 20,
/// q = 4: see docs/numbers.md.
#ifndef CANOPY_COVER_LINE_H
#define CANOPY_COVER_LINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/arena.h"
#include "lib/cover/frame.h"
#include "lib/num/band.h"

#define CANOPY_NO_HEIGHT INT32_MIN          ///< a node or a cell without data
#define CANOPY_HEIGHT_LIMIT (1 << 25)       ///< heights of points are within +- this many steps
#define CANOPY_COEFFICIENT_LIMIT (1 << 28)  ///< coefficients are within +- this many steps
#define CANOPY_LINE_SOLVES 12               ///< cap on the iterations of one line

/// Nodes of a line of n coefficients, q nodes a knot interval.
#define CANOPY_LINE_NODES(n, q) ((size_t)(q) * ((size_t)(n)-1U) + 1U)

/// Bytes of arena for lines of up to n coefficients and q nodes a knot interval (give the larger of each of both
/// directions, or the larger sum of the two).
#define CANOPY_LINE_ARENA(n, q)                                                                                        \
    (CANOPY_ARENA_ROUND((size_t)(n) * sizeof(struct canopy_band_row_fx)) + CANOPY_ARENA_ROUND(4U * (size_t)(n)) +      \
     CANOPY_ARENA_ROUND(2U * (size_t)(n)) + CANOPY_ARENA_ROUND(n) +                                                    \
     2U * CANOPY_ARENA_ROUND(4U * CANOPY_LINE_NODES(n, q)) + CANOPY_ARENA_ROUND(2U * CANOPY_LINE_NODES(n, q)) +        \
     CANOPY_ARENA_ROUND(12U * ((size_t)(q) + 1U)))

/// A line being fitted. Its fields belong to lib/cover; `nodes` is where the caller puts the heights.
struct canopy_line {
    uint16_t count;       ///< n
    uint16_t cells;       ///< q
    int32_t *nodes;       ///< CANOPY_LINE_NODES heights in steps, or CANOPY_NO_HEIGHT
    const int32_t *pins;  ///< n coefficients of pinned rows, CANOPY_NO_HEIGHT: not pinned; NULL: none is
    uint8_t solves;       ///< solves done so far
    bool singular;        ///< a matrix was close to singular, or its solution exploded: rows are at their integers
    bool settled;         ///< the iteration ended by itself, not by its cap, a cycle or a singular matrix

    void *rows;          // canopy_band_row_f32 or _fx, n
    void *best;          // float or int32_t, n: the iterate with the smallest violation so far
    uint16_t *vertices;  // nodes that matter, ascending
    void *heights;       // float or int32_t: theirs, (height - low) / 2^shift rounded up
    uint16_t vertex_count;
    void *weights;           // three tables of q + 1: s, (1-s)^3/6, s^3/6 at s = k/q
    uint16_t *chosen;        // lambda: the vertex of each row, as an index; NO_VERTEX if free
    uint8_t *concave;        // sigma: 1 where D < 0 in the last iterate
    int32_t low, high;       // range of the nodes
    int32_t floor, ceiling;  // coefficients beyond these have exploded
    uint8_t shift;
    bool have_best;
    uint32_t seen;  // fingerprint that a cycle would bring back (Brent)
    uint8_t seen_next;
    int32_t worst;  // violation of `best`, scaled
};

/// Takes its memory from `cut`: CANOPY_LINE_ARENA(n, q) bytes.
void canopy_line_init(struct canopy_line *line, size_t n, size_t q, struct canopy_arena *cut);

/// Prepares to fit lines of n coefficients with q nodes a knot interval; both at most those of init.
void canopy_line_shape_f32(struct canopy_line *line, uint16_t n, uint16_t q);
void canopy_line_shape_fx(struct canopy_line *line, uint16_t n, uint16_t q);

/// Begins a fit of line->nodes. A coefficient outside [floor, ceiling] counts as exploded. False if no node has a
/// height.
bool canopy_line_begin_f32(struct canopy_line *line, int32_t floor, int32_t ceiling);
bool canopy_line_begin_fx(struct canopy_line *line, int32_t floor, int32_t ceiling);

/// One iteration. True if there is more to do.
bool canopy_line_iterate_f32(struct canopy_line *line);
bool canopy_line_iterate_fx(struct canopy_line *line);

/// Writes the n coefficients of the best iterate, lifted by canopy_line_lift. Allowed after any number of iterations.
void canopy_line_finish_f32(struct canopy_line *line, int32_t *coefficients);
void canopy_line_finish_fx(struct canopy_line *line, int32_t *coefficients);

/// A scalar of the fit as a value. Who names one links that one only: no float in a program of canopy_line_fit_fx.
struct canopy_line_fit {
    void (*shape)(struct canopy_line *line, uint16_t n, uint16_t q);
    bool (*begin)(struct canopy_line *line, int32_t floor, int32_t ceiling);
    bool (*iterate)(struct canopy_line *line);
    void (*finish)(struct canopy_line *line, int32_t *coefficients);
    uint8_t scalar;  ///< enum canopy_scalar
};
extern const struct canopy_line_fit canopy_line_fit_f32, canopy_line_fit_fx;

/// For programs that have both.
static inline const struct canopy_line_fit *canopy_line_fit_of(enum canopy_scalar scalar) {
    return scalar == CANOPY_FX ? &canopy_line_fit_fx : &canopy_line_fit_f32;
}

/// Lists the vertices: the nodes with a height that are on the upper convex hull of their half interval. Returns how
/// many.
uint16_t canopy_line_hull(const int32_t *nodes, uint16_t n, uint16_t q, uint16_t *vertices);

/// The safe finish, exact: raises coefficients until the bound l is at least the height of every listed node.
/// Where a node of the knot interval h lacks d, those of b[h-1] … b[h+2] that l depends on there (three at a knot) rise
/// by d, and so does l; l falls nowhere when a coefficient rises, so one pass clears all. Returns the largest d.
int32_t canopy_line_lift(int32_t *b, uint16_t n, uint16_t q, const int32_t *nodes, const uint16_t *vertices,
                         uint16_t count);

#endif
