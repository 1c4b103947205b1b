#include "port/riscv/clint.h"

#include "port/riscv/mmio.h"

// Of hart 0
#define MTIMECMP_LOW 0x4000u
#define MTIMECMP_HIGH 0x4004u
#define MTIME_LOW 0xBFF8u
#define MTIME_HIGH 0xBFFCu

#define NEVER UINT64_MAX

// Two halves, and the low one may turn over between their reads: then the high one has changed.
uint64_t canopy_clint_ticks(const struct canopy_clint *clint) {
    uint32_t high, low, again;
    do {
        high = canopy_mmio_read32(clint->base + MTIME_HIGH);
        low = canopy_mmio_read32(clint->base + MTIME_LOW);
        again = canopy_mmio_read32(clint->base + MTIME_HIGH);
    } while (high != again);
    return (uint64_t)high << 32 | low;
}

// In digits of 16 bits, by the processor's own division: the compiler's of 64 bits takes ten times as long.
static uint64_t divided(uint64_t number, uint32_t divisor) {
    const uint32_t high = (uint32_t)(number >> 32), low = (uint32_t)number;
    const uint32_t upper = (high % divisor) << 16 | low >> 16;
    const uint32_t lower = (upper % divisor) << 16 | (low & 0xFFFFu);
    return (uint64_t)(high / divisor) << 32 | (uint64_t)(upper / divisor) << 16 | lower / divisor;
}

uint64_t canopy_clint_now_us(const struct canopy_clint *clint) {
    return divided(canopy_clint_ticks(clint), clint->ticks_per_us);
}

static uint64_t now_us(void *context) { return canopy_clint_now_us(context); }

struct canopy_clock canopy_clint_clock(struct canopy_clint *clint) {
    return (struct canopy_clock){.context = clint, .now_us = now_us};
}

// Never sooner than either half's old value says: first a low half that is never reached (Privileged Architecture,
// 3.2.1).
static void interrupt_at_next(const struct canopy_clint *clint) {
    const uint64_t next = clint->alarm < clint->watch ? clint->alarm : clint->watch;
    canopy_mmio_write32(clint->base + MTIMECMP_LOW, UINT32_MAX);
    canopy_mmio_write32(clint->base + MTIMECMP_HIGH, (uint32_t)(next >> 32));
    canopy_mmio_write32(clint->base + MTIMECMP_LOW, (uint32_t)next);
}

void canopy_clint_start(struct canopy_clint *clint, uintptr_t base, uint32_t hz) {
    *clint = (struct canopy_clint){.base = base, .ticks_per_us = hz / 1000000u, .alarm = NEVER, .watch = NEVER};
    interrupt_at_next(clint);
}

void canopy_clint_alarm(struct canopy_clint *clint, uint64_t due_us) {
    clint->alarm = due_us * clint->ticks_per_us;
    interrupt_at_next(clint);
}

bool canopy_clint_start_watchdog(struct canopy_clint *clint, uint32_t period_us) {
    const uint64_t ticks = (uint64_t)period_us * clint->ticks_per_us;
    if (ticks == 0 || ticks >> 31 != 0)
        return false;
    const uint64_t now = canopy_clint_ticks(clint);
    clint->watch_ticks = (uint32_t)ticks;
    clint->fed = (uint32_t)now;
    clint->watch = now + ticks;
    interrupt_at_next(clint);
    return true;
}

static void feed(void *context) {
    struct canopy_clint *clint = context;
    clint->fed = (uint32_t)canopy_clint_ticks(clint);
}

struct canopy_watchdog canopy_clint_watchdog(struct canopy_clint *clint) {
    return (struct canopy_watchdog){.context = clint, .feed = feed};
}

enum canopy_clint_event canopy_clint_on_timer(struct canopy_clint *clint) {
    const uint64_t now = canopy_clint_ticks(clint);
    if (now >= clint->alarm)
        clint->alarm = NEVER;
    if (now >= clint->watch) {
        const uint32_t since = (uint32_t)now - clint->fed;
        if (since >= clint->watch_ticks)
            return CANOPY_CLINT_HANG;
        clint->watch = now + (clint->watch_ticks - since);
    }
    interrupt_at_next(clint);
    return CANOPY_CLINT_TIME;
}
