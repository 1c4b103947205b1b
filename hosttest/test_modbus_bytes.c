// Modbus engines against every small change of what they are fed: every truncation, every changed byte, any chunking,
// garbage. Input stands in memory of its exact size and servers between canaries, so that sanitizers and checks see
// each byte too many.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "hosttest/modbus_table.h"
#include "lib/modbus/rtu.h"
#include "lib/modbus/tcp.h"

enum { US = 17, SILENCE_US = 1750, LONG_US = 1000000 };

static uint64_t random_state = 1;

static uint32_t random32(void) {
    random_state = random_state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(random_state >> 32);
}

static uint32_t below(uint32_t limit) { return (uint32_t)(((uint64_t)random32() * limit) >> 32); }

// ---------------------------------------------------------------------------------------------------------------------
// Fixtures between canaries

struct guarded {
    uint8_t before[64];
    struct canopy_modbus_rtu_server rtu;
    uint8_t between[64];
    struct canopy_modbus_tcp_server tcp;
    uint8_t after[64];
};

static struct guarded guarded;
static struct table table;
static struct canopy_modbus_bank bank;
static uint64_t now_us;
static char long_text[400];

static void start(void) {
    table_init(&table, &bank);
    memset(long_text, 'x', sizeof long_text - 1);
    table.objects[0] = "canopy";
    table.objects[1] = "test";
    table.objects[4] = long_text;
    memset(&guarded, 0xC5, sizeof guarded);
    const struct canopy_modbus_rtu_server_config rtu = {.bank = &bank, .unit = US};
    assert_int_equal(canopy_modbus_rtu_server_init(&guarded.rtu, &rtu), CANOPY_OK);
    const struct canopy_modbus_tcp_server_config tcp = {.bank = &bank, .unit = US};
    assert_int_equal(canopy_modbus_tcp_server_init(&guarded.tcp, &tcp), CANOPY_OK);
    now_us = LONG_US;
}

static void check_canaries(void) {
    for (size_t i = 0; i < 64; i++) {
        assert_int_equal(guarded.before[i], 0xC5);
        assert_int_equal(guarded.between[i], 0xC5);
        assert_int_equal(guarded.after[i], 0xC5);
    }
    assert_true(guarded.rtu.have <= CANOPY_MODBUS_RTU_ADU_MAX);
    assert_true(guarded.tcp.frame.have <= CANOPY_MODBUS_TCP_ADU_MAX);
}

static void feed_rtu(const uint8_t *bytes, size_t length) {
    uint8_t *copy = malloc(length ? length : 1);
    memcpy(copy, bytes, length);
    canopy_modbus_rtu_server_feed(&guarded.rtu, copy, length, now_us);
    free(copy);
}

// The reply after a silence, sent; its length.
static size_t rtu_reply(uint8_t *to) {
    const uint8_t *reply;
    now_us += SILENCE_US;
    const size_t length = canopy_modbus_rtu_server_poll(&guarded.rtu, now_us, &reply);
    assert_true(length <= CANOPY_MODBUS_RTU_ADU_MAX);
    if (length)
        memcpy(to, reply, length);
    canopy_modbus_rtu_server_sent(&guarded.rtu, length, now_us);
    return length;
}

static void check_rtu_alive(void) {
    uint8_t request[8] = {US, 3, 0, 0, 0, 1}, reply[CANOPY_MODBUS_RTU_ADU_MAX];
    table_crc(request, 6);
    feed_rtu(request, 8);
    assert_int_equal(rtu_reply(reply), 7);
    assert_int_equal(reply[0], US);
    assert_int_equal(reply[1], 3);
}

// ---------------------------------------------------------------------------------------------------------------------
// Requests of every function, as PDUs

struct pdu {
    size_t length;
    uint8_t at[CANOPY_MODBUS_PDU_MAX];
};

static const struct pdu requests[] = {
    {5, {3, 0, 1, 0, 2}},
    {5, {4, 0, 0, 0, 125}},
    {5, {6, 0, 1, 0x12, 0x34}},
    {8, {16, 0, 1, 0, 1, 2, 5, 6}},
    {14, {16, 0, 9, 0, 4, 8, 1, 2, 3, 4, 5, 6, 7, 8}},
    {252, {16, 0, 0, 0, 123, 246}},
    {12, {23, 0, 0, 0, 5, 0, 1, 0, 1, 2, 9, 9}},
    {252, {23, 0, 0, 0, 125, 0, 0, 0, 121, 242}},
    {4, {43, 14, 1, 0}},
    {4, {43, 14, 2, 4}},
    {4, {43, 14, 4, 1}},
    {5, {1, 0, 0, 0, 8}},
    {8, {15, 0, 0, 0, 8, 1, 255, 0}},
    {3, {99, 1, 2}},
    {1, {7}},
};
enum { REQUESTS = sizeof requests / sizeof requests[0] };

static size_t rtu_frame(const struct pdu *pdu, uint8_t unit, uint8_t *to) {
    to[0] = unit;
    memcpy(to + 1, pdu->at, pdu->length);
    return table_crc(to, 1 + pdu->length);
}

static size_t tcp_frame(const struct pdu *pdu, uint8_t unit, uint16_t transaction, uint8_t *to) {
    const uint8_t head[7] = {(uint8_t)(transaction >> 8),       (uint8_t)transaction,       0,   0,
                             (uint8_t)((pdu->length + 1) >> 8), (uint8_t)(pdu->length + 1), unit};
    memcpy(to, head, 7);
    memcpy(to + 7, pdu->at, pdu->length);
    return 7 + pdu->length;
}

static bool crc_is_right(const uint8_t *frame, size_t length) {
    uint8_t copy[CANOPY_MODBUS_RTU_ADU_MAX + 2];
    if (length < 4)
        return false;
    memcpy(copy, frame, length);
    table_crc(copy, length - 2);
    return memcmp(copy, frame, length) == 0;
}

// A request cut anywhere is not answered and changes nothing; the next one is answered.
static void every_truncation_over_rtu(void **state) {
    (void)state;
    uint8_t frame[CANOPY_MODBUS_RTU_ADU_MAX], reply[CANOPY_MODBUS_RTU_ADU_MAX];
    for (size_t i = 0; i < REQUESTS; i++) {
        const size_t length = rtu_frame(&requests[i], US, frame);
        for (size_t cut = 0; cut < length; cut++) {
            start();
            feed_rtu(frame, cut);
            const size_t answered = rtu_reply(reply);
            assert_true(answered == 0 || (crc_is_right(frame, cut) && (reply[1] & 0x80)));
            assert_int_equal(table.writes, 0);
            check_rtu_alive();
            check_canaries();
        }
    }
}

// So is one with any byte changed to any value: a CRC of 16 bits sees every such change.
static void every_changed_byte_over_rtu(void **state) {
    (void)state;
    uint8_t frame[CANOPY_MODBUS_RTU_ADU_MAX], reply[CANOPY_MODBUS_RTU_ADU_MAX];
    for (size_t i = 0; i < REQUESTS; i++) {
        const size_t length = rtu_frame(&requests[i], US, frame);
        start();
        for (size_t at = 0; at < length; at++)
            for (unsigned change = 1; change<256; change += length> 100 ? 50 : 1) {
                frame[at] ^= (uint8_t)change;
                now_us += LONG_US;
                feed_rtu(frame, length);
                assert_int_equal(rtu_reply(reply), 0);
                frame[at] ^= (uint8_t)change;
            }
        assert_int_equal(table.writes, 0);
        check_canaries();
        check_rtu_alive();
    }
}

// Every PDU of up to three bytes, and every length with each function, with a right CRC: an answer of the right shape,
// always.
static void every_short_request_is_answered(void **state) {
    (void)state;
    uint8_t reply[CANOPY_MODBUS_RTU_ADU_MAX];
    start();
    for (unsigned function = 0; function < 256; function++)
        for (size_t length = 1; length <= CANOPY_MODBUS_PDU_MAX; length++) {
            struct pdu pdu = {length, {(uint8_t)function}};
            for (size_t i = 1; i < length; i++)
                pdu.at[i] = (uint8_t)below(i < 6 ? 4 : 256);
            uint8_t frame[CANOPY_MODBUS_RTU_ADU_MAX];
            const size_t whole = rtu_frame(&pdu, US, frame);
            now_us += LONG_US;
            feed_rtu(frame, whole);
            now_us += LONG_US;  // too short ones are answered when the pause is over
            const size_t answered = rtu_reply(reply);
            assert_true(answered >= 5);
            assert_true(crc_is_right(reply, answered));
            assert_int_equal(reply[0], US);
            assert_int_equal(reply[1] & 0x7F, function & 0x7F);
            check_canaries();
        }
}

// The same bytes at the same times, cut differently into calls: the same replies, table and counters.
static void chunking_makes_no_difference_over_rtu(void **state) {
    (void)state;
    for (unsigned round = 0; round < 2000; round++) {
        uint8_t burst[900], replies[2][CANOPY_MODBUS_RTU_ADU_MAX];
        size_t length = 0, reply_length[2];
        struct table after[2];
        uint32_t counters[2][2];
        while (length < 300 && below(4)) {
            const uint32_t kind = below(3);
            if (kind == 0) {
                burst[length++] = (uint8_t)below(256);
            } else {
                const uint8_t unit = kind == 1 ? US : (uint8_t)below(20);
                length += rtu_frame(&requests[below(REQUESTS)], unit, burst + length);
            }
        }
        for (unsigned way = 0; way < 2; way++) {
            start();
            for (size_t at = 0; at < length;) {
                const size_t count = way ? 1 + below((uint32_t)(length - at)) : 1;
                feed_rtu(burst + at, count);
                at += count;
            }
            reply_length[way] = rtu_reply(replies[way]);
            after[way] = table;
            counters[way][0] = guarded.rtu.rx_frames;
            counters[way][1] = guarded.rtu.rx_errors;
        }
        assert_int_equal(reply_length[0], reply_length[1]);
        if (reply_length[0])
            assert_memory_equal(replies[0], replies[1], reply_length[0]);
        assert_memory_equal(&after[0], &after[1], sizeof table);
        assert_memory_equal(counters[0], counters[1], sizeof counters[0]);
        check_canaries();
    }
}

// Garbage with fragments of frames in it, at any times.
static void garbage_over_rtu(void **state) {
    (void)state;
    uint8_t reply[CANOPY_MODBUS_RTU_ADU_MAX], bytes[700];
    start();
    for (unsigned round = 0; round < 100000; round++) {
        size_t length = 1 + below(below(8) ? 20 : 600);
        for (size_t i = 0; i < length; i++)
            bytes[i] = (uint8_t)(below(3) ? below(256) : US);
        if (below(2))
            length = rtu_frame(&requests[below(REQUESTS)], below(2) ? US : 0, bytes);
        now_us += below(8) ? below(3000) : below(100000);
        feed_rtu(bytes, length);
        if (below(4) == 0)
            (void)rtu_reply(reply);
        if (below(16) == 0) {
            const uint8_t *pending;
            const size_t there = canopy_modbus_rtu_server_poll(&guarded.rtu, now_us, &pending);
            canopy_modbus_rtu_server_sent(&guarded.rtu, below((uint32_t)there + 2), now_us);
        }
        check_canaries();
    }
    const uint8_t *pending;  // a reply may be half sent: it goes first
    now_us += LONG_US;
    canopy_modbus_rtu_server_sent(&guarded.rtu, canopy_modbus_rtu_server_poll(&guarded.rtu, now_us, &pending), now_us);
    now_us += LONG_US;
    check_rtu_alive();
}

// Frames of every size up to the last byte of the buffer, in a server that ends where its memory ends: nothing is read
// beyond.
static void frames_fill_the_buffer(void **state) {
    (void)state;
    start();
    for (unsigned function = 0; function < 128; function++)
        for (size_t length = 1; length < 12; length++)
            for (unsigned unit = US; unit <= US + 1; unit++) {
                struct canopy_modbus_rtu_server *server = malloc(sizeof *server);
                const struct canopy_modbus_rtu_server_config config = {.bank = &bank, .unit = US};
                assert_int_equal(canopy_modbus_rtu_server_init(server, &config), CANOPY_OK);
                uint8_t stream[CANOPY_MODBUS_RTU_ADU_MAX + 20], frame[20];
                size_t have = 0;
                const struct pdu filler = {1, {7}}, pdu = {length, {(uint8_t)function}};
                const size_t last = rtu_frame(&pdu, (uint8_t)unit, frame);
                while (have + last + 4 <= CANOPY_MODBUS_RTU_ADU_MAX)
                    have += rtu_frame(&filler, US + 1, stream + have);
                memcpy(stream + have, frame, last);
                const uint8_t *reply;
                canopy_modbus_rtu_server_feed(server, stream, have + last, now_us += LONG_US);
                const size_t there = canopy_modbus_rtu_server_poll(server, now_us += SILENCE_US, &reply);
                assert_true(there <= CANOPY_MODBUS_RTU_ADU_MAX);
                free(server);
            }
}

// A full buffer without a silence: a write to us at its beginning is done if a frame follows, not if anything else
// does.
static void a_full_buffer_is_settled(void **state) {
    (void)state;
    const struct pdu write = {5, {6, 0, 1, 0, 77}}, poll = {5, {3, 0, 0, 0, 8}};
    for (unsigned followed = 0; followed < 2; followed++) {
        uint8_t stream[600];
        memset(stream, 0x55, sizeof stream);
        size_t have = rtu_frame(&write, US, stream);
        if (followed)
            have += rtu_frame(&poll, US + 1, stream + have);
        start();
        feed_rtu(stream, sizeof stream);
        assert_int_equal(table.writes, followed);
        assert_int_equal(guarded.rtu.rx_frames, followed);
        now_us += SILENCE_US;
        check_rtu_alive();
    }
}

// A neighbour's write request that begins with a whole response: the longer reading counts, and a request behind it is
// heard.
static void the_longer_reading_counts(void **state) {
    (void)state;
    struct pdu write = {22, {16, 0, 0, 0, 8}};
    uint8_t frame[CANOPY_MODBUS_RTU_ADU_MAX], reply[CANOPY_MODBUS_RTU_ADU_MAX], head[8];
    unsigned address = 0;
    do {  // its byte count and first value are the CRC of a response with this address
        write.at[1] = (uint8_t)(address >> 8);
        write.at[2] = (uint8_t)address++;
        head[0] = US + 1;
        memcpy(head + 1, write.at, 5);
        table_crc(head, 6);
    } while (head[6] != 16);
    write.at[5] = head[6];
    write.at[6] = head[7];
    size_t length = rtu_frame(&write, US + 1, frame);
    assert_true(crc_is_right(frame, 8) && crc_is_right(frame, length));
    length += rtu_frame(&requests[0], US, frame + length);
    start();
    feed_rtu(frame, length);
    assert_int_equal(rtu_reply(reply), 9);
}

// A long response of a neighbour that lost its last byte, which happens to be our address; then a request to us. The
// two do not fit the buffer, and together they begin with a whole frame.
static void a_cut_response_does_not_eat_a_request(void **state) {
    (void)state;
    struct pdu response = {252, {3, 250}};
    uint8_t frame[CANOPY_MODBUS_RTU_ADU_MAX];
    size_t length;
    do {
        response.at[2]++;
        if (response.at[2] == 0)
            response.at[3]++;
        length = rtu_frame(&response, US + 1, frame);
    } while (frame[length - 1] != US);
    start();
    feed_rtu(frame, length - 1);
    now_us += 10000;
    check_rtu_alive();
}

// ---------------------------------------------------------------------------------------------------------------------
// TCP

// Feeds in random pieces and takes the replies in random pieces, as a socket would; returns the length of all replies.
static size_t tcp_exchange(const uint8_t *bytes, size_t length, uint8_t *replies, size_t room, bool by_room) {
    size_t at = 0, replied = 0;
    for (;;) {
        const uint8_t *reply;
        const size_t pending = canopy_modbus_tcp_server_pending(&guarded.tcp, &reply);
        assert_true(pending <= CANOPY_MODBUS_TCP_ADU_MAX);
        if (pending) {
            const size_t count = 1 + below((uint32_t)pending);
            assert_true(replied + count <= room);
            memcpy(replies + replied, reply, count);
            replied += count;
            canopy_modbus_tcp_server_sent(&guarded.tcp, count);
            continue;
        }
        if (at == length)
            return replied;
        size_t count = 1 + below((uint32_t)(length - at));
        if (by_room && !canopy_modbus_tcp_server_lost(&guarded.tcp)) {
            const size_t fits = canopy_modbus_tcp_server_room(&guarded.tcp);
            assert_true(fits > 0);
            count = fits < length - at ? fits : length - at;
        }
        uint8_t *copy = malloc(count);
        memcpy(copy, bytes + at, count);
        const size_t taken = canopy_modbus_tcp_server_feed(&guarded.tcp, copy, count);
        free(copy);
        assert_true(taken <= count && taken > 0);
        if (by_room)
            assert_int_equal(taken, count);
        at += taken;
        check_canaries();
    }
}

static void every_truncation_over_tcp(void **state) {
    (void)state;
    uint8_t frame[CANOPY_MODBUS_TCP_ADU_MAX], replies[2 * CANOPY_MODBUS_TCP_ADU_MAX];
    for (size_t i = 0; i < REQUESTS; i++) {
        const size_t length = tcp_frame(&requests[i], US, 7, frame);
        for (size_t cut = 0; cut < length; cut++) {
            start();
            assert_int_equal(tcp_exchange(frame, cut, replies, sizeof replies, false), 0);
            assert_int_equal(table.writes + table.reads, 0);
            assert_true(tcp_exchange(frame + cut, length - cut, replies, sizeof replies, true) >= 9);
            assert_int_equal(replies[1], 7);
        }
    }
}

// TCP has no CRC of its own: a changed byte may be another request, but the answer has the shape of one.
static void every_changed_byte_over_tcp(void **state) {
    (void)state;
    uint8_t frame[CANOPY_MODBUS_TCP_ADU_MAX], replies[4096];
    for (size_t i = 0; i < REQUESTS; i++) {
        const size_t length = tcp_frame(&requests[i], US, 7, frame);
        for (size_t at = 0; at < length; at++)
            for (unsigned change = 1; change<256; change += length> 100 ? 50 : 1) {
                frame[at] ^= (uint8_t)change;
                start();
                const size_t replied = tcp_exchange(frame, length, replies, sizeof replies, (change & 1) != 0);
                frame[at] ^= (uint8_t)change;
                if (replied == 0)
                    continue;
                assert_true(replied >= 9);
                assert_int_equal(replies[4] << 8 | replies[5], replied - 6);
                assert_memory_equal(replies + 2, "\0", 2);
                if (replies[7] & 0x80)
                    assert_int_equal(table.writes, 0);
            }
    }
}

static void chunking_makes_no_difference_over_tcp(void **state) {
    (void)state;
    static uint8_t stream[20000], replies[3][40000];
    for (unsigned round = 0; round < 300; round++) {
        size_t length = 0, replied[3];
        struct table after[3];
        for (unsigned n = below(60); n > 0; n--) {
            struct pdu pdu = requests[below(REQUESTS)];
            if (below(8) == 0)
                pdu.at[below(6)] = (uint8_t)below(256);
            length += tcp_frame(&pdu, (uint8_t)(below(4) ? US : below(256)), (uint16_t)below(65536), stream + length);
            if (below(16) == 0)
                stream[length - pdu.length - 5] = 1;  // another protocol
        }
        for (unsigned way = 0; way < 3; way++) {
            start();
            replied[way] = tcp_exchange(stream, length, replies[way], sizeof replies[way], way == 1);
            after[way] = table;
        }
        for (unsigned way = 1; way < 3; way++) {
            assert_int_equal(replied[0], replied[way]);
            assert_memory_equal(replies[0], replies[way], replied[0]);
            assert_memory_equal(&after[0], &after[way], sizeof table);
        }
    }
}

static void garbage_over_tcp(void **state) {
    (void)state;
    static uint8_t stream[2000], replies[100000];
    for (unsigned round = 0; round < 20000; round++) {
        start();
        const size_t length = 1 + below(sizeof stream);
        for (size_t i = 0; i < length; i++)
            stream[i] = (uint8_t)(below(3) ? 0 : below(below(2) ? 24 : 256));
        (void)tcp_exchange(stream, length, replies, sizeof replies, false);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_truncation_over_rtu),
        cmocka_unit_test(every_changed_byte_over_rtu),
        cmocka_unit_test(every_short_request_is_answered),
        cmocka_unit_test(chunking_makes_no_difference_over_rtu),
        cmocka_unit_test(garbage_over_rtu),
        cmocka_unit_test(frames_fill_the_buffer),
        cmocka_unit_test(a_full_buffer_is_settled),
        cmocka_unit_test(the_longer_reading_counts),
        cmocka_unit_test(a_cut_response_does_not_eat_a_request),
        cmocka_unit_test(every_truncation_over_tcp),
        cmocka_unit_test(every_changed_byte_over_tcp),
        cmocka_unit_test(chunking_makes_no_difference_over_tcp),
        cmocka_unit_test(garbage_over_tcp),
    };
    return cmocka_run_group_tests_name("modbus_bytes", tests, NULL, NULL);
}
