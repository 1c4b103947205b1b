#include "tools/common/device.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

_Static_assert(sizeof(union canopy_device_point) == 12, "points are packed triples");

bool canopy_device_point(enum canopy_scalar scalar, double unit, const double point[3], union canopy_device_point *to,
                         struct canopy_fault *fault) {
    for (int k = 0; k < 3; k++) {
        const double scaled = point[k] / unit;
        const double whole = rint(scaled);
        if (scalar == CANOPY_FX) {
            if (!(fabs(whole) < 0x1p31)) {
                return canopy_fault_set(
                    fault, "%g overflows 32-bit fixed point at unit %g: choose a larger --unit or move the origin",
                    point[k], unit);
            }
            to->fx[k] = (int32_t)whole;
        } else {
            if (!(fabs(scaled) < 0x1.ffffffp127)) {  // halfway to 2^128 rounds to infinity
                return canopy_fault_set(
                    fault, "%g overflows 32-bit float at unit %g: choose a larger --unit or move the origin", point[k],
                    unit);
            }
            to->f32[k] = (float)scaled;
        }
    }
    return true;
}

bool canopy_device_list_append(struct canopy_device_list *list, const union canopy_device_point *points, size_t count) {
    if (count > list->room - list->count) {
        size_t room = list->room ? list->room : 65536;
        while (count > room - list->count) {
            room *= 2;
        }
        union canopy_device_point *larger = realloc(list->points, room * sizeof *larger);
        if (!larger) {
            return false;
        }
        list->points = larger;
        list->room = room;
    }
    memcpy(list->points + list->count, points, count * sizeof *points);
    list->count += count;
    return true;
}

bool canopy_device_list_add(struct canopy_device_list *list, const union canopy_device_point *point) {
    return canopy_device_list_append(list, point, 1);
}

void canopy_device_list_free(struct canopy_device_list *list) {
    free(list->points);
    *list = (struct canopy_device_list){.scalar = list->scalar};
}

struct canopy_cloud canopy_device_list_cloud(const struct canopy_device_list *list) {
    struct canopy_cloud cloud = {.scalar = list->scalar, .count = list->count, .stride = 3, .axis = {NULL}};
    for (size_t k = 0; k < 3 && list->points; k++) {
        cloud.axis[k] =
            list->scalar == CANOPY_F32 ? (const void *)(list->points->f32 + k) : (const void *)(list->points->fx + k);
    }
    return cloud;
}
