#include "tools/common/outline.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lib/num/bits.h"

#define NEAR 1e-9  // of a knot interval: as canopy_exact_coverage takes it

uint8_t *canopy_outline_coverage(const struct canopy_surrogate *s) {
    const uint32_t cells = (s->size[0] - 1) * (s->size[1] - 1);
    uint8_t *bits = calloc(CANOPY_COVERAGE_BYTES(s->size[0], s->size[1]), 1);
    for (uint32_t k = 0; bits && k < cells; k++) {
        if (!s->trim || s->trim[k]) {
            (void)canopy_bit_set(bits, k);
        }
    }
    return bits;
}

/// The mask, mended as wished, in place.
static bool mend(struct canopy_outline *o, bool close, bool clean) {
    const size_t bytes = CANOPY_COVERAGE_BYTES(o->size[0], o->size[1]);
    uint8_t *copy = malloc(bytes);
    if (copy && close) {
        canopy_trim_close(o->size, o->coverage, copy);
        memcpy(o->coverage, copy, bytes);
    }
    if (copy && clean) {
        canopy_trim_clean(o->size, o->coverage, copy);
        memcpy(o->coverage, copy, bytes);
    }
    free(copy);
    return copy != NULL;
}

bool canopy_outline_make(const struct canopy_surrogate *s, bool close, bool clean, struct canopy_outline *o,
                         struct canopy_fault *fault) {
    *o = (struct canopy_outline){.size = {(uint16_t)s->size[0], (uint16_t)s->size[1]}};
    const uint32_t corners = (uint32_t)CANOPY_TRIM_CORNERS_MOST(s->size[0], s->size[1]);
    const size_t bytes = CANOPY_TRIM_ARENA(s->size[0], s->size[1], corners);
    o->coverage = canopy_outline_coverage(s);
    o->arena = malloc(bytes);
    if (!o->coverage || !o->arena || !mend(o, close, clean)) {
        canopy_outline_free(o);
        return canopy_fault_no_memory(fault);
    }
    (void)canopy_trim_trace(&o->trace, o->size, o->coverage, corners, o->arena, bytes);  // there is room for the most
    return true;
}

void canopy_outline_free(struct canopy_outline *o) {
    free(o->coverage);
    free(o->arena);
    *o = (struct canopy_outline){.coverage = NULL};
}

/// At (x, y) of cell (h, w), from its corner.
static bool cell_holds(const struct canopy_outline *o, int h, int w, double x, double y) {
    if (h < 0 || w < 0 || h >= o->size[0] - 1 || w >= o->size[1] - 1 || !(x >= -NEAR && x <= 1.0 + NEAR) ||
        !(y >= -NEAR && y <= 1.0 + NEAR)) {
        return false;
    }
    switch (canopy_trim_shape(o->size, o->coverage, (uint32_t)h, (uint32_t)w)) {
    case CANOPY_TRIM_NOTHING: return false;
    case CANOPY_TRIM_ALL: return true;
    case CANOPY_TRIM_CORNER_00: return x + y <= 1.0 + NEAR;
    case CANOPY_TRIM_CORNER_01: return x - y <= NEAR;
    case CANOPY_TRIM_CORNER_10: return y - x <= NEAR;
    default: return x + y >= 1.0 - NEAR;
    }
}

bool canopy_outline_holds(const struct canopy_outline *o, double u, double v) {
    if (!(u >= -1.0 && u <= o->size[0] && v >= -1.0 && v <= o->size[1])) {
        return false;
    }
    const int h = (int)floor(u);
    const int w = (int)floor(v);
    for (int a = h - 1; a <= h + 1; a++) {
        for (int b = w - 1; b <= w + 1; b++) {
            if (cell_holds(o, a, b, u - a, v - b)) {
                return true;
            }
        }
    }
    return false;
}
