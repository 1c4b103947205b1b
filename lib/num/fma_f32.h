/// A product added in one instruction, where the processor has that: for sums that are proposals only, or whose error
/// bound holds with one rounding as it does with two. Results differ from machine to machine in their last bits.
#ifndef CANOPY_NUM_FMA_F32_H
#define CANOPY_NUM_FMA_F32_H

#include <math.h>

static inline float canopy_add_product_f32(float sum, float a, float b) {
#ifdef __FP_FAST_FMAF  // GCC's and clang's: fmaf is an instruction
    return fmaf(a, b, sum);
#else
    return sum + a * b;
#endif
}

#endif
