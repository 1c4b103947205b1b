/// The bounded streaming field: the highest point of every cell, and nothing else (cover.md 5).
///
/// Each knot interval is cut into cells[0] x cells[1] cells. A point raises its cell and is forgotten, so memory is
/// fixed and a point costs the same however many there are. Two fields of one frame merge by maximum.
///
/// Heights are steps of the frame, rounded up, and mirrored for the side below: inside the library the surrogate is
/// always above. A cell without data is CANOPY_NO_HEIGHT, also when data surround it.
///
/// A field keeps four bytes a cell, or, *packed*, one: four times the cells in the same memory make a tighter surface,
/// although heights are rounded up to what the code can tell (packed.h; docs/fields.md). Both are filled, read, merged
/// and certified alike.
///
/// A cell is exact where pitch is a multiple of cells, as it is for cells = frame.cells: its edges are whole quanta,
/// and a point lies in the closed cell it raises. Otherwise the field is *approximate*: in fixed point the argument
/// still holds, in float a point may stand in the neighbour of its cell, and a certificate from the field is refused.
#ifndef CANOPY_COVER_FIELD_H
#define CANOPY_COVER_FIELD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/arena.h"
#include "lib/cover/frame.h"
#include "lib/cover/line.h"
#include "lib/cover/packed.h"
#include "lib/status.h"

/// Bytes of arena of a field of m x n coefficients with cu x cv cells a knot interval.
#define CANOPY_FIELD_ARENA(m, n, cu, cv)                                                                               \
    CANOPY_ARENA_ROUND(4U * (size_t)(cu) * ((size_t)(m)-1U) * (size_t)(cv) * ((size_t)(n)-1U))

/// The same of a packed field: a byte for each cell, and four for each knot cell.
#define CANOPY_FIELD_PACKED_ARENA(m, n, cu, cv)                                                                        \
    (CANOPY_ARENA_ROUND((size_t)(cu) * ((size_t)(m)-1U) * (size_t)(cv) * ((size_t)(n)-1U)) +                           \
     CANOPY_ARENA_ROUND(4U * ((size_t)(m)-1U) * ((size_t)(n)-1U)))

/// One axis of a field, in quanta.
struct canopy_field_axis {
    int32_t origin;       // the frame's; 0 in a turned one, whose points come as offsets
    uint32_t extent;      // the far edge, from the origin; at most what an int32_t can reach
    uint32_t reciprocal;  // floor(2^32 * cells / pitch)
    uint32_t cell;        // pitch / cells where exact, else 0
    uint32_t count;       ///< cells along the axis
    uint32_t pitch;
    uint16_t cells;   ///< a knot interval
    uint8_t shift;    // offset / cell is (offset * factor >> 32) >> shift, offsets below 2^31 …
    uint32_t factor;  // … or 0: it is not
};

/// How a z in quanta becomes a height in steps: base + (z - low) * factor, the mirror of the side below included.
struct canopy_field_heights {
    int32_t low;
    uint32_t span;  // for low <= z < low + span; others, and all where a step is more than a quantum, go the long way
    int32_t factor, base;
};

struct canopy_field;

/// The two accesses that differ in a packed field. A value, so that programs without packed fields link none of it.
struct canopy_field_packing {
    int32_t (*packed_height)(const struct canopy_field *field, uint32_t cell);
    bool (*packed_raise)(struct canopy_field *field, uint32_t cell, int32_t height);
};

struct canopy_field {
    bool exact;        ///< every cell edge is a whole quantum
    int32_t *heights;  ///< axis[0].count x axis[1].count, row (u) order; NULL in a packed field
    const struct canopy_field_packing *packing;  ///< of a packed field, else NULL
    uint8_t *codes;                              ///< packed: the same of their codes (packed.h), else NULL
    int32_t *tops;  ///< packed: of the knot cells, row order; CANOPY_NO_HEIGHT without data
    struct canopy_field_heights z;
    struct canopy_field_axis axis[2];
    struct canopy_frame frame;
};

/// What a point did to the field.
struct canopy_field_hit {
    uint32_t cell;   ///< in row order
    int32_t height;  ///< the point's height in steps
    bool raised;     ///< the cell was lower, or empty (packed: its code changed)
};

/// Where a reading may be: along the frame's axes, from its origin, in quanta times 2^30, ends included; and the
/// highest it can be there (mirrored for the side below: minus the lowest).
struct canopy_field_box_fx {
    int64_t low[2], high[2], top;
};

/// The same in float: device units, from the origin in a turned frame. In a frame with axes x, y, z they are the
/// coordinates themselves (top: mirrored for the side below).
struct canopy_field_box_f32 {
    float low[2], high[2], top;
};

#define CANOPY_FIELD_BOX_CELLS 1024  ///< most cells that one box may raise

/// What a box did to the field: it raised rows first[0] … last[0], columns first[1] … last[1].
struct canopy_field_patch {
    uint32_t first[2], last[2];
    int32_t height;   ///< the box's top in steps
    uint32_t raised;  ///< how many of the cells were lower, or empty
    bool partly;      ///< the box reaches beyond the frame: only the part inside counts
};

/// Makes an empty field of a frame, which it copies. cells: a knot interval in u and v, each 1 to CANOPY_CELLS_MAX and
/// at most the pitch (else CANOPY_ARGUMENT). `arena`: CANOPY_FIELD_ARENA bytes, aligned to 8 (else CANOPY_ARENA_SHORT,
/// CANOPY_ARENA_ALIGN), the field's as long as it is used.
enum canopy_status canopy_field_init(struct canopy_field *field, const struct canopy_frame *frame,
                                     const uint16_t cells[2], void *arena, size_t bytes);

/// The same, packed. An insertion that raises a knot cell's top writes all its cells anew, so it costs up to
/// cells[0] * cells[1] times 30 instructions; tops rise in steps of 2^16 of the frame's, so it does so seldom.
enum canopy_status canopy_field_init_packed(struct canopy_field *field, const struct canopy_frame *frame,
                                            const uint16_t cells[2], void *arena, size_t bytes);

/// Forgets all data.
void canopy_field_clear(struct canopy_field *field);

/// The highest that may be in a cell, in steps, or CANOPY_NO_HEIGHT. `cell` counts in row order.
static inline int32_t canopy_field_height(const struct canopy_field *field, uint32_t cell) {
    return field->heights != NULL ? field->heights[cell] : field->packing->packed_height(field, cell);
}

/// Raises a cell to a height of at least -CANOPY_HEIGHT_LIMIT. False if it was as high.
static inline bool canopy_field_raise_cell(struct canopy_field *field, uint32_t cell, int32_t height) {
    if (field->heights == NULL) {
        return field->packing->packed_raise(field, cell, height);
    }
    const bool raised = height > field->heights[cell];
    field->heights[cell] = raised ? height : field->heights[cell];
    return raised;
}

/// Takes one point in device units of the frame's scalar. The frame's axes must be x, y, z (else: lib/cover/turn.h).
/// CANOPY_OUT_OF_FRAME: beside the frame. CANOPY_RANGE: too far beyond the frame's heights on the side that matters
/// (the other side is taken as the lowest height there is). The field is then unchanged. NaN and infinities are no
/// readings: CANOPY_OUT_OF_FRAME.
enum canopy_status canopy_field_insert_fx(struct canopy_field *field, const int32_t point[3],
                                          struct canopy_field_hit *hit);
enum canopy_status canopy_field_insert_f32(struct canopy_field *field, const float point[3],
                                           struct canopy_field_hit *hit);

/// Takes a reading that may be anywhere in a box: raises every cell that the box meets, of the field's frame in any
/// direction. A box beyond the frame's edges counts as far as it is inside, and patch->partly says so.
/// CANOPY_OUT_OF_FRAME: all of it is beside the frame, or it is no box (an end that is no number, low above high).
/// CANOPY_ARGUMENT: it meets more than CANOPY_FIELD_BOX_CELLS cells. CANOPY_RANGE: as above. The field is then
/// unchanged. Cost: the cells.
enum canopy_status canopy_field_insert_box_fx(struct canopy_field *field, const struct canopy_field_box_fx *box,
                                              struct canopy_field_patch *patch);
enum canopy_status canopy_field_insert_box_f32(struct canopy_field *field, const struct canopy_field_box_f32 *box,
                                               struct canopy_field_patch *patch);

/// Raises the cells of a patch, which are the field's, to its height; sets patch->raised. CANOPY_ARGUMENT: they are
/// more than CANOPY_FIELD_BOX_CELLS; nothing is changed.
enum canopy_status canopy_field_raise(struct canopy_field *field, struct canopy_field_patch *patch);

/// Takes `count` points; returns how many of them were refused.
size_t canopy_field_feed_fx(struct canopy_field *field, const int32_t (*points)[3], size_t count);
size_t canopy_field_feed_f32(struct canopy_field *field, const float (*points)[3], size_t count);

/// Whether two fields can be merged, and if not, why not: their frames, and the cells that each has a knot interval.
enum canopy_difference canopy_field_difference(const struct canopy_field *a, const struct canopy_field *b);

/// Merges `other` into `field` by maximum: what both fields would be had either taken all readings. It does not matter
/// in which order or how often fields are merged (associative, commutative, idempotent), so several scanners, cores or
/// machines may each keep a field of one frame. CANOPY_ARGUMENT: canopy_field_difference says why; nothing is changed.
/// Linear in the cells.
enum canopy_status canopy_field_merge(struct canopy_field *field, const struct canopy_field *other);

/// One bit a knot cell with data, as struct canopy_envelope has it. Returns how many are set.
uint32_t canopy_field_coverage(const struct canopy_field *field, uint8_t *bits);

#endif
