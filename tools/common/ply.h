/// Points from a PLY file: the x, y and z of its element "vertex".
///
/// ASCII and binary of both byte orders; x, y and z of any scalar type, kept in full precision; other properties (lists
/// too) and other elements are read over, up to the end of the file, so that a truncated copy never passes.
///
/// Why a reader of our own: Debian 12 packages no PLY library for C (RPly, tinyply and miniply are not in it). Assimp
/// keeps single precision and is about meshes with faces; VCG and CGAL are C++ templates under the GPL or LGPL that
/// bring Boost along; PCL brings VTK. The format is one page.
#ifndef CANOPY_TOOLS_COMMON_PLY_H
#define CANOPY_TOOLS_COMMON_PLY_H

#include "tools/common/points.h"
#include "tools/common/source.h"

/// Reads the open `source` from its first byte into `sink`. Faults name the file and the line, or the element and byte.
bool canopy_ply_read(struct canopy_source *source, struct canopy_points_sink sink, struct canopy_points_info *info,
                     struct canopy_fault *fault);

#endif
