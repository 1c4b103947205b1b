// The client's half of the PDU: requests are written, responses judged.
#include "lib/modbus/bytes.h"
#include "lib/modbus/pdu.h"

#include <string.h>

enum { MEI_IDENTIFY = 14 };

static bool in_limits(uint16_t address, uint16_t count, uint16_t limit) {
    return count >= 1 && count <= limit && (uint32_t)address + count <= 0x10000u;
}

static void put_values(uint8_t *to, const uint16_t *values, uint16_t count) {
    for (uint16_t i = 0; i < count; i++)
        canopy_modbus_put16(to + 2u * i, values[i]);
}

static size_t write_read(const struct canopy_modbus_request *request, uint8_t *pdu) {
    if (!in_limits(request->address, request->count, CANOPY_MODBUS_READ_MAX))
        return 0;
    canopy_modbus_put16(pdu + 1, request->address);
    canopy_modbus_put16(pdu + 3, request->count);
    return 5;
}

static size_t write_one(const struct canopy_modbus_request *request, uint8_t *pdu) {
    if (request->count != 1 || !request->values)
        return 0;
    canopy_modbus_put16(pdu + 1, request->address);
    canopy_modbus_put16(pdu + 3, request->values[0]);
    return 5;
}

static size_t write_many(const struct canopy_modbus_request *request, uint8_t *pdu) {
    if (!request->values || !in_limits(request->address, request->count, CANOPY_MODBUS_WRITE_MAX))
        return 0;
    canopy_modbus_put16(pdu + 1, request->address);
    canopy_modbus_put16(pdu + 3, request->count);
    pdu[5] = (uint8_t)(2 * request->count);
    put_values(pdu + 6, request->values, request->count);
    return 6u + pdu[5];
}

static size_t write_exchange(const struct canopy_modbus_request *request, uint8_t *pdu) {
    if (!request->values || !in_limits(request->address, request->count, CANOPY_MODBUS_READ_MAX) ||
        !in_limits(request->write_address, request->write_count, CANOPY_MODBUS_EXCHANGE_MAX))
        return 0;
    canopy_modbus_put16(pdu + 1, request->address);
    canopy_modbus_put16(pdu + 3, request->count);
    canopy_modbus_put16(pdu + 5, request->write_address);
    canopy_modbus_put16(pdu + 7, request->write_count);
    pdu[9] = (uint8_t)(2 * request->write_count);
    put_values(pdu + 10, request->values, request->write_count);
    return 10u + pdu[9];
}

static size_t write_identify(const struct canopy_modbus_request *request, uint8_t *pdu) {
    if (request->identify_code < CANOPY_MODBUS_IDENTIFY_BASIC || request->identify_code > CANOPY_MODBUS_IDENTIFY_ONE)
        return 0;
    pdu[1] = MEI_IDENTIFY;
    pdu[2] = request->identify_code;
    pdu[3] = request->identify_object;
    return 4;
}

static size_t write_by_function(const struct canopy_modbus_request *request, uint8_t *pdu) {
    switch (request->function) {
    case CANOPY_MODBUS_READ_HOLDING:
    case CANOPY_MODBUS_READ_INPUT: return write_read(request, pdu);
    case CANOPY_MODBUS_WRITE_ONE: return write_one(request, pdu);
    case CANOPY_MODBUS_WRITE: return write_many(request, pdu);
    case CANOPY_MODBUS_EXCHANGE: return write_exchange(request, pdu);
    case CANOPY_MODBUS_IDENTIFY: return write_identify(request, pdu);
    default: return 0;
    }
}

size_t canopy_modbus_request_write(const struct canopy_modbus_request *request, uint8_t *pdu,
                                   struct canopy_modbus_expected *expected) {
    const uint8_t function = request->function;
    if (request->unit == 0 && function != CANOPY_MODBUS_WRITE_ONE && function != CANOPY_MODBUS_WRITE)
        return 0;
    const size_t length = write_by_function(request, pdu);
    if (length == 0)
        return 0;
    pdu[0] = function;
    memset(expected, 0, sizeof *expected);
    expected->function = function;
    if (function == CANOPY_MODBUS_WRITE_ONE || function == CANOPY_MODBUS_WRITE)
        memcpy(expected->echo, pdu + 1, 4);
    else if (function == CANOPY_MODBUS_IDENTIFY)
        expected->echo[0] = request->identify_code;
    else
        expected->bytes = (uint8_t)(2 * request->count);
    return length;
}

static bool is_answer(const struct canopy_modbus_expected *expected, const uint8_t *pdu, size_t length) {
    switch (expected->function) {
    case CANOPY_MODBUS_WRITE_ONE:
    case CANOPY_MODBUS_WRITE: return length == 5 && memcmp(pdu + 1, expected->echo, 4) == 0;
    case CANOPY_MODBUS_IDENTIFY:
        return length >= 7 && pdu[1] == MEI_IDENTIFY && pdu[2] == expected->echo[0] &&
               canopy_modbus_response_length(pdu, length) == length;
    default: return length == 2u + expected->bytes && pdu[1] == expected->bytes;
    }
}

enum canopy_modbus_verdict canopy_modbus_response_check(const struct canopy_modbus_expected *expected,
                                                        const uint8_t *pdu, size_t length) {
    if (length == 2 && pdu[0] == (expected->function | 0x80u) && pdu[1] != 0)
        return CANOPY_MODBUS_EXCEPTION;
    if (length < 2 || pdu[0] != expected->function || !is_answer(expected, pdu, length))
        return CANOPY_MODBUS_MISMATCH;
    return CANOPY_MODBUS_ANSWER;
}

size_t canopy_modbus_registers(const struct canopy_modbus_expected *expected, const uint8_t *pdu, uint16_t *to,
                               size_t count) {
    const size_t there = expected->bytes / 2u;
    const size_t copied = there < count ? there : count;
    for (size_t i = 0; i < copied; i++)
        to[i] = canopy_modbus_get16(pdu + 2 + 2 * i);
    return copied;
}
