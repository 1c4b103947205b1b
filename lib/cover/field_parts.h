/// What a field's files share: plain (field.c) and packed (field_packed.c).
#ifndef CANOPY_COVER_FIELD_PARTS_H
#define CANOPY_COVER_FIELD_PARTS_H

#include "lib/cover/field.h"

static inline size_t canopy_field_cells(const struct canopy_field *field) {
    return (size_t)field->axis[0].count * field->axis[1].count;
}

static inline size_t canopy_field_knot_cells(const struct canopy_field *field) {
    return (field->frame.size[0] - 1U) * (size_t)(field->frame.size[1] - 1U);
}

/// All of an init but where its cells are: `needed` bytes for them are then to be had from `cut`.
enum canopy_status canopy_field_start(struct canopy_field *field, const struct canopy_frame *frame,
                                      const uint16_t cells[2], struct canopy_arena *cut, void *arena, size_t bytes,
                                      size_t needed);

#endif
