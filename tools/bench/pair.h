/// Both sides of the same points: what keeping them apart costs against each alone.
#ifndef CANOPY_TOOLS_BENCH_PAIR_H
#define CANOPY_TOOLS_BENCH_PAIR_H

#include <jansson.h>
#include <stdbool.h>

#include "tools/bench/series.h"
#include "tools/common/fault.h"
#include "tools/common/surface.h"

#define CANOPY_BENCH_PAIR_ROUNDS 3

/// Fits a sandwich CANOPY_BENCH_PAIR_ROUNDS times and each side alone once, as `wish` says but for its side. Adds
/// {"name", "fit", "mean_gap_pct": [above, below], "alone_mean_gap_pct": [above, below], "alone_cross": whether the two
/// alone cross, "apart_pct": how far the pair is apart at least, "wrong", "outside"} to `to`. Per cent are of the
/// points' height range.
bool canopy_bench_pair(const char *name, const struct canopy_device_list *points,
                       const struct canopy_surface_wish *wish, const struct canopy_series *floor, json_t *to,
                       struct canopy_fault *fault);

#endif
