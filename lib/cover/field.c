#include "lib/cover/field.h"

#include <string.h>

#include "lib/num/bits.h"
#include "lib/num/fixed.h"

static void init_axis(struct canopy_field_axis *axis, const struct canopy_frame *frame, int a, uint16_t cells) {
    const uint32_t pitch = frame->pitch[a];
    *axis = (struct canopy_field_axis){.pitch = pitch, .cells = cells};
    axis->count = (frame->size[a] - 1U) * cells;
    const uint64_t width = canopy_frame_width(frame, a);
    axis->extent = width < UINT32_MAX ? (uint32_t)width : UINT32_MAX;
    axis->cell = pitch % cells == 0 ? pitch / cells : 0;
    const uint64_t reciprocal = ((uint64_t)cells << 32) / pitch;
    axis->reciprocal = reciprocal < UINT32_MAX ? (uint32_t)reciprocal : UINT32_MAX;
}

enum canopy_status canopy_field_init(struct canopy_field *field, const struct canopy_frame *frame,
                                     const uint16_t cells[2], void *arena, size_t bytes) {
    for (int a = 0; a < 2; a++) {
        if (cells[a] < 1 || cells[a] > CANOPY_CELLS_MAX || cells[a] > frame->pitch[a]) {
            return CANOPY_ARGUMENT;
        }
    }
    struct canopy_arena cut;
    const enum canopy_status status =
        canopy_arena_open(&cut, arena, bytes, CANOPY_FIELD_ARENA(frame->size[0], frame->size[1], cells[0], cells[1]));
    if (status != CANOPY_OK) {
        return status;
    }
    field->frame = *frame;
    for (int a = 0; a < 2; a++) {
        init_axis(&field->axis[a], frame, a, cells[a]);
    }
    field->exact = field->axis[0].cell != 0 && field->axis[1].cell != 0;
    field->heights = canopy_arena_take(&cut, 4U * (size_t)field->axis[0].count * field->axis[1].count);
    canopy_field_clear(field);
    return CANOPY_OK;
}

void canopy_field_clear(struct canopy_field *field) {
    const size_t cells = (size_t)field->axis[0].count * field->axis[1].count;
    for (size_t c = 0; c < cells; c++) {
        field->heights[c] = CANOPY_NO_HEIGHT;
    }
    field->covered = 0;
}

// The cell of an offset of at most `extent` quanta. The product with the reciprocal, which was rounded down, is the
// quotient or one less; the remainder tells. The far edge belongs to the last cell.
static inline uint32_t cell_of(const struct canopy_field_axis *axis, uint32_t offset) {
    uint32_t cell = (uint32_t)(((uint64_t)offset * axis->reciprocal) >> 32);
    if (axis->cell != 0) {
        cell += offset - cell * axis->cell >= axis->cell;
    } else {
        cell += (uint64_t)(cell + 1) * axis->pitch <= (uint64_t)offset * axis->cells;
    }
    return cell < axis->count ? cell : axis->count - 1;
}

static inline void raise(struct canopy_field *field, struct canopy_field_hit *hit) {
    int32_t *height = &field->heights[hit->cell];
    hit->raised = hit->height > *height;
    if (hit->raised) {
        field->covered += *height == CANOPY_NO_HEIGHT;
        *height = hit->height;
    }
}

static inline enum canopy_status insert(struct canopy_field *field, const int32_t p[3], struct canopy_field_hit *hit) {
    const struct canopy_frame *frame = &field->frame;
    // p < origin wraps to more than any extent that fits 31 bits; a wider frame is told apart by the comparison.
    const uint32_t u = (uint32_t)p[0] - (uint32_t)frame->origin[0], v = (uint32_t)p[1] - (uint32_t)frame->origin[1];
    if (p[0] < frame->origin[0] || p[1] < frame->origin[1] || u > field->axis[0].extent || v > field->axis[1].extent) {
        return CANOPY_OUT_OF_FRAME;
    }
    int64_t height = (int64_t)p[2] - frame->origin[2];
    height = frame->side == CANOPY_BELOW ? -height : height;
    height = frame->lsb_log2 <= 0 ? height * ((int64_t)1 << -frame->lsb_log2)
                                  : canopy_shift_ceil(height, (unsigned)frame->lsb_log2);
    if (height > CANOPY_HEIGHT_LIMIT) {
        return CANOPY_RANGE;
    }
    hit->height = height < -CANOPY_HEIGHT_LIMIT ? -CANOPY_HEIGHT_LIMIT : (int32_t)height;
    hit->cell = cell_of(&field->axis[0], u) * field->axis[1].count + cell_of(&field->axis[1], v);
    raise(field, hit);
    return CANOPY_OK;
}

enum canopy_status canopy_field_insert_fx(struct canopy_field *field, const int32_t point[3],
                                          struct canopy_field_hit *hit) {
    return insert(field, point, hit);
}

size_t canopy_field_feed_fx(struct canopy_field *field, const int32_t (*points)[3], size_t count) {
    size_t refused = 0;
    struct canopy_field_hit hit;
    for (size_t i = 0; i < count; i++) {
        refused += insert(field, points[i], &hit) != CANOPY_OK;
    }
    return refused;
}

enum canopy_status canopy_field_merge(struct canopy_field *field, const struct canopy_field *other) {
    const struct canopy_frame *a = &field->frame, *b = &other->frame;
    if (memcmp(a->origin, b->origin, sizeof a->origin) != 0 || memcmp(a->pitch, b->pitch, sizeof a->pitch) != 0 ||
        memcmp(a->size, b->size, sizeof a->size) != 0 || memcmp(a->axis, b->axis, sizeof a->axis) != 0 ||
        a->side != b->side || a->lsb_log2 != b->lsb_log2 || a->quantum_log2 != b->quantum_log2 ||
        field->axis[0].cells != other->axis[0].cells || field->axis[1].cells != other->axis[1].cells) {
        return CANOPY_ARGUMENT;
    }
    const uint32_t cells = field->axis[0].count * field->axis[1].count;
    for (uint32_t c = 0; c < cells; c++) {
        struct canopy_field_hit hit = {.cell = c, .height = other->heights[c]};
        raise(field, &hit);
    }
    return CANOPY_OK;
}

uint32_t canopy_field_coverage(const struct canopy_field *field, uint8_t *bits) {
    const uint32_t rows = field->axis[0].count, columns = field->axis[1].count;
    const uint32_t across = field->frame.size[1] - 1U, knot_cells = (field->frame.size[0] - 1U) * across;
    uint32_t covered = 0;
    memset(bits, 0, (knot_cells + 7) / 8);
    for (uint32_t r = 0; r < rows; r++) {
        const int32_t *row = field->heights + (size_t)r * columns;
        const uint32_t first = r / field->axis[0].cells * across;
        for (uint32_t c = 0; c < columns; c++) {
            if (row[c] != CANOPY_NO_HEIGHT) {
                const uint32_t bit = first + c / field->axis[1].cells;
                covered += canopy_bit_set(bits, bit);
            }
        }
    }
    return covered;
}
