/// Device points wherever they are: held in memory, or in a file that is read again for every pass.
#ifndef CANOPY_TOOLS_COMMON_SUPPLY_H
#define CANOPY_TOOLS_COMMON_SUPPLY_H

#include <stdbool.h>
#include <stdint.h>

#include "tools/common/device.h"
#include "tools/common/exact.h"
#include "tools/common/fault.h"
#include "tools/common/flow.h"

struct canopy_supply {
    enum canopy_scalar scalar;
    unsigned threads;  ///< that a pass may use
    uint64_t count;
    struct canopy_device_list list;  ///< the points; without any, they are in the file:
    const char *path;
    double unit;                          ///< input units a device unit
    uint64_t mark;                        ///< what canopy_supply_mark makes of all points in their order
    union canopy_device_point low, high;  ///< the box around them
    struct canopy_points_info *info;      ///< not NULL: the file has not been read yet, so there is nothing to compare
                                          ///< with; receives what is read
};

/// Points in memory, which stay the caller's, for one thread.
struct canopy_supply canopy_supply_of(const struct canopy_device_list *list);

static inline bool canopy_supply_is_held(const struct canopy_supply *supply) { return supply->list.points != NULL; }

/// A pass over all points, as canopy_flow_file makes it, with as many threads as the supply may use, or flow->threads
/// where that is less and not 0. A file whose points are not those that it had at first, bit for bit, is a fault: what
/// is proved is proved of what was read.
bool canopy_supply_pass(const struct canopy_supply *supply, const struct canopy_flow *flow, struct canopy_fault *fault);

/// Reads the points of a file into memory after all: 12 bytes a point.
bool canopy_supply_hold(struct canopy_supply *supply, struct canopy_fault *fault);

/// What is known of each point of a surrogate, as canopy_exact_check has it, with all threads; and, if `covered` is not
/// NULL, as canopy_exact_coverage has it. Memory: the exact table for each thread, fewer threads where that were more
/// than 256 MB.
bool canopy_supply_check(const struct canopy_supply *supply, const struct canopy_surrogate *surrogate, uint8_t *covered,
                         struct canopy_exact_result *result, struct canopy_fault *fault);

/// The same of a file that is read only once, in the surrogate's scalar and unit.
bool canopy_supply_check_file(const char *path, const struct canopy_surrogate *surrogate, unsigned threads,
                              struct canopy_exact_result *result, struct canopy_points_info *info,
                              struct canopy_fault *fault);

/// A mark of points in their order, which one changed bit changes: those of batches are put together by
/// canopy_supply_join.
uint64_t canopy_supply_mark(const union canopy_device_point *points, size_t count);
static inline uint64_t canopy_supply_join(uint64_t before, uint64_t mark) {
    return (before ^ mark) * UINT64_C(0x9e3779b97f4a7c15) + 1;
}

void canopy_supply_free(struct canopy_supply *supply);

#endif
