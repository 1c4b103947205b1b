/// The record of a crash, for every port whose memory survives a reset.
///
/// A port's trap or exception handler gathers what the processor knows into a struct canopy_crash and hands it over
/// here. The record stands in .noinit, which start-up neither loads nor clears, under a magic word and a check, so that
/// memory's garbage at power-on is no crash. canopy_board_last_crash and canopy_board_forget_crash (port/board.h) are
/// here, too.
#ifndef CANOPY_PORT_COMMON_CRASH_RECORD_H
#define CANOPY_PORT_COMMON_CRASH_RECORD_H

#include "lib/port.h"

/// Keeps `crash` but for its count, which is continued: for a crash that is known only after the reset.
void canopy_crash_keep(const struct canopy_crash *crash);

/// Keeps `crash` like canopy_crash_keep, prints `crash KIND pc X lr X status X address X` on the
/// board's console, all in hexadecimal, and ends as canopy_crash_end does (port/board.h). Needs no interrupt and about
/// 100 bytes of stack.
_Noreturn void canopy_crash_record(const struct canopy_crash *crash);

#endif
