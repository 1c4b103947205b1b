/// Random points on their way to the exact judges, for tests: the frame around them, and what tools/common takes.
#ifndef CANOPY_HOSTTEST_CLOUD_H
#define CANOPY_HOSTTEST_CLOUD_H

#include <math.h>
#include <stdint.h>

#include "lib/cover/envelope.h"
#include "lib/cover/frame.h"
#include "tools/common/exact.h"
#include "tools/common/surrogate.h"

/// The frame around `count` >= 1 points, which stand in both arrays; those of the scalar count.
static inline enum canopy_status cloud_frame(enum canopy_scalar scalar, const struct canopy_grid *grid,
                                             const float (*f32)[3], const int32_t (*fx)[3], size_t count,
                                             struct canopy_frame *frame) {
    float low[3], high[3];
    int32_t from[3], to[3];
    for (int a = 0; a < 3; a++) {
        low[a] = high[a] = f32[0][a];
        from[a] = to[a] = fx[0][a];
        for (size_t i = 1; i < count; i++) {
            low[a] = fminf(low[a], f32[i][a]);
            high[a] = fmaxf(high[a], f32[i][a]);
            from[a] = fx[i][a] < from[a] ? fx[i][a] : from[a];
            to[a] = fx[i][a] > to[a] ? fx[i][a] : to[a];
        }
    }
    return scalar == CANOPY_F32 ? canopy_frame_around_f32(frame, grid, low, high)
                                : canopy_frame_around_fx(frame, grid, from, to);
}

/// The points as the judges take them.
static inline struct canopy_cloud cloud_of(enum canopy_scalar scalar, const float (*f32)[3], const int32_t (*fx)[3],
                                           size_t count) {
    const char *bytes = scalar == CANOPY_F32 ? (const void *)f32 : (const void *)fx;
    return (struct canopy_cloud){scalar, count, 3, {bytes, bytes + 4, bytes + 8}};
}

/// 1, or -1 where the library's coefficients are mirrored against those that are published.
static inline double cloud_mirror(const struct canopy_frame *frame) { return frame->side == CANOPY_BELOW ? -1 : 1; }

/// A surface over a frame with axes along x, y, z as it would be published: coefficients `sign` times b, which are
/// written to `coefficients`, that stay with the caller.
static inline struct canopy_surrogate cloud_surrogate(const struct canopy_frame *frame, enum canopy_scalar scalar,
                                                      const int32_t *b, double sign, double *coefficients) {
    struct canopy_surrogate s = {.side = (enum canopy_side)frame->side,
                                 .scalar = scalar,
                                 .unit = 1,
                                 .size = {frame->size[0], frame->size[1]},
                                 .coefficients = coefficients,
                                 .lsb = ldexp(1, frame->lsb_log2 + frame->quantum_log2)};
    for (int a = 0; a < 3; a++) {
        s.origin[a] = ldexp(frame->origin[a], frame->quantum_log2);
        s.axes[a][a] = 1;
    }
    for (int a = 0; a < 2; a++) {
        s.pitch[a] = ldexp(frame->pitch[a], frame->quantum_log2);
    }
    for (size_t i = 0; i < CANOPY_COEFFICIENTS(frame->size[0], frame->size[1]); i++) {
        coefficients[i] = sign * b[i];
    }
    return s;
}

#endif
