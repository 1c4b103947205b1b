#include <string.h>

#include "lib/cover/line.h"
#include "lib/num/num_fx.h"

#include "lib/cover/line.inc"
