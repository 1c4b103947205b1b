/// Where the conformance program's orders come from.
#ifndef CANOPY_HOSTTEST_FIRMWARE_CONFORMANCE_H
#define CANOPY_HOSTTEST_FIRMWARE_CONFORMANCE_H

#include "port/board.h"

/// Line 0, unless a platform that has no line brings its own.
struct canopy_stream conformance_orders(const struct canopy_board *of);

#endif
