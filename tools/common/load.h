/// All points of a file as the device receives them: into memory, or what is known of them and where they are.
#ifndef CANOPY_TOOLS_COMMON_LOAD_H
#define CANOPY_TOOLS_COMMON_LOAD_H

#include <stdbool.h>

#include "tools/common/device.h"
#include "tools/common/fault.h"
#include "tools/common/points.h"
#include "tools/common/supply.h"
#include "tools/common/surrogate.h"

struct canopy_load_wish {
    enum canopy_scalar scalar;
    double unit;                           ///< 0: find it
    const struct canopy_surrogate *frame;  ///< every point must be in this frame, or NULL
    uint64_t most;                         ///< bytes of memory that points may take; 0: as many as they need
    unsigned threads;                      ///< that read; 0: one
};

struct canopy_loaded {
    struct canopy_device_list list;  ///< the points; empty if they are not held
    struct canopy_supply supply;     ///< the same list, or the file that is read again for each pass
    struct canopy_points_info info;  ///< what was read
    double unit;                     ///< input units a device unit
    double loss;                     ///< the most that rounding moved a coordinate, in input units
};

/// Reads `path`. Where the unit is not given: 1 in float; in fixed point the power of ten that spreads the largest
/// extent over 10^5 to 10^6 units (of a single point: its largest coordinate). A point outside `wish->frame`, decided
/// exactly, or beyond the device format is a fault with its line. After success loaded->list needs
/// canopy_device_list_free. Memory: 12 bytes a point, 24 more while the unit is being found; where that is beyond
/// wish->most, 4 MB a thread, and the file is read again for whoever asks the supply. What cannot be read twice, a
/// pipe, is held in any case. `path` must stay as long as the supply is used.
bool canopy_load(const char *path, const struct canopy_load_wish *wish, struct canopy_loaded *loaded,
                 struct canopy_fault *fault);

#endif
