/// Start-up of a Cortex-M image: what a board's vector table points to.
#ifndef CANOPY_PORT_CORTEXM_STARTUP_H
#define CANOPY_PORT_CORTEXM_STARTUP_H

#include <stdint.h>

/// The end of the stack, from the linker: the first word of the vector table.
extern uint32_t canopy_stack_top[];

/// Copies .data, clears .bss, turns on the configurable faults, guards the
/// end of the stack where the chip has a memory protection unit, and calls main. A main that returns is a fault.
void canopy_reset(void);

/// Every exception that nobody handles, faults and the watchdog's NMI: see port/cortexm/fault.h.
void canopy_fault_entry(void);

/// The clock's interrupt: see port/cortexm/clock.h.
void canopy_systick_entry(void);

#endif
