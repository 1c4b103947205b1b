// The scan link over I2C (lib/scan/i2c_link): its bytes, and every fault at every byte and bit of a transfer.
#include "hosttest/i2c_bus.h"
#include "hosttest/unit/unit.h"
#include "lib/num/crc.h"
#include "lib/scan/generic.h"
#include "lib/scan/i2c_link.h"

#define TIMEOUT_US 30000u
#define ALL CANOPY_SCAN_READ_MAX
#define REQUEST_BYTES 5  // address, pointer, count, tag
#define WIRE_BYTES (REQUEST_BYTES + 1 + 2 * ALL + 2)

static struct i2c_bus bus;
static struct canopy_i2c port;
static struct i2c_registers file;
static struct canopy_profile_table table;
static struct canopy_i2c_link link;
static struct canopy_scan_link seam;
static struct canopy_scan_answer answer;
static uint64_t now;

// A register whose value tells its address, and nothing simple.
static uint16_t value_at(uint32_t address) { return (uint16_t)(address * 40503u + 12345u); }

static bool load(void *context, uint16_t address, uint16_t count, uint16_t *to) {
    (void)context;
    for (uint16_t i = 0; i < count; i++)
        to[i] = value_at((uint32_t)address + i);
    return address < 2000;
}

static enum canopy_status start_link(void) {
    port = i2c_bus_port(&bus);
    seam = canopy_i2c_link(&link);
    now = 5000;
    return canopy_i2c_link_init(&link, &port, &table, TIMEOUT_US);
}

// A fresh bus with nobody on it, and the generic table.
static void clean(void) {
    i2c_bus_init(&bus);
    table = canopy_profile_generic;
}

static void start(void) {
    clean();
    i2c_registers_init(&file, CANOPY_GENERIC_I2C_ADDRESS, load, NULL);
    i2c_bus_add(&bus, &file.slave);
    CHECK_EQ(start_link(), CANOPY_OK);
}

static struct canopy_profile_request request_of(uint16_t address, uint16_t count) {
    return (struct canopy_profile_request){.address = address, .count = count};
}

static bool begin(uint16_t address, uint16_t count) {
    const struct canopy_profile_request request = request_of(address, count);
    return seam.begin(seam.context, &request, now);
}

static enum canopy_scan_link_state poll(void) {
    now += 100;
    return seam.poll(seam.context, now, &answer);
}

// A read to its end.
static enum canopy_scan_link_state read(uint16_t address, uint16_t count) {
    CHECK(begin(address, count));
    for (int i = 0; i < 2000; i++) {
        const enum canopy_scan_link_state state = poll();
        if (state != CANOPY_SCAN_LINK_PENDING) {
            CHECK_EQ(poll(), CANOPY_SCAN_LINK_PENDING);  // what ended is said once
            return state;
        }
    }
    return CANOPY_SCAN_LINK_PENDING;
}

static bool right(uint16_t address, uint16_t count) {
    bool all = answer.count == count;
    for (uint16_t i = 0; i < count; i++)
        all = all && answer.registers[i] == value_at((uint32_t)address + i);
    return all;
}

static void check_right(uint16_t address, uint16_t count) {
    CHECK_EQ(read(address, count), CANOPY_SCAN_LINK_DONE);
    CHECK(right(address, count));
}

static void check_failed(uint16_t address, uint16_t count, enum canopy_scan_failure why) {
    CHECK_EQ(read(address, count), CANOPY_SCAN_LINK_FAILED);
    CHECK_EQ(answer.failure, why);
}

// ---- Bytes on the wire, from outside of this program

// A slave that writes down what it hears and plays what it was given.
static struct {
    struct i2c_slave slave;
    uint8_t heard[8], length, plays[16], at;
} scripted;

static bool scripted_select(void *context, bool reading) {
    (void)context;
    scripted.length = reading ? scripted.length : 0;
    scripted.at = 0;
    return true;
}

static bool scripted_write(void *context, uint8_t byte) {
    (void)context;
    CHECK(scripted.length < sizeof scripted.heard);
    scripted.heard[scripted.length++] = byte;
    return true;
}

static uint8_t scripted_read(void *context) {
    (void)context;
    CHECK(scripted.at < sizeof scripted.plays);
    return scripted.plays[scripted.at++];
}

static void scripted_stop(void *context) { (void)context; }

static void start_scripted(const struct canopy_scan_i2c *kind, const uint8_t *plays, size_t length) {
    clean();
    table.i2c = *kind;
    memset(&scripted, 0, sizeof scripted);
    scripted.slave =
        (struct i2c_slave){NULL, kind->address, scripted_select, scripted_write, scripted_read, scripted_stop};
    memcpy(scripted.plays, plays, length);
    i2c_bus_add(&bus, &scripted.slave);
    CHECK_EQ(start_link(), CANOPY_OK);
}

static void check_heard(const uint8_t *bytes, size_t length) {
    CHECK_EQ(scripted.length, length);
    CHECK_BYTES(scripted.heard, bytes, length);
}

UNIT(check_sums_have_their_check_values) {
    CHECK_EQ(canopy_crc16(CANOPY_CRC16_START, (const uint8_t *)"123456789", 9), 0x4B37);
    CHECK_EQ(canopy_crc8(CANOPY_CRC8_START, (const uint8_t *)"123456789", 9), 0xF4);
}

// The examples of lib/scan/generic.h and docs/scanners.md.
UNIT(the_generic_map_speaks_as_documented) {
    start_scripted(&canopy_profile_generic.i2c, (const uint8_t[]){0x43, 0x4E, 0x50, 0x53, 0x7D, 0x3F}, 6);
    CHECK_EQ(read(0, 2), CANOPY_SCAN_LINK_DONE);
    check_heard((const uint8_t[]){0x00, 0x00, 0x02, 0x01}, 4);
    CHECK_EQ(bus.address, 0x29);
    CHECK_EQ(bus.timeout_us, TIMEOUT_US);
    CHECK(!bus.stopped_between);
    CHECK_EQ(answer.count, 2);
    CHECK_EQ(answer.registers[0], 0x434E);
    CHECK_EQ(answer.registers[1], 0x5053);
    static const uint8_t header[] = {0x00, 0x07, 0x00, 0x01, 0x00, 0x00, 0x02, 0xBC, 0x00, 0x0C, 0x4F, 0x03};
    memcpy(scripted.plays, header, sizeof header);
    CHECK_EQ(read(64, 5), CANOPY_SCAN_LINK_DONE);
    check_heard((const uint8_t[]){0x00, 0x40, 0x05, 0x02}, 4);
    CHECK_EQ(answer.registers[0], 7);
    CHECK_EQ(answer.registers[3], 700);
}

// SMBus "read word": command, low byte first, packet error code.
UNIT(a_table_of_an_smbus_device) {
    const struct canopy_scan_i2c kind = {
        .address = 0x0B, .pointer_bytes = 1, .pointer_step = 1, .low_first = true, .check = CANOPY_SCAN_CRC8};
    start_scripted(&kind, (const uint8_t[]){0x34, 0x12, 0xB8}, 3);
    CHECK_EQ(read(9, 1), CANOPY_SCAN_LINK_DONE);
    check_heard((const uint8_t[]){0x09}, 1);
    CHECK_EQ(answer.registers[0], 0x1234);
    scripted.plays[2] ^= 1u;
    check_failed(9, 1, CANOPY_SCAN_CRC);
    check_failed(8, 1, CANOPY_SCAN_CRC);
    CHECK(!begin(255, 2));  // beyond the pointer
    CHECK(begin(255, 1));
}

UNIT(a_table_with_a_pointer_in_bytes_low_byte_first_and_stop_between) {
    const struct canopy_scan_i2c kind = {.address = 0x50,
                                         .pointer_bytes = 2,
                                         .pointer_low_first = true,
                                         .pointer_step = 2,
                                         .counted = true,
                                         .check = CANOPY_SCAN_CRC16,
                                         .stop_between = true};
    start_scripted(&kind, (const uint8_t[]){0x12, 0x34, 0xAB, 0xCD, 0x17, 0x60}, 6);
    CHECK_EQ(read(0x105, 2), CANOPY_SCAN_LINK_DONE);
    check_heard((const uint8_t[]){0x0A, 0x02, 0x02}, 3);
    CHECK(bus.stopped_between);
    CHECK_EQ(answer.registers[0], 0x1234);
    CHECK_EQ(answer.registers[1], 0xABCD);
    CHECK(!begin(0x8000, 1));
    CHECK(!begin(0x7FFF, 2));
    CHECK(begin(0x7FFF, 1));
}

UNIT(a_table_without_check_sum) {
    const struct canopy_scan_i2c kind = {.address = 0x40, .pointer_bytes = 1, .pointer_step = 1};
    start_scripted(&kind, (const uint8_t[]){0xBE, 0xEF}, 2);
    CHECK_EQ(read(3, 1), CANOPY_SCAN_LINK_DONE);
    check_heard((const uint8_t[]){0x03}, 1);
    CHECK_EQ(bus.at, 5);  // two addresses, the pointer and two bytes
    CHECK_EQ(answer.registers[0], 0xBEEF);
}

// ---- The link with a scanner that is well

UNIT(reads_of_any_length) {
    start();
    for (uint16_t count = 1; count <= ALL; count++)
        check_right((uint16_t)(count * 7), count);
    CHECK_EQ(bus.transfers, ALL);
    CHECK_EQ(file.answered, ALL);
    CHECK(!begin(0, 0));
    CHECK(!begin(0, ALL + 1));
    CHECK(!begin(0xFFFF, 2));
}

UNIT(every_transfer_has_another_tag) {
    start();
    uint8_t last = 0;
    for (int i = 0; i < 300; i++) {
        check_right(12, 3);
        CHECK(bus.out[3] != last || i == 0);
        last = bus.out[3];
    }
}

UNIT(a_bus_that_moves_a_byte_at_a_time) {
    start();
    bus.bytes_a_poll = 1;
    check_right(500, ALL);
}

UNIT(what_a_bus_or_a_device_cannot_carry_at_once_goes_in_pieces) {
    for (uint16_t most = 2 * CANOPY_GENERIC_D_COUNT + 2; most < 260; most++) {
        start();
        bus.max_transfer = most;
        CHECK_EQ(start_link(), CANOPY_OK);
        check_right(69, ALL);
        const uint32_t each = (uint32_t)(most - 2) / 2 < ALL ? (uint32_t)(most - 2) / 2 : ALL;
        CHECK_EQ(bus.transfers, (ALL + each - 1) / each);
    }
    start();
    table.i2c.read_max = 32;
    CHECK_EQ(start_link(), CANOPY_OK);
    check_right(69, ALL);
    CHECK_EQ(bus.transfers, 4);
    bus.transfers = 0;
    check_right(64, 32);
    CHECK_EQ(bus.transfers, 1);
}

// One piece of several fails: all of the read does.
UNIT(a_fault_in_any_piece_fails_the_read) {
    for (unsigned piece = 0; piece < 4; piece++) {
        start();
        table.i2c.read_max = 32;
        CHECK_EQ(start_link(), CANOPY_OK);
        CHECK(begin(69, ALL));
        for (unsigned i = 0; i < piece; i++)
            CHECK_EQ(poll(), CANOPY_SCAN_LINK_PENDING);
        bus.flip_at = 8 * 20;
        CHECK_EQ(poll(), CANOPY_SCAN_LINK_FAILED);
        CHECK_EQ(answer.failure, CANOPY_SCAN_CRC);
        i2c_bus_be_well(&bus);
        check_right(69, ALL);
    }
}

UNIT(the_address_is_the_tables_or_another) {
    start();
    file.slave.address = 0x33;
    struct canopy_profile_request request = request_of(5, 4);
    request.unit = 0x33;
    CHECK(seam.begin(seam.context, &request, now));
    CHECK_EQ(poll(), CANOPY_SCAN_LINK_DONE);
    CHECK(right(5, 4));
    check_failed(5, 4, CANOPY_SCAN_NAK);
    for (unsigned unit = 1; unit < 256; unit++) {
        request.unit = (uint8_t)unit;
        const bool may = unit >= 0x08 && unit <= 0x77;
        CHECK_EQ(seam.begin(seam.context, &request, now), may);
        if (may)
            CHECK(poll() != CANOPY_SCAN_LINK_PENDING);
    }
}

UNIT(tables_and_buses_that_cannot_be_are_refused) {
    clean();
    CHECK_EQ(canopy_i2c_link_init(&link, &port, &table, 0), CANOPY_ARGUMENT);
    static const struct canopy_scan_i2c wrong[] = {
        {0},
        {.address = 7, .pointer_bytes = 1, .pointer_step = 1},
        {.address = 120, .pointer_bytes = 1, .pointer_step = 1},
        {.address = 41, .pointer_bytes = 0, .pointer_step = 1},
        {.address = 41, .pointer_bytes = 3, .pointer_step = 1},
        {.address = 41, .pointer_bytes = 2, .pointer_step = 0},
        {.address = 41, .pointer_bytes = 2, .pointer_step = 3},
        {.address = 41, .pointer_bytes = 2, .pointer_step = 1, .check = CANOPY_SCAN_CRC16 + 1},
    };
    for (unsigned i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        table.i2c = wrong[i];
        CHECK_EQ(start_link(), CANOPY_ARGUMENT);
    }
    clean();
    for (uint16_t most = 0; most < 2 * CANOPY_GENERIC_D_COUNT + 2; most++) {  // the description goes in one
        bus.max_transfer = most;
        CHECK_EQ(start_link(), CANOPY_UNSUPPORTED);
    }
    bus.max_transfer = UINT16_MAX;
    table.i2c.read_max = CANOPY_GENERIC_D_COUNT - 1;
    CHECK_EQ(start_link(), CANOPY_UNSUPPORTED);
}

// ---- Faults

static void check_well_again(void) {
    i2c_bus_be_well(&bus);
    i2c_registers_be_well(&file);
    check_right(300, 9);
}

UNIT(each_outcome_has_its_failure) {
    start();
    table.i2c.address = 0x2A;  // nobody there
    check_failed(0, 5, CANOPY_SCAN_NAK);
    table.i2c.address = 0x29;
    check_failed(2000, 5, CANOPY_SCAN_NAK);  // no such registers
    check_well_again();
    bus.held = true;
    check_failed(0, 5, CANOPY_SCAN_BUS);
    check_well_again();
    port.max_transfer = bus.max_transfer = 8;  // less than it said
    check_failed(0, 5, CANOPY_SCAN_LINK);
    bus.max_transfer = UINT16_MAX;
    check_well_again();
}

UNIT(a_bus_that_is_freed_by_clocks) {
    start();
    bus.hung_clocks = 9;
    check_right(0, 5);
    CHECK_EQ(bus.recoveries, 1);
    bus.hung_clocks = 27;  // three times nine
    check_failed(0, 5, CANOPY_SCAN_BUS);
    check_failed(0, 5, CANOPY_SCAN_BUS);
    check_right(0, 5);
    struct canopy_scan_link_counters counters = {.lost_bytes = 1};
    seam.count(seam.context, &counters);
    CHECK_EQ(counters.recoveries, 2);
    CHECK_EQ(counters.lost_bytes, 0);
}

UNIT(a_bus_in_use_is_waited_for_but_not_for_ever) {
    start();
    bus.bytes_a_poll = 1;
    const struct canopy_i2c_transfer other = {.address = 0x29};
    CHECK(port.start(port.context, &other, TIMEOUT_US));
    CHECK(begin(20, 6));
    CHECK_EQ(poll(), CANOPY_SCAN_LINK_PENDING);
    CHECK_EQ(port.poll(port.context), CANOPY_I2C_DONE);
    bus.bytes_a_poll = 0;
    CHECK_EQ(poll(), CANOPY_SCAN_LINK_DONE);
    CHECK(right(20, 6));
    bus.bytes_a_poll = 1;
    CHECK(port.start(port.context, &other, TIMEOUT_US));
    CHECK(begin(20, 6));
    now += TIMEOUT_US - 200;
    CHECK_EQ(poll(), CANOPY_SCAN_LINK_PENDING);
    CHECK_EQ(poll(), CANOPY_SCAN_LINK_FAILED);
    CHECK_EQ(answer.failure, CANOPY_SCAN_BUS);
    CHECK_EQ(port.poll(port.context), CANOPY_I2C_DONE);
    check_well_again();
}

// One read at a time.
UNIT(a_read_under_way_is_not_disturbed) {
    start();
    bus.bytes_a_poll = 3;
    CHECK(begin(40, 8));
    CHECK(!begin(50, 3));
    enum canopy_scan_link_state state;
    while ((state = poll()) == CANOPY_SCAN_LINK_PENDING)
        CHECK(!begin(50, 3));
    CHECK_EQ(state, CANOPY_SCAN_LINK_DONE);
    CHECK(right(40, 8));
}

UNIT(a_refusal_or_a_halt_at_every_byte_is_told_as_what_it_is) {
    start();
    for (uint32_t at = 0; at < WIRE_BYTES; at++) {
        bus.stretch_at = at;
        check_failed(69, ALL, CANOPY_SCAN_TIMEOUT);
        check_well_again();
        bus.lose_at = at;
        check_failed(69, ALL, CANOPY_SCAN_BUS);
        check_well_again();
        bus.nak_at = at;
        if (at <= REQUEST_BYTES)  // addresses and what is written
            check_failed(69, ALL, CANOPY_SCAN_NAK);
        else
            check_right(69, ALL);  // bytes that are read the master acknowledges itself
        check_well_again();
    }
}

// Unless what is missing is what an idle wire says all the same.
UNIT(an_answer_cut_at_every_byte_is_refused) {
    start();
    uint32_t refused = 0;
    for (uint32_t at = 0; at < 2 * ALL + 2; at++) {
        file.falls_silent = at;
        if (read(69, ALL) == CANOPY_SCAN_LINK_DONE) {
            CHECK(right(69, ALL));
        } else {
            CHECK_EQ(answer.failure, CANOPY_SCAN_CRC);
            refused++;
        }
        check_well_again();
    }
    CHECK(refused >= 2 * ALL);
}

UNIT(an_answer_that_lacks_a_byte_is_refused) {
    start();
    for (uint32_t at = 0; at < 2 * ALL; at++) {
        file.skips_at = at;
        check_failed(69, ALL, CANOPY_SCAN_CRC);
        check_well_again();
    }
}

// Requests and answers alike: the device may be asked for something else than was meant.
UNIT(a_turned_bit_anywhere_is_seen) {
    start();
    for (uint32_t bit = 0; bit < 8 * WIRE_BYTES; bit++) {
        bus.flip_at = bit;
        CHECK_EQ(read(69, ALL), CANOPY_SCAN_LINK_FAILED);
        CHECK(answer.failure == CANOPY_SCAN_CRC || answer.failure == CANOPY_SCAN_NAK);
        bus.flip_at = I2C_NEVER;
    }
    check_well_again();
}

UNIT(two_turned_bits_anywhere_are_seen) {
    start();
    const uint32_t bits = 8 * (REQUEST_BYTES + 1 + 2 * 2 + 2);
    for (bus.flip_at = 0; bus.flip_at < bits; bus.flip_at++)
        for (bus.flip_also = bus.flip_at + 1; bus.flip_also < bits; bus.flip_also++)
            CHECK_EQ(read(69, 2), CANOPY_SCAN_LINK_FAILED);
    check_well_again();
}

UNIT(a_stale_answer_is_refused_even_of_the_same_registers) {
    start();
    check_right(69, 20);
    file.deaf = true;  // it answers the request before again, to whatever it is asked
    check_failed(70, 20, CANOPY_SCAN_CRC);
    check_failed(69, 19, CANOPY_SCAN_CRC);
    check_failed(69, 20, CANOPY_SCAN_CRC);
    check_well_again();
    check_right(69, 20);
    file.answers_again = true;
    check_failed(70, 20, CANOPY_SCAN_CRC);
    check_failed(69, 20, CANOPY_SCAN_CRC);
    check_failed(69, 19, CANOPY_SCAN_CRC);
    check_well_again();
}

// A bus that only gives ones or zeros, whatever the length.
UNIT(a_bus_without_a_device_on_its_data_line_is_refused) {
    for (unsigned count = 1; count <= 7; count++) {
        uint8_t plays[16];
        for (unsigned value = 0; value < 256; value += 255) {
            memset(plays, (int)value, sizeof plays);
            start_scripted(&canopy_profile_generic.i2c, plays, sizeof plays);
            check_failed(64, (uint16_t)count, CANOPY_SCAN_CRC);
        }
    }
}

UNIT_LIST(i2c, check_sums_have_their_check_values, the_generic_map_speaks_as_documented, a_table_of_an_smbus_device,
          a_table_with_a_pointer_in_bytes_low_byte_first_and_stop_between, a_table_without_check_sum,
          reads_of_any_length, every_transfer_has_another_tag, a_bus_that_moves_a_byte_at_a_time,
          what_a_bus_or_a_device_cannot_carry_at_once_goes_in_pieces, a_fault_in_any_piece_fails_the_read,
          the_address_is_the_tables_or_another, tables_and_buses_that_cannot_be_are_refused,
          each_outcome_has_its_failure, a_bus_that_is_freed_by_clocks, a_bus_in_use_is_waited_for_but_not_for_ever,
          a_read_under_way_is_not_disturbed, a_refusal_or_a_halt_at_every_byte_is_told_as_what_it_is,
          an_answer_cut_at_every_byte_is_refused, an_answer_that_lacks_a_byte_is_refused, a_turned_bit_anywhere_is_seen,
          two_turned_bits_anywhere_are_seen, a_stale_answer_is_refused_even_of_the_same_registers,
          a_bus_without_a_device_on_its_data_line_is_refused)
