/// Arm MPS2 with FPGA image AN385: a Cortex-M3 at 25 MHz, as QEMU emulates it (`-M mps2-an385`).
#ifndef CANOPY_BOARDS_MPS2_AN385_BOARD_H
#define CANOPY_BOARDS_MPS2_AN385_BOARD_H

#include "port/mps2/board_data.h"

#endif
