/// What every board with firmware gives its programs, so that the same main, tests and measurements run on all of them.
///
/// One board is linked into an image: these are functions, not callbacks. What a board has not (a second line, I2C,
/// flash) is there all the same and says "unsupported" (lib/port.h). A board's data are in its board.h, its parts in
/// the ports that its board.mk names.
#ifndef CANOPY_PORT_BOARD_H
#define CANOPY_PORT_BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/port.h"

#define CANOPY_BOARD_LINES 2

struct canopy_board {
    struct canopy_clock clock;
    struct canopy_stream line[CANOPY_BOARD_LINES];  ///< serial lines, 8N1; `line_count` of them are real
    uint8_t line_count;
    struct canopy_i2c i2c;
    struct canopy_flash flash;
    struct canopy_watchdog watchdog;  ///< not started: feeding it is harmless before canopy_board_start_watchdog
};

/// Starts clocks and devices, the lines at these speeds. Call it once, first.
struct canopy_board canopy_board_start(const uint32_t baud[CANOPY_BOARD_LINES]);

/// The flash of struct canopy_board, also before the start: settings that are stored there say how to start.
struct canopy_flash canopy_board_flash(void);

/// Masks all interrupts and tells whether they were masked before; give that to canopy_board_restore.
uint32_t canopy_board_mask(void);
void canopy_board_restore(uint32_t before);

/// The program's own memory: from the linker, for images that linker/sections.ld lays out (port/common/memory.c).
struct canopy_memory canopy_board_memory(void);

/// From now on the board resets unless the watchdog is fed once in `period_us`. False: it has none, or no such period.
bool canopy_board_start_watchdog(uint32_t period_us);

/// What interrupts have happened: changes with each one that may have brought work.
uint32_t canopy_board_activity(void);

/// Sleeps until the clock reaches `due_us`, for a tenth of a second at most, unless an interrupt has brought work since
/// `seen` was read from canopy_board_activity() or brings it. So T3.5 is met to the microsecond.
void canopy_board_sleep(uint64_t due_us, uint32_t seen);

/// Prints one character on the board's console by polling, also with interrupts off and before the start: for last
/// words and for tests. Dropped where there is no console.
void canopy_board_put(char character);

/// The crash that ended the run before this one, or NULL. It stays until canopy_board_forget_crash.
const struct canopy_crash *canopy_board_last_crash(void);
void canopy_board_forget_crash(void);

/// Resets the whole chip as the watchdog does.
_Noreturn void canopy_board_reset(void);

/// How a crash ends, once it is recorded and told. The board's own (weak) resets; tests end the emulator instead.
_Noreturn void canopy_crash_end(void);

/// For what only an emulator runs: instructions since the start, repeatably (hosttest/firmware/), and the end of the
/// run. On hardware the first is a time in other units and the second a crash.
uint64_t canopy_board_instructions(void);
_Noreturn void canopy_board_exit(bool good);

#endif
