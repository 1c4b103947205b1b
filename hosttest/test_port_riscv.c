// The RISC-V port's timer and UART against models of the devices, for what an emulator does not do: a clock that turns
// over between two reads, overruns, broken characters, a transmitter that takes its time.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

// ---- In place of port/riscv/mmio.h and port/riscv/core.h

#define CANOPY_PORT_RISCV_MMIO_H
#define CANOPY_PORT_RISCV_CORE_H

static uint32_t canopy_mmio_read32(uintptr_t address);
static void canopy_mmio_write32(uintptr_t address, uint32_t value);
static uint8_t canopy_mmio_read8(uintptr_t address);
static void canopy_mmio_write8(uintptr_t address, uint8_t value);
static uint32_t canopy_core_mask(void) { return 0; }
static void canopy_core_restore(uint32_t before) { (void)before; }

// What is tested, with those
#include "port/common/byte_ring.c"
#include "port/riscv/clint.c"
#undef NEVER
#include "port/riscv/ns16550.c"

// ---- The timer: each read of a register takes `step` ticks

#define CLINT 0x02000000u
#define HZ 10000000u

static struct {
    uint64_t time, step, compare, least;  // least: of the compare values since it was set to UINT64_MAX
} timer;

static uint32_t canopy_mmio_read32(uintptr_t address) {
    timer.time += timer.step;
    assert_true(address == CLINT + 0xBFF8u || address == CLINT + 0xBFFCu);
    return (uint32_t)(address == CLINT + 0xBFF8u ? timer.time : timer.time >> 32);
}

static void canopy_mmio_write32(uintptr_t address, uint32_t value) {
    assert_true(address == CLINT + 0x4000u || address == CLINT + 0x4004u);
    const uint64_t kept = address == CLINT + 0x4000u ? timer.compare >> 32 << 32 : (uint32_t)timer.compare;
    timer.compare = address == CLINT + 0x4000u ? kept | value : kept | (uint64_t)value << 32;
    timer.least = timer.compare < timer.least ? timer.compare : timer.least;
}

static struct canopy_clint clint;

static void start_timer(uint64_t at, uint64_t step) {
    memset(&timer, 0, sizeof timer);
    timer.time = at;
    timer.step = step;
    canopy_clint_start(&clint, CLINT, HZ);
}

static void the_clock_is_whole_over_the_turn_of_its_low_word(void **state) {
    (void)state;
    for (uint64_t turn = 1; turn <= 3; turn++) {
        for (uint64_t step = 1; step <= 40; step++) {
            for (uint64_t ahead = 0; ahead < 5 * step; ahead++) {
                start_timer((turn << 32) - ahead, 0);
                timer.step = step;
                const uint64_t before = timer.time, ticks = canopy_clint_ticks(&clint);
                assert_true(before <= ticks && ticks <= timer.time);
            }
        }
    }
}

static void the_clock_never_goes_back(void **state) {
    (void)state;
    start_timer((5ull << 32) - 100000, 7);
    uint64_t last = 0;
    for (int i = 0; i < 20000; i++) {
        const uint64_t now = canopy_clint_now_us(&clint);
        assert_true(now >= last);
        assert_true(now <= timer.time / 10 && now + 10 >= timer.time / 10);
        last = now;
    }
    assert_true(timer.time > 5ull << 32);
}

static void microseconds_are_ticks_divided(void **state) {
    (void)state;
    uint64_t number = 0x9E3779B97F4A7C15u;
    for (uint32_t i = 0; i < 300000; i++) {
        number = number * 6364136223846793005u + 1442695040888963407u;
        const uint32_t divisor = i % 4000 + 1;
        const uint64_t one = number >> (i % 64);
        assert_true(divided(one, divisor) == one / divisor);
    }
}

static void an_alarm_is_never_early_while_it_is_set(void **state) {
    (void)state;
    const uint64_t times[] = {1000, 0xFFFFFFF0u, 0x100000010u, 0x1FFFFFFFFu, 0x200000000u, 77};
    start_timer(0, 0);
    for (size_t i = 0; i < 6; i++) {
        for (size_t k = 0; k < 6; k++) {
            canopy_clint_alarm(&clint, times[i] / 10);
            const uint64_t before = timer.compare;
            timer.least = UINT64_MAX;
            canopy_clint_alarm(&clint, times[k] / 10);
            assert_true(timer.compare == times[k] / 10 * 10);
            assert_true(timer.least >= (before < timer.compare ? before : timer.compare));
        }
    }
}

static void an_alarm_goes_off_once(void **state) {
    (void)state;
    start_timer(0, 0);
    canopy_clint_alarm(&clint, 50);
    assert_true(timer.compare == 500);
    timer.time = 500;
    assert_int_equal(canopy_clint_on_timer(&clint), CANOPY_CLINT_TIME);
    assert_true(timer.compare == UINT64_MAX);
}

// Runs the timer's interrupts up to a time; true when the watchdog bites.
static bool bites_until(uint64_t end) {
    while (timer.compare <= end) {
        timer.time = timer.compare > timer.time ? timer.compare : timer.time;
        if (canopy_clint_on_timer(&clint) == CANOPY_CLINT_HANG)
            return true;
        assert_true(timer.compare > timer.time);
    }
    timer.time = end;
    return false;
}

static void a_watchdog_bites_at_the_end_of_its_period_and_not_before(void **state) {
    (void)state;
    const uint32_t period = 1000;  // us
    for (uint64_t hang = 1; hang < 40; hang++) {
        start_timer((1ull << 32) - 200000, 0);  // feeds and periods on both sides of the turn
        assert_true(canopy_clint_start_watchdog(&clint, period));
        const struct canopy_watchdog watchdog = canopy_clint_watchdog(&clint);
        for (uint64_t i = 0; i < hang; i++) {
            assert_false(bites_until(timer.time + (i % 2 != 0 ? 9999 : 1234)));
            watchdog.feed(watchdog.context);
            canopy_clint_alarm(&clint, canopy_clint_now_us(&clint) + 300);
        }
        const uint64_t fed = timer.time;
        assert_true(bites_until(UINT64_MAX - 1));
        assert_true(timer.time - fed == (uint64_t)period * 10);
    }
}

static void a_period_that_cannot_be_is_refused(void **state) {
    (void)state;
    start_timer(0, 0);
    assert_false(canopy_clint_start_watchdog(&clint, 0));
    assert_false(canopy_clint_start_watchdog(&clint, 214748365));
    assert_true(timer.compare == UINT64_MAX);
    assert_true(canopy_clint_start_watchdog(&clint, 214748364));
}

// ---- The UART (PC16550D, section 8): FIFOs, and a status that forgets its errors when it is read

#define UART 0x10000000u
#define STRIDE 4u

static struct {
    uint16_t received[64];  // the byte, and the status bits that come with it
    uint32_t first, end;
    bool overrun;
    uint8_t sent[1024];
    uint32_t in_fifo, sent_count;
    bool shifting;
    uint8_t line, enabled, divisor[2];
} wire;

static struct canopy_ns16550 device;
static struct canopy_stream stream;
static uint8_t receive_ring[32], send_ring[64];

static uint8_t line_status(void) {
    uint8_t status = wire.overrun ? 0x02 : 0;
    if (wire.first != wire.end)
        status |= (uint8_t)(0x01 | wire.received[wire.first % 64] >> 8);
    status |= wire.in_fifo == 0 ? 0x20 : 0;
    status |= wire.in_fifo == 0 && !wire.shifting ? 0x40 : 0;
    wire.overrun = false;
    if (wire.first != wire.end)
        wire.received[wire.first % 64] &= 0xFF;
    return status;
}

static uint8_t canopy_mmio_read8(uintptr_t address) {
    switch ((address - UART) / STRIDE) {
    case 0: assert_true(wire.first != wire.end); return (uint8_t)wire.received[wire.first++ % 64];
    case 2: return 0xC1;
    case 5: return line_status();
    default: fail(); return 0;
    }
}

static void canopy_mmio_write8(uintptr_t address, uint8_t value) {
    const uintptr_t which = (address - UART) / STRIDE;
    const bool divisor = (wire.line & 0x80) != 0;
    if (which <= 1 && divisor)
        wire.divisor[which] = value;
    else if (which == 0) {
        assert_true(wire.in_fifo < 16);
        wire.in_fifo++;
        wire.sent[wire.sent_count++] = value;
    } else if (which == 1)
        wire.enabled = value;
    else if (which == 3)
        wire.line = value;
    else
        assert_true(which == 2 || which == 4);
}

// A byte arrives: 16 fit, one more is lost and said so.
static void arrive(uint8_t byte, uint8_t bad) {
    if (wire.end - wire.first == 16)
        wire.overrun = true;
    else
        wire.received[wire.end++ % 64] = (uint16_t)(byte | bad << 8);
}

// One character's time passes for the transmitter.
static void shift_out(void) {
    wire.shifting = wire.in_fifo > 0;
    wire.in_fifo -= wire.shifting ? 1 : 0;
}

static void start_uart(void) {
    memset(&wire, 0, sizeof wire);
    const struct canopy_ns16550_config config = {.base = UART,
                                                 .stride = STRIDE,
                                                 .clock_hz = 3686400,
                                                 .baud = 9600,
                                                 .receive_ring = receive_ring,
                                                 .send_ring = send_ring,
                                                 .receive_length = sizeof receive_ring,
                                                 .send_length = sizeof send_ring};
    canopy_ns16550_start(&device, &config);
    stream = canopy_ns16550_stream(&device);
}

static void the_line_is_8n1_at_its_speed(void **state) {
    (void)state;
    start_uart();
    assert_int_equal(wire.line, 0x03);
    assert_int_equal(wire.divisor[0] | wire.divisor[1] << 8, 24);
    assert_int_equal(wire.enabled, 0x03);
}

static void what_arrives_is_read_in_order(void **state) {
    uint8_t to[64];
    (void)state;
    start_uart();
    uint8_t next = 0, seen = 0;
    for (uint32_t burst = 1; burst <= 16; burst++) {
        for (uint32_t i = 0; i < burst; i++)
            arrive(next++, 0);
        canopy_ns16550_on_interrupt(&device);
        const size_t count = stream.read(stream.context, to, sizeof to);
        assert_int_equal(count, burst);
        for (size_t i = 0; i < count; i++)
            assert_int_equal(to[i], seen++);
    }
    assert_int_equal(stream.lost(stream.context), 0);
}

static void an_overrun_and_a_full_ring_are_counted(void **state) {
    uint8_t to[64];
    (void)state;
    start_uart();
    for (uint8_t i = 0; i < 17; i++)
        arrive(i, 0);
    canopy_ns16550_on_interrupt(&device);
    assert_int_equal(stream.lost(stream.context), 1);
    for (uint8_t i = 0; i < 16; i++)
        arrive(i, 0);
    canopy_ns16550_on_interrupt(&device);
    assert_int_equal(stream.lost(stream.context), 1);
    arrive(99, 0);
    arrive(98, 0);
    canopy_ns16550_on_interrupt(&device);
    assert_int_equal(stream.lost(stream.context), 3);
    assert_int_equal(stream.read(stream.context, to, sizeof to), 32);
}

// Framing, parity, break: the byte is no byte, also where something else has read the status in between.
static void a_broken_character_is_dropped_and_counted(void **state) {
    uint8_t to[8];
    (void)state;
    for (uint8_t kind = 0x04; kind <= 0x10; kind = (uint8_t)(kind << 1)) {
        for (int looked = 0; looked < 2; looked++) {
            start_uart();
            arrive(1, kind);
            arrive(2, 0);
            if (looked != 0)
                (void)stream.sent(stream.context);
            canopy_ns16550_on_interrupt(&device);
            assert_int_equal(stream.read(stream.context, to, sizeof to), 1);
            assert_int_equal(to[0], 2);
            assert_int_equal(stream.lost(stream.context), 1);
        }
    }
}

static void all_is_sent_in_order_and_said_when_the_last_bit_has_left(void **state) {
    uint8_t from[64];
    (void)state;
    start_uart();
    for (uint8_t i = 0; i < 64; i++)
        from[i] = (uint8_t)(i * 7);
    assert_true(stream.sent(stream.context));
    assert_int_equal(stream.write(stream.context, from, 64), 64);
    assert_int_equal(wire.in_fifo, 16);
    assert_int_equal(stream.write(stream.context, from, 64), 16);  // what the FIFO has taken
    for (uint32_t times = 0; times < 80; times++) {
        assert_false(stream.sent(stream.context));
        shift_out();
        if (wire.in_fifo == 0)
            canopy_ns16550_on_interrupt(&device);
    }
    assert_int_equal(wire.sent_count, 80);
    assert_true(wire.shifting);
    assert_false(stream.sent(stream.context));
    shift_out();
    assert_true(stream.sent(stream.context));
    for (uint32_t i = 0; i < 80; i++)
        assert_int_equal(wire.sent[i], from[i % 64]);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_clock_is_whole_over_the_turn_of_its_low_word),
        cmocka_unit_test(the_clock_never_goes_back),
        cmocka_unit_test(microseconds_are_ticks_divided),
        cmocka_unit_test(an_alarm_is_never_early_while_it_is_set),
        cmocka_unit_test(an_alarm_goes_off_once),
        cmocka_unit_test(a_watchdog_bites_at_the_end_of_its_period_and_not_before),
        cmocka_unit_test(a_period_that_cannot_be_is_refused),
        cmocka_unit_test(the_line_is_8n1_at_its_speed),
        cmocka_unit_test(what_arrives_is_read_in_order),
        cmocka_unit_test(an_overrun_and_a_full_ring_are_counted),
        cmocka_unit_test(a_broken_character_is_dropped_and_counted),
        cmocka_unit_test(all_is_sent_in_order_and_said_when_the_last_bit_has_left),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
