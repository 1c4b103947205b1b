/// Arm MPS2 with FPGA image AN385: a Cortex-M3 at 25 MHz, as QEMU emulates it (`-M mps2-an385`).
///
/// Data of the board (application note 385, tables 3-3 and 3-4) for port/mps2.
#ifndef CANOPY_BOARDS_MPS2_AN385_BOARD_H
#define CANOPY_BOARDS_MPS2_AN385_BOARD_H

#define BOARD_CLOCK_HZ 25000000u

// Two serial lines with drivers, and one for last words: `-serial` one, two and three of QEMU.
#define BOARD_UART0_BASE 0x40004000u
#define BOARD_UART1_BASE 0x40005000u
#define BOARD_CONSOLE_BASE 0x40006000u
#define BOARD_UART0_RECEIVE_IRQ 0
#define BOARD_UART0_TRANSMIT_IRQ 1
#define BOARD_UART1_RECEIVE_IRQ 2
#define BOARD_UART1_TRANSMIT_IRQ 3
#define BOARD_TIMER_BASE 0x40000000u
#define BOARD_TIMER_IRQ 8
#define BOARD_IRQS 32

#define BOARD_WATCHDOG_BASE 0x40008000u

/// Each line's rings. Received: a whole Modbus frame, however long the loop is away. To be sent: what the wire takes in
/// 10 ms, longer than the loop is away, so that a frame leaves without gaps.
#define BOARD_RECEIVE_LENGTH 256u
#define BOARD_SEND_LENGTH 128u

#endif
