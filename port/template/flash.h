/// The flash of a platform that has none: no pages, and every call says CANOPY_UNSUPPORTED.
#ifndef CANOPY_PORT_TEMPLATE_FLASH_H
#define CANOPY_PORT_TEMPLATE_FLASH_H

#include "lib/port.h"

struct canopy_flash canopy_no_flash(void);

#endif
