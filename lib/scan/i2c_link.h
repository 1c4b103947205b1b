/// A scan link over I2C: a profile scanner as a register file, as its table says (struct canopy_scan_i2c in
/// lib/scan/table.h; lib/scan/generic.h has the wire format of the generic map).
///
///     static struct canopy_i2c_link i2c;
///     canopy_i2c_link_init(&i2c, &board.i2c, &canopy_profile_generic, 50000);
///     config.link = canopy_i2c_link(&i2c);
///
/// One read of the driver is one transfer, or several, one behind the other, where the bus or the device cannot carry
/// it at once. Header and description always go in one, as their registers must be of one moment; for the heights the
/// sequence number behind them shows whether they are.
///
/// What the check sum of the table covers is checked; without one (CANOPY_SCAN_UNCHECKED) a byte that noise turned is
/// seen only if it makes the profile contradict itself.
///
/// How transfers that failed are told: CANOPY_SCAN_NAK, CANOPY_SCAN_TIMEOUT, CANOPY_SCAN_BUS (another master, a line
/// held low, or the bus in use by somebody else of this program for `timeout_us`), CANOPY_SCAN_CRC, CANOPY_SCAN_LINK
/// (the platform cannot do it, or the address or pointer cannot be).
#ifndef CANOPY_SCAN_I2C_LINK_H
#define CANOPY_SCAN_I2C_LINK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/port.h"
#include "lib/scan/link.h"
#include "lib/scan/table.h"
#include "lib/status.h"

#define CANOPY_I2C_LINK_REQUEST_MAX 4  ///< bytes written: pointer, count, tag
#define CANOPY_I2C_LINK_CHECK_MAX 2

/// About 300 bytes. Private.
struct canopy_i2c_link {
    const struct canopy_i2c *bus;
    const struct canopy_profile_table *table;
    uint64_t begun_us;
    uint32_t timeout_us;
    uint16_t address, count, done;  // registers: the first, wanted, there
    uint8_t device;                 // its address on the bus
    uint8_t most;                   // registers in one transfer
    uint8_t now;                    // of them in the one under way
    uint8_t tag;                    // of that one
    uint8_t state;
    uint8_t out[CANOPY_I2C_LINK_REQUEST_MAX];
    uint8_t in[2 * CANOPY_SCAN_READ_MAX + CANOPY_I2C_LINK_CHECK_MAX];  // as on the wire
};

/// Prepares; nothing goes over the bus yet. `bus` and `table` must outlive the link. `timeout_us`: of one transfer,
/// more than the longest takes (258 bytes at 100 kHz: 24 ms) and than a device may hold the clock.
/// CANOPY_ARGUMENT: no timeout, or the table says nothing of I2C or what cannot be; CANOPY_UNSUPPORTED: the bus cannot
/// carry header or description at once, or there is none.
enum canopy_status canopy_i2c_link_init(struct canopy_i2c_link *link, const struct canopy_i2c *bus,
                                        const struct canopy_profile_table *table, uint32_t timeout_us);

/// The link as the seam of lib/scan/link.h; valid as long as `link` is.
struct canopy_scan_link canopy_i2c_link(struct canopy_i2c_link *link);

#endif
