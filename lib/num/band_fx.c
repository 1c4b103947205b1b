#include "lib/num/band.h"
#include "lib/num/num_fx.h"

#include "lib/num/band.inc"
