/// The fast safe surface: lines, then columns (paper S0, Section 6), from the bounded field.
///
/// Lines run along v, `lines` of them to a knot interval of u. Each is fitted above all cells within one line distance
/// on either side, so that the straight line between two neighbouring lines' splines is above the data between them.
/// Then each column of coefficients is fitted above the lines' coefficients, wherever a line's coefficient has data in
/// its support ("held"); the others leave their row free. N(v-j) >= 0 makes the surface safe (cover.md 3).
/// With one line a knot interval this is the paper's construction; two or four cost as many times the line solves and
/// are tighter (docs/numbers.md).
///
/// A coefficient no covered cell can see (all 4 x 4 knot cells of its support empty) shapes nothing that is covered: at
/// the end all such are set so that second differences vanish (free.h).
///
/// The field may rise between the steps of one fit: what a line has already read it no longer sees. The fit is
/// therefore a proposal; canopy_certify says whether it holds, and canopy_fast_raise mends what rose in between.
#ifndef CANOPY_COVER_FAST_H
#define CANOPY_COVER_FAST_H

#include <stddef.h>
#include <stdint.h>

#include "lib/arena.h"
#include "lib/cover/field.h"
#include "lib/cover/free.h"
#include "lib/cover/line.h"
#include "lib/status.h"

#define CANOPY_MAX(a, b) ((a) > (b) ? (a) : (b))

/// Bytes of arena of a fit of m x n coefficients, `cv` cells a knot interval along v, `lines` a knot interval of u.
#define CANOPY_FAST_ARENA(m, n, cv, lines)                                                                             \
    (CANOPY_LINE_ARENA(CANOPY_MAX(m, n), CANOPY_MAX(cv, lines)) +                                                      \
     CANOPY_ARENA_ROUND(4U * CANOPY_LINE_NODES(m, lines) * (size_t)(n)) +                                              \
     CANOPY_ARENA_ROUND(CANOPY_LINE_NODES(m, lines) * CANOPY_FAST_HELD_BYTES(n)) +                                     \
     CANOPY_ARENA_ROUND(4U * (size_t)CANOPY_MAX(m, n)))
/// Bytes of arena of a worker (canopy_fast_share).
#define CANOPY_FAST_SHARE_ARENA(m, n, cv, lines)                                                                       \
    (CANOPY_LINE_ARENA(CANOPY_MAX(m, n), CANOPY_MAX(cv, lines)) + CANOPY_ARENA_ROUND(4U * (size_t)CANOPY_MAX(m, n)))
#define CANOPY_FAST_HELD_BYTES(n) (((size_t)(n) + 7U) / 8U)

enum canopy_fast_stage {
    CANOPY_FAST_IDLE,
    CANOPY_FAST_LINES,
    CANOPY_FAST_COLUMNS,
    CANOPY_FAST_FREE,
    CANOPY_FAST_DONE,
    CANOPY_FAST_FAILED
};

struct canopy_fast {
    const struct canopy_field *field;
    const struct canopy_line_fit *fit;
    uint8_t stage;           ///< enum canopy_fast_stage
    bool begun;              // whether the line or column in work has begun …
    uint16_t lines;          ///< lines a knot interval of u; divides the field's cells
    uint32_t index;          // … and which it is
    int32_t *g;              // coefficients of the lines, (lines (m-1) + 1) x n
    uint8_t *held;           // one bit for each of them, each line from a new byte on
    int32_t *result;         // one line's coefficients
    int32_t *b;              // the caller's coefficients
    int32_t floor, ceiling;  // coefficients beyond these have exploded: one range beyond the field's
    uint32_t solves;         ///< banded solves of this fit so far
    uint32_t unsettled;      ///< lines and columns that did not end by themselves and were lifted
    struct canopy_line line;
    struct canopy_free free;
};

/// Prepares fits of `field`, which stays where it is and is read at every step. `lines` must divide its cells along u.
/// `fit` is the arithmetic of the solves, nothing else: &canopy_line_fit_f32 or &canopy_line_fit_fx. `arena`:
/// CANOPY_FAST_ARENA bytes, aligned to 8, the fit's as long as it is used. CANOPY_ARGUMENT: no fit, `lines` is 0 or
/// does not divide the cells; CANOPY_ARENA_SHORT, CANOPY_ARENA_ALIGN.
enum canopy_status canopy_fast_init(struct canopy_fast *fast, const struct canopy_field *field,
                                    const struct canopy_line_fit *fit, uint16_t lines, void *arena, size_t bytes);

/// Begins a fit into `coefficients`, m x n, which the caller leaves alone until it is done.
/// CANOPY_EMPTY: the field has no data.
enum canopy_status canopy_fast_begin(struct canopy_fast *fast, int32_t *coefficients);

/// Does at most `budget` units of work, each one iteration of one line, or a unit of free.h. CANOPY_MORE, or CANOPY_OK
/// when it is done; CANOPY_RANGE: a coefficient left its limit, the result is of no use.
/// The coefficients are in the library's orientation: above, mirrored for the side below.
enum canopy_status canopy_fast_step(struct canopy_fast *fast, uint32_t budget);

// ---- Several cores: lines need nothing of each other, and neither do columns

/// How many lines or columns the present stage has; 0 in the others.
uint32_t canopy_fast_count(const struct canopy_fast *fast);

/// Makes a worker for the present stage of a fit, lines or columns, with a line of its own in `arena`, of
/// CANOPY_FAST_SHARE_ARENA bytes; all else is the fit's, whose field must not rise while workers work. What comes out
/// is what canopy_fast_step gives, bit for bit. CANOPY_ARGUMENT: the fit is at another stage; CANOPY_ARENA_SHORT,
/// CANOPY_ARENA_ALIGN.
enum canopy_status canopy_fast_share(struct canopy_fast *worker, const struct canopy_fast *fast, void *arena,
                                     size_t bytes);

/// Fits one line or column, 0 to canopy_fast_count - 1. Workers may do so at the same time, each other ones.
void canopy_fast_fit(struct canopy_fast *worker, uint32_t index);

/// Adds what a worker has counted to the fit.
void canopy_fast_join(struct canopy_fast *fast, const struct canopy_fast *worker);

/// All lines or columns of the present stage have been fitted by workers: on to the next stage. After the columns,
/// canopy_fast_step does the rest.
void canopy_fast_end_stage(struct canopy_fast *fast);

// ---- Mending and turning round

/// Raises the 4 x 4 coefficients that shape the cell's knot cell by `by` steps: the bound of canopy_certify rises by
/// as much on the whole knot cell and falls nowhere. CANOPY_RANGE: a coefficient would leave its limit; nothing done.
enum canopy_status canopy_fast_raise(const struct canopy_field *field, int32_t *coefficients, uint32_t cell,
                                     int32_t by);

/// Turns coefficients of the library's orientation into those of an envelope and back: negates for the side below.
void canopy_fast_orient(const struct canopy_frame *frame, int32_t *coefficients);

#endif
