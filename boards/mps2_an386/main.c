// The Cortex-M4 runs the Cortex-M7's program: it has the memory and the floating-point unit for all of it.
#include "boards/mps2_an500/main.c"
