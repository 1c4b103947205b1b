// The clients against our own servers over a bad line, in virtual time: what a client reports as the answer is the
// answer that the server gave to this very request, or it reports none.
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

enum { US = 17, SILENCE_US = 1750, TIMEOUT_US = 50000, ROUNDS = 30000 };

static uint64_t random_state = 7;

static uint32_t random32(void) {
    random_state = random_state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(random_state >> 32);
}

static uint32_t below(uint32_t limit) { return (uint32_t)(((uint64_t)random32() * limit) >> 32); }

static struct table table;
static struct canopy_modbus_bank bank;
static uint64_t now_us;
static uint16_t values[CANOPY_MODBUS_WRITE_MAX];

static struct canopy_modbus_request random_request(void) {
    static const uint8_t functions[] = {3, 4, 6, 16, 23, 43};
    struct canopy_modbus_request request = {.unit = US,
                                            .function = functions[below(6)],
                                            .address = (uint16_t)below(TABLE_REGISTERS),
                                            .count = (uint16_t)(1 + below(below(4) ? 8 : 123)),
                                            .values = values};
    for (size_t i = 0; i < CANOPY_MODBUS_WRITE_MAX; i++)
        values[i] = (uint16_t)below(0xDEAD);
    if (request.function == 6)
        request.count = 1;
    if (request.function == 23) {
        request.write_address = (uint16_t)below(TABLE_REGISTERS);
        request.write_count = (uint16_t)(1 + below(121));
    }
    if (request.function == 43) {
        request.identify_code = (uint8_t)(1 + below(4));
        request.identify_object = (uint8_t)below(8);
    }
    return request;
}

static void start(void) {
    table_init(&table, &bank);
    table.objects[0] = "canopy";
    table.objects[2] = "1.0";
    table.objects[5] = "model";
    now_us = 1000000;
}

// ---------------------------------------------------------------------------------------------------------------------
// RTU

static struct canopy_modbus_rtu_server rtu_server;
static struct canopy_modbus_rtu_client rtu_client;

struct bytes {
    size_t length;
    uint8_t at[2 * CANOPY_MODBUS_RTU_ADU_MAX];
};

enum fault { NONE, CORRUPT, TRUNCATE, DROP, FOREIGN_FIRST, GARBAGE_FIRST, TWICE, LATE, FAULTS };

static void deliver(const uint8_t *bytes, size_t length, bool pauses) {
    for (size_t at = 0; at < length;) {
        const size_t count = 1 + below((uint32_t)(length - at));
        uint8_t *copy = malloc(count);
        memcpy(copy, bytes + at, count);
        now_us += pauses ? below(5000) : 0;
        canopy_modbus_rtu_client_feed(&rtu_client, copy, count, now_us);
        free(copy);
        at += count;
    }
}

// Takes the request from the client through the server; the server's reply.
static void serve(struct bytes *reply) {
    const uint8_t *bytes;
    while (canopy_modbus_rtu_client_pending(&rtu_client, now_us, &bytes) == 0)
        now_us += 100;
    while (true) {
        const size_t length = canopy_modbus_rtu_client_pending(&rtu_client, now_us, &bytes);
        if (length == 0)
            break;
        const size_t count = 1 + below((uint32_t)length);
        canopy_modbus_rtu_server_feed(&rtu_server, bytes, count, now_us);
        canopy_modbus_rtu_client_sent(&rtu_client, count, now_us);
    }
    now_us += SILENCE_US;
    reply->length = canopy_modbus_rtu_server_poll(&rtu_server, now_us, &bytes);
    assert_true(reply->length >= 5);
    memcpy(reply->at, bytes, reply->length);
    canopy_modbus_rtu_server_sent(&rtu_server, reply->length, now_us);
}

static void respond(const struct bytes *reply, enum fault fault) {
    struct bytes bad = *reply;
    switch (fault) {
    case CORRUPT:
        bad.at[below((uint32_t)bad.length)] ^= (uint8_t)(1 + below(255));
        deliver(bad.at, bad.length, false);
        break;
    case TRUNCATE: deliver(bad.at, below((uint32_t)bad.length), false); break;
    case DROP: break;
    case FOREIGN_FIRST:
        bad.at[0] = US + 1;
        table_crc(bad.at, bad.length - 2);
        deliver(bad.at, bad.length, true);
        now_us += SILENCE_US;
        deliver(reply->at, reply->length, false);
        break;
    case GARBAGE_FIRST:
        bad.length = 1 + below(40);
        for (size_t i = 0; i < bad.length; i++)
            bad.at[i] = (uint8_t)(below(2) ? below(256) : US);
        deliver(bad.at, bad.length, false);
        now_us += SILENCE_US;
        deliver(reply->at, reply->length, false);
        break;
    case TWICE:
        memcpy(bad.at + bad.length, reply->at, reply->length);
        deliver(bad.at, 2 * bad.length, false);
        break;
    case LATE:
        now_us += TIMEOUT_US;
        assert_int_equal(canopy_modbus_rtu_client_poll(&rtu_client, now_us), CANOPY_MODBUS_TIMED_OUT);
        deliver(reply->at, reply->length, true);
        break;
    default: deliver(reply->at, reply->length, true);
    }
}

static void an_rtu_client_reports_only_true_answers(void **state) {
    (void)state;
    unsigned done = 0, refused = 0, timed_out = 0;
    start();
    const struct canopy_modbus_rtu_server_config server = {.bank = &bank, .unit = US};
    const struct canopy_modbus_rtu_client_config client = {.timeout_us = TIMEOUT_US};
    assert_int_equal(canopy_modbus_rtu_server_init(&rtu_server, &server), CANOPY_OK);
    assert_int_equal(canopy_modbus_rtu_client_init(&rtu_client, &client, now_us), CANOPY_OK);
    for (unsigned round = 0; round < ROUNDS; round++) {
        const struct canopy_modbus_request request = random_request();
        const enum fault fault = round % 2 ? NONE : (enum fault)below(FAULTS);
        if (canopy_modbus_rtu_client_start(&rtu_client, &request) != CANOPY_OK)
            continue;  // beyond 121 registers to write, say
        struct bytes reply;
        serve(&reply);
        respond(&reply, fault);
        enum canopy_modbus_outcome outcome = canopy_modbus_rtu_client_poll(&rtu_client, now_us);
        if (fault == NONE || fault == TWICE)
            assert_true(outcome == CANOPY_MODBUS_DONE || outcome == CANOPY_MODBUS_REFUSED);
        if (fault == CORRUPT || fault == DROP || fault == TRUNCATE)
            assert_int_equal(outcome, CANOPY_MODBUS_PENDING);
        if (outcome == CANOPY_MODBUS_PENDING) {
            now_us += TIMEOUT_US;
            outcome = canopy_modbus_rtu_client_poll(&rtu_client, now_us);
            assert_int_equal(outcome, CANOPY_MODBUS_TIMED_OUT);
        }
        size_t length;
        const uint8_t *response = canopy_modbus_rtu_client_response(&rtu_client, &length);
        if (outcome == CANOPY_MODBUS_TIMED_OUT) {
            assert_int_equal(length, 0);
            timed_out++;
            continue;
        }
        assert_int_equal(length, reply.length - 3);
        assert_memory_equal(response, reply.at + 1, length);
        assert_int_equal(outcome == CANOPY_MODBUS_REFUSED, (reply.at[1] & 0x80) != 0);
        if (outcome == CANOPY_MODBUS_REFUSED) {
            assert_int_equal(canopy_modbus_rtu_client_exception(&rtu_client), reply.at[2]);
            refused++;
        } else if (request.function != 6 && request.function != 16 && request.function != 43) {
            uint16_t got[CANOPY_MODBUS_READ_MAX];
            assert_int_equal(canopy_modbus_rtu_client_registers(&rtu_client, got, CANOPY_MODBUS_READ_MAX),
                             request.count);
            assert_memory_equal(got, table.registers + request.address, 2u * request.count);
            done++;
        } else {
            done++;
        }
    }
    print_message("# %u done, %u refused, %u timed out, %u dropped\n", done, refused, timed_out, rtu_client.rx_errors);
    assert_true(done > 1000 && refused > 1000 && timed_out > 1000);
}

static void an_rtu_client_keeps_silence(void **state) {
    (void)state;
    start();
    const struct canopy_modbus_rtu_client_config config = {.timeout_us = TIMEOUT_US, .baud = 9600};
    const struct canopy_modbus_request request = {.unit = US, .function = 3, .count = 1};
    const uint8_t *bytes;
    assert_int_equal(canopy_modbus_rtu_client_init(&rtu_client, &config, now_us), CANOPY_OK);
    assert_int_equal(canopy_modbus_rtu_client_start(&rtu_client, &request), CANOPY_OK);
    for (unsigned i = 0; i < 8; i++) {  // a line that does not become silent
        now_us += 4000;
        canopy_modbus_rtu_client_feed(&rtu_client, (const uint8_t[]){1}, 1, now_us);
        assert_int_equal(canopy_modbus_rtu_client_pending(&rtu_client, now_us + 4010, &bytes), 0);
        assert_int_equal(canopy_modbus_rtu_client_poll(&rtu_client, now_us), CANOPY_MODBUS_PENDING);
    }
    assert_int_equal(canopy_modbus_rtu_client_pending(&rtu_client, now_us + 4011, &bytes), 8);
    assert_int_equal(canopy_modbus_rtu_client_poll(&rtu_client, now_us + TIMEOUT_US + 4011), CANOPY_MODBUS_TIMED_OUT);
    assert_int_equal(canopy_modbus_rtu_client_start(&rtu_client, &request), CANOPY_OK);
    canopy_modbus_rtu_client_abandon(&rtu_client);
    assert_int_equal(canopy_modbus_rtu_client_poll(&rtu_client, now_us), CANOPY_MODBUS_IDLE);
    // 8 bytes at 9600 take 9.2 ms, the response of 7 bytes 8.0 ms
    now_us += 4011;
    assert_int_equal(canopy_modbus_rtu_client_start(&rtu_client, &request), CANOPY_OK);
    canopy_modbus_rtu_client_sent(&rtu_client, 8, now_us);
    assert_int_equal(canopy_modbus_rtu_client_poll(&rtu_client, now_us + TIMEOUT_US + 17000), CANOPY_MODBUS_PENDING);
    assert_int_equal(canopy_modbus_rtu_client_poll(&rtu_client, now_us + TIMEOUT_US + 18000), CANOPY_MODBUS_TIMED_OUT);
}

// ---------------------------------------------------------------------------------------------------------------------
// TCP: the connection is a queue of bytes; answers come whole, late, doubled, with another number or not at all

static struct canopy_modbus_tcp_server tcp_server;
static struct canopy_modbus_tcp_client tcp_client;
static uint8_t queue[8 * CANOPY_MODBUS_TCP_ADU_MAX];
static size_t queued;

static void queue_bytes(const uint8_t *bytes, size_t length) {
    assert_true(queued + length <= sizeof queue);
    memcpy(queue + queued, bytes, length);
    queued += length;
}

static size_t tcp_serve(uint8_t *reply) {
    const uint8_t *bytes;
    for (size_t length; (length = canopy_modbus_tcp_client_pending(&tcp_client, &bytes)) > 0;) {
        const size_t count = 1 + below((uint32_t)length);
        assert_int_equal(canopy_modbus_tcp_server_feed(&tcp_server, bytes, count), count);
        canopy_modbus_tcp_client_sent(&tcp_client, count, now_us);
    }
    const size_t length = canopy_modbus_tcp_server_pending(&tcp_server, &bytes);
    assert_true(length >= 9);
    memcpy(reply, bytes, length);
    canopy_modbus_tcp_server_sent(&tcp_server, length);
    return length;
}

static void tcp_receive(void) {
    while (queued > 0) {
        const bool by_room = below(2);
        size_t count = 1 + below((uint32_t)queued);
        const size_t room = canopy_modbus_tcp_client_room(&tcp_client);
        if (by_room)
            count = room < queued ? room : queued;
        const size_t taken = canopy_modbus_tcp_client_feed(&tcp_client, queue, count);
        assert_true(taken <= count);
        if (by_room)
            assert_int_equal(taken, count);
        memmove(queue, queue + taken, queued - taken);
        queued -= taken;
        if (taken == 0)
            return;
    }
}

static void a_tcp_client_reports_only_true_answers(void **state) {
    (void)state;
    unsigned done = 0, timed_out = 0;
    start();
    const struct canopy_modbus_tcp_server_config server = {.bank = &bank, .unit = US};
    const struct canopy_modbus_tcp_client_config client = {.timeout_us = TIMEOUT_US};
    assert_int_equal(canopy_modbus_tcp_server_init(&tcp_server, &server), CANOPY_OK);
    assert_int_equal(canopy_modbus_tcp_client_init(&tcp_client, &client), CANOPY_OK);
    queued = 0;
    for (unsigned round = 0; round < ROUNDS; round++) {
        const struct canopy_modbus_request request = random_request();
        if (canopy_modbus_tcp_client_start(&tcp_client, &request, now_us) != CANOPY_OK)
            continue;
        uint8_t reply[CANOPY_MODBUS_TCP_ADU_MAX], other[CANOPY_MODBUS_TCP_ADU_MAX];
        const size_t length = tcp_serve(reply);
        memcpy(other, reply, length);
        const uint32_t fault = round % 2 ? 0 : below(6);
        size_t held = 0;  // of the reply, until after the timeout
        if (fault == 1)
            other[below(4)] ^= 1;  // transaction or protocol
        if (fault == 2)
            other[6] ^= 1;  // unit
        if (fault == 1 || fault == 2)
            queue_bytes(other, length);
        if (fault == 3 || fault == 4)
            held = 1 + below((uint32_t)length);
        if (fault != 5)
            queue_bytes(reply, length - held);
        tcp_receive();
        enum canopy_modbus_outcome outcome = canopy_modbus_tcp_client_poll(&tcp_client, now_us);
        if (fault < 3)
            assert_true(outcome == CANOPY_MODBUS_DONE || outcome == CANOPY_MODBUS_REFUSED);
        else
            assert_int_equal(outcome, CANOPY_MODBUS_PENDING);
        if (outcome == CANOPY_MODBUS_PENDING) {
            now_us += TIMEOUT_US;
            assert_int_equal(canopy_modbus_tcp_client_poll(&tcp_client, now_us), CANOPY_MODBUS_TIMED_OUT);
            queue_bytes(reply + length - held, held);
            timed_out++;
            continue;
        }
        size_t got_length;
        const uint8_t *got = canopy_modbus_tcp_client_response(&tcp_client, &got_length);
        assert_int_equal(got_length, length - 7);
        assert_memory_equal(got, reply + 7, got_length);
        done++;
    }
    print_message("# %u answered, %u timed out, %u dropped\n", done, timed_out, tcp_client.rx_errors);
    assert_true(done > 10000 && timed_out > 1000);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(an_rtu_client_reports_only_true_answers),
        cmocka_unit_test(an_rtu_client_keeps_silence),
        cmocka_unit_test(a_tcp_client_reports_only_true_answers),
    };
    return cmocka_run_group_tests_name("modbus_client", tests, NULL, NULL);
}
