#include "port/rp2040/pl011.h"

#include "port/rp2040/chip.h"
#include "port/rp2040/registers.h"
#include "port/rp2040/timer.h"

#define INTERRUPTS (RP2040_UART_INT_RECEIVE | RP2040_UART_INT_SEND | RP2040_UART_INT_OVERRUN)

static uint32_t get(const struct canopy_pl011 *uart, uint32_t offset) { return canopy_rp2040_get(uart->base + offset); }

static void put(const struct canopy_pl011 *uart, uint32_t offset, uint32_t value) {
    canopy_rp2040_put(uart->base + offset, value);
}

static uint64_t now_q8(void) { return canopy_rp2040_now_us() << 8; }

static bool is_full(const struct canopy_pl011 *uart) {
    return (get(uart, RP2040_UART_FR) & RP2040_UART_FR_SEND_FULL) != 0;
}

// Lowers the direction pin if the wire is free, else sees to it that it is asked again. While bytes wait to be handed
// over it is nobody's turn: the last of them sets the alarm.
static void end_sending(const struct canopy_pl011 *uart) {
    if (!canopy_byte_ring_empty(&uart->sending))
        return;
    if (now_q8() < uart->free_q8)
        canopy_rp2040_set_alarm(uart->alarm, (uart->free_q8 + 255u) >> 8);
    else if ((get(uart, RP2040_UART_FR) & RP2040_UART_FR_BUSY) != 0)
        canopy_rp2040_set_alarm(uart->alarm, canopy_rp2040_now_us() + uart->bit_us);
    else
        canopy_rp2040_put(RP2040_GPIO_OUT_CLEAR, uart->direction);
}

// Hands the transmitter what it has room for. Runs in the interrupt, or with interrupts masked.
static void send_next(struct canopy_pl011 *uart) {
    uint8_t byte;
    while (!is_full(uart) && canopy_byte_ring_take(&uart->sending, &byte)) {
        const uint64_t now = now_q8() + 256u;  // the clock may be about to step
        uart->free_q8 = (now > uart->free_q8 ? now : uart->free_q8) + uart->byte_q8;
        put(uart, RP2040_UART_DR, byte);
    }
    // Its interrupt is wanted only as long as there is something to send.
    if (!canopy_byte_ring_empty(&uart->sending)) {
        canopy_rp2040_set(uart->base + RP2040_UART_IMSC, RP2040_UART_INT_SEND);
        return;
    }
    canopy_rp2040_clear(uart->base + RP2040_UART_IMSC, RP2040_UART_INT_SEND);
    if (uart->direction != 0)
        end_sending(uart);
}

static void receive(struct canopy_pl011 *uart) {
    while ((get(uart, RP2040_UART_FR) & RP2040_UART_FR_RECEIVE_EMPTY) == 0) {
        const uint32_t data = get(uart, RP2040_UART_DR);
        if ((data & RP2040_UART_DR_BAD) != 0 || !canopy_byte_ring_put(&uart->received, (uint8_t)data))
            canopy_byte_ring_lose(&uart->received);
    }
}

void canopy_pl011_on_interrupt(struct canopy_pl011 *uart) {
    const uint32_t why = get(uart, RP2040_UART_MIS);
    put(uart, RP2040_UART_ICR, why);
    if ((why & RP2040_UART_INT_OVERRUN) != 0)
        canopy_byte_ring_lose(&uart->received);
    receive(uart);
    if ((why & RP2040_UART_INT_SEND) != 0)
        send_next(uart);
}

void canopy_pl011_on_alarm(struct canopy_pl011 *uart) {
    canopy_rp2040_clear_alarm(uart->alarm);
    end_sending(uart);
}

static size_t stream_read(void *context, uint8_t *to, size_t length) {
    struct canopy_pl011 *uart = context;
    return canopy_byte_ring_read(&uart->received, to, length);
}

size_t canopy_pl011_write(struct canopy_pl011 *uart, const uint8_t *from, size_t length) {
    const size_t count = canopy_byte_ring_write(&uart->sending, from, length);
    if (count > 0) {
        // The interrupt comes when the transmitter empties; an idle one must be started by hand.
        const uint32_t before = canopy_core_mask();
        canopy_rp2040_put(RP2040_GPIO_OUT_SET, uart->direction);
        send_next(uart);
        canopy_core_restore(before);
    }
    return count;
}

static size_t stream_write(void *context, const uint8_t *from, size_t length) {
    return canopy_pl011_write(context, from, length);
}

static bool stream_sent(void *context) {
    const struct canopy_pl011 *uart = context;
    const uint32_t before = canopy_core_mask();
    const bool sent = canopy_byte_ring_empty(&uart->sending) && now_q8() >= uart->free_q8 &&
                      (get(uart, RP2040_UART_FR) & RP2040_UART_FR_BUSY) == 0;
    if (sent)  // the alarm may be a bit away, and who hears this may mask interrupts for as long as flash is erased
        canopy_rp2040_put(RP2040_GPIO_OUT_CLEAR, uart->direction);
    canopy_core_restore(before);
    return sent;
}

static uint32_t stream_lost(void *context) {
    const struct canopy_pl011 *uart = context;
    return canopy_byte_ring_lost(&uart->received);
}

// 4.2.7.1: the divisor is in 1/64; both parts and the format come into force by the write of LCR_H.
static void set_line(uint32_t base, uint32_t clock_hz, uint32_t baud, uint32_t format) {
    const uint32_t divisor = (4u * clock_hz + baud / 2u) / baud;
    canopy_rp2040_put(base + RP2040_UART_CR, 0);
    canopy_rp2040_put(base + RP2040_UART_IBRD, divisor / 64u);
    canopy_rp2040_put(base + RP2040_UART_FBRD, divisor % 64u);
    canopy_rp2040_put(base + RP2040_UART_LCR_H, RP2040_UART_LCR_8_BITS | format);
    canopy_rp2040_put(base + RP2040_UART_CR, RP2040_UART_CR_ON);
}

void canopy_pl011_start(struct canopy_pl011 *uart, const struct canopy_pl011_config *config) {
    const uint32_t bits = config->even_parity ? 11 : 10;
    *uart = (struct canopy_pl011){
        .base = config->base,
        .byte_q8 = (bits * 256000000u + config->baud - 1u) / config->baud,
        .bit_us = (1000000u + config->baud - 1u) / config->baud,
        .direction = config->direction,
        .alarm = config->alarm,
    };
    canopy_byte_ring_init(&uart->received, config->receive_ring, config->receive_length);
    canopy_byte_ring_init(&uart->sending, config->send_ring, config->send_length);
    canopy_rp2040_reset_blocks(config->reset);
    set_line(config->base, config->clock_hz, config->baud,
             config->even_parity ? RP2040_UART_LCR_PARITY | RP2040_UART_LCR_EVEN : 0);
    put(uart, RP2040_UART_ICR, INTERRUPTS);
    put(uart, RP2040_UART_IMSC, RP2040_UART_INT_RECEIVE | RP2040_UART_INT_OVERRUN);
    canopy_core_enable_irq(config->irq);
    if (config->direction != 0)
        canopy_core_enable_irq(RP2040_IRQ_TIMER + config->alarm);
}

struct canopy_stream canopy_pl011_stream(struct canopy_pl011 *uart) {
    return (struct canopy_stream){
        .context = uart, .read = stream_read, .write = stream_write, .sent = stream_sent, .lost = stream_lost};
}

void canopy_pl011_start_printing(uint32_t base, uint32_t reset, uint32_t clock_hz, uint32_t baud) {
    canopy_rp2040_reset_blocks(reset);
    set_line(base, clock_hz, baud, 0);
}

void canopy_pl011_put(uint32_t base, char character) {
    // Bounded: a transmitter that never empties must not hold up the reset.
    for (uint32_t i = 0; i < 100000u && (canopy_rp2040_get(base + RP2040_UART_FR) & RP2040_UART_FR_SEND_FULL) != 0; i++)
        ;
    canopy_rp2040_put(base + RP2040_UART_DR, (uint8_t)character);
}

void canopy_pl011_flush(struct canopy_pl011 *uart) {
    const uint32_t before = canopy_core_mask();
    uint8_t byte;
    while (canopy_byte_ring_take(&uart->sending, &byte))
        canopy_pl011_put(uart->base, (char)byte);
    canopy_rp2040_clear(uart->base + RP2040_UART_IMSC, RP2040_UART_INT_SEND);
    canopy_core_restore(before);
}
