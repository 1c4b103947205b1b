/// The core-local interruptor's timer (SiFive FU540-C000 manual, chapter 9; the same registers as MTIMER of the RISC-V
/// ACLINT specification 1.0): the clock, one alarm to end a sleep, and a watchdog made of the same interrupt.
///
/// The watchdog is software: it catches a program that hangs, and says where, but not one that hangs with interrupts
/// masked or whose trap entry is broken. A chip that has a real one should start that as well.
#ifndef CANOPY_PORT_RISCV_CLINT_H
#define CANOPY_PORT_RISCV_CLINT_H

#include "lib/port.h"

struct canopy_clint {
    uintptr_t base;
    uint32_t ticks_per_us;
    uint64_t alarm;         ///< ticks; UINT64_MAX: none
    uint64_t watch;         ///< when to look whether the watchdog was fed; UINT64_MAX: it has not been started
    uint32_t watch_ticks;   ///< its period
    volatile uint32_t fed;  ///< the clock's low word when it was fed: one store, so that nothing needs masking
};

/// What the timer's interrupt was for.
enum canopy_clint_event { CANOPY_CLINT_TIME, CANOPY_CLINT_HANG };

/// Starts it without an alarm. `hz` of mtime is a multiple of 1 MHz, below 4 GHz. A counter of 32,768 Hz, as some chips
/// have, needs another conversion than here.
void canopy_clint_start(struct canopy_clint *clint, uintptr_t base, uint32_t hz);

/// mtime: ticks since power-on, or since the reset where that clears it.
uint64_t canopy_clint_ticks(const struct canopy_clint *clint);
uint64_t canopy_clint_now_us(const struct canopy_clint *clint);

/// The clock of lib/port.h; the object must outlive it.
struct canopy_clock canopy_clint_clock(struct canopy_clint *clint);

/// The timer interrupts at this time of the clock, or at once if it has passed; it replaces the alarm before. Call it
/// with interrupts masked.
void canopy_clint_alarm(struct canopy_clint *clint, uint64_t due_us);

/// Starts the watchdog. False: a period of 0, or of 2^31 ticks and more (214 s at 10 MHz). Call it with interrupts
/// masked.
bool canopy_clint_start_watchdog(struct canopy_clint *clint, uint32_t period_us);

/// The watchdog of lib/port.h; the object must outlive it.
struct canopy_watchdog canopy_clint_watchdog(struct canopy_clint *clint);

/// Interrupt entry. CANOPY_CLINT_HANG: nobody has fed the watchdog for its period. Otherwise the interrupt has been
/// given its next time.
enum canopy_clint_event canopy_clint_on_timer(struct canopy_clint *clint);

#endif
