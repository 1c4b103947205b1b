#include "lib/modbus/bytes.h"
#include "lib/modbus/pdu.h"

#include <string.h>

// One request, while it is turned into its reply where it stands.
struct request {
    const struct canopy_modbus_bank *bank;
    uint8_t client;
    bool broadcast;
    uint8_t *pdu;
    size_t length;  // of the request, then of the reply
};

static bool in_table(uint16_t address, uint16_t count) { return (uint32_t)address + count <= 0x10000u; }

// 03 and 04: function, address, count.
static uint8_t serve_read(struct request *r) {
    if (r->broadcast)
        return CANOPY_MODBUS_NO_EXCEPTION;
    if (r->length != 5)
        return CANOPY_MODBUS_ILLEGAL_VALUE;
    const uint16_t address = canopy_modbus_get16(r->pdu + 1);
    const uint16_t count = canopy_modbus_get16(r->pdu + 3);
    if (count < 1 || count > CANOPY_MODBUS_READ_MAX)
        return CANOPY_MODBUS_ILLEGAL_VALUE;
    if (!in_table(address, count))
        return CANOPY_MODBUS_ILLEGAL_ADDRESS;
    r->pdu[1] = (uint8_t)(2 * count);
    r->length = 2u + 2u * count;
    return r->bank->read(r->bank->context, r->client, address, count, r->pdu + 2);
}

// 06: function, address, value; the reply is the request.
static uint8_t serve_write_one(struct request *r) {
    if (r->length != 5)
        return CANOPY_MODBUS_ILLEGAL_VALUE;
    return r->bank->write(r->bank->context, r->client, canopy_modbus_get16(r->pdu + 1), 1, r->pdu + 3, r->pdu[0]);
}

// 16: function, address, count, bytes, values; the reply is the first five bytes of the request.
static uint8_t serve_write(struct request *r) {
    if (r->length < 6)
        return CANOPY_MODBUS_ILLEGAL_VALUE;
    const uint16_t address = canopy_modbus_get16(r->pdu + 1);
    const uint16_t count = canopy_modbus_get16(r->pdu + 3);
    if (count < 1 || count > CANOPY_MODBUS_WRITE_MAX || r->pdu[5] != 2 * count || r->length != 6u + r->pdu[5])
        return CANOPY_MODBUS_ILLEGAL_VALUE;
    if (!in_table(address, count))
        return CANOPY_MODBUS_ILLEGAL_ADDRESS;
    r->length = 5;
    return r->bank->write(r->bank->context, r->client, address, count, r->pdu + 6, r->pdu[0]);
}

// 23: function, read address and count, write address and count, bytes, values. Everything that can be refused without
// an effect is refused before the write.
static uint8_t serve_exchange(struct request *r) {
    const struct canopy_modbus_bank *bank = r->bank;
    if (r->length < 10)
        return CANOPY_MODBUS_ILLEGAL_VALUE;
    const uint16_t address = canopy_modbus_get16(r->pdu + 1);
    const uint16_t count = canopy_modbus_get16(r->pdu + 3);
    const uint16_t write_address = canopy_modbus_get16(r->pdu + 5);
    const uint16_t write_count = canopy_modbus_get16(r->pdu + 7);
    if (count < 1 || count > CANOPY_MODBUS_READ_MAX || write_count < 1 || write_count > CANOPY_MODBUS_EXCHANGE_MAX ||
        r->pdu[9] != 2 * write_count || r->length != 10u + r->pdu[9])
        return CANOPY_MODBUS_ILLEGAL_VALUE;
    if (!in_table(address, count) || !in_table(write_address, write_count))
        return CANOPY_MODBUS_ILLEGAL_ADDRESS;
    uint8_t exception = 0;
    if (bank->readable && !r->broadcast)
        exception = bank->readable(bank->context, r->client, address, count);
    if (!exception)
        exception = bank->write(bank->context, r->client, write_address, write_count, r->pdu + 10, r->pdu[0]);
    if (exception || r->broadcast)
        return exception;
    r->pdu[1] = (uint8_t)(2 * count);
    r->length = 2u + 2u * count;
    return bank->read(bank->context, r->client, address, count, r->pdu + 2);
}

// ---------------------------------------------------------------------------------------------------------------------
// 43/14

enum {
    MEI_IDENTIFY = 14,
    LAST_BASIC = 2,
    LAST_REGULAR = 6,
    CONFORMS_BASIC = 0x81,  // stream and individual access
    CONFORMS_REGULAR = 0x82,
    MORE_FOLLOWS = 0xFF,
    HEADER = 7
};

// NULL where there is no such object.
static const char *object(const struct canopy_modbus_bank *bank, uint8_t id) {
    if (id > LAST_REGULAR)
        return NULL;
    const char *text = bank->identify(bank->context, id);
    return text == NULL && id <= LAST_BASIC ? "" : text;
}

static uint8_t conformity(const struct canopy_modbus_bank *bank) {
    for (uint8_t id = LAST_BASIC + 1; id <= LAST_REGULAR; id++)
        if (object(bank, id))
            return CONFORMS_REGULAR;
    return CONFORMS_BASIC;
}

// Adds an object to the reply; false when it does not fit any more.
static bool add_object(struct request *r, uint8_t id, const char *text) {
    size_t length = 0;
    while (length < CANOPY_MODBUS_OBJECT_MAX && text[length])
        length++;
    if (r->length + 2 + length > CANOPY_MODBUS_PDU_MAX)
        return false;
    uint8_t *to = r->pdu + r->length;
    to[0] = id;
    to[1] = (uint8_t)length;
    memcpy(to + 2, text, length);
    r->length += 2 + length;
    r->pdu[6]++;
    return true;
}

static void add_objects(struct request *r, uint8_t first, uint8_t last) {
    for (uint8_t id = first; id <= last; id++) {
        const char *text = object(r->bank, id);
        if (text && !add_object(r, id, text)) {
            r->pdu[4] = MORE_FOLLOWS;
            r->pdu[5] = id;
            return;
        }
    }
}

// Request: function, MEI type, access code, object. Reply: those three, conformity, more follows, next object, number
// of objects, objects. A stream asked for from an unknown object starts over.
static uint8_t serve_identify(struct request *r) {
    if (!r->bank->identify || (r->length >= 2 && r->pdu[1] != MEI_IDENTIFY))
        return CANOPY_MODBUS_ILLEGAL_FUNCTION;
    if (r->length != 4)
        return CANOPY_MODBUS_ILLEGAL_VALUE;
    const uint8_t code = r->pdu[2];
    uint8_t first = r->pdu[3];
    if (code < CANOPY_MODBUS_IDENTIFY_BASIC || code > CANOPY_MODBUS_IDENTIFY_ONE)
        return CANOPY_MODBUS_ILLEGAL_VALUE;
    uint8_t last = code == CANOPY_MODBUS_IDENTIFY_BASIC ? LAST_BASIC : LAST_REGULAR;
    const bool known = first <= last && object(r->bank, first);
    if (code == CANOPY_MODBUS_IDENTIFY_ONE) {
        if (!known)
            return CANOPY_MODBUS_ILLEGAL_ADDRESS;
        last = first;
    } else if (!known) {
        first = 0;
    }
    r->pdu[3] = conformity(r->bank);
    r->pdu[4] = 0;
    r->pdu[5] = 0;
    r->pdu[6] = 0;
    r->length = HEADER;
    add_objects(r, first, last);
    return CANOPY_MODBUS_NO_EXCEPTION;
}

// ---------------------------------------------------------------------------------------------------------------------

static uint8_t dispatch(struct request *r) {
    switch (r->pdu[0]) {
    case CANOPY_MODBUS_READ_HOLDING:
    case CANOPY_MODBUS_READ_INPUT: return serve_read(r);
    case CANOPY_MODBUS_WRITE_ONE: return serve_write_one(r);
    case CANOPY_MODBUS_WRITE: return serve_write(r);
    case CANOPY_MODBUS_EXCHANGE: return serve_exchange(r);
    case CANOPY_MODBUS_IDENTIFY: return r->broadcast ? CANOPY_MODBUS_NO_EXCEPTION : serve_identify(r);
    default: return CANOPY_MODBUS_ILLEGAL_FUNCTION;
    }
}

size_t canopy_modbus_serve(const struct canopy_modbus_bank *bank, uint8_t client, bool broadcast, uint8_t *pdu,
                           size_t length) {
    struct request r = {bank, client, broadcast, pdu, length};
    const uint8_t function = pdu[0];
    const uint8_t exception = dispatch(&r);
    if (broadcast)
        return 0;
    if (!exception)
        return r.length;
    pdu[0] = (uint8_t)(function | 0x80u);
    pdu[1] = exception;
    return 2;
}
