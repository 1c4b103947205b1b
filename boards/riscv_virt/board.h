/// QEMU's `virt` board with an RV32IMAC hart (`qemu-system-riscv32 -M virt -bios none`).
///
/// Data of the board for port/riscv, from QEMU's hw/riscv/virt.c and the device tree that it makes. No chip is meant,
/// but the devices are those of many: SiFive's CLINT and PLIC, a 16550A.
#ifndef CANOPY_BOARDS_RISCV_VIRT_BOARD_H
#define CANOPY_BOARDS_RISCV_VIRT_BOARD_H

#define BOARD_CLINT_BASE 0x02000000u
#define BOARD_MTIME_HZ 10000000u

#define BOARD_PLIC_BASE 0x0C000000u

// One serial line, `-serial` one of QEMU. The console is semihosting's.
#define BOARD_UART_BASE 0x10000000u
#define BOARD_UART_STRIDE 1u
#define BOARD_UART_IRQ 10u
#define BOARD_UART_CLOCK_HZ 3686400u

#define BOARD_TEST_BASE 0x00100000u

/// The line's rings. Received: a whole Modbus frame, however long the loop is away. To be sent: what the wire takes in
/// 10 ms, longer than the loop is away, so that a frame leaves without gaps.
#define BOARD_RECEIVE_LENGTH 256u
#define BOARD_SEND_LENGTH 128u

#endif
