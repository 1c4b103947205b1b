/// The control registers of a RISC-V hart in machine mode, RV32 (The RISC-V Instruction Set Manual, volume II, version
/// 20211203, chapters 2 and 3), and the instructions around them.
#ifndef CANOPY_PORT_RISCV_CORE_H
#define CANOPY_PORT_RISCV_CORE_H

#include <stdint.h>

#define CANOPY_CSR_READ(name)                                                                                          \
    __extension__({                                                                                                    \
        uint32_t value_;                                                                                               \
        __asm volatile("csrr %0, " #name : "=r"(value_)::"memory");                                                    \
        value_;                                                                                                        \
    })
#define CANOPY_CSR_WRITE(name, value) __asm volatile("csrw " #name ", %0" ::"r"((uint32_t)(value)) : "memory")
#define CANOPY_CSR_SET(name, bits) __asm volatile("csrs " #name ", %0" ::"r"((uint32_t)(bits)) : "memory")

#define CANOPY_MSTATUS_MIE (1u << 3)    // interrupts are let in
#define CANOPY_MIE_TIMER (1u << 7)      // machine timer interrupt
#define CANOPY_MIE_EXTERNAL (1u << 11)  // machine external interrupt: the PLIC's
#define CANOPY_MCAUSE_INTERRUPT (1u << 31)

/// Masks all interrupts; not 0 if they were masked before. Give that to canopy_core_restore.
static inline uint32_t canopy_core_mask(void) {
    uint32_t before;
    __asm volatile("csrrci %0, mstatus, 8" : "=r"(before)::"memory");
    return ~before & CANOPY_MSTATUS_MIE;
}

static inline void canopy_core_restore(uint32_t before) { CANOPY_CSR_SET(mstatus, before ^ CANOPY_MSTATUS_MIE); }

/// Sleeps until an interrupt that mie lets through is pending, masked in mstatus or not (3.3.3). It may return sooner.
static inline void canopy_core_wait(void) { __asm volatile("fence\n\twfi" ::: "memory"); }

/// Instructions since the start (3.1.10). A core may leave the counter out: then it reads as it likes.
static inline uint64_t canopy_core_instructions(void) {
    uint32_t high, low, again;
    do {
        high = CANOPY_CSR_READ(minstreth);
        low = CANOPY_CSR_READ(minstret);
        again = CANOPY_CSR_READ(minstreth);
    } while (high != again);
    return (uint64_t)high << 32 | low;
}

#endif
