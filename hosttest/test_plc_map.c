// The generated registers.json is what the C code serves: every register by name, every address, every length; and
// a write changes what it says or nothing at all.
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>
#include <jansson.h>

#include "canopy_registers.h"
#include "lib/plc/plc.h"
#include "lib/version.h"

enum { M = 20, N = 19, CLIENTS = 3, ADDRESSES = 65536 };

static struct canopy_plc plc;
static CANOPY_ARENA_DECLARE(arena, CANOPY_PLC_ARENA(M, N, CLIENTS));
static int commands;

static int32_t coefficient(uint32_t index) { return (int32_t)(index * 2654435761U); }
static bool covered(uint32_t cell) { return cell % 3 != 1; }

// ---------------------------------------------------------------------------------------------------------------------
// A station whose every value is different

static void live(void *context, struct canopy_plc_live *to) {
    (void)context;
    *to = (struct canopy_plc_live){.age_ms = 0x11223344,
                                   .stale_after_ms = 0x22334455,
                                   .heartbeat = 0x1001,
                                   .status = CANOPY_PLC_VALID | CANOPY_PLC_STALE,
                                   .sensor_faults = 0x1003,
                                   .coverage_pct = 66};
}

static void counters(void *context, struct canopy_plc_counters *to) {
    (void)context;
    uint32_t value = 0x10001;
    uint32_t *const each[] = {&to->rx_frames,       &to->rx_errors,        &to->scan_errors,    &to->points_rejected,
                              &to->points_accepted, &to->readings_invalid, &to->profiles,       &to->profiles_missed,
                              &to->profiles_torn,   &to->profiles_short,   &to->profiles_stale, &to->profiles_refused,
                              &to->intrusions,      &to->publications,     &to->withdrawals,    &to->fits_failed,
                              &to->commands,        &to->lost_bytes,       &to->uptime_s,       &to->cycle_us,
                              &to->cycle_max_us};
    for (size_t i = 0; i < sizeof each / sizeof each[0]; i++)
        *each[i] = value++;
}

static enum canopy_plc_query_status height(void *context, const struct canopy_envelope *envelope, int32_t x, int32_t y,
                                           int32_t *to) {
    (void)context;
    (void)envelope;
    *to = x - y;  // quarters of a device unit
    return CANOPY_PLC_QUERY_GOOD;
}

static enum canopy_plc_result command(void *context, enum canopy_plc_command_code code) {
    (void)context;
    (void)code;
    commands++;
    return CANOPY_PLC_RESULT_REFUSED;
}

static void health(struct canopy_plc_keeper *it, struct canopy_plc_health *to) {
    (void)it;
    *to = (struct canopy_plc_health){
        .crash = {.kind = 0x30001, .pc = 0x30002, .lr = 0x30003, .sp = 0x30004, .status = 0x30005, .address = 0x30006},
        .starts = 0x20001,
        .crash_count = 0x20002,
        .ram_passes = 0x20003,
        .flash_passes = 0x20004,
        .flash_crc = 0x20005,
        .i2c_recoveries = 0x20006,
        .scanner_lost_bytes = 0x20007,
        .tests = 0x2101,
        .passed = 0x2102,
        .failed = 0x2103,
        .reset_reason = 0x2104,
        .scanner_failure = 0x2105,
        .stack_unused = 0x2106};
}

static enum canopy_plc_result keep(struct canopy_plc_keeper *it, enum canopy_plc_command_code code) {
    (void)it;
    assert_in_range(code, CANOPY_PLC_COMMAND_STORE, CANOPY_PLC_COMMAND_RESET);
    commands++;
    return CANOPY_PLC_RESULT_REFUSED;
}

static struct canopy_plc_keeper keeper;

static void start(void) {
    keeper = (struct canopy_plc_keeper){.settings = {.value = {.plc_unit = 17,
                                                               .plc_format = 1,
                                                               .plc_baud = 19200,
                                                               .scanner_unit = 18,
                                                               .scanner_i2c = 19,
                                                               .scanner_format = 0,
                                                               .side = 1,
                                                               .scanner_baud = 19201,
                                                               .scanner_timeout_ms = 1001,
                                                               .stale_after_ms = 70001,
                                                               .interval_ms = 70002,
                                                               .refresh_ms = 70003,
                                                               .watchdog_ms = 7004},
                                                     .generation = 0x40001,
                                                     .state = 0x4101,
                                                     .stored = 0x4102},
                                        .health = health,
                                        .keep = keep};
    const struct canopy_plc_config config = {
        .size = {M, N},
        .side = CANOPY_BELOW,
        .scalar = CANOPY_FX,
        .clients = CLIENTS,
        .unit = 0.001f,
        .source = {.live = live, .counters = counters, .height = height, .command = command},
    };
    assert_int_equal(canopy_plc_init(&plc, &config, arena, sizeof arena), CANOPY_OK);
    plc.keeper = &keeper;
    for (int i = 0; i < 2; i++) {
        struct canopy_envelope *to = canopy_plc_begin(&plc);
        to->frame = (struct canopy_frame){.origin = {-101, 102, -103},
                                          .pitch = {104, 0x80000105},
                                          .size = {M, N},
                                          .cells = 4,
                                          .lsb_log2 = -2,
                                          .side = CANOPY_BELOW,
                                          .axis = {{201, -202, 203}, {-204, 205, -206}, {207, -208, 209}}};
        to->first_row = -0x123456789;
        to->points = 0x7000001;
        to->margin = 0x12345;
        for (uint32_t k = 0; k < M * N; k++)
            to->coefficients[k] = coefficient(k);
        memset(to->coverage, 0, CANOPY_COVERAGE_BYTES(M, N));
        to->coverage[CANOPY_COVERAGE_BYTES(M, N) - 1] = 0xC0;  // beyond the last cell: must not be shown
        for (uint32_t k = 0; k < (M - 1) * (N - 1); k++)
            if (covered(k))
                to->coverage[k / 8] |= (uint8_t)(1U << (k % 8));
        assert_int_equal(canopy_plc_commit(&plc), CANOPY_OK);
    }
    const uint8_t query[8] = {0, 0, 1, 44, 0xFF, 0xFF, 0xFF, 0xF6};  // 300, -10
    assert_int_equal(canopy_plc_write(&plc, 0, CANOPY_REGISTER_QUERY_X, 4, query, 16), 0);
    const uint8_t refit[2] = {0x05, CANOPY_PLC_COMMAND_REFIT};
    assert_int_equal(canopy_plc_write(&plc, 0, CANOPY_REGISTER_COMMAND, 1, refit, 6), 0);
}

// What each register but the series must show, by name.
static const struct {
    const char *name, *text;
    double value;
} expected[] = {
    {"magic", NULL, 0x434E5059},
    {"probe_u32", NULL, 0x12345678},
    {"probe_f32", NULL, 1.0},
    {"map_crc", NULL, CANOPY_MAP_CRC},
    {"firmware_version", NULL, CANOPY_VERSION_MAJOR * 65536 + CANOPY_VERSION_MINOR * 256 + CANOPY_VERSION_PATCH},
    {"map_version", NULL, CANOPY_MAP_VERSION},
    {"clients", NULL, CLIENTS},
    {"capacity", NULL, M *N},
    {"vendor", CANOPY_VENDOR, 0},
    {"product", CANOPY_PRODUCT, 0},
    {"revision", CANOPY_VERSION, 0},
    {"heartbeat", NULL, 0x1001},
    {"status", NULL, 5},
    {"age_ms", NULL, 0x11223344},
    {"sensor_faults", NULL, 0x1003},
    {"coverage_pct", NULL, 66},
    {"stale_after_ms", NULL, 0x22334455},
    {"sequence", NULL, 2},
    {"points", NULL, 0x7000001},
    {"scalar", NULL, 1},
    {"side", NULL, 1},
    {"grid_m", NULL, M},
    {"grid_n", NULL, N},
    {"unit", NULL, (double)0.001f},
    {"lsb", NULL, 0.25},
    {"margin", NULL, 0x12345},
    {"origin_x", NULL, -101},
    {"origin_y", NULL, 102},
    {"origin_z", NULL, -103},
    {"pitch_u", NULL, 104},
    {"pitch_v", NULL, 0x80000105},
    {"axis_00", NULL, 201 / 1073741824.0},
    {"axis_01", NULL, -202 / 1073741824.0},
    {"axis_02", NULL, 203 / 1073741824.0},
    {"axis_10", NULL, -204 / 1073741824.0},
    {"axis_11", NULL, 205 / 1073741824.0},
    {"axis_12", NULL, -206 / 1073741824.0},
    {"axis_20", NULL, 207 / 1073741824.0},
    {"axis_21", NULL, -208 / 1073741824.0},
    {"axis_22", NULL, 209 / 1073741824.0},
    {"block_count", NULL, 7},
    {"coverage_count", NULL, 1},
    {"first_row_high", NULL, -2},
    {"first_row_low", NULL, 0xDCBA9877},
    {"query_x", NULL, 300},
    {"query_y", NULL, -10},
    {"query_height", NULL, 77},
    {"query_status", NULL, 0},
    {"query_sequence", NULL, 2},
    {"command", NULL, 0x0501},
    {"command_echo", NULL, 0x0501},
    {"command_result", NULL, CANOPY_PLC_RESULT_REFUSED},
    {"rx_frames", NULL, 0x10001},
    {"rx_errors", NULL, 0x10002},
    {"scan_errors", NULL, 0x10003},
    {"points_rejected", NULL, 0x10004},
    {"points_accepted", NULL, 0x10005},
    {"readings_invalid", NULL, 0x10006},
    {"profiles", NULL, 0x10007},
    {"profiles_missed", NULL, 0x10008},
    {"profiles_torn", NULL, 0x10009},
    {"profiles_short", NULL, 0x1000A},
    {"profiles_stale", NULL, 0x1000B},
    {"profiles_refused", NULL, 0x1000C},
    {"intrusions", NULL, 0x1000D},
    {"publications", NULL, 2},
    {"withdrawals", NULL, 0},
    {"fits_failed", NULL, 0x10010},
    {"commands", NULL, 1},
    {"lost_bytes", NULL, 0x10012},
    {"uptime_s", NULL, 0x10013},
    {"cycle_us", NULL, 0x10014},
    {"cycle_max_us", NULL, 0x10015},
    {"selftests", NULL, 0x2101},
    {"selftests_passed", NULL, 0x2102},
    {"selftests_failed", NULL, 0x2103},
    {"reset_reason", NULL, 0x2104},
    {"starts", NULL, 0x20001},
    {"crash_count", NULL, 0x20002},
    {"crash_kind", NULL, 0x30001},
    {"crash_pc", NULL, 0x30002},
    {"crash_lr", NULL, 0x30003},
    {"crash_sp", NULL, 0x30004},
    {"crash_status", NULL, 0x30005},
    {"crash_address", NULL, 0x30006},
    {"ram_passes", NULL, 0x20003},
    {"flash_passes", NULL, 0x20004},
    {"flash_crc", NULL, 0x20005},
    {"i2c_recoveries", NULL, 0x20006},
    {"scanner_lost_bytes", NULL, 0x20007},
    {"scanner_failure", NULL, 0x2105},
    {"stack_unused", NULL, 0x2106},
    {"settings_state", NULL, 0x4101},
    {"settings_stored", NULL, 0x4102},
    {"settings_generation", NULL, 0x40001},
    {"set_plc_unit", NULL, 17},
    {"set_plc_format", NULL, 1},
    {"set_plc_baud", NULL, 19200},
    {"set_scanner_unit", NULL, 18},
    {"set_scanner_i2c", NULL, 19},
    {"set_scanner_format", NULL, 0},
    {"set_side", NULL, 1},
    {"set_scanner_baud", NULL, 19201},
    {"set_scanner_timeout_ms", NULL, 1001},
    {"set_stale_after_ms", NULL, 70001},
    {"set_interval_ms", NULL, 70002},
    {"set_refresh_ms", NULL, 70003},
    {"set_watchdog_ms", NULL, 7004},
};

enum { EXPECTED = sizeof expected / sizeof expected[0] };

// ---------------------------------------------------------------------------------------------------------------------
// The generated map

static json_t *map;
static bool is_register[ADDRESSES + 1];

static int load(void **unused) {
    (void)unused;
    const char *build = getenv("BUILD");
    char path[4096];
    snprintf(path, sizeof path, "%s/registers.json", build != NULL ? build : "build");
    json_error_t error;
    map = json_load_file(path, 0, &error);
    if (map == NULL) {
        printf("# %s: %s\n", path, error.text);
        return -1;
    }
    size_t i;
    json_t *item;
    json_array_foreach(json_object_get(map, "registers"), i, item) {
        const json_int_t address = json_integer_value(json_object_get(item, "address"));
        for (json_int_t k = 0; k < json_integer_value(json_object_get(item, "words")); k++)
            is_register[address + k] = true;
    }
    return 0;
}

static int unload(void **unused) {
    (void)unused;
    json_decref(map);
    return 0;
}

static uint16_t word_at(const uint8_t *bytes, uint32_t i) { return (uint16_t)(bytes[2 * i] << 8 | bytes[2 * i + 1]); }

static uint32_t pair_at(const uint8_t *bytes, uint32_t i) {
    return (uint32_t)word_at(bytes, i) << 16 | word_at(bytes, i + 1);
}

// A value in physical terms, as a client decodes it that knows nothing but the JSON.
static double decode(const char *type, double scale, const uint8_t *bytes, size_t words) {
    if (strcmp(type, "u16") == 0) {
        assert_int_equal(words, 1);
        return scale * word_at(bytes, 0);
    }
    assert_int_equal(words, 2);
    const uint32_t bits = pair_at(bytes, 0);
    if (strcmp(type, "u32") == 0)
        return scale * bits;
    if (strcmp(type, "i32") == 0)
        return scale * (int32_t)bits;
    assert_string_equal(type, "f32");
    float value;
    memcpy(&value, &bits, sizeof value);
    return scale * (double)value;
}

static void check_block(uint32_t k, const uint8_t *bytes) {
    assert_int_equal(pair_at(bytes, 0), k < 7 ? 2 : 0);
    for (uint32_t i = 0; i < 61; i++) {
        const uint32_t index = 61 * k + i;
        assert_int_equal((int32_t)pair_at(bytes, 2 + 2 * i), index < M * N ? coefficient(index) : INT32_MIN);
    }
}

static void check_coverage(uint32_t k, const uint8_t *bytes) {
    assert_int_equal(pair_at(bytes, 0), k < 1 ? 2 : 0);
    for (uint32_t i = 0; i < 1952; i++) {
        const uint32_t cell = 1952 * k + i;
        assert_int_equal(word_at(bytes, 2 + i / 16) >> (i % 16) & 1, cell < (M - 1) * (N - 1) && covered(cell));
    }
}

// The second publication was the same as the first.
static void check_changes(uint32_t k, const uint8_t *bytes) {
    assert_int_equal(pair_at(bytes, 0), k < 1 ? 2 : 0);
    for (uint32_t i = 0; i < 61; i++)
        assert_int_equal(pair_at(bytes, 2 + 2 * i), 61 * k + i < M ? 1 : 0);
}

static void every_register_by_name(void **unused) {
    (void)unused;
    start();
    assert_int_equal(json_integer_value(json_object_get(map, "map_version")), CANOPY_MAP_VERSION);
    assert_string_equal(json_string_value(json_object_get(map, "word_order")), "ABCD");
    uint32_t found = 0, blocks = 0, coverage = 0, changes = 0;
    size_t i;
    json_t *item;
    json_array_foreach(json_object_get(map, "registers"), i, item) {
        uint8_t bytes[250];
        const char *name = json_string_value(json_object_get(item, "name"));
        const char *type = json_string_value(json_object_get(item, "type"));
        const double scale = json_number_value(json_object_get(item, "scale"));
        const json_int_t words = json_integer_value(json_object_get(item, "words"));
        const json_int_t address = json_integer_value(json_object_get(item, "address"));
        assert_string_equal(json_string_value(json_object_get(item, "table")), "holding");
        assert_int_equal(canopy_plc_read(&plc, 0, (uint16_t)address, (uint16_t)words, bytes), 0);
        unsigned k;
        char rest;
        if (sscanf(name, "block_%u%c", &k, &rest) == 1) {
            assert_int_equal(k, blocks++);
            check_block(k, bytes);
            continue;
        }
        if (sscanf(name, "coverage_%u%c", &k, &rest) == 1) {
            assert_int_equal(k, coverage++);
            check_coverage(k, bytes);
            continue;
        }
        if (sscanf(name, "changed_%u%c", &k, &rest) == 1) {
            assert_int_equal(k, changes++);
            check_changes(k, bytes);
            continue;
        }
        size_t e = 0;
        while (e < EXPECTED && strcmp(expected[e].name, name) != 0)
            e++;
        if (e == EXPECTED) {
            fail_msg("nobody says what %s should show", name);
            return;
        }
        found++;
        if (expected[e].text != NULL) {
            char text[251] = {0};
            memcpy(text, bytes, 2 * (size_t)words);
            assert_string_equal(text, expected[e].text);
        } else {
            const double value = decode(type, scale, bytes, (size_t)words);
            if (value < expected[e].value || value > expected[e].value)
                fail_msg("%s is %.17g instead of %.17g", name, value, expected[e].value);
        }
    }
    assert_int_equal(found, EXPECTED);
    assert_int_equal(blocks, CANOPY_BLOCK_MAX);
    assert_int_equal(coverage, CANOPY_COVERAGE_MAX);
    assert_int_equal(changes, CANOPY_CHANGED_MAX);
}

// ---------------------------------------------------------------------------------------------------------------------
// What changed

// A PLC that keeps the rows by their number, reads those that changed after the sequence it knows, and has the
// envelope.
struct follower {
    uint32_t sequence;
    int64_t first;
    int32_t rows[M][N];
};

static uint32_t follow(struct follower *it, uint8_t client) {
    uint8_t header[96], changes[250], block[250];
    uint32_t read = 0;
    assert_int_equal(canopy_plc_read(&plc, client, CANOPY_REGISTER_SEQUENCE, 48, header), 0);
    const uint32_t sequence = pair_at(header, 0);
    const int64_t first = (int64_t)((uint64_t)pair_at(header, 44) << 32 | pair_at(header, 46));
    assert_int_equal(canopy_plc_read(&plc, client, CANOPY_REGISTER_CHANGED_0, 124, changes), 0);
    assert_int_equal(pair_at(changes, 0), sequence);
    const struct follower old = *it;
    for (uint32_t i = 0; i < M; i++) {
        const int64_t was = first + i - old.first;
        if ((int32_t)(pair_at(changes, 2 + 2 * i) - old.sequence) > 0) {
            for (uint32_t c = i * N; c < (i + 1) * N; c++) {
                const uint16_t address = (uint16_t)(CANOPY_REGISTER_BLOCK_0 + c / 61 * CANOPY_BLOCK_STRIDE);
                assert_int_equal(canopy_plc_read(&plc, client, (uint16_t)(address + 2 + c % 61 * 2), 2, block), 0);
                it->rows[i][c % N] = (int32_t)pair_at(block, 0);
            }
            read++;
        } else {
            assert_true(was >= 0 && was < M);
            memcpy(it->rows[i], old.rows[was], sizeof it->rows[i]);
        }
    }
    it->sequence = sequence;
    it->first = first;
    return read;
}

static void who_reads_only_what_changed_has_all(void **unused) {
    (void)unused;
    static const int steps[] = {0, 0, 0, 1, 1, 2, 0, 3, 40, -1, 0};
    static struct follower followers[CLIENTS];
    static int32_t rows[M][N];
    uint32_t random = 1, read = 0, followed = 0;
    int64_t first = -7;
    start();
    memset(followers, 0, sizeof followers);
    for (uint32_t time = 0; time < 4000; time++) {
        random = random * 1664525U + 1013904223U;
        const int by = steps[(random >> 16) % (sizeof steps / sizeof steps[0])];
        first += by;
        for (uint32_t i = 0; by > 0 && i < M; i++)  // as a ring moves: rows go to the front, new ones come
            for (uint32_t j = 0; j < N; j++)
                rows[i][j] = i + (uint32_t)by < M ? rows[i + (uint32_t)by][j] : (int32_t)(time * 1000 + i * N + j);
        if ((random >> 8) % 3 == 0)
            rows[(random >> 10) % M][(random >> 20) % N] ^= 1;
        struct canopy_envelope *to = canopy_plc_begin(&plc);
        to->frame = (struct canopy_frame){.origin = {by < 0 ? (int32_t)time : 5, (int32_t)first * 4, 9},
                                          .pitch = {4, 4 + (time % 500 == 7)},  // a new scale: nothing is as it was
                                          .size = {M, N},
                                          .cells = 4,
                                          .side = CANOPY_BELOW};
        to->first_row = first;
        memcpy(to->coefficients, rows, sizeof rows);
        if ((random >> 12) % 50 == 0)
            canopy_plc_withdraw(&plc);
        assert_int_equal(canopy_plc_commit(&plc), CANOPY_OK);
        for (uint8_t c = 0; c < CLIENTS; c++)
            if ((random >> (4 + c)) % (2U + c) == 0) {  // some miss publications
                read += follow(&followers[c], c);
                followed++;
                assert_memory_equal(followers[c].rows, rows, sizeof rows);
            }
    }
    printf("# %u of %u rows read\n", read, followed * M);
    assert_true(3 * read < 2 * followed * M);
}

// ---------------------------------------------------------------------------------------------------------------------
// Every address

static uint16_t image[ADDRESSES];

static void read_image(void) {
    uint8_t bytes[2];
    for (uint32_t a = 0; a < ADDRESSES; a++) {
        image[a] = 0;
        if (canopy_plc_read(&plc, 0, (uint16_t)a, 1, bytes) == 0)
            image[a] = word_at(bytes, 0);
    }
}

// How many registers of the table stand before each address.
static uint32_t before[ADDRESSES + 1];

static void every_address_and_length(void **unused) {
    (void)unused;
    start();
    for (uint32_t a = 0; a < ADDRESSES; a++)
        before[a + 1] = before[a] + is_register[a];
    uint32_t accepted = 0;
    for (uint32_t a = 0; a < ADDRESSES; a++)
        for (uint32_t count = 0; count <= 130 && a + count <= ADDRESSES; count++) {
            uint8_t exception = 0;
            if (count == 0 || count > 125)
                exception = CANOPY_MODBUS_ILLEGAL_VALUE;
            else if (a + count > CANOPY_MAP_END || before[a + count] == before[a])
                exception = CANOPY_MODBUS_ILLEGAL_ADDRESS;
            if (canopy_plc_readable(&plc, 1, (uint16_t)a, (uint16_t)count) != exception)
                fail_msg("%u registers from %u: not %u", count, a, exception);
            accepted += exception == 0;
        }
    assert_in_range(accepted, 4000000, 8192000);
}

// A long read shows what single reads show, writes exactly its bytes, and agrees with what readable says.
static void long_reads_are_many_short_ones(void **unused) {
    (void)unused;
    start();
    read_image();
    static const uint16_t counts[] = {1, 2, 3, 7, 61, 62, 123, 124, 125};
    for (uint32_t a = 0; a < ADDRESSES; a++)
        for (size_t i = 0; i < sizeof counts / sizeof counts[0] && a + counts[i] <= ADDRESSES; i++) {
            if (a > 2600 && a < 9800)
                continue;  // nothing there: covered above
            const uint16_t count = counts[i];
            uint8_t bytes[252];
            memset(bytes, 0x5A, sizeof bytes);
            const uint8_t exception = canopy_plc_read(&plc, 0, (uint16_t)a, count, bytes);
            assert_int_equal(exception, canopy_plc_readable(&plc, 0, (uint16_t)a, count));
            for (uint32_t k = 0; k < count && exception == 0; k++)
                if (word_at(bytes, k) != image[a + k])
                    fail_msg("register %u in %u from %u: %04X instead of %04X", a + k, count, a, word_at(bytes, k),
                             image[a + k]);
            assert_int_equal(bytes[2 * count], 0x5A);
        }
}

// ---------------------------------------------------------------------------------------------------------------------
// Every write

static struct canopy_plc plc_before;
static struct canopy_plc_keeper keeper_before;
static unsigned char arena_before[sizeof arena];

static void remember(void) {
    plc_before = plc;
    keeper_before = keeper;
    memcpy(arena_before, arena, sizeof arena);
}

static bool unchanged(void) {
    return memcmp(&plc, &plc_before, sizeof plc) == 0 && memcmp(&keeper, &keeper_before, sizeof keeper) == 0 &&
           memcmp(arena, arena_before, sizeof arena) == 0;
}

// The settings as the table's own page tells them, not as the code has them.
static const struct {
    const char *name;
    uint32_t low, high;
} ranges[] = {
    {"set_plc_unit", 1, 247},
    {"set_plc_format", 0, 1},
    {"set_plc_baud", 1200, 921600},
    {"set_scanner_unit", 1, 247},
    {"set_scanner_i2c", 8, 119},
    {"set_scanner_format", 0, 1},
    {"set_side", 0, 1},
    {"set_scanner_baud", 1200, 921600},
    {"set_scanner_timeout_ms", 10, 10000},
    {"set_stale_after_ms", 10, 4000000},
    {"set_interval_ms", 0, 4000000},
    {"set_refresh_ms", 0, 4000000},
    {"set_watchdog_ms", 1000, 8000},
};

enum { SETTINGS_COUNT = sizeof ranges / sizeof ranges[0] };

static json_t *register_of(const char *name) {
    size_t i;
    json_t *item;
    json_array_foreach(json_object_get(map, "registers"), i, item) {
        if (strcmp(json_string_value(json_object_get(item, "name")), name) == 0)
            return item;
    }
    fail_msg("no register %s", name);
    return NULL;
}

// How a write of `value` to setting s must be answered, alone and without touching anything else.
static void write_setting(size_t s, uint32_t value) {
    const json_t *item = register_of(ranges[s].name);
    const uint16_t address = (uint16_t)json_integer_value(json_object_get(item, "address"));
    const uint16_t words = (uint16_t)json_integer_value(json_object_get(item, "words"));
    const uint8_t all[4] = {(uint8_t)(value >> 24), (uint8_t)(value >> 16), (uint8_t)(value >> 8), (uint8_t)value};
    const uint8_t *bytes = words == 2 ? all : all + 2;
    const bool good = value >= ranges[s].low && value <= ranges[s].high;
    if (words == 1 && value > 0xFFFF)
        return;
    remember();
    read_image();
    assert_int_equal(canopy_plc_write(&plc, 1, address, words, bytes, 16), good ? 0 : CANOPY_MODBUS_ILLEGAL_VALUE);
    if (!good) {
        assert_true(unchanged());
        return;
    }
    uint8_t answer[4];
    assert_int_equal(canopy_plc_read(&plc, 0, address, words, answer), 0);
    assert_memory_equal(answer, bytes, 2U * words);
    for (uint32_t a = CANOPY_REGISTER_SETTINGS_STATE; a < CANOPY_REGISTER_SETTINGS_STATE + 100; a++)
        if (a < address || a >= (uint32_t)address + words) {
            uint8_t other[2] = {0, 0};
            (void)canopy_plc_read(&plc, 0, (uint16_t)a, 1, other);
            assert_int_equal(word_at(other, 0), image[a]);
        }
}

static void settings_take_their_ranges_and_nothing_else(void **unused) {
    (void)unused;
    start();
    uint32_t random = 1;
    for (size_t s = 0; s < SETTINGS_COUNT; s++) {
        const uint32_t low = ranges[s].low, high = ranges[s].high;
        const uint32_t edges[] = {low, high, low - 1, high + 1, 0, 0xFFFF, 0x10000, 0xFFFFFFFF, low + (high - low) / 2};
        for (size_t i = 0; i < sizeof edges / sizeof edges[0]; i++)
            write_setting(s, edges[i]);
        for (int i = 0; i < 20; i++) {
            random = random * 1664525U + 1013904223U;
            write_setting(s, random >> (random % 29));
        }
    }
}

static void fixed_settings_keep_their_value(void **unused) {
    (void)unused;
    start();
    keeper.fixed = 1U << CANOPY_SETTING_SIDE | 1U << CANOPY_SETTING_PLC_BAUD;
    const uint8_t zero[2] = {0, 0}, one[2] = {0, 1}, same[4] = {0, 0, 0x4B, 0x00}, other[4] = {0, 1, 0xC2, 0x00};
    remember();
    assert_int_equal(canopy_plc_write(&plc, 0, CANOPY_REGISTER_SET_SIDE, 1, zero, 6), CANOPY_MODBUS_ILLEGAL_VALUE);
    assert_int_equal(canopy_plc_write(&plc, 0, CANOPY_REGISTER_SET_SIDE, 1, one, 6), 0);
    assert_int_equal(canopy_plc_write(&plc, 0, CANOPY_REGISTER_SET_PLC_BAUD, 2, same, 16), 0);
    assert_int_equal(canopy_plc_write(&plc, 0, CANOPY_REGISTER_SET_PLC_BAUD, 2, other, 16),
                     CANOPY_MODBUS_ILLEGAL_VALUE);
    assert_true(unchanged());
    assert_int_equal(canopy_plc_write(&plc, 0, CANOPY_REGISTER_SET_SCANNER_BAUD, 2, other, 16), 0);
}

// All settings in one request: one that is out of range refuses them all.
static void a_write_of_many_settings_is_all_or_nothing(void **unused) {
    (void)unused;
    start();
    uint8_t bytes[CANOPY_SETTINGS_BYTES];
    const uint16_t words = CANOPY_SETTINGS_BYTES / 2;
    assert_int_equal(canopy_plc_read(&plc, 0, CANOPY_REGISTER_SET_PLC_UNIT, words, bytes), 0);
    remember();
    for (size_t i = 0; i < sizeof bytes; i += 2) {
        uint8_t wrong[sizeof bytes];
        memcpy(wrong, bytes, sizeof bytes);
        wrong[1] = 99;  // a change that is allowed, first
        wrong[i] = wrong[i + 1] = 0xFF;
        // 65535 in the low half of a long setting may still be in its range
        const uint8_t exception = canopy_plc_write(&plc, 0, CANOPY_REGISTER_SET_PLC_UNIT, words, wrong, 16);
        if (exception == 0) {
            assert_int_equal(keeper.settings.value.plc_unit, 99);
            start();
            remember();  // padding may differ from start to start
        } else {
            assert_int_equal(exception, CANOPY_MODBUS_ILLEGAL_VALUE);
            assert_true(unchanged());
        }
    }
    plc.keeper = NULL;
    assert_int_equal(canopy_plc_write(&plc, 0, CANOPY_REGISTER_SET_PLC_UNIT, words, bytes, 16),
                     CANOPY_MODBUS_ILLEGAL_ADDRESS);
    uint8_t state[2];
    assert_int_equal(canopy_plc_read(&plc, 0, CANOPY_REGISTER_SETTINGS_STATE, 1, state), 0);
    assert_int_equal(word_at(state, 0), CANOPY_PLC_SETTINGS_NOWHERE);
}

// Whether `count` registers from `a` on are whole settings: written in range or refused for their value, elsewhere.
static bool is_setting(uint32_t a, uint32_t count) {
    uint32_t covered = 0;
    if (a < CANOPY_REGISTER_SET_PLC_UNIT || a >= CANOPY_REGISTER_SET_PLC_UNIT + 100)
        return false;  // the table need not be searched
    for (size_t s = 0; s < SETTINGS_COUNT; s++) {
        const json_t *item = register_of(ranges[s].name);
        const uint32_t address = (uint32_t)json_integer_value(json_object_get(item, "address"));
        const uint32_t words = (uint32_t)json_integer_value(json_object_get(item, "words"));
        covered += address >= a && address + words <= a + count ? words : 0;
    }
    return covered == count;
}

static void single_writes_have_their_effect_or_none(void **unused) {
    (void)unused;
    static const uint16_t values[] = {0, 1, 3, 4, 0x00FF, 0x0102, 0x7FFF, 0x8000, 0xFFFF};
    start();
    remember();
    for (uint32_t a = 0; a < ADDRESSES; a++)
        for (size_t i = 0; i < sizeof values / sizeof values[0]; i++) {
            const uint8_t bytes[2] = {(uint8_t)(values[i] >> 8), (uint8_t)values[i]};
            if (a == CANOPY_REGISTER_COMMAND || is_setting(a, 1))
                continue;
            assert_int_equal(canopy_plc_write(&plc, 0, (uint16_t)a, 1, bytes, 6), CANOPY_MODBUS_ILLEGAL_ADDRESS);
            if (!unchanged())
                fail_msg("a refused write of %04X to %u changed something", values[i], a);
        }
}

static void every_command_word(void **unused) {
    (void)unused;
    start();
    for (uint32_t value = 0; value < 65536; value++) {
        remember();
        const int ran = commands;
        const struct canopy_plc_command kept = plc.clients[1].command;
        const uint8_t bytes[2] = {(uint8_t)(value >> 8), (uint8_t)value};
        const uint8_t code = (uint8_t)value;
        const uint8_t exception = canopy_plc_write(&plc, 1, CANOPY_REGISTER_COMMAND, 1, bytes, 6);
        if (code >= CANOPY_PLC_COMMANDS) {
            assert_int_equal(exception, CANOPY_MODBUS_ILLEGAL_VALUE);
            assert_true(unchanged());
            continue;
        }
        assert_int_equal(exception, 0);
        assert_int_equal(commands, ran + (code != 0));
        uint8_t answer[6];
        assert_int_equal(canopy_plc_read(&plc, 1, CANOPY_REGISTER_COMMAND, 3, answer), 0);
        assert_int_equal(word_at(answer, 0), value);
        assert_int_equal(word_at(answer, 1), value);
        assert_int_equal(word_at(answer, 2), code ? CANOPY_PLC_RESULT_REFUSED : CANOPY_PLC_RESULT_DONE);
        // Nothing else: with its command and the count of commands put back, the object is what it was.
        plc.commands--;
        plc.clients[1].command = kept;
        assert_true(unchanged());
    }
}

static void only_whole_items_are_written(void **unused) {
    (void)unused;
    uint8_t bytes[246] = {0};
    for (size_t i = 0; i < sizeof bytes; i++)
        bytes[i] = (uint8_t)(i * 37);
    start();
    remember();
    uint32_t written = 0;
    for (uint32_t a = 0; a < ADDRESSES; a++)
        for (uint32_t count = 2; count <= 123 && a + count <= ADDRESSES; count += count < 12 ? 1 : 37) {
            const bool whole = (a == CANOPY_REGISTER_QUERY_X && (count == 2 || count == 4)) ||
                               (a == CANOPY_REGISTER_QUERY_Y && count == 2);
            if (is_setting(a, count)) {
                // whole settings: what they may be is tested above
                if (canopy_plc_write(&plc, 0, (uint16_t)a, (uint16_t)count, bytes, 16) != 0)
                    assert_true(unchanged());
                start();
                remember();
                continue;
            }
            const uint8_t exception = canopy_plc_write(&plc, 0, (uint16_t)a, (uint16_t)count, bytes, 16);
            assert_int_equal(exception, whole ? 0 : CANOPY_MODBUS_ILLEGAL_ADDRESS);
            written += whole;
            if (!whole && !unchanged())
                fail_msg("a refused write of %u registers to %u changed something", count, a);
            if (whole) {
                uint8_t answer[8];
                assert_int_equal(canopy_plc_read(&plc, 0, (uint16_t)a, (uint16_t)count, answer), 0);
                assert_memory_equal(answer, bytes, 2 * count);
                remember();
            }
        }
    assert_int_equal(written, 3);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_register_by_name),
        cmocka_unit_test(who_reads_only_what_changed_has_all),
        cmocka_unit_test(every_address_and_length),
        cmocka_unit_test(long_reads_are_many_short_ones),
        cmocka_unit_test(single_writes_have_their_effect_or_none),
        cmocka_unit_test(settings_take_their_ranges_and_nothing_else),
        cmocka_unit_test(fixed_settings_keep_their_value),
        cmocka_unit_test(a_write_of_many_settings_is_all_or_nothing),
        cmocka_unit_test(every_command_word),
        cmocka_unit_test(only_whole_items_are_written),
    };
    return cmocka_run_group_tests_name("plc_map", tests, load, unload);
}
