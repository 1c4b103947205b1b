/// canopyd's one loop: PLCs are served, readings taken and the station stepped in turns of bounded length.
///
/// A turn takes readings for at most 0.3 ms and fits for at most 0.5 ms before it looks at the PLCs again. What may
/// block (the scanner) is in a thread of its own, behind a ring; standard error is never waited for.
#ifndef CANOPY_BOARDS_LINUX_DAEMON_H
#define CANOPY_BOARDS_LINUX_DAEMON_H

#include <stdbool.h>
#include <stdint.h>

#include "boards/linux/keep.h"
#include "boards/linux/options.h"
#include "boards/linux/source.h"
#include "lib/station/station.h"
#include "lib/station/tightening.h"
#include "lib/station/turning.h"
#include "port/linux/rtu_server.h"
#include "port/linux/scanner.h"
#include "port/linux/tcp_server.h"
#include "tools/common/fault.h"

/// All members are the daemon's own. Large; must not move.
struct canopyd {
    struct canopyd_source source;
    struct canopy_linux_scanner scanner;
    struct canopy_linux_scanner_status scan;
    struct canopy_station station;
    struct canopy_modbus_bank bank;
    struct canopyd_keep keep;
    void *arena;
    struct canopy_station_turned turned;
    struct canopy_station_tightening tightening;  // where it is wanted
    void *tightening_arena;
    struct canopy_linux_tcp_server tcp[CANOPYD_MODBUS_MAX];
    struct canopy_linux_rtu_server rtu[CANOPYD_MODBUS_MAX];
    unsigned tcp_count, rtu_count;
    int signals;
    double told_unit;    // what the user says of the unit, 0: nothing
    bool framed;         // the frame is fixed
    bool deaf;           // readings are refused: another unit, or a scene without a frame
    uint16_t status;     // as it was logged last …
    uint64_t status_us;  // … at that time
    uint64_t turn_us;    // when this turn began
    uint32_t cycle_max_us;
};

/// How a run ended.
enum canopyd_end { CANOPYD_SIGNALLED, CANOPYD_RESTART, CANOPYD_FAILED };

/// Opens everything and starts the scanner's thread, with the settings that are stored in the place of options. False:
/// `fault` says what is wrong and where; then, too, close it.
/// SIGINT and SIGTERM are blocked from here on, and end canopyd_run().
bool canopyd_open(struct canopyd *daemon, struct canopyd_options *options, struct canopy_fault *fault);

/// Serves until a signal comes, a PLC asks for a restart, or the system refuses to go on; the log says which.
enum canopyd_end canopyd_run(struct canopyd *daemon);

/// Closes everything. A scanner that hangs in a read for over a second is left to the end of the process: false.
bool canopyd_close(struct canopyd *daemon);

#endif
