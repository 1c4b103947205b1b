/// As much of an RP2040 as port/rp2040 touches, on a host: what its registers do when they are read and written, and
/// time that passes. The port's own files are compiled against it (port/rp2040/registers.h), so that what an emulator
/// lacks is tested with the code that ships: a transmitter that takes its time, lines that are held, alarms that were
/// missed by a microsecond.
///
/// Written from the datasheet alone. Every access takes 40 ns. Interrupts are delivered while none is being handled and
/// they are not masked; a test points `chip.handler` at them. An access to a block in reset, an overwritten transmitter
/// or any other misuse ends the test.
#ifndef CANOPY_HOSTTEST_RP2040_CHIP_H
#define CANOPY_HOSTTEST_RP2040_CHIP_H

#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

#include "port/rp2040/registers.h"

#define CHIP_ACCESS_NS 40u
#define CHIP_NEVER UINT64_MAX
#define CHIP_BYTES 1024

/// A PL011 whose FIFOs are off.
struct chip_uart {
    uint32_t control, format, whole, part, mask, raw;
    uint32_t waiting, shifting;  // a byte | CHIP_HAS
    uint32_t received;           // the same, with error bits
    uint64_t shifted_ns;
    bool instant;   // like an emulator's: takes every byte at once and is never busy
    uint32_t slow;  // its bits are so much longer, in 1/1000
    struct {
        uint8_t byte;
        uint64_t begin_ns, end_ns;
    } wire[CHIP_BYTES];
    size_t sent;
};
#define CHIP_HAS 0x10000u

/// What is at an I2C address.
struct chip_device {
    uint8_t address;
    uint8_t memory[256], pointer;
    uint32_t refuses_at;      // the written byte that it does not acknowledge, from 0
    uint32_t stretches_at;    // the byte of a transfer at which it holds the clock without end
    uint32_t clocks_to_rest;  // of a device that holds the data line; UINT32_MAX: it never lets go
    bool holds_clock;
};

/// A DW_apb_i2c as a master.
struct chip_i2c {
    uint32_t control, target, enable, mask, raw, send_level, low, high, spike, hold, source;
    uint16_t commands[16], current, got[16];
    uint32_t command_count, got_count, most_got;
    bool active, reading, bus_taken, broken_off;
    uint32_t bytes, written;  // of this transfer, since START
    uint64_t done_ns;
    uint32_t starts, stops, restarts;
    bool loses_arbitration;
};

struct chip {
    uint64_t now_ns;
    uint32_t masked, irqs;  // PRIMASK, enabled at the controller
    bool handling;
    void (*handler[32])(void);
    void (*nmi)(void);
    uint32_t resets;
    uint64_t ready_ns;  // when RESET_DONE follows
    uint32_t armed, timer_raw, timer_enabled, timer_forced, alarm[4];
    uint64_t due_ns[4];
    uint32_t out, out_enable, function[30], pad[30];
    uint64_t rose_ns[30], fell_ns[30];  // outputs, last
    uint32_t rises[30];
    struct chip_uart uart[2];
    struct chip_i2c i2c;
    struct chip_device device;
    uint32_t data_pin, clock_pin, clock_pulses;
    bool clock_was_low, stop_seen, data_was_low;
    uint32_t nmi_mask, dog_control, dog_reason, scratch2, dog_selected;
    uint64_t dog_ns;  // when it bites
    bool bitten;
};

static struct chip chip;

static void chip_serve(void);

static void chip_start(void) {
    chip = (struct chip){.resets = 0x1FFFFFF, .now_ns = 5000, .dog_ns = CHIP_NEVER};
    for (int i = 0; i < 4; i++)
        chip.due_ns[i] = CHIP_NEVER;
    chip.i2c.done_ns = CHIP_NEVER;
    chip.device.refuses_at = chip.device.stretches_at = UINT32_MAX;
}

static uint64_t chip_now_us(void) { return chip.now_ns / 1000u; }

// ---- UART

static uint64_t chip_byte_ns(const struct chip_uart *u) {
    const double bit = 16.0 * ((double)u->whole + (double)u->part / 64.0) / 125e6 * 1e9;
    return (uint64_t)(bit * ((u->format & 2u) != 0 ? 11.0 : 10.0) * (1.0 + u->slow / 1000.0));
}

static void chip_shift(struct chip_uart *u, uint32_t byte) {
    assert_true(u->sent < CHIP_BYTES);
    u->shifting = u->instant ? 0 : byte;
    u->shifted_ns = chip.now_ns + (u->instant ? 0 : chip_byte_ns(u));
    u->wire[u->sent].byte = (uint8_t)byte;
    u->wire[u->sent].begin_ns = chip.now_ns;
    u->wire[u->sent++].end_ns = u->shifted_ns;
    u->raw |= RP2040_UART_INT_SEND;  // the holding register has become empty
}

static void chip_uart_put(struct chip_uart *u, uint32_t offset, uint32_t value) {
    switch (offset) {
    case RP2040_UART_DR:
        assert_int_equal(u->control & (1u | 1u << 8), 1u | 1u << 8);
        assert_int_equal(u->waiting, 0);  // it was not full
        if (u->shifting == 0)
            chip_shift(u, value | CHIP_HAS);
        else
            u->waiting = value | CHIP_HAS;
        break;
    case RP2040_UART_IBRD: u->whole = value; break;
    case RP2040_UART_FBRD: u->part = value; break;
    case RP2040_UART_LCR_H: u->format = value; break;
    case RP2040_UART_CR: u->control = value; break;
    case RP2040_UART_IMSC: u->mask = value; break;
    case RP2040_UART_ICR: u->raw &= ~value; break;
    default: fail_msg("UART: write to %#x", offset);
    }
}

static uint32_t chip_uart_get(struct chip_uart *u, uint32_t offset) {
    switch (offset) {
    case RP2040_UART_DR: {
        const uint32_t data = u->received & 0xFFFu;
        u->received = 0;
        u->raw &= ~RP2040_UART_INT_RECEIVE;
        return data;
    }
    case RP2040_UART_FR:
        return (u->shifting != 0 ? RP2040_UART_FR_BUSY : 0) | (u->waiting != 0 ? RP2040_UART_FR_SEND_FULL : 0) |
               (u->received == 0 ? RP2040_UART_FR_RECEIVE_EMPTY : 0);
    case RP2040_UART_IMSC: return u->mask;
    case RP2040_UART_MIS: return u->raw & u->mask;
    default: fail_msg("UART: read of %#x", offset);
    }
    return 0;
}

/// A character comes in, with the bits of DR for what is wrong with it.
__attribute__((unused)) static void chip_receive(int line, uint32_t data) {
    struct chip_uart *u = &chip.uart[line];
    if (u->received != 0)
        u->raw |= RP2040_UART_INT_OVERRUN;
    else {
        u->received = data | CHIP_HAS;
        u->raw |= RP2040_UART_INT_RECEIVE;
    }
    chip_serve();
}

// ---- I2C: lines

static bool chip_device_holds_data(void) { return chip.device.clocks_to_rest > 0; }

static bool chip_drives_low(uint32_t pin) {
    return chip.function[pin] == RP2040_FUNCTION_SIO && (chip.out_enable >> pin & 1u) != 0 &&
           (chip.out >> pin & 1u) == 0;
}

static bool chip_data_is_low(void) { return chip_device_holds_data() || chip_drives_low(chip.data_pin); }
static bool chip_clock_is_low(void) { return chip.device.holds_clock || chip_drives_low(chip.clock_pin); }

// After any change of the outputs: a rising clock moves the device on, a rising data line under a high clock is a STOP.
static void chip_follow_lines(void) {
    if (chip.data_pin == chip.clock_pin)
        return;
    const bool clock_low = chip_clock_is_low();
    if (chip.clock_was_low && !clock_low) {
        chip.clock_pulses++;
        if (chip.device.clocks_to_rest > 0 && chip.device.clocks_to_rest != UINT32_MAX)
            chip.device.clocks_to_rest--;
    }
    const bool data_low = chip_data_is_low();
    if (!clock_low && !chip.clock_was_low && chip.data_was_low && !data_low)
        chip.stop_seen = true;
    chip.clock_was_low = clock_low;
    chip.data_was_low = data_low;
}

// ---- I2C: controller

static uint32_t chip_i2c_raw(const struct chip_i2c *c) {
    return c->raw | (c->enable != 0 && c->command_count <= c->send_level ? RP2040_I2C_INT_TX_EMPTY : 0);
}

static uint64_t chip_i2c_byte_ns(const struct chip_i2c *c) { return (c->low + 1u + c->high + c->spike + 7u) * 8u * 9u; }

static void chip_i2c_next(struct chip_i2c *c);

static void chip_i2c_stop(struct chip_i2c *c) {
    c->active = c->bus_taken = false;
    c->stops++;
    c->raw |= RP2040_I2C_INT_STOP_DET;
    c->broken_off = false;
}

static void chip_i2c_break_off(struct chip_i2c *c, uint32_t source) {
    c->source = source;
    c->command_count = 0;
    c->raw |= RP2040_I2C_INT_TX_ABRT;
    c->done_ns = chip.now_ns + 5000u;  // STOP follows
    c->broken_off = true;
}

// The byte on the bus is over: with `bus_taken` false it was the address.
static void chip_i2c_byte_done(struct chip_i2c *c) {
    struct chip_device *d = &chip.device;
    c->done_ns = CHIP_NEVER;
    if (c->broken_off) {
        chip_i2c_stop(c);
        return;
    }
    if (!c->bus_taken) {
        if (c->loses_arbitration)
            chip_i2c_break_off(c, RP2040_I2C_ABRT_ARBITRATION);
        else if (c->target != d->address)
            chip_i2c_break_off(c, 1u);
        else {
            c->bus_taken = true;
            chip_i2c_next(c);
        }
        return;
    }
    const uint16_t command = c->current;
    if ((command & RP2040_I2C_CMD_READ) != 0) {
        assert_true(c->got_count < 16);  // an overflow
        c->got[c->got_count++] = d->memory[d->pointer++];
        c->most_got = c->got_count > c->most_got ? c->got_count : c->most_got;
    } else {
        if (c->written == d->refuses_at) {
            chip_i2c_break_off(c, RP2040_I2C_ABRT_NO_DATA);
            return;
        }
        if (c->written++ == 0)
            d->pointer = (uint8_t)command;
        else
            d->memory[d->pointer++] = (uint8_t)command;
    }
    if ((command & RP2040_I2C_CMD_STOP) != 0)
        chip_i2c_stop(c);
    chip_i2c_next(c);
}

// Begins the next byte, with START or repeated START in front where it must be.
static void chip_i2c_next(struct chip_i2c *c) {
    if (c->enable == 0 || c->command_count == 0 || c->done_ns != CHIP_NEVER || (c->raw & RP2040_I2C_INT_TX_ABRT) != 0)
        return;
    if (chip_device_holds_data() || chip.device.holds_clock)
        return;  // it waits for a bus at rest
    const bool read = (c->commands[0] & RP2040_I2C_CMD_READ) != 0;
    const bool restart =
        c->active && ((c->commands[0] & RP2040_I2C_CMD_RESTART) != 0 || read != c->reading) && c->bytes > 0;
    if (!c->active || restart) {
        c->starts += !c->active;
        c->restarts += restart;
        c->active = true;
        c->bus_taken = false;
        c->reading = read;
        c->written = 0;
        c->bytes = restart ? c->bytes : 0;
        c->commands[0] &= (uint16_t)~RP2040_I2C_CMD_RESTART;
    }
    if (c->bus_taken && c->bytes++ >= chip.device.stretches_at) {
        chip.device.holds_clock = true;
        chip_follow_lines();
        return;
    }
    if (c->bus_taken) {  // it leaves the FIFO as it begins
        c->current = c->commands[0];
        memmove(c->commands, c->commands + 1, sizeof c->commands - sizeof c->commands[0]);
        c->command_count--;
    }
    c->done_ns = chip.now_ns + chip_i2c_byte_ns(c);
}

static void chip_i2c_put(struct chip_i2c *c, uint32_t offset, uint32_t value) {
    switch (offset) {
    case RP2040_I2C_CON: c->control = value; break;
    case RP2040_I2C_TAR:
        assert_int_equal(c->enable, 0);
        c->target = value;
        break;
    case RP2040_I2C_DATA_CMD:
        assert_int_equal(c->enable, 1);
        assert_true(c->command_count < 16);
        if ((c->raw & RP2040_I2C_INT_TX_ABRT) != 0)
            break;  // it stays empty until that is cleared
        c->commands[c->command_count++] = (uint16_t)value;
        chip_i2c_next(c);
        break;
    case RP2040_I2C_FS_SCL_HCNT: c->high = value; break;
    case RP2040_I2C_FS_SCL_LCNT: c->low = value; break;
    case RP2040_I2C_FS_SPKLEN: c->spike = value; break;
    case RP2040_I2C_SDA_HOLD: c->hold = value; break;
    case RP2040_I2C_INTR_MASK: c->mask = value; break;
    case RP2040_I2C_TX_TL: c->send_level = value; break;
    case RP2040_I2C_ENABLE:
        assert_true(value != 0 || !c->active);  // it would have to be aborted first
        c->enable = value;
        if (value == 0)
            c->command_count = c->got_count = 0;
        break;
    default: fail_msg("I2C: write to %#x", offset);
    }
}

static uint32_t chip_i2c_get(struct chip_i2c *c, uint32_t offset) {
    switch (offset) {
    case RP2040_I2C_DATA_CMD: {
        assert_true(c->got_count > 0);
        const uint16_t byte = c->got[0];
        memmove(c->got, c->got + 1, sizeof c->got - sizeof c->got[0]);
        c->got_count--;
        return byte;
    }
    case RP2040_I2C_RAW_INTR_STAT: return chip_i2c_raw(c);
    case RP2040_I2C_CLR_INTR: c->raw = c->source = 0; return 0;
    case RP2040_I2C_CLR_TX_ABRT:
        c->raw &= ~RP2040_I2C_INT_TX_ABRT;
        c->source = 0;
        return 0;
    case RP2040_I2C_CLR_STOP_DET: c->raw &= ~RP2040_I2C_INT_STOP_DET; return 0;
    case RP2040_I2C_STATUS: return c->active ? RP2040_I2C_STATUS_MASTER_ACTIVE : 0;
    case RP2040_I2C_TXFLR: return c->command_count;
    case RP2040_I2C_RXFLR: return c->got_count;
    case RP2040_I2C_TX_ABRT_SOURCE: return c->source;
    case RP2040_I2C_ENABLE_STATUS: return c->enable;
    default: fail_msg("I2C: read of %#x", offset);
    }
    return 0;
}

static void chip_i2c_reset(void) {
    const struct chip_i2c old = chip.i2c;
    chip.i2c = (struct chip_i2c){.done_ns = CHIP_NEVER,
                                 .mask = 0x8FF,
                                 .starts = old.starts,
                                 .stops = old.stops,
                                 .restarts = old.restarts,
                                 .most_got = old.most_got,
                                 .loses_arbitration = old.loses_arbitration};
}

// ---- Time, interrupts

static uint32_t chip_pending(void) {
    uint32_t pending = 0;
    const uint32_t alarms = (chip.timer_raw & chip.timer_enabled) | chip.timer_forced;
    pending |= alarms << RP2040_IRQ_TIMER;
    for (uint32_t line = 0; line < 2; line++)
        if ((chip.uart[line].raw & chip.uart[line].mask) != 0)
            pending |= 1u << (RP2040_IRQ_UART0 + line);
    if ((chip_i2c_raw(&chip.i2c) & chip.i2c.mask) != 0)
        pending |= 1u << RP2040_IRQ_I2C0;
    return pending;
}

static void chip_serve(void) {
    for (uint32_t turns = 0; !chip.handling; turns++) {
        assert_true(turns < 1000u);  // an interrupt that nobody answers
        if ((chip_pending() & chip.nmi_mask) != 0 && chip.nmi != NULL) {
            chip.nmi();
            return;
        }
        const uint32_t wanted = chip.masked != 0 ? 0 : chip_pending() & chip.irqs;
        if (wanted == 0)
            return;
        const int irq = __builtin_ctz(wanted);
        assert_non_null((void *)(uintptr_t)chip.handler[irq]);
        chip.handling = true;
        chip.handler[irq]();
        chip.handling = false;
    }
}

static uint64_t chip_next_event(void) {
    uint64_t next = chip.dog_ns;
    for (int i = 0; i < 4; i++)
        next = chip.due_ns[i] < next ? chip.due_ns[i] : next;
    for (int i = 0; i < 2; i++)
        if (chip.uart[i].shifting != 0 && chip.uart[i].shifted_ns < next)
            next = chip.uart[i].shifted_ns;
    return chip.i2c.done_ns < next ? chip.i2c.done_ns : next;
}

static void chip_happen(void) {
    if (chip.dog_ns <= chip.now_ns) {
        chip.dog_ns = CHIP_NEVER;
        chip.bitten = true;
    }
    for (uint32_t i = 0; i < 4; i++)
        if (chip.due_ns[i] <= chip.now_ns) {
            chip.due_ns[i] = CHIP_NEVER;
            chip.armed &= ~(1u << i);
            chip.timer_raw |= 1u << i;
        }
    for (int i = 0; i < 2; i++) {
        struct chip_uart *u = &chip.uart[i];
        if (u->shifting == 0 || u->shifted_ns > chip.now_ns)
            continue;
        const uint32_t next = u->waiting;
        u->shifting = u->waiting = 0;
        if (next != 0)
            chip_shift(u, next);
    }
    if (chip.i2c.done_ns <= chip.now_ns)
        chip_i2c_byte_done(&chip.i2c);
}

static void chip_pass(uint64_t ns) {
    const uint64_t end_ns = chip.now_ns + ns;
    for (uint64_t next; (next = chip_next_event()) <= end_ns;) {
        chip.now_ns = next > chip.now_ns ? next : chip.now_ns;
        chip_happen();
        chip_serve();
    }
    chip.now_ns = end_ns > chip.now_ns ? end_ns : chip.now_ns;
    chip_serve();
}

uint32_t canopy_core_mask(void) {
    const uint32_t before = chip.masked;
    chip.masked = 1;
    return before;
}

void canopy_core_restore(uint32_t before) {
    chip.masked = before;
    chip_serve();
}

void canopy_core_enable_irq(uint32_t irq) { chip.irqs |= 1u << irq; }

// ---- The bus

static void chip_set_outputs(uint32_t out, uint32_t enable) {
    for (uint32_t pin = 0; pin < 30; pin++) {
        const uint32_t is = out & enable, was = chip.out & chip.out_enable;
        if ((is & ~was) >> pin & 1u) {
            chip.rose_ns[pin] = chip.now_ns;
            chip.rises[pin]++;
        }
        if ((was & ~is) >> pin & 1u)
            chip.fell_ns[pin] = chip.now_ns;
    }
    chip.out = out;
    chip.out_enable = enable;
    chip_follow_lines();
}

static void chip_set_alarm(uint32_t number, uint32_t value) {
    const uint32_t ahead = value - (uint32_t)chip_now_us();
    chip.alarm[number] = value;
    chip.armed |= 1u << number;
    // equality, seen at the clock's next step at the earliest: now is too late
    const uint64_t us = ahead == 0 ? 1ull << 32 : ahead;
    chip.due_ns[number] = (chip_now_us() + us) * 1000u;
}

static void chip_must_run(uint32_t block) { assert_int_equal(chip.resets & block, 0); }

static uint32_t chip_read(uint32_t address) {
    if (address >= RP2040_UART0 && address < RP2040_UART1 + 0x1000u) {
        chip_must_run(address < RP2040_UART1 ? RP2040_RESET_UART0 : RP2040_RESET_UART1);
        return chip_uart_get(&chip.uart[address >= RP2040_UART1], address & 0xFFFu);
    }
    if (address >= RP2040_I2C0 && address < RP2040_I2C0 + 0x1000u) {
        chip_must_run(RP2040_RESET_I2C0);
        return chip_i2c_get(&chip.i2c, address & 0xFFFu);
    }
    switch (address) {
    case RP2040_TIMER_RAW_HIGH: return (uint32_t)(chip_now_us() >> 32);
    case RP2040_TIMER_RAW_LOW: return (uint32_t)chip_now_us();
    case RP2040_TIMER_ARMED: return chip.armed;
    case RP2040_TIMER_INTE: return chip.timer_enabled;
    case RP2040_TIMER_INTF: return chip.timer_forced;
    case RP2040_RESETS_RESET: return chip.resets;
    case RP2040_RESETS_DONE: return chip.now_ns < chip.ready_ns ? 0 : ~chip.resets;
    case RP2040_GPIO_IN:
        return (chip_data_is_low() ? 0 : 1u << chip.data_pin) | (chip_clock_is_low() ? 0 : 1u << chip.clock_pin);
    case RP2040_WATCHDOG_CTRL: return chip.dog_control;
    case RP2040_WATCHDOG_REASON: return chip.dog_reason;
    case RP2040_WATCHDOG_SCRATCH2: return chip.scratch2;
    default: fail_msg("read of %#x", address);
    }
    return 0;
}

static void chip_write(uint32_t address, uint32_t value) {
    if (address >= RP2040_UART0 && address < RP2040_UART1 + 0x1000u) {
        chip_must_run(address < RP2040_UART1 ? RP2040_RESET_UART0 : RP2040_RESET_UART1);
        chip_uart_put(&chip.uart[address >= RP2040_UART1], address & 0xFFFu, value);
        return;
    }
    if (address >= RP2040_I2C0 && address < RP2040_I2C0 + 0x1000u) {
        chip_must_run(RP2040_RESET_I2C0);
        chip_i2c_put(&chip.i2c, address & 0xFFFu, value);
        return;
    }
    for (uint32_t pin = 0; pin < 30; pin++) {
        if (address == RP2040_GPIO_CTRL(pin)) {
            chip.function[pin] = value;
            chip_follow_lines();
            return;
        }
        if (address == RP2040_PAD(pin)) {
            chip.pad[pin] = value;
            return;
        }
    }
    for (uint32_t i = 0; i < 4; i++)
        if (address == RP2040_TIMER_ALARM(i)) {
            chip_set_alarm(i, value);
            return;
        }
    switch (address) {
    case RP2040_TIMER_ARMED:
        for (uint32_t i = 0; i < 4; i++)
            if ((value >> i & 1u) != 0)
                chip.due_ns[i] = CHIP_NEVER;
        chip.armed &= ~value;
        break;
    case RP2040_TIMER_INTR: chip.timer_raw &= ~value; break;
    case RP2040_TIMER_INTE: chip.timer_enabled = value; break;
    case RP2040_TIMER_INTF: chip.timer_forced = value; break;
    case RP2040_RESETS_RESET:
        if ((value & ~chip.resets & RP2040_RESET_I2C0) != 0)
            chip_i2c_reset();
        chip.resets = value;
        chip.ready_ns = chip.now_ns + 1000u;
        break;
    case RP2040_GPIO_OUT_SET: chip_set_outputs(chip.out | value, chip.out_enable); break;
    case RP2040_GPIO_OUT_CLEAR: chip_set_outputs(chip.out & ~value, chip.out_enable); break;
    case RP2040_GPIO_ENABLE_SET: chip_set_outputs(chip.out, chip.out_enable | value); break;
    case RP2040_GPIO_ENABLE_CLEAR: chip_set_outputs(chip.out, chip.out_enable & ~value); break;
    case RP2040_SYSCFG_NMI_MASK: chip.nmi_mask = value; break;
    case RP2040_PSM_WATCHDOG_SELECT: chip.dog_selected = value; break;
    case RP2040_WATCHDOG_SCRATCH2: chip.scratch2 = value; break;
    case RP2040_WATCHDOG_LOAD:
        assert_int_equal(value & ~0xFFFFFFu, 0);
        chip.dog_ns = chip.now_ns + value * 500ull;  // RP2040-E1: two a microsecond
        break;
    case RP2040_WATCHDOG_CTRL: chip.dog_control = value; break;
    default: fail_msg("write to %#x", address);
    }
}

uint32_t canopy_rp2040_get(uint32_t address) {
    chip_pass(CHIP_ACCESS_NS);
    const uint32_t value = chip_read(address);
    chip_serve();
    return value;
}

void canopy_rp2040_put(uint32_t address, uint32_t value) {
    chip_pass(CHIP_ACCESS_NS);
    const uint32_t base = address & ~0x3000u;
    switch (address >> 28 == 0xD ? 0 : address & 0x3000u) {
    case RP2040_SET: chip_write(base, chip_read(base) | value); break;
    case RP2040_CLEAR: chip_write(base, chip_read(base) & ~value); break;
    default: chip_write(address, value); break;
    }
    chip_serve();
}

#endif
