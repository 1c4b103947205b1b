#include "lib/cover/field.h"

#include <string.h>

#include "lib/cover/axes.h"
#include "lib/cover/cell.h"
#include "lib/cover/field_parts.h"
#include "lib/num/bits.h"
#include "lib/num/fixed.h"

// With s = floor(log2 d), k = 32 + s and m = 2^k / d rounded up, m d is less than d < 2^(s+1) above 2^k. So for
// n < 2^31 n m / 2^k is less than 2^31 2^(s+1) / (2^k d) = 1/d above n / d, which is too little for the next whole
// number. A power of two needs no rounding, and one bit less.
static void find_factor(struct canopy_field_axis *axis) {
    const uint32_t d = axis->cell;
    if (d < 2 || axis->extent > (uint32_t)INT32_MAX) {
        return;
    }
    uint8_t s = 0;
    while (d >> s > 1) {
        s++;
    }
    const bool power = (d & (d - 1)) == 0;
    axis->shift = power ? (uint8_t)(s - 1) : s;
    axis->factor = power ? UINT32_C(1) << 31 : (uint32_t)(((uint64_t)1 << (32 + s)) / d + 1);
}

static void init_axis(struct canopy_field_axis *axis, const struct canopy_frame *frame, int a, uint16_t cells,
                      bool straight) {
    const uint32_t pitch = frame->pitch[a];
    *axis = (struct canopy_field_axis){.origin = straight ? frame->origin[a] : 0, .pitch = pitch, .cells = cells};
    axis->count = (frame->size[a] - 1U) * cells;
    const uint64_t width = canopy_frame_width(frame, a);
    // Clipped to what coordinates can be, so that p - origin, taken modulo 2^32, is beyond it for every p outside.
    const uint32_t reach = straight ? (uint32_t)INT32_MAX - (uint32_t)frame->origin[a] : UINT32_MAX;
    axis->extent = width < reach ? (uint32_t)width : reach;
    axis->cell = pitch % cells == 0 ? pitch / cells : 0;
    const uint64_t reciprocal = ((uint64_t)cells << 32) / pitch;
    axis->reciprocal = reciprocal < UINT32_MAX ? (uint32_t)reciprocal : UINT32_MAX;
    find_factor(axis);
}

static int32_t clamp(int64_t z) { return z < INT32_MIN ? INT32_MIN : z > INT32_MAX ? INT32_MAX : (int32_t)z; }

static void init_heights(struct canopy_field_heights *z, const struct canopy_frame *frame) {
    const int32_t zero = frame->origin[2];
    *z = (struct canopy_field_heights){.low = INT32_MAX, .base = CANOPY_NO_HEIGHT};
    if (frame->lsb_log2 <= 0 && frame->lsb_log2 >= -CANOPY_RANGE_LOG2) {
        const int32_t reach = CANOPY_HEIGHT_LIMIT >> -frame->lsb_log2;
        z->low = clamp((int64_t)zero - reach);
        z->span = (uint32_t)clamp((int64_t)zero + reach) - (uint32_t)z->low;
        z->factor = (frame->side == CANOPY_BELOW ? -1 : 1) * (1 << -frame->lsb_log2);
        z->base = (z->low - zero) * z->factor;
    }
}

enum canopy_status canopy_field_start(struct canopy_field *field, const struct canopy_frame *frame,
                                      const uint16_t cells[2], struct canopy_arena *cut, void *arena, size_t bytes,
                                      size_t needed) {
    for (int a = 0; a < 2; a++) {
        if (cells[a] < 1 || cells[a] > CANOPY_CELLS_MAX || cells[a] > frame->pitch[a]) {
            return CANOPY_ARGUMENT;
        }
    }
    const enum canopy_status status = canopy_arena_open(cut, arena, bytes, needed);
    if (status != CANOPY_OK) {
        return status;
    }
    *field = (struct canopy_field){0};
    field->frame = *frame;
    const bool straight = canopy_axes_are_straight(field->frame.axis);
    for (int a = 0; a < 2; a++) {
        init_axis(&field->axis[a], frame, a, cells[a], straight);
    }
    init_heights(&field->z, frame);
    field->exact = field->axis[0].cell != 0 && field->axis[1].cell != 0;
    return CANOPY_OK;
}

enum canopy_status canopy_field_init(struct canopy_field *field, const struct canopy_frame *frame,
                                     const uint16_t cells[2], void *arena, size_t bytes) {
    const size_t needed = CANOPY_FIELD_ARENA(frame->size[0], frame->size[1], cells[0], cells[1]);
    struct canopy_arena cut;
    const enum canopy_status status = canopy_field_start(field, frame, cells, &cut, arena, bytes, needed);
    if (status == CANOPY_OK) {
        field->heights = canopy_arena_take(&cut, needed);
        canopy_field_clear(field);
    }
    return status;
}

static void empty(int32_t *heights, size_t count) {
    for (size_t i = 0; i < count; i++) {
        heights[i] = CANOPY_NO_HEIGHT;
    }
}

void canopy_field_clear(struct canopy_field *field) {
    if (field->heights != NULL) {
        empty(field->heights, canopy_field_cells(field));
    } else {
        memset(field->codes, CANOPY_PACKED_NONE, canopy_field_cells(field));
        empty(field->tops, canopy_field_knot_cells(field));
    }
}

// The cell of a coordinate; false beside the frame. The far edge belongs to the last cell.
CANOPY_INLINE bool find_cell(const struct canopy_field_axis *axis, int32_t p, bool exact, uint32_t *cell) {
    const uint32_t offset = (uint32_t)p - (uint32_t)axis->origin;
    if (offset < axis->extent) {
        *cell = canopy_cell_of(axis, offset, exact);
        return true;
    }
    *cell = canopy_cell_of(axis, axis->extent, exact);
    *cell = *cell < axis->count ? *cell : axis->count - 1;
    return offset == axis->extent;
}

// The height of any z, the long way; CANOPY_NO_HEIGHT if it is too high. A step of 2^-30 quanta is as good as any finer
// one, since one quantum is too high then; and 2^62 as good as any coarser one, since all heights are 0 or 1.
static int32_t find_far_height(const struct canopy_frame *frame, int32_t z) {
    int64_t steps = (int64_t)z - frame->origin[2];
    steps = frame->side == CANOPY_BELOW ? -steps : steps;
    const int lsb_log2 = frame->lsb_log2 < -30 ? -30 : frame->lsb_log2 > 62 ? 62 : frame->lsb_log2;
    steps = lsb_log2 <= 0 ? steps * ((int64_t)1 << -lsb_log2) : canopy_shift_ceil(steps, (unsigned)lsb_log2);
    if (steps > CANOPY_HEIGHT_LIMIT) {
        return CANOPY_NO_HEIGHT;
    }
    return steps < -CANOPY_HEIGHT_LIMIT ? -CANOPY_HEIGHT_LIMIT : (int32_t)steps;
}

// False where it is too high.
CANOPY_INLINE bool find_height(const struct canopy_field_heights *heights, const struct canopy_frame *frame, int32_t z,
                               int32_t *height) {
    const uint32_t above_low = (uint32_t)z - (uint32_t)heights->low;
    if (above_low < heights->span) {
        *height = heights->base + (int32_t)above_low * heights->factor;
        return true;
    }
    *height = find_far_height(frame, z);
    return *height != CANOPY_NO_HEIGHT;
}

enum canopy_status canopy_field_insert_fx(struct canopy_field *field, const int32_t point[3],
                                          struct canopy_field_hit *hit) {
    uint32_t row, column;
    if (!find_cell(&field->axis[0], point[0], field->exact, &row) ||
        !find_cell(&field->axis[1], point[1], field->exact, &column)) {
        return CANOPY_OUT_OF_FRAME;
    }
    if (!find_height(&field->z, &field->frame, point[2], &hit->height)) {
        return CANOPY_RANGE;
    }
    hit->cell = row * field->axis[1].count + column;
    hit->raised = canopy_field_raise_cell(field, hit->cell, hit->height);
    return CANOPY_OK;
}

// One after the other, whatever they are.
static size_t feed_any(struct canopy_field *field, const int32_t (*points)[3], size_t count) {
    struct canopy_field_hit hit;
    size_t refused = 0;
    for (; count > 0; count--, points++) {
        refused += canopy_field_insert_fx(field, *points, &hit) != CANOPY_OK;
    }
    return refused;
}

CANOPY_INLINE uint32_t quotient(uint32_t offset, uint32_t factor, uint8_t shift) {
    return canopy_product_high(offset, factor) >> shift;
}

// Points in the frame with ordinary heights, which nearly all are, into a field with factors. Everything the loop needs
// is copied to where nobody else can see it, so that it may stay in registers.
static size_t feed(struct canopy_field *field, const int32_t (*points)[3], size_t count) {
    const struct canopy_field_axis u = field->axis[0], v = field->axis[1];
    const struct canopy_field_heights z = field->z;
    int32_t *heights = field->heights;
    size_t refused = 0;
    for (; count > 0; count--, points++) {
        const uint32_t du = (uint32_t)(*points)[0] - (uint32_t)u.origin,
                       dv = (uint32_t)(*points)[1] - (uint32_t)v.origin;
        const uint32_t above_low = (uint32_t)(*points)[2] - (uint32_t)z.low;
        if (du >= u.extent || dv >= v.extent || above_low >= z.span) {
            refused += feed_any(field, points, 1);
            continue;
        }
        const int32_t height = z.base + (int32_t)above_low * z.factor;
        int32_t *cell = &heights[quotient(du, u.factor, u.shift) * v.count + quotient(dv, v.factor, v.shift)];
        if (height > *cell) {
            *cell = height;
        }
    }
    return refused;
}

size_t canopy_field_feed_fx(struct canopy_field *field, const int32_t (*points)[3], size_t count) {
    const bool fast = field->heights != NULL && field->axis[0].factor != 0 && field->axis[1].factor != 0;
    return fast ? feed(field, points, count) : feed_any(field, points, count);
}

enum canopy_difference canopy_field_difference(const struct canopy_field *a, const struct canopy_field *b) {
    const enum canopy_difference frames = canopy_frame_difference(&a->frame, &b->frame);
    const bool cells = a->axis[0].cells == b->axis[0].cells && a->axis[1].cells == b->axis[1].cells;
    return frames != CANOPY_SAME || cells ? frames : CANOPY_DIFFERENT_CELLS;
}

enum canopy_status canopy_field_merge(struct canopy_field *field, const struct canopy_field *other) {
    if (canopy_field_difference(field, other) != CANOPY_SAME) {
        return CANOPY_ARGUMENT;
    }
    const uint32_t cells = field->axis[0].count * field->axis[1].count;
    for (uint32_t c = 0; c < cells; c++) {
        const int32_t height = canopy_field_height(other, c);
        if (height != CANOPY_NO_HEIGHT) {
            (void)canopy_field_raise_cell(field, c, height);
        }
    }
    return CANOPY_OK;
}

static bool is_covered(const struct canopy_field *field, uint32_t h, uint32_t w) {
    const uint32_t columns = field->axis[1].count, cu = field->axis[0].cells, cv = field->axis[1].cells;
    if (field->heights == NULL) {
        return field->tops[h * (field->frame.size[1] - 1U) + w] != CANOPY_NO_HEIGHT;
    }
    const int32_t *row = field->heights + (size_t)h * cu * columns + (size_t)w * cv;
    for (uint32_t r = 0; r < cu; r++, row += columns) {
        for (uint32_t c = 0; c < cv; c++) {
            if (row[c] != CANOPY_NO_HEIGHT) {
                return true;
            }
        }
    }
    return false;
}

uint32_t canopy_field_coverage(const struct canopy_field *field, uint8_t *bits) {
    const uint32_t down = field->frame.size[0] - 1U, across = field->frame.size[1] - 1U;
    uint32_t covered = 0;
    memset(bits, 0, (down * across + 7) / 8);
    for (uint32_t h = 0; h < down; h++) {
        for (uint32_t w = 0; w < across; w++) {
            if (is_covered(field, h, w)) {
                covered += canopy_bit_set(bits, h * across + w);
            }
        }
    }
    return covered;
}
