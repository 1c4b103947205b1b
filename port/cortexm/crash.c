#include "port/cortexm/crash.h"

#include <stddef.h>

#include "port/board.h"
#include "port/cortexm/core.h"
#include "port/cortexm/startup.h"

#define MAGIC 0x43414E46u
#define FRAME_BYTES 32u  // r0-r3, r12, lr, pc, psr

static struct {
    uint32_t magic;
    struct canopy_crash crash;
    uint32_t check;  // exclusive or of all before it
} kept __attribute__((section(".noinit")));

static uint32_t checksum(void) {
    const struct canopy_crash *c = &kept.crash;
    return kept.magic ^ c->kind ^ c->pc ^ c->lr ^ c->sp ^ c->status ^ c->address ^ c->count;
}

static bool is_valid(void) { return kept.magic == MAGIC && kept.check == checksum(); }

const struct canopy_crash *canopy_board_last_crash(void) {
    return is_valid() && kept.crash.kind != CANOPY_CRASH_NONE ? &kept.crash : NULL;
}

void canopy_board_forget_crash(void) {
    if (!is_valid())
        kept.crash.count = 0;
    kept.magic = MAGIC;
    kept.crash.kind = CANOPY_CRASH_NONE;
    kept.check = checksum();
}

__attribute__((weak)) _Noreturn void canopy_crash_end(void) { canopy_board_reset(); }

static void put_text(const char *text) {
    while (*text != '\0')
        canopy_board_put(*text++);
}

static void put_number(const char *name, uint32_t value) {
    put_text(name);
    for (int shift = 28; shift >= 0; shift -= 4)
        canopy_board_put("0123456789abcdef"[(value >> shift) & 15u]);
}

// The processor pushed eight words; they may be read only if they are in the stack.
static const uint32_t *pushed_at(uint32_t sp) {
    const uint32_t lowest = (uint32_t)(uintptr_t)canopy_stack_limit, end = (uint32_t)(uintptr_t)canopy_stack_top;
    return sp >= lowest && sp <= end - FRAME_BYTES && sp % 4u == 0 ? (const uint32_t *)(uintptr_t)sp : NULL;
}

// Why, and at which address, where the processor knows: ARMv6-M does not.
static void look_why(struct canopy_crash *crash) {
    crash->status = crash->address = 0;
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
    const uint32_t count = is_valid() ? kept.crash.count : 0;
    const uint32_t *pushed = pushed_at(sp);
    struct canopy_crash *crash = &kept.crash;
    kept.magic = MAGIC;
    crash->kind = kind;
    crash->lr = pushed != NULL ? pushed[5] : 0;
    crash->pc = pushed != NULL ? pushed[6] : 0;
    crash->sp = sp;
    look_why(crash);
    crash->count = count + 1;
    kept.check = checksum();

    put_number("\r\ncrash ", kind);
    put_number(" pc ", crash->pc);
    put_number(" lr ", crash->lr);
    put_number(" status ", crash->status);
    put_number(" address ", crash->address);
    put_text("\r\n");
    canopy_crash_end();
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
