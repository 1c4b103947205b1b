// libFuzzer on the Modbus engines: RTU server, TCP server, RTU client and TCP client, chosen by the first byte. The
// rest is a list of steps: a byte that says what to do and for how long, then so many bytes of input.
#include <stdlib.h>
#include <string.h>

#include "hosttest/modbus_table.h"
#include "lib/modbus/rtu.h"
#include "lib/modbus/tcp.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static struct table table;
static struct canopy_modbus_bank bank;

struct input {
    const uint8_t *at;
    size_t left;
};

// The next step's bytes in memory of their exact size; its first byte goes to *step. NULL at the end.
static uint8_t *next(struct input *input, uint8_t *step, size_t *length) {
    if (input->left < 2)
        return NULL;
    *step = input->at[0];
    *length = input->at[1] < input->left - 2 ? input->at[1] : input->left - 2;
    uint8_t *copy = malloc(*length ? *length : 1);
    if (*length)
        memcpy(copy, input->at + 2, *length);
    input->at += 2 + *length;
    input->left -= 2 + *length;
    return copy;
}

static void expect(bool condition) {
    if (!condition)
        abort();
}

// The low nibble of a step is the time before it, in powers of two of microseconds times 8.
static uint64_t delay_us(uint8_t step) { return (uint64_t)4 << (step & 15u); }

// A right CRC is hard to guess: bit 4 of a step asks for one.
static void help(uint8_t step, uint8_t *bytes, size_t length) {
    if ((step & 0x10) && length >= 4)
        table_crc(bytes, length - 2);
}

static void rtu_server(struct input *input) {
    static struct canopy_modbus_rtu_server server;
    const struct canopy_modbus_rtu_server_config config = {.bank = &bank, .unit = 1, .baud = 115200};
    expect(canopy_modbus_rtu_server_init(&server, &config) == CANOPY_OK);
    uint64_t now_us = 0;
    uint8_t step;
    size_t length;
    for (uint8_t *bytes; (bytes = next(input, &step, &length)) != NULL; free(bytes)) {
        const uint8_t *reply;
        now_us += delay_us(step);
        help(step, bytes, length);
        canopy_modbus_rtu_server_feed(&server, bytes, length, now_us);
        const size_t pending = canopy_modbus_rtu_server_poll(&server, now_us + (step & 0x20 ? 1750 : 0), &reply);
        expect(pending <= CANOPY_MODBUS_RTU_ADU_MAX);
        if (pending && (step & 0x40)) {
            uint8_t copy[CANOPY_MODBUS_RTU_ADU_MAX];
            memcpy(copy, reply, pending);
            canopy_modbus_rtu_server_sent(&server, (step & 0x80) ? pending : 1, now_us);
        }
    }
    // Whatever came before: a request after a silence is answered.
    const uint8_t *reply;
    uint8_t request[8] = {1, 3, 0, 0, 0, 1};
    table_crc(request, 6);
    table.fail = 0;
    size_t pending = canopy_modbus_rtu_server_poll(&server, now_us, &reply);
    canopy_modbus_rtu_server_sent(&server, pending, now_us);  // a reply under way goes first
    now_us += 3000;
    canopy_modbus_rtu_server_feed(&server, request, 8, now_us);
    pending = canopy_modbus_rtu_server_poll(&server, now_us + 1750, &reply);
    expect(pending == 7 && reply[0] == 1 && reply[1] == 3);
}

static void tcp_server(struct input *input) {
    static struct canopy_modbus_tcp_server server;
    const struct canopy_modbus_tcp_server_config config = {.bank = &bank, .unit = 1};
    expect(canopy_modbus_tcp_server_init(&server, &config) == CANOPY_OK);
    uint8_t step;
    size_t length;
    for (uint8_t *bytes; (bytes = next(input, &step, &length)) != NULL; free(bytes)) {
        const size_t room = canopy_modbus_tcp_server_room(&server);
        const size_t count = (step & 1) && room < length ? room : length;
        const size_t taken = canopy_modbus_tcp_server_feed(&server, bytes, count);
        expect(taken <= count && (count > room || taken == count));
        const uint8_t *reply;
        const size_t pending = canopy_modbus_tcp_server_pending(&server, &reply);
        expect(pending <= CANOPY_MODBUS_TCP_ADU_MAX);
        if (pending) {
            uint8_t copy[CANOPY_MODBUS_TCP_ADU_MAX];
            memcpy(copy, reply, pending);
            canopy_modbus_tcp_server_sent(&server, (step & 2) ? pending : 1);
        }
    }
}

static const uint16_t values[CANOPY_MODBUS_WRITE_MAX];

static struct canopy_modbus_request request_of(const uint8_t *bytes, size_t length) {
    struct canopy_modbus_request request = {.unit = 1, .function = 3, .count = 1, .values = values};
    if (length >= 8) {
        request.unit = bytes[0];
        request.function = bytes[1];
        request.address = (uint16_t)(bytes[2] << 8 | bytes[3]);
        request.count = bytes[4];
        request.write_count = bytes[5];
        request.identify_code = bytes[6];
        request.identify_object = bytes[7];
    }
    return request;
}

static void check_registers(size_t (*registers)(uint16_t *)) {
    uint16_t *got = malloc(3 * sizeof *got);
    expect(registers(got) <= 3);
    free(got);
}

static struct canopy_modbus_rtu_client rtu;
static struct canopy_modbus_tcp_client tcp;

static size_t rtu_registers(uint16_t *to) { return canopy_modbus_rtu_client_registers(&rtu, to, 3); }
static size_t tcp_registers(uint16_t *to) { return canopy_modbus_tcp_client_registers(&tcp, to, 3); }

static void rtu_client(struct input *input) {
    const struct canopy_modbus_rtu_client_config config = {.timeout_us = 100000, .baud = 115200};
    uint64_t now_us = 0;
    expect(canopy_modbus_rtu_client_init(&rtu, &config, now_us) == CANOPY_OK);
    uint8_t step;
    size_t length;
    for (uint8_t *bytes; (bytes = next(input, &step, &length)) != NULL; free(bytes)) {
        now_us += delay_us(step);
        if (step & 0x40) {
            const struct canopy_modbus_request request = request_of(bytes, length);
            (void)canopy_modbus_rtu_client_start(&rtu, &request);
        } else {
            help(step, bytes, length);
            canopy_modbus_rtu_client_feed(&rtu, bytes, length, now_us);
        }
        const uint8_t *out;
        const size_t pending = canopy_modbus_rtu_client_pending(&rtu, now_us + 2000, &out);
        expect(pending <= CANOPY_MODBUS_RTU_ADU_MAX);
        canopy_modbus_rtu_client_sent(&rtu, (step & 0x80) ? pending : pending / 2, now_us);
        (void)canopy_modbus_rtu_client_poll(&rtu, now_us);
        (void)canopy_modbus_rtu_client_response(&rtu, &length);
        expect(length <= CANOPY_MODBUS_PDU_MAX);
        check_registers(rtu_registers);
    }
}

static void tcp_client(struct input *input) {
    const struct canopy_modbus_tcp_client_config config = {.timeout_us = 100000};
    uint64_t now_us = 0;
    expect(canopy_modbus_tcp_client_init(&tcp, &config) == CANOPY_OK);
    uint8_t step;
    size_t length;
    for (uint8_t *bytes; (bytes = next(input, &step, &length)) != NULL; free(bytes)) {
        now_us += delay_us(step);
        if (step & 0x40) {
            const struct canopy_modbus_request request = request_of(bytes, length);
            (void)canopy_modbus_tcp_client_start(&tcp, &request, now_us);
        } else {
            expect(canopy_modbus_tcp_client_feed(&tcp, bytes, length) <= length);
        }
        const uint8_t *out;
        const size_t pending = canopy_modbus_tcp_client_pending(&tcp, &out);
        expect(pending <= CANOPY_MODBUS_TCP_ADU_MAX);
        canopy_modbus_tcp_client_sent(&tcp, (step & 0x80) ? pending : pending / 2, now_us);
        (void)canopy_modbus_tcp_client_poll(&tcp, now_us);
        (void)canopy_modbus_tcp_client_response(&tcp, &length);
        expect(length <= CANOPY_MODBUS_PDU_MAX);
        check_registers(tcp_registers);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    if (size == 0)
        return 0;
    table_init(&table, &bank);
    table.objects[0] = "canopy";
    table.objects[5] = "model";
    table.fail = data[0] >> 5 == 7 ? CANOPY_MODBUS_BUSY : 0;
    struct input input = {data + 1, size - 1};
    switch (data[0] % 4) {
    case 0: rtu_server(&input); break;
    case 1: tcp_server(&input); break;
    case 2: rtu_client(&input); break;
    default: tcp_client(&input);
    }
    return 0;
}
