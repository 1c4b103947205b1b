/// The serial line of the simulator: a pseudo-terminal of its own, or a device that is there.
#ifndef CANOPY_TOOLS_SCANNER_LINE_H
#define CANOPY_TOOLS_SCANNER_LINE_H

#include <stdbool.h>
#include <stdint.h>

#include "tools/common/fault.h"

struct line_options {
    char path[256];
    uint32_t baud;
    char parity;        ///< 'N', 'E', 'O'
    uint8_t stop_bits;  ///< 1, 2
    uint8_t unit;
};

struct line {
    int file;          ///< non-blocking
    int keeper;        ///< our own end of the pseudo-terminal's other side: keeps it raw and open; -1 for a device
    char device[256];  ///< what the master opens
    char link[256];    ///< symbolic link that stands for it, "" if none
};

/// PATH[,BAUD[,8E1[,UNIT]]]: 115200, 8E1 and unit 1 unless told.
bool line_parse(const char *text, struct line_options *options, struct canopy_fault *fault);

/// Opens `path` as a device if it is a character device, else makes a pseudo-terminal and, unless `path` is "pty", a
/// symbolic link of that name to it. A link that an earlier run left is replaced; any other file is not.
bool line_open(const struct line_options *options, struct line *line, struct canopy_fault *fault);

/// Closes and removes the link.
void line_close(struct line *line);

/// Bits of a character on the wire: start, data, parity, stop.
unsigned line_character_bits(const struct line_options *options);

#endif
