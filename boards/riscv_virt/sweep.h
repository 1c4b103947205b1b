/// A scanner that is not there: a board without one plays it, and answers the reads of the generic map
/// (lib/scan/generic.h) itself, so that the whole driver is at work.
///
/// The scene: waves of a floor, parts that stand on it, no reading in the shadow behind a part and here and there. A
/// profile is CANOPY_SWEEP_COLUMNS heights of one y, and CANOPY_SWEEP_PROFILES of them are a sweep; then it begins
/// again, for ever. Every sweep sees the same, but for parts that are put there between sweeps. Profiles come every
/// CANOPY_SWEEP_PERIOD_US at the earliest, and none before the one in front has been read to its last register: nothing
/// is missed, so that the first N readings of a run are known beforehand. tools/sweep.py is the same in Python, for who
/// wants to check them.
#ifndef CANOPY_BOARDS_RISCV_VIRT_SWEEP_H
#define CANOPY_BOARDS_RISCV_VIRT_SWEEP_H

#include "lib/scan/generic.h"
#include "lib/scan/link.h"

#define CANOPY_SWEEP_COLUMNS 160
#define CANOPY_SWEEP_PROFILES 120
#define CANOPY_SWEEP_PERIOD_US 20000
#define CANOPY_SWEEP_X_STEP 25         ///< device units of 0.1, from one column to the next
#define CANOPY_SWEEP_Y_STEP 30         ///< from one profile to the next
#define CANOPY_SWEEP_HEIGHT_MOST 2047  ///< of any reading

struct canopy_sweep {
    struct canopy_profile_request request;
    uint64_t due_us;   ///< when the next profile may come
    uint32_t profile;  ///< profiles before this one, since the start
    bool asked;
    bool read;  ///< this profile, to its last register
};

/// Height of column i of profile j (both of the sweep), or CANOPY_GENERIC_INVALID.
uint16_t canopy_sweep_height(uint32_t sweep, uint32_t j, uint32_t i);

/// Makes it stand before its first profile.
void canopy_sweep_init(struct canopy_sweep *sweep);

/// The link to it; the object must outlive it. A read of what the map has not fails as an exception.
struct canopy_scan_link canopy_sweep_link(struct canopy_sweep *sweep);

#endif
