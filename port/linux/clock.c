#include "port/linux/clock.h"

#include <stddef.h>
#include <time.h>

uint64_t canopy_linux_now_us(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000U + (uint64_t)now.tv_nsec / 1000U;
}

static uint64_t now_us(void *context) {
    (void)context;
    return canopy_linux_now_us();
}

struct canopy_clock canopy_linux_clock(void) {
    return (struct canopy_clock){.context = NULL, .now_us = now_us};
}
