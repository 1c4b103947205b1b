#include "tools/common/number.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <strings.h>

#if FLT_EVAL_METHOD != 0
#error "The host tools need IEEE double arithmetic without excess precision: compile with -msse2 -mfpmath=sse."
#endif

static bool is_digit(char c) { return c >= '0' && c <= '9'; }

static enum canopy_number spelled_out(const char *text) {
    if (*text == '+' || *text == '-') {
        text++;
    }
    return strncasecmp(text, "nan", 3) == 0 || strncasecmp(text, "inf", 3) == 0 ? CANOPY_NUMBER_NOT_FINITE
                                                                                : CANOPY_NUMBER_NONE;
}

/// Powers of ten that are exact doubles.
static const double POWER[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                               1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};

enum canopy_number canopy_number_read(const char *text, const char **end, double *value) {
    const char *p = text;
    const bool negative = *p == '-';
    if (*p == '-' || *p == '+') {
        p++;
    }
    uint64_t digits = 0;  // at most 19 digits, so it cannot overflow
    int kept = 0;
    int scale = 0;
    bool any = false;
    bool simple = true;
    for (; is_digit(*p); p++, any = true) {
        digits = kept < 19 ? digits * 10 + (uint64_t)(*p - '0') : digits;
        kept += digits != 0;
        simple = simple && kept <= 18;
    }
    if (*p == '.') {
        for (p++; is_digit(*p); p++, any = true) {
            digits = kept < 19 ? digits * 10 + (uint64_t)(*p - '0') : digits;
            kept += digits != 0;
            simple = simple && kept <= 18 && scale > -400;
            scale -= scale > -400;
        }
    }
    if (!any) {
        *end = text;
        return spelled_out(text);
    }
    if (*p == 'e' || *p == 'E') {
        const char *q = p + 1;
        const bool down = *q == '-';
        q += *q == '-' || *q == '+';
        if (is_digit(*q)) {
            int exponent = 0;
            for (; is_digit(*q); q++) {
                exponent = exponent < 100000 ? exponent * 10 + (*q - '0') : exponent;
            }
            scale += down ? -exponent : exponent;
            p = q;
        }
    }
    *end = p;
    if (simple && digits <= (UINT64_C(1) << 53) && scale >= -22 && scale <= 22) {
        // Both operands are exact doubles, so the one rounding is the right one.
        const double whole = (double)digits;
        const double size = scale < 0 ? whole / POWER[-scale] : whole * POWER[scale];
        *value = negative ? -size : size;
        return CANOPY_NUMBER_OK;
    }
    *value = strtod(text, NULL);
    return isfinite(*value) ? CANOPY_NUMBER_OK : CANOPY_NUMBER_TOO_LARGE;
}

const char *canopy_number_complaint(enum canopy_number what) {
    switch (what) {
    case CANOPY_NUMBER_OK: return "is a number";
    case CANOPY_NUMBER_NOT_FINITE: return "is not finite";
    case CANOPY_NUMBER_TOO_LARGE: return "is beyond the largest IEEE double";
    case CANOPY_NUMBER_NONE:
    default: return "is not a number";
    }
}

bool canopy_number_positive(const char *text, double *value) {
    const char *end;
    return canopy_number_read(text, &end, value) == CANOPY_NUMBER_OK && *end == '\0' && *value > 0.0;
}

bool canopy_number_digits(const char *text, const char **end, uint64_t *value) {
    bool fits = true;
    uint64_t sum = 0;
    for (*end = text; is_digit(**end); ++*end) {
        const uint64_t digit = (uint64_t)(**end - '0');
        fits = fits && sum <= (UINT64_MAX - digit) / 10;
        sum = sum * 10 + digit;
    }
    *value = sum;
    return fits && *end != text;
}

bool canopy_number_whole(const char *text, uint64_t low, uint64_t high, uint64_t *value) {
    const char *end;
    return canopy_number_digits(text, &end, value) && *end == '\0' && *value >= low && *value <= high;
}

bool canopy_number_whole32(const char *text, uint32_t low, uint32_t high, uint32_t *value) {
    uint64_t wide;
    const bool whole = canopy_number_whole(text, low, high, &wide);
    *value = (uint32_t)wide;
    return whole;
}
