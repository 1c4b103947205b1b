#include "port/mps2/cmsdk_timer.h"

#include "port/cortexm/clock.h"
#include "port/cortexm/core.h"

#define CTRL 0x0u
#define VALUE 0x4u
#define RELOAD 0x8u
#define INTERRUPT 0xCu  // writing one clears

#define CTRL_COUNT_AND_INTERRUPT 9u

static volatile uint32_t *at(uintptr_t base, uint32_t offset) { return (volatile uint32_t *)(base + offset); }

void canopy_cmsdk_timer_start(struct canopy_cmsdk_timer *timer, uintptr_t base, uint32_t clock_hz, uint32_t irq) {
    *timer = (struct canopy_cmsdk_timer){.base = base, .ticks_per_us = clock_hz / 1000000u};
    *at(base, CTRL) = 0;
    *at(base, INTERRUPT) = 1;
    canopy_core_enable_irq(irq);
}

void canopy_cmsdk_timer_alarm(const struct canopy_cmsdk_timer *timer, uint32_t us) {
    *at(timer->base, CTRL) = 0;
    *at(timer->base, RELOAD) = us * timer->ticks_per_us;
    *at(timer->base, VALUE) = us * timer->ticks_per_us;
    *at(timer->base, CTRL) = CTRL_COUNT_AND_INTERRUPT;
}

void canopy_cmsdk_timer_on_alarm(const struct canopy_cmsdk_timer *timer) {
    *at(timer->base, CTRL) = 0;  // once
    *at(timer->base, INTERRUPT) = 1;
    canopy_cortexm_note_activity();
}
