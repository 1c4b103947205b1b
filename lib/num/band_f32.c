#include "lib/num/band.h"
#include "lib/num/num_f32.h"

#include "lib/num/band.inc"
