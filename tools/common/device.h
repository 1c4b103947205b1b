/// Points as the device receives them: input coordinates over the unit, rounded to the device's own numbers.
///
/// In IEEE double: f32 takes (float)(p / unit), fx takes rint(p / unit), ties to even.
#ifndef CANOPY_TOOLS_COMMON_DEVICE_H
#define CANOPY_TOOLS_COMMON_DEVICE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "tools/common/exact.h"
#include "tools/common/fault.h"

/// One point of either scalar.
union canopy_device_point {
    float f32[3];
    int32_t fx[3];
};

/// Converts a finite point. Beyond the format (float: overflow to infinity; fixed point: 2^31 or more) it fills `fault`
/// with what is wrong and the remedy, and returns false.
bool canopy_device_point(enum canopy_scalar scalar, double unit, const double point[3], union canopy_device_point *to,
                         struct canopy_fault *fault);

/// A growing list of device points, x y z triples.
struct canopy_device_list {
    enum canopy_scalar scalar;
    size_t count;
    size_t room;
    union canopy_device_point *points;
};

/// Appends; false if there is no memory. Begin with a zeroed struct and `scalar` set.
bool canopy_device_list_add(struct canopy_device_list *list, const union canopy_device_point *point);
/// Appends `count` points.
bool canopy_device_list_append(struct canopy_device_list *list, const union canopy_device_point *points, size_t count);
void canopy_device_list_free(struct canopy_device_list *list);

/// The list as a cloud.
struct canopy_cloud canopy_device_list_cloud(const struct canopy_device_list *list);

#endif
