// The station on the board: a built-in sweep is the scanner, the PLC is on the one UART, RTU 115200 8N1.
#include "boards/riscv_virt/sweep.h"
#include "lib/station/device.h"
#include "lib/version.h"
#include "port/board.h"

#ifndef STATION_GRID_M  // make build/riscv_virt/canopy-<M>x<N>.elf sets them
#define STATION_GRID_M 20
#define STATION_GRID_N 20
#endif
#define CELLS 4  // field cells a knot interval
#define LINES 1  // lines a knot interval
#define WORDS 1  // registers a height of the generic scanner
#define BAUD 115200
#define OUR_UNIT 1
#define WATCHDOG_US 2000000  // a cycle takes 10 ms at most; an emulator's busy host may hold one up

static CANOPY_ARENA_DECLARE(arena, CANOPY_DEVICE_ARENA(STATION_GRID_M, STATION_GRID_N, CELLS, LINES,
                                                       CANOPY_SWEEP_COLUMNS, WORDS));
static struct canopy_device device;
static struct canopy_sweep sweep;

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

int main(void) {
    const struct canopy_board board = canopy_board_start((const uint32_t[]){BAUD, BAUD});
    introduce();
    canopy_sweep_init(&sweep);
    const struct canopy_device_config config = {
        .clock = board.clock,
        .scanner = {.link = canopy_sweep_link(&sweep),
                    .table = &canopy_profile_generic,
                    .columns = CANOPY_SWEEP_COLUMNS,
                    .unit = 1},
        .plc = {.stream = board.line[0], .baud = BAUD, .character_bits = 10, .unit = OUR_UNIT},
        .station = {.grid = {.size = {STATION_GRID_M, STATION_GRID_N}, .cells = CELLS, .side = CANOPY_ABOVE},
                    .fit = &canopy_line_fit_fx,
                    .lines = LINES,
                    .clients = 1,
                    .unit = 1.0F,
                    .stale_after_us = 5000000,
                    .interval_us = 1000000,
                    .refresh_us = 500000},
        .readings = 32,
        .budget = 1,
    };
    if (canopy_device_init(&device, &config, arena, sizeof arena) != CANOPY_OK)
        return 1;  // ends in a crash that says where
    (void)canopy_board_start_watchdog(WATCHDOG_US);
    for (;;) {
        const uint32_t seen = canopy_board_activity();
        const uint64_t due_us = canopy_device_step(&device);
        board.watchdog.feed(board.watchdog.context);
        canopy_board_sleep(due_us, seen);
    }
}
