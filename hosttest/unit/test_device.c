// A whole device, in virtual time: the test is the scanner, on a serial line or on I2C, and the PLC on its line.
#include "hosttest/i2c_bus.h"
#include "hosttest/unit/unit.h"
#include "lib/modbus/rtu.h"
#include "lib/plc/map.h"
#include "lib/scan/generic.h"
#include "lib/scan/i2c_link.h"
#include "lib/station/device.h"
#include "lib/station/rtu_link.h"

#define M 5
#define N 4
#define CELLS 2
#define COLUMNS 12
#define PROFILES 9
#define BAUD 115200u
#define SILENCE_US 1750u

// ---- Time and wires

static uint64_t now_us;

static uint64_t tell_time(void *context) {
    (void)context;
    return now_us;
}

// One direction of a line: at most `room` bytes are taken at once, everything that was taken can be read.
struct wire {
    uint8_t bytes[512];
    size_t have, room;
};

struct line {
    struct wire to_device, from_device;
    uint32_t lost;
};

static struct line scanner_line, plc_line;

static size_t take(struct wire *wire, uint8_t *to, size_t length) {
    const size_t count = length < wire->have ? length : wire->have;
    memcpy(to, wire->bytes, count);
    wire->have -= count;
    memmove(wire->bytes, wire->bytes + count, wire->have);
    return count;
}

static size_t put(struct wire *wire, const uint8_t *from, size_t length) {
    const size_t space = sizeof wire->bytes - wire->have, fits = length < space ? length : space;
    const size_t count = fits < wire->room ? fits : wire->room;
    memcpy(wire->bytes + wire->have, from, count);
    wire->have += count;
    return count;
}

static size_t device_read(void *context, uint8_t *to, size_t length) {
    return take(&((struct line *)context)->to_device, to, length);
}

static size_t device_write(void *context, const uint8_t *from, size_t length) {
    return put(&((struct line *)context)->from_device, from, length);
}

static bool device_sent(void *context) { return ((struct line *)context)->from_device.have == 0; }

static uint32_t device_lost(void *context) { return ((struct line *)context)->lost; }

static struct canopy_stream stream_of(struct line *line) {
    line->to_device.have = line->from_device.have = 0;
    line->to_device.room = line->from_device.room = sizeof line->to_device.bytes;
    line->lost = 0;
    return (struct canopy_stream){line, device_read, device_write, device_sent, device_lost};
}

// ---- The scanner: a generic map behind an RTU server or on I2C

static struct {
    struct canopy_modbus_rtu_server server;
    uint16_t sequence;  // of the profile shown, from 1
    bool read_whole;
    bool silent;
    bool refuses;    // whatever is asked
    bool loop;       // begins again after the last profile
    bool stands;     // shows the same profile for ever
    uint32_t magic;  // 0: the right one
    uint32_t spoil;  // replies to spoil, then none
} scanner;

static uint16_t height_of(uint16_t profile, uint16_t column) {
    const bool none = (profile + 2 * column) % 7 == 3;
    return none ? CANOPY_GENERIC_INVALID : (uint16_t)(1000 + 90 * profile + 40 * ((column * 5) % 7));
}

static uint16_t valid_of(uint16_t profile) {
    uint16_t count = 0;
    for (uint16_t i = 0; i < COLUMNS; i++)
        count = (uint16_t)(count + (height_of(profile, i) != CANOPY_GENERIC_INVALID));
    return count;
}

static uint32_t description(uint16_t at) {
    static const uint32_t words[CANOPY_GENERIC_D_COUNT / 2] = {
        CANOPY_GENERIC_MAGIC,
        (1u << 16) | 3u,
        (COLUMNS << 16) | PROFILES,
        (uint32_t)-500,
        100,
        0,
        (1u << 16) | 5u,
        (uint32_t)-500,
        0,
        900,
        700,
        900,
        3000,
        0x3F000000u,  // half a millimetre a unit
    };
    return at < 2 && scanner.magic != 0 ? scanner.magic : words[at / 2];
}

static uint16_t profile_register(uint16_t at) {
    const uint16_t profile = (uint16_t)((scanner.sequence - 1) % PROFILES);
    const uint32_t y = 100u * profile;
    switch (at) {
    case CANOPY_GENERIC_P_SEQUENCE: return scanner.sequence;
    case CANOPY_GENERIC_P_ID: return 3;
    case CANOPY_GENERIC_P_POSITION: return (uint16_t)(y >> 16);
    case CANOPY_GENERIC_P_POSITION + 1: return (uint16_t)y;
    case CANOPY_GENERIC_P_VALID: return valid_of(profile);
    default: break;
    }
    const uint16_t column = (uint16_t)(at - CANOPY_GENERIC_P_COUNT);
    return column < COLUMNS ? height_of(profile, column) : scanner.sequence;
}

static bool scanner_load(void *context, uint16_t address, uint16_t count, uint16_t *to) {
    (void)context;
    const uint16_t end = CANOPY_GENERIC_HEIGHTS + COLUMNS + 1;
    if (address + count > end || scanner.refuses)
        return false;
    const bool more = !scanner.stands && (scanner.loop || scanner.sequence < PROFILES);
    if (address == CANOPY_GENERIC_PROFILE && scanner.read_whole && more) {
        scanner.sequence++;
        scanner.read_whole = false;
    }
    for (uint16_t i = 0; i < count; i++) {
        const uint16_t at = (uint16_t)(address + i);
        to[i] = at < CANOPY_GENERIC_PROFILE ? (uint16_t)(description(at) >> (at % 2 == 0 ? 16 : 0))
                                            : profile_register((uint16_t)(at - CANOPY_GENERIC_PROFILE));
    }
    scanner.read_whole = scanner.read_whole || address + count == end;
    return true;
}

static uint8_t scanner_read(void *context, uint8_t client, uint16_t address, uint16_t count, uint8_t *to) {
    uint16_t registers[CANOPY_SCAN_READ_MAX];
    (void)client;
    if (!scanner_load(context, address, count, registers))
        return CANOPY_MODBUS_ILLEGAL_ADDRESS;
    for (uint16_t i = 0; i < count; i++) {
        to[2 * i] = (uint8_t)(registers[i] >> 8);
        to[2 * i + 1] = (uint8_t)registers[i];
    }
    return 0;
}

static uint8_t scanner_write(void *context, uint8_t client, uint16_t address, uint16_t count, const uint8_t *from,
                             uint8_t function) {
    (void)context, (void)client, (void)address, (void)count, (void)from, (void)function;
    return CANOPY_MODBUS_ILLEGAL_FUNCTION;
}

static const struct canopy_modbus_bank scanner_bank = {.read = scanner_read, .write = scanner_write};

static void run_scanner(void) {
    uint8_t bytes[64], reply[CANOPY_MODBUS_RTU_ADU_MAX];
    size_t count;
    while ((count = take(&scanner_line.from_device, bytes, sizeof bytes)) > 0)
        canopy_modbus_rtu_server_feed(&scanner.server, bytes, count, now_us);
    const uint8_t *at;
    const size_t length = canopy_modbus_rtu_server_poll(&scanner.server, now_us, &at);
    if (length == 0)
        return;
    memcpy(reply, at, length);
    canopy_modbus_rtu_server_sent(&scanner.server, length, now_us);
    if (scanner.spoil > 0) {
        scanner.spoil--;
        reply[length - 1] ^= 1u;
    }
    if (!scanner.silent)
        (void)put(&scanner_line.to_device, reply, length);
}

// ---- The device and its PLC

static CANOPY_ARENA_DECLARE(arena, CANOPY_DEVICE_ARENA(M, N, CELLS, 1, COLUMNS, 1));
static struct canopy_device device;
static struct canopy_rtu_link link;
static struct canopy_modbus_rtu_client plc;
static uint64_t due_us;

static struct canopy_device_config usual(void) {
    return (struct canopy_device_config){
        .clock = {NULL, tell_time},
        .scanner = {.link = canopy_rtu_link(&link), .table = &canopy_profile_generic, .columns = COLUMNS, .unit = 4},
        .plc = {.stream = stream_of(&plc_line), .baud = BAUD, .character_bits = 10, .unit = 9},
        .station = {.grid = {.size = {M, N}, .cells = CELLS, .side = CANOPY_ABOVE},
                    .fit = &canopy_line_fit_fx,
                    .lines = 1,
                    .clients = 1,
                    .unit = 1.0F,
                    .stale_after_us = 3000000,
                    .interval_us = 10000,
                    .refresh_us = 10000},
        .readings = 5,
        .budget = 2,
    };
}

static void start_with(const struct canopy_device_config *config) {
    const struct canopy_modbus_rtu_server_config server = {
        .bank = &scanner_bank, .unit = 4, .character_bits = 10, .baud = BAUD};
    const struct canopy_modbus_rtu_client_config client = {.character_bits = 10, .baud = BAUD, .timeout_us = 50000};
    scanner.sequence = 1;
    scanner.read_whole = scanner.silent = scanner.loop = scanner.stands = scanner.refuses = false;
    scanner.spoil = scanner.magic = 0;
    due_us = 0;
    CHECK_EQ(canopy_modbus_rtu_server_init(&scanner.server, &server), CANOPY_OK);
    CHECK_EQ(canopy_modbus_rtu_client_init(&plc, &client, now_us), CANOPY_OK);
    const struct canopy_rtu_link_config line = {{NULL, tell_time}, stream_of(&scanner_line), BAUD, 20000, 10};
    CHECK_EQ(canopy_rtu_link_init(&link, &line), CANOPY_OK);
    CHECK_EQ(canopy_device_init(&device, config, arena, sizeof arena), CANOPY_OK);
}

static void start(void) {
    now_us = 1000000;
    const struct canopy_device_config config = usual();
    start_with(&config);
}

// The same scanner on a bus of 400 kHz: four bytes in a tick.
static struct i2c_bus bus;
static struct i2c_registers on_bus;
static struct canopy_i2c bus_port;
static struct canopy_i2c_link i2c;

static void start_on_i2c(void) {
    now_us = 1000000;
    i2c_bus_init(&bus);
    bus.bytes_a_poll = 4;
    i2c_registers_init(&on_bus, CANOPY_GENERIC_I2C_ADDRESS, scanner_load, NULL);
    i2c_bus_add(&bus, &on_bus.slave);
    bus_port = i2c_bus_port(&bus);
    CHECK_EQ(canopy_i2c_link_init(&i2c, &bus_port, &canopy_profile_generic, 30000), CANOPY_OK);
    struct canopy_device_config config = usual();
    config.scanner.link = canopy_i2c_link(&i2c);
    config.scanner.unit = 0;
    start_with(&config);
}

// A tick of 100 us for all three; the device sleeps until bytes come or what it asked for is due.
static void tick(void) {
    now_us += 100;
    run_scanner();
    const bool interrupt = scanner_line.to_device.have > 0 || plc_line.to_device.have > 0 || bus.phase != I2C_BUS_IDLE;
    if (due_us <= now_us || interrupt)
        due_us = canopy_device_step(&device);
}

static void run_for(uint32_t us) {
    for (const uint64_t end_us = now_us + us; now_us < end_us;)
        tick();
}

// The PLC reads registers through the line; returns how long it waited.
static uint32_t plc_read(uint16_t address, uint16_t count, uint16_t *to) {
    const struct canopy_modbus_request request = {.unit = 9, .function = 3, .address = address, .count = count};
    CHECK_EQ(canopy_modbus_rtu_client_start(&plc, &request), CANOPY_OK);
    uint64_t sent_us = 0;
    enum canopy_modbus_outcome outcome;
    while ((outcome = canopy_modbus_rtu_client_poll(&plc, now_us)) == CANOPY_MODBUS_PENDING) {
        const uint8_t *bytes;
        uint8_t answer[64];
        size_t length = canopy_modbus_rtu_client_pending(&plc, now_us, &bytes);
        if (length > 0) {
            canopy_modbus_rtu_client_sent(&plc, put(&plc_line.to_device, bytes, length), now_us);
            sent_us = now_us;
        }
        tick();
        while ((length = take(&plc_line.from_device, answer, sizeof answer)) > 0)
            canopy_modbus_rtu_client_feed(&plc, answer, length, now_us);
    }
    CHECK_EQ(outcome, CANOPY_MODBUS_DONE);
    CHECK_EQ(canopy_modbus_rtu_client_registers(&plc, to, count), count);
    return (uint32_t)(now_us - sent_us);
}

static uint32_t all_valid(void) {
    uint32_t count = 0;
    for (uint16_t i = 0; i < PROFILES; i++)
        count += valid_of(i);
    return count;
}

// Where the PLC finds what: protocol addresses of the register map, which never change.
enum { MAGIC = 0, STATUS = 101, SEQUENCE = 120, POINTS = 122, UNIT_F32 = 128, SCAN_ERRORS = 304 };

static uint32_t plc_read32(uint16_t address) {
    uint16_t words[2];
    (void)plc_read(address, 2, words);
    return (uint32_t)words[0] << 16 | words[1];
}

// ---- Tests

UNIT(a_sweep_becomes_an_envelope) {
    start();
    run_for(2000000);
    CHECK_EQ(device.driver.counters.profiles, PROFILES);
    CHECK_EQ(plc_read32(POINTS), all_valid());
    CHECK(plc_read32(SEQUENCE) > 0);
    uint16_t status;
    (void)plc_read(STATUS, 1, &status);
    CHECK_EQ(status, CANOPY_PLC_VALID);
    CHECK_EQ(plc_read32(UNIT_F32), 0x3F000000u);  // the scanner's, not the configured 1
    CHECK_EQ(device.station.rejected, 0);
}

UNIT(the_plc_is_answered_at_its_silence) {
    start();
    uint16_t words[2];
    for (int i = 0; i < 40; i++) {
        const uint32_t waited_us = plc_read(MAGIC, 2, words);
        // 8 bytes of request and 9 of answer on the wire, T3.5 before the answer and after it
        CHECK(waited_us >= SILENCE_US);
        CHECK(waited_us <= 2 * SILENCE_US + 17 * 87 + 1000);
        CHECK_EQ(words[0], 0x434E);
        run_for(7300);
    }
}

UNIT(a_silent_scanner_is_a_fault_and_the_plc_is_answered) {
    start();
    scanner.silent = true;
    run_for(5000000);
    CHECK_EQ(device.station.sensor_faults, 1);
    CHECK(device.driver.counters.failures[CANOPY_SCAN_TIMEOUT] > 0);
    CHECK_EQ(device.driver.counters.failures[CANOPY_SCAN_CRC], 0);
    CHECK_EQ(plc_read32(MAGIC), 0x434E5059u);
    CHECK(plc_read32(SCAN_ERRORS) > 0);
    scanner.silent = false;
    run_for(3000000);
    CHECK_EQ(plc_read32(POINTS), all_valid());
}

UNIT(exceptions_of_the_scanner_are_a_fault) {
    start();
    scanner.refuses = true;
    run_for(2000000);
    CHECK_EQ(device.station.sensor_faults, 1);
    CHECK(device.driver.counters.failures[CANOPY_SCAN_EXCEPTION] > 2);
    CHECK_EQ(device.driver.counters.last_failure, 1 + CANOPY_SCAN_EXCEPTION);
    scanner.refuses = false;
    run_for(1000000);
    CHECK_EQ(plc_read32(POINTS), all_valid());
}

UNIT(a_scanner_that_cannot_be_asked_is_a_fault) {
    now_us = 1000000;
    struct canopy_device_config config = usual();
    config.scanner.unit = 0;  // all devices: nobody answers
    start_with(&config);
    run_for(2000000);
    CHECK_EQ(device.station.sensor_faults, 1);
    CHECK(device.driver.counters.failures[CANOPY_SCAN_LINK] > 2);
    CHECK_EQ(plc_read32(MAGIC), 0x434E5059u);
}

UNIT(spoiled_answers_are_counted_and_read_again) {
    start();
    scanner.spoil = 3;
    run_for(3000000);
    CHECK_EQ(device.driver.counters.failures[CANOPY_SCAN_CRC], 3);
    CHECK_EQ(plc_read32(POINTS), all_valid());
}

UNIT(a_line_that_takes_a_byte_at_a_time_is_enough) {
    start();
    scanner_line.from_device.room = plc_line.from_device.room = 1;
    run_for(4000000);
    CHECK_EQ(plc_read32(POINTS), all_valid());
}

UNIT(lost_bytes_are_shown) {
    start();
    plc_line.lost = 17;
    scanner_line.lost = 5;
    run_for(10000);
    CHECK_EQ(device.station.port.lost_bytes, 17);
    CHECK_EQ(device.station.port.scan.lost_bytes, 5);
    CHECK_EQ(device.station.port.scan.recoveries, 0);
}

// ---- The scanner on I2C

static uint16_t plc_status(void) {
    uint16_t status;
    (void)plc_read(STATUS, 1, &status);
    return status;
}

// Every reading of the sweep, with its uncertainty, is under what is published.
static void check_envelope(void) {
    const struct canopy_envelope *envelope = canopy_plc_published(&device.station.plc);
    CHECK(envelope != NULL);
    const struct canopy_frame *frame = &envelope->frame;
    CHECK(frame->lsb_log2 <= 0);
    for (uint16_t p = 0; p < PROFILES; p++)
        for (uint16_t c = 0; c < COLUMNS; c++) {
            const int32_t x = -500 + 100 * c - frame->origin[0], y = 100 * p - frame->origin[1];
            const int64_t z = (int64_t)height_of(p, c) + 5 - frame->origin[2];
            int32_t low, high;
            if (height_of(p, c) == CANOPY_GENERIC_INVALID)
                continue;
            CHECK_EQ(canopy_envelope_height(envelope, (uint32_t)x, (uint32_t)y, &low, &high), CANOPY_OK);
            CHECK(z * (INT64_C(1) << -frame->lsb_log2) <= high);
        }
}

UNIT(a_sweep_over_i2c_becomes_an_envelope) {
    start_on_i2c();
    run_for(900000);  // within the stale limit of the scanner, which does not begin again
    CHECK_EQ(plc_read32(POINTS), all_valid());
    CHECK_EQ(plc_status(), CANOPY_PLC_VALID);
    CHECK_EQ(plc_read32(SCAN_ERRORS), 0);
    CHECK_EQ(device.station.sensor_faults, 0);
    check_envelope();
}

UNIT(nobody_on_the_bus_is_a_fault) {
    start_on_i2c();
    scanner.loop = true;
    on_bus.slave.address = 0x30;
    run_for(3000000);
    CHECK_EQ(device.station.sensor_faults, 1);
    CHECK(device.driver.counters.failures[CANOPY_SCAN_NAK] > 0);
    CHECK_EQ(plc_read32(SEQUENCE), 0);
    on_bus.slave.address = CANOPY_GENERIC_I2C_ADDRESS;
    run_for(3000000);
    CHECK_EQ(device.station.sensor_faults, 0);
    CHECK(plc_read32(POINTS) >= all_valid());
    check_envelope();
}

UNIT(a_held_bus_is_a_fault_until_it_is_free_and_recoveries_are_shown) {
    start_on_i2c();
    scanner.loop = true;
    bus.held = true;
    run_for(3000000);
    CHECK_EQ(device.station.sensor_faults, 1);
    CHECK(device.driver.counters.failures[CANOPY_SCAN_BUS] > 0);
    CHECK(plc_read32(SCAN_ERRORS) > 0);
    CHECK_EQ(device.station.port.scan.recoveries, 0);
    i2c_bus_be_well(&bus);
    bus.hung_clocks = 4;
    run_for(3000000);
    CHECK_EQ(device.station.port.scan.recoveries, 1);
    CHECK_EQ(device.station.sensor_faults, 0);
    CHECK(plc_read32(POINTS) >= all_valid());
    check_envelope();
}

UNIT(another_device_at_the_address_is_refused) {
    start_on_i2c();
    scanner.magic = 0x12345678;
    run_for(3000000);
    CHECK_EQ(device.station.sensor_faults, 1);
    CHECK(device.driver.counters.refused > 0);
    CHECK_EQ(plc_read32(SEQUENCE), 0);
    CHECK_EQ(plc_status() & CANOPY_PLC_VALID, 0);
}

UNIT(a_scanner_that_repeats_its_profile_becomes_stale) {
    start_on_i2c();
    run_for(500000);
    CHECK_EQ(plc_status(), CANOPY_PLC_VALID);
    scanner.stands = true;
    run_for(5000000);
    CHECK_EQ(device.station.sensor_faults, 1);
    CHECK(device.driver.counters.stale > 0);
    CHECK_EQ(plc_status() & (CANOPY_PLC_VALID | CANOPY_PLC_STALE), CANOPY_PLC_STALE);
    check_envelope();  // it is readable, and says what it is worth
}

// A fault of random kind and place in every other transfer, for as long as it takes to see everything three times.
UNIT(the_envelope_is_right_over_a_bad_bus) {
    start_on_i2c();
    scanner.loop = true;
    uint32_t random = 1;
    for (int i = 0; i < 4000 || device.station.points < 3 * all_valid(); i++) {
        CHECK(i < 100000);
        random = random * 1664525u + 1013904223u;
        const uint32_t at = (random >> 8) % 70;
        i2c_bus_be_well(&bus);
        switch (random >> 29) {
        case 0: bus.flip_at = (random >> 8) % (8 * 70); break;
        case 1: bus.nak_at = at % 6; break;
        case 2: bus.stretch_at = at; break;
        case 3: bus.hung_clocks = (uint16_t)(at % 20); break;
        default: break;
        }
        run_for(1000);
        CHECK_EQ(device.station.rejected, 0);
        CHECK(device.station.field.frame.size[0] == 0 || device.station.points <= device.driver.counters.readings);
    }
    i2c_bus_be_well(&bus);
    run_for(1000000);
    CHECK(device.driver.counters.failures[CANOPY_SCAN_CRC] > 20);
    CHECK(device.driver.counters.failures[CANOPY_SCAN_NAK] > 20);
    CHECK(device.driver.counters.failures[CANOPY_SCAN_TIMEOUT] > 20);
    CHECK_EQ(plc_status(), CANOPY_PLC_VALID);
    CHECK_EQ(device.station.sensor_faults, 0);
    check_envelope();
}

// ---- Configurations

UNIT(a_scanner_without_scene_gets_the_configured_frame) {
    struct canopy_device_config config = usual();
    struct canopy_frame frame;
    const int32_t low[3] = {0, 0, 0}, high[3] = {1000, 1000, 1000};
    CHECK_EQ(canopy_frame_around_fx(&frame, &config.station.grid, low, high), CANOPY_OK);
    config.frame = &frame;
    start_with(&config);
    CHECK_EQ(device.station.stage, CANOPY_STATION_RESTING);
    CHECK_EQ(device.station.field.frame.pitch[0], frame.pitch[0]);
}

UNIT(bad_configurations_are_refused) {
    struct canopy_device_config config = usual();
    CHECK_EQ(canopy_device_init(&device, &config, arena, sizeof arena - 8), CANOPY_ARENA_SHORT);
    CHECK_EQ(canopy_device_init(&device, &config, (uint8_t *)arena + 4, sizeof arena - 4), CANOPY_ARENA_ALIGN);
    config.budget = 0;
    CHECK_EQ(canopy_device_init(&device, &config, arena, sizeof arena), CANOPY_ARGUMENT);
    config = usual();
    config.readings = 0;
    CHECK_EQ(canopy_device_init(&device, &config, arena, sizeof arena), CANOPY_ARGUMENT);
    config = usual();
    config.station.clients = 2;
    CHECK_EQ(canopy_device_init(&device, &config, arena, sizeof arena), CANOPY_ARGUMENT);
    config = usual();
    config.plc.unit = 0;
    CHECK_EQ(canopy_device_init(&device, &config, arena, sizeof arena), CANOPY_ARGUMENT);
    config = usual();
    struct canopy_profile_table silent = *config.scanner.table;
    for (int a = 0; a < 3; a++)
        silent.low[a].where = silent.high[a].where = CANOPY_SCAN_ABSENT;
    config.scanner.table = &silent;
    CHECK_EQ(canopy_device_init(&device, &config, arena, sizeof arena), CANOPY_ARGUMENT);  // where would its scene be?
}

UNIT_LIST(device, a_sweep_becomes_an_envelope, the_plc_is_answered_at_its_silence,
          a_silent_scanner_is_a_fault_and_the_plc_is_answered, exceptions_of_the_scanner_are_a_fault,
          a_scanner_that_cannot_be_asked_is_a_fault, spoiled_answers_are_counted_and_read_again,
          a_line_that_takes_a_byte_at_a_time_is_enough, lost_bytes_are_shown, a_sweep_over_i2c_becomes_an_envelope,
          nobody_on_the_bus_is_a_fault, a_held_bus_is_a_fault_until_it_is_free_and_recoveries_are_shown,
          another_device_at_the_address_is_refused, a_scanner_that_repeats_its_profile_becomes_stale,
          the_envelope_is_right_over_a_bad_bus, a_scanner_without_scene_gets_the_configured_frame,
          bad_configurations_are_refused)
