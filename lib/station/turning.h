/// A station's frames with axes of any direction (lib/cover/turn.h): the part that programs with axes x, y and z leave
/// out, 5 KB of a Cortex-M0+.
///
///     static struct canopy_station_turned turned;
///     canopy_station_turned_init(&turned);
///     config.turning = &turned.part;
#ifndef CANOPY_STATION_TURNING_H
#define CANOPY_STATION_TURNING_H

#include "lib/cover/turn.h"
#include "lib/station/station.h"

struct canopy_station_turned {
    struct canopy_station_turning part;  ///< for the station's configuration
    struct canopy_turn_fx turn;          // of the frame in use
};

/// Prepares for one station, whose it is as long as the station is used.
void canopy_station_turned_init(struct canopy_station_turned *turned);

#endif
