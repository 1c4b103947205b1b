/// Traps of a RISC-V hart in machine mode: interrupts to the board, everything else to the record of the crash.
///
/// An exception takes a fresh stack if its own is what is broken, fills the record (port/common/crash_record.h) with
/// mepc, ra, sp, mcause and mtval, and resets. mcause becomes a kind of lib/port.h: an access fault below the stack is
/// CANOPY_CRASH_MEMORY, another one CANOPY_CRASH_BUS; what cannot be executed or is misaligned CANOPY_CRASH_USAGE.
#ifndef CANOPY_PORT_RISCV_TRAP_H
#define CANOPY_PORT_RISCV_TRAP_H

#include <stdbool.h>
#include <stdint.h>

/// What an interrupt has interrupted, for who records it.
struct canopy_trap_place {
    uint32_t pc, lr, sp;
};

/// What mtvec points to; direct mode.
void canopy_trap_entry(void);

/// The board's: handles the interrupt of this code (mcause without its highest bit: 7 timer, 11 external). Interrupts
/// stay masked until it returns. False: nobody handles it, which is a crash.
bool canopy_trap_interrupt(uint32_t code, const struct canopy_trap_place *place);

/// Ends in a crash of this kind at that place.
_Noreturn void canopy_trap_crash(uint32_t kind, const struct canopy_trap_place *place);

#endif
