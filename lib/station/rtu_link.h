/// A scan link over a serial line: a profile scanner that is a Modbus RTU server (lib/modbus/rtu.h).
///
///     static struct canopy_rtu_link rtu;
///     canopy_rtu_link_init(&rtu, &(struct canopy_rtu_link_config){.clock = board.clock, .stream = board.line[0],
///                                                                  .baud = 115200, .character_bits = 10,
///                                                                  .timeout_us = 500000});
///     config.scanner.link = canopy_rtu_link(&rtu);
///
/// It must be moved on also while no read is under way, so that what a disturbed line brings then is thrown away.
#ifndef CANOPY_STATION_RTU_LINK_H
#define CANOPY_STATION_RTU_LINK_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/modbus/rtu.h"
#include "lib/port.h"
#include "lib/scan/link.h"
#include "lib/status.h"

struct canopy_rtu_link_config {
    struct canopy_clock clock;
    struct canopy_stream stream;
    uint32_t baud;           ///< for the silences; 0: bytes take no time
    uint32_t timeout_us;     ///< from the request's end to the answer's start; the wire time is added
    uint8_t character_bits;  ///< 10 (8N1) or 11
};

/// About 370 bytes. Private.
struct canopy_rtu_link {
    struct canopy_clock clock;
    struct canopy_stream stream;
    struct canopy_modbus_rtu_client client;
    uint32_t errors;  // of the client, when it was asked
    bool asked;
};

/// CANOPY_ARGUMENT as canopy_modbus_rtu_client_init says.
enum canopy_status canopy_rtu_link_init(struct canopy_rtu_link *link, const struct canopy_rtu_link_config *config);

/// The link as the seam of lib/scan/link.h; valid as long as `link` is.
struct canopy_scan_link canopy_rtu_link(struct canopy_rtu_link *link);

#endif
