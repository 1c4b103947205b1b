#include "tools/common/option.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>

#include "tools/common/number.h"

bool canopy_option_real(const char *name, const char *text, double low, double high, double *to,
                        struct canopy_fault *fault) {
    char *end = NULL;
    *to = strtod(text, &end);
    if (end == text || *end != '\0' || !isfinite(*to) || *to < low || *to > high) {
        return canopy_fault_set(fault, "--%s %s: give a number from %g to %g", name, text, low, high);
    }
    return true;
}

bool canopy_option_whole(const char *name, const char *text, uint64_t low, uint64_t high, uint64_t *to,
                         struct canopy_fault *fault) {
    return canopy_number_whole(text, low, high, to) ||
           canopy_fault_set(fault, "--%s %s: give a whole number from %" PRIu64 " to %" PRIu64, name, text, low, high);
}

bool canopy_option_whole32(const char *name, const char *text, uint32_t low, uint32_t high, uint32_t *to,
                           struct canopy_fault *fault) {
    uint64_t value = 0;
    if (!canopy_option_whole(name, text, low, high, &value, fault)) {
        return false;
    }
    *to = (uint32_t)value;
    return true;
}

bool canopy_option_whole16(const char *name, const char *text, uint16_t low, uint16_t high, uint16_t *to,
                           struct canopy_fault *fault) {
    uint64_t value = 0;
    if (!canopy_option_whole(name, text, low, high, &value, fault)) {
        return false;
    }
    *to = (uint16_t)value;
    return true;
}

bool canopy_option_grid(const char *text, uint32_t size[2]) {
    const char *end = text;
    uint64_t m = 0;
    if (!canopy_number_digits(text, &end, &m) || m > UINT32_MAX || *end != 'x') {
        return false;
    }
    size[0] = (uint32_t)m;
    return canopy_number_whole32(end + 1, 0, UINT32_MAX, &size[1]);
}

bool canopy_option_numbers(const char *text, int count, double *to) {
    for (int k = 0; k < count; k++) {
        const char *end = text;
        if (canopy_number_read(text, &end, &to[k]) != CANOPY_NUMBER_OK || *end != (k + 1 < count ? ',' : '\0')) {
            return false;
        }
        text = end + 1;
    }
    return true;
}
