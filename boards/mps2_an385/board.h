/// Arm MPS2 with FPGA image AN385: a Cortex-M3 at 25 MHz, as QEMU emulates it (`-M mps2-an385`).
///
/// Data of the board (application note 385, tables 3-3 and 3-4) and its parts, ready to use.
#ifndef CANOPY_BOARDS_MPS2_AN385_BOARD_H
#define CANOPY_BOARDS_MPS2_AN385_BOARD_H

#include "lib/port.h"

#define BOARD_CLOCK_HZ 25000000u

// Two serial lines with drivers, and one for last words: `-serial` one, two and three of QEMU.
#define BOARD_UART0_BASE 0x40004000u
#define BOARD_UART1_BASE 0x40005000u
#define BOARD_CONSOLE_BASE 0x40006000u
#define BOARD_UART0_RECEIVE_IRQ 0
#define BOARD_UART0_TRANSMIT_IRQ 1
#define BOARD_UART1_RECEIVE_IRQ 2
#define BOARD_UART1_TRANSMIT_IRQ 3
#define BOARD_IRQS 32

#define BOARD_WATCHDOG_BASE 0x40008000u

/// Each line's rings: a whole Modbus frame of 256 bytes and the start of the next.
#define BOARD_RING_LENGTH 512u

struct board {
    struct canopy_clock clock;
    struct canopy_stream line[2];     ///< UART 0 and 1, 8N1
    struct canopy_watchdog watchdog;  ///< not started: feeding it is harmless before board_start_watchdog
};

/// Starts the clock and both lines. Call it once, first.
struct board board_start(uint32_t baud0, uint32_t baud1);

/// From now on the board resets unless the watchdog is fed once in `period_us`, at most 171 seconds.
void board_start_watchdog(uint32_t period_us);

#endif
