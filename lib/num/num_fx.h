/// The scalar of the fixed-point line fit: what lib/num/band.inc and lib/cover/line.inc ask of a number.
///
/// `num` is a weight of order one in Q24: range +-127, resolution 6e-8. `val` is a height in whole steps. `acc` is a
/// sum of weight * height in Q24, 64 bits wide, exact. The fit may round as it likes, because nothing it says is
/// believed before canopy_line_lift and the certificate have looked at it: so everything here rounds to nearest or
/// down, whichever is cheaper on a Cortex-M3.
///
/// Included by the .inc files' two instantiations only, one scalar a translation unit.
#ifndef CANOPY_NUM_FX_H
#define CANOPY_NUM_FX_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/num/fixed.h"

typedef int32_t num;
typedef int32_t val;
typedef int64_t acc;

#define NUM(name) name##_fx
#define NUM_ONE (1 << 24)
#define NUM_VAL_BITS 22  // heights are scaled to at most 2^22: nine bits of room for what elimination adds

/// p / q for 0 <= p <= q <= 2^17.
static inline num num_ratio(int32_t p, int32_t q) {
    return (num)((((uint64_t)(uint32_t)p << 24) + (uint32_t)q / 2) / (uint32_t)q);
}

static inline num num_mul(num a, num b, bool *saturated) { return canopy_narrow(canopy_wide(a, b) >> 24, saturated); }

/// 1 / a for 1/64 <= |a| < 64, to about 20 bits: one 32-bit division for 11 bits, one Newton step for the rest.
static inline num num_inverse(num a) {
    const uint32_t size = (uint32_t)(a < 0 ? -a : a);
    const uint32_t guess = UINT32_MAX / (size >> 8);                 // about 2^40 / size, 11 to 23 bits
    const int32_t miss = (int32_t)(((uint64_t)guess * size) >> 16);  // guess * size / 2^40 in Q24
    const int64_t better = (int64_t)guess * (2 * NUM_ONE - miss);    // Q16 + Q24
    const num inverse = (num)(better >> 16);
    return a < 0 ? -inverse : inverse;
}

/// a - factor * b.
static inline num num_less(num a, num factor, num b, bool *saturated) {
    return canopy_narrow(a - (canopy_wide(factor, b) >> 24), saturated);
}

/// |a| <= limit, limit below 128; never true for what is not a number.
static inline bool num_within(num a, int32_t limit) { return a <= limit * NUM_ONE && a >= -limit * NUM_ONE; }

static inline acc num_widen(val x) { return (acc)x * NUM_ONE; }

static inline acc num_scale(num w, val x) { return canopy_wide(w, x); }

static inline val num_narrow(acc a, bool *saturated) { return canopy_narrow(a >> 24, saturated); }

// Like num_narrow, for what is known to fit.
static inline val num_drop(acc a) { return (val)(a >> 24); }

static inline val num_val(int32_t x) { return x; }

static inline int32_t num_val_ceil(val x) { return x; }

#endif
