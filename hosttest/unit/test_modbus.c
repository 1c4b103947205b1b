// Modbus on known bytes: every function, every exception, framing over RTU and TCP. Small enough for the device.
#include "hosttest/modbus_table.h"
#include "hosttest/unit/unit.h"
#include "lib/modbus/crc.h"
#include "lib/modbus/rtu.h"
#include "lib/modbus/tcp.h"

static struct table table;
static struct canopy_modbus_bank bank;
static struct canopy_modbus_rtu_server rtu;
static struct canopy_modbus_tcp_server tcp;
static struct canopy_modbus_rtu_client rtu_client;
static struct canopy_modbus_tcp_client tcp_client;
static uint64_t now_us;

enum { UNIT_ID = 17, CLIENT = 3, SILENCE_US = 1750 };

static void start(void) {
    table_init(&table, &bank);
    now_us = 1000000;
    const struct canopy_modbus_rtu_server_config config = {.bank = &bank, .unit = UNIT_ID, .client = CLIENT};
    CHECK_EQ(canopy_modbus_rtu_server_init(&rtu, &config), CANOPY_OK);
    const struct canopy_modbus_tcp_server_config tcp_config = {.bank = &bank, .unit = UNIT_ID, .client = CLIENT};
    CHECK_EQ(canopy_modbus_tcp_server_init(&tcp, &tcp_config), CANOPY_OK);
}

// ---------------------------------------------------------------------------------------------------------------------
// PDUs

static uint8_t pdu[CANOPY_MODBUS_PDU_MAX];

#define SERVE(...) serve((const uint8_t[]){__VA_ARGS__}, sizeof((const uint8_t[]){__VA_ARGS__}), false)

static size_t serve(const uint8_t *request, size_t length, bool broadcast) {
    memset(pdu, 0xEE, sizeof pdu);
    memcpy(pdu, request, length);
    return canopy_modbus_serve(&bank, CLIENT, broadcast, pdu, length);
}

static void check_pdu(size_t length, const uint8_t *wanted, size_t wanted_length) {
    CHECK_EQ(length, wanted_length);
    CHECK_BYTES(pdu, wanted, wanted_length);
}

#define CHECK_PDU(length, ...)                                                                                         \
    check_pdu((length), (const uint8_t[]){__VA_ARGS__}, sizeof((const uint8_t[]){__VA_ARGS__}))

UNIT(crc_has_published_values) {
    uint8_t text[11] = "123456789";
    CHECK_EQ(canopy_modbus_crc(CANOPY_MODBUS_CRC_START, text, 9), 0x4B37);
    CHECK_EQ(canopy_modbus_crc_append(text, 9), 11);
    CHECK(canopy_modbus_crc_ok(text, 11));
    text[4] ^= 0x10;
    CHECK(!canopy_modbus_crc_ok(text, 11));
    CHECK(canopy_modbus_crc_ok((const uint8_t[]){0x01, 0x03, 0x00, 0x00, 0x00, 0x01, 0x84, 0x0A}, 8));
    CHECK(canopy_modbus_crc_ok((const uint8_t[]){0x01, 0x04, 0x00, 0x01, 0x00, 0x27, 0xE1, 0xD0}, 8));
    CHECK(!canopy_modbus_crc_ok((const uint8_t[]){0xFF, 0xFF}, 2));
}

UNIT(reads) {
    start();
    CHECK_PDU(SERVE(3, 0, 0, 0, 2), 3, 4, 0x12, 0x34, 0x12, 0x3B);
    CHECK_PDU(SERVE(4, 0, 1, 0, 1), 4, 2, 0x12, 0x3B);
    CHECK_EQ(table.client, CLIENT);
    CHECK_EQ(SERVE(3, 0, 0, 0, 125), 252);
    CHECK_EQ(pdu[1], 250);
    CHECK_EQ(table.reads, 3);
    CHECK_PDU(SERVE(3, 1, 43, 0, 1), 3, 2, 0x1A, 0x61);  // the last register, 299
}

static uint8_t read_any(void *context, uint8_t client, uint16_t address, uint16_t count, uint8_t *to) {
    (void)context;
    (void)client;
    (void)address;
    memset(to, 0x77, 2u * count);
    return CANOPY_MODBUS_NO_EXCEPTION;
}

UNIT(reads_end_at_65535) {
    start();
    bank.read = read_any;
    CHECK_PDU(SERVE(3, 0xFF, 0xFF, 0, 1), 3, 2, 0x77, 0x77);
    CHECK_PDU(SERVE(4, 0xFF, 0xFE, 0, 2), 4, 4, 0x77, 0x77, 0x77, 0x77);
    CHECK_PDU(SERVE(4, 0xFF, 0xFE, 0, 3), 0x84, 2);
}

UNIT(reads_are_refused) {
    start();
    for (uint8_t function = 3; function <= 4; function++) {
        const uint8_t refusal = function | 0x80;
        CHECK_PDU(SERVE(function, 0, 0, 0, 0), refusal, 3);
        CHECK_PDU(SERVE(function, 0, 0, 0, 126), refusal, 3);
        CHECK_PDU(SERVE(function, 0, 0, 1, 0), refusal, 3);
        CHECK_PDU(SERVE(function, 0xFF, 0xFF, 0xFF, 0xFF), refusal, 3);
        CHECK_PDU(SERVE(function, 1, 44, 0, 1), refusal, 2);
        CHECK_PDU(SERVE(function, 1, 43, 0, 2), refusal, 2);
        CHECK_PDU(SERVE(function, 0xFF, 0xFF, 0, 2), refusal, 2);
        CHECK_PDU(SERVE(function), refusal, 3);
        CHECK_PDU(SERVE(function, 0, 0, 0), refusal, 3);
        CHECK_PDU(SERVE(function, 0, 0, 0, 1, 0), refusal, 3);
    }
    CHECK_EQ(table.reads, 0);
    table.fail = CANOPY_MODBUS_BUSY;
    CHECK_PDU(SERVE(3, 0, 0, 0, 1), 0x83, 6);
    table.fail = CANOPY_MODBUS_FAILURE;
    CHECK_PDU(SERVE(4, 0, 0, 0, 1), 0x84, 4);
}

UNIT(writes_one) {
    start();
    CHECK_PDU(SERVE(6, 0, 5, 0xAB, 0xCD), 6, 0, 5, 0xAB, 0xCD);
    CHECK_EQ(table.registers[5], 0xABCD);
    CHECK_EQ(table.function, 6);
    CHECK_PDU(SERVE(6, 0, 6, 0xDE, 0xAD), 0x86, 3);
    CHECK_PDU(SERVE(6, 1, 44, 0, 1), 0x86, 2);
    CHECK_PDU(SERVE(6, 0, 5, 0), 0x86, 3);
    CHECK_PDU(SERVE(6, 0, 5, 0, 0, 0), 0x86, 3);
    CHECK_EQ(table.writes, 1);
}

UNIT(writes) {
    start();
    CHECK_PDU(SERVE(16, 0, 9, 0, 2, 4, 1, 2, 3, 4), 16, 0, 9, 0, 2);
    CHECK_EQ(table.registers[9], 0x0102);
    CHECK_EQ(table.registers[10], 0x0304);
    CHECK_EQ(table.function, 16);
    CHECK_PDU(SERVE(16, 0, 9, 0, 2, 3, 1, 2, 3, 4), 0x90, 3);     // byte count
    CHECK_PDU(SERVE(16, 0, 9, 0, 2, 2, 1, 2), 0x90, 3);           // byte count and length agree, the count does not
    CHECK_PDU(SERVE(16, 0, 9, 0, 2, 4, 1, 2, 3), 0x90, 3);        // too short
    CHECK_PDU(SERVE(16, 0, 9, 0, 2, 4, 1, 2, 3, 4, 5), 0x90, 3);  // too long
    CHECK_PDU(SERVE(16, 0, 9, 0, 2), 0x90, 3);
    CHECK_PDU(SERVE(16, 0, 9, 0, 0, 0), 0x90, 3);
    CHECK_PDU(SERVE(16, 1, 43, 0, 2, 4, 1, 2, 3, 4), 0x90, 2);
    CHECK_PDU(SERVE(16, 0xFF, 0xFF, 0, 2, 4, 1, 2, 3, 4), 0x90, 2);
    CHECK_PDU(SERVE(16, 0, 9, 0, 2, 4, 9, 9, 0xDE, 0xAD), 0x90, 3);
    CHECK_EQ(table.registers[9], 0x0102);
    CHECK_EQ(table.writes, 1);
    uint8_t most[6 + 2 * 123] = {16, 0, 0, 0, 123, 246};
    CHECK_PDU(serve(most, sizeof most, false), 16, 0, 0, 0, 123);
    uint8_t more[6 + 2 * 123] = {16, 0, 0, 0, 124, 248};
    CHECK_PDU(serve(more, sizeof more, false), 0x90, 3);
}

UNIT(exchanges_write_first) {
    start();
    CHECK_PDU(SERVE(23, 0, 9, 0, 2, 0, 10, 0, 1, 2, 0x55, 0xAA), 23, 4, 0x12, 0x73, 0x55, 0xAA);
    CHECK_EQ(table.function, 23);
    CHECK_EQ(table.writes, 1);
    CHECK_PDU(SERVE(23, 0, 9, 0, 0, 0, 10, 0, 1, 2, 1, 1), 0x97, 3);
    CHECK_PDU(SERVE(23, 0, 9, 0, 126, 0, 10, 0, 1, 2, 1, 1), 0x97, 3);
    CHECK_PDU(SERVE(23, 0, 9, 0, 2, 0, 10, 0, 0, 0), 0x97, 3);
    CHECK_PDU(SERVE(23, 0, 9, 0, 2, 0, 10, 0, 1, 4, 1, 1), 0x97, 3);  // declares more than there is
    CHECK_PDU(SERVE(23, 0, 9, 0, 2, 0, 10, 0, 2, 4, 1, 1), 0x97, 3);
    CHECK_PDU(SERVE(23, 0, 9, 0, 2, 0, 10, 0, 1, 2, 1, 1, 1), 0x97, 3);  // declares less than there is
    CHECK_PDU(SERVE(23, 0, 9, 0, 2, 0, 10, 0, 1, 4, 1, 1, 1, 1), 0x97, 3);
    CHECK_PDU(SERVE(23, 0, 9, 0, 2, 0, 10, 0, 1, 0, 1, 1), 0x97, 3);
    CHECK_PDU(SERVE(23, 0, 9, 0, 2, 0, 10, 0, 1, 255, 1, 1), 0x97, 3);
    CHECK_PDU(SERVE(23, 0, 9, 0, 2, 0, 10, 0, 1), 0x97, 3);
    CHECK_PDU(SERVE(23), 0x97, 3);
    CHECK_PDU(SERVE(23, 1, 44, 0, 1, 0, 10, 0, 1, 2, 1, 1), 0x97, 2);  // nothing to read: nothing written
    CHECK_PDU(SERVE(23, 0xFF, 0xFF, 0, 2, 0, 10, 0, 1, 2, 1, 1), 0x97, 2);
    CHECK_PDU(SERVE(23, 0, 9, 0, 2, 0xFF, 0xFF, 0, 2, 4, 1, 1, 1, 1), 0x97, 2);
    CHECK_PDU(SERVE(23, 0, 9, 0, 2, 1, 44, 0, 1, 2, 1, 1), 0x97, 2);
    CHECK_EQ(table.writes, 1);
    uint8_t most[10 + 2 * 121] = {23, 0, 0, 0, 125, 0, 0, 0, 121, 242};
    CHECK_EQ(serve(most, sizeof most, false), 252);
    uint8_t more[10 + 2 * 121] = {23, 0, 0, 0, 125, 0, 0, 0, 122, 244};
    CHECK_PDU(serve(more, sizeof more, false), 0x97, 3);
    bank.readable = NULL;
    CHECK_PDU(SERVE(23, 1, 44, 0, 1, 0, 10, 0, 1, 2, 1, 1), 0x97, 2);
    CHECK_EQ(table.registers[10], 0x0101);  // as the header says: the write stands
}

UNIT(other_functions_are_illegal) {
    start();
    for (unsigned function = 0; function < 256; function++) {
        if (function == 3 || function == 4 || function == 6 || function == 16 || function == 23 || function == 43)
            continue;
        CHECK_PDU(SERVE((uint8_t)function, 0, 0, 0, 1), (uint8_t)(function | 0x80), 1);
        CHECK_PDU(SERVE((uint8_t)function), (uint8_t)(function | 0x80), 1);
    }
}

UNIT(broadcast_writes_and_is_silent) {
    start();
    CHECK_EQ(serve((const uint8_t[]){6, 0, 1, 0, 7}, 5, true), 0);
    CHECK_EQ(table.registers[1], 7);
    CHECK_EQ(serve((const uint8_t[]){16, 0, 2, 0, 1, 2, 0, 8}, 8, true), 0);
    CHECK_EQ(table.registers[2], 8);
    CHECK_EQ(serve((const uint8_t[]){23, 0, 0, 0, 1, 0, 3, 0, 1, 2, 0, 9}, 12, true), 0);
    CHECK_EQ(table.registers[3], 9);
    CHECK_EQ(serve((const uint8_t[]){3, 0, 0, 0, 1}, 5, true), 0);
    CHECK_EQ(serve((const uint8_t[]){43, 14, 1, 0}, 4, true), 0);
    CHECK_EQ(serve((const uint8_t[]){99}, 1, true), 0);
    CHECK_EQ(serve((const uint8_t[]){6, 0, 1}, 3, true), 0);
    CHECK_EQ(table.reads, 0);
    CHECK_EQ(table.writes, 3);
}

UNIT(identifies) {
    start();
    table.objects[0] = "Vendor";
    table.objects[1] = "P";
    CHECK_PDU(SERVE(43, 14, 1, 0), 43, 14, 1, 0x81, 0, 0, 3, 0, 6, 'V', 'e', 'n', 'd', 'o', 'r', 1, 1, 'P', 2, 0);
    CHECK_PDU(SERVE(43, 14, 1, 1), 43, 14, 1, 0x81, 0, 0, 2, 1, 1, 'P', 2, 0);
    CHECK_PDU(SERVE(43, 14, 2, 2), 43, 14, 2, 0x81, 0, 0, 1, 2, 0);
    table.objects[5] = "M";
    CHECK_PDU(SERVE(43, 14, 2, 1), 43, 14, 2, 0x82, 0, 0, 3, 1, 1, 'P', 2, 0, 5, 1, 'M');
    CHECK_PDU(SERVE(43, 14, 3, 5), 43, 14, 3, 0x82, 0, 0, 1, 5, 1, 'M');
    CHECK_PDU(SERVE(43, 14, 4, 5), 43, 14, 4, 0x82, 0, 0, 1, 5, 1, 'M');
    CHECK_PDU(SERVE(43, 14, 4, 2), 43, 14, 4, 0x82, 0, 0, 1, 2, 0);
    CHECK_EQ(SERVE(43, 14, 1, 5), 7 + 8 + 3 + 2);      // not a basic object: the stream starts over
    CHECK_EQ(SERVE(43, 14, 2, 4), 7 + 8 + 3 + 2 + 3);  // nor is there a 4
    CHECK_EQ(SERVE(43, 14, 2, 200), 7 + 8 + 3 + 2 + 3);
    CHECK_PDU(SERVE(43, 14, 4, 4), 0xAB, 2);
    CHECK_PDU(SERVE(43, 14, 4, 7), 0xAB, 2);
    CHECK_PDU(SERVE(43, 14, 4, 255), 0xAB, 2);
    CHECK_PDU(SERVE(43, 14, 0, 0), 0xAB, 3);
    CHECK_PDU(SERVE(43, 14, 5, 0), 0xAB, 3);
    CHECK_PDU(SERVE(43, 14, 1), 0xAB, 3);
    CHECK_PDU(SERVE(43, 14, 1, 0, 0), 0xAB, 3);
    CHECK_PDU(SERVE(43), 0xAB, 3);
    CHECK_PDU(SERVE(43, 13, 0, 0), 0xAB, 1);
    bank.identify = NULL;
    CHECK_PDU(SERVE(43, 14, 1, 0), 0xAB, 1);
}

UNIT(identification_goes_on) {
    static char text[300];
    start();
    memset(text, 'x', sizeof text - 1);
    text[200] = 0;
    table.objects[0] = text;
    table.objects[1] = text;
    table.objects[2] = "1.0";
    CHECK_EQ(SERVE(43, 14, 1, 0), 7 + 2 + 200);
    CHECK_EQ(pdu[4], 0xFF);
    CHECK_EQ(pdu[5], 1);
    CHECK_EQ(pdu[6], 1);
    CHECK_EQ(SERVE(43, 14, 1, 1), 7 + 2 + 200 + 2 + 3);
    CHECK_EQ(pdu[4], 0);
    CHECK_EQ(pdu[5], 0);
    CHECK_EQ(pdu[6], 2);
    text[200] = 'x';  // now 299 bytes: cut to what a reply can hold
    CHECK_EQ(SERVE(43, 14, 4, 0), CANOPY_MODBUS_PDU_MAX);
    CHECK_EQ(pdu[8], CANOPY_MODBUS_OBJECT_MAX);
    CHECK_EQ(SERVE(43, 14, 1, 0), CANOPY_MODBUS_PDU_MAX);
    CHECK_EQ(pdu[5], 1);
}

UNIT(lengths) {
    const uint8_t write[] = {16, 0, 0, 0, 2, 4};
    for (size_t have = 0; have < 6; have++)
        CHECK_EQ(canopy_modbus_request_length(write, have), 0);
    CHECK_EQ(canopy_modbus_request_length(write, 6), 10);
    CHECK_EQ(canopy_modbus_response_length(write, 1), 5);
    const uint8_t queue[] = {24, 1, 0};
    CHECK_EQ(canopy_modbus_response_length(queue, 2), 0);
    CHECK_EQ(canopy_modbus_response_length(queue, 3), 3 + 256);
    const uint8_t exchange[] = {23, 0, 0, 0, 2, 0, 0, 0, 2, 255};
    CHECK_EQ(canopy_modbus_request_length(exchange, 10), 265);
    CHECK_EQ(canopy_modbus_response_length(exchange, 1), 0);
    const uint8_t objects[] = {43, 14, 1, 0x81, 0, 0, 2, 0, 1, 'x', 1, 0};
    for (size_t have = 0; have < 12; have++)
        CHECK_EQ(canopy_modbus_response_length(objects, have), 0);
    CHECK_EQ(canopy_modbus_response_length(objects, 12), 12);
    CHECK_EQ(canopy_modbus_request_length(objects, 2), 4);
    CHECK_EQ(canopy_modbus_request_length((const uint8_t[]){99}, 1), CANOPY_MODBUS_LENGTH_OPEN);
    CHECK_EQ(canopy_modbus_response_length((const uint8_t[]){99}, 1), CANOPY_MODBUS_LENGTH_OPEN);
    CHECK_EQ(canopy_modbus_response_length((const uint8_t[]){0x83}, 1), 2);
}

// ---------------------------------------------------------------------------------------------------------------------
// RTU server

static uint8_t frame[2 * CANOPY_MODBUS_RTU_ADU_MAX];

// Puts a frame with its CRC at `at` of `frame`; returns where it ends.
static size_t put(size_t at, const uint8_t *bytes, size_t length) {
    memcpy(frame + at, bytes, length);
    return at + table_crc(frame + at, length);
}

#define PUT(at, ...) put((at), (const uint8_t[]){__VA_ARGS__}, sizeof((const uint8_t[]){__VA_ARGS__}))

// Feeds bytes [from, to) of `frame` after `gap_us`.
static void hear(size_t from, size_t to, uint64_t gap_us) {
    now_us += gap_us;
    canopy_modbus_rtu_server_feed(&rtu, frame + from, to - from, now_us);
}

// The reply after a silence: checked, and sent. An empty one means no reply.
static void check_reply(const uint8_t *wanted, size_t wanted_length) {
    const uint8_t *reply;
    CHECK_EQ(canopy_modbus_rtu_server_poll(&rtu, rtu.last_us + SILENCE_US - 1, &reply), 0);
    now_us += SILENCE_US;
    const size_t length = canopy_modbus_rtu_server_poll(&rtu, now_us, &reply);
    CHECK_EQ(length, wanted_length ? wanted_length + 2 : 0);
    if (length == 0)
        return;
    CHECK_BYTES(reply, wanted, wanted_length);
    CHECK(canopy_modbus_crc_ok(reply, length));
    canopy_modbus_rtu_server_sent(&rtu, length, now_us);
    CHECK_EQ(canopy_modbus_rtu_server_poll(&rtu, now_us + 10000000, &reply), 0);
}

#define CHECK_REPLY(...) check_reply((const uint8_t[]){__VA_ARGS__}, sizeof((const uint8_t[]){__VA_ARGS__}))
#define CHECK_NO_REPLY() check_reply(NULL, 0)

UNIT(rtu_configuration_is_checked) {
    start();
    struct canopy_modbus_rtu_server_config config = {.bank = &bank, .unit = 1};
    CHECK_EQ(canopy_modbus_rtu_server_init(&rtu, &config), CANOPY_OK);
    config.unit = 0;
    CHECK_EQ(canopy_modbus_rtu_server_init(&rtu, &config), CANOPY_ARGUMENT);
    config.unit = 248;
    CHECK_EQ(canopy_modbus_rtu_server_init(&rtu, &config), CANOPY_ARGUMENT);
    config.unit = 247;
    config.character_bits = 9;
    CHECK_EQ(canopy_modbus_rtu_server_init(&rtu, &config), CANOPY_ARGUMENT);
    config.character_bits = 10;
    config.pause_us = 100;
    CHECK_EQ(canopy_modbus_rtu_server_init(&rtu, &config), CANOPY_ARGUMENT);
    config.pause_us = 1750;
    CHECK_EQ(canopy_modbus_rtu_server_init(&rtu, &config), CANOPY_OK);
    bank.read = NULL;
    CHECK_EQ(canopy_modbus_rtu_server_init(&rtu, &config), CANOPY_ARGUMENT);
    config.bank = NULL;
    CHECK_EQ(canopy_modbus_rtu_server_init(&rtu, &config), CANOPY_ARGUMENT);
    CHECK_EQ(canopy_modbus_rtu_silence_us(9600), 4011);
    CHECK_EQ(canopy_modbus_rtu_silence_us(19200), 2006);
    CHECK_EQ(canopy_modbus_rtu_silence_us(19201), 1750);
    CHECK_EQ(canopy_modbus_rtu_silence_us(0), 1750);
    CHECK(sizeof rtu <= 368);
}

UNIT(rtu_answers) {
    start();
    hear(0, PUT(0, UNIT_ID, 3, 0, 0, 0, 1), 10000);
    CHECK_EQ(canopy_modbus_rtu_server_due(&rtu), now_us + SILENCE_US);
    CHECK_REPLY(UNIT_ID, 3, 2, 0x12, 0x34);
    CHECK_EQ(canopy_modbus_rtu_server_due(&rtu), CANOPY_MODBUS_RTU_NEVER);
    const size_t end = PUT(0, UNIT_ID, 16, 0, 9, 0, 2, 4, 1, 2, 3, 4);
    for (size_t i = 0; i < end; i++)
        hear(i, i + 1, 500);
    CHECK_REPLY(UNIT_ID, 16, 0, 9, 0, 2);
    hear(0, PUT(0, UNIT_ID, 99), 10000);
    CHECK_REPLY(UNIT_ID, 0xE3, 1);
    hear(0, PUT(0, UNIT_ID, 3, 0, 0, 0, 1, 0), 10000);  // one byte too many
    CHECK_REPLY(UNIT_ID, 0x83, 3);
    CHECK_EQ(rtu.rx_frames, 4);
    CHECK_EQ(rtu.rx_errors, 0);
}

// Zeros behind a right CRC leave it right: such bytes can be a frame that goes on, or one with a disturbance behind it.
UNIT(rtu_waits_where_a_crc_is_right_too_early) {
    start();
    hear(0, PUT(0, UNIT_ID, 3), 10000);
    CHECK_NO_REPLY();
    now_us += CANOPY_MODBUS_RTU_PAUSE_US;
    CHECK_REPLY(UNIT_ID, 0x83, 3);
    // the first value whose CRC ends in zero: right without its last byte
    size_t end;
    uint16_t value = 0;
    do
        end = PUT(0, UNIT_ID, 6, 0, 1, (uint8_t)(value >> 8), (uint8_t)(value & 0xFF));
    while (frame[end - 1] != 0 && ++value != 0);
    CHECK(canopy_modbus_crc_ok(frame, end - 1));
    hear(0, end - 1, 10000);
    CHECK_NO_REPLY();
    hear(end - 1, end, 10000);
    CHECK_REPLY(UNIT_ID, 6, 0, 1, (uint8_t)(value >> 8), (uint8_t)(value & 0xFF));
    end = PUT(0, UNIT_ID, 6, 0, 1, 0, 9);
    frame[end] = 0;
    hear(0, end + 1, 10000);
    CHECK_NO_REPLY();
    CHECK_EQ(table.registers[1], value);
}

UNIT(rtu_is_silent_when_it_must) {
    start();
    hear(0, PUT(0, UNIT_ID + 1, 3, 0, 0, 0, 1), 10000);
    CHECK_NO_REPLY();
    hear(0, PUT(0, UNIT_ID + 1, 3, 2, 0, 0), 10000);
    CHECK_NO_REPLY();
    hear(0, PUT(0, 0, 6, 0, 1, 0, 7), 10000);
    CHECK_NO_REPLY();
    CHECK_EQ(table.registers[1], 7);
    hear(0, PUT(0, 0, 3, 0, 1, 0, 7), 10000);
    CHECK_NO_REPLY();
    CHECK_EQ(table.reads, 0);
    CHECK_EQ(rtu.rx_frames, 2);
    CHECK_EQ(rtu.rx_errors, 0);
    const size_t end = PUT(0, UNIT_ID, 6, 0, 1, 0, 9);
    frame[end - 1] ^= 1;
    hear(0, end, 10000);
    CHECK_NO_REPLY();
    hear(0, PUT(0, UNIT_ID, 3, 0, 1, 0, 1), 10000);
    CHECK_REPLY(UNIT_ID, 3, 2, 0, 7);
    CHECK_EQ(rtu.rx_errors, 1);
}

UNIT(rtu_hears_us_after_an_absent_neighbour) {
    for (uint64_t gap_us = SILENCE_US; gap_us < 3000000; gap_us = gap_us * 5 / 4) {
        start();
        hear(0, PUT(0, 5, 3, 0x10, 0, 0, 8), 10000);
        hear(0, PUT(0, UNIT_ID, 3, 0, 0, 0, 1), gap_us);
        CHECK_REPLY(UNIT_ID, 3, 2, 0x12, 0x34);
        hear(0, PUT(0, 5, 99, 1, 2, 3), 10000);
        hear(0, PUT(0, UNIT_ID, 3, 0, 0, 0, 1), gap_us);
        CHECK_REPLY(UNIT_ID, 3, 2, 0x12, 0x34);
        hear(0, 3, 10000);  // somebody was cut off
        hear(0, PUT(0, UNIT_ID, 3, 0, 0, 0, 1), gap_us);
        CHECK_REPLY(UNIT_ID, 3, 2, 0x12, 0x34);
    }
}

UNIT(rtu_ignores_a_request_inside_a_response) {
    start();
    const size_t asked = PUT(0, 5, 3, 0, 0, 0, 8);
    uint8_t response[3 + 16] = {5, 3, 16};
    memcpy(response + 3, (const uint8_t[]){UNIT_ID, 6, 0, 1, 0, 66}, 6);
    table_crc(response + 3, 6);
    const size_t end = put(asked, response, sizeof response);
    for (size_t cut = 0; cut <= end; cut++) {
        hear(0, cut, 10000);
        hear(cut, end, 300);
        CHECK_NO_REPLY();
    }
    CHECK_EQ(rtu.rx_errors, 0);
    // cut off behind the request: it starts where no frame can
    hear(0, asked, 10000);
    hear(asked, asked + 3 + 8, 10000);
    CHECK_NO_REPLY();
    CHECK_EQ(table.writes, 0);
}

// The head of a cut response can be a whole request, and a request to us can follow: believed only if no response of
// that length is awaited.
UNIT(rtu_awaits_a_neighbours_response) {
    for (uint8_t count = 7; count <= 9; count++) {
        start();
        hear(0, PUT(0, 5, 3, 0, 0, 0, count), 10000);
        CHECK_NO_REPLY();
        hear(0, PUT(PUT(0, 5, 3, 16, 1, 2, 3), UNIT_ID, 6, 0, 1, 0, 66), 10000);
        if (count == 8) {
            CHECK_NO_REPLY();
            CHECK_EQ(table.writes, 0);
        } else {
            CHECK_REPLY(UNIT_ID, 6, 0, 1, 0, 66);
        }
    }
}

UNIT(rtu_splits_frames_without_silence) {
    start();
    size_t end = PUT(0, 5, 3, 0, 0, 0, 2);
    end = PUT(end, 5, 3, 4, 1, 2, 3, 4);
    end = PUT(end, 0, 6, 0, 1, 0, 7);
    end = PUT(end, UNIT_ID, 6, 0, 2, 0, 8);
    end = PUT(end, 6, 16, 0, 0, 0, 1, 2, 3, 4);
    end = PUT(end, 6, 16, 0, 0, 0, 1);
    end = PUT(end, UNIT_ID, 3, 0, 1, 0, 2);
    hear(0, end, 10000);
    CHECK_REPLY(UNIT_ID, 3, 4, 0, 7, 0, 8);
    CHECK_EQ(rtu.rx_frames, 3);
    CHECK_EQ(rtu.rx_errors, 0);
}

UNIT(rtu_forgives_a_pause) {
    start();
    const size_t end = PUT(0, UNIT_ID, 16, 0, 9, 0, 2, 4, 1, 2, 3, 4);
    for (size_t cut = 1; cut < end; cut++) {
        hear(0, cut, 200000);
        hear(cut, end, 20000);
        CHECK_REPLY(UNIT_ID, 16, 0, 9, 0, 2);
    }
    CHECK_EQ(rtu.rx_errors, 0);
    hear(0, 5, 200000);
    hear(5, end, 60000);
    CHECK_NO_REPLY();
    CHECK_EQ(rtu.rx_errors, 1);
}

UNIT(rtu_survives_floods) {
    start();
    for (size_t i = 0; i < sizeof frame; i++)
        frame[i] = (uint8_t)(i * 37u + 11u);
    for (int i = 0; i < 8; i++)
        hear(0, sizeof frame, 0);
    hear(0, PUT(0, UNIT_ID, 3, 0, 0, 0, 1), SILENCE_US);
    CHECK_REPLY(UNIT_ID, 3, 2, 0x12, 0x34);
    for (int i = 0; i < 100; i++)  // neighbours talking without a silence
        hear(0, PUT(PUT(0, 5, 3, 0, 0, 0, 2), 5, 3, 4, 1, 2, 3, 4), 0);
    hear(0, PUT(0, UNIT_ID, 3, 0, 0, 0, 1), 0);
    CHECK_REPLY(UNIT_ID, 3, 2, 0x12, 0x34);
}

UNIT(rtu_reply_is_withdrawn_or_finished) {
    start();
    const uint8_t *reply;
    const size_t end = PUT(0, UNIT_ID, 3, 0, 0, 0, 1);
    hear(0, end, 10000);
    CHECK_EQ(canopy_modbus_rtu_server_poll(&rtu, now_us + SILENCE_US, &reply), 7);
    hear(0, 1, 5000);  // somebody speaks before we did
    CHECK_EQ(canopy_modbus_rtu_server_poll(&rtu, now_us, &reply), 0);
    hear(0, end, 100000);
    now_us += SILENCE_US;
    CHECK_EQ(canopy_modbus_rtu_server_poll(&rtu, now_us, &reply), 7);
    canopy_modbus_rtu_server_sent(&rtu, 3, now_us);
    hear(0, end, 100);  // while we speak: ignored
    CHECK_EQ(canopy_modbus_rtu_server_poll(&rtu, now_us, &reply), 4);
    CHECK_EQ(reply[0], 0x12);
    canopy_modbus_rtu_server_sent(&rtu, 100, now_us);
    CHECK_EQ(canopy_modbus_rtu_server_poll(&rtu, now_us + 5000, &reply), 0);
}

// ---------------------------------------------------------------------------------------------------------------------
// RTU client

static const uint16_t values[3] = {1, 2, 0xFFFF};

static void client_start(const struct canopy_modbus_request *request) {
    const struct canopy_modbus_rtu_client_config config = {.timeout_us = 100000};
    now_us = 1000000;
    CHECK_EQ(canopy_modbus_rtu_client_init(&rtu_client, &config, now_us), CANOPY_OK);
    CHECK_EQ(canopy_modbus_rtu_client_poll(&rtu_client, now_us), CANOPY_MODBUS_IDLE);
    CHECK_EQ(canopy_modbus_rtu_client_start(&rtu_client, request), CANOPY_OK);
    CHECK_EQ(canopy_modbus_rtu_client_start(&rtu_client, request), CANOPY_ARGUMENT);
}

static void client_sends(const uint8_t *wanted, size_t length) {
    const uint8_t *bytes;
    CHECK_EQ(canopy_modbus_rtu_client_pending(&rtu_client, rtu_client.last_us + SILENCE_US - 1, &bytes), 0);
    now_us = rtu_client.last_us + SILENCE_US;
    CHECK_EQ(canopy_modbus_rtu_client_pending(&rtu_client, now_us, &bytes), length);
    CHECK_BYTES(bytes, wanted, length);
    canopy_modbus_rtu_client_sent(&rtu_client, 3, now_us);
    CHECK_EQ(canopy_modbus_rtu_client_pending(&rtu_client, now_us, &bytes), length - 3);
    canopy_modbus_rtu_client_sent(&rtu_client, length, now_us);
    CHECK_EQ(canopy_modbus_rtu_client_pending(&rtu_client, now_us, &bytes), 0);
}

static void client_hears(size_t from, size_t to, uint64_t gap_us) {
    now_us += gap_us;
    canopy_modbus_rtu_client_feed(&rtu_client, frame + from, to - from, now_us);
}

UNIT(rtu_client_reads) {
    uint16_t got[2] = {0, 0};
    const struct canopy_modbus_request request = {.unit = 1, .function = 3, .address = 0, .count = 1};
    client_start(&request);
    client_sends((const uint8_t[]){0x01, 0x03, 0x00, 0x00, 0x00, 0x01, 0x84, 0x0A}, 8);
    const size_t end = PUT(0, 1, 3, 2, 0xAB, 0xCD);
    for (size_t i = 0; i < end; i++) {
        CHECK_EQ(canopy_modbus_rtu_client_poll(&rtu_client, now_us), CANOPY_MODBUS_PENDING);
        client_hears(i, i + 1, 3000);
    }
    CHECK_EQ(canopy_modbus_rtu_client_poll(&rtu_client, now_us), CANOPY_MODBUS_DONE);
    CHECK_EQ(canopy_modbus_rtu_client_registers(&rtu_client, got, 2), 1);
    CHECK_EQ(got[0], 0xABCD);
    CHECK_EQ(got[1], 0);
    CHECK_EQ(rtu_client.rx_frames, 1);
    CHECK_EQ(rtu_client.rx_errors, 0);
}

UNIT(rtu_client_drops_what_is_no_answer) {
    const struct canopy_modbus_request request = {.unit = 1, .function = 3, .address = 0, .count = 1};
    client_start(&request);
    client_hears(0, PUT(0, 1, 3, 2, 9, 9), 5000);  // late, for an earlier request
    client_sends((const uint8_t[]){0x01, 0x03, 0x00, 0x00, 0x00, 0x01, 0x84, 0x0A}, 8);
    client_hears(0, PUT(0, 2, 3, 2, 9, 9), 2000);        // another unit
    client_hears(0, PUT(0, 1, 4, 2, 9, 9), 2000);        // another function
    client_hears(0, PUT(0, 1, 3, 4, 9, 9, 9, 9), 2000);  // another length
    const size_t end = PUT(0, 1, 3, 2, 9, 9);
    frame[end - 1] ^= 1;
    client_hears(0, end, 2000);
    CHECK_EQ(canopy_modbus_rtu_client_poll(&rtu_client, now_us), CANOPY_MODBUS_PENDING);
    CHECK_EQ(rtu_client.rx_errors, 5);
    PUT(0, 1, 3, 2, 9, 9);
    client_hears(0, 4, 2000);  // cut off, and then the whole
    client_hears(0, end, 2000);
    CHECK_EQ(canopy_modbus_rtu_client_poll(&rtu_client, now_us), CANOPY_MODBUS_DONE);
    CHECK_EQ(rtu_client.rx_errors, 6);
    CHECK_EQ(canopy_modbus_rtu_client_start(&rtu_client, &request), CANOPY_OK);
    client_sends((const uint8_t[]){0x01, 0x03, 0x00, 0x00, 0x00, 0x01, 0x84, 0x0A}, 8);
    client_hears(0, 4, 2000);  // cut off, and then another unit's
    client_hears(0, PUT(0, 2, 3, 2, 9, 9), 2000);
    CHECK_EQ(canopy_modbus_rtu_client_poll(&rtu_client, now_us), CANOPY_MODBUS_PENDING);
    CHECK_EQ(rtu_client.rx_errors, 8);
}

UNIT(rtu_client_is_refused_or_times_out) {
    const struct canopy_modbus_request request = {
        .unit = 1, .function = 16, .address = 5, .count = 3, .values = values};
    client_start(&request);
    size_t end = PUT(0, 1, 16, 0, 5, 0, 3, 6, 0, 1, 0, 2, 0xFF, 0xFF);
    client_sends(frame, end);
    client_hears(0, PUT(0, 1, 0x90, 2), 3000);
    CHECK_EQ(canopy_modbus_rtu_client_poll(&rtu_client, now_us), CANOPY_MODBUS_REFUSED);
    CHECK_EQ(canopy_modbus_rtu_client_exception(&rtu_client), 2);
    CHECK_EQ(canopy_modbus_rtu_client_start(&rtu_client, &request), CANOPY_OK);
    client_sends(frame, PUT(0, 1, 16, 0, 5, 0, 3, 6, 0, 1, 0, 2, 0xFF, 0xFF));
    client_hears(0, PUT(0, 1, 16, 0, 5, 0, 2), 3000);  // not what was written
    CHECK_EQ(canopy_modbus_rtu_client_poll(&rtu_client, rtu_client.deadline_us - 1), CANOPY_MODBUS_PENDING);
    CHECK_EQ(canopy_modbus_rtu_client_poll(&rtu_client, rtu_client.deadline_us), CANOPY_MODBUS_TIMED_OUT);
    CHECK_EQ(canopy_modbus_rtu_client_exception(&rtu_client), 0);
}

UNIT(rtu_client_broadcasts) {
    struct canopy_modbus_request request = {.unit = 0, .function = 6, .address = 5, .count = 1, .values = values};
    client_start(&request);
    client_sends(frame, PUT(0, 0, 6, 0, 5, 0, 1));
    CHECK_EQ(canopy_modbus_rtu_client_poll(&rtu_client, now_us + 99999), CANOPY_MODBUS_PENDING);
    CHECK_EQ(canopy_modbus_rtu_client_poll(&rtu_client, now_us + 100000), CANOPY_MODBUS_DONE);
    request.function = 3;
    CHECK_EQ(canopy_modbus_rtu_client_start(&rtu_client, &request), CANOPY_ARGUMENT);
}

UNIT(requests_are_written) {
    struct canopy_modbus_expected expected;
    struct canopy_modbus_request request = {
        .unit = 1, .function = 23, .address = 3, .count = 6, .write_address = 14, .write_count = 3, .values = values};
    CHECK_PDU(canopy_modbus_request_write(&request, pdu, &expected), 23, 0, 3, 0, 6, 0, 14, 0, 3, 6, 0, 1, 0, 2, 0xFF,
              0xFF);
    request.write_count = 122;
    CHECK_EQ(canopy_modbus_request_write(&request, pdu, &expected), 0);
    request = (struct canopy_modbus_request){.unit = 1, .function = 43, .identify_code = 4, .identify_object = 2};
    CHECK_PDU(canopy_modbus_request_write(&request, pdu, &expected), 43, 14, 4, 2);
    const uint8_t objects[] = {43, 14, 4, 0x81, 0, 0, 1, 2, 1, 'x'};
    CHECK_EQ(canopy_modbus_response_check(&expected, objects, 10), CANOPY_MODBUS_ANSWER);
    CHECK_EQ(canopy_modbus_response_check(&expected, objects, 9), CANOPY_MODBUS_MISMATCH);
    request = (struct canopy_modbus_request){.unit = 1, .function = 4, .address = 65535, .count = 2};
    CHECK_EQ(canopy_modbus_request_write(&request, pdu, &expected), 0);
    request.count = 0;
    CHECK_EQ(canopy_modbus_request_write(&request, pdu, &expected), 0);
    request = (struct canopy_modbus_request){.unit = 1, .function = 5};
    CHECK_EQ(canopy_modbus_request_write(&request, pdu, &expected), 0);
}

// ---------------------------------------------------------------------------------------------------------------------
// TCP

static void check_tcp(const uint8_t *wanted, size_t length) {
    const uint8_t *bytes;
    CHECK_EQ(canopy_modbus_tcp_server_pending(&tcp, &bytes), length);
    CHECK_BYTES(bytes, wanted, length);
    CHECK_EQ(canopy_modbus_tcp_server_room(&tcp), 0);
    for (size_t left = length; left > 0; left--) {
        CHECK_EQ(canopy_modbus_tcp_server_pending(&tcp, &bytes), left);
        CHECK_EQ(*bytes, wanted[length - left]);
        canopy_modbus_tcp_server_sent(&tcp, 1);
    }
    CHECK_EQ(canopy_modbus_tcp_server_pending(&tcp, &bytes), 0);
}

#define CHECK_TCP(...) check_tcp((const uint8_t[]){__VA_ARGS__}, sizeof((const uint8_t[]){__VA_ARGS__}))
#define TCP_FEED(...)                                                                                                  \
    canopy_modbus_tcp_server_feed(&tcp, (const uint8_t[]){__VA_ARGS__}, sizeof((const uint8_t[]){__VA_ARGS__}))

UNIT(tcp_answers) {
    start();
    CHECK_EQ(TCP_FEED(0xAB, 0xCD, 0, 0, 0, 6, UNIT_ID, 3, 0, 0, 0, 1), 12);
    CHECK_TCP(0xAB, 0xCD, 0, 0, 0, 5, UNIT_ID, 3, 2, 0x12, 0x34);
    CHECK_EQ(TCP_FEED(0, 1, 0, 0, 0, 6, 0, 3, 0, 0, 0, 0), 12);
    CHECK_TCP(0, 1, 0, 0, 0, 3, 0, 0x83, 3);
    CHECK_EQ(TCP_FEED(0, 1, 0, 0, 0, 2, 255, 99), 8);
    CHECK_TCP(0, 1, 0, 0, 0, 3, 255, 0xE3, 1);
    CHECK_EQ(TCP_FEED(0, 1, 0, 0, 0, 6, UNIT_ID + 1, 3, 0, 0, 0, 0), 12);  // another unit
    CHECK_EQ(canopy_modbus_tcp_server_room(&tcp), 6);
    CHECK_EQ(tcp.rx_frames, 3);
    tcp.config.any_unit = true;
    CHECK_EQ(TCP_FEED(0, 1, 0, 0, 0, 6, UNIT_ID + 1, 6, 0, 0, 0, 0), 12);
    CHECK_TCP(0, 1, 0, 0, 0, 6, UNIT_ID + 1, 6, 0, 0, 0, 0);
    CHECK_EQ(tcp.rx_errors, 0);
}

UNIT(tcp_takes_one_request_at_a_time) {
    static const uint8_t two[24] = {0, 1, 0, 0, 0, 6, UNIT_ID, 3, 0, 0, 0, 1, 0, 2, 0, 0, 0, 6, UNIT_ID, 3, 0, 1, 0, 1};
    start();
    CHECK_EQ(canopy_modbus_tcp_server_feed(&tcp, two, 24), 12);
    CHECK_EQ(canopy_modbus_tcp_server_feed(&tcp, two + 12, 12), 0);
    CHECK_TCP(0, 1, 0, 0, 0, 5, UNIT_ID, 3, 2, 0x12, 0x34);
    for (size_t i = 12; i < 24; i++) {
        CHECK(canopy_modbus_tcp_server_room(&tcp) >= 1);
        CHECK(canopy_modbus_tcp_server_room(&tcp) <= 24 - i);
        CHECK_EQ(canopy_modbus_tcp_server_feed(&tcp, two + i, 1), 1);
    }
    CHECK_TCP(0, 2, 0, 0, 0, 5, UNIT_ID, 3, 2, 0x12, 0x3B);
}

UNIT(tcp_skips_what_is_no_modbus) {
    start();
    CHECK_EQ(TCP_FEED(0, 1, 0, 1, 0, 6, UNIT_ID, 3, 0, 0, 0, 1), 12);  // protocol 1
    CHECK_EQ(TCP_FEED(0, 1, 0, 0, 0, 0), 6);                           // nothing
    CHECK_EQ(TCP_FEED(0, 1, 0, 0, 0, 1, UNIT_ID), 7);                  // no function
    CHECK_EQ(tcp.rx_errors, 3);
    CHECK_EQ(TCP_FEED(0, 1, 0, 0, 0, 6, UNIT_ID, 3, 0, 0, 0, 1), 12);
    CHECK_TCP(0, 1, 0, 0, 0, 5, UNIT_ID, 3, 2, 0x12, 0x34);
    CHECK(!canopy_modbus_tcp_server_lost(&tcp));
    CHECK_EQ(TCP_FEED(0, 1, 0, 0, 0, 255, UNIT_ID, 3), 8);
    CHECK(canopy_modbus_tcp_server_lost(&tcp));
    CHECK_EQ(canopy_modbus_tcp_server_room(&tcp), 0);
    CHECK_EQ(TCP_FEED(0, 1, 0, 0, 0, 6, UNIT_ID, 3, 0, 0, 0, 1), 12);
    CHECK_EQ(tcp.rx_frames, 1);
    CHECK_EQ(tcp.rx_errors, 4);
}

#define ANSWER(...)                                                                                                    \
    canopy_modbus_tcp_client_feed(&tcp_client, (const uint8_t[]){__VA_ARGS__}, sizeof((const uint8_t[]){__VA_ARGS__}))

UNIT(tcp_client_matches_transactions) {
    const struct canopy_modbus_tcp_client_config config = {.timeout_us = 1000};
    const struct canopy_modbus_request request = {.unit = 1, .function = 4, .address = 7, .count = 1};
    const uint8_t *bytes;
    uint16_t got = 0;
    CHECK_EQ(canopy_modbus_tcp_client_init(&tcp_client, &config), CANOPY_OK);
    CHECK_EQ(canopy_modbus_tcp_client_start(&tcp_client, &request, 0), CANOPY_OK);
    CHECK_EQ(canopy_modbus_tcp_client_pending(&tcp_client, &bytes), 12);
    CHECK_BYTES(bytes, ((const uint8_t[]){0, 1, 0, 0, 0, 6, 1, 4, 0, 7, 0, 1}), 12);
    canopy_modbus_tcp_client_sent(&tcp_client, 12, 10);
    CHECK_EQ(ANSWER(0, 1, 0, 0, 0, 5), 6);
    CHECK_EQ(canopy_modbus_tcp_client_poll(&tcp_client, 1009), CANOPY_MODBUS_PENDING);
    CHECK_EQ(canopy_modbus_tcp_client_poll(&tcp_client, 1010), CANOPY_MODBUS_TIMED_OUT);
    CHECK_EQ(canopy_modbus_tcp_client_start(&tcp_client, &request, 2000), CANOPY_OK);
    canopy_modbus_tcp_client_sent(&tcp_client, 12, 2000);
    CHECK_EQ(ANSWER(1, 4, 2, 9, 9), 5);                     // the rest of the late answer
    CHECK_EQ(ANSWER(0, 2, 0, 0, 0, 5, 2, 4, 2, 9, 9), 11);  // another unit
    CHECK_EQ(ANSWER(0, 2, 0, 0, 0, 5, 1, 3, 2, 9, 9), 11);  // another function
    CHECK_EQ(ANSWER(0, 2, 0, 0, 0, 7, 1, 4, 4, 9, 9, 9, 9), 13);
    CHECK_EQ(tcp_client.rx_errors, 4);
    CHECK_EQ(ANSWER(0, 2, 0, 0, 0, 5, 1, 4, 2, 0x12, 0x34, 9, 9), 11);
    CHECK_EQ(canopy_modbus_tcp_client_poll(&tcp_client, 2500), CANOPY_MODBUS_DONE);
    CHECK_EQ(canopy_modbus_tcp_client_registers(&tcp_client, &got, 1), 1);
    CHECK_EQ(got, 0x1234);
    CHECK_EQ(canopy_modbus_tcp_client_start(&tcp_client, &request, 3000), CANOPY_OK);
    canopy_modbus_tcp_client_sent(&tcp_client, 12, 3000);
    CHECK_EQ(ANSWER(0, 3, 0, 0, 0, 3, 1, 0x84, 6), 9);
    CHECK_EQ(canopy_modbus_tcp_client_poll(&tcp_client, 3000), CANOPY_MODBUS_REFUSED);
    CHECK_EQ(canopy_modbus_tcp_client_exception(&tcp_client), 6);
    CHECK_EQ(canopy_modbus_tcp_client_start(&tcp_client, &request, 4000), CANOPY_OK);
    canopy_modbus_tcp_client_sent(&tcp_client, 5, 4000);
    CHECK_EQ(canopy_modbus_tcp_client_poll(&tcp_client, 5000), CANOPY_MODBUS_TIMED_OUT);
    CHECK(canopy_modbus_tcp_client_lost(&tcp_client));  // half a request cannot be taken back
}

UNIT_LIST(modbus, crc_has_published_values, reads, reads_end_at_65535, reads_are_refused, writes_one, writes,
          exchanges_write_first, other_functions_are_illegal, broadcast_writes_and_is_silent, identifies,
          identification_goes_on, lengths, rtu_configuration_is_checked, rtu_answers,
          rtu_waits_where_a_crc_is_right_too_early, rtu_is_silent_when_it_must, rtu_hears_us_after_an_absent_neighbour,
          rtu_ignores_a_request_inside_a_response, rtu_awaits_a_neighbours_response, rtu_splits_frames_without_silence,
          rtu_forgives_a_pause, rtu_survives_floods, rtu_reply_is_withdrawn_or_finished, rtu_client_reads,
          rtu_client_drops_what_is_no_answer, rtu_client_is_refused_or_times_out, rtu_client_broadcasts,
          requests_are_written, tcp_answers, tcp_takes_one_request_at_a_time, tcp_skips_what_is_no_modbus,
          tcp_client_matches_transactions)
