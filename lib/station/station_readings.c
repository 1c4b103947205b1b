// Readings on their way into the field, and whether one is an intrusion.

#include "lib/inline.h"
#include "lib/num/bits.h"
#include "lib/station/station.h"

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
