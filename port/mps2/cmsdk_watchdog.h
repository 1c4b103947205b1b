/// The watchdog of Arm's Cortex-M System Design Kit (CMSDK technical reference, 4.6).
///
/// It counts down from its period. At the first zero it raises NMI, which leaves a record that says where the
/// program hung (port/cortexm/crash.h) and resets; should that fail too, the second zero resets by hardware.
#ifndef CANOPY_PORT_MPS2_CMSDK_WATCHDOG_H
#define CANOPY_PORT_MPS2_CMSDK_WATCHDOG_H

#include "lib/port.h"

struct canopy_cmsdk_watchdog {
    uintptr_t base;
};

/// Starts it: from now on it must be fed once in `period_us`. Nothing stops it but a reset. Feed it from one place, at
/// the end of a finished cycle, never from an interrupt. `clock_hz * period_us / 1e6` must fit 32 bits.
void canopy_cmsdk_watchdog_start(struct canopy_cmsdk_watchdog *watchdog, uintptr_t base, uint32_t clock_hz,
                                 uint32_t period_us);

/// The watchdog of lib/port.h; the object must outlive it.
struct canopy_watchdog canopy_cmsdk_watchdog(struct canopy_cmsdk_watchdog *watchdog);

#endif
