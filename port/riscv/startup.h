/// Start-up of a RISC-V image in machine mode, one hart.
#ifndef CANOPY_PORT_RISCV_STARTUP_H
#define CANOPY_PORT_RISCV_STARTUP_H

#include <stdint.h>

/// The two ends of the stack, from the linker.
extern uint32_t canopy_stack_top[], canopy_stack_limit[];

/// The first instruction of the image (section .vectors, at the lowest address of FLASH, where these chips start).
/// Interrupts off; gp and sp; all harts but number 0 sleep for ever; the 64 KB below the stack forbidden by a locked
/// entry of the physical memory protection, where the core has it; .data copied, .bss cleared; traps to
/// canopy_trap_entry; interrupts on; main. A main that returns is a crash.
void canopy_reset(void);

#endif
