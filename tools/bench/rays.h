/// Rays on a surface that has been fitted: how long one takes.
#ifndef CANOPY_TOOLS_BENCH_RAYS_H
#define CANOPY_TOOLS_BENCH_RAYS_H

#include <stdbool.h>
#include <stdint.h>

#include "tools/bench/series.h"
#include "tools/common/surrogate.h"

#define CANOPY_BENCH_RAYS 8192

struct canopy_bench_rays {
    struct canopy_series time;  ///< of all rays, once a round
    uint32_t hits, cells;       ///< of all rays
    uint8_t steps;              ///< most root-finder steps in one cell
};

/// Casts CANOPY_BENCH_RAYS rays: from everywhere over three frame widths, one to two widths away on the free side, to
/// everywhere in the frame at heights within the surface's range. The same rays each time. The surrogate is one that
/// canopy_surface_fit made, with axes along x, y, z. False: no memory, or a pitch that is no whole number of quanta.
bool canopy_bench_rays(const struct canopy_surrogate *surrogate, struct canopy_bench_rays *rays);

/// {"ns_per_ray", "per_second", "hits_pct", "cells_per_ray", "most_steps"}; the reference is new.
json_t *canopy_bench_rays_report(const struct canopy_bench_rays *rays);

#endif
