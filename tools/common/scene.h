/// A point file as a line scanner sees it: a grid of heights in whole device units.
#ifndef CANOPY_TOOLS_COMMON_SCENE_H
#define CANOPY_TOOLS_COMMON_SCENE_H

#include <stdbool.h>
#include <stdint.h>

#include "tools/common/fault.h"

#define CANOPY_SCENE_NONE 0xFFFFu  ///< a column without reading

/// Device units, but for `unit`. Reading (p, c) is at x = start[0] + c step[0], y = start[1] + p step[1],
/// z = z_offset + heights[p * columns + c] * z_step.
struct canopy_scene {
    double unit;
    uint32_t columns, profiles;
    int32_t start[2], step[2];
    int32_t z_offset;
    uint16_t z_step;
    uint16_t height_max;      ///< the largest count whose z fits 32 bits, at most 65534
    int32_t low[3], high[3];  ///< box of all readings
    uint64_t valid;           ///< readings
    uint16_t *heights;        ///< profile by profile
};

/// What the caller wants; 0 where it does not care.
struct canopy_scene_wish {
    uint32_t profiles, columns;
    double unit;
    double margin;  ///< input units kept free below and above the heights for noise
};

bool canopy_scene_load(const char *path, const struct canopy_scene_wish *wish, struct canopy_scene *scene,
                       struct canopy_fault *fault);
void canopy_scene_free(struct canopy_scene *scene);

/// The double of the shortest decimal that rounds to this float.
double canopy_scene_shortest(float value);

#endif
