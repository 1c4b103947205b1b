/// One Modbus device as this program reads it: libmodbus below, patience and care on top.
///
/// An RTU answer says neither address nor time, so one that comes too late could be taken for the answer to the next
/// request. Two things prevent it: consecutive requests use the function codes 03 and 04 in turn (both show the same
/// registers, and an answer repeats its code), and after a failure the line is left alone until late answers are
/// through.
#ifndef CANOPY_TOOLS_PLC_LINK_H
#define CANOPY_TOOLS_PLC_LINK_H

#include <signal.h>
#include <stdbool.h>
#include <stdint.h>

#include "port/linux/modbus_client.h"
#include "tools/common/fault.h"
#include "tools/common/wire.h"

struct plc_link_options {
    uint32_t timeout_ms;  ///< for an answer to begin, wire time added
    uint32_t gap_ms;      ///< RTU: silence before each request, at least; T3.5 is kept anyhow
    unsigned retries;     ///< of a failed read
};

struct plc_link {
    struct canopy_wire_url url;
    struct plc_link_options options;
    struct canopy_linux_modbus_client client;
    uint8_t function;  ///< of the last request
    uint64_t requests, failures;
};

/// Prepares; the device is first spoken to by plc_link_read. The link must not move in memory.
bool plc_link_open(struct plc_link *link, const char *url, const struct plc_link_options *options,
                   struct canopy_fault *fault);
void plc_link_close(struct plc_link *link);

/// Reads `count` (1 to 125) registers. Retries but for exceptions, which say that there is no such register.
bool plc_link_read(struct plc_link *link, uint16_t address, uint16_t count, uint16_t *to, struct canopy_fault *fault);

/// Set by a signal handler: reads fail at once, waits end.
extern volatile sig_atomic_t plc_ended;

void plc_sleep_ms(uint32_t ms);
uint64_t plc_now_ms(void);

#endif
