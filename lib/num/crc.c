#include "lib/num/crc.h"

uint16_t canopy_crc16(uint16_t crc, const uint8_t *bytes, size_t length) {
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

uint8_t canopy_crc8(uint8_t crc, const uint8_t *bytes, size_t length) {
    uint32_t sum = crc;
    for (size_t i = 0; i < length; i++) {
        sum ^= bytes[i];
        for (unsigned bit = 0; bit < 8; bit++)
            sum = (sum << 1) ^ (sum & 0x80u ? 0x107u : 0u);
    }
    return (uint8_t)sum;
}
