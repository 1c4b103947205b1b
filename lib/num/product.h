/// Products of two numbers of 32 bits, of which a Cortex-M0+ has the low half only: it makes the other of digits of 16
/// bits, in half the time that the compiler's product of 64 bits takes there, and in a function, not at every place.
/// Everywhere else these are the processor's own instructions.
#ifndef CANOPY_NUM_PRODUCT_H
#define CANOPY_NUM_PRODUCT_H

#include <stdint.h>

#include "lib/inline.h"

/// floor(a b / 2^32) by digits.
CANOPY_INLINE uint32_t canopy_product_high_by_digits(uint32_t a, uint32_t b) {
    const uint32_t a0 = a & 0xFFFFU, a1 = a >> 16, b0 = b & 0xFFFFU, b1 = b >> 16;
    const uint32_t first = a1 * b0 + (a0 * b0 >> 16), second = a0 * b1 + (first & 0xFFFFU);
    return a1 * b1 + (first >> 16) + (second >> 16);
}

/// a b by digits, exact: of numbers without a sign, less what their signs count too much.
int64_t canopy_product_by_digits(int32_t a, int32_t b);

#if defined(__ARM_ARCH_6M__)
CANOPY_INLINE uint32_t canopy_product_high(uint32_t a, uint32_t b) { return canopy_product_high_by_digits(a, b); }
static inline int64_t canopy_wide(int32_t a, int32_t b) { return canopy_product_by_digits(a, b); }
#else
/// floor(a b / 2^32).
CANOPY_INLINE uint32_t canopy_product_high(uint32_t a, uint32_t b) { return (uint32_t)((uint64_t)a * b >> 32); }
/// a b, exact.
static inline int64_t canopy_wide(int32_t a, int32_t b) { return (int64_t)a * b; }
#endif

#endif
