// Readings on their way into the field, and whether one is an intrusion.

#include "lib/num/bits.h"
#include "lib/station/station_parts.h"

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

void canopy_station_mark(struct canopy_station *station, uint32_t cell) {
    (void)canopy_bit_set(station->risen_cells, cell);
    if (station->stage == CANOPY_STATION_CERTIFYING || station->stage == CANOPY_STATION_SETTLING) {
        station->late_count += canopy_bit_set(station->late_cells, cell);
    }
}

void canopy_station_intrude(struct canopy_station *station) {
    station->intrusion = true;
    station->intrusions++;
}

enum canopy_status canopy_station_reject(struct canopy_station *station, enum canopy_status status) {
    station->rejected++;
    if (status == CANOPY_RANGE) {
        station->beyond = true;
        canopy_station_intrude(station);
    }
    return status;
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

// A reading in a frame with axes x, y and z.
static enum canopy_status take(struct canopy_station *station, const int32_t point[3], uint32_t uncertainty) {
    int32_t worst[3];
    struct canopy_field_hit hit;
    const enum canopy_status status = enter(station, point, uncertainty, worst, &hit);
    if (status != CANOPY_OK) {
        return canopy_station_reject(station, status);
    }
    canopy_station_accept(station, &hit);
    if (canopy_bit_get(station->risen_cells, hit.cell) && is_beyond(station, worst, hit.height)) {
        canopy_station_intrude(station);
    }
    return CANOPY_OK;
}

static bool are_floats(const int32_t point[3]) {
    const uint32_t most = CANOPY_STATION_FLOAT_MOST;  // added, negative numbers are none
    return (uint32_t)point[0] + most <= 2 * most && (uint32_t)point[1] + most <= 2 * most &&
           (uint32_t)point[2] + most <= 2 * most;
}

// A reading that is not one of floats, in a station that has them. A lower z than there is counts as the lowest: what
// is above that is above the reading, and above the float nearest to it.
static enum canopy_status take_far(struct canopy_station *station, const int32_t point[3], uint32_t uncertainty) {
    const bool above = station->config.grid.side == CANOPY_ABOVE;
    if (!station->turned && is_beside(&station->field.frame, point)) {
        return canopy_station_reject(station, CANOPY_OUT_OF_FRAME);
    }
    if (station->turned || (point[2] > 0) == above) {
        return canopy_station_reject(station, CANOPY_RANGE);
    }
    const int32_t lowest = above ? -CANOPY_STATION_FLOAT_MOST : CANOPY_STATION_FLOAT_MOST;
    return take(station, (const int32_t[3]){point[0], point[1], lowest}, uncertainty);
}

enum canopy_status canopy_station_reading(struct canopy_station *station, const int32_t point[3], uint32_t uncertainty,
                                          uint64_t now_us) {
    station->now_us = now_us;
    if (station->stage == CANOPY_STATION_WAITING) {
        station->rejected++;
        return CANOPY_EMPTY;
    }
    if (station->config.fit->scalar == CANOPY_F32 && !are_floats(point)) {
        return take_far(station, point, uncertainty);
    }
    if (station->turned) {
        return station->config.turning->turned_reading(station->config.turning, station, point, uncertainty);
    }
    return take(station, point, uncertainty);
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
