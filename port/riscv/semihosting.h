/// Characters for a debugger or an emulator (RISC-V Semihosting specification 0.4). Without either the breakpoint
/// traps, and canopy_trap_entry passes over it: the character is dropped.
#ifndef CANOPY_PORT_RISCV_SEMIHOSTING_H
#define CANOPY_PORT_RISCV_SEMIHOSTING_H

#include <stdbool.h>
#include <stdint.h>

#define CANOPY_SEMIHOSTING_BEFORE 0x01F01013u  // slli x0, x0, 0x1f
#define CANOPY_SEMIHOSTING_AFTER 0x40705013u   // srai x0, x0, 7

static inline void canopy_semihosting_put(char character) {
    register uint32_t operation __asm("a0") = 3;  // SYS_WRITEC
    register const char *what __asm("a1") = &character;
    // Three instructions of 32 bits in one page
    __asm volatile(".option push\n\t"
                   ".option norvc\n\t"
                   ".balign 16\n\t"
                   "slli x0, x0, 0x1f\n\t"
                   "ebreak\n\t"
                   "srai x0, x0, 7\n\t"
                   ".option pop"
                   : "+r"(operation)
                   : "r"(what)
                   : "memory");
}

/// Whether the breakpoint at `pc` is one of these.
static inline bool canopy_semihosting_is_at(uint32_t pc) {
    if (pc % 4u != 0)
        return false;
    const uint32_t *at = (const uint32_t *)(uintptr_t)pc;
    return at[-1] == CANOPY_SEMIHOSTING_BEFORE && at[1] == CANOPY_SEMIHOSTING_AFTER;
}

#endif
