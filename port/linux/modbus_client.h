/// Reads registers of a Modbus device through libmodbus: RTU or TCP, connecting as needed. Its calls block.
///
/// What libmodbus 3.1.6 leaves to its user is done here: T3.5 of silence before every RTU request, late bytes thrown
/// away, a TCP connection given up after anything but a Modbus exception (a late answer would be taken for the next
/// one's, and then for ever), the RTU line checked to run at the rate asked for, a new try after a lost link only when
/// its back-off is over: 0.1 s, doubled to at most 5 s.
#ifndef CANOPY_PORT_LINUX_MODBUS_CLIENT_H
#define CANOPY_PORT_LINUX_MODBUS_CLIENT_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/scan/profile.h"
#include "port/linux/serial.h"

struct canopy_linux_modbus_config {
    bool tcp;
    const char *host, *service;                ///< TCP: name or number, port; must outlive the client
    struct canopy_linux_serial_config serial;  ///< RTU; `device` must outlive the client
    uint32_t timeout_us;  ///< an answer begins within this time, RTU wire time added; at least 1000
};

/// All members are the client's own.
struct canopy_linux_modbus_client {
    struct canopy_linux_modbus_config config;
    struct _modbus *modbus;
    bool connected;
    uint64_t quiet_us;     // RTU: when the last byte came or went
    uint64_t retry_us;     // no connection is tried before
    uint32_t back_off_us;  // after the next failure
    char why[80];          ///< what libmodbus said of the last failure
};

/// Prepares; connects to nothing yet. False: no memory, or something libmodbus refuses.
bool canopy_linux_modbus_open(struct canopy_linux_modbus_client *client,
                              const struct canopy_linux_modbus_config *config);

/// When fetch may be called: a time to wait for while the link is down, else 0.
uint64_t canopy_linux_modbus_ready_us(const struct canopy_linux_modbus_client *client);

/// Does the request into `registers` (request->count of them, host order). False: *failure says why, client->why in
/// words. Blocks for two timeouts and the wire time of a frame at most, but for the look-up of a host's name.
bool canopy_linux_modbus_fetch(struct canopy_linux_modbus_client *client, const struct canopy_profile_request *request,
                               uint16_t *registers, enum canopy_scan_failure *failure);

void canopy_linux_modbus_close(struct canopy_linux_modbus_client *client);

#endif
