#include "tools/common/filling.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lib/cover/free.h"
#include "lib/num/bits.h"
#include "tools/common/outline.h"

enum canopy_filling canopy_filling_named(const char *name) {
    static const char *const names[] = {"", "nearest", "straight", "bent"};
    for (int rule = CANOPY_FILLING_NEAREST; rule <= CANOPY_FILLING_BENT; rule++) {
        if (strcmp(name, names[rule]) == 0) {
            return (enum canopy_filling)rule;
        }
    }
    return CANOPY_FILLING_OWN;
}

static void fill(struct canopy_surrogate *s, enum canopy_filling rule, const uint8_t *coverage, uint8_t *seen,
                 int32_t *b) {
    const uint16_t size[2] = {(uint16_t)s->size[0], (uint16_t)s->size[1]};
    const uint32_t count = s->size[0] * s->size[1];
    const int32_t sign = s->side == CANOPY_ABOVE ? 1 : -1;  // the library's orientation: rounded as the device does
    struct canopy_free work;
    for (uint32_t k = 0; k < count; k++) {
        b[k] = sign * (int32_t)lrint(s->coefficients[k]);
    }
    canopy_free_see(size, coverage, seen);
    if (canopy_free_begin(&work, size, seen, b) != CANOPY_OK) {
        return;  // nothing is covered: nothing to go by
    }
    if (rule != CANOPY_FILLING_NEAREST) {
        canopy_free_straighten(&work);
        while (canopy_free_step(&work, UINT32_MAX) == CANOPY_MORE) {}
    }
    if (rule == CANOPY_FILLING_BENT) {
        canopy_free_bend(&work);
        while (canopy_free_step(&work, UINT32_MAX) == CANOPY_MORE) {}
    }
    for (uint32_t k = 0; k < count; k++) {
        if (!canopy_bit_get(seen, k)) {
            s->coefficients[k] = sign * b[k];
        }
    }
}

bool canopy_filling_apply(struct canopy_surrogate *s, enum canopy_filling rule, struct canopy_fault *fault) {
    if (rule == CANOPY_FILLING_OWN) {
        return true;
    }
    uint8_t *coverage = canopy_outline_coverage(s);
    uint8_t *seen = malloc(CANOPY_FREE_SEEN_BYTES(s->size[0], s->size[1]));
    int32_t *b = malloc((size_t)s->size[0] * s->size[1] * sizeof *b);
    const bool ok = coverage && seen && b;
    if (ok) {
        fill(s, rule, coverage, seen, b);
    }
    free(coverage);
    free(seen);
    free(b);
    return ok || canopy_fault_no_memory(fault);
}
