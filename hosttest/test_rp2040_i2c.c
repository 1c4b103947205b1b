// port/rp2040's I2C master against a model of the controller and of the bus: transfers of every shape, every refusal,
// a clock held without end, and a data line that is held for 1 to 9 clocks, or for ever.
#include <stdlib.h>

#include "hosttest/rp2040_chip.h"

#include "port/rp2040/chip.c"
#include "port/rp2040/dw_i2c.c"
#include "port/rp2040/timer.c"

#define ADDRESS 0x29u
#define TIMEOUT_US 20000u

static struct canopy_dw_i2c master;
static struct canopy_i2c bus;
static uint32_t interrupts, alarms;

static void on_i2c(void) {
    interrupts++;
    (void)canopy_dw_i2c_on_interrupt(&master);
}

static void on_i2c_alarm(void) {
    alarms++;
    canopy_dw_i2c_on_alarm(&master);
}

static void power_on(void) {
    chip_start();
    chip.handler[RP2040_IRQ_I2C0] = on_i2c;
    chip.handler[RP2040_IRQ_TIMER + 3] = on_i2c_alarm;
    chip.resets &= ~(RP2040_RESET_TIMER | RP2040_RESET_IO_BANK0);
    chip.data_pin = 4;
    chip.clock_pin = 5;
    chip.device.address = ADDRESS;
    for (uint32_t i = 0; i < 256; i++)
        chip.device.memory[i] = (uint8_t)(i * 37u + 11u);
    interrupts = alarms = 0;
    canopy_dw_i2c_start(&master, &(struct canopy_dw_i2c_config){.base = RP2040_I2C0,
                                                                .reset = RP2040_RESET_I2C0,
                                                                .irq = RP2040_IRQ_I2C0,
                                                                .clock_hz = 125000000u,
                                                                .data_pin = 4,
                                                                .clock_pin = 5,
                                                                .alarm = 3});
    bus = canopy_dw_i2c(&master);
}

static enum canopy_i2c_outcome run(const struct canopy_i2c_transfer *transfer, uint64_t poll_ns) {
    assert_true(bus.start(bus.context, transfer, TIMEOUT_US));
    const uint64_t end = chip.now_ns + 1000u * (TIMEOUT_US + 2000u) + poll_ns;
    enum canopy_i2c_outcome outcome;
    while ((outcome = bus.poll(bus.context)) == CANOPY_I2C_PENDING) {
        assert_false(bus.start(bus.context, transfer, TIMEOUT_US));
        assert_true(chip.now_ns < end);
        chip_pass(poll_ns);
    }
    assert_int_equal(bus.poll(bus.context), outcome);
    assert_int_equal(chip.function[4], RP2040_FUNCTION_I2C);
    assert_int_equal(chip.function[5], RP2040_FUNCTION_I2C);
    assert_int_equal(chip.armed & 8u, 0);
    return outcome;
}

static uint8_t remembered(uint32_t at) { return (uint8_t)(at % 256u * 37u + 11u); }

// 4.3.14 and the I2C specification's table 10: 400 kHz, low at least 1.3 us, high at least 0.6 us, data held 0.3 us.
static void test_timing(void **state) {
    (void)state;
    power_on();
    const double low_us = (chip.i2c.low + 1) / 125.0, high_us = (chip.i2c.high + chip.i2c.spike + 7) / 125.0;
    assert_true(low_us >= 1.3 && high_us >= 0.6);
    assert_true(low_us + high_us >= 2.5 && low_us + high_us < 2.6);
    assert_true(chip.i2c.hold / 125.0 >= 0.3 && chip.i2c.hold + 2 <= chip.i2c.low);
    assert_true(chip.i2c.spike / 125.0 >= 0.05 && chip.i2c.spike / 125.0 < 0.06);
    assert_int_equal(chip.i2c.control, 0x65);
    assert_int_equal(chip.pad[4], 0x5A);  // pulled up, an input with a Schmitt trigger, 4 mA
    assert_int_equal(bus.poll(bus.context), CANOPY_I2C_UNSUPPORTED);
}

// Every length around the FIFO's, polled often, or so rarely that interrupts must do it all.
static void test_reads_of_every_length(void **state) {
    (void)state;
    const uint64_t polls[] = {200, 50000, 15000000};
    for (int p = 0; p < 3; p++)
        for (uint32_t length = 1; length <= 255; length += length < 40 ? 1 : 43)
            for (int stop = 0; stop < 2; stop++) {
                power_on();
                const uint8_t out[] = {17};
                uint8_t in[256] = {0};
                const struct canopy_i2c_transfer transfer = {.out = out,
                                                             .in = in,
                                                             .out_length = 1,
                                                             .in_length = (uint16_t)length,
                                                             .address = ADDRESS,
                                                             .stop_between = stop != 0};
                assert_int_equal(run(&transfer, polls[p]), CANOPY_I2C_DONE);
                for (uint32_t i = 0; i < 256; i++)
                    assert_int_equal(in[i], i < length ? remembered(17 + i) : 0);
                assert_int_equal(chip.i2c.starts, stop != 0 ? 2 : 1);
                assert_int_equal(chip.i2c.restarts, stop != 0 ? 0 : 1);
                assert_int_equal(chip.i2c.stops, stop != 0 ? 2 : 1);
                assert_true(interrupts < length / 4 + 6);
            }
}

// The program masks interrupts for longer than the FIFO lasts, as when it writes the flash: the controller holds the
// clock, and nothing that comes finds the FIFO full.
static void test_masked_for_long(void **state) {
    (void)state;
    power_on();
    uint8_t out[1] = {0}, in[255];
    const struct canopy_i2c_transfer transfer = {
        .out = out, .in = in, .out_length = 1, .in_length = 255, .address = ADDRESS};
    assert_true(bus.start(bus.context, &transfer, TIMEOUT_US));
    for (int i = 0; i < 14; i++) {
        const uint32_t before = canopy_core_mask();
        chip_pass(1000000);
        canopy_core_restore(before);
        chip_pass(1000);
    }
    while (bus.poll(bus.context) == CANOPY_I2C_PENDING)
        chip_pass(1000);
    assert_int_equal(bus.poll(bus.context), CANOPY_I2C_DONE);
    for (uint32_t i = 0; i < 255; i++)
        assert_int_equal(in[i], remembered(i));
    assert_int_equal(chip.i2c.most_got, 16);
}

static void test_writes(void **state) {
    (void)state;
    for (uint32_t length = 1; length <= 200; length += 7) {
        power_on();
        uint8_t out[256] = {90};
        for (uint32_t i = 1; i < length; i++)
            out[i] = (uint8_t)(i ^ 0x55u);
        const struct canopy_i2c_transfer transfer = {.out = out, .out_length = (uint16_t)length, .address = ADDRESS};
        assert_int_equal(run(&transfer, 30000), CANOPY_I2C_DONE);
        for (uint32_t i = 1; i < length; i++)
            assert_int_equal(chip.device.memory[(90 + i - 1) & 255u], i ^ 0x55u);
        assert_int_equal(chip.i2c.stops, 1);
    }
}

static void test_probes(void **state) {
    (void)state;
    for (uint32_t address = 0; address < 128; address++) {
        power_on();
        const struct canopy_i2c_transfer transfer = {.address = (uint8_t)address};
        assert_int_equal(run(&transfer, 1000), address == ADDRESS ? CANOPY_I2C_DONE : CANOPY_I2C_NAK_ADDRESS);
        assert_int_equal(chip.i2c.stops, 1);
    }
}

static void test_what_cannot_be(void **state) {
    (void)state;
    power_on();
    const struct canopy_i2c_transfer wrong[] = {
        {.address = 128}, {.address = ADDRESS, .out_length = 1}, {.address = ADDRESS, .in_length = 1}};
    for (int i = 0; i < 3; i++) {
        assert_true(bus.start(bus.context, &wrong[i], TIMEOUT_US));
        assert_int_equal(bus.poll(bus.context), CANOPY_I2C_UNSUPPORTED);
    }
    assert_int_equal(chip.i2c.starts, 0);
}

// Refused at each byte, and a good transfer behind each.
static void test_refused_bytes(void **state) {
    (void)state;
    power_on();
    uint8_t out[40] = {0}, in[4];
    for (uint32_t at = 0; at < 40; at++) {
        chip.device.refuses_at = at;
        assert_int_equal(run(&(struct canopy_i2c_transfer){.out = out, .out_length = 40, .address = ADDRESS}, 700),
                         CANOPY_I2C_NAK_DATA);
        chip.device.refuses_at = UINT32_MAX;
        out[0] = 100;
        assert_int_equal(run(
                             &(struct canopy_i2c_transfer){
                                 .out = out, .in = in, .out_length = 1, .in_length = 4, .address = ADDRESS},
                             700),
                         CANOPY_I2C_DONE);
        assert_int_equal(in[3], chip.device.memory[103]);
    }
}

static void test_lost_arbitration(void **state) {
    (void)state;
    power_on();
    chip.i2c.loses_arbitration = true;
    assert_int_equal(run(&(struct canopy_i2c_transfer){.address = ADDRESS}, 1000), CANOPY_I2C_ARBITRATION);
    chip.i2c.loses_arbitration = false;
    assert_int_equal(run(&(struct canopy_i2c_transfer){.address = ADDRESS}, 1000), CANOPY_I2C_DONE);
}

// The clock is held without end from each byte on: the transfer ends in time, by itself where the program sleeps.
static void test_held_clock(void **state) {
    (void)state;
    for (uint32_t at = 0; at < 6; at++) {
        power_on();
        chip.device.stretches_at = at;
        uint8_t out[4] = {0}, in[4];
        const struct canopy_i2c_transfer transfer = {
            .out = out, .in = in, .out_length = 3, .in_length = 4, .address = ADDRESS};
        const uint64_t begin = chip.now_ns;
        assert_true(bus.start(bus.context, &transfer, TIMEOUT_US));
        while (alarms == 0)
            chip_pass(1000);
        assert_true(chip.now_ns - begin >= 1000u * TIMEOUT_US && chip.now_ns - begin < 1000u * TIMEOUT_US + 20000u);
        assert_int_equal(bus.poll(bus.context), CANOPY_I2C_HELD);
        assert_true(chip.now_ns - begin < 1000u * (TIMEOUT_US + 700u));
        assert_int_equal(bus.recoveries(bus.context), 0);
        chip.device.holds_clock = false;
        chip.device.stretches_at = UINT32_MAX;
        assert_int_equal(run(&transfer, 1000), CANOPY_I2C_DONE);
    }
}

// A device that holds the data line lets go after so many clocks: nine are always enough, and a STOP ends them.
static void test_held_data_line(void **state) {
    (void)state;
    for (uint32_t clocks = 1; clocks <= 9; clocks++) {
        power_on();
        chip.device.clocks_to_rest = clocks;
        chip.clock_pulses = 0;
        uint8_t out[1] = {3}, in[2];
        const struct canopy_i2c_transfer transfer = {
            .out = out, .in = in, .out_length = 1, .in_length = 2, .address = ADDRESS};
        const uint64_t begin = chip.now_ns;
        assert_true(bus.start(bus.context, &transfer, TIMEOUT_US));
        assert_true(chip.now_ns - begin < 140000u);  // a tenth of a millisecond and the STOP
        assert_int_equal(chip.clock_pulses, clocks + 1);
        assert_true(chip.stop_seen);
        while (bus.poll(bus.context) == CANOPY_I2C_PENDING)
            chip_pass(1000);
        assert_int_equal(bus.poll(bus.context), CANOPY_I2C_DONE);
        assert_int_equal(in[1], remembered(4));
        assert_int_equal(bus.recoveries(bus.context), 1);
    }
}

static void test_data_line_held_for_ever(void **state) {
    (void)state;
    const uint32_t clocks[] = {11, 30, UINT32_MAX};
    for (int i = 0; i < 3; i++) {
        power_on();
        chip.device.clocks_to_rest = clocks[i];
        const struct canopy_i2c_transfer transfer = {.address = ADDRESS};
        assert_true(bus.start(bus.context, &transfer, TIMEOUT_US));
        assert_int_equal(bus.poll(bus.context), CANOPY_I2C_HELD);
        assert_int_equal(bus.recoveries(bus.context), 0);
        assert_int_equal(chip.out_enable & 0x30u, 0);  // we hold nothing
    }
}

// The data line falls and stays during a transfer: a timeout, the bus is free again, and that is counted.
static void test_data_line_held_in_a_transfer(void **state) {
    (void)state;
    power_on();
    uint8_t out[30] = {0};
    const struct canopy_i2c_transfer transfer = {.out = out, .out_length = 30, .address = ADDRESS};
    assert_true(bus.start(bus.context, &transfer, TIMEOUT_US));
    chip_pass(200000);
    chip.device.clocks_to_rest = 4;
    enum canopy_i2c_outcome outcome;
    while ((outcome = bus.poll(bus.context)) == CANOPY_I2C_PENDING)
        chip_pass(10000);
    assert_int_equal(outcome, CANOPY_I2C_TIMEOUT);
    assert_int_equal(bus.recoveries(bus.context), 1);
    assert_int_equal(run(&transfer, 10000), CANOPY_I2C_DONE);
}

// Anything behind anything, with faults: what is read is right or is not said to be.
static void test_random_transfers(void **state) {
    (void)state;
    srand(41);
    for (int round = 0; round < 30; round++) {
        power_on();
        for (int i = 0; i < 60; i++) {
            uint8_t out[64] = {(uint8_t)rand()}, in[128];
            struct canopy_i2c_transfer transfer = {.out = out,
                                                   .in = in,
                                                   .out_length = (uint16_t)(rand() % 2),
                                                   .in_length = (uint16_t)(rand() % 128),
                                                   .address = rand() % 8 == 0 ? 9 : ADDRESS,
                                                   .stop_between = rand() % 2 != 0};
            chip.device.pointer = 0;
            chip.device.refuses_at = rand() % 8 == 0 ? 0 : UINT32_MAX;
            chip.device.clocks_to_rest = rand() % 8 == 0 ? (uint32_t)(rand() % 12) : 0;
            chip.device.stretches_at = rand() % 8 == 0 ? (uint32_t)(rand() % 128) : UINT32_MAX;
            const bool faultless = transfer.address == ADDRESS && chip.device.refuses_at != 0 &&
                                   chip.device.clocks_to_rest <= 9 && chip.device.stretches_at == UINT32_MAX;
            const uint8_t from = transfer.out_length > 0 ? out[0] : 0;
            const enum canopy_i2c_outcome outcome = run(&transfer, (uint64_t)(100 + rand() % 100000));
            assert_true(!faultless || outcome == CANOPY_I2C_DONE);
            for (uint32_t k = 0; outcome == CANOPY_I2C_DONE && k < transfer.in_length; k++)
                assert_int_equal(in[k], remembered(from + k));
            chip.device.clocks_to_rest = 0;
            chip.device.holds_clock = false;
        }
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_timing),
        cmocka_unit_test(test_reads_of_every_length),
        cmocka_unit_test(test_masked_for_long),
        cmocka_unit_test(test_writes),
        cmocka_unit_test(test_probes),
        cmocka_unit_test(test_what_cannot_be),
        cmocka_unit_test(test_refused_bytes),
        cmocka_unit_test(test_lost_arbitration),
        cmocka_unit_test(test_held_clock),
        cmocka_unit_test(test_held_data_line),
        cmocka_unit_test(test_data_line_held_for_ever),
        cmocka_unit_test(test_data_line_held_in_a_transfer),
        cmocka_unit_test(test_random_transfers),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
