// The station on the board: a profile scanner on I2C 0 (400 kHz), the PLC on UART 0, RTU over RS-485, 115200 8N1.
#include "lib/scan/generic.h"
#include "lib/scan/i2c_link.h"
#include "lib/station/device.h"
#include "lib/version.h"
#include "port/board.h"

#ifndef STATION_GRID_M  // make build/rp2040_pico/canopy-<M>x<N>.elf sets them
#define STATION_GRID_M 20
#define STATION_GRID_N 20
#endif
#define CELLS 4      // field cells a knot interval
#define LINES 1      // lines a knot interval
#define COLUMNS 512  // readings a profile, at most
#define WORDS 1      // registers a height of the generic scanner
#define BAUD 115200
#define OUR_UNIT 1
#define TRANSFER_US 50000    // the longest takes 6 ms, and the scanner may hold the clock for some
#define WATCHDOG_US 2000000  // a cycle takes 20 ms at most, and half a second when it writes the flash

static CANOPY_ARENA_DECLARE(arena, CANOPY_DEVICE_ARENA(STATION_GRID_M, STATION_GRID_N, CELLS, LINES, COLUMNS, WORDS));
static struct canopy_board board;
static struct canopy_device device;
static struct canopy_i2c_link scanner;

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
    board = canopy_board_start((const uint32_t[]){BAUD, BAUD});
    introduce();
    const struct canopy_device_config config = {
        .clock = board.clock,
        .scanner = {.link = canopy_i2c_link(&scanner), .table = &canopy_profile_generic, .columns = COLUMNS},
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
    if (canopy_i2c_link_init(&scanner, &board.i2c, &canopy_profile_generic, TRANSFER_US) != CANOPY_OK ||
        canopy_device_init(&device, &config, arena, sizeof arena) != CANOPY_OK)
        return 1;  // ends in a crash that says where
    (void)canopy_board_start_watchdog(WATCHDOG_US);
    for (;;) {
        const uint32_t seen = canopy_board_activity();
        const uint64_t due_us = canopy_device_step(&device);
        board.watchdog.feed(board.watchdog.context);
        canopy_board_sleep(due_us, seen);
    }
}
