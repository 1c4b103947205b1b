#include "lib/station/turning.h"

#include "lib/cover/axes.h"
#include "lib/num/bits.h"
#include "lib/num/fixed.h"
#include "lib/station/station_parts.h"

// ---- Frames

static bool are_sound(const int32_t axes[3][3]) { return canopy_axes_are_sound(axes); }

// Around the eight corners of the box.
static enum canopy_status make_frame(const struct canopy_station_config *config, const int32_t low[3],
                                     const int32_t high[3], uint32_t uncertainty, struct canopy_frame *frame) {
    if (low[0] > high[0] || low[1] > high[1] || low[2] > high[2]) {
        return CANOPY_ARGUMENT;
    }
    bool saturated = false;  // then the rest of the box has no room either, which the frame says
    const int32_t bottom = canopy_narrow((int64_t)low[2] - uncertainty, &saturated);
    const int32_t top = canopy_narrow((int64_t)high[2] + uncertainty, &saturated);
    struct canopy_turned_box_fx box;
    canopy_turned_box_begin_fx(&box);
    for (unsigned c = 0; c < 8; c++) {
        const int32_t corner[3] = {(c & 1U ? high : low)[0], (c & 2U ? high : low)[1], c & 4U ? top : bottom};
        canopy_turned_box_add_fx(&box, (const int32_t(*)[3])config->axes, corner);
    }
    return canopy_frame_around_turned_fx(frame, &config->grid, (const int32_t(*)[3])config->axes, &box);
}

static enum canopy_status begin(struct canopy_station_turning *turning, const struct canopy_frame *frame) {
    struct canopy_station_turned *turned = (struct canopy_station_turned *)(void *)turning;  // its first member
    return canopy_turn_init_fx(&turned->turn, frame);
}

// ---- Readings

// What a box has done: cells that rose are marked, those that have its height already being marked with them. Whether
// any cell of it has risen since the publication.
static bool mark_patch(struct canopy_station *station, const struct canopy_field_patch *patch) {
    const uint32_t columns = station->field.axis[1].count;
    bool risen = false;
    for (uint32_t r = patch->first[0]; r <= patch->last[0]; r++) {
        for (uint32_t c = patch->first[1]; c <= patch->last[1]; c++) {
            const uint32_t cell = r * columns + c;
            if (patch->raised > 0 && station->field.heights[cell] == patch->height) {
                canopy_station_mark(station, cell);
            }
            risen = risen || canopy_bit_get(station->risen_cells, cell);
        }
    }
    station->risen = station->risen || patch->raised > 0;
    return risen;
}

// Whether a reading in a box that is not what was certified may lie beyond the published envelope: against the least
// that the surface can be over it.
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
static bool is_place_beyond(const struct canopy_station_turned *turned, const struct canopy_station *station,
                            const int32_t point[3], int32_t height) {
    int64_t q[3];
    canopy_turn_point_fx(&turned->turn, point, q);
    const struct canopy_field_box_fx box = {.low = {q[0], q[1]}, .high = {q[0], q[1]}, .top = q[2]};
    return is_box_beyond(station, &box, height);
}

// A reading whose uncertainty is one of the place.
static enum canopy_status take_box(const struct canopy_station_turned *turned, struct canopy_station *station,
                                   const int32_t point[3], uint32_t uncertainty) {
    const uint32_t half[3] = {0, 0, uncertainty};
    struct canopy_field_box_fx box;
    struct canopy_field_patch patch;
    int64_t q[3];
    canopy_turn_point_fx(&turned->turn, point, q);
    enum canopy_status status = canopy_turn_box_fx(&turned->turn, q, half, &box);
    if (status == CANOPY_OK) {
        status = canopy_field_insert_box_fx(&station->field, &box, &patch);
    }
    if (status != CANOPY_OK) {  // all of it beside the frame; else too high or too wide for what is in the frame
        return canopy_station_reject(station, status == CANOPY_OUT_OF_FRAME ? status : CANOPY_RANGE);
    }
    if (mark_patch(station, &patch) && is_box_beyond(station, &box, patch.height)) {
        canopy_station_intrude(station);
    }
    if (!canopy_turn_is_inside_fx(&turned->turn, q)) {
        return canopy_station_reject(station, CANOPY_OUT_OF_FRAME);
    }
    canopy_station_count(station);
    return CANOPY_OK;
}

// A reading that is where it says.
static enum canopy_status take_place(const struct canopy_station_turned *turned, struct canopy_station *station,
                                     const int32_t point[3]) {
    struct canopy_field_hit hit;
    const enum canopy_status status = canopy_turn_insert_fx(&station->field, &turned->turn, point, &hit);
    if (status != CANOPY_OK) {
        return canopy_station_reject(station, status);
    }
    canopy_station_accept(station, &hit);
    if (canopy_bit_get(station->risen_cells, hit.cell) && is_place_beyond(turned, station, point, hit.height)) {
        canopy_station_intrude(station);
    }
    return CANOPY_OK;
}

static enum canopy_status take(struct canopy_station_turning *turning, struct canopy_station *station,
                               const int32_t point[3], uint32_t uncertainty) {
    const struct canopy_station_turned *turned = (const struct canopy_station_turned *)(void *)turning;
    return uncertainty > 0 ? take_box(turned, station, point, uncertainty) : take_place(turned, station, point);
}

void canopy_station_turned_init(struct canopy_station_turned *turned) {
    *turned = (struct canopy_station_turned){
        .part = {
            .turned_are_sound = are_sound, .turned_frame = make_frame, .turned_begin = begin, .turned_reading = take}};
}
