/// One bit a thing, bit i at byte i/8, bit i%8: marks of cells and coefficients.
#ifndef CANOPY_NUM_BITS_H
#define CANOPY_NUM_BITS_H

#include <stdbool.h>
#include <stdint.h>

static inline bool canopy_bit_get(const uint8_t *bits, uint32_t at) {
    return ((uint32_t)bits[at / 8] >> (at % 8) & 1U) != 0;
}

/// True if it was clear.
static inline bool canopy_bit_set(uint8_t *bits, uint32_t at) {
    const bool was_clear = !canopy_bit_get(bits, at);
    bits[at / 8] = (uint8_t)(bits[at / 8] | 1U << (at % 8));
    return was_clear;
}

static inline void canopy_bit_clear(uint8_t *bits, uint32_t at) {
    bits[at / 8] = (uint8_t)(bits[at / 8] & ~(1U << (at % 8)));
}

#endif
