/// Points from a PCD file (Point Cloud Library, versions .5 to .7): its fields x, y and z.
///
/// DATA ascii, binary and binary_compressed; x, y and z of any of the format's types (I, U, F of 1, 2, 4 or 8 bytes),
/// kept in full precision; other fields are read over. A point of an organised cloud that was not measured has nan (or
/// inf) in a coordinate: it is no point, is skipped, and is counted in info->skipped. VIEWPOINT is where the sensor
/// stood, not a transformation of the points, and plays no part. WIDTH, HEIGHT and POINTS must agree, and all points
/// must be there, so that a truncated copy never passes. Binary PCD is written in the byte order of the machine; it is
/// read with the lowest byte first.
///
/// Memory does not grow with the file but for binary_compressed, which the format keeps by fields: all of it is held,
/// unpacked (4 GB at most, which is the format's own limit).
///
/// Why a reader of our own: libpcl-io is the only one in Debian 12, and brings VTK and 200 MB along. What is compressed
/// is unpacked by Debian's liblzf, the library that the format is defined by.
#ifndef CANOPY_TOOLS_COMMON_PCD_H
#define CANOPY_TOOLS_COMMON_PCD_H

#include "tools/common/points.h"
#include "tools/common/source.h"

/// Reads the open `source` from its first byte into `sink`. Faults name the file and the line, or the point and byte.
bool canopy_pcd_read(struct canopy_source *source, struct canopy_points_sink sink, struct canopy_points_info *info,
                     struct canopy_fault *fault);

#endif
