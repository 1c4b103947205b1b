/// An output file that is there whole or not at all.
///
/// What is written goes to a temporary file in the same directory, which takes the final name on commit. When the
/// program fails or is interrupted by SIGINT, SIGTERM or SIGHUP before that, nothing is left behind and a file that
/// stood there before is untouched. What is no regular file (a device, a pipe, a link) is written to directly.
#ifndef CANOPY_TOOLS_COMMON_OUTPUT_H
#define CANOPY_TOOLS_COMMON_OUTPUT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

#include "tools/common/fault.h"

#define CANOPY_OUTPUTS_MAX 2  ///< as many may be open at a time in a program

struct canopy_output {
    const char *path;  ///< belongs to the caller, valid until commit or abandon
    char *temporary;   ///< the name of what is being written; NULL if `path` itself is
    FILE *file;        ///< open for writing in binary
};

/// Creates the temporary file. On failure nothing needs abandoning.
bool canopy_output_open(struct canopy_output *output, const char *path, struct canopy_fault *fault);

/// Flushes, closes and renames. On failure everything is removed.
bool canopy_output_commit(struct canopy_output *output, struct canopy_fault *fault);

/// The same for several that belong together: either all get their names or none.
bool canopy_output_commit_all(struct canopy_output *const outputs[], size_t count, struct canopy_fault *fault);

/// Removes the temporary file. Harmless after commit.
void canopy_output_abandon(struct canopy_output *output);

#endif
