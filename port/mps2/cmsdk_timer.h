/// The timer of Arm's Cortex-M System Design Kit (CMSDK technical reference, 4.1) as an alarm: one interrupt at a time
/// to come, to end a sleep.
#ifndef CANOPY_PORT_MPS2_CMSDK_TIMER_H
#define CANOPY_PORT_MPS2_CMSDK_TIMER_H

#include <stdint.h>

struct canopy_cmsdk_timer {
    uintptr_t base;
    uint32_t ticks_per_us;
};

/// Sets the timer up and lets its interrupt in. `clock_hz` is a multiple of 1 MHz.
void canopy_cmsdk_timer_start(struct canopy_cmsdk_timer *timer, uintptr_t base, uint32_t clock_hz, uint32_t irq);

/// The alarm goes off once, in `us` microseconds (1 to 100 seconds); it replaces the one before.
void canopy_cmsdk_timer_alarm(const struct canopy_cmsdk_timer *timer, uint32_t us);

/// Interrupt entry, from the board's vector table.
void canopy_cmsdk_timer_on_alarm(const struct canopy_cmsdk_timer *timer);

#endif
