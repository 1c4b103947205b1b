/// The CRC of Modbus RTU (CRC-16/MODBUS: polynomial 0x8005 reflected, start 0xFFFF, sent low byte first).
///
/// Source: MODBUS over Serial Line V1.02, 6.2.2. Check value: "123456789" gives 0x4B37.
#ifndef CANOPY_MODBUS_CRC_H
#define CANOPY_MODBUS_CRC_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/num/crc.h"

#define CANOPY_MODBUS_CRC_START CANOPY_CRC16_START

/// Goes on from `crc` over `length` bytes; start with CANOPY_MODBUS_CRC_START.
static inline uint16_t canopy_modbus_crc(uint16_t crc, const uint8_t *bytes, size_t length) {
    return canopy_crc16(crc, bytes, length);
}

/// Writes the CRC of bytes[0, length) to bytes[length] and bytes[length + 1]; returns length + 2.
size_t canopy_modbus_crc_append(uint8_t *bytes, size_t length);

/// True when the last two of `length` bytes are the CRC of those before. False for fewer than four bytes.
bool canopy_modbus_crc_ok(const uint8_t *bytes, size_t length);

#endif
