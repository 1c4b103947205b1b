/// Time on a serial line. Private to lib/modbus.
#ifndef CANOPY_MODBUS_RTU_TIME_H
#define CANOPY_MODBUS_RTU_TIME_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/// Length of a character in microseconds times 256, rounded down; 0 without a baud rate.
uint32_t canopy_modbus_rtu_character_q8(uint32_t baud, uint8_t bits);

/// How long `count` characters take, rounded down, so that no silence is overlooked.
static inline uint64_t canopy_modbus_rtu_wire_us(uint32_t character_q8, size_t count) {
    return ((uint64_t)count * character_q8) >> 8;
}

/// From `from` to `to`, 0 if that is backwards.
static inline uint64_t canopy_modbus_rtu_since(uint64_t from, uint64_t to) { return to > from ? to - from : 0; }

static inline bool canopy_modbus_rtu_bits_ok(uint8_t bits) { return bits == 0 || bits == 10 || bits == 11; }

#endif
