#include "port/mps2/cmsdk_watchdog.h"

#define LOAD 0x000u
#define CONTROL 0x008u
#define CLEAR 0x00Cu
#define LOCK 0xC00u

#define CONTROL_WARN_AND_RESET 3u
#define UNLOCK 0x1ACCE551u

static volatile uint32_t *at(uintptr_t base, uint32_t offset) { return (volatile uint32_t *)(base + offset); }

static void feed(void *context) {
    const struct canopy_cmsdk_watchdog *watchdog = context;
    *at(watchdog->base, LOCK) = UNLOCK;
    *at(watchdog->base, CLEAR) = 1;  // takes the warning back and reloads the counter
    *at(watchdog->base, LOCK) = 0;   // a program gone wild does not feed it by chance
}

void canopy_cmsdk_watchdog_start(struct canopy_cmsdk_watchdog *watchdog, uintptr_t base, uint32_t clock_hz,
                                 uint32_t period_us) {
    watchdog->base = base;
    *at(base, LOCK) = UNLOCK;
    *at(base, LOAD) = (uint32_t)((uint64_t)clock_hz * period_us / 1000000u);
    *at(base, CONTROL) = CONTROL_WARN_AND_RESET;
    *at(base, LOCK) = 0;
}

struct canopy_watchdog canopy_cmsdk_watchdog(struct canopy_cmsdk_watchdog *watchdog) {
    return (struct canopy_watchdog){.context = watchdog, .feed = feed};
}
