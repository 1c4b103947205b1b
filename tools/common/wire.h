/// How people name a wire: serial lines and TCP addresses, for every program alike.
///
///     PATH[,BAUD[,8E1[,UNIT]]]      a serial line: 115200, 8E1 and unit 1 unless told
///     HOST:PORT, [V6]:PORT, :PORT   a TCP address
///     rtu:LINE, tcp:HOST:PORT[,UNIT]    either, as a URL
#ifndef CANOPY_TOOLS_COMMON_WIRE_H
#define CANOPY_TOOLS_COMMON_WIRE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "tools/common/fault.h"

struct canopy_wire_line {
    char path[256];
    uint32_t baud;      ///< 1200 to 1000000
    char parity;        ///< 'N', 'E', 'O'
    uint8_t stop_bits;  ///< 1, 2
    uint8_t unit;       ///< 1 to 247
};

struct canopy_wire_tcp {
    char host[128];  ///< "" for every address of this machine
    char port[8];    ///< 0 to 65535, digits
    uint8_t unit;    ///< 1 unless told
};

struct canopy_wire_url {
    bool tcp;  ///< which of the two it is
    struct canopy_wire_line line;
    struct canopy_wire_tcp address;
};

bool canopy_wire_line_parse(const char *text, struct canopy_wire_line *line, struct canopy_fault *fault);
bool canopy_wire_tcp_parse(const char *text, struct canopy_wire_tcp *address, struct canopy_fault *fault);
bool canopy_wire_url_parse(const char *text, struct canopy_wire_url *url, struct canopy_fault *fault);

/// The parts that programs with other rules share: what a line's format says …
bool canopy_wire_format(const char *text, char *parity, uint8_t *stop_bits);

/// … and HOST:PORT cut in two in place, at its last colon, without the brackets of an IPv6 address (the host then
/// begins behind `text`). NULL without a colon.
char *canopy_wire_cut(char *text, char **port);

/// Bits of a character on the line: start, data, parity, stop.
unsigned canopy_wire_character_bits(const struct canopy_wire_line *line);

#endif
