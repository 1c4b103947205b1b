/// Points from a LAS file (ASPRS LAS 1.0 to 1.4, point formats 0 to 10): airborne, mobile and terrestrial surveys.
///
/// A coordinate is the file's whole number times its scale plus its offset, in IEEE double (two roundings, the format's
/// own rule). Points that the file marks as withheld, which the format says are deleted, are skipped and counted in
/// info->skipped. Everything else of a point and the variable length records are read over; all points that the header
/// counts must be there, so that a truncated copy never passes. Memory does not grow with the file.
///
/// Compressed files (.laz) are recognised and refused with what to do. Why: Debian 12 packages neither LASzip, PDAL nor
/// libLAS, and no other library that unpacks LAZ; and an uncompressed LAS file is one page of format, which needs none.
#ifndef CANOPY_TOOLS_COMMON_LAS_H
#define CANOPY_TOOLS_COMMON_LAS_H

#include "tools/common/points.h"
#include "tools/common/source.h"

/// Reads the open `source` from its first byte into `sink`. Faults name the file, and the byte or the point.
bool canopy_las_read(struct canopy_source *source, struct canopy_points_sink sink, struct canopy_points_info *info,
                     struct canopy_fault *fault);

#endif
