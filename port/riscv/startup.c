#include "port/riscv/startup.h"

#include "port/board.h"
#include "port/riscv/core.h"
#include "port/riscv/trap.h"

extern uint32_t canopy_data_load[], canopy_data_start[], canopy_data_end[], canopy_bss_start[], canopy_bss_end[];

int main(void);

// Called with a stack and gp, and with interrupts off.
__attribute__((used)) static _Noreturn void start(void) {
    const uint32_t *from = canopy_data_load;
    for (uint32_t *to = canopy_data_start; to != canopy_data_end; to++)
        *to = *from++;
    for (uint32_t *to = canopy_bss_start; to != canopy_bss_end; to++)
        *to = 0;
    CANOPY_CSR_SET(mstatus, CANOPY_MSTATUS_MIE);
    (void)main();
    __asm volatile("unimp");
    for (;;)
        ;
}

// Below the stack, 64 KB that nothing uses are forbidden: entry 0 of the physical memory protection (3.7), naturally
// aligned, without any right, and locked, so that it binds machine mode, too. A core without the protection traps at
// its registers: the trap goes to where it is over. A locked entry stands until the reset of the hart; an emulator that
// keeps it through a reset finds the same again.
__attribute__((naked, section(".vectors"))) void canopy_reset(void) {
    __asm volatile("csrw mie, zero\n\t"
                   "csrci mstatus, 8\n\t"
                   ".option push\n\t"
                   ".option norelax\n\t"  // gp is what relaxed addresses are relative to
                   "la gp, __global_pointer$\n\t"
                   ".option pop\n\t"
                   "csrr t0, mhartid\n\t"
                   "bnez t0, 3f\n\t"
                   "la sp, canopy_stack_top\n\t"
                   "la t0, 1f\n\t"
                   "csrw mtvec, t0\n\t"
                   "la t0, canopy_stack_limit - 65536\n\t"
                   "srli t0, t0, 2\n\t"
                   "li t1, 65536 / 8 - 1\n\t"
                   "or t0, t0, t1\n\t"
                   "csrw pmpaddr0, t0\n\t"
                   "li t0, 0x98\n\t"  // locked, naturally aligned power of two, neither read nor write nor execute
                   "csrw pmpcfg0, t0\n\t"
                   ".balign 4\n"
                   "1:\tla t0, %0\n\t"
                   "csrw mtvec, t0\n\t"
                   "tail %1\n"
                   "3:\twfi\n\t"
                   "j 3b" ::"i"(canopy_trap_entry),
                   "i"(start));
}

uint32_t canopy_board_mask(void) { return canopy_core_mask(); }

void canopy_board_restore(uint32_t before) { canopy_core_restore(before); }
