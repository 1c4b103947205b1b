// How long a PDU is, from its own first bytes. Lengths beyond CANOPY_MODBUS_PDU_MAX come out as they are; whoever asks
// compares.
#include "lib/modbus/bytes.h"
#include "lib/modbus/pdu.h"

enum { MEI_IDENTIFY = 14, EXCEPTION_BIT = 0x80 };

// A byte at `at` counts what follows it.
static size_t counted(const uint8_t *pdu, size_t have, size_t at) {
    return have > at ? at + 1 + pdu[at] : CANOPY_MODBUS_LENGTH_MORE;
}

static size_t identify_request_length(const uint8_t *pdu, size_t have) {
    if (have < 2)
        return CANOPY_MODBUS_LENGTH_MORE;
    return pdu[1] == MEI_IDENTIFY ? 4 : CANOPY_MODBUS_LENGTH_OPEN;
}

size_t canopy_modbus_request_length(const uint8_t *pdu, size_t have) {
    if (have == 0)
        return CANOPY_MODBUS_LENGTH_MORE;
    switch (pdu[0]) {
    case 0x01:
    case 0x02:
    case 0x03:
    case 0x04:
    case 0x05:
    case 0x06:
    case 0x08: return 5;
    case 0x07:
    case 0x0B:
    case 0x0C:
    case 0x11: return 1;
    case 0x0F:
    case 0x10: return counted(pdu, have, 5);
    case 0x14:
    case 0x15: return counted(pdu, have, 1);
    case 0x16: return 7;
    case 0x17: return counted(pdu, have, 9);
    case 0x18: return 3;
    case 0x2B: return identify_request_length(pdu, have);
    default: return CANOPY_MODBUS_LENGTH_OPEN;
    }
}

// Header of seven bytes, the last of them the number of objects; each object is an id, a length and so many bytes.
static size_t identify_response_length(const uint8_t *pdu, size_t have) {
    if (have < 2)
        return CANOPY_MODBUS_LENGTH_MORE;
    if (pdu[1] != MEI_IDENTIFY)
        return CANOPY_MODBUS_LENGTH_OPEN;
    if (have < 7)
        return CANOPY_MODBUS_LENGTH_MORE;
    size_t length = 7;
    for (uint8_t left = pdu[6]; left > 0 && length <= CANOPY_MODBUS_PDU_MAX; left--) {
        if (length + 2 > have)
            return CANOPY_MODBUS_LENGTH_MORE;
        length += 2u + pdu[length + 1];
    }
    return length;
}

size_t canopy_modbus_response_length(const uint8_t *pdu, size_t have) {
    if (have == 0)
        return CANOPY_MODBUS_LENGTH_MORE;
    if (pdu[0] & EXCEPTION_BIT)
        return 2;
    switch (pdu[0]) {
    case 0x01:
    case 0x02:
    case 0x03:
    case 0x04:
    case 0x0C:
    case 0x11:
    case 0x14:
    case 0x15:
    case 0x17: return counted(pdu, have, 1);
    case 0x05:
    case 0x06:
    case 0x08:
    case 0x0B:
    case 0x0F:
    case 0x10: return 5;
    case 0x07: return 2;
    case 0x16: return 7;
    case 0x18: return have < 3 ? CANOPY_MODBUS_LENGTH_MORE : 3u + canopy_modbus_get16(pdu + 1);
    case 0x2B: return identify_response_length(pdu, have);
    default: return CANOPY_MODBUS_LENGTH_OPEN;
    }
}
