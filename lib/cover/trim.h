/// The trim: which part of the frame the surface is meant for, as outlines along and diagonal to knot cells (paper S0,
/// Section 6, Figure 7), and as an exact answer to "is (u, v) inside?".
///
/// The rule, cell by cell:
///   - A covered knot cell is inside, whole.
///   - An uncovered cell of whose four neighbours exactly two are covered, two that share a corner, is cut along its
///     diagonal: the triangle at that corner is inside. So staircases of covered cells end in straight lines.
///   - Any other cell is outside: also a notch (three covered neighbours) and a hole of one cell (four).
/// Beyond the frame nothing is covered. The trim is the closed union: its edges belong to it.
///
/// Outlines are closed polygons of knots, counter-clockwise seen with u to the right and v up, and holes are clockwise:
/// the inside is always on the left. Corners are where the direction changes, and nowhere else. Every polygon is
/// simple; two may touch at a corner, where covered cells meet diagonally and no triangle joins them. A piece that
/// hangs together along edges is one counter-clockwise polygon and a clockwise one for each gap in it. What several
/// pieces enclose that touch at corners only is no gap in any of them and has no polygon.
///
/// Removing specks and closing small holes changes what was seen; it is done on a copy of the mask, if it is asked for.
#ifndef CANOPY_COVER_TRIM_H
#define CANOPY_COVER_TRIM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/arena.h"
#include "lib/cover/envelope.h"
#include "lib/status.h"

/// What of a knot cell is inside.
enum canopy_trim_shape {
    CANOPY_TRIM_NOTHING = 0,
    CANOPY_TRIM_ALL,
    CANOPY_TRIM_CORNER_00,  ///< the triangle at the cell's corner (h, w) …
    CANOPY_TRIM_CORNER_01,  ///< … (h, w + 1) …
    CANOPY_TRIM_CORNER_10,  ///< … (h + 1, w) …
    CANOPY_TRIM_CORNER_11   ///< … (h + 1, w + 1)
};

/// The rule above for knot cell (h, w), h < m - 1, w < n - 1. size = {m, n}; `coverage` as in struct canopy_envelope.
enum canopy_trim_shape canopy_trim_shape(const uint16_t size[2], const uint8_t *coverage, uint32_t h, uint32_t w);

/// Whether (u, v), quanta from the frame's origin, is inside or on an edge of the trim. Exact; outside the frame false.
bool canopy_trim_holds(const struct canopy_envelope *envelope, uint32_t u, uint32_t v);

/// canopy_envelope_height inside the trim. CANOPY_OUT_OF_FRAME: beside the frame; CANOPY_EMPTY: outside the trim; the
/// bounds are then unchanged.
enum canopy_status canopy_trim_height(const struct canopy_envelope *envelope, uint32_t u, uint32_t v, int32_t *low,
                                      int32_t *high);

struct canopy_trim_corner {
    uint16_t u, v;  ///< knots: 0 to m - 1, 0 to n - 1
};

/// One polygon: corners[first] … corners[first + count - 1], and back to the first.
struct canopy_trim_polygon {
    uint32_t first, count;
    int32_t twice_area;  ///< in knot cells; negative for a hole
};

struct canopy_trim_outline {
    struct canopy_trim_corner *corners;
    struct canopy_trim_polygon *polygons;
    uint32_t corner_count, polygon_count;
    uint32_t room;   // corners there is memory for
    uint32_t chain;  // corners of the polygon being traced, at the end of `corners`, the last one first
    uint8_t *marks;  // four bits a knot
};

/// Bytes of arena for outlines of up to `corners` corners in all.
#define CANOPY_TRIM_ARENA(m, n, corners)                                                                               \
    (CANOPY_ARENA_ROUND(4U * (size_t)(corners)) +                                                                      \
     CANOPY_ARENA_ROUND(sizeof(struct canopy_trim_polygon) * ((size_t)(corners) / 3U)) +                               \
     CANOPY_ARENA_ROUND(((size_t)(m) * (size_t)(n) + 1U) / 2U))

/// No outline has more corners. What scans leave has about 4 (m + n).
#define CANOPY_TRIM_CORNERS_MOST(m, n) (2U * (size_t)(m) * (size_t)(n))

/// Traces all outlines into the arena, in no particular order. Linear in m n.
/// CANOPY_EMPTY: nothing is covered. CANOPY_RANGE: they have more than `corners` corners; the outline is of no use.
enum canopy_status canopy_trim_trace(struct canopy_trim_outline *outline, const uint16_t size[2],
                                     const uint8_t *coverage, uint32_t corners, void *arena, size_t bytes);

/// Copies the mask with every hole of one cell closed: an uncovered cell whose four neighbours are covered. Returns how
/// many there were. `to`: CANOPY_COVERAGE_BYTES, not the mask itself.
uint32_t canopy_trim_close(const uint16_t size[2], const uint8_t *coverage, uint8_t *to);

/// Copies the mask without specks: covered cells none of whose eight neighbours is covered. Returns how many.
uint32_t canopy_trim_clean(const uint16_t size[2], const uint8_t *coverage, uint8_t *to);

#endif
