/// The cyclic program for a scene that moves: readings in, certified envelopes of a window over a belt out.
///
/// What station.h is for a scene that stands, with a ring (lib/cover/ring.h) for its field. A reading's position along
/// the belt is its own coordinate, as the scanner or an encoder counts it, modulo 2^32 or a turn of a head. The row of
/// the newest reading and `lag` rows behind it are open. When the belt has moved on, the rows behind close, their lines
/// are fitted, what changed is certified, and the window is published: m coefficients along the belt, with first_row
/// (plc.h), so that a PLC reads only rows that are new.
///
/// What a published envelope means, in every interleaving of readings, steps and reads:
///   - Its certificate covers exactly the readings accepted so far in its rows, first_row + 1 to first_row + m - 2,
///     but for rows that were forgotten by age; it is `points` of them. The place of a forgotten row is not covered.
///   - A later reading in one of these rows (a late one: other scanners, a belt that runs back) that raises its cell,
///     or falls into a row that has risen since the publication, is compared with the published surface in the call
///     that accepts it. If it is not surely on the safe side, status bit 0 is clear and the intrusion bit set before
///     that call returns, until a publication covers it. A reading so far beyond the frame that no envelope can cover
///     it sets both at once, until its row has left the ring. Of rows ahead of the window nothing is claimed, and
///     readings there are no intrusions.
///   - Rows with a reading older than expire_after_us are forgotten, and the envelope is published again without
///     them: in the same step, or at the end of the refit that is in work.
///   - Stale is an age of more than stale_after_us since the last accepted reading. The last envelope stays readable.
///
/// While a refit is in work the window stands, and the belt may move on as far as there are open rows. When it comes to
/// the end of them the ring moves nevertheless and the refit begins again (`overruns` counts that): a slow processor
/// should have more open rows, and then takes several at once, which costs it less than one by one.
///
/// All calls on one belt come from one thread. Nothing blocks. Coordinates are fixed point: whole device units.
#ifndef CANOPY_STATION_BELT_H
#define CANOPY_STATION_BELT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/arena.h"
#include "lib/cover/ring.h"
#include "lib/plc/plc.h"
#include "lib/scan/profile.h"
#include "lib/station/show.h"
#include "lib/status.h"

struct canopy_belt_config {
    struct canopy_ring_config ring;  ///< `open` at least lag + 1; one or more above that let the belt move in a refit
    uint16_t lag;                    ///< rows behind that of the newest reading that stay open
    uint16_t leap;             ///< a reading more rows than this ahead is a fault, and rejected; 0: any is believed
    uint8_t clients;           ///< of the PLC side
    float unit;                ///< of the scene: point = device units * unit
    uint32_t stale_after_us;   ///< readings older than this make the envelope stale
    uint32_t expire_after_us;  ///< rows with a reading older than this are forgotten; 0: never
};

/// Bytes of arena. `cells` is Q.
#define CANOPY_BELT_ARENA(m, n, cells, lines, open, clients)                                                           \
    (CANOPY_RING_ARENA(m, n, cells, lines, open) + CANOPY_ARENA_ROUND((size_t)(m) + (open)) +                          \
     CANOPY_PLC_ARENA(m, n, clients))

/// All members are the belt's own, but `port`, `scan`, `scan_errors` and `sensor_faults`.
struct canopy_belt {
    struct canopy_belt_config config;
    struct canopy_plc plc;
    struct canopy_ring ring;
    uint8_t *risen;  // one flag a row, by its number modulo m + open: it rose since the publication
    uint64_t start_us, now_us, reading_us;
    int64_t head;        ///< row of the newest reading, while `running`
    int64_t beyond_row;  // the last row with a reading that nothing can cover …
    bool beyond;         // … if there is one
    bool running;        ///< a reading has come since the start or restart
    bool have_reading;
    bool due;      // something is to be fitted
    bool working;  // a refit is in work
    bool intrusion;
    uint16_t heartbeat, coverage_pct;
    uint32_t accepted, rejected, intrusions, fits_failed;
    uint32_t overruns;  ///< refits begun again because the belt was faster

    struct canopy_station_port port;             ///< set by the port, any time
    const struct canopy_profile_counters *scan;  ///< the scanner driver's, or NULL
    uint32_t scan_errors;                        ///< set with it
    uint16_t sensor_faults;                      ///< one bit a sensor: silent, stale or refused
};

/// Makes a belt that waits for a reading, whose row is then its head. `arena`: CANOPY_BELT_ARENA bytes, aligned to 8,
/// the belt's as long as it is used; the belt must not be moved in memory. CANOPY_ARGUMENT, CANOPY_ARENA_SHORT,
/// CANOPY_ARENA_ALIGN.
enum canopy_status canopy_belt_init(struct canopy_belt *belt, const struct canopy_belt_config *config, void *arena,
                                    size_t bytes, uint64_t now_us);

/// Takes one valid reading: device units; the true height is within z +- uncertainty. CANOPY_OK: accepted. Rejected:
/// CANOPY_OUT_OF_FRAME, beside the belt; CANOPY_AHEAD, it leaps; CANOPY_RANGE, too far beyond the frame's heights, and
/// an intrusion; CANOPY_DROPPED, its row has left the ring, and an intrusion if what is published still has the row:
/// nothing can tell any more whether it is beyond.
enum canopy_status canopy_belt_reading(struct canopy_belt *belt, const int32_t point[3], uint32_t uncertainty,
                                       uint64_t now_us);

/// Takes up to `most` columns of the driver's complete profile, as canopy_station_profile does.
bool canopy_belt_profile(struct canopy_belt *belt, struct canopy_profile_driver *driver, uint16_t *column,
                         uint16_t most, uint64_t now_us);

/// One cycle: at most `budget` units of work of the refit (canopy_refit_step).
void canopy_belt_step(struct canopy_belt *belt, uint32_t budget, uint64_t now_us);

/// The registers, for Modbus servers.
struct canopy_modbus_bank canopy_belt_bank(struct canopy_belt *belt);

#endif
