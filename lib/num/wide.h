/// The few operations that need 128 bits in between: products over a divisor, and comparing two fractions.
///
/// Where the compiler has a 128-bit integer it is used; elsewhere digits of 32 bits do the same.
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

/// One digit of 32 bits of rest:next / c, rest < c, c with its highest bit set: the estimate from c's own highest digit
/// is at most two too large. What remains is left in *rest.
static inline uint32_t canopy_wide_digit(uint64_t *rest, uint32_t next, uint64_t c) {
    const uint64_t c1 = c >> 32, c0 = (uint32_t)c;
    uint64_t digit = *rest / c1, left = *rest - digit * c1;
    while (digit >> 32 != 0 || digit * c0 > (left << 32 | next)) {
        digit--;
        left += c1;
        if (left >> 32 != 0) {
            break;
        }
    }
    *rest = (*rest << 32 | next) - digit * c;
    return (uint32_t)digit;
}

/// floor(p / c) for p.high < c, by digits (D. Knuth, The Art of Computer Programming, 4.3.1, Algorithm D).
static inline uint64_t canopy_wide_divide_by_digits(struct canopy_wide_product p, uint64_t c) {
    unsigned shift = 0;
    for (unsigned bits = 32; bits > 0; bits /= 2) {
        if (c << shift >> (64 - bits) == 0) {
            shift += bits;
        }
    }
    const uint64_t divisor = c << shift, low = p.low << shift;
    uint64_t rest = shift == 0 ? p.high : p.high << shift | p.low >> (64 - shift);
    const uint64_t first = canopy_wide_digit(&rest, (uint32_t)(low >> 32), divisor);
    return first << 32 | canopy_wide_digit(&rest, (uint32_t)low, divisor);
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
    return product.high >= c ? UINT64_MAX : canopy_wide_divide_by_digits(product, c);
#endif
}

/// a/b < c/d, exactly; b, d > 0.
static inline bool canopy_ratio_less(uint64_t a, uint64_t b, uint64_t c, uint64_t d) {
    const struct canopy_wide_product left = canopy_wide_by_digits(a, d), right = canopy_wide_by_digits(c, b);
    return left.high < right.high || (left.high == right.high && left.low < right.low);
}

#endif
