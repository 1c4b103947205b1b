#include "port/cortexm/clock.h"

#include "port/cortexm/core.h"
#include "port/cortexm/startup.h"

static uint32_t ticks_per_us;
static uint32_t us_per_turn;     // whole, so that time needs no division of 64 bits
static volatile uint32_t turns;  // written by the interrupt, read with interrupts masked; they last 91 years at 25 MHz
static uint32_t latest, latest_part;  // what was read last, with interrupts masked
static volatile uint32_t activity;

void canopy_cortexm_clock_start(uint32_t hz) {
    ticks_per_us = hz / 1000000u;
    us_per_turn = (1u << 24) / ticks_per_us;
    CANOPY_SYSTICK_LOAD = us_per_turn * ticks_per_us - 1u;
    CANOPY_SYSTICK_VAL = 0;
    CANOPY_SYSTICK_CTRL = 7;  // processor clock, interrupt, enabled
}

void canopy_systick_entry(void) { turns++; }

// The whole turns and the ticks into the next one. The counter runs down and its interrupt becomes pending as it
// reaches 0: a value of 0 is the first tick of a new turn.
static uint32_t read_clock(uint32_t *whole) {
    const uint32_t before = canopy_core_mask();
    uint32_t left = CANOPY_SYSTICK_VAL;
    uint32_t count = turns;
    if ((CANOPY_SCB_ICSR & CANOPY_ICSR_SYSTICK_PENDING) != 0) {
        left = CANOPY_SYSTICK_VAL;  // read again: the first may be from before the turn
        count++;
    }
    uint32_t part = left == 0 ? 0 : us_per_turn * ticks_per_us - left;
    // QEMU on a busy host may show the 0 before the interrupt is pending: the clock stands still then, never goes back.
    if (count < latest || (count == latest && part < latest_part)) {
        count = latest;
        part = latest_part;
    }
    latest = count;
    latest_part = part;
    canopy_core_restore(before);
    *whole = count;
    return part;
}

uint64_t canopy_cortexm_ticks(void) {
    uint32_t whole;
    const uint32_t part = read_clock(&whole);
    return (uint64_t)whole * (us_per_turn * ticks_per_us) + part;
}

uint64_t canopy_cortexm_now_us(void) {
    uint32_t whole;
    const uint32_t part = read_clock(&whole);
    return (uint64_t)whole * us_per_turn + part / ticks_per_us;
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
