/// The UART of Arm's Cortex-M System Design Kit (CMSDK technical reference, 4.3) as a byte stream: interrupts and two
/// rings.
///
/// It has 8 data bits, no parity and one stop bit; it cannot do 8E1. Both rings belong to the caller.
#ifndef CANOPY_PORT_MPS2_CMSDK_UART_H
#define CANOPY_PORT_MPS2_CMSDK_UART_H

#include "lib/port.h"
#include "port/common/byte_ring.h"

struct canopy_cmsdk_uart {
    uintptr_t base;
    uint32_t byte_us;  ///< ten bits on the wire, rounded up
    struct canopy_clock clock;
    struct canopy_byte_ring received;
    struct canopy_byte_ring sending;
    uint64_t emptied_us;  ///< when the last byte went from the buffer to the wire; written with interrupts masked
};

struct canopy_cmsdk_uart_config {
    uintptr_t base;
    uint32_t clock_hz;  ///< of the peripheral
    uint32_t baud;      ///< at most clock_hz / 16
    uint32_t receive_irq, transmit_irq;
    struct canopy_clock clock;  ///< to know when the last byte has left the wire, which the hardware does not tell
    uint8_t *receive_ring, *send_ring;
    uint32_t receive_length, send_length;  ///< powers of two
};

/// Sets the UART up and lets its interrupts in. The board's vector table must call the two entries below for it.
void canopy_cmsdk_uart_start(struct canopy_cmsdk_uart *uart, const struct canopy_cmsdk_uart_config *config);

/// The stream of lib/port.h over it; the UART must outlive the stream.
struct canopy_stream canopy_cmsdk_uart_stream(struct canopy_cmsdk_uart *uart);

/// Interrupt entries: one byte each, bounded.
void canopy_cmsdk_uart_on_receive(struct canopy_cmsdk_uart *uart);
void canopy_cmsdk_uart_on_transmit(struct canopy_cmsdk_uart *uart);

/// Prints one character by polling, also with interrupts off and before the start: for a fault's last words.
void canopy_cmsdk_uart_put(uintptr_t base, char character);

#endif
