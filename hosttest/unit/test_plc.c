// The register map as a client sees it: snapshots, holds, queries, commands, exceptions.
#include "canopy_registers.h"
#include "hosttest/unit/unit.h"
#include "lib/plc/plc.h"
#include "lib/version.h"

enum { M = 8, N = 9, CLIENTS = 2, COUNT = M * N, CELLS = (M - 1) * (N - 1) };

static struct canopy_plc plc;
static CANOPY_ARENA_DECLARE(arena, CANOPY_PLC_ARENA(M, N, CLIENTS));
static uint8_t answer[250];

// What the station would say, set by the tests.
static struct {
    struct canopy_plc_live live;
    struct canopy_plc_counters counters;
    int32_t height;
    enum canopy_plc_query_status height_status;
    enum canopy_plc_result result;
    int commands;
    enum canopy_plc_command_code last;
    bool withdraws;
} station;

static void live(void *context, struct canopy_plc_live *to) {
    (void)context;
    *to = station.live;
}

static void counters(void *context, struct canopy_plc_counters *to) {
    (void)context;
    *to = station.counters;
}

static enum canopy_plc_query_status height(void *context, const struct canopy_envelope *envelope, int32_t x, int32_t y,
                                           int32_t *to) {
    (void)context;
    *to = station.height + envelope->coefficients[0] + 2 * x + 3 * y;
    return station.height_status;
}

static enum canopy_plc_result command(void *context, enum canopy_plc_command_code code) {
    (void)context;
    station.commands++;
    station.last = code;
    if (station.withdraws)
        canopy_plc_withdraw(&plc);
    return station.result;
}

static struct canopy_plc_config config_of(uint8_t side) {
    return (struct canopy_plc_config){
        .size = {M, N},
        .side = side,
        .scalar = CANOPY_FX,
        .clients = CLIENTS,
        .unit = 0.5f,
        .source = {.live = live, .counters = counters, .height = height, .command = command},
    };
}

static void start(uint8_t side) {
    const struct canopy_plc_config config = config_of(side);
    memset(&station, 0, sizeof station);
    station.result = CANOPY_PLC_RESULT_DONE;
    memset(arena, 0xA5, sizeof arena);
    CHECK_EQ(canopy_plc_init(&plc, &config, arena, sizeof arena), CANOPY_OK);
}

static int32_t coefficient(uint32_t sequence, uint32_t index) {
    return (int32_t)(sequence * 1000 + index) * (index % 2 ? -1 : 1);
}

static void fill(struct canopy_envelope *to, uint32_t sequence) {
    to->frame = (struct canopy_frame){.origin = {-5, 6, (int32_t)sequence},
                                      .pitch = {70, 80},
                                      .size = {M, N},
                                      .cells = 4,
                                      .side = plc.config.side,
                                      .axis = {{1 << 30, 0, 0}, {0, 1 << 30, 0}, {0, 0, 1 << 30}}};
    to->scalar = CANOPY_FX;
    to->points = 100 + sequence;
    to->margin = 3;
    for (uint32_t i = 0; i < COUNT; i++)
        to->coefficients[i] = coefficient(sequence, i);
    memset(to->coverage, 0, CANOPY_COVERAGE_BYTES(M, N));
    for (uint32_t i = 0; i < CELLS; i += sequence)
        to->coverage[i / 8] |= (uint8_t)(1U << (i % 8));
}

static void publish(void) {
    fill(canopy_plc_begin(&plc), plc.sequence + 1);
    CHECK_EQ(canopy_plc_commit(&plc), CANOPY_OK);
}

// ---------------------------------------------------------------------------------------------------------------------
// A client

static uint8_t ask(uint8_t client, uint32_t address, uint32_t count) {
    return canopy_plc_read(&plc, client, (uint16_t)address, (uint16_t)count, answer);
}

static uint16_t word(size_t i) { return (uint16_t)(answer[2 * i] << 8 | answer[2 * i + 1]); }
static uint32_t pair(size_t i) { return (uint32_t)word(i) << 16 | word(i + 1); }

static uint16_t read_word(uint8_t client, uint32_t address) {
    CHECK_EQ(ask(client, address, 1), 0);
    return word(0);
}

static uint32_t read_pair(uint8_t client, uint32_t address) {
    CHECK_EQ(ask(client, address, 2), 0);
    return pair(0);
}

static uint8_t write_pair(uint8_t client, uint32_t address, uint32_t value) {
    const uint8_t bytes[4] = {(uint8_t)(value >> 24), (uint8_t)(value >> 16), (uint8_t)(value >> 8), (uint8_t)value};
    return canopy_plc_write(&plc, client, (uint16_t)address, 2, bytes, 16);
}

static uint8_t write_word(uint8_t client, uint32_t address, uint16_t value) {
    const uint8_t bytes[2] = {(uint8_t)(value >> 8), (uint8_t)value};
    return canopy_plc_write(&plc, client, (uint16_t)address, 1, bytes, 6);
}

enum {
    BLOCK_0 = CANOPY_REGISTER_BLOCK_0,
    BLOCK_1 = BLOCK_0 + CANOPY_BLOCK_STRIDE,
    SEQUENCE = CANOPY_REGISTER_SEQUENCE
};

// The sequence of a whole block, after its contents are checked against it.
static uint32_t read_block(uint8_t client, uint32_t k) {
    CHECK_EQ(ask(client, BLOCK_0 + k * CANOPY_BLOCK_STRIDE, CANOPY_BLOCK_WORDS), 0);
    const uint32_t sequence = pair(0);
    for (uint32_t i = 0; i < CANOPY_PLC_BLOCK_COEFFICIENTS; i++) {
        const uint32_t index = k * CANOPY_PLC_BLOCK_COEFFICIENTS + i;
        const bool known = sequence != 0 && index < COUNT;
        CHECK_EQ((int32_t)pair(2 + 2 * i), known ? coefficient(sequence, index) : INT32_MAX);
    }
    return sequence;
}

static uint32_t read_coverage(uint8_t client) {
    CHECK_EQ(ask(client, CANOPY_REGISTER_COVERAGE_0, CANOPY_COVERAGE_WORDS), 0);
    const uint32_t sequence = pair(0);
    for (uint32_t i = 0; i < CANOPY_PLC_BLOCK_CELLS; i++)
        CHECK_EQ(word(2 + i / 16) >> (i % 16) & 1, sequence != 0 && i < CELLS && i % sequence == 0);
    return sequence;
}

// ---------------------------------------------------------------------------------------------------------------------

UNIT(init_says_what_is_wrong) {
    struct canopy_plc_config config = config_of(CANOPY_ABOVE);
    const size_t bytes = CANOPY_PLC_ARENA(M, N, CLIENTS);
    CHECK_EQ(canopy_plc_init(&plc, &config, arena, bytes), CANOPY_OK);
    CHECK_EQ(canopy_plc_init(&plc, &config, arena, bytes - 1), CANOPY_ARENA_SHORT);
    CHECK_EQ(canopy_plc_init(&plc, &config, NULL, bytes), CANOPY_ARENA_ALIGN);
    CHECK_EQ(canopy_plc_init(&plc, &config, (unsigned char *)arena + 4, bytes), CANOPY_ARENA_ALIGN);
    CHECK_EQ(canopy_plc_init(&plc, NULL, arena, bytes), CANOPY_ARGUMENT);
#define WRONG(member, value)                                                                                           \
    config = config_of(CANOPY_ABOVE);                                                                                  \
    config.member = value;                                                                                             \
    CHECK_EQ(canopy_plc_init(&plc, &config, arena, bytes), CANOPY_ARGUMENT)
    WRONG(size[0], 3);
    WRONG(size[1], 3);
    WRONG(size[1], 4097);
    WRONG(side, 2);
    WRONG(scalar, 2);
    WRONG(clients, 0);
    WRONG(clients, 251);
    WRONG(unit, 0.0f);
    WRONG(unit, -1.0f);
    WRONG(unit, 1e-40f);
    WRONG(unit, 3e38f * 10.0f);
    WRONG(source.live, NULL);
    WRONG(source.counters, NULL);
    WRONG(source.height, NULL);
    WRONG(source.command, NULL);
#undef WRONG
}

UNIT(identity_shows_the_word_order) {
    start(CANOPY_ABOVE);
    CHECK_EQ(ask(0, 0, 38), 0);
    static const uint8_t bytes[] = {0x43, 0x4E, 0x50, 0x59, 0x12, 0x34, 0x56, 0x78, 0x3F, 0x80, 0x00, 0x00};
    CHECK_BYTES(answer, bytes, sizeof bytes);
    CHECK_EQ(pair(CANOPY_REGISTER_MAP_CRC), CANOPY_MAP_CRC);
    CHECK_EQ(word(CANOPY_REGISTER_MAP_VERSION), CANOPY_MAP_VERSION);
    CHECK_EQ(word(CANOPY_REGISTER_CLIENTS), CLIENTS);
    CHECK_EQ(pair(CANOPY_REGISTER_CAPACITY), COUNT);
    CHECK_BYTES(answer + 2 * CANOPY_REGISTER_VENDOR, "canopy\0\0\0\0\0\0\0\0\0", 16);
    CHECK_BYTES(answer + 2 * CANOPY_REGISTER_REVISION, CANOPY_VERSION, sizeof CANOPY_VERSION);
    const struct canopy_modbus_bank bank = canopy_plc_bank(&plc);
    CHECK_BYTES(bank.identify(bank.context, 0), CANOPY_VENDOR, sizeof CANOPY_VENDOR);
    CHECK_BYTES(bank.identify(bank.context, 2), CANOPY_VERSION, sizeof CANOPY_VERSION);
    CHECK(bank.identify(bank.context, 1) != NULL && bank.identify(bank.context, 4) != NULL);
    CHECK(bank.identify(bank.context, 3) == NULL && bank.identify(bank.context, 255) == NULL);
}

UNIT(without_an_envelope_everything_is_unknown) {
    start(CANOPY_ABOVE);
    station.live.status = CANOPY_PLC_VALID | CANOPY_PLC_STALE;
    CHECK_EQ(read_word(0, CANOPY_REGISTER_STATUS), CANOPY_PLC_STALE);
    CHECK_EQ(ask(0, SEQUENCE, 44), 0);
    CHECK_EQ(pair(0), 0);
    CHECK_EQ(pair(2), 0);
    CHECK_EQ(word(CANOPY_REGISTER_GRID_M - SEQUENCE), M);
    CHECK_EQ(word(CANOPY_REGISTER_GRID_N - SEQUENCE), N);
    CHECK_EQ(word(CANOPY_REGISTER_BLOCK_COUNT - SEQUENCE), 2);
    CHECK_EQ(word(CANOPY_REGISTER_COVERAGE_COUNT - SEQUENCE), 1);
    CHECK_EQ(read_block(0, 0), 0);
    CHECK_EQ(read_coverage(0), 0);
    CHECK(canopy_plc_published(&plc) == NULL);
    start(CANOPY_BELOW);
    CHECK_EQ((int32_t)read_pair(0, BLOCK_0 + 2), INT32_MIN);
    CHECK_EQ((int32_t)read_pair(0, CANOPY_REGISTER_QUERY_HEIGHT), INT32_MIN);
}

UNIT(an_envelope_is_served_whole) {
    start(CANOPY_ABOVE);
    publish();
    publish();
    CHECK_EQ(ask(0, SEQUENCE, 44), 0);
    CHECK_EQ(pair(0), 2);
    CHECK_EQ(pair(2), 102);
    CHECK_EQ(word(4), CANOPY_FX);
    CHECK_EQ(word(5), CANOPY_ABOVE);
    CHECK_EQ(pair(8), 0x3F000000);   // 0.5
    CHECK_EQ(pair(10), 0x3F800000);  // 1.0
    CHECK_EQ(pair(12), 3);
    CHECK_EQ((int32_t)pair(14), -5);
    CHECK_EQ(pair(16), 6);
    CHECK_EQ(pair(18), 2);
    CHECK_EQ(pair(20), 70);
    CHECK_EQ(pair(22), 80);
    CHECK_EQ(pair(24), 1 << 30);
    CHECK_EQ(pair(26), 0);
    CHECK_EQ(pair(40), 1 << 30);
    CHECK_EQ(read_block(0, 0), 2);
    CHECK_EQ(read_block(0, 1), 2);
    CHECK_EQ(read_block(0, 2), 0);  // no such block in this grid
    CHECK_EQ(read_block(0, CANOPY_BLOCK_MAX - 1), 0);
    CHECK_EQ(read_coverage(0), 2);
    CHECK_EQ(canopy_plc_sequence(&plc), 2);
    CHECK_EQ(canopy_plc_published(&plc)->points, 102);
}

UNIT(scales_are_exact_powers) {
    start(CANOPY_ABOVE);
    struct canopy_envelope *next = canopy_plc_begin(&plc);
    fill(next, 1);
    next->frame.quantum_log2 = -3;
    next->frame.lsb_log2 = 5;
    CHECK_EQ(canopy_plc_commit(&plc), CANOPY_OK);
    CHECK_EQ(read_pair(0, CANOPY_REGISTER_UNIT), 0x3D800000);  // 0.5 / 8
    CHECK_EQ(read_pair(0, CANOPY_REGISTER_LSB), 0x42000000);   // 32
    next = canopy_plc_begin(&plc);
    fill(next, 2);
    next->frame.quantum_log2 = -126;
    CHECK_EQ(canopy_plc_commit(&plc), CANOPY_RANGE);
    next->frame.quantum_log2 = 0;
    next->frame.lsb_log2 = 128;
    CHECK_EQ(canopy_plc_commit(&plc), CANOPY_RANGE);
    next->frame.lsb_log2 = -127;
    CHECK_EQ(canopy_plc_commit(&plc), CANOPY_RANGE);
    CHECK_EQ(read_pair(0, SEQUENCE), 1);
    next->frame.lsb_log2 = -126;
    CHECK_EQ(canopy_plc_commit(&plc), CANOPY_OK);
    CHECK_EQ(read_pair(0, SEQUENCE), 2);
    CHECK_EQ(read_pair(0, CANOPY_REGISTER_LSB), 0x00800000);
}

UNIT(a_wrong_envelope_is_not_published) {
    start(CANOPY_ABOVE);
    CHECK_EQ(canopy_plc_commit(&plc), CANOPY_ARGUMENT);
    struct canopy_envelope *next = canopy_plc_begin(&plc);
    CHECK(canopy_plc_begin(&plc) == next);
#define WRONG(member, value)                                                                                           \
    fill(next, 1);                                                                                                     \
    next->member = value;                                                                                              \
    CHECK_EQ(canopy_plc_commit(&plc), CANOPY_ARGUMENT)
    WRONG(frame.size[0], 3);
    WRONG(frame.size[1], 3);
    WRONG(frame.size[0], M + 1);
    WRONG(frame.side, CANOPY_BELOW);
    WRONG(scalar, CANOPY_F32);
    WRONG(margin, -1);
    WRONG(frame.pitch[0], 0);
    WRONG(frame.pitch[1], 0);
#undef WRONG
    CHECK_EQ(read_pair(0, SEQUENCE), 0);
    fill(next, 1);
    CHECK_EQ(canopy_plc_commit(&plc), CANOPY_OK);
    CHECK_EQ(read_pair(0, SEQUENCE), 1);
}

UNIT(publish_copies) {
    start(CANOPY_ABOVE);
    static int32_t coefficients[COUNT];
    static uint8_t coverage[CANOPY_COVERAGE_BYTES(M, N)];
    struct canopy_envelope mine = {.coefficients = coefficients, .coverage = coverage};
    fill(&mine, 1);
    CHECK_EQ(canopy_plc_publish(&plc, &mine), CANOPY_OK);
    memset(coefficients, 0, sizeof coefficients);
    CHECK_EQ(read_block(0, 0), 1);
    CHECK_EQ(read_coverage(0), 1);
    mine.frame.size[0] = M + 1;
    CHECK_EQ(canopy_plc_publish(&plc, &mine), CANOPY_ARGUMENT);
    fill(&mine, 2);
    CHECK_EQ(canopy_plc_publish(&plc, &mine), CANOPY_OK);
    CHECK_EQ(read_block(1, 1), 2);
    CHECK_EQ(read_block(0, 1), 1);
}

UNIT(a_hold_lasts_over_publications) {
    start(CANOPY_ABOVE);
    publish();
    CHECK_EQ(read_pair(0, SEQUENCE), 1);
    CHECK_EQ(read_block(0, 1), 1);
    for (int i = 0; i < 5; i++)
        publish();
    CHECK_EQ(read_pair(1, SEQUENCE), 6);
    publish();
    CHECK_EQ(read_block(0, 0), 1);
    CHECK_EQ(read_coverage(0), 1);
    CHECK_EQ(read_pair(0, CANOPY_REGISTER_POINTS), 101);
    CHECK_EQ(read_block(1, 0), 6);
    CHECK_EQ(read_pair(0, SEQUENCE), 7);
    CHECK_EQ(read_block(0, 0), 7);
}

UNIT(without_sequence_the_first_read_holds) {
    start(CANOPY_ABOVE);
    publish();
    CHECK_EQ(read_block(0, 0), 1);
    publish();
    CHECK_EQ(read_block(0, 1), 1);
    CHECK_EQ(read_block(0, 0), 2);  // asked again: the next pass
    CHECK_EQ(read_block(0, 1), 2);
}

UNIT(polling_one_register_follows_the_newest) {
    start(CANOPY_ABOVE);
    publish();
    CHECK_EQ(read_pair(0, SEQUENCE), 1);
    CHECK_EQ(read_pair(0, CANOPY_REGISTER_POINTS), 101);
    publish();
    CHECK_EQ(read_pair(0, CANOPY_REGISTER_POINTS), 102);
    publish();
    CHECK_EQ(read_pair(0, CANOPY_REGISTER_POINTS), 103);
    CHECK_EQ(read_coverage(0), 3);
    publish();
    CHECK_EQ(read_coverage(0), 4);
}

UNIT(parts_of_a_block_belong_together) {
    start(CANOPY_ABOVE);
    publish();
    CHECK_EQ(ask(0, BLOCK_0, 62), 0);
    CHECK_EQ(pair(0), 1);
    publish();
    CHECK_EQ(ask(0, BLOCK_0 + 62, 62), 0);
    CHECK_EQ((int32_t)pair(0), coefficient(1, 30));
    CHECK_EQ(ask(0, BLOCK_0 + 61, 2), 0);  // the low half of 29, the high half of 30
    CHECK_EQ(word(0), (uint16_t)coefficient(1, 29));
    CHECK_EQ(word(1), (uint32_t)coefficient(1, 30) >> 16);
    CHECK_EQ(ask(0, SEQUENCE, 1), 0);
    publish();
    CHECK_EQ(ask(0, SEQUENCE + 1, 1), 0);
    CHECK_EQ(word(0), 2);
}

UNIT(one_request_spans_blocks) {
    start(CANOPY_ABOVE);
    publish();
    CHECK_EQ(ask(0, BLOCK_0 + 100, 125), 0);
    CHECK_EQ((int32_t)pair(0), coefficient(1, 49));
    CHECK_EQ(word(24), 0);  // the register between the blocks
    CHECK_EQ(pair(25), 1);
    CHECK_EQ((int32_t)pair(27), coefficient(1, 61));
    publish();
    CHECK_EQ(read_block(0, 1), 2);  // its sequence has been shown already
}

UNIT(a_withdrawal_breaks_holds) {
    start(CANOPY_ABOVE);
    publish();
    CHECK_EQ(read_pair(0, SEQUENCE), 1);
    CHECK_EQ(read_block(0, 0), 1);
    publish();
    canopy_plc_withdraw(&plc);
    CHECK_EQ(read_block(0, 1), 0);
    CHECK_EQ(read_coverage(0), 0);
    publish();
    CHECK_EQ(read_pair(0, CANOPY_REGISTER_POINTS), 0);  // still the broken hold
    CHECK_EQ(read_pair(0, SEQUENCE), 3);
    CHECK_EQ(read_block(0, 1), 3);
    canopy_plc_withdraw(&plc);
    CHECK_EQ(read_pair(0, SEQUENCE), 0);
    CHECK_EQ(read_block(0, 0), 0);
    publish();
    CHECK_EQ(read_block(0, 0), 4);
    CHECK_EQ(read_pair(0, CANOPY_REGISTER_WITHDRAWALS), 2);
    CHECK_EQ(read_pair(0, CANOPY_REGISTER_PUBLICATIONS), 4);
}

UNIT(live_status_is_never_held) {
    start(CANOPY_ABOVE);
    publish();
    CHECK_EQ(read_pair(0, SEQUENCE), 1);
    for (uint16_t i = 0; i < 3; i++) {
        station.live = (struct canopy_plc_live){.heartbeat = i, .status = CANOPY_PLC_VALID, .age_ms = 70000U + i};
        station.counters.rx_frames = 90000U + i;
        publish();
        CHECK_EQ(ask(0, CANOPY_REGISTER_HEARTBEAT, 8), 0);
        CHECK_EQ(word(0), i);
        CHECK_EQ(word(1), CANOPY_PLC_VALID);
        CHECK_EQ(pair(2), 70000 + i);
        CHECK_EQ(read_pair(0, CANOPY_REGISTER_RX_FRAMES), 90000 + i);
        CHECK_EQ(read_block(0, i < 2 ? i : 1), i < 2 ? 1 : 4);  // and does not touch the hold
    }
}

UNIT(the_sequence_skips_zero_when_it_wraps) {
    start(CANOPY_ABOVE);
    plc.sequence = UINT32_MAX - 1;
    publish();
    CHECK_EQ(read_pair(0, SEQUENCE), UINT32_MAX);
    fill(canopy_plc_begin(&plc), 1);
    CHECK_EQ(canopy_plc_commit(&plc), CANOPY_OK);
    CHECK_EQ(read_pair(0, SEQUENCE), 1);
}

UNIT(a_new_connection_starts_clean) {
    start(CANOPY_ABOVE);
    publish();
    CHECK_EQ(read_pair(0, SEQUENCE), 1);
    CHECK_EQ(write_pair(0, CANOPY_REGISTER_QUERY_X, 7), 0);
    CHECK_EQ(write_word(0, CANOPY_REGISTER_COMMAND, 0x0100), 0);
    publish();
    canopy_plc_forget(&plc, 0);
    canopy_plc_forget(&plc, CLIENTS);
    CHECK_EQ(read_block(0, 0), 2);
    CHECK_EQ(read_pair(0, CANOPY_REGISTER_QUERY_X), 0);
    CHECK_EQ(read_word(0, CANOPY_REGISTER_COMMAND_ECHO), 0);
}

UNIT(queries_are_per_client_and_fresh) {
    start(CANOPY_ABOVE);
    CHECK_EQ(write_pair(0, CANOPY_REGISTER_QUERY_X, 10), 0);
    CHECK_EQ(ask(0, CANOPY_REGISTER_QUERY_X, 9), 0);
    CHECK_EQ((int32_t)pair(4), INT32_MAX);
    CHECK_EQ(word(6), CANOPY_PLC_QUERY_NONE);
    CHECK_EQ(pair(7), 0);
    publish();
    CHECK_EQ(write_pair(0, CANOPY_REGISTER_QUERY_Y, (uint32_t)-4), 0);
    CHECK_EQ(ask(0, CANOPY_REGISTER_QUERY_X, 9), 0);
    CHECK_EQ(pair(0), 10);
    CHECK_EQ((int32_t)pair(2), -4);
    CHECK_EQ((int32_t)pair(4), 1000 + 20 - 12);
    CHECK_EQ(word(6), CANOPY_PLC_QUERY_GOOD);
    CHECK_EQ(pair(7), 1);
    CHECK_EQ(read_pair(1, CANOPY_REGISTER_QUERY_X), 0);
    publish();
    CHECK_EQ(read_pair(0, CANOPY_REGISTER_QUERY_SEQUENCE), 1);  // as long as the height is not asked again
    CHECK_EQ(read_pair(0, CANOPY_REGISTER_QUERY_HEIGHT), 2008);
    CHECK_EQ(read_pair(0, CANOPY_REGISTER_QUERY_SEQUENCE), 2);
    station.height_status = CANOPY_PLC_QUERY_UNCOVERED;
    CHECK_EQ((int32_t)read_pair(0, CANOPY_REGISTER_QUERY_HEIGHT), INT32_MAX);
    CHECK_EQ(read_word(0, CANOPY_REGISTER_QUERY_STATUS), CANOPY_PLC_QUERY_UNCOVERED);
    station.height_status = CANOPY_PLC_QUERY_GOOD;
    station.live.status = CANOPY_PLC_INTRUSION;
    CHECK_EQ((int32_t)read_pair(0, CANOPY_REGISTER_QUERY_HEIGHT), INT32_MAX);
    CHECK_EQ(read_word(0, CANOPY_REGISTER_QUERY_STATUS), CANOPY_PLC_QUERY_INTRUSION);
    station.live.status = 0;
    CHECK_EQ(read_pair(0, CANOPY_REGISTER_QUERY_HEIGHT), 2008);
    canopy_plc_withdraw(&plc);
    CHECK_EQ(read_word(0, CANOPY_REGISTER_QUERY_STATUS), CANOPY_PLC_QUERY_NONE);
    CHECK_EQ(read_pair(0, CANOPY_REGISTER_QUERY_SEQUENCE), 0);
}

// Asks a published envelope whose surface is `steps` high.
static int32_t height_of(uint8_t side, int32_t steps, int16_t lsb_log2, uint16_t status) {
    start(side);
    struct canopy_envelope *next = canopy_plc_begin(&plc);
    fill(next, 1);
    next->frame.lsb_log2 = lsb_log2;
    next->coefficients[0] = 0;
    CHECK_EQ(canopy_plc_commit(&plc), CANOPY_OK);
    station.height = steps;
    CHECK_EQ(ask(0, CANOPY_REGISTER_QUERY_HEIGHT, 3), 0);
    CHECK_EQ(word(2), status);
    return (int32_t)pair(0);
}

UNIT(heights_are_rounded_to_the_safe_side) {
    CHECK_EQ(height_of(CANOPY_ABOVE, 9, -2, 0), 3);
    CHECK_EQ(height_of(CANOPY_ABOVE, 8, -2, 0), 2);
    CHECK_EQ(height_of(CANOPY_ABOVE, -9, -2, 0), -2);
    CHECK_EQ(height_of(CANOPY_BELOW, 9, -2, 0), 2);
    CHECK_EQ(height_of(CANOPY_BELOW, -9, -2, 0), -3);
    CHECK_EQ(height_of(CANOPY_ABOVE, INT32_MIN, -40, 0), 0);
    CHECK_EQ(height_of(CANOPY_ABOVE, 1, -126, 0), 1);
    CHECK_EQ(height_of(CANOPY_BELOW, -1, -126, 0), -1);
    CHECK_EQ(height_of(CANOPY_ABOVE, INT32_MAX, 0, 0), INT32_MAX);
    CHECK_EQ(height_of(CANOPY_BELOW, INT32_MIN, 0, 0), INT32_MIN);
    CHECK_EQ(height_of(CANOPY_ABOVE, -3, 4, 0), -48);
    CHECK_EQ(height_of(CANOPY_ABOVE, -1, 31, 0), INT32_MIN);
    CHECK_EQ(height_of(CANOPY_ABOVE, 1, 31, CANOPY_PLC_QUERY_RANGE), INT32_MAX);
    CHECK_EQ(height_of(CANOPY_ABOVE, -3, 31, CANOPY_PLC_QUERY_RANGE), INT32_MAX);
    CHECK_EQ(height_of(CANOPY_BELOW, 1, 100, CANOPY_PLC_QUERY_RANGE), INT32_MIN);
    CHECK_EQ(height_of(CANOPY_BELOW, 0, 100, 0), 0);
}

UNIT(another_unit_withdraws) {
    start(CANOPY_ABOVE);
    publish();
    CHECK_EQ(canopy_plc_set_unit(&plc, 0.5f), CANOPY_OK);  // the one there is
    CHECK_EQ(read_pair(0, SEQUENCE), 1);
    CHECK_EQ(canopy_plc_set_unit(&plc, 0.0f), CANOPY_ARGUMENT);
    CHECK_EQ(canopy_plc_set_unit(&plc, -2.0f), CANOPY_ARGUMENT);
    CHECK_EQ(read_block(0, 0), 1);
    CHECK_EQ(canopy_plc_set_unit(&plc, 2.0f), CANOPY_OK);
    CHECK_EQ(read_block(0, 1), 0);
    publish();
    CHECK_EQ(ask(0, SEQUENCE, 44), 0);
    CHECK_EQ(pair(0), 2);
    CHECK_EQ(pair(8), 0x40000000);
}

UNIT(commands_run_once) {
    start(CANOPY_ABOVE);
    CHECK_EQ(write_word(0, CANOPY_REGISTER_COMMAND, 0x0101), 0);
    CHECK_EQ(station.commands, 1);
    CHECK_EQ(station.last, CANOPY_PLC_COMMAND_REFIT);
    CHECK_EQ(ask(0, CANOPY_REGISTER_COMMAND, 3), 0);
    CHECK_EQ(word(0), 0x0101);
    CHECK_EQ(word(1), 0x0101);
    CHECK_EQ(word(2), CANOPY_PLC_RESULT_DONE);
    CHECK_EQ(write_word(0, CANOPY_REGISTER_COMMAND, 0x0101), 0);  // a repetition
    CHECK_EQ(station.commands, 1);
    CHECK_EQ(write_word(1, CANOPY_REGISTER_COMMAND, 0x0101), 0);  // another client
    CHECK_EQ(station.commands, 2);
    CHECK_EQ(write_word(0, CANOPY_REGISTER_COMMAND, 0x0001), 0);  // without a number: always
    CHECK_EQ(write_word(0, CANOPY_REGISTER_COMMAND, 0x0001), 0);
    CHECK_EQ(station.commands, 4);
    station.result = CANOPY_PLC_RESULT_REFUSED;
    CHECK_EQ(write_word(0, CANOPY_REGISTER_COMMAND, 0x0202), 0);
    CHECK_EQ(read_word(0, CANOPY_REGISTER_COMMAND_RESULT), CANOPY_PLC_RESULT_REFUSED);
    CHECK_EQ(write_word(0, CANOPY_REGISTER_COMMAND, 0x0300 + CANOPY_PLC_COMMANDS), CANOPY_MODBUS_ILLEGAL_VALUE);
    CHECK_EQ(read_word(0, CANOPY_REGISTER_COMMAND_ECHO), 0x0202);
    CHECK_EQ(station.commands, 5);
    CHECK_EQ(write_word(0, CANOPY_REGISTER_COMMAND, 0x0400), 0);  // nothing, done
    CHECK_EQ(station.commands, 5);
    CHECK_EQ(read_word(0, CANOPY_REGISTER_COMMAND_RESULT), CANOPY_PLC_RESULT_DONE);
    CHECK_EQ(read_pair(0, CANOPY_REGISTER_COMMANDS), 6);
}

UNIT(a_command_may_withdraw) {
    start(CANOPY_ABOVE);
    publish();
    CHECK_EQ(read_pair(1, SEQUENCE), 1);
    station.withdraws = true;
    CHECK_EQ(write_word(0, CANOPY_REGISTER_COMMAND, CANOPY_PLC_COMMAND_WITHDRAW), 0);
    CHECK_EQ(read_block(1, 0), 0);
}

UNIT(what_cannot_be_read_is_an_exception) {
    start(CANOPY_ABOVE);
    CHECK_EQ(ask(0, 0, 0), CANOPY_MODBUS_ILLEGAL_VALUE);
    CHECK_EQ(ask(0, 0, 126), CANOPY_MODBUS_ILLEGAL_VALUE);
    CHECK_EQ(ask(CLIENTS, 0, 1), CANOPY_MODBUS_FAILURE);
    CHECK_EQ(ask(0, CANOPY_MAP_END - 1, 1), 0);
    CHECK_EQ(ask(0, CANOPY_MAP_END - 1, 2), CANOPY_MODBUS_ILLEGAL_ADDRESS);
    CHECK_EQ(ask(0, CANOPY_MAP_END, 1), CANOPY_MODBUS_ILLEGAL_ADDRESS);
    CHECK_EQ(ask(0, 65535, 1), CANOPY_MODBUS_ILLEGAL_ADDRESS);
    CHECK_EQ(ask(0, 65535, 125), CANOPY_MODBUS_ILLEGAL_ADDRESS);
    CHECK_EQ(ask(0, 38, 62), CANOPY_MODBUS_ILLEGAL_ADDRESS);  // between identity and live
    CHECK_EQ(ask(0, 38, 63), 0);
    CHECK_EQ(ask(0, 37, 62), 0);
    CHECK_EQ(ask(0, 5000, 125), CANOPY_MODBUS_ILLEGAL_ADDRESS);
    CHECK_EQ(ask(0, BLOCK_0 + 124, 1), CANOPY_MODBUS_ILLEGAL_ADDRESS);
    CHECK_EQ(ask(0, BLOCK_0 + 124, 2), 0);
    CHECK_EQ(ask(0, BLOCK_0 - 1, 1), CANOPY_MODBUS_ILLEGAL_ADDRESS);
}

UNIT(what_cannot_be_written_is_an_exception) {
    start(CANOPY_ABOVE);
    const uint8_t zeros[250] = {0};
    CHECK_EQ(write_word(0, CANOPY_REGISTER_STATUS, 1), CANOPY_MODBUS_ILLEGAL_ADDRESS);
    CHECK_EQ(write_pair(0, SEQUENCE, 1), CANOPY_MODBUS_ILLEGAL_ADDRESS);
    CHECK_EQ(write_word(0, BLOCK_0, 1), CANOPY_MODBUS_ILLEGAL_ADDRESS);
    CHECK_EQ(write_word(0, 5000, 1), CANOPY_MODBUS_ILLEGAL_ADDRESS);
    CHECK_EQ(write_word(0, 65535, 1), CANOPY_MODBUS_ILLEGAL_ADDRESS);
    CHECK_EQ(write_word(0, CANOPY_REGISTER_QUERY_X, 1), CANOPY_MODBUS_ILLEGAL_ADDRESS);      // half
    CHECK_EQ(write_word(0, CANOPY_REGISTER_QUERY_X + 1, 1), CANOPY_MODBUS_ILLEGAL_ADDRESS);  // the other half
    CHECK_EQ(write_pair(0, CANOPY_REGISTER_QUERY_X + 1, 1), CANOPY_MODBUS_ILLEGAL_ADDRESS);  // two halves
    CHECK_EQ(canopy_plc_write(&plc, 0, CANOPY_REGISTER_QUERY_X, 3, zeros, 16), CANOPY_MODBUS_ILLEGAL_ADDRESS);
    CHECK_EQ(canopy_plc_write(&plc, 0, CANOPY_REGISTER_QUERY_X, 4, zeros, 16), 0);
    CHECK_EQ(canopy_plc_write(&plc, 0, CANOPY_REGISTER_QUERY_X, 5, zeros, 16), CANOPY_MODBUS_ILLEGAL_ADDRESS);
    CHECK_EQ(canopy_plc_write(&plc, 0, CANOPY_REGISTER_COMMAND, 2, zeros, 16), CANOPY_MODBUS_ILLEGAL_ADDRESS);
    CHECK_EQ(canopy_plc_write(&plc, 0, CANOPY_REGISTER_QUERY_X, 0, zeros, 16), CANOPY_MODBUS_ILLEGAL_VALUE);
    CHECK_EQ(canopy_plc_write(&plc, 0, CANOPY_REGISTER_QUERY_X, 124, zeros, 16), CANOPY_MODBUS_ILLEGAL_VALUE);
    CHECK_EQ(canopy_plc_write(&plc, CLIENTS, CANOPY_REGISTER_QUERY_X, 2, zeros, 16), CANOPY_MODBUS_FAILURE);
    CHECK_EQ(station.commands, 0);
}

UNIT_LIST(plc, init_says_what_is_wrong, identity_shows_the_word_order, without_an_envelope_everything_is_unknown,
          an_envelope_is_served_whole, scales_are_exact_powers, a_wrong_envelope_is_not_published, publish_copies,
          a_hold_lasts_over_publications, without_sequence_the_first_read_holds,
          polling_one_register_follows_the_newest, parts_of_a_block_belong_together, one_request_spans_blocks,
          a_withdrawal_breaks_holds, live_status_is_never_held, the_sequence_skips_zero_when_it_wraps,
          a_new_connection_starts_clean, queries_are_per_client_and_fresh, heights_are_rounded_to_the_safe_side,
          another_unit_withdraws, commands_run_once, a_command_may_withdraw, what_cannot_be_read_is_an_exception,
          what_cannot_be_written_is_an_exception)
