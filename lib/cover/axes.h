/// The axes of a frame, from a viewing direction or from three points: three rows of integers, times CANOPY_AXIS_ONE,
/// for u, v and the height.
///
/// What a frame means is the exact linear map of these integers (q = axes (p - origin)), so nothing that is proved
/// hangs on their being orthonormal. They are so within CANOPY_AXES_ERROR: every inner product of two rows, in units of
/// 2^-30, is that near to 2^30 (of a row with itself) or 0. They are right-handed. The same integers come out on every
/// machine; there is no floating point, and none of libm, in the fixed-point functions.
///
/// Cost: three integer square roots of 32 steps and nine 64-bit divisions. Made once a frame.
#ifndef CANOPY_COVER_AXES_H
#define CANOPY_COVER_AXES_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/cover/frame.h"
#include "lib/status.h"

#define CANOPY_AXES_ERROR 8         ///< units of 2^-30
#define CANOPY_AXES_TOLERANCE 1024  ///< of axes that come from elsewhere, as files allow: 2^-20

/// From the direction to the viewer, of any length: the height axis is d normalised, the u axis is the part of x that
/// is orthogonal to it, normalised (of y if the height axis' x component is beyond +- 0.9), v = height x u. 0,0,1 gives
/// x, y and z. CANOPY_ARGUMENT: no direction (0, 0, 0); *axes is unchanged.
enum canopy_status canopy_axes_from_direction_fx(const int32_t direction[3], int32_t axes[3][3]);

/// From three points of a plane, in device units: u runs from the first to the second; the height axis is the plane's
/// normal (second - first) x (third - first), so that a viewer whom it points at sees the three run anticlockwise;
/// v = height x u, and the third point is on its positive side. Give the first two the other way round to look from
/// the other side. The plane decides the axes only: the frame's origin is the corner of what it holds.
/// The normal is exact but for its rounding, however flat the triangle. CANOPY_ARGUMENT: the three are on one line, or
/// two are equal, exactly; *axes is unchanged.
enum canopy_status canopy_axes_from_points_fx(const int32_t points[3][3], int32_t axes[3][3]);

/// The same from floats, which become integers first: all nine, or three, times one power of two that brings the
/// largest magnitude to 2^30, rounded to nearest. CANOPY_ARGUMENT also where one is not finite, or where the triangle
/// vanishes in that rounding.
enum canopy_status canopy_axes_from_direction_f32(const float direction[3], int32_t axes[3][3]);
enum canopy_status canopy_axes_from_points_f32(const float points[3][3], int32_t axes[3][3]);

/// Whether axes from elsewhere are a rotation within CANOPY_AXES_TOLERANCE, right-handed: then no sum of lib/cover/turn
/// can overflow.
bool canopy_axes_are_sound(const int32_t axes[3][3]);

/// Whether they are exactly x, y and z.
bool canopy_axes_are_straight(const int32_t axes[3][3]);

#endif
