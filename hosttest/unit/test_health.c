// What stands behind the registers of health and settings: through the registers, on a flash and a memory of the test.
#include "canopy_registers.h"
#include "hosttest/unit/unit.h"
#include "lib/num/crc32.h"
#include "lib/station/health.h"

enum { PAGE_BYTES = 256, RAM_WORDS = 64, FLASH_WORDS = 40, M = 4, N = 4 };

static CANOPY_ARENA_DECLARE(arena, CANOPY_SELFTEST_ARENA);
static CANOPY_ARENA_DECLARE(plc_arena, CANOPY_PLC_ARENA(M, N, 1));
static uint8_t pages[2][PAGE_BYTES];
static uint32_t ram[RAM_WORDS], program[FLASH_WORDS + 1];
static struct canopy_health health;
static struct canopy_health_kept kept;
static struct canopy_plc plc;
static struct canopy_settings settings;
static struct canopy_station_port port;
static struct canopy_profile_counters scan;
static uint32_t resets, operations;
static uint64_t now_us;

// ---- Flash and memory

static enum canopy_status read(void *context, uint32_t page, uint32_t offset, uint8_t *to, uint32_t length) {
    (void)context;
    memcpy(to, &pages[page][offset], length);
    return CANOPY_OK;
}

static enum canopy_status read_none(void *context, uint32_t page, uint32_t offset, uint8_t *to, uint32_t length) {
    (void)context, (void)page, (void)offset, (void)to, (void)length;
    return CANOPY_RANGE;
}

static enum canopy_status erase(void *context, uint32_t page) {
    (void)context;
    operations++;
    memset(pages[page], 0xFF, PAGE_BYTES);
    return CANOPY_OK;
}

static enum canopy_status program_flash(void *context, uint32_t page, uint32_t offset, const uint8_t *from,
                                        uint32_t length) {
    (void)context;
    operations++;
    for (uint32_t i = 0; i < length; i++)
        pages[page][offset + i] &= from[i];
    return CANOPY_OK;
}

static const struct canopy_flash flash = {.page_bytes = PAGE_BYTES,
                                          .program_bytes = 4,
                                          .page_count = 2,
                                          .read = read,
                                          .erase = erase,
                                          .program = program_flash};
static const struct canopy_flash no_flash = {.read = read};

static uint32_t mask(void) { return 0; }
static void restore(uint32_t was) { (void)was; }

static const struct canopy_memory memory = {.ram = ram,
                                            .ram_end = ram + RAM_WORDS,
                                            .stack = ram,
                                            .stack_end = ram + RAM_WORDS / 2,
                                            .flash = (const uint8_t *)program,
                                            .flash_end = program + FLASH_WORDS,
                                            .mask = mask,
                                            .restore = restore};

static void count_reset(void) { resets++; }

static void own_defaults(struct canopy_settings *to) {
    canopy_settings_defaults(to);
    to->plc_unit = 9;
}

// ---- Registers

static void live(void *context, struct canopy_plc_live *to) {
    (void)context;
    to->status = CANOPY_PLC_VALID;
}
static void counters(void *context, struct canopy_plc_counters *to) { (void)context, (void)to; }
static enum canopy_plc_query_status height(void *context, const struct canopy_envelope *envelope, int32_t x, int32_t y,
                                           int32_t *to) {
    (void)context, (void)envelope, (void)x, (void)y;
    *to = 0;
    return CANOPY_PLC_QUERY_GOOD;
}
static enum canopy_plc_result command(void *context, enum canopy_plc_command_code code) {
    (void)context, (void)code;
    return CANOPY_PLC_RESULT_REFUSED;
}

static uint32_t ask(uint16_t address, uint16_t words) {
    uint8_t bytes[4];
    CHECK_EQ(canopy_plc_read(&plc, 0, address, words, bytes), 0);
    const uint32_t high = (uint32_t)bytes[0] << 8 | bytes[1];
    return words == 1 ? high : high << 16 | (uint32_t)bytes[2] << 8 | bytes[3];
}

static uint8_t tell(uint16_t address, uint16_t words, uint32_t value) {
    const uint8_t bytes[4] = {(uint8_t)(value >> 24), (uint8_t)(value >> 16), (uint8_t)(value >> 8), (uint8_t)value};
    return canopy_plc_write(&plc, 0, address, words, words == 2 ? bytes : bytes + 2, 16);
}

#define ASK(name, words) ask(CANOPY_REGISTER_##name, words)
#define ORDER(code) (tell(CANOPY_REGISTER_COMMAND, 1, CANOPY_PLC_COMMAND_##code), ASK(COMMAND_RESULT, 1))

// ---- The device

static void make_program(void) {
    for (uint32_t i = 0; i < FLASH_WORDS; i++)
        program[i] = i * 40503U;
    program[FLASH_WORDS] = canopy_crc32(0, program, 4 * FLASH_WORDS);
}

static void power_on(void) {
    memset(&kept, 0x5A, sizeof kept);
    memset(pages, 0xFF, sizeof pages);
    make_program();
    resets = 0;
    now_us = 0;
}

static void start_with(const struct canopy_flash *from, const struct canopy_crash *crash,
                       const struct canopy_selftest_known *known, uint32_t fixed) {
    const struct canopy_health_config config = {.memory = &memory,
                                                .flash = from,
                                                .kept = &kept,
                                                .defaults = own_defaults,
                                                .fixed = fixed,
                                                .reset = count_reset};
    const struct canopy_plc_config shown = {.size = {M, N},
                                            .clients = 1,
                                            .scalar = CANOPY_FX,
                                            .unit = 1,
                                            .source = {NULL, live, counters, height, command}};
    memset(&health, 0xA5, sizeof health);
    memset(arena, 0xA5, sizeof arena);
    canopy_health_open(&health, &config, &settings, (uint8_t *)arena);
    canopy_health_test(&health, crash, known, arena, sizeof arena);
    CHECK_EQ(canopy_plc_init(&plc, &shown, plc_arena, sizeof plc_arena), CANOPY_OK);
    canopy_health_attach(&health, &plc, &port, &scan);
}

static void start(void) { start_with(&flash, NULL, &canopy_selftest_fx, 0); }

static void run(uint32_t steps) {
    for (; steps > 0; steps--)
        canopy_health_step(&health, now_us += CANOPY_HEALTH_PERIOD_US, true);
}

static enum canopy_status publish(void) {
    struct canopy_envelope *next = canopy_plc_begin(&plc);
    memset(next->coefficients, 0, 4 * M * N);
    memset(next->coverage, 0xFF, CANOPY_COVERAGE_BYTES(M, N));
    next->frame = (struct canopy_frame){.pitch = {4, 4}, .size = {M, N}, .cells = 4};
    next->margin = 0;
    next->points = 1;
    return canopy_plc_commit(&plc);
}

// ---- Settings

UNIT(what_is_stored_is_in_force_at_the_next_start) {
    power_on();
    start();
    CHECK_EQ(settings.plc_unit, 9);
    CHECK_EQ(settings.plc_baud, 115200);
    CHECK_EQ(ASK(SETTINGS_STATE, 1), CANOPY_PLC_SETTINGS_NONE);
    CHECK_EQ(ASK(SET_PLC_UNIT, 1), 9);
    CHECK_EQ(tell(CANOPY_REGISTER_SET_PLC_UNIT, 1, 33), 0);
    CHECK_EQ(tell(CANOPY_REGISTER_SET_PLC_BAUD, 2, 19200), 0);
    CHECK_EQ(ASK(SETTINGS_STORED, 1), CANOPY_PLC_STORE_NONE);
    CHECK_EQ(ORDER(STORE), CANOPY_PLC_RESULT_DONE);
    CHECK_EQ(ASK(SETTINGS_STORED, 1), CANOPY_PLC_STORE_UNDER_WAY);
    CHECK_EQ(ORDER(STORE), CANOPY_PLC_RESULT_REFUSED);
    CHECK_EQ(ORDER(DEFAULTS), CANOPY_PLC_RESULT_REFUSED);
    for (uint32_t done = 1; ASK(SETTINGS_STORED, 1) == CANOPY_PLC_STORE_UNDER_WAY; done++) {
        const uint32_t before = operations;
        canopy_health_step(&health, now_us, false);  // not while an answer is on its way
        CHECK_EQ(operations, before);
        canopy_health_step(&health, now_us, true);
        CHECK(operations <= before + 1);
        CHECK(done < 10);
    }
    CHECK_EQ(ASK(SETTINGS_STORED, 1), CANOPY_PLC_STORE_DONE);
    CHECK_EQ(ASK(SETTINGS_GENERATION, 2), 1);
    CHECK_EQ(ASK(SETTINGS_STATE, 1), CANOPY_PLC_SETTINGS_NONE);  // as it started
    start();
    CHECK_EQ(settings.plc_unit, 33);
    CHECK_EQ(settings.plc_baud, 19200);
    CHECK_EQ(settings.stale_after_ms, 5000);
    CHECK_EQ(ASK(SET_PLC_BAUD, 2), 19200);
    CHECK_EQ(ASK(SETTINGS_STATE, 1), CANOPY_PLC_SETTINGS_STORED);
    CHECK_EQ(ASK(SETTINGS_GENERATION, 2), 1);
    CHECK_EQ(ASK(SETTINGS_STORED, 1), CANOPY_PLC_STORE_NONE);
}

static void store_unit(uint16_t unit) {
    CHECK_EQ(tell(CANOPY_REGISTER_SET_PLC_UNIT, 1, unit), 0);
    CHECK_EQ(ORDER(STORE), CANOPY_PLC_RESULT_DONE);
    run(10);
    CHECK_EQ(ASK(SETTINGS_STORED, 1), CANOPY_PLC_STORE_DONE);
}

UNIT(defaults_are_restored) {
    power_on();
    start();
    store_unit(33);
    start();
    CHECK_EQ(settings.plc_unit, 33);
    CHECK_EQ(ORDER(DEFAULTS), CANOPY_PLC_RESULT_DONE);
    CHECK_EQ(ASK(SET_PLC_UNIT, 1), 9);
    run(10);
    CHECK_EQ(ASK(SETTINGS_STORED, 1), CANOPY_PLC_STORE_DONE);
    start();
    CHECK_EQ(settings.plc_unit, 9);
    CHECK_EQ(ASK(SETTINGS_STATE, 1), CANOPY_PLC_SETTINGS_STORED);
    CHECK_EQ(ASK(SETTINGS_GENERATION, 2), 2);
}

UNIT(damage_is_shown) {
    power_on();
    start();
    store_unit(33);
    pages[1][20] ^= 4;
    start();
    CHECK_EQ(settings.plc_unit, 33);
    CHECK_EQ(ASK(SETTINGS_STATE, 1), CANOPY_PLC_SETTINGS_MENDED);
    store_unit(34);
    start();
    CHECK_EQ(ASK(SETTINGS_STATE, 1), CANOPY_PLC_SETTINGS_STORED);
    pages[0][30] ^= 1;
    pages[1][2] ^= 0x80;
    start();
    CHECK_EQ(settings.plc_unit, 9);
    CHECK_EQ(ASK(SET_PLC_UNIT, 1), 9);
    CHECK_EQ(ASK(SETTINGS_STATE, 1), CANOPY_PLC_SETTINGS_CORRUPT);
    CHECK_EQ(ASK(SETTINGS_GENERATION, 2), 0);
}

UNIT(without_a_memory_nothing_is_stored_and_all_else_works) {
    power_on();
    start_with(&no_flash, NULL, &canopy_selftest_fx, 0);
    CHECK_EQ(ASK(SETTINGS_STATE, 1), CANOPY_PLC_SETTINGS_NOWHERE);
    CHECK_EQ(tell(CANOPY_REGISTER_SET_PLC_UNIT, 1, 33), 0);
    CHECK_EQ(ORDER(STORE), CANOPY_PLC_RESULT_REFUSED);
    CHECK_EQ(ORDER(DEFAULTS), CANOPY_PLC_RESULT_REFUSED);
    CHECK_EQ(ASK(SET_PLC_UNIT, 1), 33);
    CHECK_EQ(ASK(SETTINGS_STORED, 1), CANOPY_PLC_STORE_NONE);
}

// Stores a record as a firmware of another version would.
static void store_as(uint16_t version, const uint8_t *payload, uint16_t length) {
    uint8_t scratch[CANOPY_STORE_OPEN_SCRATCH];
    struct canopy_store store;
    power_on();
    (void)canopy_store_open(&store, &flash, scratch);
    CHECK(canopy_store_begin(&store));
    while (canopy_store_is_writing(&store))
        CHECK(canopy_store_step(&store, version, payload, length, scratch) <= CANOPY_MORE);
}

UNIT(records_of_other_versions) {
    uint8_t payload[CANOPY_SETTINGS_BYTES + 2] = {0};
    struct canopy_settings mine;
    canopy_settings_defaults(&mine);
    mine.plc_unit = 44;
    mine.watchdog_ms = 3000;
    canopy_settings_encode(&mine, payload);
    // older: it had fewer settings, down to none, and they end with a setting
    for (uint16_t length = 0; length <= CANOPY_SETTINGS_BYTES; length += 2) {
        store_as(CANOPY_SETTINGS_VERSION, payload, length);
        start();
        const bool whole = length <= 4 || length == CANOPY_SETTINGS_BYTES || settings.plc_unit == 44;
        CHECK_EQ(settings.plc_unit, length > 0 && whole ? 44 : 9);
        CHECK_EQ(settings.watchdog_ms, length == CANOPY_SETTINGS_BYTES ? 3000 : 2000);
        CHECK_EQ(ASK(SETTINGS_STATE, 1), whole ? CANOPY_PLC_SETTINGS_STORED : CANOPY_PLC_SETTINGS_REFUSED);
    }
    // in the middle of a setting, longer, newer, out of range
    store_as(CANOPY_SETTINGS_VERSION, payload, 6);
    start();
    CHECK_EQ(ASK(SETTINGS_STATE, 1), CANOPY_PLC_SETTINGS_REFUSED);
    store_as(CANOPY_SETTINGS_VERSION, payload, CANOPY_SETTINGS_BYTES + 2);
    start();
    CHECK_EQ(ASK(SETTINGS_STATE, 1), CANOPY_PLC_SETTINGS_REFUSED);
    store_as(CANOPY_SETTINGS_VERSION + 1, payload, CANOPY_SETTINGS_BYTES);
    start();
    CHECK_EQ(ASK(SETTINGS_STATE, 1), CANOPY_PLC_SETTINGS_REFUSED);
    CHECK_EQ(settings.plc_unit, 9);
    payload[1] = 248;
    store_as(CANOPY_SETTINGS_VERSION, payload, CANOPY_SETTINGS_BYTES);
    start();
    CHECK_EQ(ASK(SETTINGS_STATE, 1), CANOPY_PLC_SETTINGS_REFUSED);
    CHECK_EQ(settings.plc_unit, 9);
    CHECK_EQ(settings.watchdog_ms, 2000);
}

UNIT(a_setting_that_a_device_has_not_is_no_other) {
    uint8_t payload[CANOPY_SETTINGS_BYTES];
    struct canopy_settings mine;
    own_defaults(&mine);
    mine.side = 1;
    canopy_settings_encode(&mine, payload);
    store_as(CANOPY_SETTINGS_VERSION, payload, sizeof payload);
    start();
    CHECK_EQ(settings.side, 1);
    start_with(&flash, NULL, &canopy_selftest_fx, 1U << CANOPY_SETTING_SIDE);
    CHECK_EQ(settings.side, 0);
    CHECK_EQ(ASK(SETTINGS_STATE, 1), CANOPY_PLC_SETTINGS_REFUSED);
    CHECK_EQ(tell(CANOPY_REGISTER_SET_SIDE, 1, 1), CANOPY_MODBUS_ILLEGAL_VALUE);
}

// ---- Starts

UNIT(why_it_started) {
    struct canopy_crash crash = {.kind = CANOPY_CRASH_BUS, .pc = 0x1234, .count = 1};
    power_on();
    start();
    CHECK_EQ(ASK(RESET_REASON, 1), CANOPY_PLC_RESET_POWER);
    CHECK_EQ(ASK(STARTS, 2), 1);
    CHECK_EQ(ASK(CRASH_COUNT, 2), 0);
    start();
    CHECK_EQ(ASK(RESET_REASON, 1), CANOPY_PLC_RESET_OTHER);
    start_with(&flash, &crash, &canopy_selftest_fx, 0);
    CHECK_EQ(ASK(RESET_REASON, 1), CANOPY_PLC_RESET_CRASH);
    CHECK_EQ(ASK(CRASH_PC, 2), 0x1234);
    CHECK_EQ(ASK(CRASH_KIND, 2), CANOPY_CRASH_BUS);
    CHECK_EQ(ASK(CRASH_COUNT, 2), 1);
    start_with(&flash, &crash, &canopy_selftest_fx, 0);  // the same crash, still known
    CHECK_EQ(ASK(RESET_REASON, 1), CANOPY_PLC_RESET_OTHER);
    CHECK_EQ(ASK(CRASH_PC, 2), 0x1234);
    crash.kind = CANOPY_CRASH_WATCHDOG;
    crash.count = 2;
    start_with(&flash, &crash, &canopy_selftest_fx, 0);
    CHECK_EQ(ASK(RESET_REASON, 1), CANOPY_PLC_RESET_WATCHDOG);
    CHECK_EQ(ASK(STARTS, 2), 5);
    power_on();
    start_with(&flash, &crash, &canopy_selftest_fx, 0);
    CHECK_EQ(ASK(RESET_REASON, 1), CANOPY_PLC_RESET_POWER);
    CHECK_EQ(ASK(STARTS, 2), 1);
}

UNIT(a_reset_waits_for_the_answer_and_for_what_is_stored) {
    power_on();
    start();
    CHECK_EQ(tell(CANOPY_REGISTER_SET_PLC_UNIT, 1, 33), 0);
    CHECK_EQ(ORDER(STORE), CANOPY_PLC_RESULT_DONE);
    CHECK_EQ(ORDER(RESET), CANOPY_PLC_RESULT_DONE);
    for (uint32_t step = 0; step < 20; step++)
        canopy_health_step(&health, now_us, false);
    CHECK_EQ(resets, 0);
    while (resets == 0) {
        const bool stored = ASK(SETTINGS_STORED, 1) == CANOPY_PLC_STORE_DONE;
        canopy_health_step(&health, now_us, true);
        CHECK(resets == 0 || stored);
    }
    start();
    CHECK_EQ(ASK(RESET_REASON, 1), CANOPY_PLC_RESET_COMMAND);
    CHECK_EQ(settings.plc_unit, 33);
    start();
    CHECK_EQ(ASK(RESET_REASON, 1), CANOPY_PLC_RESET_OTHER);
}

// ---- Self-tests

UNIT(tests_pass_in_the_background) {
    power_on();
    start();
    CHECK_EQ(ASK(SELFTESTS, 1), 7);
    CHECK_EQ(ASK(SELFTESTS_PASSED, 1), CANOPY_PLC_SELFTEST_CERTIFICATE);
    CHECK_EQ(publish(), CANOPY_OK);
    run(3);
    CHECK_EQ(ASK(SELFTESTS_PASSED, 1), CANOPY_PLC_SELFTEST_CERTIFICATE | CANOPY_PLC_SELFTEST_FLASH);
    CHECK_EQ(ASK(FLASH_CRC, 2), program[FLASH_WORDS]);
    for (uint32_t step = 0; step < 100; step++)
        canopy_health_step(&health, now_us + step, true);  // not before its time
    CHECK_EQ(ASK(FLASH_PASSES, 2), 1);
    run(RAM_WORDS / 4);
    CHECK_EQ(ASK(SELFTESTS_PASSED, 1), 7);
    CHECK_EQ(ASK(SELFTESTS_FAILED, 1), 0);
    CHECK(ASK(RAM_PASSES, 2) >= 1);
    CHECK_EQ(ASK(STATUS, 1), CANOPY_PLC_VALID);
}

// Nothing is published any more, and what was is withdrawn.
static void check_barred(void) {
    CHECK_EQ(ASK(STATUS, 1), 0);
    CHECK_EQ(ASK(SEQUENCE, 2), 0);
    CHECK_EQ(publish(), CANOPY_NOT_SAFE);
    CHECK_EQ(ASK(STATUS, 1), 0);
    CHECK_EQ(ask(CANOPY_REGISTER_BLOCK_0 + 2, 2), INT32_MAX);
    CHECK_EQ(tell(CANOPY_REGISTER_QUERY_X, 2, 1), 0);
    CHECK_EQ(ASK(QUERY_STATUS, 1), CANOPY_PLC_QUERY_NONE);
    run(200);
    CHECK_EQ(publish(), CANOPY_NOT_SAFE);
}

UNIT(a_program_that_changes_withdraws_the_envelope) {
    power_on();
    start();
    CHECK_EQ(publish(), CANOPY_OK);
    run(50);
    CHECK_EQ(ASK(STATUS, 1), CANOPY_PLC_VALID);
    program[17] ^= 0x100;
    run(6);
    CHECK_EQ(ASK(SELFTESTS_FAILED, 1), CANOPY_PLC_SELFTEST_FLASH);
    CHECK_EQ(ASK(SELFTESTS_PASSED, 1) & CANOPY_PLC_SELFTEST_FLASH, 0);
    CHECK(ASK(FLASH_CRC, 2) != program[FLASH_WORDS]);
    check_barred();
    program[17] ^= 0x100;
    check_barred();
    start();  // a reset is no remedy, and the test has not come by again
    CHECK_EQ(ASK(SELFTESTS_FAILED, 1), CANOPY_PLC_SELFTEST_FLASH);
    run(1);
    check_barred();
    power_on();
    start();
    CHECK_EQ(ASK(SELFTESTS_FAILED, 1), 0);
    CHECK_EQ(publish(), CANOPY_OK);
    run(10);
    CHECK_EQ(ASK(STATUS, 1), CANOPY_PLC_VALID);
}

UNIT(ram_that_fails_withdraws_the_envelope) {
    power_on();
    start();
    CHECK_EQ(publish(), CANOPY_OK);
    run(5);
    health.selftest.ram_failed = true;  // what sets it: test_march.c
    run(1);
    CHECK_EQ(ASK(SELFTESTS_FAILED, 1), CANOPY_PLC_SELFTEST_RAM);
    check_barred();
    start();
    run(1);
    check_barred();
}

UNIT(a_wrong_certificate_at_start_publishes_nothing) {
    struct canopy_selftest_known wrong = canopy_selftest_fx;
    wrong.crc ^= 1;
    power_on();
    start_with(&flash, NULL, &wrong, 0);
    CHECK_EQ(ASK(SELFTESTS_FAILED, 1), CANOPY_PLC_SELFTEST_CERTIFICATE);
    run(1);
    check_barred();
}

// The defaults could be the other side: whoever had settings gets nothing that was made with others.
UNIT(settings_that_are_lost_publish_nothing_until_they_are_stored_again) {
    static const uint8_t newer[2] = {0, 44};
    const struct canopy_flash blind = {
        .page_bytes = PAGE_BYTES, .program_bytes = 4, .page_count = 2, .read = read_none};
    for (int how = 0; how < 3; how++) {
        power_on();
        if (how == 1) {
            store_as(CANOPY_SETTINGS_VERSION + 1, newer, sizeof newer);
        } else {
            start();
            store_unit(33);
            pages[0][20] ^= how == 0 ? 1 : 0;
            pages[1][20] ^= how == 0 ? 1 : 0;
        }
        start_with(how == 2 ? &blind : &flash, NULL, &canopy_selftest_fx, 0);
        CHECK_EQ(ASK(SETTINGS_STATE, 1), how == 0   ? CANOPY_PLC_SETTINGS_CORRUPT
                                         : how == 1 ? CANOPY_PLC_SETTINGS_REFUSED
                                                    : CANOPY_PLC_SETTINGS_NOWHERE);
        run(1);
        CHECK_EQ(ASK(SELFTESTS_FAILED, 1), 0);
        check_barred();
        if (how == 2)
            continue;
        store_unit(34);
        check_barred();
        start();
        CHECK_EQ(publish(), CANOPY_OK);
        run(10);
        CHECK_EQ(ASK(STATUS, 1), CANOPY_PLC_VALID);
    }
    // a device that never had settings, or has no memory for them, works with its defaults
    for (int has = 0; has < 2; has++) {
        power_on();
        start_with(has != 0 ? &flash : &no_flash, NULL, &canopy_selftest_fx, 0);
        CHECK_EQ(publish(), CANOPY_OK);
        run(10);
        CHECK_EQ(ASK(STATUS, 1), CANOPY_PLC_VALID);
    }
}

UNIT(wires_are_shown) {
    power_on();
    start();
    port.scan.recoveries = 70001;
    port.scan.lost_bytes = 70002;
    scan.last_failure = 1 + CANOPY_SCAN_NAK;
    CHECK_EQ(ASK(I2C_RECOVERIES, 2), 70001);
    CHECK_EQ(ASK(SCANNER_LOST_BYTES, 2), 70002);
    CHECK_EQ(ASK(SCANNER_FAILURE, 1), 1 + CANOPY_SCAN_NAK);
}

UNIT(unused_stack_is_what_keeps_the_pattern) {
    power_on();
    start();
    // The stack of this memory is the lower half of `ram`; the host's or the board's own is elsewhere.
    memset(ram, 0xC5, sizeof ram);
    ram[11] = 0;
    CHECK_EQ(ASK(STACK_UNUSED, 1), 44);
    ram[0] = 1;
    CHECK_EQ(ASK(STACK_UNUSED, 1), 0);
    memset(ram, 0xC5, sizeof ram);
    CHECK_EQ(ASK(STACK_UNUSED, 1), RAM_WORDS / 2 * 4);
}

UNIT_LIST(health, what_is_stored_is_in_force_at_the_next_start, defaults_are_restored, damage_is_shown,
          without_a_memory_nothing_is_stored_and_all_else_works, records_of_other_versions,
          a_setting_that_a_device_has_not_is_no_other, why_it_started,
          a_reset_waits_for_the_answer_and_for_what_is_stored, tests_pass_in_the_background,
          a_program_that_changes_withdraws_the_envelope, ram_that_fails_withdraws_the_envelope,
          a_wrong_certificate_at_start_publishes_nothing,
          settings_that_are_lost_publish_nothing_until_they_are_stored_again, wires_are_shown,
          unused_stack_is_what_keeps_the_pattern)
