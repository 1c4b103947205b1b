#include "tools/bench/pair.h"

struct pair {
    struct canopy_surrogate surrogates[2];
    struct canopy_surface_report reports[2];
    struct canopy_crossing crossing;
};

static void free_both(struct pair *pair) {
    canopy_surrogate_free(&pair->surrogates[CANOPY_ABOVE]);
    canopy_surrogate_free(&pair->surrogates[CANOPY_BELOW]);
}

/// Each side as if there were no other one.
static bool fit_alone(const struct canopy_device_list *points, const struct canopy_surface_wish *wish,
                      struct pair *pair, struct canopy_fault *fault) {
    struct canopy_surface_wish one = *wish;
    one.side = CANOPY_ABOVE;
    if (!canopy_surface_fit(points, &one, &pair->surrogates[0], &pair->reports[0], fault)) {
        return false;
    }
    one.side = CANOPY_BELOW;
    if (!canopy_surface_fit(points, &one, &pair->surrogates[1], &pair->reports[1], fault)) {
        canopy_surrogate_free(&pair->surrogates[0]);
        return false;
    }
    const bool ok = canopy_crossing_find(&pair->surrogates[0], &pair->surrogates[1], &pair->crossing, fault);
    free_both(pair);
    return ok;
}

static bool fit_together(const struct canopy_device_list *points, const struct canopy_surface_wish *wish,
                         struct pair *pair, struct canopy_series *time, struct canopy_fault *fault) {
    for (int round = 0; round < CANOPY_BENCH_PAIR_ROUNDS; round++) {
        if (!canopy_surface_fit_both(points, wish, pair->surrogates, pair->reports, &pair->crossing, fault)) {
            return false;
        }
        canopy_series_add(time, 1e3 * pair->reports[0].fit_ms);
        free_both(pair);
    }
    return true;
}

static json_t *gaps(const struct pair *pair) {
    return json_pack("[f, f]", canopy_exact_mean_gap(&pair->reports[0].result),
                     canopy_exact_mean_gap(&pair->reports[1].result));
}

bool canopy_bench_pair(const char *name, const struct canopy_device_list *points,
                       const struct canopy_surface_wish *wish, const struct canopy_series *floor, json_t *to,
                       struct canopy_fault *fault) {
    static struct canopy_series time;  // too large for a stack
    struct pair alone, both;
    time.count = 0;
    if (!fit_alone(points, wish, &alone, fault) || !fit_together(points, wish, &both, &time, fault)) {
        return false;
    }
    const struct canopy_exact_result *above = &both.reports[0].result, *below = &both.reports[1].result;
    json_array_append_new(to, json_pack("{s:s, s:o, s:o, s:o, s:b, s:f, s:I, s:I}", "name", name, "fit",
                                        canopy_series_report(&time, floor, points->count), "mean_gap_pct", gaps(&both),
                                        "alone_mean_gap_pct", gaps(&alone), "alone_cross",
                                        alone.crossing.verdict != CANOPY_CROSSING_NONE, "apart_pct",
                                        100.0 * both.crossing.distance / (above->height_max - above->height_min),
                                        "wrong", (json_int_t)(above->wrong + below->wrong), "outside",
                                        (json_int_t)(above->outside + below->outside)));
    return true;
}
