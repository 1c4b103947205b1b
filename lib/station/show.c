#include "lib/station/show.h"

void canopy_show_port(const struct canopy_station_port *port, const struct canopy_profile_counters *scan,
                      struct canopy_plc_counters *to) {
    to->rx_frames = port->rx_frames;
    to->rx_errors = port->rx_errors;
    to->lost_bytes = port->lost_bytes;
    to->cycle_us = port->cycle_us;
    to->cycle_max_us = port->cycle_max_us;
    if (scan != NULL) {
        to->readings_invalid = scan->invalid;
        to->profiles = scan->profiles;
        to->profiles_missed = scan->missed;
        to->profiles_torn = scan->torn;
        to->profiles_short = scan->short_of;
        to->profiles_stale = scan->stale;
        to->profiles_refused = scan->refused;
    }
}

enum canopy_plc_query_status canopy_show_height(const struct canopy_envelope *envelope, int32_t x, int32_t y,
                                                bool intrusion, int32_t *height) {
    int32_t low, high;
    if (x < 0 || y < 0 || canopy_envelope_height(envelope, (uint32_t)x, (uint32_t)y, &low, &high) != CANOPY_OK) {
        return CANOPY_PLC_QUERY_OUTSIDE;
    }
    if (!canopy_envelope_covers(envelope, (uint32_t)x, (uint32_t)y)) {
        return CANOPY_PLC_QUERY_UNCOVERED;
    }
    *height = envelope->frame.side == CANOPY_ABOVE ? high : low;
    return intrusion ? CANOPY_PLC_QUERY_INTRUSION : CANOPY_PLC_QUERY_GOOD;
}
