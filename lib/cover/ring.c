#include "lib/cover/ring.h"

#include <string.h>

#define FAR ((int64_t)1 << 62)

static uint32_t window_rows(const struct canopy_ring *ring) { return ring->field.frame.size[0] - 1U; }

static uint32_t all_rows(const struct canopy_ring *ring) { return window_rows(ring) + ring->open; }

static size_t row_cells(const struct canopy_ring *ring) {
    return (size_t)ring->field.axis[0].cells * ring->field.axis[1].count;
}

static int64_t pitch_of(const struct canopy_ring *ring) { return ring->field.frame.pitch[0]; }

static int64_t start_of(const struct canopy_ring *ring) { return ring->end - all_rows(ring) * pitch_of(ring); }

// ---- Beginning

// A box of device coordinates in those of the belt: a quarter turn for every step of the heading.
static bool turn_box(const struct canopy_ring_config *config, int32_t low[3], int32_t high[3]) {
    const int along = config->heading % 2, across = 1 - along;
    const bool along_is_negative = config->heading >= CANOPY_AGAINST_X;
    const bool across_is_negative = config->heading == CANOPY_ALONG_Y || config->heading == CANOPY_AGAINST_X;
    const int from[2] = {along, across};
    const bool negative[2] = {along_is_negative, across_is_negative};
    for (int a = 0; a < 2; a++) {
        const int64_t l = config->low[from[a]], h = config->high[from[a]];
        if (negative[a] && (l == INT32_MIN || h == INT32_MIN)) {
            return false;
        }
        low[a] = (int32_t)(negative[a] ? -h : l);
        high[a] = (int32_t)(negative[a] ? -l : h);
    }
    low[2] = config->low[2];
    high[2] = config->high[2];
    return true;
}

static bool is_valid(const struct canopy_ring_config *config) {
    return config->heading <= CANOPY_AGAINST_Y && config->fit != NULL && config->open >= 1 &&
           config->open <= CANOPY_SIZE_MAX && config->lines >= 1 && config->grid.cells % config->lines == 0;
}

static enum canopy_status make_fields(struct canopy_ring *ring, const struct canopy_frame *frame, void *heights,
                                      size_t bytes) {
    const uint16_t cells[2] = {frame->cells, frame->cells};
    const enum canopy_status status = canopy_field_init(&ring->field, frame, cells, heights, bytes);
    if (status != CANOPY_OK) {
        return status;
    }
    // A field ends where coordinates do; a ring's go on, modulo 2^32.
    ring->field.axis[0].extent = window_rows(ring) * frame->pitch[0];
    ring->intake = ring->field;
    ring->intake.axis[0].count = all_rows(ring) * frame->cells;
    ring->intake.axis[0].extent = all_rows(ring) * frame->pitch[0];
    return CANOPY_OK;
}

enum canopy_status canopy_ring_init(struct canopy_ring *ring, const struct canopy_ring_config *config, void *arena,
                                    size_t bytes) {
    int32_t low[3], high[3];
    struct canopy_frame frame;
    if (!is_valid(config) || !turn_box(config, low, high) ||
        canopy_frame_around_fx(&frame, &config->grid, low, high) != CANOPY_OK) {
        return CANOPY_ARGUMENT;
    }
    const uint16_t m = frame.size[0], n = frame.size[1], q = frame.cells;
    if ((m - 1U + config->open) * (uint64_t)frame.pitch[0] > INT32_MAX) {
        return CANOPY_ARGUMENT;
    }
    struct canopy_arena cut;
    enum canopy_status status =
        canopy_arena_open(&cut, arena, bytes, CANOPY_RING_ARENA(m, n, q, config->lines, config->open));
    if (status != CANOPY_OK) {
        return status;
    }
    *ring = (struct canopy_ring){
        .heading = config->heading, .open = config->open, .period = config->period, .base = low[0]};
    const size_t heights = CANOPY_FIELD_ARENA((size_t)m + config->open, n, q, q);
    status = make_fields(ring, &frame, canopy_arena_take(&cut, heights), heights);
    if (status == CANOPY_OK) {
        ring->rows = canopy_arena_take(&cut, all_rows(ring) * sizeof *ring->rows);
        canopy_field_clear(&ring->intake);
        status = canopy_refit_init(&ring->refit, &ring->field, config->fit, config->lines, cut.next, cut.left);
    }
    return status == CANOPY_OK ? canopy_ring_restart(ring, 0) : status;
}

// The origins that follow from first: those of the fields wrap.
static void place_window(struct canopy_ring *ring) {
    const int64_t start = ring->base + ring->first * pitch_of(ring);
    ring->end = start + all_rows(ring) * pitch_of(ring);
    ring->field.frame.origin[0] = (int32_t)(uint32_t)(uint64_t)start;
    ring->field.axis[0].origin = ring->field.frame.origin[0];
    ring->intake.frame.origin[0] = ring->field.frame.origin[0];
    ring->intake.axis[0].origin = ring->field.frame.origin[0];
    ring->end_low = (uint32_t)(uint64_t)ring->end;
    if (ring->period != 0) {
        const int64_t rest = ring->end % (int64_t)ring->period;
        ring->end_low = (uint32_t)(rest < 0 ? rest + (int64_t)ring->period : rest);
    }
}

static void forget_rows(struct canopy_ring *ring, uint32_t from, uint32_t count) {
    int32_t *cell = ring->intake.heights + from * row_cells(ring), *end = cell + count * row_cells(ring);
    while (cell < end) {
        *cell++ = CANOPY_NO_HEIGHT;
    }
    for (uint32_t h = from; h < from + count; h++) {
        ring->rows[h] = (struct canopy_ring_row){.oldest_us = UINT64_MAX};
    }
}

enum canopy_status canopy_ring_restart(struct canopy_ring *ring, int64_t first) {
    const int64_t most = FAR / pitch_of(ring);
    if (first > most || first < -most) {
        return CANOPY_ARGUMENT;
    }
    ring->first = first - window_rows(ring);
    place_window(ring);
    forget_rows(ring, 0, all_rows(ring));
    canopy_refit_shift(&ring->refit, window_rows(ring));
    return CANOPY_OK;
}

// ---- Places

struct canopy_ring_place canopy_ring_place_of(const struct canopy_ring *ring, int32_t x, int32_t y) {
    const int64_t along = ring->heading % 2 == 0 ? x : y, across = ring->heading % 2 == 0 ? y : x;
    const bool mirrored = ring->heading == CANOPY_ALONG_Y || ring->heading == CANOPY_AGAINST_X;
    const int64_t u = ring->heading >= CANOPY_AGAINST_X ? -along : along;
    struct canopy_ring_place place = {.v = mirrored ? -across : across};
    if (ring->period == 0) {
        place.u = ring->end + (int32_t)((uint32_t)(uint64_t)u - ring->end_low);
        return place;
    }
    const int64_t period = ring->period;
    int64_t ahead = (u - ring->end_low) % period;  // from -period to period
    ahead = ahead < -(period / 2) ? ahead + period : ahead >= (period + 1) / 2 ? ahead - period : ahead;
    place.u = ring->end + ahead;
    return place;
}

int64_t canopy_ring_row_at(const struct canopy_ring *ring, int64_t u) {
    const int64_t offset = u - ring->base, row = offset / pitch_of(ring);
    return row - (offset % pitch_of(ring) < 0);
}

enum canopy_status canopy_ring_row(const struct canopy_ring *ring, int64_t row, struct canopy_ring_row *info) {
    if (row <= ring->first) {
        return CANOPY_DROPPED;
    }
    if (row - ring->first >= (int64_t)all_rows(ring)) {
        return CANOPY_AHEAD;
    }
    *info = ring->rows[row - ring->first];
    return CANOPY_OK;
}

// ---- Readings

static bool is_beside(const struct canopy_ring *ring, int64_t v) {
    const struct canopy_field_axis *axis = &ring->intake.axis[1];
    return v < axis->origin || v - axis->origin > (int64_t)axis->extent;
}

enum canopy_status canopy_ring_insert(struct canopy_ring *ring, const struct canopy_ring_place *place, int32_t z,
                                      uint64_t now_us, struct canopy_ring_hit *hit) {
    if (is_beside(ring, place->v)) {
        return CANOPY_OUT_OF_FRAME;
    }
    if (place->u < start_of(ring) + pitch_of(ring)) {
        return CANOPY_DROPPED;
    }
    if (place->u >= ring->end) {
        return CANOPY_AHEAD;
    }
    const int32_t point[3] = {(int32_t)(uint32_t)(uint64_t)place->u, (int32_t)place->v, z};
    struct canopy_field_hit cell;
    const enum canopy_status status = canopy_field_insert_fx(&ring->intake, point, &cell);
    if (status != CANOPY_OK) {
        return status;
    }
    const uint32_t h = cell.cell / (uint32_t)row_cells(ring);
    struct canopy_ring_row *row = &ring->rows[h];
    row->readings++;
    row->oldest_us = now_us < row->oldest_us ? now_us : row->oldest_us;
    *hit = (struct canopy_ring_hit){ring->first + h, cell.cell, cell.height, cell.raised, h < window_rows(ring)};
    if (hit->closed && hit->raised) {
        canopy_refit_rose(&ring->refit, hit->cell);
    }
    return CANOPY_OK;
}

uint64_t canopy_ring_reach(struct canopy_ring *ring, int64_t u) {
    if (u < ring->end || u > FAR) {
        return 0;
    }
    const uint64_t by = (uint64_t)(u - ring->end) / ring->field.frame.pitch[0] + 1;
    const uint32_t all = all_rows(ring), rows = by < all ? (uint32_t)by : all;
    const size_t cells = row_cells(ring);
    memmove(ring->intake.heights, ring->intake.heights + rows * cells, 4 * (all - rows) * cells);
    memmove(ring->rows, ring->rows + rows, (all - rows) * sizeof *ring->rows);
    forget_rows(ring, all - rows, rows);
    forget_rows(ring, 0, 1);  // the guard
    ring->first += (int64_t)by;
    place_window(ring);
    canopy_refit_shift(&ring->refit, rows < window_rows(ring) ? rows : window_rows(ring));
    return by;
}

uint32_t canopy_ring_expire(struct canopy_ring *ring, uint64_t before_us) {
    uint32_t gone = 0;
    for (uint32_t h = 1; h < all_rows(ring); h++) {
        if (ring->rows[h].oldest_us < before_us) {
            forget_rows(ring, h, 1);
            if (h < window_rows(ring)) {
                canopy_refit_changed(&ring->refit, h, 1);
                gone++;
            }
        }
    }
    return gone;
}

// ---- Merging

enum canopy_difference canopy_ring_difference(const struct canopy_ring *a, const struct canopy_ring *b) {
    const enum canopy_difference fields = canopy_field_difference(&a->field, &b->field);
    if (fields != CANOPY_SAME && fields != CANOPY_DIFFERENT_ORIGIN) {
        return fields;
    }
    if (a->heading != b->heading) {
        return CANOPY_DIFFERENT_AXES;
    }
    const bool same = a->first == b->first && a->base == b->base && a->open == b->open && a->period == b->period;
    return same ? fields : CANOPY_DIFFERENT_ORIGIN;
}

// True if any cell rose.
static bool merge_row(int32_t *cells, const int32_t *other, size_t count) {
    bool rose = false;
    for (size_t c = 0; c < count; c++) {
        if (other[c] > cells[c]) {
            cells[c] = other[c];
            rose = true;
        }
    }
    return rose;
}

enum canopy_status canopy_ring_merge(struct canopy_ring *ring, const struct canopy_ring *other) {
    if (canopy_ring_difference(ring, other) != CANOPY_SAME) {
        return CANOPY_ARGUMENT;
    }
    const size_t cells = row_cells(ring);
    for (uint32_t h = 1; h < all_rows(ring); h++) {
        struct canopy_ring_row *row = &ring->rows[h];
        row->readings += other->rows[h].readings;
        row->oldest_us = other->rows[h].oldest_us < row->oldest_us ? other->rows[h].oldest_us : row->oldest_us;
        if (merge_row(ring->intake.heights + h * cells, other->intake.heights + h * cells, cells) &&
            h < window_rows(ring)) {
            canopy_refit_changed(&ring->refit, h, 1);
        }
    }
    return CANOPY_OK;
}

// ---- Publishing

// A coordinate along the belt as the device counts it.
static int32_t wrap(const struct canopy_ring *ring, int64_t along) {
    if (ring->period == 0) {
        return (int32_t)(uint32_t)(uint64_t)along;
    }
    const int64_t rest = along % (int64_t)ring->period;
    return (int32_t)(uint32_t)(rest < 0 ? rest + (int64_t)ring->period : rest);
}

void canopy_ring_frame(const struct canopy_ring *ring, struct canopy_frame *frame) {
    static const int32_t turns[4][2] = {{1, 0}, {0, 1}, {-1, 0}, {0, -1}};  // x and y of u
    const int32_t x = turns[ring->heading][0], y = turns[ring->heading][1];
    const int32_t axes[2][2] = {{x, y}, {-y, x}}, v = ring->field.frame.origin[1];
    *frame = ring->field.frame;
    for (int c = 0; c < 2; c++) {
        frame->origin[c] = axes[0][c] != 0 ? wrap(ring, axes[0][c] * start_of(ring)) : axes[1][c] * v;
        for (int a = 0; a < 2; a++) {
            frame->axis[a][c] = axes[a][c] * CANOPY_AXIS_ONE;
        }
    }
}

enum canopy_status canopy_ring_publish(const struct canopy_ring *ring, struct canopy_envelope *envelope) {
    if (!canopy_refit_is_certified(&ring->refit)) {
        return CANOPY_MORE;
    }
    const int32_t margin = canopy_refit_margin(&ring->refit);
    if (margin == INT32_MAX) {
        return CANOPY_EMPTY;
    }
    const struct canopy_frame *frame = &ring->field.frame;
    memcpy(envelope->coefficients, ring->refit.coefficients, 4U * (size_t)frame->size[0] * frame->size[1]);
    canopy_fast_orient(frame, envelope->coefficients);
    (void)canopy_field_coverage(&ring->field, envelope->coverage);
    canopy_ring_frame(ring, &envelope->frame);
    envelope->scalar = CANOPY_FX;
    envelope->margin = margin;
    envelope->first_row = ring->first;
    envelope->points = 0;
    for (uint32_t h = 1; h < window_rows(ring); h++) {
        envelope->points += ring->rows[h].readings;
    }
    return CANOPY_OK;
}
