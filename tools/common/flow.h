/// A pass over a file of points with all cores: the reader's thread cuts the file into batches, threads work on them,
/// and the reader's thread gathers what came out, in the order of the file. What comes out is therefore the same for
/// any number of threads.
///
/// Text is cut at line ends and parsed by the threads; of binary files the reader's thread decodes the numbers, which
/// takes 10 to 20 ns a point. The first bad line of the file is the one that is reported, whoever came upon it.
#ifndef CANOPY_TOOLS_COMMON_FLOW_H
#define CANOPY_TOOLS_COMMON_FLOW_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "tools/common/device.h"
#include "tools/common/fault.h"
#include "tools/common/points.h"

#define CANOPY_THREADS_MAX 64

/// Points of the file that follow each other, or of a list in memory.
struct canopy_batch {
    size_t count;
    const double (*raw)[3];             ///< as they stand in the file; NULL for points from memory
    const uint64_t *where;              ///< their lines in this batch, or their numbers in the file …
    uint64_t before;                    ///< … and, when it is gathered, the lines before the batch
    union canopy_device_point *points;  ///< room for as many, for whoever works on them; or points from memory, which
                                        ///< must not be changed
    void *result;                       ///< result_size bytes, zero when work begins
};

struct canopy_flow {
    const char *stage;   ///< what the pass is for, for canopy_progress
    unsigned threads;    ///< that work, 1 to CANOPY_THREADS_MAX
    size_t result_size;  ///< bytes that each batch's result takes
    void *context;
    /// Works on a batch, in any thread (0 … threads - 1) and any order; NULL: nothing to do. To refuse a point, fills
    /// `fault`, says which it is, and returns false: what follows in the file is then not gathered.
    bool (*work)(void *context, unsigned thread, struct canopy_batch *batch, size_t *bad, struct canopy_fault *fault);
    /// Takes a batch that has been worked on, in the caller's thread and the file's order. NULL: nothing to do.
    bool (*gather)(void *context, struct canopy_batch *batch, struct canopy_fault *fault);
};

/// How many threads this process may run at once: its processors, at most 16.
unsigned canopy_flow_threads(void);

/// Passes over a file. Faults and `info` are those of canopy_points_read. Memory: about 4 MB a thread, whatever the
/// file's size.
bool canopy_flow_file(const char *path, const struct canopy_flow *flow, struct canopy_points_info *info,
                      struct canopy_fault *fault);

/// Passes over points in memory.
bool canopy_flow_memory(const union canopy_device_point *points, size_t count, const struct canopy_flow *flow,
                        struct canopy_fault *fault);

#endif
