#include "lib/modbus/crc.h"

uint16_t canopy_modbus_crc(uint16_t crc, const uint8_t *bytes, size_t length) {
    // What a nibble in the low bits turns into after four shifts of the reflected polynomial 0xA001.
    static const uint16_t nibble[16] = {0x0000, 0xCC01, 0xD801, 0x1400, 0xF001, 0x3C00, 0x2800, 0xE401,
                                        0xA001, 0x6C00, 0x7800, 0xB401, 0x5000, 0x9C01, 0x8801, 0x4400};
    uint32_t sum = crc;
    for (size_t i = 0; i < length; i++) {
        sum ^= bytes[i];
        sum = (sum >> 4) ^ nibble[sum & 15u];
        sum = (sum >> 4) ^ nibble[sum & 15u];
    }
    return (uint16_t)sum;
}

size_t canopy_modbus_crc_append(uint8_t *bytes, size_t length) {
    const uint16_t crc = canopy_modbus_crc(CANOPY_MODBUS_CRC_START, bytes, length);
    bytes[length] = (uint8_t)(crc & 0xFFu);
    bytes[length + 1] = (uint8_t)(crc >> 8);
    return length + 2;
}

bool canopy_modbus_crc_ok(const uint8_t *bytes, size_t length) {
    // A frame followed by its own CRC, low byte first, leaves nothing.
    return length >= 4 && canopy_modbus_crc(CANOPY_MODBUS_CRC_START, bytes, length) == 0;
}
