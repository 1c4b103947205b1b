#include "tools/common/dyadic.h"

#include <float.h>
#include <limits.h>
#include <math.h>

int canopy_dyadic_exponent(double x) {
    int exponent = 0;
    frexp(x, &exponent);
    return x == 0.0 ? INT_MAX : exponent - DBL_MANT_DIG;
}

int canopy_dyadic_exponent_of(const double *values, size_t count) {
    int least = INT_MAX;
    for (size_t i = 0; i < count; i++) {
        const int now = canopy_dyadic_exponent(values[i]);
        least = now < least ? now : least;
    }
    return least;
}

void canopy_dyadic_set(mpz_t z, double x, int exponent) {
    int own = 0;
    const double mantissa = ldexp(frexp(x, &own), DBL_MANT_DIG);
    mpz_set_d(z, mantissa);
    if (x != 0.0) {
        mpz_mul_2exp(z, z, (mp_bitcnt_t)(own - DBL_MANT_DIG - exponent));
    }
}
