#include "tools/bench/series.h"

#include <stdlib.h>
#include <string.h>
#include <time.h>

double canopy_series_now(void) {
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}

void canopy_series_add(struct canopy_series *series, double us) {
    if (series->count < CANOPY_SERIES_MOST) {
        series->us[series->count++] = us;
    }
}

static int compare(const void *a, const void *b) {
    const double x = *(const double *)a;
    const double y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(const double *values, size_t count) {
    double sorted[CANOPY_SERIES_MOST];
    memcpy(sorted, values, count * sizeof *sorted);
    qsort(sorted, count, sizeof *sorted, compare);
    return (sorted[(count - 1) / 2] + sorted[count / 2]) / 2.0;
}

double canopy_series_median(const struct canopy_series *series) { return median(series->us, series->count); }

static double best(const struct canopy_series *series) {
    double least = series->us[0];
    for (size_t i = 1; i < series->count; i++) {
        least = series->us[i] < least ? series->us[i] : least;
    }
    return least;
}

json_t *canopy_series_report(const struct canopy_series *series, const struct canopy_series *floor, size_t points) {
    const double middle = canopy_series_median(series);
    double quotients[CANOPY_SERIES_MOST] = {0};
    for (size_t i = 0; i < series->count; i++) {
        quotients[i] = series->us[i] / floor->us[i];
    }
    return json_pack("{s:f, s:f, s:f, s:f, s:f}", "median_us", middle, "best_us", best(series), "ns_per_point",
                     1e3 * middle / (double)points, "floors", middle / canopy_series_median(floor), "floors_by_round",
                     median(quotients, series->count));
}
