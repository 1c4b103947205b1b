/// The ring: a field that moves, for belts and rotating heads (cover.md 5, "a moving scene").
///
/// Along u the scene has no end. Its *knot rows*, one knot interval of u each, are numbered for ever (64 bits): row r
/// is u from base + r * pitch on. The ring has some of them:
///
///     dropped … | guard |   window: closed rows   |   open rows   | … ahead
///               first   first + 1                 first + m - 1   first + m - 1 + open
///
/// Readings enter where they belong, as long as their row is in the ring. As the scene moves on (canopy_ring_reach) an
/// open row closes, the oldest row of the window is dropped, and the frame's origin moves by one pitch: whole numbers,
/// nothing is resampled. m x n coefficients cover the window, m - 1 knot rows; what is published is always this
/// unrolled window, with the plain formula of the surface. The first of its rows is a *guard*: it holds coefficients
/// but no readings, and its coverage is empty. So a row that leaves changes no coefficient, and the surface over a row
/// stays as it is from the time that CANOPY_REFIT_REACH + 5 rows have followed it until it is dropped, unless late
/// readings reach it. Open rows are not published: nothing is claimed about a row that is still being scanned. With
/// several scanners along the belt, `open` is as many rows as the last of them is behind the first.
///
/// A belt may run along x or y, in either direction (enum canopy_heading). Coordinates along it are int32_t as anywhere
/// and wrap modulo 2^32, as an encoder does; the ring knows which turn is meant, because it takes the nearest one. The
/// origin of the published frame wraps with them: it is device coordinates, so the distance along the belt of a point
/// from it is a difference modulo 2^32 (or the period). first_row says which row it is without a doubt.
///
/// A rotating head is a belt whose coordinate is the angle: `period` counts a turn, after which it begins again with 0.
/// The spline is not periodic, so the window slides round and round, open, with the newest sector at its end. With more
/// than one turn of rows in it (m - 2 rows >= a turn and the reach of the refit), every sector is covered, the newest
/// ones twice: the later row counts.
///
/// Rows are dropped by position, as above, and by age (canopy_ring_expire): a row goes as a whole when its oldest
/// reading is too old, and its place is not covered from then on.
///
/// What has moved is moved in memory too, a memmove of the field a row: so the window is at all times an ordinary field
/// that every other part of the library can read. On a Cortex-M3 that is an eighth of what the refit of a row costs
/// (docs/belts.md). Fixed point only: a float has no place for a coordinate that grows without end.
#ifndef CANOPY_COVER_RING_H
#define CANOPY_COVER_RING_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/arena.h"
#include "lib/cover/envelope.h"
#include "lib/cover/field.h"
#include "lib/cover/frame.h"
#include "lib/cover/refit.h"
#include "lib/status.h"

/// Which way u grows; v is 90 degrees to its left, seen from above.
enum canopy_heading { CANOPY_ALONG_X = 0, CANOPY_ALONG_Y = 1, CANOPY_AGAINST_X = 2, CANOPY_AGAINST_Y = 3 };

struct canopy_ring_config {
    struct canopy_grid grid;  ///< size[0] = m along the belt, size[1] = n across it
    int32_t low[3], high[3];  ///< a box in device units: m - 1 rows long, as wide and high as the scene (canopy_frame)
    uint8_t heading;          ///< enum canopy_heading. Row 0 begins at the box's end where u is least, and is open
    const struct canopy_line_fit *fit;  ///< arithmetic of the solves (canopy_fast_init)
    uint16_t lines;                     ///< a knot interval of u (canopy_fast_init)
    uint16_t open;                      ///< open rows, at least 1
    uint32_t period;                    ///< after which the coordinate along u begins again; 0: 2^32
};

/// What is known of a knot row beside its cells.
struct canopy_ring_row {
    uint64_t oldest_us;  ///< when its oldest reading was taken; UINT64_MAX without any
    uint32_t readings;   ///< accepted, modulo 2^32
};

struct canopy_ring {
    struct canopy_field field;     ///< the window, in the belt's own coordinates (u, v, height)
    struct canopy_field intake;    // the same and the open rows behind it
    struct canopy_refit refit;     ///< the window's coefficients
    struct canopy_ring_row *rows;  // of the intake
    int64_t first;                 ///< the guard's row number
    int64_t base;                  // u where row 0 begins
    int64_t end;                   // u where the intake ends …
    uint32_t end_low;              // … modulo the period
    uint32_t period;
    uint16_t open;
    uint8_t heading;
};

/// Bytes of arena. `cells` is Q.
#define CANOPY_RING_ARENA(m, n, cells, lines, open)                                                                    \
    (CANOPY_FIELD_ARENA((size_t)(m) + (open), n, cells, cells) + CANOPY_REFIT_ARENA(m, n, cells, cells, lines) +       \
     CANOPY_ARENA_ROUND(((size_t)(m)-1U + (open)) * sizeof(struct canopy_ring_row)))

/// Makes an empty ring. CANOPY_ARGUMENT: a member is out of its range, or the ring is longer than 2^31 - 1 device
/// units; CANOPY_ARENA_SHORT, CANOPY_ARENA_ALIGN. The ring must not be moved in memory.
enum canopy_status canopy_ring_init(struct canopy_ring *ring, const struct canopy_ring_config *config, void *arena,
                                    size_t bytes);

/// Forgets all readings and begins with row `first` as the first open one. CANOPY_ARGUMENT: its place is beyond +-
/// 2^62; nothing is changed.
enum canopy_status canopy_ring_restart(struct canopy_ring *ring, int64_t first);

/// A place in the belt's coordinates.
struct canopy_ring_place {
    int64_t u;  ///< along, without end
    int64_t v;  ///< across, device units
};

/// The place of a point in device units; u is the one nearest to the end of the open rows, so the point must be within
/// half a period of it.
struct canopy_ring_place canopy_ring_place_of(const struct canopy_ring *ring, int32_t x, int32_t y);

/// The number of the row at u.
int64_t canopy_ring_row_at(const struct canopy_ring *ring, int64_t u);

/// What is known of a row. CANOPY_DROPPED: it has left the ring, or is the guard; CANOPY_AHEAD: it is not in it yet;
/// *info is then unchanged.
enum canopy_status canopy_ring_row(const struct canopy_ring *ring, int64_t row, struct canopy_ring_row *info);

/// What a reading did to the ring.
struct canopy_ring_hit {
    int64_t row;
    uint32_t cell;   ///< index into field.heights, if `closed`
    int32_t height;  ///< in steps
    bool raised;     ///< its cell was lower, or empty
    bool closed;     ///< its row is in the window: the refit knows
};

/// Takes one reading, height in device units. CANOPY_DROPPED: its row has left the ring; CANOPY_AHEAD: it is not in it
/// yet (canopy_ring_reach); CANOPY_OUT_OF_FRAME: beside the belt; CANOPY_RANGE: as canopy_field_insert_fx. The ring is
/// then unchanged.
enum canopy_status canopy_ring_insert(struct canopy_ring *ring, const struct canopy_ring_place *place, int32_t z,
                                      uint64_t now_us, struct canopy_ring_hit *hit);

/// Moves on until the row at u is open; does nothing where it is already, or has been, nor beyond
/// 2^62. Returns by how many rows.
uint64_t canopy_ring_reach(struct canopy_ring *ring, int64_t u);

/// Forgets all rows with a reading older than `before_us`. Returns how many of them were in the window.
uint32_t canopy_ring_expire(struct canopy_ring *ring, uint64_t before_us);

/// Whether two rings can be merged, and if not, why not. Rings that are not at the same row, or have not as many open
/// ones, differ in their origin.
enum canopy_difference canopy_ring_difference(const struct canopy_ring *a, const struct canopy_ring *b);

/// Merges the readings of `other` into `ring`: cells by maximum (associative, commutative, idempotent), the age of a
/// row by its oldest reading. Readings are added up: merge each ring once. CANOPY_ARGUMENT: canopy_ring_difference says
/// why; nothing is changed.
enum canopy_status canopy_ring_merge(struct canopy_ring *ring, const struct canopy_ring *other);

/// The frame of the window as it is now, in device coordinates.
void canopy_ring_frame(const struct canopy_ring *ring, struct canopy_frame *frame);

/// Fills in all of *envelope, whose pointers have room for the window: its certificate covers exactly the readings
/// accepted in the closed rows of the window that have not been forgotten, `points` of them, and first_row is the
/// guard's number. CANOPY_MORE: the refit has to go on, not every cell is certified; CANOPY_EMPTY: no reading is in the
/// window. The envelope is then unchanged. O(cells of the window).
enum canopy_status canopy_ring_publish(const struct canopy_ring *ring, struct canopy_envelope *envelope);

#endif
