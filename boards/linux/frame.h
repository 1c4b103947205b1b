/// The frame of a surrogate file, for a station that keeps to it.
#ifndef CANOPY_BOARDS_LINUX_FRAME_H
#define CANOPY_BOARDS_LINUX_FRAME_H

#include <stdbool.h>

#include "lib/cover/frame.h"
#include "tools/common/fault.h"

/// Reads the frame of `path` for `grid`'s cells and side; its size goes to grid->size. *unit is the file's unit. False,
/// and `fault` names the file and what a fixed-point station cannot use: another scalar, axes finer than 2^-30, a pitch
/// that the cells do not divide, a step that is no power of two, a grid that differs from `asked` (0 x 0: any).
bool canopyd_frame_read(const char *path, const uint16_t asked[2], struct canopy_grid *grid, struct canopy_frame *frame,
                        double *unit, struct canopy_fault *fault);

#endif
