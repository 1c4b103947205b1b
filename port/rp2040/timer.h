/// The clock of an RP2040 (datasheet 4.6): 64 bits of microseconds since the start of the chip, and its four alarms,
/// each with an interrupt of its own.
#ifndef CANOPY_PORT_RP2040_TIMER_H
#define CANOPY_PORT_RP2040_TIMER_H

#include <stdint.h>

#include "lib/port.h"

uint64_t canopy_rp2040_now_us(void);

/// The clock as the library sees it.
struct canopy_clock canopy_rp2040_clock(void);

/// Raises interrupt RP2040_IRQ_TIMER + `number` (0 to 3) when the clock reaches `at_us`, at once if it has; at most 35
/// minutes ahead. It replaces the alarm of that number that was set before.
void canopy_rp2040_set_alarm(uint32_t number, uint64_t at_us);

/// Takes an alarm and its interrupt back: also what its handler does first.
void canopy_rp2040_clear_alarm(uint32_t number);

#endif
