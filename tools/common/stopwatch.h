/// Processor time of the calling thread, whatever else the machine does.
#ifndef CANOPY_TOOLS_COMMON_STOPWATCH_H
#define CANOPY_TOOLS_COMMON_STOPWATCH_H

#include <time.h>

/// Milliseconds since some beginning.
static inline double canopy_stopwatch_ms(void) {
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e3 * (double)t.tv_sec + 1e-6 * (double)t.tv_nsec;
}

/// The same of time that passes on the wall, where several threads work.
static inline double canopy_stopwatch_wall_ms(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e3 * (double)t.tv_sec + 1e-6 * (double)t.tv_nsec;
}

#endif
