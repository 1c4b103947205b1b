/// The clock of a Linux process: CLOCK_MONOTONIC in microseconds.
#ifndef CANOPY_PORT_LINUX_CLOCK_H
#define CANOPY_PORT_LINUX_CLOCK_H

#include <stdint.h>

#include "lib/port.h"

/// From any thread; about 25 ns.
uint64_t canopy_linux_now_us(void);

/// The same behind the seam.
struct canopy_clock canopy_linux_clock(void);

#endif
