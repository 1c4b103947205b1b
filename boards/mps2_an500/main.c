// The station on the board, in float: the scanner on UART 0, the PLC on UART 1, both RTU 115200 8N1. What it has
// published it makes tighter when there is nothing else to do.
#include "boards/common/rtu_scanner.h"
#include "lib/station/tightening.h"
#include "lib/station/turning.h"

#define SCANNER_LINE 0
#define PLC_LINE 1
#define ROWS CANOPY_TIGHTEN_ROWS_FEW(STATION_GRID_M, STATION_GRID_N)

static CANOPY_ARENA_DECLARE(arena, CANOPY_PROGRAM_ARENA(CANOPY_PROGRAM_COLUMNS, CANOPY_PROGRAM_WORDS));
static CANOPY_ARENA_DECLARE(spare_arena, CANOPY_STATION_TIGHTENING_ARENA(STATION_GRID_M, STATION_GRID_N,
                                                                         CANOPY_PROGRAM_CELLS, ROWS));
static struct canopy_device device;
static struct canopy_rtu_link scanner;
static struct canopy_station_turned turned;
static struct canopy_station_tightening tightening;

int main(void) {
    struct canopy_settings settings;
    const struct canopy_board board =
        canopy_program_start(&settings, PLC_LINE, &canopy_selftest_f32, arena, sizeof arena);
    struct canopy_device_config config;
    canopy_program_configure(&config, &board, &settings, PLC_LINE);
    config.station.fit = &canopy_line_fit_f32;
    config.station.turning = &turned.part;
    canopy_station_turned_init(&turned);
    if (!canopy_program_rtu_scanner(&config, &scanner, &board, &settings, SCANNER_LINE) ||
        canopy_device_init(&device, &config, arena, sizeof arena) != CANOPY_OK ||
        canopy_station_tightening_init(&tightening, &config.station.grid, ROWS, spare_arena, sizeof spare_arena) !=
            CANOPY_OK)
        return 1;  // ends in a crash that says where
    device.station.spare = &tightening.spare;
    canopy_program_run(&board, &settings, &device);
}
