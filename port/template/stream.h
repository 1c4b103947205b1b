/// The serial line of a platform that has none: it never gives or takes a byte. What was never taken has been sent.
#ifndef CANOPY_PORT_TEMPLATE_STREAM_H
#define CANOPY_PORT_TEMPLATE_STREAM_H

#include "lib/port.h"

struct canopy_stream canopy_no_stream(void);

#endif
