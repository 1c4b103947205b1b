/// A whole device: a profile scanner behind a link, a station, and the RTU server of a PLC on a serial line. It waits
/// for nothing: a board calls it in a loop.
///
///     for (;;) {
///         const uint64_t due_us = canopy_device_step(&device);
///         … feed the watchdog, sleep until an interrupt brings work or the clock reaches due_us …
///     }
///
/// One step moves the bytes there are, carries out at most one PLC request and one scanner answer, takes at most
/// `readings` readings and does at most `budget` units of fitting: its length is bounded, and the PLC is answered in
/// the step in which its silence of T3.5 is over.
#ifndef CANOPY_STATION_DEVICE_H
#define CANOPY_STATION_DEVICE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/modbus/rtu.h"
#include "lib/port.h"
#include "lib/scan/link.h"
#include "lib/scan/profile.h"
#include "lib/station/health.h"
#include "lib/station/station.h"
#include "lib/status.h"

struct canopy_device_scanner {
    struct canopy_scan_link link;  ///< lib/station/rtu_link.h, lib/scan/i2c_link.h, or the board's own
    const struct canopy_profile_table
        *table;        ///< the kind of scanner: sound (canopy_scan_table_ok), outlives the device
    uint16_t columns;  ///< the most readings a profile may have
    uint8_t unit;      ///< Modbus unit; I2C address, 0: the table's
};

struct canopy_device_plc {
    struct canopy_stream stream;
    uint32_t baud;           ///< for the silences; 0: bytes take no time
    uint8_t character_bits;  ///< 10 (8N1) or 11
    uint8_t unit;            ///< ours: 1 to 247
};

struct canopy_device_config {
    struct canopy_clock clock;
    struct canopy_device_scanner scanner;
    struct canopy_device_plc plc;
    const struct canopy_frame *frame;      ///< of scanners that do not tell their scene, else NULL
    struct canopy_station_config station;  ///< clients must be 1; a scanner that tells its unit overrides it
    uint16_t readings;                     ///< taken in one step, at least 1
    uint16_t budget;                       ///< units of canopy_station_step in one step, at least 1
};

/// Bytes of arena. `words` is 1 for scanners with heights of 16 bits, 2 for 32.
#define CANOPY_DEVICE_ARENA(m, n, cells, lines, columns, words)                                                        \
    (CANOPY_STATION_ARENA(m, n, cells, lines, 1) + CANOPY_PROFILE_ARENA(columns, words))

/// Private but for the station, which may be looked at.
struct canopy_device {
    uint16_t column;  // of the profile being taken
    bool asked;
    bool bad;     // the scanner's last profile or description did not come or made no sense
    bool framed;  // the frame is the configuration's, not the scanner's
    uint16_t readings, budget;
    struct canopy_clock clock;
    struct canopy_scan_link link;
    struct canopy_stream plc;
    struct canopy_station station;
    struct canopy_profile_driver driver;
    struct canopy_modbus_bank bank;
    struct canopy_modbus_rtu_server server;
    struct canopy_health *health;  // or NULL
};

/// Makes a device that waits for its scanner. `arena`: CANOPY_DEVICE_ARENA bytes, aligned to 8, the device's as long as
/// it is used. CANOPY_ARGUMENT, CANOPY_ARENA_SHORT, CANOPY_ARENA_ALIGN as its parts say; CANOPY_ARGUMENT, too, without
/// a frame for a scanner that does not tell its scene.
enum canopy_status canopy_device_init(struct canopy_device *device, const struct canopy_device_config *config,
                                      void *arena, size_t bytes);

/// Puts a health that has been opened and tested behind the device's registers; canopy_device_step gives it its time.
void canopy_device_keep(struct canopy_device *device, struct canopy_health *health);

/// One cycle. Returns when the next has something to do although no interrupt comes: a time that has passed means at
/// once.
uint64_t canopy_device_step(struct canopy_device *device);

#endif
