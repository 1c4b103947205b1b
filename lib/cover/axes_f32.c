#include <math.h>

#include "lib/cover/axes.h"

// All numbers times one power of two, rounded, so that the largest magnitude has 30 bits. False where one is not
// finite. All zero gives zeros.
static bool scale(const float *from, int count, int32_t *to) {
    int most = -149;  // the largest exponent
    for (int i = 0; i < count; i++) {
        int exponent = -149;
        if (!isfinite(from[i])) {
            return false;
        }
        (void)frexpf(from[i], &exponent);
        most = from[i] != 0.0f && exponent > most ? exponent : most;
    }
    for (int i = 0; i < count; i++) {
        to[i] = (int32_t)rintf(ldexpf(from[i], 30 - most));
    }
    return true;
}

enum canopy_status canopy_axes_from_direction_f32(const float direction[3], int32_t axes[3][3]) {
    int32_t d[3];
    return scale(direction, 3, d) ? canopy_axes_from_direction_fx(d, axes) : CANOPY_ARGUMENT;
}

enum canopy_status canopy_axes_from_points_f32(const float points[3][3], int32_t axes[3][3]) {
    int32_t p[3][3];
    return scale(points[0], 9, p[0]) ? canopy_axes_from_points_fx((const int32_t(*)[3])p, axes) : CANOPY_ARGUMENT;
}
