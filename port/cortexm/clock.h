/// The clock of a Cortex-M: SysTick, extended to 64 bits by an interrupt at each of its turns. There is one, as there
/// is one SysTick. A turn is nearly 2^24 processor clocks, 0.67 s at 25 MHz: the clock is right as long as interrupts
/// are never masked, nor the processor held up by a debugger or an emulator's host, for so long.
#ifndef CANOPY_PORT_CORTEXM_CLOCK_H
#define CANOPY_PORT_CORTEXM_CLOCK_H

#include <stdint.h>

#include "lib/port.h"

/// Starts SysTick from the processor clock of `hz`, a multiple of 1 MHz.
void canopy_cortexm_clock_start(uint32_t hz);

/// The clock as the library sees it: microseconds since the start.
struct canopy_clock canopy_cortexm_clock(void);

uint64_t canopy_cortexm_now_us(void);

/// Processor clock ticks since the start. Under `qemu -icount shift=0` an instruction takes one nanosecond of virtual
/// time, so that at 25 MHz a tick is 40 instructions.
uint64_t canopy_cortexm_ticks(void);

/// What interrupts have happened: changes with each one that may have brought work.
uint32_t canopy_cortexm_activity(void);

/// Interrupt handlers call this when they leave work behind.
void canopy_cortexm_note_activity(void);

/// Sleeps until an interrupt unless one has brought work since `seen` was read from canopy_cortexm_activity. Set an
/// alarm before, or the clock's next turn is the first to end it.
void canopy_cortexm_idle(uint32_t seen);

#endif
