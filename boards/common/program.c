#include "boards/common/program.h"

#include "canopy_registers.h"
#include "lib/station/health.h"
#include "lib/version.h"

static void say(const char *text) {
    while (*text != '\0')
        canopy_board_put(*text++);
}

static struct canopy_health health;
static struct canopy_health_kept kept __attribute__((section(".noinit")));
static struct canopy_memory memory;
static struct canopy_flash flash;

// For who looks at the console: that it starts, and whether the run before ended in a crash, of which the handler has
// already said where.
static void introduce(void) {
    const bool crashed =
        health.reset_reason == CANOPY_PLC_RESET_CRASH || health.reset_reason == CANOPY_PLC_RESET_WATCHDOG;
    say("canopy " CANOPY_VERSION);
    say(crashed ? " starts after a crash\r\n" : " starts\r\n");
}

// What all boards' lines are: port/board.h. That there is one more setting than a board has use for does no harm.
static const uint32_t fixed = 1U << CANOPY_SETTING_PLC_FORMAT | 1U << CANOPY_SETTING_SCANNER_FORMAT;

struct canopy_board canopy_program_start(struct canopy_settings *settings, uint8_t plc_line,
                                         const struct canopy_selftest_known *known, void *arena, size_t bytes) {
    memory = canopy_board_memory();
    flash = canopy_board_flash();
    const struct canopy_health_config config = {.memory = &memory,
                                                .flash = &flash,
                                                .kept = &kept,
                                                .defaults = canopy_settings_defaults,
                                                .fixed = fixed,
                                                .reset = canopy_board_reset};
    canopy_health_open(&health, &config, settings, arena);
    uint32_t baud[CANOPY_BOARD_LINES] = {settings->scanner_baud, settings->scanner_baud};
    baud[plc_line] = settings->plc_baud;
    const struct canopy_board board = canopy_board_start(baud);
    canopy_health_test(&health, canopy_board_last_crash(), known, arena, bytes);
    introduce();
    return board;
}

void canopy_program_run(const struct canopy_board *board, const struct canopy_settings *settings,
                        struct canopy_device *device) {
    canopy_device_keep(device, &health);
    // A cycle takes 20 ms at most; an emulator's busy host, or flash that is written, may hold one up.
    if (!canopy_board_start_watchdog(settings->watchdog_ms * 1000U))
        say("no watchdog\r\n");
    for (;;) {
        const uint32_t seen = canopy_board_activity();
        const uint64_t due_us = canopy_device_step(device);
        board->watchdog.feed(board->watchdog.context);
        canopy_board_sleep(due_us, seen);
    }
}
