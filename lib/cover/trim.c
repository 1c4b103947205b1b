#include "lib/cover/trim.h"

#include <string.h>

#include "lib/num/bits.h"
#include "lib/spline/surface.h"

// ---- Cells

// Whether cell (h, w) is covered; the frame's outside, where h or w have gone below 0 too, is not.
static inline bool is_covered(const uint16_t size[2], const uint8_t *coverage, uint32_t h, uint32_t w) {
    const uint32_t across = size[1] - 1U;
    return h < size[0] - 1U && w < across && canopy_bit_get(coverage, h * across + w);
}

enum canopy_trim_shape canopy_trim_shape(const uint16_t size[2], const uint8_t *coverage, uint32_t h, uint32_t w) {
    if (is_covered(size, coverage, h, w)) {
        return CANOPY_TRIM_ALL;
    }
    const uint32_t low_u = is_covered(size, coverage, h - 1, w), high_u = is_covered(size, coverage, h + 1, w);
    const uint32_t low_v = is_covered(size, coverage, h, w - 1), high_v = is_covered(size, coverage, h, w + 1);
    if (low_u + high_u != 1 || low_v + high_v != 1) {
        return CANOPY_TRIM_NOTHING;
    }
    return (enum canopy_trim_shape)(CANOPY_TRIM_CORNER_00 + 2 * high_u + high_v);
}

// ---- Points

// Distances from the right angle, x along u and y along v: inside where x / pitch[0] + y / pitch[1] <= 1.
static bool is_in_triangle(const uint32_t pitch[2], uint32_t x, uint32_t y) {
    return (uint64_t)x * pitch[1] <= (uint64_t)(pitch[1] - y) * pitch[0];
}

// Of a cell, at du and dv quanta from its corner (h, w).
static bool cell_holds(const struct canopy_envelope *envelope, uint32_t h, uint32_t w, uint32_t du, uint32_t dv) {
    const uint32_t *pitch = envelope->frame.pitch;
    const enum canopy_trim_shape shape = canopy_trim_shape(envelope->frame.size, envelope->coverage, h, w);
    switch (shape) {
    case CANOPY_TRIM_NOTHING: return false;
    case CANOPY_TRIM_ALL: return true;
    case CANOPY_TRIM_CORNER_00: return is_in_triangle(pitch, du, dv);
    case CANOPY_TRIM_CORNER_01: return is_in_triangle(pitch, du, pitch[1] - dv);
    case CANOPY_TRIM_CORNER_10: return is_in_triangle(pitch, pitch[0] - du, dv);
    default: return is_in_triangle(pitch, pitch[0] - du, pitch[1] - dv);
    }
}

bool canopy_trim_holds(const struct canopy_envelope *envelope, uint32_t u, uint32_t v) {
    const struct canopy_frame *frame = &envelope->frame;
    if (u > canopy_frame_width(frame, 0) || v > canopy_frame_width(frame, 1)) {
        return false;
    }
    const uint32_t h = canopy_place_of(u, frame->pitch[0], frame->size[0]).interval;
    const uint32_t w = canopy_place_of(v, frame->pitch[1], frame->size[1]).interval;
    const uint32_t du = u - h * frame->pitch[0], dv = v - w * frame->pitch[1];
    const bool low_u = du == 0 && h > 0, low_v = dv == 0 && w > 0;  // on an edge: the cell beyond is closed too
    return cell_holds(envelope, h, w, du, dv) || (low_u && cell_holds(envelope, h - 1, w, frame->pitch[0], dv)) ||
           (low_v && cell_holds(envelope, h, w - 1, du, frame->pitch[1])) ||
           (low_u && low_v && cell_holds(envelope, h - 1, w - 1, frame->pitch[0], frame->pitch[1]));
}

enum canopy_status canopy_trim_height(const struct canopy_envelope *envelope, uint32_t u, uint32_t v, int32_t *low,
                                      int32_t *high) {
    int32_t bounds[2];
    const enum canopy_status status = canopy_envelope_height(envelope, u, v, &bounds[0], &bounds[1]);
    if (status != CANOPY_OK) {
        return status;
    }
    if (!canopy_trim_holds(envelope, u, v)) {
        return CANOPY_EMPTY;
    }
    *low = bounds[0];
    *high = bounds[1];
    return CANOPY_OK;
}

// ---- Outlines
//
// Around a knot there are eight octants, 0 from u towards v; direction d lies between octants d - 1 and d, and leads to
// a neighbouring knot. A *wedge* is a run of filled octants; the outline comes in along its last direction and leaves
// along its first, so that the inside is on the left. No wedge is narrower than a right angle and no gap than half of
// one, so a knot has two wedges at most; where it has two, both are covered cells, and the knot is a *touching* one.
//
// Traced so, an outline may come to a touching knot twice. The way between the two visits is then a polygon of its own
// and taken off: it is a gap that hangs together with what is beyond at that knot only.

enum {
    MARK_FIRST = 1,   // the outline that leaves along the first wedge of the knot has been traced
    MARK_SECOND = 2,  // the second
    MARK_CHAIN = 4    // the knot is a corner of the chain
};

static uint8_t marks_at(const struct canopy_trim_outline *outline, uint32_t knot) {
    return (uint8_t)(outline->marks[knot / 2] >> (knot % 2 * 4) & 15U);
}

static void set_mark(struct canopy_trim_outline *outline, uint32_t knot, uint8_t mark) {
    outline->marks[knot / 2] = (uint8_t)(outline->marks[knot / 2] | (uint32_t)mark << (knot % 2 * 4));
}

static void clear_mark(struct canopy_trim_outline *outline, uint32_t knot, uint8_t mark) {
    outline->marks[knot / 2] = (uint8_t)(outline->marks[knot / 2] & ~((uint32_t)mark << (knot % 2 * 4)));
}

// What the cell on one side of a knot fills of its two octants, 1 for the one beside the u axis, 2 for the other. The
// knot is the cell's corner (a, b).
static uint32_t fill_of(enum canopy_trim_shape shape, uint32_t a, uint32_t b) {
    if (shape <= CANOPY_TRIM_ALL) {
        return shape == CANOPY_TRIM_ALL ? 3 : 0;
    }
    const uint32_t corner = (uint32_t)shape - CANOPY_TRIM_CORNER_00;
    const bool same_a = corner / 2 == a, same_b = corner % 2 == b;
    return same_a ? (same_b ? 3 : 2) : (same_b ? 1 : 0);
}

struct plane {
    const uint16_t *size;
    const uint8_t *coverage;
};

// The cell that has knot (u, v) as its corner (a, b).
static uint32_t fill_at(const struct plane *plane, uint32_t u, uint32_t v, uint32_t a, uint32_t b) {
    const uint32_t h = u - a, w = v - b;
    if (h >= plane->size[0] - 1U || w >= plane->size[1] - 1U) {
        return 0;
    }
    return fill_of(canopy_trim_shape(plane->size, plane->coverage, h, w), a, b);
}

static uint32_t swap_pair(uint32_t pair) { return (pair >> 1 | pair << 1) & 3U; }

// The filled octants around a knot, one bit each.
static uint32_t octants_at(const struct plane *plane, uint32_t u, uint32_t v) {
    return fill_at(plane, u, v, 0, 0) | swap_pair(fill_at(plane, u, v, 1, 0)) << 2 | fill_at(plane, u, v, 1, 1) << 4 |
           swap_pair(fill_at(plane, u, v, 0, 1)) << 6;
}

static inline bool is_filled(uint32_t octants, uint32_t octant) { return (octants >> (octant & 7U) & 1U) != 0; }

// The first directions of all wedges, one bit each.
static uint32_t starts_of(uint32_t octants) { return octants & ~(octants << 1 | octants >> 7); }

static inline bool is_single(uint32_t bits) { return (bits & (bits - 1)) == 0; }

// The first direction of the wedge whose last one is `last`.
static uint32_t start_of_wedge(uint32_t octants, uint32_t last) {
    uint32_t direction = last;
    do {
        direction = (direction + 7) & 7U;
    } while (is_filled(octants, direction + 7));
    return direction;
}

static uint32_t end_of_wedge(uint32_t octants, uint32_t first) {
    uint32_t direction = first;
    do {
        direction = (direction + 1) & 7U;
    } while (is_filled(octants, direction));
    return direction;
}

static uint8_t mark_of(uint32_t starts, uint32_t direction) {
    return (starts & ((1U << direction) - 1)) == 0 ? MARK_FIRST : MARK_SECOND;
}

static void step(uint32_t direction, uint32_t *u, uint32_t *v) {
    static const int32_t by[8][2] = {{1, 0}, {1, 1}, {0, 1}, {-1, 1}, {-1, 0}, {-1, -1}, {0, -1}, {1, -1}};
    *u += (uint32_t)by[direction][0];
    *v += (uint32_t)by[direction][1];
}

static int32_t twice_area(const struct canopy_trim_corner *corners, uint32_t count) {
    int64_t sum = 0;
    for (uint32_t k = 0; k < count; k++) {
        const struct canopy_trim_corner a = corners[k], b = corners[k + 1 < count ? k + 1 : 0];
        sum += (int32_t)a.u * b.v - (int32_t)b.u * a.v;
    }
    return (int32_t)sum;
}

// Takes the last `count` corners off the chain: they are a polygon.
static void take_off(struct canopy_trim_outline *outline, uint32_t count, uint32_t n) {
    struct canopy_trim_corner *to = outline->corners + outline->corner_count;
    struct canopy_trim_corner *from = outline->corners + (outline->room - outline->chain);
    for (uint32_t k = 0; k < count / 2; k++) {  // the chain stands the last one first
        const struct canopy_trim_corner corner = from[k];
        from[k] = from[count - 1 - k];
        from[count - 1 - k] = corner;
    }
    memmove(to, from, count * sizeof *to);
    for (uint32_t k = 0; k < count; k++) {
        clear_mark(outline, (uint32_t)to[k].u * n + to[k].v, MARK_CHAIN);
    }
    outline->polygons[outline->polygon_count++] =
        (struct canopy_trim_polygon){outline->corner_count, count, twice_area(to, count)};
    outline->corner_count += count;
    outline->chain -= count;
}

// How many corners the chain has from (u, v) on.
static uint32_t count_from(const struct canopy_trim_outline *outline, uint32_t u, uint32_t v) {
    const struct canopy_trim_corner *corner = outline->corners + (outline->room - outline->chain);
    uint32_t count = 1;
    for (; corner->u != u || corner->v != v; corner++) {
        count++;
    }
    return count;
}

// Adds a corner to the chain; false if there is no room.
static bool add_corner(struct canopy_trim_outline *outline, uint32_t u, uint32_t v, uint32_t n) {
    if (outline->corner_count + outline->chain >= outline->room) {
        return false;
    }
    outline->chain++;
    outline->corners[outline->room - outline->chain] = (struct canopy_trim_corner){(uint16_t)u, (uint16_t)v};
    set_mark(outline, u * n + v, MARK_CHAIN);
    return true;
}

// Traces the outline that leaves knot (u, v), a corner of it, along `direction`. False if there is no room.
static bool trace(struct canopy_trim_outline *outline, const struct plane *plane, uint32_t u, uint32_t v,
                  uint32_t direction) {
    const uint32_t n = plane->size[1], first_u = u, first_v = v, first = direction;
    uint32_t starts = starts_of(octants_at(plane, u, v));
    bool corner = true;
    do {
        const uint32_t knot = u * n + v;
        if (!is_single(starts) && (marks_at(outline, knot) & MARK_CHAIN) != 0) {
            take_off(outline, count_from(outline, u, v), n);
        }
        if (corner && !add_corner(outline, u, v, n)) {
            return false;
        }
        set_mark(outline, knot, mark_of(starts, direction));
        step(direction, &u, &v);
        const uint32_t octants = octants_at(plane, u, v), next = start_of_wedge(octants, (direction + 4) & 7U);
        corner = next != direction;
        direction = next;
        starts = starts_of(octants);
    } while (u != first_u || v != first_v || direction != first);
    take_off(outline, outline->chain, n);
    return true;
}

// Traces what leaves a knot and has not been traced. The first corner of an outline, by u and v, is met first.
static bool trace_from(struct canopy_trim_outline *outline, const struct plane *plane, uint32_t u, uint32_t v) {
    const uint32_t octants = octants_at(plane, u, v), starts = starts_of(octants), knot = u * plane->size[1] + v;
    for (uint32_t direction = 0; direction < 8; direction++) {
        if ((starts >> direction & 1U) == 0 || (marks_at(outline, knot) & mark_of(starts, direction)) != 0 ||
            end_of_wedge(octants, direction) == (direction + 4) % 8) {
            continue;
        }
        if (!trace(outline, plane, u, v, direction)) {
            return false;
        }
    }
    return true;
}

enum canopy_status canopy_trim_trace(struct canopy_trim_outline *outline, const uint16_t size[2],
                                     const uint8_t *coverage, uint32_t corners, void *arena, size_t bytes) {
    struct canopy_arena cut;
    const size_t knots = (size_t)size[0] * size[1];
    const enum canopy_status status =
        canopy_arena_open(&cut, arena, bytes, CANOPY_TRIM_ARENA(size[0], size[1], corners));
    if (status != CANOPY_OK) {
        return status;
    }
    *outline = (struct canopy_trim_outline){.room = corners};
    outline->corners = canopy_arena_take(&cut, sizeof *outline->corners * corners);
    outline->polygons = canopy_arena_take(&cut, sizeof *outline->polygons * (corners / 3U));
    outline->marks = canopy_arena_take(&cut, (knots + 1) / 2);
    memset(outline->marks, 0, (knots + 1) / 2);
    const struct plane plane = {size, coverage};
    for (uint32_t u = 0; u < size[0]; u++) {
        for (uint32_t v = 0; v < size[1]; v++) {
            if (!trace_from(outline, &plane, u, v)) {
                return CANOPY_RANGE;
            }
        }
    }
    return outline->polygon_count > 0 ? CANOPY_OK : CANOPY_EMPTY;
}

// ---- Masks

uint32_t canopy_trim_close(const uint16_t size[2], const uint8_t *coverage, uint8_t *to) {
    uint32_t closed = 0;
    memcpy(to, coverage, CANOPY_COVERAGE_BYTES(size[0], size[1]));
    for (uint32_t h = 0; h + 1 < size[0]; h++) {
        for (uint32_t w = 0; w + 1 < size[1]; w++) {
            if (!is_covered(size, coverage, h, w) && is_covered(size, coverage, h - 1, w) &&
                is_covered(size, coverage, h + 1, w) && is_covered(size, coverage, h, w - 1) &&
                is_covered(size, coverage, h, w + 1)) {
                closed += canopy_bit_set(to, h * (size[1] - 1U) + w);
            }
        }
    }
    return closed;
}

static bool is_alone(const uint16_t size[2], const uint8_t *coverage, uint32_t h, uint32_t w) {
    for (uint32_t p = 0; p < 3; p++) {
        for (uint32_t q = 0; q < 3; q++) {
            if ((p != 1 || q != 1) && is_covered(size, coverage, h + p - 1, w + q - 1)) {
                return false;
            }
        }
    }
    return true;
}

uint32_t canopy_trim_clean(const uint16_t size[2], const uint8_t *coverage, uint8_t *to) {
    uint32_t removed = 0;
    memcpy(to, coverage, CANOPY_COVERAGE_BYTES(size[0], size[1]));
    for (uint32_t h = 0; h + 1 < size[0]; h++) {
        for (uint32_t w = 0; w + 1 < size[1]; w++) {
            if (is_covered(size, coverage, h, w) && is_alone(size, coverage, h, w)) {
                canopy_bit_clear(to, h * (size[1] - 1U) + w);
                removed++;
            }
        }
    }
    return removed;
}
