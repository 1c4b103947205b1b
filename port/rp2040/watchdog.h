/// The watchdog of an RP2040 (datasheet 4.7). It resets the whole chip but for its oscillators; memory keeps what it
/// holds.
///
/// It gives no warning, so an alarm of the timer does: when the period is over its interrupt, which is made
/// non-maskable, leaves a record that says where the program hung (port/cortexm/crash.h) and resets. Where that fails
/// too, the watchdog resets an eighth of the period later, and the next start knows it from the reason it keeps.
#ifndef CANOPY_PORT_RP2040_WATCHDOG_H
#define CANOPY_PORT_RP2040_WATCHDOG_H

#include "lib/port.h"

/// The watchdog counts 24 bits, down by two a microsecond (erratum RP2040-E1): 8.39 s, which leaves the warning some
/// time.
#define CANOPY_RP2040_WATCHDOG_MOST_US 8300000u

/// The alarm of the timer that warns, RP2040_IRQ_TIMER + this; nobody else may use it.
#define CANOPY_RP2040_WATCHDOG_ALARM 1u

/// Looks why the chip was reset and records a crash if the watchdog did it unrecorded. Call it once, early. Only a
/// watchdog that this program started counts: the boot ROM resets by it, too, after loading a program.
void canopy_rp2040_watchdog_look_back(void);

/// Starts it: from now on it must be fed once in `period_us`, at most CANOPY_RP2040_WATCHDOG_MOST_US; false beyond that
/// and below 1000. Nothing stops it but a reset.
bool canopy_rp2040_watchdog_start(uint32_t period_us);

/// The watchdog of lib/port.h. Fed before the start it does nothing.
struct canopy_watchdog canopy_rp2040_watchdog(void);

/// Around work that takes up to CANOPY_RP2040_WATCHDOG_MOST_US and during which no vector may be fetched: no warning
/// comes, and the whole of that time is given.
void canopy_rp2040_watchdog_hold(void);
void canopy_rp2040_watchdog_resume(void);

/// Resets the chip now.
_Noreturn void canopy_rp2040_reset(void);

#endif
