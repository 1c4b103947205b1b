/// Evaluation of the tensor-product surface S(u,v) = sum b[i][j] N(u-i) N(v-j), N the uniform cubic B-spline, with the
/// first and last row and column of coefficients repeated once outside the grid. With its gradient, in both scalars.
#ifndef CANOPY_SPLINE_SURFACE_H
#define CANOPY_SPLINE_SURFACE_H

#include <stdint.h>

#define CANOPY_UNIT_Q30 (1 << 30)

/// A place along one axis: knot interval and position in it. The last knot belongs to the last interval, s = 1.
struct canopy_place {
    uint32_t interval;  ///< 0 to size - 2
    int32_t s;          ///< 0 to 2^30: Q30
};

/// The place of an offset of 0 to (size - 1) * pitch; s is rounded down.
struct canopy_place canopy_place_of(uint32_t offset, uint32_t pitch, uint32_t size);

/// The four B-splines that do not vanish at s, Q30; they sum to 2^30 exactly. Off by less than 1.4, 2.5, 5.3 and 1.4
/// units of 2^-30. `slope` (may be NULL): their derivatives by s, Q30, which sum to 0.
void canopy_basis_fx(int32_t s, int32_t weight[4], int32_t slope[4]);
void canopy_basis_f32(float s, float weight[4], float slope[4]);

/// How far canopy_surface_fx may be from S, in steps, either way. Per axis: the weights' errors times differences of
/// coefficients of up to 2^29 (7.9 * 2^-30 * 2^29 < 4), s rounded down (2^-30 times a slope of up to 2^29: 1/2), and
/// one floor: less than 6.
#define CANOPY_SURFACE_FX_ERROR 12

/// The surface at (u, v), in steps; coefficients within +-2^28. size = {m, n}; b in row (u) order.
/// gradient (may be NULL): by u and by v, steps a knot interval, to about 2^-26 of the coefficients' differences.
int32_t canopy_surface_fx(const int32_t *b, const uint16_t size[2], const struct canopy_place *u,
                          const struct canopy_place *v, int32_t gradient[2]);

/// The same in float, s from 0 to 1: relative to the largest coefficient nearby, off by at most 2^-20.
float canopy_surface_f32(const int32_t *b, const uint16_t size[2], const uint32_t interval[2], const float s[2],
                         float gradient[2]);

#endif
