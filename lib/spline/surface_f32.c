#include <stddef.h>

#include "lib/spline/surface.h"

void canopy_basis_f32(float s, float weight[4], float slope[4]) {
    const float r = 1.0f - s, s2 = s * s, r2 = r * r;
    weight[0] = r2 * r * (1.0f / 6.0f);
    weight[3] = s2 * s * (1.0f / 6.0f);
    weight[1] = (3.0f * s - 6.0f) * s2 * (1.0f / 6.0f) + 2.0f / 3.0f;
    weight[2] = (3.0f * r - 6.0f) * r2 * (1.0f / 6.0f) + 2.0f / 3.0f;
    if (slope != NULL) {
        slope[0] = -0.5f * r2;
        slope[1] = (1.5f * s - 2.0f) * s;
        slope[2] = -(1.5f * r - 2.0f) * r;
        slope[3] = 0.5f * s2;
    }
}

float canopy_surface_f32(const int32_t *b, const uint16_t size[2], const uint32_t interval[2], const float s[2],
                         float gradient[2]) {
    float wu[4], wv[4], du[4], dv[4], value = 0.0f, by_u = 0.0f, by_v = 0.0f;
    canopy_basis_f32(s[0], wu, du);
    canopy_basis_f32(s[1], wv, dv);
    for (uint32_t a = 0; a < 4; a++) {
        uint32_t i = interval[0] + a;  // one too far, so that it cannot be negative
        i = i > 0 ? i - 1 : 0;
        i = i < size[0] ? i : size[0] - 1U;
        float row = 0.0f, slope = 0.0f;
        for (uint32_t c = 0; c < 4; c++) {
            uint32_t j = interval[1] + c;
            j = j > 0 ? j - 1 : 0;
            j = j < size[1] ? j : size[1] - 1U;
            const float here = (float)b[(size_t)i * size[1] + j];
            row += wv[c] * here;
            slope += dv[c] * here;
        }
        value += wu[a] * row;
        by_u += du[a] * row;
        by_v += wu[a] * slope;
    }
    if (gradient != NULL) {
        gradient[0] = by_u;
        gradient[1] = by_v;
    }
    return value;
}
