/// Crashes of a Cortex-M: the exceptions that have no handler, faults, and the watchdog's warning where it has one.
///
/// Any of them ends in canopy_crash_entry, which takes a fresh stack, fills the record (lib/port.h, struct
/// canopy_crash), prints `crash N pc X lr X status X address X` on the board's console, and resets. The next start
/// finds the record: canopy_board_last_crash. How it ends is canopy_crash_end's (port/board.h).
#ifndef CANOPY_PORT_CORTEXM_CRASH_H
#define CANOPY_PORT_CORTEXM_CRASH_H

/// What a board's vector table points to for every exception that nobody handles.
void canopy_crash_entry(void);

#endif
