#include "lib/station/belt.h"

#include <string.h>

#include "lib/num/bits.h"

static uint32_t window_rows(const struct canopy_belt *belt) { return belt->ring.field.frame.size[0] - 1U; }

// ---- What the registers ask

static bool is_stale(const struct canopy_belt *belt) {
    return !belt->have_reading || belt->now_us - belt->reading_us > belt->config.stale_after_us;
}

static void show_live(void *context, struct canopy_plc_live *to) {
    const struct canopy_belt *belt = context;
    const bool published = canopy_plc_published(&belt->plc) != NULL, stale = is_stale(belt);
    to->heartbeat = belt->heartbeat;
    to->age_ms = belt->have_reading ? canopy_show_ms(belt->now_us - belt->reading_us) : UINT32_MAX;
    to->stale_after_ms = belt->config.stale_after_us / 1000;
    to->sensor_faults = belt->sensor_faults;
    to->coverage_pct = belt->coverage_pct;
    to->status = (uint16_t)((published && !stale && !belt->intrusion ? CANOPY_PLC_VALID : 0) |
                            (belt->intrusion ? CANOPY_PLC_INTRUSION : 0) | (stale ? CANOPY_PLC_STALE : 0));
}

static void show_counters(void *context, struct canopy_plc_counters *to) {
    const struct canopy_belt *belt = context;
    canopy_show_port(&belt->port, belt->scan, to);
    to->uptime_s = (uint32_t)((belt->now_us - belt->start_us) / 1000000);
    to->points_accepted = belt->accepted;
    to->points_rejected = belt->rejected;
    to->intrusions = belt->intrusions;
    to->fits_failed = belt->fits_failed;
    to->scan_errors = belt->scan_errors;
}

static enum canopy_plc_query_status ask_height(void *context, const struct canopy_envelope *envelope, int32_t x,
                                               int32_t y, int32_t *height) {
    const struct canopy_belt *belt = context;
    return canopy_show_height(envelope, x, y, belt->intrusion, height);
}

static void forget(struct canopy_belt *belt) {
    canopy_plc_withdraw(&belt->plc);
    belt->running = false;
    belt->have_reading = false;
    belt->beyond = false;
    belt->due = false;
    belt->working = false;
    belt->intrusion = false;
    belt->coverage_pct = 0;
}

static enum canopy_plc_result run_command(void *context, enum canopy_plc_command_code code) {
    struct canopy_belt *belt = context;
    switch (code) {
    case CANOPY_PLC_COMMAND_REFIT:
        belt->due = belt->running;
        return belt->running ? CANOPY_PLC_RESULT_DONE : CANOPY_PLC_RESULT_REFUSED;
    case CANOPY_PLC_COMMAND_RESTART: forget(belt); return CANOPY_PLC_RESULT_DONE;
    case CANOPY_PLC_COMMAND_WITHDRAW: canopy_plc_withdraw(&belt->plc); return CANOPY_PLC_RESULT_DONE;
    default: return CANOPY_PLC_RESULT_REFUSED;
    }
}

// ---- Beginning

enum canopy_status canopy_belt_init(struct canopy_belt *belt, const struct canopy_belt_config *config, void *arena,
                                    size_t bytes, uint64_t now_us) {
    const struct canopy_ring_config *ring = &config->ring;
    const uint16_t m = ring->grid.size[0], n = ring->grid.size[1], q = ring->grid.cells;
    if (ring->open <= config->lag || m < CANOPY_SIZE_MIN || n < CANOPY_SIZE_MIN) {
        return CANOPY_ARGUMENT;
    }
    struct canopy_arena cut;
    enum canopy_status status =
        canopy_arena_open(&cut, arena, bytes, CANOPY_BELT_ARENA(m, n, q, ring->lines, ring->open, config->clients));
    if (status != CANOPY_OK) {
        return status;
    }
    *belt = (struct canopy_belt){.config = *config, .start_us = now_us, .now_us = now_us};
    const size_t for_ring = CANOPY_RING_ARENA(m, n, q, ring->lines, ring->open);
    status = canopy_ring_init(&belt->ring, ring, canopy_arena_take(&cut, for_ring), for_ring);
    if (status != CANOPY_OK) {
        return status;
    }
    belt->risen = canopy_arena_take(&cut, (size_t)m + ring->open);
    const struct canopy_plc_config plc = {
        .size = {m, n},
        .side = ring->grid.side,
        .scalar = CANOPY_FX,
        .clients = config->clients,
        .unit = config->unit,
        .source = {belt, show_live, show_counters, ask_height, run_command},
    };
    return canopy_plc_init(&belt->plc, &plc, cut.next, cut.left);
}

static bool is_beside(const struct canopy_belt *belt, int64_t v) {
    const struct canopy_frame *frame = &belt->ring.field.frame;
    return v < frame->origin[1] || v - frame->origin[1] > (int64_t)canopy_frame_width(frame, 1);
}

static uint8_t *risen_of(struct canopy_belt *belt, int64_t row) {
    return &belt->risen[(uint64_t)row % ((uint64_t)belt->config.ring.grid.size[0] + belt->config.ring.open)];
}

static void clear_risen(struct canopy_belt *belt) {
    memset(belt->risen, 0, (size_t)belt->config.ring.grid.size[0] + belt->config.ring.open);
}

// The first reading: its row and those that lag behind it are the first open ones.
static void start(struct canopy_belt *belt, int64_t row) {
    (void)canopy_ring_restart(&belt->ring, row - belt->config.lag);
    clear_risen(belt);
    belt->head = row;
    belt->running = true;
}

// ---- Readings

static void intrude(struct canopy_belt *belt) {
    belt->intrusion = true;
    belt->intrusions++;
}

// Whether the reading may lie beyond what the published envelope claims. What is not sure counts as beyond.
static bool is_beyond(const struct canopy_belt *belt, const struct canopy_ring_place *place, int32_t height) {
    const struct canopy_envelope *envelope = canopy_plc_published(&belt->plc);
    if (envelope == NULL) {
        return false;
    }
    const struct canopy_frame *frame = &envelope->frame;
    const int64_t pitch = frame->pitch[0], row = canopy_ring_row_at(&belt->ring, place->u);
    if (row <= envelope->first_row || row - envelope->first_row >= (int64_t)window_rows(belt)) {
        return false;
    }
    const int64_t u = place->u - (belt->ring.base + envelope->first_row * pitch);
    const int64_t v = place->v - belt->ring.field.frame.origin[1];
    int32_t low, high;
    if (canopy_envelope_height(envelope, (uint32_t)u, (uint32_t)v, &low, &high) != CANOPY_OK) {
        return true;
    }
    return frame->side == CANOPY_ABOVE ? height > low : height > -high;
}

// Whether the published envelope, older than the ring, still claims something about a row that the ring has dropped.
static bool is_claimed(const struct canopy_belt *belt, int64_t row) {
    const struct canopy_envelope *envelope = canopy_plc_published(&belt->plc);
    return envelope != NULL && row > envelope->first_row && row <= belt->ring.first;
}

// Takes the reading's row into the ring if the belt has come to it.
static enum canopy_status come_to(struct canopy_belt *belt, const struct canopy_ring_place *place) {
    const int64_t row = canopy_ring_row_at(&belt->ring, place->u);
    if (is_beside(belt, place->v)) {
        return CANOPY_OUT_OF_FRAME;
    }
    if (!belt->running) {
        start(belt, row);
    }
    if (belt->config.leap != 0 && row - belt->head > belt->config.leap) {
        return CANOPY_AHEAD;
    }
    if (place->u >= belt->ring.end) {  // no open row is left for it: the window cannot wait
        belt->overruns += belt->working;
        belt->working = false;
        belt->due = true;
        (void)canopy_ring_reach(&belt->ring, place->u);
    }
    return CANOPY_OK;
}

static enum canopy_status enter(struct canopy_belt *belt, const int32_t point[3], uint32_t uncertainty) {
    const struct canopy_ring_place place = canopy_ring_place_of(&belt->ring, point[0], point[1]);
    enum canopy_status status = come_to(belt, &place);
    if (status != CANOPY_OK) {
        return status;
    }
    const bool above = belt->config.ring.grid.side == CANOPY_ABOVE;
    const int64_t z = (int64_t)point[2] + (above ? (int64_t)uncertainty : -(int64_t)uncertainty);
    const int64_t row = canopy_ring_row_at(&belt->ring, place.u);
    struct canopy_ring_hit hit;
    status = z > INT32_MAX || z < INT32_MIN ? CANOPY_RANGE
                                            : canopy_ring_insert(&belt->ring, &place, (int32_t)z, belt->now_us, &hit);
    if (status == CANOPY_OK || status == CANOPY_RANGE) {
        belt->head = row > belt->head ? row : belt->head;
    }
    if (status == CANOPY_RANGE && row > belt->ring.first) {
        belt->beyond_row = !belt->beyond || row > belt->beyond_row ? row : belt->beyond_row;
        belt->beyond = true;
        intrude(belt);
    }
    if (status == CANOPY_DROPPED && is_claimed(belt, row)) {
        intrude(belt);  // it can no longer be compared: what is not sure counts as beyond
    }
    if (status != CANOPY_OK || !hit.closed) {
        return status;
    }
    if (hit.raised) {
        belt->due = true;
        *risen_of(belt, row) = true;
    }
    if (*risen_of(belt, row) && is_beyond(belt, &place, hit.height)) {
        intrude(belt);
    }
    return CANOPY_OK;
}

enum canopy_status canopy_belt_reading(struct canopy_belt *belt, const int32_t point[3], uint32_t uncertainty,
                                       uint64_t now_us) {
    belt->now_us = now_us;
    const enum canopy_status status = enter(belt, point, uncertainty);
    if (status != CANOPY_OK) {
        belt->rejected++;
        return status;
    }
    belt->accepted++;
    belt->have_reading = true;
    belt->reading_us = now_us;
    return CANOPY_OK;
}

bool canopy_belt_profile(struct canopy_belt *belt, struct canopy_profile_driver *driver, uint16_t *column,
                         uint16_t most, uint64_t now_us) {
    const struct canopy_profile *profile = canopy_profile_get(driver);
    if (profile == NULL) {
        return false;
    }
    for (; most > 0 && *column < profile->columns; most--, (*column)++) {
        struct canopy_reading reading;
        if (canopy_profile_reading(driver, *column, &reading) && reading.valid) {
            const int32_t point[3] = {reading.x, reading.y, reading.z};
            (void)canopy_belt_reading(belt, point, reading.uncertainty, now_us);  // counted there
        }
    }
    if (*column < profile->columns) {
        return true;
    }
    *column = 0;
    canopy_profile_done(driver);
    return false;
}

// ---- The step

// In per cent of the knot cells that can have readings: the guard has none.
static uint16_t coverage_of(const struct canopy_belt *belt, const struct canopy_envelope *envelope) {
    const uint32_t across = envelope->frame.size[1] - 1U, cells = window_rows(belt) * across;
    uint32_t covered = 0;
    for (uint32_t c = 0; c < cells; c++) {
        covered += canopy_bit_get(envelope->coverage, c);
    }
    return (uint16_t)(100U * covered / (cells - across));
}

static void publish(struct canopy_belt *belt) {
    struct canopy_envelope *next = canopy_plc_begin(&belt->plc);
    switch (canopy_ring_publish(&belt->ring, next)) {
    case CANOPY_OK:
        if (canopy_plc_commit(&belt->plc) != CANOPY_OK) {
            belt->fits_failed++;
            return;
        }
        belt->coverage_pct = coverage_of(belt, next);
        break;
    case CANOPY_EMPTY:
        canopy_plc_withdraw(&belt->plc);
        belt->coverage_pct = 0;
        break;
    default: return;
    }
    belt->beyond = belt->beyond && belt->beyond_row > belt->ring.first;
    belt->intrusion = belt->beyond;
    clear_risen(belt);
}

// Forgets what is too old.
static void expire(struct canopy_belt *belt) {
    const uint64_t after = belt->config.expire_after_us;
    if (after == 0 || belt->now_us <= after || canopy_ring_expire(&belt->ring, belt->now_us - after) == 0) {
        return;
    }
    belt->due = true;  // what is left may be tighter now
    if (!belt->working) {
        publish(belt);  // and is certified, if nothing has risen
    }
}

// Closes the rows that the belt has left behind.
static void move(struct canopy_belt *belt) {
    const struct canopy_ring *ring = &belt->ring;
    const int64_t last = belt->head + ring->open - 1 - belt->config.lag;
    const int64_t u = ring->base + last * (int64_t)ring->field.frame.pitch[0];
    belt->due = canopy_ring_reach(&belt->ring, u) > 0 || belt->due;
}

static void work(struct canopy_belt *belt, uint32_t budget) {
    switch (canopy_refit_step(&belt->ring.refit, budget)) {
    case CANOPY_OK:
        belt->working = false;
        publish(belt);
        break;
    case CANOPY_MORE: break;
    default:
        belt->working = false;
        belt->due = true;
        belt->fits_failed++;
        break;
    }
}

void canopy_belt_step(struct canopy_belt *belt, uint32_t budget, uint64_t now_us) {
    belt->now_us = now_us;
    belt->heartbeat++;
    if (!belt->running) {
        return;
    }
    expire(belt);
    if (!belt->working) {
        move(belt);
        if (belt->due) {
            belt->due = false;
            belt->working = true;
            canopy_refit_begin(&belt->ring.refit);
        }
    }
    if (belt->working) {
        work(belt, budget);
    }
}

struct canopy_modbus_bank canopy_belt_bank(struct canopy_belt *belt) {
    return canopy_plc_bank(&belt->plc);
}
