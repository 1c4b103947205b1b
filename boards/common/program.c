#include "boards/common/program.h"

#include "lib/version.h"

static void say(const char *text) {
    while (*text != '\0')
        canopy_board_put(*text++);
}

// For who looks at the console: that it starts, and whether the run before ended in a crash, of which the handler has
// already said where.
static void introduce(void) {
    say("canopy " CANOPY_VERSION);
    say(canopy_board_last_crash() != NULL ? " starts after a crash\r\n" : " starts\r\n");
    canopy_board_forget_crash();
}

struct canopy_board canopy_program_start(struct canopy_settings *settings, uint8_t plc_line) {
    canopy_settings_defaults(settings);
    uint32_t baud[CANOPY_BOARD_LINES] = {settings->scanner_baud, settings->scanner_baud};
    baud[plc_line] = settings->plc_baud;
    const struct canopy_board board = canopy_board_start(baud);
    introduce();
    return board;
}

void canopy_program_run(const struct canopy_board *board, const struct canopy_settings *settings,
                        struct canopy_device *device) {
    // A cycle takes 20 ms at most; an emulator's busy host, or flash that is written, may hold one up.
    (void)canopy_board_start_watchdog(settings->watchdog_ms * 1000U);
    for (;;) {
        const uint32_t seen = canopy_board_activity();
        const uint64_t due_us = canopy_device_step(device);
        board->watchdog.feed(board->watchdog.context);
        canopy_board_sleep(due_us, seen);
    }
}
