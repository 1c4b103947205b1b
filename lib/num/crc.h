/// Check sums of bytes on wires.
#ifndef CANOPY_NUM_CRC_H
#define CANOPY_NUM_CRC_H

#include <stddef.h>
#include <stdint.h>

#define CANOPY_CRC16_START 0xFFFFu

/// CRC-16/MODBUS (polynomial 0x8005 reflected, start 0xFFFF): goes on from `crc` over `length` bytes. "123456789" gives
/// 0x4B37. Finds every change of up to three bits and every burst of up to 16 in what a wire of canopy carries at
/// once. Two table look-ups a byte, 32 bytes of table.
uint16_t canopy_crc16(uint16_t crc, const uint8_t *bytes, size_t length);

#define CANOPY_CRC8_START 0u

/// CRC-8, SMBus' packet error code (polynomial 0x07, start 0; System Management Bus 3.2, 6.4.1.1): goes on from `crc`.
/// "123456789" gives 0xF4.
uint8_t canopy_crc8(uint8_t crc, const uint8_t *bytes, size_t length);

#endif
