/// The wires of the simulator: one RTU line, one TCP listener with up to eight connections, one loop.
#ifndef CANOPY_TOOLS_SCANNER_SERVE_H
#define CANOPY_TOOLS_SCANNER_SERVE_H

#include <stdbool.h>
#include <stdint.h>

#include "tools/common/fault.h"
#include "tools/common/sweep.h"
#include "tools/scanner/line.h"
#include "tools/scanner/mischief.h"

struct serve_options {
    bool rtu;
    struct canopy_wire_line line;
    bool pace;  ///< bytes take their time at the line's baud rate
    bool tcp;
    struct canopy_wire_tcp address;  ///< its unit is that of TCP
    struct mischief_options mischief;
    uint64_t mischief_seed;
};

/// What there is to say about the wires at the end.
struct serve_report {
    uint64_t requests, replies, wire_bytes;  ///< bytes in both directions on the line
    uint32_t rx_errors;
    struct mischief mischief;
};

struct server;

/// Opens line and listener. NULL, and `fault` says why.
struct server *serve_open(const struct serve_options *options, struct canopy_sweep *sweep, struct canopy_fault *fault);
void serve_close(struct server *server);

/// What a master opens: the device of the line, and the address of the listener; "" where there is none.
const char *serve_device(const struct server *server);
const char *serve_address(const struct server *server);

/// Waits for something to happen, at most `wait_us`, and answers. Signals end the wait.
/// False when the line is gone for good.
bool serve_once(struct server *server, uint64_t wait_us);

struct serve_report serve_report(const struct server *server);

uint64_t serve_now_us(void);

#endif
