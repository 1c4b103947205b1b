#include "lib/cover/refine_certify.h"

#include <stdbool.h>

enum canopy_status canopy_refine_certify_init(struct canopy_refine_certify *certify, const struct canopy_field *field,
                                              struct canopy_certify *base, void *arena, size_t bytes) {
    const uint16_t cu = field->axis[0].cells, cv = field->axis[1].cells;
    const uint8_t level = cu % 4 == 0 && cv % 4 == 0 ? 2 : 1;
    if (!field->exact || base->field != field || cu % 2 != 0 || cv % 2 != 0) {
        return CANOPY_ARGUMENT;
    }
    struct canopy_arena cut;
    const enum canopy_status status = canopy_arena_open(&cut, arena, bytes, CANOPY_REFINE_CERTIFY_ARENA(cu, cv));
    if (status != CANOPY_OK) {
        return status;
    }
    *certify = (struct canopy_refine_certify){.field = field, .base = base, .level = level};
    for (int a = 0; a < 2; a++) {
        certify->weights[a] = canopy_arena_take(&cut, 12U * CANOPY_BEZIER_LATTICE(field->axis[a].cells / 2U));
        canopy_bezier_weights(certify->weights[a], (uint16_t)(field->axis[a].cells >> level));
    }
    return CANOPY_OK;
}

enum canopy_status canopy_refine_certify_begin(struct canopy_refine_certify *certify, const int32_t *coefficients,
                                               const struct canopy_refinement *windows, uint32_t count) {
    for (uint32_t k = 0; k < count; k++) {
        if (windows[k].level < 1 || windows[k].level > certify->level) {
            return CANOPY_ARGUMENT;
        }
    }
    certify->b = coefficients;
    certify->windows = windows;
    certify->count = count;
    certify->next = 0;
    certify->margin = INT32_MAX;
    return CANOPY_OK;
}

// ---- One fine cell

static inline int32_t least(int32_t a, int32_t b) { return a < b ? a : b; }

// The least Bernstein coefficient over four lattice columns in u, at each lattice point of v, for row `row` of the
// field's cells in a fine cell.
static void least_of_row(const struct canopy_refine_certify *certify, int32_t c[4][4], uint32_t row,
                         int32_t lowest[CANOPY_BEZIER_LATTICE(CANOPY_CELLS_MAX / 2)]) {
    const uint32_t count = CANOPY_BEZIER_LATTICE((uint32_t)certify->field->axis[1].cells >> certify->level);
    for (uint32_t l = 0; l < count; l++) {
        lowest[l] = INT32_MAX;
    }
    for (uint32_t k = 3 * row; k <= 3 * row + 3; k++) {
        const int32_t *u = certify->weights[0] + (size_t)3 * k;
        int32_t column[4];
        for (int e = 0; e < 4; e++) {
            column[e] = canopy_bezier_floor(c[0][e], c[1][e], c[2][e], c[3][e], u);
        }
        for (uint32_t l = 0; l < count; l++) {
            const int32_t *v = certify->weights[1] + (size_t)3 * l;
            lowest[l] = least(lowest[l], canopy_bezier_floor(column[0], column[1], column[2], column[3], v));
        }
    }
}

// The first of the field's cells in fine cell g, and how many there are along each axis.
static uint32_t cells_of(const struct canopy_refine_certify *certify, const uint32_t g[2], uint32_t q[2]) {
    for (int a = 0; a < 2; a++) {
        q[a] = (uint32_t)certify->field->axis[a].cells >> certify->level;
    }
    return g[0] * q[0] * certify->field->axis[1].count + g[1] * q[1];
}

static bool is_covered(const struct canopy_refine_certify *certify, const uint32_t g[2]) {
    uint32_t q[2];
    const uint32_t first = cells_of(certify, g, q);
    for (uint32_t r = 0; r < q[0]; r++) {
        const uint32_t row = first + r * certify->field->axis[1].count;
        for (uint32_t s = 0; s < q[1]; s++) {
            if (canopy_field_height(certify->field, row + s) != CANOPY_NO_HEIGHT) {
                return true;
            }
        }
    }
    return false;
}

// The bound of the first `count` windows over all cells of g. CANOPY_OK: all safe, *margin the least; CANOPY_NOT_SAFE:
// *cell lacks -*margin.
static enum canopy_status bound_cell(const struct canopy_refine_certify *certify, const uint32_t g[2], uint32_t count,
                                     int32_t *margin, uint32_t *cell) {
    int32_t c[4][4], lowest[CANOPY_BEZIER_LATTICE(CANOPY_CELLS_MAX / 2)];
    uint32_t q[2];
    const uint32_t first = cells_of(certify, g, q);
    if (!canopy_refined_cell(certify->b, certify->field->frame.size, certify->windows, count, certify->level, g, c)) {
        return CANOPY_RANGE;
    }
    *margin = INT32_MAX;
    for (uint32_t r = 0; r < q[0]; r++) {
        const uint32_t row = first + r * certify->field->axis[1].count;
        least_of_row(certify, c, r, lowest);
        for (uint32_t s = 0; s < q[1]; s++) {
            const int32_t *of = lowest + (size_t)3 * s, height = canopy_field_height(certify->field, row + s);
            const int32_t bound = least(least(of[0], of[1]), least(of[2], of[3]));
            if (height != CANOPY_NO_HEIGHT && bound - height < *margin) {
                *margin = bound - height;
                *cell = row + s;
            }
        }
    }
    return *margin >= 0 ? CANOPY_OK : CANOPY_NOT_SAFE;
}

// No window reaches down here: the base's certificate.
static bool is_safe_without(struct canopy_refine_certify *certify, const uint32_t g[2], int32_t *margin) {
    uint32_t q[2];
    const uint32_t first = cells_of(certify, g, q);
    for (uint32_t r = 0; r < q[0]; r++) {
        for (uint32_t s = 0; s < q[1]; s++) {
            const uint32_t cell = first + r * certify->field->axis[1].count + s;
            if (canopy_certify_cell(certify->base, cell) != CANOPY_OK) {
                return false;
            }
        }
    }
    *margin = certify->base->margin;
    return true;
}

// Whether the window lowers the surface somewhere in fine cell g, as far as its coefficients tell.
static bool lowers(const struct canopy_refine_certify *certify, const struct canopy_refinement *window,
                   const uint32_t g[2]) {
    const unsigned shift = certify->level - window->level;
    const int32_t u = (int32_t)(g[0] >> shift) - 1 - window->first[0];
    const int32_t v = (int32_t)(g[1] >> shift) - 1 - window->first[1];
    for (int32_t i = u > 0 ? u : 0; i <= u + 3 && i < window->size[0]; i++) {
        for (int32_t j = v > 0 ? v : 0; j <= v + 3 && j < window->size[1]; j++) {
            if (window->d[(size_t)i * window->size[1] + (size_t)j] < 0) {
                return true;
            }
        }
    }
    return false;
}

static enum canopy_status certify_cell(struct canopy_refine_certify *certify, const uint32_t g[2]) {
    int32_t margin;
    uint32_t cell;
    enum canopy_status status = bound_cell(certify, g, certify->count, &margin, &cell);
    if (status == CANOPY_NOT_SAFE) {
        certify->failed_cell = cell;
        certify->missing = -margin;
    }
    uint32_t count = certify->count;
    while (status == CANOPY_NOT_SAFE && count > 0 && !lowers(certify, &certify->windows[count - 1], g)) {
        count--;
        if (count == 0 && is_safe_without(certify, g, &margin)) {
            status = CANOPY_OK;
        } else if (count > 0) {
            status = bound_cell(certify, g, count, &margin, &cell);
        }
    }
    if (status == CANOPY_OK) {
        certify->margin = least(certify->margin, margin);
    }
    return status;
}

// ---- All of them

static bool is_reached(const struct canopy_refine_certify *certify, const uint32_t g[2]) {
    for (uint32_t k = 0; k < certify->count; k++) {
        if (canopy_refinement_meets(&certify->windows[k], certify->level, g)) {
            return true;
        }
    }
    return false;
}

enum canopy_status canopy_refine_certify_step(struct canopy_refine_certify *certify, uint32_t cells) {
    const uint16_t *size = certify->field->frame.size;
    const uint32_t across = (size[1] - 1U) << certify->level, all = ((size[0] - 1U) << certify->level) * across;
    for (; cells > 0 && certify->next < all; cells--) {
        const uint32_t g[2] = {certify->next / across, certify->next % across};
        if (is_reached(certify, g) && is_covered(certify, g)) {
            const enum canopy_status status = certify_cell(certify, g);
            if (status != CANOPY_OK) {
                return status;
            }
        }
        certify->next++;
    }
    return certify->next < all ? CANOPY_MORE : CANOPY_OK;
}
