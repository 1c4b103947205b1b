/// Points from a file, one after the other, in IEEE double.
///
/// A path that ends in `.ply` (any case) is read as PLY; everything else, and "-" for standard input, as text: three
/// numbers a line, separated by blanks or tabs and at most one comma or semicolon; further columns are ignored, `#`
/// starts a comment, blank lines are skipped. Nothing is repaired: a word, a missing column, two kinds of separator on
/// a line (decimal commas), nan, inf or a number beyond double is a fault with its line. Memory does not grow with the
/// file. Text: about 0.1 us a point.
#ifndef CANOPY_TOOLS_COMMON_POINTS_H
#define CANOPY_TOOLS_COMMON_POINTS_H

#include <stdbool.h>
#include <stdint.h>

#include "tools/common/fault.h"

/// Takes one finite point. To refuse it, fill `fault` with what is wrong and the remedy, and return false; the reader
/// puts the file and `where` in front. `where` is the text line, or in binary PLY the number of the vertex, from 1.
struct canopy_points_sink {
    void *context;
    bool (*take)(void *context, const double point[3], uint64_t where, struct canopy_fault *fault);
};

/// What was read.
struct canopy_points_info {
    uint64_t count;
    bool by_line;  ///< `where` is a text line; false: it is the number of a vertex in a binary PLY
};

/// Reads all points of `path` into `sink`. No point at all is a fault. `info` is valid on success.
bool canopy_points_read(const char *path, struct canopy_points_sink sink, struct canopy_points_info *info,
                        struct canopy_fault *fault);

/// Puts `path` and the place `where` before the text of a fault found after reading. Always returns false.
bool canopy_points_place(struct canopy_fault *fault, const char *path, bool by_line, uint64_t where);

#endif
