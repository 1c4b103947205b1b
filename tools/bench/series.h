/// Times of one thing, measured once a round, and what is said about them.
#ifndef CANOPY_TOOLS_BENCH_SERIES_H
#define CANOPY_TOOLS_BENCH_SERIES_H

#include <jansson.h>
#include <stddef.h>

#define CANOPY_SERIES_MOST 1024

struct canopy_series {
    size_t count;
    double us[CANOPY_SERIES_MOST];
};

/// Microseconds of this thread's processor time: other programs on the machine take time from us, but do not count.
double canopy_series_now(void);

/// Appends; beyond CANOPY_SERIES_MOST it is left out.
void canopy_series_add(struct canopy_series *series, double us);

double canopy_series_median(const struct canopy_series *series);

/// {"median_us", "best_us", "ns_per_point", "floors", "floors_by_round"}: nanoseconds and multiples of the floor are of
/// the medians; by_round is the median of each round's quotient, for rounds of both correspond. The reference is new.
/// (The best alone is not to be trusted: where a thread loses its core the clock can leave out a little of its time.)
json_t *canopy_series_report(const struct canopy_series *series, const struct canopy_series *floor, size_t points);

#endif
