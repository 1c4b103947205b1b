#include "port/mps2/cmsdk_uart.h"

#include "port/cortexm/clock.h"
#include "port/cortexm/core.h"

// Registers by offset.
#define DATA 0x00u
#define STATE 0x04u
#define CTRL 0x08u
#define INTERRUPT 0x0Cu  // status when read; writing ones clears
#define BAUD_DIVISOR 0x10u

#define STATE_SEND_FULL (1u << 0)
#define STATE_RECEIVE_FULL (1u << 1)
#define STATE_RECEIVE_OVERRUN (1u << 3)
#define CTRL_ENABLE 0x0Fu  // transmitter, receiver and the interrupts of both
#define INTERRUPT_SEND (1u << 0)
#define INTERRUPT_RECEIVE (1u << 1)

static volatile uint32_t *at(uintptr_t base, uint32_t offset) { return (volatile uint32_t *)(base + offset); }

void canopy_cmsdk_uart_on_receive(struct canopy_cmsdk_uart *uart) {
    *at(uart->base, INTERRUPT) = INTERRUPT_RECEIVE;
    const uint32_t state = *at(uart->base, STATE);
    if ((state & STATE_RECEIVE_OVERRUN) != 0) {
        *at(uart->base, STATE) = STATE_RECEIVE_OVERRUN;
        canopy_byte_ring_lose(&uart->received);
    }
    if ((state & STATE_RECEIVE_FULL) != 0 && !canopy_byte_ring_put(&uart->received, (uint8_t)*at(uart->base, DATA)))
        canopy_byte_ring_lose(&uart->received);
    canopy_cortexm_note_activity();
}

// Moves the next byte to the transmitter if it has room. Runs in the interrupt, or with interrupts masked.
static void send_next(struct canopy_cmsdk_uart *uart) {
    if ((*at(uart->base, STATE) & STATE_SEND_FULL) != 0)
        return;
    uint8_t byte;
    if (canopy_byte_ring_take(&uart->sending, &byte))
        *at(uart->base, DATA) = byte;
    else
        uart->emptied_us = uart->clock.now_us(uart->clock.context);
}

void canopy_cmsdk_uart_on_transmit(struct canopy_cmsdk_uart *uart) {
    *at(uart->base, INTERRUPT) = INTERRUPT_SEND;
    send_next(uart);
    canopy_cortexm_note_activity();
}

static size_t stream_read(void *context, uint8_t *to, size_t length) {
    struct canopy_cmsdk_uart *uart = context;
    return canopy_byte_ring_read(&uart->received, to, length);
}

static size_t stream_write(void *context, const uint8_t *from, size_t length) {
    struct canopy_cmsdk_uart *uart = context;
    const size_t count = canopy_byte_ring_write(&uart->sending, from, length);
    if (count > 0) {
        // The interrupt comes when the buffer empties; an idle transmitter must be started by hand.
        const uint32_t before = canopy_core_mask();
        send_next(uart);
        canopy_core_restore(before);
    }
    return count;
}

static bool stream_sent(void *context) {
    struct canopy_cmsdk_uart *uart = context;
    const uint32_t before = canopy_core_mask();
    const bool empty = canopy_byte_ring_empty(&uart->sending) && (*at(uart->base, STATE) & STATE_SEND_FULL) == 0 &&
                       (*at(uart->base, INTERRUPT) & INTERRUPT_SEND) == 0;
    const uint64_t emptied_us = uart->emptied_us;
    canopy_core_restore(before);
    return empty && uart->clock.now_us(uart->clock.context) - emptied_us >= uart->byte_us;
}

static uint32_t stream_lost(void *context) {
    const struct canopy_cmsdk_uart *uart = context;
    return canopy_byte_ring_lost(&uart->received);
}

void canopy_cmsdk_uart_start(struct canopy_cmsdk_uart *uart, const struct canopy_cmsdk_uart_config *config) {
    *uart = (struct canopy_cmsdk_uart){
        .base = config->base,
        .byte_us = (10000000u + config->baud - 1u) / config->baud,
        .clock = config->clock,
    };
    canopy_byte_ring_init(&uart->received, config->receive_ring, config->receive_length);
    canopy_byte_ring_init(&uart->sending, config->send_ring, config->send_length);
    *at(uart->base, CTRL) = 0;
    *at(uart->base, BAUD_DIVISOR) = config->clock_hz / config->baud;
    *at(uart->base, INTERRUPT) = INTERRUPT_SEND | INTERRUPT_RECEIVE;
    *at(uart->base, CTRL) = CTRL_ENABLE;
    canopy_core_enable_irq(config->receive_irq);
    canopy_core_enable_irq(config->transmit_irq);
}

struct canopy_stream canopy_cmsdk_uart_stream(struct canopy_cmsdk_uart *uart) {
    return (struct canopy_stream){
        .context = uart, .read = stream_read, .write = stream_write, .sent = stream_sent, .lost = stream_lost};
}

void canopy_cmsdk_uart_put(uintptr_t base, char character) {
    *at(base, CTRL) |= 1u;  // the transmitter alone
    if (*at(base, BAUD_DIVISOR) < 16u)
        *at(base, BAUD_DIVISOR) = 16u;  // the console's speed when nobody has set one
    // Bounded: a transmitter that never empties must not hold up the reset.
    for (uint32_t i = 0; i < 1000000u && (*at(base, STATE) & STATE_SEND_FULL) != 0; i++)
        ;
    *at(base, DATA) = (uint8_t)character;
}
