#include "tools/canopy/queried.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lib/num/bits.h"
#include "tools/canopy/flat.h"

// ---------------------------------------------------------------------------------------------------------------------
// Reading

static bool no_memory(const char *path, struct canopy_fault *fault) {
    return canopy_fault_set(fault, "%s: out of memory: close other programs", path);
}

bool canopy_queried_no_memory(const struct canopy_queried *queried, struct canopy_fault *fault) {
    return no_memory(queried->path, fault);
}

/// Memory and frame for the grid of a level. False: no memory.
static bool set_level(struct canopy_queried *queried, unsigned level) {
    const struct canopy_surrogate *s = &queried->surrogate;
    struct canopy_envelope *low = &queried->low, *high = &queried->high;
    const uint32_t m = canopy_flat_size(s, 0, level), n = canopy_flat_size(s, 1, level);
    free(low->coefficients);
    free(high->coefficients);
    free(low->coverage);
    low->coefficients = malloc(CANOPY_COEFFICIENTS(m, n) * sizeof *low->coefficients);
    high->coefficients = malloc(CANOPY_COEFFICIENTS(m, n) * sizeof *high->coefficients);
    low->coverage = high->coverage = calloc(CANOPY_COVERAGE_BYTES(m, n), 1);
    if (!low->coefficients || !high->coefficients || !low->coverage) {
        return false;
    }
    low->frame = (struct canopy_frame){.size = {(uint16_t)m, (uint16_t)n},
                                       .pitch = {CANOPY_QUERIED_PITCH >> level, CANOPY_QUERIED_PITCH >> level},
                                       .cells = 1,
                                       .side = (uint8_t)s->side};
    for (int k = 0; k < 3; k++) {
        low->frame.axis[k][k] = CANOPY_AXIS_ONE;
    }
    high->frame = low->frame;
    for (uint32_t h = 0; h < m - 1; h++) {
        for (uint32_t w = 0; w < n - 1; w++) {
            if (!s->trim || s->trim[(size_t)(h >> level) * (s->size[1] - 1) + (w >> level)]) {
                canopy_bit_set(low->coverage, h * (n - 1) + w);
            }
        }
    }
    queried->level = level;
    return true;
}

bool canopy_queried_read_refined(const char *path, struct canopy_queried *queried, struct canopy_fault *fault) {
    *queried = (struct canopy_queried){.path = path};
    struct canopy_surrogate *s = &queried->surrogate;
    if (!canopy_surrogate_read(path, s, fault)) {
        memset(s, 0, sizeof *s);
        return false;
    }
    queried->low.scalar = queried->high.scalar = (uint8_t)s->scalar;
    return set_level(queried, 0) || no_memory(path, fault);
}

bool canopy_queried_read(const char *path, struct canopy_queried *queried, struct canopy_fault *fault) {
    return canopy_queried_read_refined(path, queried, fault) &&
           (queried->surrogate.window_count == 0 ||
            canopy_fault_set(fault,
                             "%s: \"windows\": this question is about one grid: give a surrogate without refinement "
                             "windows, or make it one with canopy regrid",
                             path));
}

void canopy_queried_free(struct canopy_queried *queried) {
    canopy_surrogate_free(&queried->surrogate);
    free(queried->low.coefficients);
    free(queried->high.coefficients);
    free(queried->low.coverage);
    *queried = (struct canopy_queried){.path = queried->path};
}

bool canopy_queried_match(const struct canopy_queried *a, const struct canopy_queried *b, struct canopy_fault *fault) {
    const struct canopy_surrogate *s = &a->surrogate, *t = &b->surrogate;
    const char *what = s->unit != t->unit                                    ? "units"
                       : memcmp(s->size, t->size, sizeof s->size) != 0       ? "sizes"
                       : memcmp(s->pitch, t->pitch, sizeof s->pitch) != 0    ? "pitches"
                       : memcmp(s->axes, t->axes, sizeof s->axes) != 0       ? "axes"
                       : memcmp(s->origin, t->origin, sizeof s->origin) != 0 ? "origins"
                                                                             : NULL;
    return !what ||
           canopy_fault_set(fault, "%s and %s: their frames have different %s: fit one with --frame of the other",
                            a->path, b->path, what);
}

// ---------------------------------------------------------------------------------------------------------------------
// Steps

static double largest_of(const double *values, size_t count) {
    double largest = 0.0;
    for (size_t i = 0; i < count; i++) {
        largest = fmax(largest, fabs(values[i]));
    }
    return largest;
}

/// No coefficient on any grid, windows added up, is larger.
static double largest_height(const struct canopy_surrogate *s) {
    double sum = largest_of(s->coefficients, (size_t)s->size[0] * s->size[1]);
    for (size_t k = 0; k < s->window_count; k++) {
        sum += largest_of(s->windows[k].coefficients, (size_t)s->windows[k].size[0] * s->windows[k].size[1]);
    }
    return sum * s->lsb;
}

/// Coefficients in steps, rounded down and up.
static bool set_coefficients(struct canopy_queried *q, double step) {
    const struct canopy_surrogate *s = &q->surrogate;
    const size_t count = CANOPY_COEFFICIENTS(q->low.frame.size[0], q->low.frame.size[1]);
    const double ratio = s->lsb / step;
    int exponent = 0;
    const double doubt = frexp(ratio, &exponent) == 0.5 ? 0.0 : 0x1p-50;  // a power of two: products are exact
    for (size_t i = 0; q->level == 0 && i < count; i++) {
        const double x = s->coefficients[i] * ratio;
        q->low.coefficients[i] = (int32_t)floor(x - fabs(x) * doubt);
        q->high.coefficients[i] = (int32_t)ceil(x + fabs(x) * doubt);
    }
    if (q->level > 0 && (!canopy_flat_write(s, q->level, ratio, doubt, false, q->low.coefficients) ||
                         !canopy_flat_write(s, q->level, ratio, doubt, true, q->high.coefficients))) {
        return false;
    }
    q->apart = 0;
    for (size_t i = 0; i < count; i++) {
        const int32_t apart = q->high.coefficients[i] - q->low.coefficients[i];
        q->apart = apart > q->apart ? apart : q->apart;
    }
    return true;
}

double canopy_queried_scale(struct canopy_queried *const queried[], size_t count, double reach) {
    double step = queried[0]->surrogate.lsb;
    unsigned level = 0;
    for (size_t k = 0; k < count; k++) {
        const struct canopy_surrogate *s = &queried[k]->surrogate;
        const unsigned own = canopy_flat_level(s);
        level = own > level ? own : level;
        step = fmin(step, s->lsb);
        reach = fmax(reach, largest_height(s));
    }
    while (reach / step < 0x1p26 && reach > 0.0) {
        step /= 2.0;
    }
    while (reach / step >= 0x1p27) {
        step *= 2.0;
    }
    for (size_t k = 0; k < count; k++) {
        if ((queried[k]->level != level && !set_level(queried[k], level)) || !set_coefficients(queried[k], step)) {
            return 0.0;
        }
    }
    return step;
}
