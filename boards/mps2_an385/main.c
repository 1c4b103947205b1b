// The station on the board: the scanner on UART 0, the PLC on UART 1, both RTU 115200 8N1.
#include "boards/common/program.h"
#include "lib/scan/generic.h"
#include "lib/station/rtu_link.h"
#include "lib/station/turning.h"

#define SCANNER_LINE 0
#define PLC_LINE 1
#define COLUMNS 512  // readings a profile, at most
#define WORDS 1      // registers a height of the generic scanner

static CANOPY_ARENA_DECLARE(arena, CANOPY_PROGRAM_ARENA(COLUMNS, WORDS));
static struct canopy_device device;
static struct canopy_rtu_link scanner;
static struct canopy_station_turned turned;

int main(void) {
    struct canopy_settings settings;
    const struct canopy_board board = canopy_program_start(&settings, PLC_LINE, arena, sizeof arena);
    const struct canopy_rtu_link_config line = {.clock = board.clock,
                                                .stream = board.line[SCANNER_LINE],
                                                .baud = settings.scanner_baud,
                                                .character_bits = CANOPY_PROGRAM_BITS,
                                                .timeout_us = settings.scanner_timeout_ms * 1000U};
    struct canopy_device_config config;
    canopy_program_configure(&config, &board, &settings, PLC_LINE);
    config.scanner = (struct canopy_device_scanner){.link = canopy_rtu_link(&scanner),
                                                    .table = &canopy_profile_generic,
                                                    .columns = COLUMNS,
                                                    .unit = (uint8_t)settings.scanner_unit};
    config.station.turning = &turned.part;
    canopy_station_turned_init(&turned);
    if (canopy_rtu_link_init(&scanner, &line) != CANOPY_OK ||
        canopy_device_init(&device, &config, arena, sizeof arena) != CANOPY_OK)
        return 1;  // ends in a crash that says where
    canopy_program_run(&board, &settings, &device);
}
