/// The watchdog of a platform that has none: it may be fed, and never bites. Such a board says false to
/// canopy_board_start_watchdog.
#ifndef CANOPY_PORT_TEMPLATE_WATCHDOG_H
#define CANOPY_PORT_TEMPLATE_WATCHDOG_H

#include "lib/port.h"

struct canopy_watchdog canopy_no_watchdog(void);

#endif
