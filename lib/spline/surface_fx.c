#include <stddef.h>

#include "lib/num/fixed.h"
#include "lib/spline/surface.h"

struct canopy_place canopy_place_of(uint32_t offset, uint32_t pitch, uint32_t size) {
    uint32_t interval = offset / pitch;
    interval = interval < size - 1 ? interval : size - 2;
    const uint64_t rest = offset - (uint64_t)interval * pitch;
    return (struct canopy_place){interval, (int32_t)((rest << 30) / pitch)};
}

static inline int32_t mul_floor(int32_t a, int32_t b) { return (int32_t)canopy_shift_floor(canopy_wide(a, b), 30); }

void canopy_basis_fx(int32_t s, int32_t weight[4], int32_t slope[4]) {
    const int32_t two_thirds = 715827882;  // floor(2^30 * 2/3)
    const int32_t r = CANOPY_UNIT_Q30 - s, s2 = mul_floor(s, s), r2 = mul_floor(r, r);
    const int32_t s3 = mul_floor(s2, s), r3 = mul_floor(r2, r);
    weight[0] = (int32_t)((uint32_t)r3 / 6);  // no sign to divide: r and s are from 0 to 1
    weight[1] = s3 / 2 - s2 + two_thirds;
    weight[3] = (int32_t)((uint32_t)s3 / 6);
    weight[2] = CANOPY_UNIT_Q30 - weight[0] - weight[1] - weight[3];
    if (slope != NULL) {
        slope[0] = -(r2 / 2);
        slope[3] = s2 / 2;
        slope[1] = s2 + s2 / 2 - s - s;
        slope[2] = -slope[0] - slope[1] - slope[3];
    }
}

// Four coefficients around a knot interval, `stride` apart, the end ones repeated.
static inline void around(const int32_t *b, uint32_t size, size_t stride, uint32_t interval, int32_t c[4]) {
    c[0] = b[stride * (interval > 0 ? interval - 1 : 0)];
    c[1] = b[stride * interval];
    c[2] = b[stride * (interval + 1)];
    c[3] = b[stride * (interval + 2 < size ? interval + 2 : interval + 1)];
}

// sum w[i] c[i] for weights that sum to `one`, taken from c[1] so that the products stay small.
static inline int32_t mix(const int32_t c[4], const int32_t w[4]) {
    const int64_t rise =
        canopy_wide(c[0] - c[1], w[0]) + canopy_wide(c[2] - c[1], w[2]) + canopy_wide(c[3] - c[1], w[3]);
    return (int32_t)canopy_shift_floor(rise, 30);
}

int32_t canopy_surface_fx(const int32_t *b, const uint16_t size[2], const struct canopy_place *u,
                          const struct canopy_place *v, int32_t gradient[2]) {
    int32_t wu[4], wv[4], du[4], dv[4], row[4], slope[4];
    canopy_basis_fx(u->s, wu, du);
    canopy_basis_fx(v->s, wv, dv);
    for (uint32_t a = 0; a < 4; a++) {
        uint32_t i = u->interval + a;  // one too far, so that it cannot be negative
        i = i > 0 ? i - 1 : 0;
        i = i < size[0] ? i : size[0] - 1U;
        int32_t c[4];
        around(b + (size_t)i * size[1], size[1], 1, v->interval, c);
        row[a] = c[1] + mix(c, wv);
        slope[a] = mix(c, dv);
    }
    if (gradient != NULL) {
        gradient[0] = mix(row, du);
        gradient[1] = slope[1] + mix(slope, wu);
    }
    return row[1] + mix(row, wu);
}
