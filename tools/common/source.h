/// A buffered input file that knows its name, its line and its byte: what every point reader stands on.
///
/// One buffer of fixed size however large the file; "-" is standard input.
#ifndef CANOPY_TOOLS_COMMON_SOURCE_H
#define CANOPY_TOOLS_COMMON_SOURCE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include "tools/common/fault.h"

#define CANOPY_LINE_LIMIT 65536  ///< the longest text line accepted, in bytes

struct canopy_source {
    const char *name;  ///< as it is named in faults
    uint64_t line;     ///< number of the line last returned by canopy_source_line, from 1
    uint64_t offset;   ///< bytes consumed so far
    // private
    FILE *file;
    char *buffer;
    size_t begin;
    size_t end;
    bool ended;
    double size;  ///< of a file, in bytes; 0: not known
};

enum canopy_source_state { CANOPY_SOURCE_OK, CANOPY_SOURCE_END, CANOPY_SOURCE_FAULT };

/// Opens `path`, or standard input for "-". On failure nothing needs closing.
bool canopy_source_open(struct canopy_source *source, const char *path, struct canopy_fault *fault);

/// The next line without its end (LF or CR LF), NUL-terminated, valid until the next call. A line with a NUL byte in it
/// or longer than CANOPY_LINE_LIMIT is a fault.
enum canopy_source_state canopy_source_line(struct canopy_source *source, char **line, struct canopy_fault *fault);

/// The next whole lines as they stand, up to about 1 MB of them, valid until the next call: `*size` bytes, then one
/// that may be written over. Only the last line of the file may lack its end, and only a line longer than
/// CANOPY_LINE_LIMIT may be cut.
enum canopy_source_state canopy_source_lines(struct canopy_source *source, char **lines, size_t *size,
                                             struct canopy_fault *fault);

/// The next `count` bytes (at most CANOPY_LINE_LIMIT), valid until the next call; NULL if the file ends before them or
/// cannot be read, with `fault` saying at which byte.
const unsigned char *canopy_source_bytes(struct canopy_source *source, size_t count, struct canopy_fault *fault);

/// Reads over `count` bytes. False if the file ends before them or cannot be read.
bool canopy_source_skip(struct canopy_source *source, uint64_t count, struct canopy_fault *fault);

/// What comes next, without consuming it: `*count` bytes, at most CANOPY_LINE_LIMIT, fewer at the end of the file.
/// Valid until the next call; NULL if the file cannot be read.
const unsigned char *canopy_source_peek(struct canopy_source *source, size_t *count, struct canopy_fault *fault);

/// How much of the file has been consumed, 0 to 1; less than 0 where its size is not known.
double canopy_source_part(const struct canopy_source *source);

/// Closes what canopy_source_open opened.
void canopy_source_close(struct canopy_source *source);

#endif
