/// Points seen along a direction: axes for it, and the points in those axes.
///
/// The library fits in frames whose axes are x, y and z. Points are therefore turned into the frame's axes first,
/// rounded to the scalar, and fitted there.
#ifndef CANOPY_TOOLS_COMMON_TURN_H
#define CANOPY_TOOLS_COMMON_TURN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "tools/common/device.h"
#include "tools/common/fault.h"
#include "tools/common/supply.h"

/// Axes for a direction, the rule of canopy_axes_from_direction_fx in IEEE double: axes[2] is the direction normalised,
/// axes[0] the part of x orthogonal to it, normalised (of y if the direction is within 26 degrees of x), axes[1] =
/// axes[2] x axes[0]; components in multiples of 2^-30. False for a direction without length.
bool canopy_turn_axes(const double direction[3], int32_t axes[3][3]);

/// Axes for three points of a plane, x y z each, the rule of canopy_axes_from_points_fx: axes[0] from the first to the
/// second, axes[2] along (second - first) x (third - first), towards a viewer who sees them anticlockwise, axes[1] =
/// axes[2] x axes[0]. False for points that are not finite, or on a line: a triangle whose angle at the first point is
/// 0 or 180 degrees to about 1e-12, which is what decimals leave of a line.
bool canopy_turn_axes_plane(const double points[9], int32_t axes[3][3]);

/// Points in the coordinates of their axes.
struct canopy_turned {
    int32_t axes[3][3];
    bool along;  ///< every axis is plus or minus a coordinate axis: turning is exact
    enum canopy_scalar scalar;
    size_t count;
    const union canopy_device_point *points;  ///< NULL: they are turned anew in every pass over the supply
    union canopy_device_point *memory;        ///< of the points, unless they are those that were given
    const struct canopy_supply *supply;
    union canopy_device_point low, high;  ///< without points: their box
    bool exchanged;                       ///< without points: a pass exchanges the first two coordinates
};

/// Turns a list that is not empty. Points that do not need it are not copied: the list must stay as it is until
/// canopy_turned_free, which is needed after false too. False: the turned points do not fit 32-bit fixed point, or
/// there is no memory (12 bytes a point).
bool canopy_turn(const struct canopy_device_list *points, int32_t axes[3][3], struct canopy_turned *turned,
                 struct canopy_fault *fault);

/// The same of a supply: of one that is held, a list; else nothing is held, and turning is part of each pass. The
/// supply must stay until canopy_turned_free.
bool canopy_turn_supply(const struct canopy_supply *supply, int32_t axes[3][3], struct canopy_turned *turned,
                        struct canopy_fault *fault);

/// A pass over turned points that are not held.
bool canopy_turned_pass(const struct canopy_turned *turned, const struct canopy_flow *flow, struct canopy_fault *fault);
void canopy_turned_free(struct canopy_turned *turned);

/// Widens a box, low and high, to hold another.
void canopy_turned_widen(enum canopy_scalar scalar, union canopy_device_point box[2],
                         const union canopy_device_point part[2]);

/// The smallest box that holds the points. Linear, at the speed of memory.
void canopy_turned_box(const struct canopy_turned *turned, union canopy_device_point *low,
                       union canopy_device_point *high);

#endif
