// Every function of port/board.h on a platform that has nothing: the file to begin a port with (docs/porting.md). What
// each of them is to do says port/board.h; what stands here says what it must not forget. The crash's record is the
// same everywhere: port/common/crash_record.c has canopy_board_last_crash, canopy_board_forget_crash, canopy_crash_end.
#include "port/board.h"

#include "port/template/clock.h"
#include "port/template/flash.h"
#include "port/template/i2c.h"
#include "port/template/stream.h"
#include "port/template/watchdog.h"

// Start the clock first: the other devices may want it. A line that is real counts in line_count, and real ones come
// first. Interrupts are on when this returns.
struct canopy_board canopy_board_start(const uint32_t baud[CANOPY_BOARD_LINES]) {
    (void)baud;
    return (struct canopy_board){.clock = canopy_no_clock(),
                                 .line = {canopy_no_stream(), canopy_no_stream()},
                                 .line_count = 0,
                                 .i2c = canopy_no_i2c(),
                                 .flash = canopy_no_flash(),
                                 .watchdog = canopy_no_watchdog()};
}

// Called before the start: it may need what start-up has not done yet.
struct canopy_flash canopy_board_flash(void) {
    return canopy_no_flash();
}

// One instruction each, that compilers do not move memory accesses across.
uint32_t canopy_board_mask(void) { return 0; }

void canopy_board_restore(uint32_t before) { (void)before; }

// A bite should leave a record before it resets (port/common/crash_record.h); a chip whose watchdog cannot warn notes
// the crash after the reset, where the chip tells why it was reset.
bool canopy_board_start_watchdog(uint32_t period_us) {
    (void)period_us;
    return false;
}

// One more with each interrupt that may have brought work.
uint32_t canopy_board_activity(void) { return 0; }

// Mask interrupts, look whether any came since `seen`, set the alarm, wait for an interrupt, restore: so that one that
// comes between the look and the wait still ends it. To return at once, as here, is always right and never sleeps.
void canopy_board_sleep(uint64_t due_us, uint32_t seen) {
    (void)due_us;
    (void)seen;
}

// Polls, bounded: a transmitter that is stuck must not hold up the reset behind a crash.
void canopy_board_put(char character) { (void)character; }

// What cannot reset stands still, with interrupts off.
void canopy_board_reset(void) {
    for (;;)
        ;
}

// What counts instructions, or processor clocks on a chip that runs each in one.
uint64_t canopy_board_instructions(void) { return 0; }

// How an emulator is told that the run is over; without one there is nobody to tell.
void canopy_board_exit(bool good) {
    (void)good;
    canopy_board_reset();
}
