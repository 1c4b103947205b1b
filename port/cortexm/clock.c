#include "port/cortexm/clock.h"

#include "port/cortexm/core.h"
#include "port/cortexm/startup.h"

static uint32_t ticks_per_ms;
static uint32_t ticks_per_us;
static volatile uint64_t milliseconds;  // written by the interrupt, read with interrupts masked
static uint64_t latest;  // what was read last, with interrupts masked: the clock never goes back behind it
static uint32_t latest_part;
static volatile uint32_t activity;

void canopy_cortexm_clock_start(uint32_t hz) {
    ticks_per_ms = hz / 1000u;
    ticks_per_us = hz / 1000000u;
    CANOPY_SYSTICK_LOAD = ticks_per_ms - 1u;
    CANOPY_SYSTICK_VAL = 0;
    CANOPY_SYSTICK_CTRL = 7;  // processor clock, interrupt, enabled
}

void canopy_systick_entry(void) { milliseconds++; }

// The whole milliseconds and the ticks into the next one. The counter runs down and its interrupt becomes pending as it
// reaches 0: a value of 0 is the first tick of a new millisecond.
static uint32_t read_clock(uint64_t *whole) {
    const uint32_t before = canopy_core_mask();
    uint32_t left = CANOPY_SYSTICK_VAL;
    uint64_t count = milliseconds;
    if ((CANOPY_SCB_ICSR & CANOPY_ICSR_SYSTICK_PENDING) != 0) {
        left = CANOPY_SYSTICK_VAL;  // read again: the first may be from before the turn
        count++;
    }
    const uint32_t part = left == 0 ? 0 : ticks_per_ms - left;
    // QEMU on a busy host may show the 0 before the interrupt is pending: then it stands still until that has happened.
    if (count > latest || (count == latest && part > latest_part)) {
        latest = count;
        latest_part = part;
    }
    *whole = latest;
    const uint32_t result = latest_part;
    canopy_core_restore(before);
    return result;
}

uint64_t canopy_cortexm_ticks(void) {
    uint64_t whole;
    const uint32_t part = read_clock(&whole);
    return whole * ticks_per_ms + part;
}

uint64_t canopy_cortexm_now_us(void) {
    uint64_t whole;
    const uint32_t part = read_clock(&whole);
    return whole * 1000u + part / ticks_per_us;
}

static uint64_t now_us(void *context) {
    (void)context;
    return canopy_cortexm_now_us();
}

struct canopy_clock canopy_cortexm_clock(void) {
    return (struct canopy_clock){.context = NULL, .now_us = now_us};
}

uint32_t canopy_cortexm_activity(void) { return activity; }

void canopy_cortexm_note_activity(void) {
    const uint32_t before = canopy_core_mask();
    activity++;
    canopy_core_restore(before);
}

void canopy_cortexm_idle(uint32_t seen) {
    // Masked, so that an interrupt between the look and the sleep still ends the sleep.
    const uint32_t before = canopy_core_mask();
    if (activity == seen)
        canopy_core_wait();
    canopy_core_restore(before);
}
