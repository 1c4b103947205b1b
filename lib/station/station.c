#include "lib/station/station.h"

#include <string.h>

#include "lib/cover/axes.h"
#include "lib/num/bits.h"
#include "lib/station/show.h"

static uint32_t cell_count(const struct canopy_station *station) {
    return station->field.axis[0].count * station->field.axis[1].count;
}

static void clear_bits(const struct canopy_station *station, uint8_t *bits) {
    memset(bits, 0, (cell_count(station) + 7) / 8);
}

// ---- What the registers ask

static bool is_stale(const struct canopy_station *station) {
    return !station->have_reading || station->now_us - station->reading_us > station->config.stale_after_us;
}

static void show_live(void *context, struct canopy_plc_live *to) {
    const struct canopy_station *station = context;
    const bool published = canopy_plc_published(&station->plc) != NULL, stale = is_stale(station);
    to->heartbeat = station->heartbeat;
    to->age_ms = station->have_reading ? canopy_show_ms(station->now_us - station->reading_us) : UINT32_MAX;
    to->stale_after_ms = station->config.stale_after_us / 1000;
    to->sensor_faults = station->sensor_faults;
    to->coverage_pct = station->coverage_pct;
    to->status = (uint16_t)((published && !stale && !station->intrusion ? CANOPY_PLC_VALID : 0) |
                            (station->intrusion ? CANOPY_PLC_INTRUSION : 0) | (stale ? CANOPY_PLC_STALE : 0));
}

static void show_counters(void *context, struct canopy_plc_counters *to) {
    const struct canopy_station *station = context;
    canopy_show_port(&station->port, station->scan, to);
    to->uptime_s = (uint32_t)((station->now_us - station->start_us) / 1000000);
    to->points_accepted = station->accepted;
    to->points_rejected = station->rejected;
    to->intrusions = station->intrusions;
    to->fits_failed = station->fits_failed;
    to->scan_errors = station->scan_errors;
}

static enum canopy_plc_query_status ask_height(void *context, const struct canopy_envelope *envelope, int32_t x,
                                               int32_t y, int32_t *height) {
    const struct canopy_station *station = context;
    return canopy_show_height(envelope, x, y, station->intrusion, height);
}

// ---- Scenes

static void rest(struct canopy_station *station) {
    station->stage = CANOPY_STATION_RESTING;
    station->candidate = NULL;
    station->handed = false;
    station->kept = false;
}

static void forget(struct canopy_station *station) {
    canopy_plc_withdraw(&station->plc);
    station->points = 0;
    station->published_points = 0;
    station->risen = false;
    station->intrusion = false;
    station->beyond = false;
    station->have_reading = false;
    station->coverage_pct = 0;
    station->spare_stage = CANOPY_STATION_SPARE_NOTHING;
    station->tightened = false;
    clear_bits(station, station->risen_cells);
    rest(station);
}

static enum canopy_plc_result run_command(void *context, enum canopy_plc_command_code code) {
    struct canopy_station *station = context;
    if (station->stage == CANOPY_STATION_WAITING) {
        return CANOPY_PLC_RESULT_REFUSED;
    }
    switch (code) {
    case CANOPY_PLC_COMMAND_REFIT:
        station->risen = station->points > 0;
        station->fit_us = 0;
        return station->risen ? CANOPY_PLC_RESULT_DONE : CANOPY_PLC_RESULT_REFUSED;
    case CANOPY_PLC_COMMAND_RESTART:
        canopy_field_clear(&station->field);
        forget(station);
        return CANOPY_PLC_RESULT_DONE;
    case CANOPY_PLC_COMMAND_WITHDRAW: canopy_plc_withdraw(&station->plc); return CANOPY_PLC_RESULT_DONE;
    default: return CANOPY_PLC_RESULT_REFUSED;
    }
}

// All 0 is x, y and z.
static enum canopy_status settle_axes(struct canopy_station_config *config) {
    static const int32_t none[3][3];
    if (memcmp(config->axes, none, sizeof none) == 0) {
        config->axes[0][0] = config->axes[1][1] = config->axes[2][2] = CANOPY_AXIS_ONE;
    }
    const int32_t(*axes)[3] = (const int32_t(*)[3])config->axes;
    if (canopy_axes_are_straight(axes)) {
        return CANOPY_OK;
    }
    if (config->turning == NULL) {
        return CANOPY_UNSUPPORTED;
    }
    return config->turning->turned_are_sound(axes) ? CANOPY_OK : CANOPY_ARGUMENT;
}

enum canopy_status canopy_station_init(struct canopy_station *station, const struct canopy_station_config *config,
                                       void *arena, size_t bytes, uint64_t now_us) {
    const struct canopy_grid *grid = &config->grid;
    const uint16_t m = grid->size[0], n = grid->size[1], q = grid->cells;
    if (m < CANOPY_SIZE_MIN || n < CANOPY_SIZE_MIN || m > CANOPY_SIZE_MAX || n > CANOPY_SIZE_MAX || q < 1 ||
        q > CANOPY_CELLS_MAX || config->fit == NULL || config->lines < 1 || q % config->lines != 0) {
        return CANOPY_ARGUMENT;
    }
    struct canopy_station_config own = *config;
    enum canopy_status status = settle_axes(&own);
    if (status != CANOPY_OK) {
        return status;
    }
    struct canopy_arena cut;
    const size_t field_bytes = CANOPY_FIELD_ARENA(m, n, q, q), mark_bytes = CANOPY_STATION_MARKS(m, n, q);
    const size_t table_bytes = CANOPY_CERTIFY_TABLES(q, q), certify_bytes = CANOPY_CERTIFY_WORK(n, q);
    const size_t fast_bytes = CANOPY_FAST_ARENA(m, n, q, config->lines);
    const size_t work_bytes = CANOPY_MAX(fast_bytes, certify_bytes + mark_bytes);
    status = canopy_arena_open(&cut, arena, bytes, field_bytes + mark_bytes + table_bytes + work_bytes);
    if (status != CANOPY_OK) {
        return status;
    }
    *station = (struct canopy_station){.config = own, .start_us = now_us, .now_us = now_us};
    station->field_bytes = field_bytes;
    station->work_bytes = work_bytes;
    station->field_arena = canopy_arena_take(&cut, field_bytes);
    station->risen_cells = canopy_arena_take(&cut, mark_bytes);
    station->tables_arena = canopy_arena_take(&cut, table_bytes);
    station->work_arena = canopy_arena_take(&cut, work_bytes);
    station->late_cells = (uint8_t *)station->work_arena + certify_bytes;
    const struct canopy_plc_config plc = {
        .size = {m, n},
        .side = grid->side,
        .scalar = config->fit->scalar,
        .clients = config->clients,
        .unit = config->unit,
        .source = {station, show_live, show_counters, ask_height, run_command},
    };
    return canopy_plc_init(&station->plc, &plc, cut.next, cut.left);
}

// All that could be refused further on is refused here, while nothing has been changed.
static bool is_acceptable(const struct canopy_frame *frame, const struct canopy_grid *grid) {
    if (frame->size[0] != grid->size[0] || frame->size[1] != grid->size[1] || frame->cells != grid->cells ||
        frame->side != grid->side || frame->quantum_log2 != 0) {
        return false;
    }
    return frame->pitch[0] > 0 && frame->pitch[0] % grid->cells == 0 && frame->pitch[1] > 0 &&
           frame->pitch[1] % grid->cells == 0;
}

static bool is_float(int64_t x) { return x >= -CANOPY_STATION_FLOAT_MOST && x <= CANOPY_STATION_FLOAT_MOST; }

// Whether the points of a frame have the scalar; of a turned one nothing is known before they come.
static bool has_scalar(const struct canopy_station *station, const struct canopy_frame *frame) {
    bool within = true;
    for (int a = 0; a < 3; a++) {
        const int64_t low = frame->origin[a], high = low + (a < 2 ? (int64_t)canopy_frame_width(frame, a) : 0);
        within = within && is_float(low) && is_float(high);
    }
    return within || station->config.fit->scalar == CANOPY_FX || !canopy_axes_are_straight(frame->axis);
}

enum canopy_status canopy_station_begin(struct canopy_station *station, const struct canopy_frame *frame) {
    const struct canopy_grid *grid = &station->config.grid;
    if (!is_acceptable(frame, grid)) {
        return CANOPY_ARGUMENT;
    }
    if (!has_scalar(station, frame)) {
        return CANOPY_RANGE;
    }
    struct canopy_station_turning *turning = station->config.turning;
    const bool turned = !canopy_axes_are_straight(frame->axis);
    enum canopy_status status = !turned           ? CANOPY_OK
                                : turning != NULL ? turning->turned_begin(turning, frame)
                                                  : CANOPY_UNSUPPORTED;
    if (status != CANOPY_OK) {
        return status;
    }
    const uint16_t cells[2] = {frame->cells, frame->cells};
    status = canopy_field_init(&station->field, frame, cells, station->field_arena, station->field_bytes);
    if (status == CANOPY_OK) {
        status = canopy_fast_init(&station->fast, &station->field, station->config.fit, station->config.lines,
                                  station->work_arena, station->work_bytes);
    }
    if (status == CANOPY_OK) {
        status =
            canopy_certify_init_apart(&station->certify, &station->field, station->tables_arena, station->work_arena);
    }
    if (status == CANOPY_OK) {
        station->turned = turned;
        forget(station);
    }
    return status;
}

// The frame around a box in the scanner's axes. In turned ones what a reading's z is uncertain by is sideways, too.
static enum canopy_status frame_around(const struct canopy_station *station, const int32_t low[3],
                                       const int32_t high[3], uint32_t uncertainty, struct canopy_frame *frame) {
    const struct canopy_station_config *config = &station->config;
    for (int a = 0; a < 3 && config->fit->scalar == CANOPY_F32; a++) {
        if (!is_float(low[a]) || !is_float(high[a])) {
            return CANOPY_RANGE;
        }
    }
    const bool straight = canopy_axes_are_straight((const int32_t(*)[3])config->axes);
    const enum canopy_status status = straight ? canopy_frame_around_fx(frame, &config->grid, low, high)
                                               : config->turning->turned_frame(config, low, high, uncertainty, frame);
    return status == CANOPY_OK && !has_scalar(station, frame) ? CANOPY_RANGE : status;
}

static enum canopy_status begin_around(struct canopy_station *station, const int32_t low[3], const int32_t high[3],
                                       uint32_t uncertainty) {
    struct canopy_frame frame;
    const enum canopy_status status = frame_around(station, low, high, uncertainty, &frame);
    if (status != CANOPY_OK) {
        return status;
    }
    const struct canopy_frame *old = &station->field.frame;
    if (station->stage != CANOPY_STATION_WAITING && memcmp(old->origin, frame.origin, sizeof frame.origin) == 0 &&
        memcmp(old->pitch, frame.pitch, sizeof frame.pitch) == 0 && old->lsb_log2 == frame.lsb_log2 &&
        memcmp(old->axis, frame.axis, sizeof frame.axis) == 0) {
        return CANOPY_OK;
    }
    return canopy_station_begin(station, &frame);
}

enum canopy_status canopy_station_begin_box(struct canopy_station *station, const int32_t low[3],
                                            const int32_t high[3]) {
    return begin_around(station, low, high, 0);
}

enum canopy_status canopy_station_begin_scene(struct canopy_station *station,
                                              const struct canopy_profile_scene *scene) {
    if (memcmp(&station->config.unit, &scene->unit, sizeof scene->unit) == 0) {
        return begin_around(station, scene->low, scene->high, scene->uncertainty);
    }
    struct canopy_frame frame;
    enum canopy_status status = frame_around(station, scene->low, scene->high, scene->uncertainty, &frame);
    if (status == CANOPY_OK) {
        status = canopy_plc_set_unit(&station->plc, scene->unit);
    }
    if (status != CANOPY_OK) {
        return status;
    }
    station->config.unit = scene->unit;
    return canopy_station_begin(station, &frame);
}

// ---- The step

// Drops the candidate. The last envelope stays; the next attempt waits for its interval, or not if there is an
// intrusion.
static void fail(struct canopy_station *station) {
    station->fits_failed++;
    station->risen = true;
    rest(station);
}

static void begin_certificate(struct canopy_station *station) {
    clear_bits(station, station->late_cells);
    station->late_count = 0;
    station->late_at = 0;
    canopy_certify_begin(&station->certify, station->candidate);
    station->stage = CANOPY_STATION_CERTIFYING;
}

static void begin_fast(struct canopy_station *station) {
    struct canopy_envelope *next = canopy_plc_begin(&station->plc);
    station->kept = false;
    station->tightened = false;
    station->fit_us = station->now_us;
    if (canopy_fast_begin(&station->fast, next->coefficients) != CANOPY_OK) {
        rest(station);  // an empty field: nothing to fit
        return;
    }
    station->candidate = next->coefficients;
    station->risen = false;
    station->stage = CANOPY_STATION_FITTING;
}

// What is published, in the library's orientation.
static void copy_published(const struct canopy_station *station, int32_t *to) {
    const struct canopy_envelope *last = canopy_plc_published(&station->plc);
    memcpy(to, last->coefficients, 4U * last->frame.size[0] * last->frame.size[1]);
    canopy_fast_orient(&last->frame, to);
}

// What is tight is kept if it still holds, as it is.
static void begin_keep(struct canopy_station *station) {
    station->candidate = canopy_plc_begin(&station->plc)->coefficients;
    copy_published(station, station->candidate);
    station->fit_us = station->now_us;
    station->risen = false;
    station->kept = true;
    begin_certificate(station);
}

static void begin_fit(struct canopy_station *station) {
    if (station->tightened && !station->intrusion && canopy_plc_published(&station->plc) != NULL) {
        begin_keep(station);
    } else {
        begin_fast(station);
    }
}

// Publishes the candidate, whose every covered cell is certified at this moment.
static void publish(struct canopy_station *station) {
    struct canopy_envelope *next = canopy_plc_begin(&station->plc);
    const struct canopy_frame *frame = &station->field.frame;
    canopy_fast_orient(frame, next->coefficients);
    next->frame = *frame;
    next->points = station->points;
    next->margin = station->certify.margin;
    const uint32_t covered = canopy_field_coverage(&station->field, next->coverage);
    const uint32_t cells = (frame->size[0] - 1U) * (frame->size[1] - 1U);
    if (canopy_plc_commit(&station->plc) != CANOPY_OK) {
        fail(station);
        return;
    }
    station->coverage_pct = (uint16_t)(100U * covered / cells);
    station->published_points = station->points;
    station->publish_us = station->now_us;
    station->intrusion = station->beyond;
    station->tightened = station->handed || station->kept;
    station->spare_stage =
        station->spare == NULL || station->handed ? CANOPY_STATION_SPARE_NOTHING : CANOPY_STATION_SPARE_WAITING;
    clear_bits(station, station->risen_cells);
    rest(station);
}

// Nothing has risen since the last publication: the same envelope covers all readings there are.
static void refresh(struct canopy_station *station) {
    struct canopy_envelope *next = canopy_plc_begin(&station->plc);
    const struct canopy_envelope *last = canopy_plc_published(&station->plc);
    const size_t count = (size_t)last->frame.size[0] * last->frame.size[1];
    next->frame = last->frame;
    next->margin = last->margin;
    next->points = station->points;
    memcpy(next->coefficients, last->coefficients, 4 * count);
    memcpy(next->coverage, last->coverage, CANOPY_COVERAGE_BYTES(last->frame.size[0], last->frame.size[1]));
    if (canopy_plc_commit(&station->plc) == CANOPY_OK) {
        station->published_points = station->points;
        station->publish_us = station->now_us;
    }
}

static void decide(struct canopy_station *station) {
    if (station->risen && (station->intrusion || station->now_us - station->fit_us >= station->config.interval_us)) {
        begin_fit(station);
    } else if (!station->risen && station->points != station->published_points &&
               canopy_plc_published(&station->plc) != NULL &&
               station->now_us - station->publish_us >= station->config.refresh_us) {
        refresh(station);
    }
}

static void fit(struct canopy_station *station) {
    const enum canopy_status status = canopy_fast_step(&station->fast, 1);
    if (status != CANOPY_OK) {
        if (status != CANOPY_MORE) {
            fail(station);
        }
        return;
    }
    begin_certificate(station);
}

// Raises the candidate under the cell that failed; what was to be kept as it is is fitted anew.
static void mend(struct canopy_station *station) {
    if (station->kept) {
        begin_fast(station);
        return;
    }
    if (canopy_fast_raise(&station->field, station->candidate, station->certify.failed_cell,
                          station->certify.missing) != CANOPY_OK) {
        fail(station);
    }
}

static void certify(struct canopy_station *station) {
    switch (canopy_certify_step(&station->certify, 1)) {
    case CANOPY_OK: station->stage = CANOPY_STATION_SETTLING; break;
    case CANOPY_NOT_SAFE: mend(station); break;
    case CANOPY_MORE: break;
    default: fail(station); break;
    }
}

// The next late cell, from late_at on and around; there is one.
static uint32_t next_late(struct canopy_station *station) {
    const uint32_t cells = cell_count(station);
    uint32_t cell = station->late_at;
    while (!canopy_bit_get(station->late_cells, cell)) {
        cell = cell + 1 < cells ? cell + 1 : 0;
    }
    station->late_at = cell;
    return cell;
}

static void settle(struct canopy_station *station) {
    if (station->late_count == 0) {
        publish(station);
        return;
    }
    const uint32_t cell = next_late(station);
    if (canopy_certify_cell(&station->certify, cell) == CANOPY_OK) {
        canopy_bit_clear(station->late_cells, cell);
        station->late_count--;
    } else {
        mend(station);
    }
}

// ---- Spare time

static void hand_over(struct canopy_station *station) {
    struct canopy_envelope *next = canopy_plc_begin(&station->plc);
    station->spare_stage = CANOPY_STATION_SPARE_NOTHING;
    if (station->spare->spare_take(station->spare, next->coefficients)) {
        station->candidate = next->coefficients;
        station->handed = true;
        begin_certificate(station);
    }
}

static void spend(struct canopy_station *station) {
    struct canopy_station_spare *spare = station->spare;
    if (station->spare_stage == CANOPY_STATION_SPARE_WAITING) {
        int32_t *work = canopy_plc_begin(&station->plc)->coefficients;
        copy_published(station, work);
        station->spare_stage = spare->spare_begin(spare, &station->field, &station->certify, work)
                                   ? CANOPY_STATION_SPARE_WORK
                                   : CANOPY_STATION_SPARE_NOTHING;
    } else if (spare->spare_step(spare) != CANOPY_MORE) {
        hand_over(station);
    }
}

bool canopy_station_is_working(const struct canopy_station *station) {
    switch (station->stage) {
    case CANOPY_STATION_WAITING: return false;
    case CANOPY_STATION_RESTING:
        return station->spare_stage != CANOPY_STATION_SPARE_NOTHING && !station->risen &&
               canopy_plc_published(&station->plc) != NULL;
    default: return true;
    }
}

void canopy_station_step(struct canopy_station *station, uint32_t budget, uint64_t now_us) {
    const uint32_t sequence = canopy_plc_sequence(&station->plc);
    station->now_us = now_us;
    if (station->stage == CANOPY_STATION_RESTING) {
        decide(station);
    }
    // no more than one envelope a cycle
    for (; budget > 0 && canopy_plc_sequence(&station->plc) == sequence && canopy_station_is_working(station);
         budget--) {
        switch (station->stage) {
        case CANOPY_STATION_FITTING: fit(station); break;
        case CANOPY_STATION_CERTIFYING: certify(station); break;
        case CANOPY_STATION_SETTLING: settle(station); break;
        default: spend(station); break;
        }
    }
    station->heartbeat++;
}

struct canopy_modbus_bank canopy_station_bank(struct canopy_station *station) {
    return canopy_plc_bank(&station->plc);
}
