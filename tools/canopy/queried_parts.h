/// Inside tools/canopy/queried: the rational numbers that its files share. Not for others.
///
///     queried.c          reading surrogates, and the envelopes that hold them
///     queried_units.c    answers in input units
///     queried_options.c  the command line
///     queried_answer.c   extremes, planes, volumes
#ifndef CANOPY_TOOLS_CANOPY_QUERIED_PARTS_H
#define CANOPY_TOOLS_CANOPY_QUERIED_PARTS_H

#include <gmp.h>

#include "tools/canopy/queried.h"

/// The double next to x, below or above it.
double canopy_queried_round(const mpq_t x, bool upward);

/// sum += a * b
void canopy_queried_add_product(mpq_t sum, double a, double b);

/// x *= by
void canopy_queried_multiply(mpq_t x, double by);

/// The origin along an axis, in device units.
void canopy_queried_origin(mpq_t sum, const struct canopy_surrogate *s, int axis);

#endif
