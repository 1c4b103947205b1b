// port/rp2040's UART against a model of the chip: the direction pin of RS-485 around every byte, the end of sending to
// the bit, and every way in which a received byte is lost.
#include <stdlib.h>

#include "hosttest/rp2040_chip.h"

#include "port/common/byte_ring.c"
#include "port/rp2040/chip.c"
#include "port/rp2040/pl011.c"
#include "port/rp2040/timer.c"

#define PIN 2u
#define ALARM 2u

static struct canopy_pl011 uart;
static struct canopy_stream stream;
static uint8_t receive_ring[64], send_ring[128];
static struct chip_uart *const line = &chip.uart[0];

static void on_uart(void) { canopy_pl011_on_interrupt(&uart); }
static void on_alarm(void) { canopy_pl011_on_alarm(&uart); }

static void start(uint32_t baud, bool even) {
    chip_start();
    chip.handler[RP2040_IRQ_UART0] = on_uart;
    chip.handler[RP2040_IRQ_TIMER + ALARM] = on_alarm;
    chip.resets &= ~(RP2040_RESET_TIMER | RP2040_RESET_IO_BANK0);
    canopy_rp2040_put(RP2040_GPIO_ENABLE_SET, 1u << PIN);
    canopy_pl011_start(&uart, &(struct canopy_pl011_config){.base = RP2040_UART0,
                                                            .reset = RP2040_RESET_UART0,
                                                            .irq = RP2040_IRQ_UART0,
                                                            .clock_hz = 125000000u,
                                                            .baud = baud,
                                                            .even_parity = even,
                                                            .receive_ring = receive_ring,
                                                            .send_ring = send_ring,
                                                            .receive_length = sizeof receive_ring,
                                                            .send_length = sizeof send_ring,
                                                            .direction = 1u << PIN,
                                                            .alarm = ALARM});
    stream = canopy_pl011_stream(&uart);
}

static bool pin_is_high(void) { return (chip.out >> PIN & 1u) != 0; }

static size_t write_bytes(size_t from, size_t count) {
    uint8_t bytes[CHIP_BYTES];
    for (size_t i = 0; i < count; i++)
        bytes[i] = (uint8_t)((from + i) * 7u);
    return stream.write(stream.context, bytes, count);
}

static uint64_t bit_ns(uint32_t baud) { return 1000000000u / baud; }
static uint64_t last_end(void) { return line->wire[line->sent - 1].end_ns; }

static void assert_wire(size_t count) {
    assert_int_equal(line->sent, count);
    for (size_t i = 0; i < count; i++)
        assert_int_equal(line->wire[i].byte, (uint8_t)(i * 7u));
}

static void wait_for_fall(void) {
    for (uint64_t end = chip.now_ns + 3000000000u; pin_is_high(); chip_pass(1000))
        assert_true(chip.now_ns < end);
}

// Datasheet 4.2.7.1's own example, and the rates that are usual.
static void test_divisors(void **state) {
    (void)state;
    const struct {
        uint32_t baud, whole, part;
    } cases[] = {{115200, 67, 52}, {9600, 813, 51}, {19200, 406, 58}, {1200, 6510, 27}, {1000000, 7, 52}};
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        start(cases[i].baud, false);
        assert_int_equal(line->whole, cases[i].whole);
        assert_int_equal(line->part, cases[i].part);
        assert_int_equal(line->format, 3u << 5);
        assert_int_equal(line->control, 0x301);
    }
    start(19200, true);
    assert_int_equal(line->format, 3u << 5 | 6u);  // 8E1, FIFOs off
}

static const uint32_t bauds[] = {1200, 9600, 19200, 57600, 115200, 1000000};
#define FOR_EACH_BAUD(baud)                                                                                            \
    for (size_t turn_ = 0; turn_ < sizeof bauds / sizeof bauds[0]; turn_++)                                            \
        for (uint32_t baud = bauds[turn_], once_ = 1; once_ != 0; once_ = 0)

static void test_pin_is_high_around_a_frame(void **state) {
    (void)state;
    FOR_EACH_BAUD(baud) for (int even = 0; even < 2; even++) {
        start(baud, even != 0);
        assert_false(pin_is_high());
        assert_int_equal(write_bytes(0, 100), 100);
        assert_true(pin_is_high());
        wait_for_fall();
        assert_wire(100);
        for (size_t i = 1; i < 100; i++)
            assert_true(line->wire[i].begin_ns - line->wire[i - 1].end_ns < 1000);  // no gap within
        assert_int_equal(chip.rises[PIN], 1);
        assert_true(chip.rose_ns[PIN] < line->wire[0].begin_ns);
        assert_true(chip.fell_ns[PIN] >= last_end());
        assert_true(chip.fell_ns[PIN] <= last_end() + bit_ns(baud) + 4000u);
    }
}

static void test_sent_is_true_after_the_last_stop_bit(void **state) {
    (void)state;
    FOR_EACH_BAUD(baud) {
        start(baud, false);
        assert_true(stream.sent(stream.context));
        write_bytes(0, 5);
        bool sent = false;
        for (uint64_t end = chip.now_ns + 100000000u; !sent; chip_pass(500)) {
            assert_true(chip.now_ns < end);
            sent = stream.sent(stream.context);
            assert_true(!sent || (line->sent == 5 && chip.now_ns >= last_end()));
        }
        assert_true(chip.now_ns <= last_end() + 4000u);
    }
}

// A byte comes while the last one before it leaves: at every moment around its end.
static void test_bytes_behind_the_last(void **state) {
    (void)state;
    for (uint32_t after = 0; after < 30000; after += 137) {
        start(115200, false);
        write_bytes(0, 3);
        while (line->sent < 3)
            chip_pass(100);
        while (chip.now_ns + 15000 < last_end() + after)
            chip_pass(50);
        write_bytes(3, 2);
        assert_true(pin_is_high());
        wait_for_fall();
        assert_wire(5);
        assert_true(chip.fell_ns[PIN] >= last_end() && chip.fell_ns[PIN] <= last_end() + bit_ns(115200) + 4000u);
        assert_true(chip.rose_ns[PIN] < line->wire[chip.rises[PIN] == 1 ? 0 : 3].begin_ns);
    }
}

// The clock of the bits is not that of the microseconds: the busy flag has the last word.
static void test_slow_transmitter(void **state) {
    (void)state;
    FOR_EACH_BAUD(baud) {
        start(baud, false);
        line->slow = 20;
        write_bytes(0, 120);
        wait_for_fall();
        assert_wire(120);
        assert_true(chip.fell_ns[PIN] >= last_end());
        assert_true(chip.fell_ns[PIN] <= last_end() + 2u * bit_ns(baud) + 6000u);
    }
}

// Whoever has heard that all is sent may mask interrupts for half a second, to erase flash: the others' line is free.
static void test_sent_means_that_the_pin_has_fallen(void **state) {
    (void)state;
    FOR_EACH_BAUD(baud) for (uint32_t slow = 0; slow <= 20; slow += 2) {
        start(baud, false);
        line->slow = slow;
        write_bytes(0, 60);
        for (uint64_t end = chip.now_ns + 3000000000u; !stream.sent(stream.context); chip_pass(700))
            assert_true(chip.now_ns < end);
        assert_false(pin_is_high());
        assert_true(chip.fell_ns[PIN] >= last_end());
        chip_pass(5000000);
        assert_false(pin_is_high());
        assert_int_equal(chip.rises[PIN], 1);
        assert_int_equal(write_bytes(60, 3), 3);
        wait_for_fall();
        assert_wire(63);
    }
}

// An emulator that swallows bytes and is never busy: the time of the wire holds all the same.
static void test_instant_transmitter(void **state) {
    (void)state;
    FOR_EACH_BAUD(baud)
    for (uint32_t even = 0; even < 2; even++) {
        start(baud, even != 0);
        line->instant = true;
        const uint64_t begin = chip.now_ns, least = (500u + 50u * even) * bit_ns(baud);
        write_bytes(0, 50);
        assert_false(stream.sent(stream.context));
        wait_for_fall();
        assert_wire(50);
        assert_true(chip.fell_ns[PIN] - begin >= least && chip.fell_ns[PIN] - begin <= least + 100000u);
        assert_true(stream.sent(stream.context));
    }
}

static void test_without_a_direction_pin(void **state) {
    (void)state;
    start(115200, false);
    uart.direction = 0;
    write_bytes(0, 20);
    chip_pass(3000000);
    assert_wire(20);
    assert_int_equal(chip.rises[PIN], 0);
    assert_int_equal(chip.armed & 1u << ALARM, 0);
    assert_true(stream.sent(stream.context));
}

static void test_full_ring_takes_no_more(void **state) {
    (void)state;
    start(9600, false);
    assert_int_equal(write_bytes(0, 200), 128);
    assert_int_equal(write_bytes(128, 10), 2);  // two have gone to the transmitter
    wait_for_fall();
    assert_wire(130);
}

static void test_received_bytes(void **state) {
    (void)state;
    start(115200, false);
    uint8_t got[100];
    for (uint32_t i = 0; i < 60; i++) {
        chip_receive(0, i);
        chip_pass(86000);
    }
    assert_int_equal(stream.read(stream.context, got, 20), 20);
    assert_int_equal(stream.read(stream.context, &got[20], 80), 40);
    for (uint32_t i = 0; i < 60; i++)
        assert_int_equal(got[i], i);
    assert_int_equal(stream.read(stream.context, got, 1), 0);
    assert_int_equal(stream.lost(stream.context), 0);
}

static void test_each_bad_byte_is_lost_and_counted(void **state) {
    (void)state;
    start(115200, true);
    uint8_t got[8];
    const uint32_t bad[] = {0x141, 0x242, 0x700, 0x343};  // framing, parity, break with both, two at once
    for (uint32_t i = 0; i < 4; i++) {
        chip_receive(0, 0x30u + i);
        chip_receive(0, bad[i]);
    }
    assert_int_equal(stream.read(stream.context, got, 8), 4);
    assert_memory_equal(got, "0123", 4);
    assert_int_equal(stream.lost(stream.context), 4);
}

static void test_overruns(void **state) {
    (void)state;
    start(115200, false);
    uint8_t got[80];
    chip.masked = 1;
    chip_receive(0, 'a');
    chip_receive(0, 'b');
    chip_receive(0, 'c');
    canopy_core_restore(0);
    assert_int_equal(stream.lost(stream.context), 1);  // the chip does not tell how many
    chip_receive(0, 'd');
    assert_int_equal(stream.read(stream.context, got, 80), 2);
    assert_memory_equal(got, "ad", 2);
    for (uint32_t i = 0; i < 70; i++)
        chip_receive(0, i);
    assert_int_equal(stream.lost(stream.context), 1 + 6);  // behind the ring's 64
    assert_int_equal(stream.read(stream.context, got, 80), 64);
    assert_int_equal(got[63], 63);
}

// Anything in any order: every byte leaves once, in order, under a high pin.
static void test_random_use(void **state) {
    (void)state;
    srand(40);
    for (int run = 0; run < 300; run++) {
        start(bauds[rand() % 6], rand() % 2 != 0);
        line->slow = (uint32_t)rand() % 8u;
        size_t written = 0, heard = 0, told = 0;
        uint8_t got[32];
        for (int step = 0; step < 120 && written < 800; step++) {
            switch (rand() % 4) {
            case 0: written += write_bytes(written, (size_t)(rand() % 40)); break;
            case 1:
                chip_receive(0, told & 0xFFu);
                told++;
                chip_pass(20);
                break;
            case 2:
                for (size_t n = stream.read(stream.context, got, sizeof got), i = 0; i < n; i++, heard++)
                    assert_int_equal(got[i], heard & 0xFFu);
                break;
            default: chip_pass((uint64_t)(rand() % 2000000)); break;
            }
            assert_true(pin_is_high() || (line->shifting == 0 && line->waiting == 0));
        }
        wait_for_fall();
        assert_wire(written);
        assert_true(written == 0 || chip.fell_ns[PIN] >= last_end());
        assert_int_equal(heard + stream.read(stream.context, got, 32) + stream.lost(stream.context) <= told, true);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_divisors),
        cmocka_unit_test(test_pin_is_high_around_a_frame),
        cmocka_unit_test(test_sent_is_true_after_the_last_stop_bit),
        cmocka_unit_test(test_bytes_behind_the_last),
        cmocka_unit_test(test_slow_transmitter),
        cmocka_unit_test(test_sent_means_that_the_pin_has_fallen),
        cmocka_unit_test(test_instant_transmitter),
        cmocka_unit_test(test_without_a_direction_pin),
        cmocka_unit_test(test_full_ring_takes_no_more),
        cmocka_unit_test(test_received_bytes),
        cmocka_unit_test(test_each_bad_byte_is_lost_and_counted),
        cmocka_unit_test(test_overruns),
        cmocka_unit_test(test_random_use),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
