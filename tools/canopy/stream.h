/// A point file against an open surrogate, in chunks: memory does not grow with the file.
#ifndef CANOPY_TOOLS_CANOPY_STREAM_H
#define CANOPY_TOOLS_CANOPY_STREAM_H

#include "tools/common/device.h"
#include "tools/common/exact.h"
#include "tools/common/points.h"

/// Is given each chunk of device points in the surrogate's scalar and unit.
struct canopy_stream_sink {
    void *context;
    void (*take)(void *context, const struct canopy_cloud *cloud);
};

/// Reads `path` to its end. Bad points are faults with their line, as in points.h and device.h. `info` says what was
/// read.
bool canopy_stream_points(const char *path, const struct canopy_surrogate *surrogate, struct canopy_stream_sink sink,
                          struct canopy_points_info *info, struct canopy_fault *fault);

#endif
