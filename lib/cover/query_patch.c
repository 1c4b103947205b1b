#include "lib/cover/query_patch.h"

#include <stddef.h>

#include "lib/cover/line.h"
#include "lib/num/fixed.h"

struct canopy_patch_span canopy_patch_span_of(uint32_t low, uint32_t high, uint32_t pitch, uint32_t size) {
    struct canopy_patch_span span;
    span.first = low / pitch < size - 1 ? low / pitch : size - 2;
    const uint32_t last = high / pitch < size - 1 ? high / pitch : size - 2;
    const uint64_t at_first = low - (uint64_t)span.first * pitch;
    uint64_t at_last = high - (uint64_t)last * pitch;
    span.last = last;
    if (at_last == 0 && last > span.first) {
        span.last--;  // the window ends on the knot between the two
        at_last = pitch;
    }
    span.from = (uint32_t)((at_first << CANOPY_PATCH_BITS) / pitch);
    span.to = (uint32_t)(((at_last << CANOPY_PATCH_BITS) + pitch - 1) / pitch);
    return span;
}

static inline uint32_t clip(uint32_t one_too_far, uint32_t n) {
    const uint32_t i = one_too_far > 0 ? one_too_far - 1 : 0;
    return i < n ? i : n - 1;
}

static inline bool is_within(int32_t b) { return b <= CANOPY_COEFFICIENT_LIMIT && b >= -CANOPY_COEFFICIENT_LIMIT; }

enum canopy_status canopy_patch_gather(const struct canopy_query_subject *subject, uint32_t row, uint32_t column,
                                       int32_t d[16]) {
    const uint32_t m = subject->surface->frame.size[0], n = subject->surface->frame.size[1];
    bool within = true;
    uint32_t columns[4];
    for (uint32_t e = 0; e < 4; e++) {
        columns[e] = clip(column + e, n);
    }
    for (uint32_t a = 0; a < 4; a++, d += 4) {
        const size_t line = (size_t)clip(row + a, m) * n;
        const int32_t *b = subject->surface->coefficients + line;
        for (uint32_t e = 0; e < 4; e++) {
            d[e] = b[columns[e]];
            within = within && is_within(d[e]);
        }
        for (uint32_t e = 0; e < 4 && subject->minus != NULL; e++) {
            const int32_t other = subject->minus->coefficients[line + columns[e]];
            within = within && is_within(other);
            d[e] = within ? d[e] - other : 0;
        }
    }
    return within ? CANOPY_OK : CANOPY_RANGE;
}

// Four spline coefficients to four Bernstein coefficients, times 6, in place.
static inline void to_bernstein(int64_t *c, ptrdiff_t stride) {
    const int64_t b0 = c[0], b1 = c[stride], b2 = c[2 * stride], b3 = c[3 * stride];
    const int64_t both = 2 * (b1 + b2);
    c[0] = b0 + 4 * b1 + b2;
    c[stride] = both + 2 * b1;
    c[2 * stride] = both + 2 * b2;
    c[3 * stride] = b1 + 4 * b2 + b3;
}

// The plane's values at the thirds of the cell, 36 times those in 2^-16 steps: below 36 * 2^28 * 2^16 = 2^50.
static void take_plane(const struct canopy_query_plane *plane, int32_t sign, uint32_t row, uint32_t column,
                       int64_t c[16]) {
    const int64_t by_u = 12 * plane->rise[0], by_v = 12 * plane->rise[1];
    int64_t line = 36 * plane->at_origin + 3 * by_u * (int64_t)row + 3 * by_v * (int64_t)column;
    for (int p = 0; p < 4; p++, line += by_u) {
        int64_t here = line;
        for (int q = 0; q < 4; q++, here += by_v) {
            *c++ -= canopy_shift_ceil(sign * here, 16);
        }
    }
}

void canopy_patch_cell(const struct canopy_query_subject *subject, int32_t sign, uint32_t row, uint32_t column,
                       const int32_t d[16], int64_t c[16]) {
    for (int i = 0; i < 16; i++) {
        c[i] = sign * d[i];
    }
    for (int p = 0; p < 4; p++) {
        to_bernstein(c + 4 * (ptrdiff_t)p, 1);
    }
    for (int q = 0; q < 4; q++) {
        to_bernstein(c + q, 4);
    }
    if (subject->plane != NULL) {
        take_plane(subject->plane, sign, row, column, c);
    }
}

static inline int64_t between(int64_t x, int64_t y, uint32_t s, unsigned bits) {
    return x + canopy_shift_floor((y - x) * (int64_t)s, bits);
}

// Blossoms: each letter is an argument, a = from, c = to.
static void cut_line(int64_t *c, ptrdiff_t stride, uint32_t from, uint32_t to, unsigned bits) {
    int64_t a[3], e[3];
    for (int i = 0; i < 3; i++) {
        const int64_t left = c[i * stride], right = c[(i + 1) * stride];
        a[i] = between(left, right, from, bits);
        e[i] = between(left, right, to, bits);
    }
    const int64_t aa0 = between(a[0], a[1], from, bits), aa1 = between(a[1], a[2], from, bits);
    const int64_t cc0 = between(e[0], e[1], to, bits), cc1 = between(e[1], e[2], to, bits);
    c[0] = between(aa0, aa1, from, bits);
    c[stride] = between(aa0, aa1, to, bits);
    c[2 * stride] = between(cc0, cc1, from, bits);
    c[3 * stride] = between(cc0, cc1, to, bits);
}

void canopy_patch_cut(int64_t c[16], int axis, uint32_t from, uint32_t to, unsigned bits) {
    for (int i = 0; i < 4; i++) {
        cut_line(axis == 0 ? c + i : c + 4 * (ptrdiff_t)i, axis == 0 ? 4 : 1, from, to, bits);
    }
}
