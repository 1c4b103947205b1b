/// The scanner that the options name, as registers that a scanner thread reads.
#ifndef CANOPY_BOARDS_LINUX_SOURCE_H
#define CANOPY_BOARDS_LINUX_SOURCE_H

#include <stdbool.h>

#include "boards/linux/url.h"
#include "port/linux/modbus_client.h"
#include "port/linux/scanner.h"
#include "tools/common/fault.h"
#include "tools/common/sweep.h"

/// Must not move once open.
struct canopyd_source {
    const struct canopy_profile_table *table;
    struct canopy_linux_registers registers;
    struct canopy_sweep *sweep;                // sim
    struct canopy_linux_modbus_client modbus;  // modbus-rtu, modbus-tcp
};

/// Prepares it: reads the point file of sim with `unit` (0: the unit rule), looks the driver up, checks that an RTU
/// device is there. Nothing is connected yet.
bool canopyd_source_open(struct canopyd_source *source, const struct canopyd_scanner_url *url, double unit,
                         uint32_t timeout_us, struct canopy_fault *fault);

void canopyd_source_close(struct canopyd_source *source);

#endif
