/// The fast method by several threads: lines are shared out among them, then columns (lib/cover/fast.h).
#ifndef CANOPY_TOOLS_COMMON_CREW_H
#define CANOPY_TOOLS_COMMON_CREW_H

#include <stdbool.h>

#include "lib/cover/fast.h"
#include "tools/common/fault.h"

/// Fits all lines and columns of a fit that has begun; canopy_fast_step does what is left. The result does not depend
/// on the number of threads. Memory: CANOPY_FAST_SHARE_ARENA for each. Shows progress.
bool canopy_crew_run(struct canopy_fast *fast, unsigned threads, struct canopy_fault *fault);

#endif
