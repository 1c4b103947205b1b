/// Where the devices are that every FPGA image of Arm's MPS2 with CMSDK has alike: data for a board's board.h.
///
/// Application notes 385 (Cortex-M3), 386 (Cortex-M4) and 500 (Cortex-M7), each its tables of the memory map and of
/// the interrupts: what port/mps2 uses stands at the same addresses in all of them.
#ifndef CANOPY_PORT_MPS2_BOARD_DATA_H
#define CANOPY_PORT_MPS2_BOARD_DATA_H

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
