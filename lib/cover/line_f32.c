#include <string.h>

#include "lib/cover/line.h"
#include "lib/num/fixed.h"
#include "lib/num/num_f32.h"

#define LINE_SCALAR CANOPY_F32
#include "lib/cover/line.inc"
