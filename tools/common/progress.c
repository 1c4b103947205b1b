#include "tools/common/progress.h"

#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <time.h>
#include <unistd.h>

#define FIRST_S 1.0
#define EVERY_S 0.2

static struct {
    enum { NEW, SILENT, TERMINAL } to;
    bool shown;
    double next_s;
} state;

static double now_s(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

void canopy_progress(const char *stage, double part, uint64_t points) {
    if (state.to == NEW) {
        state.to = isatty(STDERR_FILENO) ? TERMINAL : SILENT;
        state.next_s = now_s() + FIRST_S;
    }
    if (state.to == SILENT) {
        return;
    }
    const double now = now_s();
    if (now < state.next_s) {
        return;
    }
    state.next_s = now + EVERY_S;
    state.shown = true;
    fprintf(stderr, "\r\033[Kcanopy: %s", stage);
    if (part >= 0.0) {
        fprintf(stderr, " %.0f%%", 100.0 * (part < 1.0 ? part : 1.0));
    }
    if (points > 0) {
        fprintf(stderr, " (%" PRIu64 " points)", points);
    }
    fflush(stderr);
}

void canopy_progress_end(void) {
    if (state.shown) {
        fputs("\r\033[K", stderr);
        fflush(stderr);
    }
    state.to = NEW;
    state.shown = false;
}
