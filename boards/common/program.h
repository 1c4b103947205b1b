/// The program that is the station on every board: what is the same in all of their main.c.
///
/// A main has what is not the same: how many columns, which link reaches the scanner, which line the PLC is on, and it
/// owns every buffer:
///
///     static CANOPY_ARENA_DECLARE(arena, CANOPY_PROGRAM_ARENA(COLUMNS, WORDS));
///     static struct canopy_device device;
///     static struct canopy_i2c_link scanner;
///
///     int main(void) {
///         struct canopy_settings settings;
///         const struct canopy_board board = canopy_program_start(&settings, PLC_LINE, &canopy_selftest_fx, arena,
///                                                                 sizeof arena);
///         struct canopy_device_config config;
///         canopy_program_configure(&config, &board, &settings, PLC_LINE);
///         config.scanner = …;
///         if (… the link … || canopy_device_init(&device, &config, arena, sizeof arena) != CANOPY_OK)
///             return 1;  // ends in a crash that says where
///         canopy_program_run(&board, &settings, &device);
///     }
#ifndef CANOPY_BOARDS_COMMON_PROGRAM_H
#define CANOPY_BOARDS_COMMON_PROGRAM_H

#include <stdint.h>

#include "lib/plc/settings.h"
#include "lib/station/device.h"
#include "port/board.h"

#ifndef STATION_GRID_M  // make build/<board>/canopy-<M>x<N>.elf sets them
#define STATION_GRID_M 20
#define STATION_GRID_N 20
#endif
#ifndef STATION_CELLS  // … and canopy-<M>x<N>x<Q>.elf this
#define STATION_CELLS 4
#endif
#define CANOPY_PROGRAM_CELLS STATION_CELLS  ///< Q, field cells a knot interval
#define CANOPY_PROGRAM_LINES 1              ///< lines a knot interval
#define CANOPY_PROGRAM_BITS 10U             ///< of a character: 8N1, as port/board.h says
#define CANOPY_PROGRAM_COLUMNS 512          ///< readings a profile of a scanner, at most
#define CANOPY_PROGRAM_WORDS 1              ///< registers a height of the generic scanner

/// Bytes of the device's arena: profiles of up to `columns` readings of `words` registers.
#define CANOPY_PROGRAM_ARENA(columns, words)                                                                           \
    CANOPY_DEVICE_ARENA(STATION_GRID_M, STATION_GRID_N, CANOPY_PROGRAM_CELLS, CANOPY_PROGRAM_LINES, columns, words)

/// Reads the settings that are stored, starts the board with them, tests it (lib/station/health.h), says so on its
/// console, and tells the settings that are in force. Of the two lines the PLC is on `plc_line`; if the scanner is on a
/// line it is on the other. `known`: by the arithmetic of the station's fit. `arena`: the device's, not used yet.
struct canopy_board canopy_program_start(struct canopy_settings *settings, uint8_t plc_line,
                                         const struct canopy_selftest_known *known, void *arena, size_t bytes);

/// What a device in fixed point is configured with on all boards; the scanner is left to the main.
static inline void canopy_program_configure(struct canopy_device_config *to, const struct canopy_board *board,
                                            const struct canopy_settings *settings, uint8_t plc_line) {
    *to = (struct canopy_device_config){
        .clock = board->clock,
        .plc = {.stream = board->line[plc_line],
                .baud = settings->plc_baud,
                .character_bits = CANOPY_PROGRAM_BITS,
                .unit = (uint8_t)settings->plc_unit},
        .station = {.grid = {.size = {STATION_GRID_M, STATION_GRID_N},
                             .cells = CANOPY_PROGRAM_CELLS,
                             .side = settings->side == 0 ? CANOPY_ABOVE : CANOPY_BELOW},
                    .fit = &canopy_line_fit_fx,
                    .lines = CANOPY_PROGRAM_LINES,
                    .clients = 1,
                    .unit = 1.0F,
                    .stale_after_us = settings->stale_after_ms * 1000U,
                    .interval_us = settings->interval_ms * 1000U,
                    .refresh_us = settings->refresh_ms * 1000U},
        .readings = 32,
        .budget = 1,
    };
}

/// Starts the watchdog and runs the device for ever.
_Noreturn void canopy_program_run(const struct canopy_board *board, const struct canopy_settings *settings,
                                  struct canopy_device *device);

#endif
