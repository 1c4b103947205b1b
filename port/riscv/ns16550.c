#include "port/riscv/ns16550.h"

#include "port/riscv/core.h"
#include "port/riscv/mmio.h"

// Registers in the order of the data sheet; the first two are the divisor's while LCR says so.
#define DATA 0u
#define INTERRUPT_ENABLE 1u
#define FIFO_CONTROL 2u
#define LINE_CONTROL 3u
#define MODEM_CONTROL 4u
#define LINE_STATUS 5u

#define INTERRUPTS_BOTH 0x03u    // a byte has come; the transmitter is empty
#define FIFO_ON_AND_EMPTY 0x07u  // and an interrupt from the first byte on
#define LINE_8N1 0x03u
#define LINE_DIVISOR 0x80u
#define MODEM_OUT 0x0Bu  // DTR, RTS, and OUT2, which lets the interrupt out on a PC's card
#define STATUS_RECEIVED 0x01u
#define STATUS_OVERRUN 0x02u
#define STATUS_BAD_BYTE 0x1Cu  // parity, framing, break: of the byte that is read next
#define STATUS_FIFO_EMPTY 0x20u
#define STATUS_ALL_SENT 0x40u

#define FIFO_BYTES 16u

static uint8_t get(const struct canopy_ns16550 *uart, uint32_t which) {
    return canopy_mmio_read8(uart->base + which * uart->stride);
}

static void set(const struct canopy_ns16550 *uart, uint32_t which, uint8_t value) {
    canopy_mmio_write8(uart->base + which * uart->stride, value);
}

// Reading the status forgets its errors: they are kept until the byte they belong to is read.
static uint8_t look(struct canopy_ns16550 *uart) {
    const uint8_t status = get(uart, LINE_STATUS);
    if ((status & STATUS_OVERRUN) != 0)
        canopy_byte_ring_lose(&uart->received);
    uart->errors |= status & STATUS_BAD_BYTE;
    return status;
}

static void empty_receiver(struct canopy_ns16550 *uart) {
    for (uint32_t i = 0; i < FIFO_BYTES && (look(uart) & STATUS_RECEIVED) != 0; i++) {
        const bool bad = uart->errors != 0;
        const uint8_t byte = get(uart, DATA);
        uart->errors = 0;
        if (bad || !canopy_byte_ring_put(&uart->received, byte))
            canopy_byte_ring_lose(&uart->received);
    }
}

// In the interrupt, or with interrupts masked.
static void fill_transmitter(struct canopy_ns16550 *uart) {
    uint8_t byte;
    if ((look(uart) & STATUS_FIFO_EMPTY) == 0)
        return;
    for (uint32_t i = 0; i < FIFO_BYTES && canopy_byte_ring_take(&uart->sending, &byte); i++)
        set(uart, DATA, byte);
}

void canopy_ns16550_on_interrupt(struct canopy_ns16550 *uart) {
    (void)get(uart, FIFO_CONTROL);  // read, it is the interrupt's identity: that takes the transmitter's back
    empty_receiver(uart);
    fill_transmitter(uart);
}

static size_t stream_read(void *context, uint8_t *to, size_t length) {
    struct canopy_ns16550 *uart = context;
    return canopy_byte_ring_read(&uart->received, to, length);
}

static size_t stream_write(void *context, const uint8_t *from, size_t length) {
    struct canopy_ns16550 *uart = context;
    const size_t count = canopy_byte_ring_write(&uart->sending, from, length);
    if (count > 0) {
        // The interrupt comes when the FIFO empties; an idle transmitter must be started by hand.
        const uint32_t before = canopy_core_mask();
        fill_transmitter(uart);
        canopy_core_restore(before);
    }
    return count;
}

static bool stream_sent(void *context) {
    struct canopy_ns16550 *uart = context;
    const uint32_t before = canopy_core_mask();
    const bool sent = canopy_byte_ring_empty(&uart->sending) && (look(uart) & STATUS_ALL_SENT) != 0;
    canopy_core_restore(before);
    return sent;
}

static uint32_t stream_lost(void *context) {
    const struct canopy_ns16550 *uart = context;
    return canopy_byte_ring_lost(&uart->received);
}

void canopy_ns16550_start(struct canopy_ns16550 *uart, const struct canopy_ns16550_config *config) {
    *uart = (struct canopy_ns16550){.base = config->base, .stride = config->stride};
    canopy_byte_ring_init(&uart->received, config->receive_ring, config->receive_length);
    canopy_byte_ring_init(&uart->sending, config->send_ring, config->send_length);
    const uint32_t divisor = (config->clock_hz + 8u * config->baud) / (16u * config->baud);
    set(uart, INTERRUPT_ENABLE, 0);
    set(uart, LINE_CONTROL, LINE_DIVISOR);
    set(uart, DATA, (uint8_t)divisor);
    set(uart, INTERRUPT_ENABLE, (uint8_t)(divisor >> 8));
    set(uart, LINE_CONTROL, LINE_8N1);
    set(uart, FIFO_CONTROL, FIFO_ON_AND_EMPTY);
    set(uart, MODEM_CONTROL, MODEM_OUT);
    (void)look(uart);
    uart->errors = 0;
    set(uart, INTERRUPT_ENABLE, INTERRUPTS_BOTH);
}

struct canopy_stream canopy_ns16550_stream(struct canopy_ns16550 *uart) {
    return (struct canopy_stream){
        .context = uart, .read = stream_read, .write = stream_write, .sent = stream_sent, .lost = stream_lost};
}
