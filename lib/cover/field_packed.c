// Fields of one byte a cell.

#include "lib/cover/field_parts.h"
#include "lib/cover/packed.h"

static uint32_t knot_cell_of(const struct canopy_field *field, uint32_t cell) {
    const uint32_t row = cell / field->axis[1].count, column = cell - row * field->axis[1].count;
    return row / field->axis[0].cells * (field->frame.size[1] - 1U) + column / field->axis[1].cells;
}

static int32_t packed_height(const struct canopy_field *field, uint32_t cell) {
    const uint8_t code = field->codes[cell];
    return code == CANOPY_PACKED_NONE ? CANOPY_NO_HEIGHT
                                      : canopy_packed_height(code, field->tops[knot_cell_of(field, cell)]);
}

// Codes of a knot cell whose top rises.
static void recode(struct canopy_field *field, uint32_t knot_cell, int32_t from, int32_t to) {
    const uint32_t across = field->frame.size[1] - 1U, columns = field->axis[1].count;
    const uint32_t h = knot_cell / across, w = knot_cell - h * across;
    uint8_t *row = field->codes + (size_t)h * field->axis[0].cells * columns + (size_t)w * field->axis[1].cells;
    for (uint32_t r = 0; r < field->axis[0].cells; r++, row += columns) {
        for (uint32_t c = 0; c < field->axis[1].cells; c++) {
            if (row[c] != CANOPY_PACKED_NONE) {
                row[c] = canopy_packed_code(canopy_packed_height(row[c], from), to);
            }
        }
    }
}

static bool packed_raise(struct canopy_field *field, uint32_t cell, int32_t height) {
    const uint32_t knot_cell = knot_cell_of(field, cell);
    int32_t *top = &field->tops[knot_cell];
    if (height > *top) {
        const int32_t risen = canopy_packed_top(height);
        if (*top != CANOPY_NO_HEIGHT) {
            recode(field, knot_cell, *top, risen);
        }
        *top = risen;
    }
    const uint8_t code = canopy_packed_code(height, *top);
    const bool raised = code < field->codes[cell] || field->codes[cell] == CANOPY_PACKED_NONE;
    field->codes[cell] = raised ? code : field->codes[cell];
    return raised;
}

static const struct canopy_field_packing packing = {packed_height, packed_raise};

enum canopy_status canopy_field_init_packed(struct canopy_field *field, const struct canopy_frame *frame,
                                            const uint16_t cells[2], void *arena, size_t bytes) {
    const size_t needed = CANOPY_FIELD_PACKED_ARENA(frame->size[0], frame->size[1], cells[0], cells[1]);
    struct canopy_arena cut;
    const enum canopy_status status = canopy_field_start(field, frame, cells, &cut, arena, bytes, needed);
    if (status == CANOPY_OK) {
        field->packing = &packing;
        field->codes = canopy_arena_take(&cut, canopy_field_cells(field));
        field->tops = canopy_arena_take(&cut, 4 * canopy_field_knot_cells(field));
        canopy_field_clear(field);
    }
    return status;
}
