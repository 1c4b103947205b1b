// The station on the board: the scanner on line 0, the PLC on line 1, both RTU 8N1.
#include "boards/common/rtu_scanner.h"

#define SCANNER_LINE 0
#define PLC_LINE 1

static CANOPY_ARENA_DECLARE(arena, CANOPY_PROGRAM_ARENA(CANOPY_PROGRAM_COLUMNS, CANOPY_PROGRAM_WORDS));
static struct canopy_device device;
static struct canopy_rtu_link scanner;

int main(void) {
    struct canopy_settings settings;
    const struct canopy_board board =
        canopy_program_start(&settings, PLC_LINE, &canopy_selftest_fx, arena, sizeof arena);
    struct canopy_device_config config;
    canopy_program_configure(&config, &board, &settings, PLC_LINE);
    if (!canopy_program_rtu_scanner(&config, &scanner, &board, &settings, SCANNER_LINE) ||
        canopy_device_init(&device, &config, arena, sizeof arena) != CANOPY_OK)
        return 1;  // ends in a crash that says where
    canopy_program_run(&board, &settings, &device);
}
