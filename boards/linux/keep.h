/// What canopyd keeps: settings that PLCs change and store (--settings FILE), and its health.
///
/// The options are the settings' defaults. What is stored takes their place at the next start; what the options do not
/// have (no RTU line: no baud rate) is fixed.
#ifndef CANOPY_BOARDS_LINUX_KEEP_H
#define CANOPY_BOARDS_LINUX_KEEP_H

#include <stdbool.h>
#include <stdint.h>

#include "boards/linux/options.h"
#include "lib/station/health.h"
#include "lib/station/station.h"
#include "port/linux/flash_file.h"
#include "tools/common/fault.h"

/// All members are its own.
struct canopyd_keep {
    struct canopy_health health;
    struct canopy_health_kept kept;
    struct canopy_flash flash;
    struct canopy_linux_flash_file file;
    uint32_t commands;    // that have been run
    uint64_t command_us;  // when that grew
};

/// Opens the file, if the options name one, and puts what is stored in it in force. False: `fault` says what is wrong.
/// One in a process. Close it either way.
bool canopyd_keep_open(struct canopyd_keep *keep, struct canopyd_options *options, struct canopy_fault *fault);

/// Puts it behind a station's registers.
void canopyd_keep_attach(struct canopyd_keep *keep, struct canopy_station *station);

/// Stores what is to be stored, a little after the command. False: a PLC has asked for a restart, and it is time.
bool canopyd_keep_step(struct canopyd_keep *keep, uint64_t now_us);

void canopyd_keep_close(struct canopyd_keep *keep);

#endif
