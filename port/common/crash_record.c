#include "port/common/crash_record.h"

#include "port/board.h"

#define MAGIC 0x43414E46u

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

void canopy_crash_keep(const struct canopy_crash *crash) {
    const uint32_t count = is_valid() ? kept.crash.count : 0;
    kept.magic = MAGIC;
    kept.crash = *crash;
    kept.crash.count = count + 1;
    kept.check = checksum();
}

_Noreturn void canopy_crash_record(const struct canopy_crash *crash) {
    canopy_crash_keep(crash);
    put_number("\r\ncrash ", crash->kind);
    put_number(" pc ", crash->pc);
    put_number(" lr ", crash->lr);
    put_number(" status ", crash->status);
    put_number(" address ", crash->address);
    put_text("\r\n");
    canopy_crash_end();
}
