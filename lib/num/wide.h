/// The few operations that need 128 bits in between: products over a divisor, and comparing two fractions.
///
/// Where the compiler has a 128-bit integer it is used; elsewhere 32-bit digits and a long division, bit by bit, do the
/// same. Cost of the latter on a Cortex-M3: some 800 instructions for a quotient, 40 for a comparison.
#ifndef CANOPY_NUM_WIDE_H
#define CANOPY_NUM_WIDE_H

#include <stdbool.h>
#include <stdint.h>

/// A product of two 64-bit numbers.
struct canopy_wide_product {
    uint64_t high, low;
};

/// a * b, exact, by digits of 32 bits: what chips without a 128-bit integer do, and the host where tests ask for it.
static inline struct canopy_wide_product canopy_wide_by_digits(uint64_t a, uint64_t b) {
    const uint64_t a0 = (uint32_t)a, a1 = a >> 32, b0 = (uint32_t)b, b1 = b >> 32;
    const uint64_t low = a0 * b0, first = a1 * b0 + (low >> 32), second = a0 * b1 + (uint32_t)first;
    return (struct canopy_wide_product){a1 * b1 + (first >> 32) + (second >> 32), second << 32 | (uint32_t)low};
}

/// floor(p / c) for p.high < c, bit by bit.
static inline uint64_t canopy_wide_divide_by_bits(struct canopy_wide_product p, uint64_t c) {
    uint64_t rest = p.high, quotient = p.low;
    for (int bit = 0; bit < 64; bit++) {
        const bool carry = rest >> 63 != 0;
        rest = rest << 1 | quotient >> 63;
        quotient <<= 1;
        if (carry || rest >= c) {
            rest -= c;
            quotient |= 1;
        }
    }
    return quotient;
}

/// floor(a * b / c), c > 0. What does not fit 64 bits is UINT64_MAX.
static inline uint64_t canopy_mul_div(uint64_t a, uint64_t b, uint64_t c) {
    if ((a | b) >> 32 == 0) {
        return a * b / c;
    }
#ifdef __SIZEOF_INT128__
    __extension__ typedef unsigned __int128 wide;
    const wide product = (wide)a * b;
    if ((uint64_t)(product >> 64) == 0) {
        return (uint64_t)product / c;
    }
    return (uint64_t)(product >> 64) >= c ? UINT64_MAX : (uint64_t)(product / c);
#else
    const struct canopy_wide_product product = canopy_wide_by_digits(a, b);
    if (product.high == 0) {
        return product.low / c;
    }
    return product.high >= c ? UINT64_MAX : canopy_wide_divide_by_bits(product, c);
#endif
}

/// a/b < c/d, exactly; b, d > 0.
static inline bool canopy_ratio_less(uint64_t a, uint64_t b, uint64_t c, uint64_t d) {
    const struct canopy_wide_product left = canopy_wide_by_digits(a, d), right = canopy_wide_by_digits(c, b);
    return left.high < right.high || (left.high == right.high && left.low < right.low);
}

#endif
