/// The I2C master of a platform that has none: every transfer ends as CANOPY_I2C_UNSUPPORTED.
#ifndef CANOPY_PORT_TEMPLATE_I2C_H
#define CANOPY_PORT_TEMPLATE_I2C_H

#include "lib/port.h"

struct canopy_i2c canopy_no_i2c(void);

#endif
