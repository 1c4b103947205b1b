/// The scalar of the float line fit: what lib/num/band.inc and lib/cover/line.inc ask of a number.
///
/// `num` is a weight of order one, `val` a height. See num_fx.h for the fixed-point twin and what each function means.
#ifndef CANOPY_NUM_F32_H
#define CANOPY_NUM_F32_H

#ifdef __FAST_MATH__
#error "canopy needs IEEE arithmetic: build without -ffast-math"
#endif

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

typedef float num;
typedef float val;
typedef float acc;

#define NUM(name) name##_f32
#define NUM_ONE 1.0f
#define NUM_VAL_BITS 24  // heights are scaled to at most 2^24, where float still counts in ones

static inline num num_ratio(int32_t p, int32_t q) { return (float)p / (float)q; }

static inline num num_mul(num a, num b, bool *saturated) {
    (void)saturated;  // an infinity is caught by num_within
    return a * b;
}

static inline num num_inverse(num a) { return 1.0f / a; }

static inline num num_less(num a, num factor, num b, bool *saturated) {
    (void)saturated;  // an infinity is caught by num_within
    return a - factor * b;
}

static inline bool num_within(num a, int32_t limit) { return fabsf(a) <= (float)limit; }

static inline acc num_widen(val x) { return x; }

static inline acc num_scale(num w, val x) { return w * x; }

static inline val num_narrow(acc a, bool *saturated) {
    (void)saturated;  // what is too large, infinite or no number is no height within a line's limits, where it is used
    return a;
}

// Like num_narrow, for what is known to fit.
static inline val num_drop(acc a) { return a; }

static inline val num_val(int32_t x) { return (float)x; }

static inline int32_t num_val_ceil(val x) {
    const int32_t whole = (int32_t)x;
    return whole + ((float)whole < x ? 1 : 0);
}

#endif
