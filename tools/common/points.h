/// Points from a file, one after the other, in IEEE double.
///
/// A path that ends in `.ply`, `.pcd`, `.las` or `.laz` (any case) is read as that (ply.h, pcd.h, las.h), and so is
/// whatever begins as such a file does, standard input ("-") too; everything else is text: three
/// numbers a line, separated by blanks or tabs and at most one comma or semicolon; further columns are ignored, `#`
/// starts a comment, blank lines are skipped. Nothing is repaired: a word, a missing column, two kinds of separator on
/// a line (decimal commas), nan, inf or a number beyond double is a fault with its line. Memory does not grow with the
/// file. Text: about 0.1 us a point.
#ifndef CANOPY_TOOLS_COMMON_POINTS_H
#define CANOPY_TOOLS_COMMON_POINTS_H

#include <stdbool.h>
#include <stdint.h>

#include "tools/common/fault.h"
#include "tools/common/source.h"

/// Takes one finite point. To refuse it, fill `fault` with what is wrong and the remedy, and return false; the reader
/// puts the file and `where` in front. `where` is the text line, or in binary files the number of the point, from 1.
struct canopy_points_sink {
    void *context;
    bool (*take)(void *context, const double point[3], uint64_t where, struct canopy_fault *fault);
};

/// What was read.
struct canopy_points_info {
    uint64_t count;    ///< points that the sink was given
    uint64_t skipped;  ///< points that the file itself says are none …
    const char *why;   ///< … because they "were not measured" (PCD) or "are withheld" (LAS)
    bool by_line;      ///< `where` is a text line; false: it is the number of a point in a binary file
};

/// A reader of a binary format.
typedef bool canopy_points_reader(struct canopy_source *source, struct canopy_points_sink sink,
                                  struct canopy_points_info *info, struct canopy_fault *fault);

/// Chooses the reader of an open file; NULL: it is text. False: it cannot be read.
bool canopy_points_find_reader(struct canopy_source *source, const char *path, canopy_points_reader **read,
                               struct canopy_fault *fault);

/// Parses `size` bytes of text lines, text[size] being writable too, into `sink`, to which `where` is a line's number
/// in the text, from 1. `first`: the text begins the file. `*lines` is how many there were, or the number of the one
/// that the fault is about, which does not name it.
bool canopy_points_parse(char *text, size_t size, bool first, struct canopy_points_sink sink, uint64_t *lines,
                         struct canopy_fault *fault);

/// Says that a file without a point has none. Always returns false. `lines` are those of a text.
bool canopy_points_none(const char *path, const struct canopy_points_info *info, uint64_t lines,
                        struct canopy_fault *fault);

/// Reads all points of `path` into `sink`. No point at all is a fault. `info` is valid on success.
bool canopy_points_read(const char *path, struct canopy_points_sink sink, struct canopy_points_info *info,
                        struct canopy_fault *fault);

/// " (5 more in the file were not measured)", or nothing where none was skipped.
struct canopy_points_note {
    char text[80];
};
struct canopy_points_note canopy_points_skipped(const struct canopy_points_info *info);

/// Puts `path` and the place `where` before the text of a fault found after reading. Always returns false.
bool canopy_points_place(struct canopy_fault *fault, const char *path, bool by_line, uint64_t where);

#endif
