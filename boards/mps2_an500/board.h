/// Arm MPS2 with FPGA image AN500: a Cortex-M7 with a floating-point unit at 25 MHz, as QEMU emulates it
/// (`-M mps2-an500`). Memories that port/mps2 uses and devices are those of AN385; PSRAM is at 0x60000000 instead of
/// 0x21000000, Ethernet at 0xA0000000, and there is no block RAM.
///
/// The caches stay off, as reset leaves them: nothing here needs them, and without DMA nothing but this program writes
/// memory, so that turning them on (ARMv7-M Architecture Reference Manual, B2.2.7) changes speed alone.
#ifndef CANOPY_BOARDS_MPS2_AN500_BOARD_H
#define CANOPY_BOARDS_MPS2_AN500_BOARD_H

#include "port/mps2/board_data.h"

#endif
