/// The UART of an RP2040 (datasheet 4.2, Arm's PL011) as a byte stream: interrupts and two rings, and the direction pin
/// of an RS-485 line.
///
/// Its FIFOs are off: with them it tells of received bytes by fours, or 32 bit times after the last, and the silences
/// of Modbus RTU (T1.5, T3.5) could not be told. An interrupt a byte then: at 115200 baud one in 87 us.
///
/// It has no interrupt for the end of the last stop bit. So the time when the wire will be free is reckoned from the
/// bytes handed over; from then on the busy flag decides. An alarm of the chip's timer brings that moment, and the
/// direction pin falls in its interrupt: at most one bit time after the stop bit, if no other interrupt is in the way.
/// It has fallen, too, when the stream says that all is sent.
#ifndef CANOPY_PORT_RP2040_PL011_H
#define CANOPY_PORT_RP2040_PL011_H

#include "lib/port.h"
#include "port/common/byte_ring.h"

struct canopy_pl011 {
    uint32_t base;
    uint32_t byte_q8;  ///< a byte on the wire, in 1/256 us, rounded up
    uint32_t bit_us;   ///< a bit, rounded up
    uint32_t direction;
    uint32_t alarm;
    struct canopy_byte_ring received, sending;
    uint64_t free_q8;  ///< when the wire will be free, in 1/256 us; written with interrupts masked
};

struct canopy_pl011_config {
    uint32_t base;      ///< RP2040_UART0 or RP2040_UART1
    uint32_t reset;     ///< RP2040_RESET_UART0 or RP2040_RESET_UART1
    uint32_t irq;       ///< RP2040_IRQ_UART0 or RP2040_IRQ_UART1
    uint32_t clock_hz;  ///< clk_peri
    uint32_t baud;      ///< at most clock_hz / 16, at least clock_hz / 1048560: 120 at 125 MHz
    bool even_parity;   ///< 8E1 instead of 8N1
    uint8_t *receive_ring, *send_ring;
    uint32_t receive_length, send_length;  ///< powers of two
    uint32_t direction;                    ///< the bit of the GPIO that is high while sending; 0: there is none
    uint32_t alarm;                        ///< of the timer, for the direction pin's fall
};

/// Sets the UART up and lets its interrupts in; the direction pin is an output already. The board's vector table must
/// call the entries below for it.
void canopy_pl011_start(struct canopy_pl011 *uart, const struct canopy_pl011_config *config);

/// The stream of lib/port.h over it; the UART must outlive the stream. Bytes with a wrong parity or stop bit are lost,
/// a break and each overrun count as one.
struct canopy_stream canopy_pl011_stream(struct canopy_pl011 *uart);

/// What the stream's write does: takes what fits, sends it by interrupts, and returns how much that was.
size_t canopy_pl011_write(struct canopy_pl011 *uart, const uint8_t *from, size_t length);

/// Interrupt entries, of the UART and of the direction pin's alarm. The first moves what there is, at most what the
/// rings hold.
void canopy_pl011_on_interrupt(struct canopy_pl011 *uart);
void canopy_pl011_on_alarm(struct canopy_pl011 *uart);

/// Starts the transmitter alone, 8N1, without interrupts: for what must be printed before everything else.
void canopy_pl011_start_printing(uint32_t base, uint32_t reset, uint32_t clock_hz, uint32_t baud);

/// Prints one character by polling, also with interrupts off.
void canopy_pl011_put(uint32_t base, char character);

/// Sends by polling what waits to be sent: 87 us a byte at 115200 baud. For who is about to print like that, or to
/// reset.
void canopy_pl011_flush(struct canopy_pl011 *uart);

#endif
