// The job that a station spends spare time on. It is part of the float path, hence the name: in soft float where there
// is no hardware for it.

#include "lib/station/tightening.h"

#include <string.h>

// The spare is the first member.
static struct canopy_station_tightening *of(struct canopy_station_spare *spare) {
    return (struct canopy_station_tightening *)(void *)spare;
}

static bool spare_begin(struct canopy_station_spare *spare, const struct canopy_field *field,
                        struct canopy_certify *certify, const int32_t *published) {
    struct canopy_station_tightening *t = of(spare);
    const size_t count = (size_t)field->frame.size[0] * field->frame.size[1];
    if (canopy_tighten_init(&t->tighten, &field->frame, &t->size, t->arena, t->bytes) != CANOPY_OK ||
        canopy_tighten_field_begin(&t->tighten, field, certify) != CANOPY_OK) {
        return false;
    }
    memcpy(t->b, published, 4 * count);
    return true;
}

static enum canopy_status spare_step(struct canopy_station_spare *spare) {
    struct canopy_station_tightening *t = of(spare);
    if (t->tighten.stage != CANOPY_TIGHTEN_TAKE) {
        return canopy_tighten_step(&t->tighten, 1);
    }
    if (canopy_tighten_field_step(&t->tighten) == CANOPY_MORE) {
        return CANOPY_MORE;
    }
    const enum canopy_status status = canopy_tighten_begin(&t->tighten, t->b, true);
    return status == CANOPY_OK ? CANOPY_MORE : status;
}

static bool spare_take(struct canopy_station_spare *spare, int32_t *coefficients) {
    const struct canopy_station_tightening *t = of(spare);
    memcpy(coefficients, t->b, 4U * t->tighten.frame.size[0] * t->tighten.frame.size[1]);
    return t->tighten.stage != CANOPY_TIGHTEN_TAKE && t->tighten.published > 1;
}

enum canopy_status canopy_station_tightening_init(struct canopy_station_tightening *tightening,
                                                  const struct canopy_grid *grid, uint32_t rows, void *arena,
                                                  size_t bytes) {
    const uint16_t m = grid->size[0], n = grid->size[1];
    if (m < CANOPY_SIZE_MIN || n < CANOPY_SIZE_MIN || m > CANOPY_SIZE_MAX || n > CANOPY_SIZE_MAX || grid->cells < 1 ||
        grid->cells > CANOPY_CELLS_MAX || rows < 2U * m * n) {
        return CANOPY_ARGUMENT;
    }
    struct canopy_arena cut;
    const enum canopy_status status =
        canopy_arena_open(&cut, arena, bytes, CANOPY_STATION_TIGHTENING_ARENA(m, n, grid->cells, rows));
    if (status != CANOPY_OK) {
        return status;
    }
    *tightening = (struct canopy_station_tightening){.spare = {spare_begin, spare_step, spare_take},
                                                     .size = {0, {grid->cells, grid->cells}, rows}};
    tightening->b = canopy_arena_take(&cut, 4U * (size_t)m * n);
    tightening->arena = cut.next;
    tightening->bytes = cut.left;
    return CANOPY_OK;
}
