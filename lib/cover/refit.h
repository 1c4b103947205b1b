/// Fits again what has changed: a field that evolves, row by row, at the price of the rows that did.
///
/// It is the fast method (fast.h) with a memory. Every line knows whether its cells changed since it was fitted; only
/// such lines are fitted again. The columns follow, but only near those lines: a column's solution forgets what happens
/// a knot interval away by a factor of 0.27 or so (the root of the B-spline's tridiagonal recurrence), so the
/// coefficients up to CANOPY_REFIT_REACH rows to either side are solved for and all others are pinned where they are.
/// What the reach leaves out costs tightness, 0.27^5 = 0.14 % of the change, and never safety: each column is lifted
/// above all lines that its new coefficients concern (canopy_line_lift), and a knot row is certified again whenever one
/// of the coefficients that shape it, or one of its cells, has changed. What was proved of the other rows stays proved.
///
/// A knot row is one row of knot intervals, cells[0] rows of cells; a line stands between two of them (or, with more
/// lines than one a knot interval, inside).
///
///     canopy_refit_init(&refit, &field, &canopy_line_fit_fx, 1, arena, bytes);
///     for (;;) {
///         … insert readings; each that raised a cell: canopy_refit_rose(&refit, hit.cell) …
///         canopy_refit_begin(&refit);
///         while ((status = canopy_refit_step(&refit, 1)) == CANOPY_MORE) { … more readings, same rule … }
///         if (status == CANOPY_OK && canopy_refit_is_certified(&refit)) publish refit.coefficients
///     }
///
/// Readings may come between any two steps: a cell that rises voids the certificate of its knot row, whatever stage the
/// refit is in, and canopy_refit_step does not say CANOPY_OK before every such row has been certified again (raised by
/// canopy_fast_raise where the fit knew nothing of the reading). The line is fitted with it in the next refit.
#ifndef CANOPY_COVER_REFIT_H
#define CANOPY_COVER_REFIT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/arena.h"
#include "lib/cover/certify.h"
#include "lib/cover/fast.h"
#include "lib/cover/field.h"
#include "lib/status.h"

#define CANOPY_REFIT_REACH 4  ///< rows of coefficients solved for on either side of a line that changed

/// Bytes of arena for m x n coefficients on a field of cu x cv cells a knot interval, `lines` a knot interval of u.
#define CANOPY_REFIT_ARENA(m, n, cu, cv, lines)                                                                        \
    (CANOPY_FAST_ARENA(m, n, cv, lines) + CANOPY_CERTIFY_ARENA(n, cu, cv) +                                            \
     CANOPY_ARENA_ROUND(4U * (size_t)(m) * (size_t)(n)) + CANOPY_ARENA_ROUND(CANOPY_LINE_NODES(m, lines)) +            \
     4U * CANOPY_ARENA_ROUND(4U * (size_t)(m)) + CANOPY_ARENA_ROUND(m) + CANOPY_ARENA_ROUND(n))

enum canopy_refit_stage {
    CANOPY_REFIT_IDLE,
    CANOPY_REFIT_LINES,
    CANOPY_REFIT_COLUMNS,
    CANOPY_REFIT_CERTIFY,
    CANOPY_REFIT_FAILED
};

struct canopy_refit {
    struct canopy_fast fast;        // the lines' coefficients, and the memory to fit one line
    struct canopy_certify certify;  // one knot row at a time
    int32_t *coefficients;          ///< m x n, the library's orientation: above, mirrored for the side below
    uint8_t *lines;                 // one enum line_state a line
    uint8_t *uncertified;           // one flag a knot row: a cell or a coefficient has changed
    int32_t *margins;               // of the knot rows, INT32_MAX where nothing is covered
    int32_t *low, *high;            // of the knot rows: all heights are between; INT32_MAX, INT32_MIN: no data
    int32_t *pins;                  // of the column in work
    uint8_t *blank;                 // one flag a column: nothing to be seen in the run in work
    uint8_t stage;                  ///< enum canopy_refit_stage
    bool begun;                     // the line or column in work has begun
    uint32_t index;                 // line, column or knot row in work
    uint32_t first, last;           // the run of rows of coefficients in work: these are solved for
    uint32_t run_line, next_line;   // its first line, and where to look for the next run
    uint32_t changed_first;         ///< rows of coefficients that have changed since canopy_refit_begin: the first …
    uint32_t changed_end;           ///< … and the one behind the last; none where it is not greater
    uint32_t solves;                ///< banded solves of this refit so far
    uint32_t fitted;                ///< lines fitted in this refit so far
    uint32_t certified;             ///< knot rows certified in this refit so far
};

/// Prepares for `field`, which must be exact and outlive the refit; all of it counts as changed. Else as
/// canopy_fast_init.
enum canopy_status canopy_refit_init(struct canopy_refit *refit, const struct canopy_field *field,
                                     const struct canopy_line_fit *fit, uint16_t lines, void *arena, size_t bytes);

/// The cell has risen, or is new. O(1); in a packed field O(cells of its knot row). For a cell of canopy_field_hit; the
/// field itself holds the height.
void canopy_refit_rose(struct canopy_refit *refit, uint32_t cell);

/// The cells of `count` knot rows from `row` on may have changed in any way. O(cells of these rows).
void canopy_refit_changed(struct canopy_refit *refit, uint32_t row, uint32_t count);

/// The field has moved on by `rows` knot rows, 1 or more: what was in row i is in row i - rows now, what came in at the
/// end may have any data, and the first knot row is empty: nothing is claimed of it any more, so that no coefficient
/// needs to change where rows leave. Ends a refit in work; its lines are not lost. O(m n) words moved, and the cells of
/// the new rows looked at.
void canopy_refit_shift(struct canopy_refit *refit, uint32_t rows);

/// Begins to fit what has changed. A refit in work ends; nothing is lost.
void canopy_refit_begin(struct canopy_refit *refit);

/// At most `budget` units of work: an iteration of a line or of a part of a column, or the certificate of a knot row.
/// CANOPY_MORE: not done. CANOPY_OK: done, and every covered cell is certified. CANOPY_RANGE: a coefficient left its
/// limit; the coefficients are of no use, and the next refit begins from nothing.
enum canopy_status canopy_refit_step(struct canopy_refit *refit, uint32_t budget);

/// Whether the coefficients, as they are, are safe for all cells, as they are.
bool canopy_refit_is_certified(const struct canopy_refit *refit);

/// Whether some line should be fitted or some knot row certified.
bool canopy_refit_is_due(const struct canopy_refit *refit);

/// The certified distance to the nearest covered cell, in steps, of canopy_refit_is_certified coefficients; INT32_MAX
/// without data.
int32_t canopy_refit_margin(const struct canopy_refit *refit);

#endif
