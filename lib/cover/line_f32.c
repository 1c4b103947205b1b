#include <string.h>

#include "lib/cover/line.h"
#include "lib/num/fixed.h"
#include "lib/num/num_f32.h"

#include "lib/cover/line.inc"
