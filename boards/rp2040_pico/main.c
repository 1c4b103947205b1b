// The station on the board: a profile scanner on I2C 0 (400 kHz), the PLC on UART 0, RTU over RS-485, 115200 8N1.
#include "boards/common/program.h"
#include "lib/scan/generic.h"
#include "lib/scan/i2c_link.h"

#define PLC_LINE 0
#define TRANSFER_US 50000  // the longest takes 6 ms, and the scanner may hold the clock for some

static CANOPY_ARENA_DECLARE(arena, CANOPY_PROGRAM_ARENA(CANOPY_PROGRAM_COLUMNS, CANOPY_PROGRAM_WORDS));
static struct canopy_device device;
static struct canopy_i2c_link scanner;

int main(void) {
    struct canopy_settings settings;
    const struct canopy_board board =
        canopy_program_start(&settings, PLC_LINE, &canopy_selftest_fx, arena, sizeof arena);
    struct canopy_device_config config;
    canopy_program_configure(&config, &board, &settings, PLC_LINE);
    config.scanner = (struct canopy_device_scanner){.link = canopy_i2c_link(&scanner),
                                                    .table = &canopy_profile_generic,
                                                    .columns = CANOPY_PROGRAM_COLUMNS,
                                                    .unit = (uint8_t)settings.scanner_i2c};
    if (canopy_i2c_link_init(&scanner, &board.i2c, &canopy_profile_generic, TRANSFER_US) != CANOPY_OK ||
        canopy_device_init(&device, &config, arena, sizeof arena) != CANOPY_OK)
        return 1;  // ends in a crash that says where
    canopy_program_run(&board, &settings, &device);
}
