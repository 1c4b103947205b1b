/// Start-up of a Cortex-M image: what a board's vector table points to.
#ifndef CANOPY_PORT_CORTEXM_STARTUP_H
#define CANOPY_PORT_CORTEXM_STARTUP_H

#include <stdint.h>

/// The two ends of the stack, from the linker. The upper one is the first word of the vector table.
extern uint32_t canopy_stack_top[], canopy_stack_limit[];

/// Copies .data, clears .bss, turns on the floating-point unit and the configurable faults where there are, guards the
/// end of the stack where the chip has a memory protection unit, and calls main. A main that returns is a crash.
void canopy_reset(void);

/// The clock's interrupt: see port/cortexm/clock.h.
void canopy_systick_entry(void);

#endif
