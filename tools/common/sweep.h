/// A line scanner that sweeps a point file, without wires: points become profiles, profiles become registers.
///
/// The registers are the generic profile map (lib/scan/generic.h). Who serves them is not decided here: canopy-scanner
/// puts a Modbus server in front, canopyd reads them by a function call. Each read is judged afterwards: the caller
/// says whether the master was really offered what was read (canopy_sweep_offered), so that the sweep knows which
/// profiles, and so which readings, were served.
///
/// What the scanner sees: the scene is cut into profiles (lines of one y) and columns (cells of x); a column's reading
/// is its highest point, seen from +z, at the column's own x and y; a column without point has no reading. Points on a
/// regular lattice that fits keep their own columns and profiles, and then the readings are the points. Everything is
/// in whole device units: coordinate = rint(p / unit).
///
/// When the next profile comes. On demand (rate 0): when a master looks at the sequence number after all registers of
/// the current profile were offered to it; nothing is missed and nothing is lost. At a rate: by the clock, as a real
/// scanner does, from the first look on; who is slow misses profiles.
///
/// Everything is reproducible: noise and dropouts depend on seed, round, profile and column only, faults on the seed
/// and the order of reads.
#ifndef CANOPY_TOOLS_COMMON_SWEEP_H
#define CANOPY_TOOLS_COMMON_SWEEP_H

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

#include "tools/common/fault.h"

#define CANOPY_SWEEP_CLIENTS 9       ///< masters that are told apart, from 0
#define CANOPY_SWEEP_COLUMNS 4096    ///< most columns
#define CANOPY_SWEEP_PROFILES 65535  ///< most profiles

struct canopy_sweep_options {
    uint32_t profiles;  ///< 0: the lattice of the points, or what suits their number
    uint32_t columns;   ///< 0: likewise, at most 488 (four reads a profile)
    double unit;        ///< input units a device unit; 0: the power of ten that gives 10^5 to 10^6 to the extent
    double rate_hz;     ///< profiles a second; 0: on demand
    bool loop;          ///< begin again after the last profile
    uint64_t seed;
    uint16_t sequence;     ///< of the first profile; 0 counts as 1
    uint16_t uncertainty;  ///< told to the master, device units
    // Faults; each probability is for one profile, dropouts for one reading.
    double noise;     ///< sigma of a normal error of each height, input units; cut at 4 sigma
    double dropouts;  ///< a reading is missing
    double torn;      ///< the next profile takes over in the middle of the read; the torn one comes again later
    double stale;     ///< for 3 to 12 looks the scanner shows the same frame still, or the one before
    double lost;      ///< up to three sequence numbers are passed over
    double short_of;  ///< promises one reading too many; afterwards the same profile with the right number
};

struct canopy_sweep;

/// How far it is.
struct canopy_sweep_status {
    uint32_t profiles;  ///< of one round
    uint32_t columns;   ///< of a profile
    uint64_t readings;  ///< of one round, before noise and dropouts
    uint32_t profile;   ///< profiles that are through in this round
    uint32_t rounds;    ///< whole rounds that are through
    uint16_t sequence;  ///< of the profile that stands now, 0 before the first look
    uint64_t served;    ///< valid readings in profiles that were offered completely
    uint64_t doubtful;  ///< those in profiles of which an answer was doubtful: the master may have taken them or not
    uint64_t missed;    ///< those in profiles that passed without having been offered completely
    uint64_t torn, stale, lost, short_of;  ///< faults made
    bool over;                             ///< all profiles are through and it does not loop
};

/// Reads the points of `path` and prepares the sweep. NULL, and `fault` says why: the file, the options (too many
/// columns, …) or coordinates that do not fit 32 bits at this unit.
struct canopy_sweep *canopy_sweep_open(const char *path, const struct canopy_sweep_options *options,
                                       struct canopy_fault *fault);

void canopy_sweep_close(struct canopy_sweep *sweep);

/// Input units a device unit: the double of the shortest decimal that is this float, as the registers carry a float.
double canopy_sweep_unit(const struct canopy_sweep *sweep);

/// What a scanner shows at these registers now. Returns 0 or a Modbus exception code.
uint8_t canopy_sweep_read(struct canopy_sweep *sweep, uint8_t client, uint16_t address, uint16_t count, uint16_t *to,
                          uint64_t now_us);

/// The last read of `client` goes to its master as it is. `doubtful`: but so late, or behind such noise, that the
/// master may not take it. Without this call the master is taken not to have seen it.
void canopy_sweep_offered(struct canopy_sweep *sweep, uint8_t client, bool doubtful);

/// From now on each reading of a served profile is written to `file`, a line each: "x y z", input units, 17 digits, so
/// that rint(coordinate / unit) is the device's own number. A profile is served, and written once, when all its
/// registers were offered to one master under one sequence number with no doubt. `file` belongs to the caller.
void canopy_sweep_log(struct canopy_sweep *sweep, FILE *file);

/// Client `client` is another master from now on.
void canopy_sweep_forget(struct canopy_sweep *sweep, uint8_t client);

struct canopy_sweep_status canopy_sweep_status(const struct canopy_sweep *sweep);

#endif
