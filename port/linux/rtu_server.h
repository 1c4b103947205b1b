/// A Modbus RTU server on a serial line, never waiting for it.
///
/// When the device goes away (an adapter unplugged, a pty closed at its other end) the line is closed and opened again
/// every second until it is back.
#ifndef CANOPY_PORT_LINUX_RTU_SERVER_H
#define CANOPY_PORT_LINUX_RTU_SERVER_H

#include <poll.h>
#include <stdint.h>

#include "lib/modbus/rtu.h"
#include "port/linux/serial.h"

struct canopy_linux_rtu_server_config {
    const struct canopy_modbus_bank *bank;     ///< must outlive the server
    struct canopy_linux_serial_config serial;  ///< `device` must outlive the server
    uint8_t unit;                              ///< 1 to 247
    uint8_t client;                            ///< of the bank
    /// Called with `client` when the line opens and when it closes. May be NULL.
    void (*forget)(void *context, uint8_t client);
    void *context;
};

/// All members are the server's own.
struct canopy_linux_rtu_server {
    struct canopy_linux_rtu_server_config config;
    struct canopy_linux_serial line;
    struct canopy_modbus_rtu_server modbus;
    uint32_t rx_frames, rx_errors;  // of earlier openings
    uint64_t retry_us;
    bool blocked;  // the line takes no more of the reply for now
};

/// Opens the line. NULL, or in a few words what is wrong.
const char *canopy_linux_rtu_server_open(struct canopy_linux_rtu_server *server,
                                         const struct canopy_linux_rtu_server_config *config);

/// What to poll for, and when to call serve in any case (canopy_modbus_rtu_server_due).
void canopy_linux_rtu_server_watch(const struct canopy_linux_rtu_server *server, struct pollfd *fd);
uint64_t canopy_linux_rtu_server_due(const struct canopy_linux_rtu_server *server);

/// Serves the line: takes at most 1 KiB, answers what is due. Call it when `fd` is ready or the time is due.
void canopy_linux_rtu_server_serve(struct canopy_linux_rtu_server *server, uint64_t now_us);

/// Monotonic, over all openings; `lost`: received bytes lost to parity, framing and overrun.
uint32_t canopy_linux_rtu_server_rx_frames(const struct canopy_linux_rtu_server *server);
uint32_t canopy_linux_rtu_server_rx_errors(const struct canopy_linux_rtu_server *server);
uint32_t canopy_linux_rtu_server_lost(struct canopy_linux_rtu_server *server);

void canopy_linux_rtu_server_close(struct canopy_linux_rtu_server *server);

#endif
