/// Decimal numbers from text, correctly rounded and strict.
#ifndef CANOPY_TOOLS_COMMON_NUMBER_H
#define CANOPY_TOOLS_COMMON_NUMBER_H

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

#endif
