// The station on the board: a built-in sweep is the scanner, the PLC is on the one UART, RTU 115200 8N1.
#include "boards/common/program.h"
#include "boards/riscv_virt/sweep.h"

#define PLC_LINE 0

static CANOPY_ARENA_DECLARE(arena, CANOPY_PROGRAM_ARENA(CANOPY_SWEEP_COLUMNS, CANOPY_PROGRAM_WORDS));
static struct canopy_device device;
static struct canopy_sweep sweep;

int main(void) {
    struct canopy_settings settings;
    const struct canopy_board board =
        canopy_program_start(&settings, PLC_LINE, &canopy_selftest_fx, arena, sizeof arena);
    struct canopy_device_config config;
    canopy_program_configure(&config, &board, &settings, PLC_LINE);
    config.scanner = (struct canopy_device_scanner){.link = canopy_sweep_link(&sweep),
                                                    .table = &canopy_profile_generic,
                                                    .columns = CANOPY_SWEEP_COLUMNS,
                                                    .unit = (uint8_t)settings.scanner_unit};
    canopy_sweep_init(&sweep);
    if (canopy_device_init(&device, &config, arena, sizeof arena) != CANOPY_OK)
        return 1;  // ends in a crash that says where
    canopy_program_run(&board, &settings, &device);
}
