#include "lib/station/station.h"

#include <string.h>

#include "lib/inline.h"
#include "lib/num/bits.h"
#include "lib/num/fixed.h"
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

// All 0 is x, y and z. False where they are no rotation.
static bool settle_axes(int32_t axes[3][3]) {
    static const int32_t none[3][3];
    if (memcmp(axes, none, sizeof none) == 0) {
        axes[0][0] = axes[1][1] = axes[2][2] = CANOPY_AXIS_ONE;
    }
    return canopy_axes_are_sound((const int32_t(*)[3])axes);
}

enum canopy_status canopy_station_init(struct canopy_station *station, const struct canopy_station_config *config,
                                       void *arena, size_t bytes, uint64_t now_us) {
    const struct canopy_grid *grid = &config->grid;
    const uint16_t m = grid->size[0], n = grid->size[1], q = grid->cells;
    if (m < CANOPY_SIZE_MIN || n < CANOPY_SIZE_MIN || m > CANOPY_SIZE_MAX || n > CANOPY_SIZE_MAX || q < 1 ||
        q > CANOPY_CELLS_MAX || config->lines < 1 || q % config->lines != 0) {
        return CANOPY_ARGUMENT;
    }
    struct canopy_station_config own = *config;
    if (!settle_axes(own.axes)) {
        return CANOPY_ARGUMENT;
    }
    struct canopy_arena cut;
    enum canopy_status status =
        canopy_arena_open(&cut, arena, bytes, CANOPY_STATION_ARENA(m, n, q, config->lines, config->clients));
    if (status != CANOPY_OK) {
        return status;
    }
    *station = (struct canopy_station){.config = own, .start_us = now_us, .now_us = now_us};
    station->field_arena = canopy_arena_take(&cut, CANOPY_FIELD_ARENA(m, n, q, q));
    station->risen_cells = canopy_arena_take(&cut, CANOPY_STATION_MARKS(m, n, q));
    station->late_cells = canopy_arena_take(&cut, CANOPY_STATION_MARKS(m, n, q));
    station->fast_arena = canopy_arena_take(&cut, CANOPY_FAST_ARENA(m, n, q, config->lines));
    station->certify_arena = canopy_arena_take(&cut, CANOPY_CERTIFY_ARENA(n, q, q));
    const struct canopy_plc_config plc = {
        .size = {m, n},
        .side = grid->side,
        .scalar = CANOPY_FX,
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
    return canopy_axes_are_sound(frame->axis) && frame->pitch[0] > 0 && frame->pitch[0] % grid->cells == 0 &&
           frame->pitch[1] > 0 && frame->pitch[1] % grid->cells == 0;
}

enum canopy_status canopy_station_begin(struct canopy_station *station, const struct canopy_frame *frame) {
    const struct canopy_grid *grid = &station->config.grid;
    if (!is_acceptable(frame, grid)) {
        return CANOPY_ARGUMENT;
    }
    struct canopy_turn_fx turn;
    const bool turned = !canopy_axes_are_straight(frame->axis);
    enum canopy_status status = turned ? canopy_turn_init_fx(&turn, frame) : CANOPY_OK;
    if (status != CANOPY_OK) {
        return status;
    }
    const uint16_t cells[2] = {frame->cells, frame->cells};
    status = canopy_field_init(&station->field, frame, cells, station->field_arena,
                               CANOPY_FIELD_ARENA(grid->size[0], grid->size[1], cells[0], cells[1]));
    if (status == CANOPY_OK) {
        status =
            canopy_fast_init(&station->fast, &station->field, CANOPY_FX, station->config.lines, station->fast_arena,
                             CANOPY_FAST_ARENA(grid->size[0], grid->size[1], cells[1], station->config.lines));
    }
    if (status == CANOPY_OK) {
        status = canopy_certify_init(&station->certify, &station->field, station->certify_arena,
                                     CANOPY_CERTIFY_ARENA(grid->size[1], cells[0], cells[1]));
    }
    if (status == CANOPY_OK) {
        station->turned = turned;
        if (turned) {
            station->turn = turn;
        }
        forget(station);
    }
    return status;
}

// The frame around a box in the scanner's axes: with turned ones, around its eight corners.
static enum canopy_status frame_around(const struct canopy_station *station, const int32_t low[3],
                                       const int32_t high[3], struct canopy_frame *frame) {
    const int32_t(*axes)[3] = station->config.axes;
    if (canopy_axes_are_straight(axes) || low[0] > high[0] || low[1] > high[1] || low[2] > high[2]) {
        return canopy_frame_around_fx(frame, &station->config.grid, low, high);
    }
    struct canopy_turned_box_fx box;
    canopy_turned_box_begin_fx(&box);
    for (unsigned c = 0; c < 8; c++) {
        const int32_t corner[3] = {(c & 1U ? high : low)[0], (c & 2U ? high : low)[1], (c & 4U ? high : low)[2]};
        canopy_turned_box_add_fx(&box, axes, corner);
    }
    return canopy_frame_around_turned_fx(frame, &station->config.grid, axes, &box);
}

enum canopy_status canopy_station_begin_box(struct canopy_station *station, const int32_t low[3],
                                            const int32_t high[3]) {
    struct canopy_frame frame;
    const enum canopy_status status = frame_around(station, low, high, &frame);
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

// The scene's box; in turned axes what a reading's z is uncertain by is sideways, too, so the box holds that as well.
static void box_of(const struct canopy_station *station, const struct canopy_profile_scene *scene, int32_t low[3],
                   int32_t high[3]) {
    const int64_t more = canopy_axes_are_straight((const int32_t(*)[3])station->config.axes) ? 0 : scene->uncertainty;
    bool saturated = false;  // then the rest of the box has no room either, which the frame says
    memcpy(low, scene->low, sizeof scene->low);
    memcpy(high, scene->high, sizeof scene->high);
    low[2] = canopy_narrow(low[2] - more, &saturated);
    high[2] = canopy_narrow(high[2] + more, &saturated);
}

enum canopy_status canopy_station_begin_scene(struct canopy_station *station,
                                              const struct canopy_profile_scene *scene) {
    int32_t low[3], high[3];
    box_of(station, scene, low, high);
    if (memcmp(&station->config.unit, &scene->unit, sizeof scene->unit) == 0) {
        return canopy_station_begin_box(station, low, high);
    }
    struct canopy_frame frame;
    enum canopy_status status = frame_around(station, low, high, &frame);
    if (status == CANOPY_OK) {
        status = canopy_plc_set_unit(&station->plc, scene->unit);
    }
    if (status != CANOPY_OK) {
        return status;
    }
    station->config.unit = scene->unit;
    return canopy_station_begin(station, &frame);
}

// ---- Readings

// Whether a reading whose cell is not what was certified may lie beyond the published envelope. What is not sure counts
// as beyond.
static bool is_beyond(const struct canopy_station *station, const int32_t point[3], int32_t height) {
    const struct canopy_envelope *envelope = canopy_plc_published(&station->plc);
    if (envelope == NULL) {
        return false;
    }
    const uint32_t u = (uint32_t)point[0] - (uint32_t)envelope->frame.origin[0];
    const uint32_t v = (uint32_t)point[1] - (uint32_t)envelope->frame.origin[1];
    int32_t low, high;
    if (canopy_envelope_height(envelope, u, v, &low, &high) != CANOPY_OK) {
        return true;
    }
    return envelope->frame.side == CANOPY_ABOVE ? height > low : height > -high;
}

// Remembers that a cell rose: since the last publication, and after the certificate had passed it.
static void mark(struct canopy_station *station, uint32_t cell) {
    (void)canopy_bit_set(station->risen_cells, cell);
    if (station->stage == CANOPY_STATION_CERTIFYING || station->stage == CANOPY_STATION_SETTLING) {
        station->late_count += canopy_bit_set(station->late_cells, cell);
    }
}

static void intrude(struct canopy_station *station) {
    station->intrusion = true;
    station->intrusions++;
}

static bool is_beside(const struct canopy_frame *frame, const int32_t point[3]) {
    for (int a = 0; a < 2; a++) {
        const int64_t offset = (int64_t)point[a] - frame->origin[a];
        if (offset < 0 || offset > (int64_t)canopy_frame_width(frame, a)) {
            return true;
        }
    }
    return false;
}

// Enters the reading with z at the unsafe end of its uncertainty, `worst`. Where that does not fit 32 bits the frame
// may still reach that far, but no coordinate does: it is out of range.
static enum canopy_status enter(struct canopy_station *station, const int32_t point[3], uint32_t uncertainty,
                                int32_t worst[3], struct canopy_field_hit *hit) {
    const bool above = station->config.grid.side == CANOPY_ABOVE;
    const int64_t z = (int64_t)point[2] + (above ? (int64_t)uncertainty : -(int64_t)uncertainty);
    if (z > INT32_MAX || z < INT32_MIN) {
        return is_beside(&station->field.frame, point) ? CANOPY_OUT_OF_FRAME : CANOPY_RANGE;
    }
    worst[0] = point[0];
    worst[1] = point[1];
    worst[2] = (int32_t)z;
    return canopy_field_insert_fx(&station->field, worst, hit);
}

static enum canopy_status reject(struct canopy_station *station, enum canopy_status status) {
    station->rejected++;
    if (status == CANOPY_RANGE) {
        station->beyond = true;
        intrude(station);
    }
    return status;
}

CANOPY_INLINE void count(struct canopy_station *station) {
    station->points++;
    station->accepted++;
    station->have_reading = true;
    station->reading_us = station->now_us;
}

CANOPY_INLINE void accept(struct canopy_station *station, const struct canopy_field_hit *hit) {
    count(station);
    if (hit->raised) {
        station->risen = true;
        mark(station, hit->cell);
    }
}

// What a box has done: cells that rose are marked, those that have its height already being marked with them. Whether
// any cell of it has risen since the publication.
static bool mark_patch(struct canopy_station *station, const struct canopy_field_patch *patch) {
    const uint32_t columns = station->field.axis[1].count;
    bool risen = false;
    for (uint32_t r = patch->first[0]; r <= patch->last[0]; r++) {
        for (uint32_t c = patch->first[1]; c <= patch->last[1]; c++) {
            const uint32_t cell = r * columns + c;
            if (patch->raised > 0 && station->field.heights[cell] == patch->height) {
                mark(station, cell);
            }
            risen = risen || canopy_bit_get(station->risen_cells, cell);
        }
    }
    station->risen = station->risen || patch->raised > 0;
    return risen;
}

// As is_beyond, for a box: against the least that the surface can be over it.
static bool is_box_beyond(const struct canopy_station *station, const struct canopy_field_box_fx *box, int32_t height) {
    const struct canopy_envelope *envelope = canopy_plc_published(&station->plc);
    if (envelope == NULL) {
        return false;
    }
    int32_t low, high;
    if (canopy_envelope_over(envelope, box->low, box->high, &low, &high) != CANOPY_OK) {
        return true;
    }
    return envelope->frame.side == CANOPY_ABOVE ? height > low : height > -high;
}

// The same for a place without uncertainty.
static bool is_place_beyond(const struct canopy_station *station, const int32_t point[3], int32_t height) {
    int64_t q[3];
    canopy_turn_point_fx(&station->turn, point, q);
    const struct canopy_field_box_fx box = {.low = {q[0], q[1]}, .high = {q[0], q[1]}, .top = q[2]};
    return is_box_beyond(station, &box, height);
}

// A reading whose uncertainty is one of the place.
static enum canopy_status take_box(struct canopy_station *station, const int32_t point[3], uint32_t uncertainty) {
    const uint32_t half[3] = {0, 0, uncertainty};
    struct canopy_field_box_fx box;
    struct canopy_field_patch patch;
    int64_t q[3];
    canopy_turn_point_fx(&station->turn, point, q);
    enum canopy_status status = canopy_turn_box_fx(&station->turn, q, half, &box);
    if (status == CANOPY_OK) {
        status = canopy_field_insert_box_fx(&station->field, &box, &patch);
    }
    if (status != CANOPY_OK) {  // all of it beside the frame; else too high or too wide for what is in the frame
        return reject(station, status == CANOPY_OUT_OF_FRAME ? status : CANOPY_RANGE);
    }
    if (mark_patch(station, &patch) && is_box_beyond(station, &box, patch.height)) {
        intrude(station);
    }
    if (!canopy_turn_is_inside_fx(&station->turn, q)) {
        return reject(station, CANOPY_OUT_OF_FRAME);
    }
    count(station);
    return CANOPY_OK;
}

// A reading that is where it says.
static enum canopy_status take_turned(struct canopy_station *station, const int32_t point[3]) {
    struct canopy_field_hit hit;
    const enum canopy_status status = canopy_turn_insert_fx(&station->field, &station->turn, point, &hit);
    if (status != CANOPY_OK) {
        return reject(station, status);
    }
    accept(station, &hit);
    if (canopy_bit_get(station->risen_cells, hit.cell) && is_place_beyond(station, point, hit.height)) {
        intrude(station);
    }
    return CANOPY_OK;
}

enum canopy_status canopy_station_reading(struct canopy_station *station, const int32_t point[3], uint32_t uncertainty,
                                          uint64_t now_us) {
    station->now_us = now_us;
    if (station->stage == CANOPY_STATION_WAITING) {
        station->rejected++;
        return CANOPY_EMPTY;
    }
    if (station->turned) {
        return uncertainty > 0 ? take_box(station, point, uncertainty) : take_turned(station, point);
    }
    int32_t worst[3];
    struct canopy_field_hit hit;
    const enum canopy_status status = enter(station, point, uncertainty, worst, &hit);
    if (status != CANOPY_OK) {
        return reject(station, status);
    }
    accept(station, &hit);
    if (canopy_bit_get(station->risen_cells, hit.cell) && is_beyond(station, worst, hit.height)) {
        intrude(station);
    }
    return CANOPY_OK;
}

bool canopy_station_profile(struct canopy_station *station, struct canopy_profile_driver *driver, uint16_t *column,
                            uint16_t most, uint64_t now_us) {
    const struct canopy_profile *profile = canopy_profile_get(driver);
    if (profile == NULL) {
        return false;
    }
    for (; most > 0 && *column < profile->columns; most--, (*column)++) {
        struct canopy_reading reading;
        if (canopy_profile_reading(driver, *column, &reading) && reading.valid) {
            const int32_t point[3] = {reading.x, reading.y, reading.z};
            (void)canopy_station_reading(station, point, reading.uncertainty, now_us);  // counted there
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
