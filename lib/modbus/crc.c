#include "lib/modbus/crc.h"

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
