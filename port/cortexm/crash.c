#include "port/cortexm/crash.h"

#include <stddef.h>

#include "port/common/crash_record.h"
#include "port/cortexm/core.h"
#include "port/cortexm/startup.h"

#define FRAME_BYTES 32u  // r0-r3, r12, lr, pc, psr

// The processor pushed eight words; they may be read only if they are in the stack.
static const uint32_t *pushed_at(uint32_t sp) {
    const uint32_t lowest = (uint32_t)(uintptr_t)canopy_stack_limit, end = (uint32_t)(uintptr_t)canopy_stack_top;
    return sp >= lowest && sp <= end - FRAME_BYTES && sp % 4u == 0 ? (const uint32_t *)(uintptr_t)sp : NULL;
}

// Why, and at which address, where the processor knows: ARMv6-M does not.
static void look_why(struct canopy_crash *crash) {
    (void)crash;
#if __ARM_ARCH > 6
    crash->status = CANOPY_SCB_CFSR;
    if ((crash->status & (1u << 15)) != 0)
        crash->address = CANOPY_SCB_BFAR;
    else if ((crash->status & (1u << 7)) != 0)
        crash->address = CANOPY_SCB_MMFAR;
#endif
}

// Called by the entry below, on a fresh stack, with the exception's stack pointer and number.
__attribute__((used)) static _Noreturn void record_crash(uint32_t sp, uint32_t kind) {
    const uint32_t *pushed = pushed_at(sp);
    struct canopy_crash crash = {.kind = kind, .sp = sp};
    if (pushed != NULL) {
        crash.lr = pushed[5];
        crash.pc = pushed[6];
    }
    look_why(&crash);
    canopy_crash_record(&crash);
}

// The stack may be what is broken, or full: then start again from its top, which is far from where it is full. Nothing
// returns from here. Elsewhere go on below what the processor pushed. Instructions that ARMv6-M has, too.
__attribute__((naked)) void canopy_crash_entry(void) {
    __asm volatile("mov r0, sp\n\t"
                   "mrs r1, ipsr\n\t"
                   "ldr r2, =canopy_stack_limit + 256\n\t"
                   "ldr r3, =canopy_stack_top\n\t"
                   "cmp r0, r2\n\t"
                   "blo 1f\n\t"
                   "cmp r0, r3\n\t"
                   "bls 2f\n"
                   "1:\tmov sp, r3\n"
                   "2:\tldr r2, =%c0\n\t"
                   "bx r2\n\t"
                   ".ltorg" ::"i"(record_crash));
}
