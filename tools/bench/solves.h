/// How many banded solves each line of a fit takes: the paper's Fig. 9.
#ifndef CANOPY_TOOLS_BENCH_SOLVES_H
#define CANOPY_TOOLS_BENCH_SOLVES_H

#include <jansson.h>
#include <stdbool.h>
#include <stdint.h>

#include "lib/cover/line.h"
#include "tools/common/device.h"

/// Index k: so many lines took k solves. Lines with nothing on them are in neither.
struct canopy_bench_solves {
    uint32_t lines[CANOPY_LINE_SOLVES + 1];    ///< along v, scattered heights: the paper's Heuristic(sigma, b, lambda)
    uint32_t columns[CANOPY_LINE_SOLVES + 1];  ///< along u, uniform heights: its Heuristic(sigma, b)
    uint32_t most;                             ///< of one surface, in all
};

/// Adds the lines of one fit from the points as canopy_fitting_run does it, side above, and returns its sum of solves;
/// 0: no memory, or the points are not fit for it.
uint32_t canopy_bench_solves_add(struct canopy_bench_solves *solves, const struct canopy_device_list *points,
                                 const uint16_t size[2]);

/// {"lines": [...], "columns": [...], "most_of_a_surface"}; the reference is new.
json_t *canopy_bench_solves_report(const struct canopy_bench_solves *solves);

#endif
