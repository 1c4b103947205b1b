/// Doubles as what they are: whole numbers times powers of two, in whole numbers of any length.
#ifndef CANOPY_TOOLS_COMMON_DYADIC_H
#define CANOPY_TOOLS_COMMON_DYADIC_H

#include <gmp.h>
#include <stddef.h>

/// An exponent e for which x * 2^-e is whole: about that of its last bit. INT_MAX for zero.
int canopy_dyadic_exponent(double x);

/// The least of them: good for all values. INT_MAX if all are zero.
int canopy_dyadic_exponent_of(const double *values, size_t count);

/// z = x * 2^-exponent, whole because exponent <= canopy_dyadic_exponent(x).
void canopy_dyadic_set(mpz_t z, double x, int exponent);

#endif
