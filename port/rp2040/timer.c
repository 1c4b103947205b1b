#include "port/rp2040/timer.h"

#include "port/rp2040/registers.h"

// The two halves are read apart: again if the upper one has changed meanwhile.
uint64_t canopy_rp2040_now_us(void) {
    uint32_t high = canopy_rp2040_get(RP2040_TIMER_RAW_HIGH);
    for (;;) {
        const uint32_t low = canopy_rp2040_get(RP2040_TIMER_RAW_LOW);
        const uint32_t again = canopy_rp2040_get(RP2040_TIMER_RAW_HIGH);
        if (again == high)
            return (uint64_t)high << 32 | low;
        high = again;
    }
}

static uint64_t now_us(void *context) {
    (void)context;
    return canopy_rp2040_now_us();
}

struct canopy_clock canopy_rp2040_clock(void) {
    return (struct canopy_clock){.context = NULL, .now_us = now_us};
}

void canopy_rp2040_set_alarm(uint32_t number, uint64_t at_us) {
    canopy_rp2040_clear_alarm(number);
    canopy_rp2040_put(RP2040_TIMER_ALARM(number), (uint32_t)at_us);
    canopy_rp2040_set(RP2040_TIMER_INTE, 1u << number);
    // It goes off when the clock becomes equal: one that had passed before it was written, and so is armed still, is
    // raised by hand.
    if (canopy_rp2040_now_us() >= at_us && (canopy_rp2040_get(RP2040_TIMER_ARMED) & 1u << number) != 0) {
        canopy_rp2040_put(RP2040_TIMER_ARMED, 1u << number);
        canopy_rp2040_set(RP2040_TIMER_INTF, 1u << number);
    }
}

void canopy_rp2040_clear_alarm(uint32_t number) {
    canopy_rp2040_put(RP2040_TIMER_ARMED, 1u << number);
    canopy_rp2040_clear(RP2040_TIMER_INTF, 1u << number);
    canopy_rp2040_put(RP2040_TIMER_INTR, 1u << number);
}
