#include <string.h>

#include "lib/cover/line.h"
#include "lib/num/num_fx.h"

#define LINE_SCALAR CANOPY_FX
#include "lib/cover/line.inc"
