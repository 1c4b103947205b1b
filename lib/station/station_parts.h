/// What a station's files share: the accounts of a reading.
#ifndef CANOPY_STATION_PARTS_H
#define CANOPY_STATION_PARTS_H

#include <stdint.h>

#include "lib/inline.h"
#include "lib/station/station.h"

/// Remembers that a cell rose: since the last publication, and after the certificate had passed it.
void canopy_station_mark(struct canopy_station *station, uint32_t cell);

/// A reading lies beyond the published envelope.
void canopy_station_intrude(struct canopy_station *station);

/// Counts a reading that is not accepted; CANOPY_RANGE: it is beyond what any envelope can cover. Returns `status`.
enum canopy_status canopy_station_reject(struct canopy_station *station, enum canopy_status status);

/// Counts one that is.
CANOPY_INLINE void canopy_station_count(struct canopy_station *station) {
    station->points++;
    station->accepted++;
    station->have_reading = true;
    station->reading_us = station->now_us;
}

/// The same for one of one cell.
CANOPY_INLINE void canopy_station_accept(struct canopy_station *station, const struct canopy_field_hit *hit) {
    canopy_station_count(station);
    if (hit->raised) {
        station->risen = true;
        canopy_station_mark(station, hit->cell);
    }
}

#endif
