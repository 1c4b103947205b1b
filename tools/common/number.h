/// Decimal numbers from text, correctly rounded and strict.
#ifndef CANOPY_TOOLS_COMMON_NUMBER_H
#define CANOPY_TOOLS_COMMON_NUMBER_H

#include <stdbool.h>
#include <stdint.h>

enum canopy_number {
    CANOPY_NUMBER_OK,
    CANOPY_NUMBER_NONE,        ///< there is no number here
    CANOPY_NUMBER_NOT_FINITE,  ///< nan or inf, spelled out
    CANOPY_NUMBER_TOO_LARGE    ///< a decimal beyond the largest IEEE double
};

/// Reads `[+-]digits[.digits][(e|E)[+-]digits]` at `text`, which must end in a NUL somewhere, into the nearest double.
/// `*end` is set to the first character after it, or to `text` if there is none. What follows is the caller's matter.
/// About 10 ns for numbers of up to 15 digits and a small exponent (one exact product or quotient, Clinger 1990),
/// otherwise glibc's correctly rounded strtod. Hexadecimal, underscores and locale play no part.
enum canopy_number canopy_number_read(const char *text, const char **end, double *value);

/// What is wrong, in words that follow "what the reader found": "is not a number" and so on.
const char *canopy_number_complaint(enum canopy_number what);

/// A finite decimal number above 0 and nothing else.
bool canopy_number_positive(const char *text, double *value);

/// Decimal digits at `text`, without sign; `*end` is set behind them. False where there are none or they do not fit.
bool canopy_number_digits(const char *text, const char **end, uint64_t *value);

/// A whole decimal number from `low` to `high` and nothing else.
bool canopy_number_whole(const char *text, uint64_t low, uint64_t high, uint64_t *value);
bool canopy_number_whole32(const char *text, uint32_t low, uint32_t high, uint32_t *value);

#endif
