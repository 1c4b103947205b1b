/// Sixteen bits, high byte first, as everything in Modbus but the CRC.
#ifndef CANOPY_MODBUS_BYTES_H
#define CANOPY_MODBUS_BYTES_H

#include <stdint.h>

static inline uint16_t canopy_modbus_get16(const uint8_t *from) { return (uint16_t)(from[0] << 8 | from[1]); }

static inline void canopy_modbus_put16(uint8_t *to, uint16_t value) {
    to[0] = (uint8_t)(value >> 8);
    to[1] = (uint8_t)(value & 0xFFu);
}

#endif
