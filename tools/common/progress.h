/// How far a long run is, for a person at a terminal: one line on standard error that is written over, and erased at
/// the end. Nothing is ever written where standard error is no terminal, nor in the first second, nor more often than
/// five times a second. One run at a time, from one thread.
#ifndef CANOPY_TOOLS_COMMON_PROGRESS_H
#define CANOPY_TOOLS_COMMON_PROGRESS_H

#include <stdint.h>

/// Says which `stage` the run is in and how much of it is done, 0 to 1 (less than 0: not known); `points`, if not 0,
/// is how many have been read in it. Cheap enough to be called every millisecond.
void canopy_progress(const char *stage, double part, uint64_t points);

/// Erases the line. Before anything else is printed.
void canopy_progress_end(void);

#endif
