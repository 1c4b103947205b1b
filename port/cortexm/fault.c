#include "port/cortexm/fault.h"

#include <stdbool.h>
#include <stddef.h>

#include "port/cortexm/core.h"
#include "port/cortexm/startup.h"

#define MAGIC 0x43414E46u
#define FRAME_BYTES 32u  // r0-r3, r12, lr, pc, psr

extern uint32_t canopy_stack_limit[];

static struct canopy_fault record __attribute__((section(".noinit")));

static uint32_t checksum(const struct canopy_fault *fault) {
    return fault->magic ^ fault->kind ^ fault->pc ^ fault->lr ^ fault->psr ^ fault->sp ^ fault->cfsr ^ fault->hfsr ^
           fault->address ^ fault->count;
}

static bool is_valid(const struct canopy_fault *fault) {
    return fault->magic == MAGIC && fault->check == checksum(fault);
}

const struct canopy_fault *canopy_fault_last(void) { return is_valid(&record) && record.kind != 0 ? &record : NULL; }

void canopy_fault_forget(void) {
    if (!is_valid(&record))
        record.count = 0;
    record.magic = MAGIC;
    record.kind = 0;
    record.check = checksum(&record);
}

__attribute__((weak)) void canopy_fault_put(char character) { (void)character; }

__attribute__((weak)) _Noreturn void canopy_fault_end(void) { canopy_core_reset(); }

static void put_text(const char *text) {
    while (*text != '\0')
        canopy_fault_put(*text++);
}

static void put_number(const char *name, uint32_t value) {
    put_text(name);
    for (int shift = 28; shift >= 0; shift -= 4)
        canopy_fault_put("0123456789abcdef"[(value >> shift) & 15u]);
}

// The processor pushed eight words; they may be read only if they are in the stack.
static const uint32_t *pushed_at(uint32_t sp) {
    const uint32_t lowest = (uint32_t)(uintptr_t)canopy_stack_limit, end = (uint32_t)(uintptr_t)canopy_stack_top;
    return sp >= lowest && sp <= end - FRAME_BYTES && sp % 4u == 0 ? (const uint32_t *)(uintptr_t)sp : NULL;
}

// Called by the entry below, on a fresh stack, with the exception's stack pointer and number.
__attribute__((used)) static _Noreturn void record_fault(uint32_t sp, uint32_t kind) {
    const uint32_t count = is_valid(&record) ? record.count : 0;
    const uint32_t *pushed = pushed_at(sp);
    record.magic = MAGIC;
    record.kind = kind;
    record.lr = pushed != NULL ? pushed[5] : 0;
    record.pc = pushed != NULL ? pushed[6] : 0;
    record.psr = pushed != NULL ? pushed[7] : 0;
    record.sp = sp;
    record.cfsr = CANOPY_SCB_CFSR;
    record.hfsr = CANOPY_SCB_HFSR;
    record.address = 0;
    if ((record.cfsr & (1u << 15)) != 0)
        record.address = CANOPY_SCB_BFAR;
    else if ((record.cfsr & (1u << 7)) != 0)
        record.address = CANOPY_SCB_MMFAR;
    record.count = count + 1;
    record.check = checksum(&record);

    put_number("\r\nfault ", kind);
    put_number(" pc ", record.pc);
    put_number(" lr ", record.lr);
    put_number(" cfsr ", record.cfsr);
    put_number(" address ", record.address);
    put_text("\r\n");
    canopy_fault_end();
}

// The stack may be what is broken, or full: then start again from its top, which is far from where it is full. Nothing
// returns from here. Elsewhere go on below what the processor pushed.
__attribute__((naked)) void canopy_fault_entry(void) {
    __asm volatile("mov r0, sp\n\t"
                   "mrs r1, ipsr\n\t"
                   "ldr r2, =canopy_stack_limit + 256\n\t"
                   "ldr r3, =canopy_stack_top\n\t"
                   "cmp r0, r2\n\t"
                   "blo 1f\n\t"
                   "cmp r0, r3\n\t"
                   "bls 2f\n"
                   "1:\tmov sp, r3\n"
                   "2:\tb record_fault\n\t"
                   ".ltorg");
}
