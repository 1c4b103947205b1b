/// A UART of the 16550A's kind (PC16550D data sheet, Texas Instruments SNLS378, section 8) as a byte stream, 8N1: both
/// FIFOs of 16 bytes, one interrupt, two rings.
///
/// What was received with a framing error or as a break is dropped and counted as lost, and so is one byte for each
/// overrun that the UART tells.
#ifndef CANOPY_PORT_RISCV_NS16550_H
#define CANOPY_PORT_RISCV_NS16550_H

#include "lib/port.h"
#include "port/common/byte_ring.h"

struct canopy_ns16550 {
    uintptr_t base;
    uint32_t stride;  ///< bytes from one register to the next
    struct canopy_byte_ring received;
    struct canopy_byte_ring sending;
    uint8_t errors;  ///< of the line status, which forgets them when it is read; with interrupts masked
};

struct canopy_ns16550_config {
    uintptr_t base;
    uint32_t stride;    ///< 1, 2 or 4
    uint32_t clock_hz;  ///< of its baud generator
    uint32_t baud;      ///< at most clock_hz / 16; what the generator makes of it is within 3 % for the usual ones
    uint8_t *receive_ring, *send_ring;
    uint32_t receive_length, send_length;  ///< powers of two
};

/// Sets it up, empty. Its interrupt must then be let in, and call canopy_ns16550_on_interrupt.
void canopy_ns16550_start(struct canopy_ns16550 *uart, const struct canopy_ns16550_config *config);

/// Interrupt entry: empties the receiver, at most 16 bytes at a time, and fills the transmitter.
void canopy_ns16550_on_interrupt(struct canopy_ns16550 *uart);

/// The stream of lib/port.h over it; the UART must outlive the stream.
struct canopy_stream canopy_ns16550_stream(struct canopy_ns16550 *uart);

#endif
