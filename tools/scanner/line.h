/// The serial line of the simulator: a pseudo-terminal of its own, or a device that is there.
#ifndef CANOPY_TOOLS_SCANNER_LINE_H
#define CANOPY_TOOLS_SCANNER_LINE_H

#include <stdbool.h>
#include <stdint.h>

#include "tools/common/fault.h"
#include "tools/common/wire.h"

struct line {
    int file;          ///< non-blocking
    int keeper;        ///< our own end of the pseudo-terminal's other side: keeps it raw and open; -1 for a device
    char device[256];  ///< what the master opens
    char link[256];    ///< symbolic link that stands for it, "" if none
};

/// Opens `path` as a device if it is a character device, else makes a pseudo-terminal and, unless `path` is "pty", a
/// symbolic link of that name to it. A link that an earlier run left is replaced; any other file is not.
bool line_open(const struct canopy_wire_line *options, struct line *line, struct canopy_fault *fault);

/// Closes and removes the link.
void line_close(struct line *line);

#endif
