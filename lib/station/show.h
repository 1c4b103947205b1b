/// What the station and the belt show alike: counters of others, and one height of an envelope.
#ifndef CANOPY_STATION_SHOW_H
#define CANOPY_STATION_SHOW_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/cover/envelope.h"
#include "lib/plc/plc.h"
#include "lib/scan/link.h"
#include "lib/scan/profile.h"

/// What the port adds to the counters; the station only shows it.
struct canopy_station_port {
    uint32_t rx_frames, rx_errors, lost_bytes;  ///< of all PLC ports
    uint32_t cycle_us, cycle_max_us;            ///< of the main loop
    struct canopy_scan_link_counters scan;      ///< of the wire to the scanner
};

/// Milliseconds that fit a register.
static inline uint32_t canopy_show_ms(uint64_t us) {
    const uint64_t ms = us / 1000;
    return ms < UINT32_MAX ? (uint32_t)ms : UINT32_MAX;
}

/// The port's counters and the scanner driver's (NULL: none).
void canopy_show_port(const struct canopy_station_port *port, const struct canopy_profile_counters *scan,
                      struct canopy_plc_counters *to);

/// Answers a query at (x, y), device units along u and v: see struct canopy_plc_source.
enum canopy_plc_query_status canopy_show_height(const struct canopy_envelope *envelope, int32_t x, int32_t y,
                                                bool intrusion, int32_t *height);

#endif
