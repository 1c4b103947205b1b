/// The certificate from the field: is the surface above every point of every covered cell? (cover.md 5, 6)
///
/// It is recomputed from the published coefficients and shares no code with the fit. The argument, all in integers:
///
/// For every column j of coefficients and every node row u_k = k/Q, the bound l of Lemma 5.1, rounded down, is L[k][j].
/// Between two node rows of one cell the column's spline lies above the straight line from L[k][j] to L[k+1][j]
/// (Lemma 5.1; (1-s)^3 is convex). B-splines are not negative, so there S(u, .) lies above the same mixture of the two
/// splines with coefficients L[k] and L[k+1]. The bound of those at the node columns v_l = l/Q, rounded down again, is
/// M[k][l], and S lies above the bilinear interpolant of M over each cell, hence above the least of its four corners.
/// Cells are closed and, where the field is exact, a point is in its cell: S >= that least >= the cell's highest point.
///
/// l leaves out convex bends, of which the tightest surfaces are full. So where it says too little, the cell has a
/// second chance: S lies above the least of its 4 x 4 Bernstein coefficients over the cell (bezier.h), which are made
/// in u first, rounded down, then in v, rounded down. Both bounds hold; the larger counts.
///
/// Work is done a row of cells at a time: Q (n-1) cells, one bound of each coefficient column and one of each node. A
/// second chance is 32 Bernstein coefficients of a spline. What the fast method fits needs none unless the field has
/// risen since.
#ifndef CANOPY_COVER_CERTIFY_H
#define CANOPY_COVER_CERTIFY_H

#include <stddef.h>
#include <stdint.h>

#include "lib/arena.h"
#include "lib/cover/field.h"
#include "lib/spline/bezier.h"
#include "lib/status.h"

/// Bytes of arena to certify coefficients, n along v, on a field of cu x cv cells a knot interval.
#define CANOPY_CERTIFY_ARENA(n, cu, cv) (CANOPY_CERTIFY_TABLES(cu, cv) + CANOPY_CERTIFY_WORK(n, cv))
/// … of which tables, the same for both directions where these have the same cells, …
#define CANOPY_CERTIFY_TABLES(cu, cv) (CANOPY_CERTIFY_TABLE(cu) + ((cu) != (cv) ? CANOPY_CERTIFY_TABLE(cv) : 0U))
#define CANOPY_CERTIFY_TABLE(q)                                                                                        \
    (CANOPY_ARENA_ROUND(12U * ((size_t)(q) + 1U)) + CANOPY_ARENA_ROUND(12U * CANOPY_BEZIER_LATTICE((size_t)(q))))
/// … and what a step writes and the next one reads.
#define CANOPY_CERTIFY_WORK(n, cv)                                                                                     \
    (CANOPY_ARENA_ROUND(4U * (size_t)(n)) + 2U * CANOPY_ARENA_ROUND(4U * CANOPY_LINE_NODES(n, cv)))

struct canopy_certify {
    const struct canopy_field *field;
    const int32_t *b;      // the coefficients in canonical orientation (above), size[0] x size[1]; NULL: out of range
    int32_t *column;       // L of one node row
    int32_t *low, *high;   // M of the node rows below and above the present row of cells
    int32_t *weights[2];   // Q30 tables of u and v: s, (1-s)^3/6 and s^3/6 rounded up
    int32_t *lattice[2];   // tables of canopy_bezier_weights of u and v
    uint32_t row;          // next row of cells
    bool have_low;         // `low` is of this row
    int32_t margin;        ///< least bound minus height so far
    uint32_t failed_cell;  ///< after CANOPY_NOT_SAFE: the first cell whose bound is too low …
    int32_t missing;       ///< … and by how much
};

/// Prepares to certify on `field`, which must be exact (else CANOPY_ARGUMENT) and stays where it is. `arena`:
/// CANOPY_CERTIFY_ARENA bytes, aligned to 8 (else CANOPY_ARENA_SHORT, CANOPY_ARENA_ALIGN), as long as it is used.
enum canopy_status canopy_certify_init(struct canopy_certify *certify, const struct canopy_field *field, void *arena,
                                       size_t bytes);

/// The same in two pieces of CANOPY_CERTIFY_TABLES and CANOPY_CERTIFY_WORK bytes, aligned to 8: others may use the
/// second from the end of one certificate to the beginning of the next. CANOPY_ARGUMENT: the field is not exact.
enum canopy_status canopy_certify_init_apart(struct canopy_certify *certify, const struct canopy_field *field,
                                             void *tables, void *work);

/// Begins with coefficients in the library's orientation: above, mirrored for the side below. They must stand within
/// +- CANOPY_COEFFICIENT_LIMIT, where nothing below overflows: else every step and cell says CANOPY_RANGE.
void canopy_certify_begin(struct canopy_certify *certify, const int32_t *coefficients);

/// Goes on at `row` with a margin of its own: for who certifies some rows of cells alone, canopy_certify_step(…, 1) or
/// more at a time.
static inline void canopy_certify_seek(struct canopy_certify *certify, uint32_t row) {
    certify->row = row;
    certify->have_low = false;
    certify->margin = INT32_MAX;
}

/// Looks at up to `rows` rows of cells. CANOPY_MORE: not finished; CANOPY_OK: every covered cell is safe, by
/// certify->margin at least; CANOPY_NOT_SAFE: certify->failed_cell lacks certify->missing. If the coefficients are
/// then raised (never lowered), the next call goes on from the row that failed.
enum canopy_status canopy_certify_step(struct canopy_certify *certify, uint32_t rows);

/// The same for one cell that has risen since it was looked at; lowers the margin as needed. Any number, any time.
enum canopy_status canopy_certify_cell(struct canopy_certify *certify, uint32_t cell);

#endif
