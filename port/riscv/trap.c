#include "port/riscv/trap.h"

#include "port/common/crash_record.h"
#include "port/riscv/core.h"
#include "port/riscv/semihosting.h"
#include "port/riscv/startup.h"

#define GUARD_BYTES 65536u
#define CAUSE_BREAKPOINT 3u

// What the entry pushes: the registers that a C function may change.
struct frame {
    uint32_t ra, t0, t1, t2, a0, a1, a2, a3, a4, a5, a6, a7, t3, t4, t5, t6;
};

_Noreturn void canopy_trap_crash(uint32_t kind, const struct canopy_trap_place *place) {
    const struct canopy_crash crash = {
        .kind = kind, .pc = place->pc, .lr = place->lr, .sp = place->sp, .status = CANOPY_CSR_READ(mcause)};
    canopy_crash_record(&crash);
}

static bool is_access_fault(uint32_t cause) { return cause == 1 || cause == 5 || cause == 7; }

// By the address, or, where the core does not tell it, by the stack pointer.
static bool is_below_stack(uint32_t address, uint32_t sp) {
    const uint32_t limit = (uint32_t)(uintptr_t)canopy_stack_limit;
    return limit - address - 1u < GUARD_BYTES || (address == 0 && sp < limit);
}

static enum canopy_crash_kind kind_of(uint32_t cause, uint32_t address, uint32_t sp) {
    if (is_access_fault(cause))
        return is_below_stack(address, sp) ? CANOPY_CRASH_MEMORY : CANOPY_CRASH_BUS;
    return cause <= 11 ? CANOPY_CRASH_USAGE : CANOPY_CRASH_HARD;
}

// On a fresh stack if the old one is broken, with its pointer and the return address then.
__attribute__((used)) static _Noreturn void record_crash(uint32_t sp, uint32_t ra) {
    struct canopy_crash crash = {.pc = CANOPY_CSR_READ(mepc),
                                 .lr = ra,
                                 .sp = sp,
                                 .status = CANOPY_CSR_READ(mcause),
                                 .address = CANOPY_CSR_READ(mtval)};
    crash.kind = kind_of(crash.status, crash.address, sp);
    canopy_crash_record(&crash);
}

// What may return: interrupts, and breakpoints of semihosting that nobody heard, which are passed over.
__attribute__((used)) static void take_trap(const struct frame *frame) {
    const uint32_t cause = CANOPY_CSR_READ(mcause), pc = CANOPY_CSR_READ(mepc);
    const struct canopy_trap_place place = {.pc = pc, .lr = frame->ra, .sp = (uint32_t)(uintptr_t)(frame + 1)};
    if (cause == CAUSE_BREAKPOINT && canopy_semihosting_is_at(pc))
        CANOPY_CSR_WRITE(mepc, pc + 4u);
    else if (cause == CAUSE_BREAKPOINT)
        canopy_trap_crash(CANOPY_CRASH_USAGE, &place);
    else if (!canopy_trap_interrupt(cause & ~CANOPY_MCAUSE_INTERRUPT, &place))
        canopy_trap_crash(CANOPY_CRASH_HARD, &place);
}

// Until it is known whether there is a stack only t0 is free, because mscratch keeps it. A crash does not return: it
// may use every register, and takes the stack from its top if the pointer is outside of it or near its end.
__attribute__((naked, aligned(64))) void canopy_trap_entry(void) {
    __asm volatile("csrw mscratch, t0\n\t"
                   "csrr t0, mcause\n\t"
                   "bltz t0, 1f\n\t"
                   "addi t0, t0, -3\n\t"
                   "beqz t0, 1f\n\t"
                   "mv a0, sp\n\t"
                   "mv a1, ra\n\t"
                   "la t0, canopy_stack_limit + 256\n\t"
                   "la t1, canopy_stack_top\n\t"
                   "bltu sp, t0, 2f\n\t"
                   "bleu sp, t1, 3f\n"
                   "2:\tmv sp, t1\n"
                   "3:\tandi sp, sp, -16\n\t"
                   "tail %0\n"
                   "1:\tcsrr t0, mscratch\n\t"
                   "addi sp, sp, -64\n\t"
                   "sw ra, 0(sp)\n\t"
                   "sw t0, 4(sp)\n\t"
                   "sw t1, 8(sp)\n\t"
                   "sw t2, 12(sp)\n\t"
                   "sw a0, 16(sp)\n\t"
                   "sw a1, 20(sp)\n\t"
                   "sw a2, 24(sp)\n\t"
                   "sw a3, 28(sp)\n\t"
                   "sw a4, 32(sp)\n\t"
                   "sw a5, 36(sp)\n\t"
                   "sw a6, 40(sp)\n\t"
                   "sw a7, 44(sp)\n\t"
                   "sw t3, 48(sp)\n\t"
                   "sw t4, 52(sp)\n\t"
                   "sw t5, 56(sp)\n\t"
                   "sw t6, 60(sp)\n\t"
                   "mv a0, sp\n\t"
                   "call %1\n\t"
                   "lw ra, 0(sp)\n\t"
                   "lw t0, 4(sp)\n\t"
                   "lw t1, 8(sp)\n\t"
                   "lw t2, 12(sp)\n\t"
                   "lw a0, 16(sp)\n\t"
                   "lw a1, 20(sp)\n\t"
                   "lw a2, 24(sp)\n\t"
                   "lw a3, 28(sp)\n\t"
                   "lw a4, 32(sp)\n\t"
                   "lw a5, 36(sp)\n\t"
                   "lw a6, 40(sp)\n\t"
                   "lw a7, 44(sp)\n\t"
                   "lw t3, 48(sp)\n\t"
                   "lw t4, 52(sp)\n\t"
                   "lw t5, 56(sp)\n\t"
                   "lw t6, 60(sp)\n\t"
                   "addi sp, sp, 64\n\t"
                   "mret" ::"i"(record_crash),
                   "i"(take_trap));
}
