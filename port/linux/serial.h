/// A serial line of Linux as a stream that never blocks: raw termios, eight data bits.
#ifndef CANOPY_PORT_LINUX_SERIAL_H
#define CANOPY_PORT_LINUX_SERIAL_H

#include <stdbool.h>
#include <stdint.h>
#include <termios.h>

#include "lib/port.h"

struct canopy_linux_serial_config {
    const char *device;  ///< a path; read by open only
    uint32_t baud;       ///< one that canopy_linux_baud_known() knows
    char parity;         ///< 'N', 'E' or 'O'; bytes with a wrong one are dropped and counted as lost
    uint8_t stop_bits;   ///< 1 or 2
    bool rs485;          ///< let the kernel switch the driver (TIOCSRS485); see `rs485` below
};

/// One open line. The members may be read.
struct canopy_linux_serial {
    int fd;            ///< -1 when closed
    bool gone;         ///< the device went away (unplugged, hung up): close it and try again later
    bool rs485;        ///< the kernel switches the driver. False though asked for: this device cannot
    uint32_t lost;     // received bytes lost up to `base`, of earlier openings too
    uint32_t base[4];  // what TIOCGICOUNT said at open
    bool counts;       // it says something at all
};

/// Whether this is a standard rate of Linux that libmodbus knows too.
bool canopy_linux_baud_known(uint32_t baud);

/// The rate as termios names it; false if it is not known.
bool canopy_linux_speed(uint32_t baud, speed_t *speed);

/// Opens the line for this process alone (TIOCEXCL), forgets what was waiting in it. NULL, or in a few words what is
/// wrong; the line is closed then. `lost` of an earlier opening of the same struct goes on; begin with a zeroed one.
const char *canopy_linux_serial_open(struct canopy_linux_serial *line, const struct canopy_linux_serial_config *config);

/// Closes; harmless when closed.
void canopy_linux_serial_close(struct canopy_linux_serial *line);

/// The line as a stream; it must outlive it. `sent` is true when the kernel's buffer and the transmitter are empty.
struct canopy_stream canopy_linux_serial_stream(struct canopy_linux_serial *line);

#endif
