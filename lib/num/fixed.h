/// 32-bit fixed point with wide accumulators. Every operation that loses something says in its name which way.
///
/// A number is an int32_t that stands for value * 2^-Q; the format Q is the caller's and stands in the name of what
/// holds it. Products and sums are made in int64_t, where they are exact, and come back through one of the
/// `narrow` functions. What does not fit saturates *and* raises a flag that stays raised: saturation is never a
/// silent result, and no value of the result is reserved to mean it.
///
/// All functions are constant-time but for the compiler's own 64-bit division in canopy_div_*.
#ifndef CANOPY_NUM_FIXED_H
#define CANOPY_NUM_FIXED_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/num/product.h"

/// floor(a / 2^shift), shift 0 to 62.
static inline int64_t canopy_shift_floor(int64_t a, unsigned shift) {
    // C11 leaves >> of a negative number to the compiler; every compiler this library is built with shifts
    // arithmetically, and hosttest/unit/test_num.c proves it on each target.
    return a >> shift;
}

/// ceil(a / 2^shift), shift 0 to 62; a may be at most INT64_MAX - 2^shift + 1.
static inline int64_t canopy_shift_ceil(int64_t a, unsigned shift) {
    return (a + (((int64_t)1 << shift) - 1)) >> shift;
}

/// a as 32 bits. Saturates and raises *saturated where it does not fit; never lowers the flag.
static inline int32_t canopy_narrow(int64_t a, bool *saturated) {
    if (a == (int32_t)a) {
        return (int32_t)a;
    }
    *saturated = true;
    return a < 0 ? INT32_MIN : INT32_MAX;
}

/// ceil(a / b) of what has no sign; a + b below 2^64.
static inline uint64_t canopy_div_up(uint64_t a, uint64_t b) { return (a + b - 1) / b; }

/// ceil(a / b) for b > 0.
static inline int64_t canopy_div_ceil(int64_t a, int64_t b) {
    const int64_t quotient = a / b;
    return quotient + (a % b > 0 ? 1 : 0);
}

/// The smallest k with 2^k >= a; 0 for a <= 1.
static inline unsigned canopy_log2_ceil(uint64_t a) {
    unsigned k = 0;
    while (k < 63 && ((uint64_t)1 << k) < a) {
        k++;
    }
    return k;
}

#endif
