/// The clock of a platform that has none: it stands still at 0.
///
/// It never goes back, and that is all that can be said for it: no silence ends, no envelope grows old, nothing that is
/// due comes. Replace it first. A clock that counted its own calls would look better and be worse: an envelope would
/// seem fresh as long as nobody asks.
#ifndef CANOPY_PORT_TEMPLATE_CLOCK_H
#define CANOPY_PORT_TEMPLATE_CLOCK_H

#include "lib/port.h"

struct canopy_clock canopy_no_clock(void);

#endif
