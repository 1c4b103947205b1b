/// Arm MPS2 with FPGA image AN386: a Cortex-M4 with its single-precision unit at 25 MHz, as QEMU emulates it
/// (`-M mps2-an386`). Memories and devices are those of AN385.
#ifndef CANOPY_BOARDS_MPS2_AN386_BOARD_H
#define CANOPY_BOARDS_MPS2_AN386_BOARD_H

#include "port/mps2/board_data.h"

#endif
