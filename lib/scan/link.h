/// How the reads of a profile driver (lib/scan/profile.h) reach a scanner, whatever is between: a Modbus line
/// (lib/station/rtu_link.h), an I2C bus (lib/scan/i2c_link.h), or nothing at all, when a board plays its own scanner.
///
/// A link carries one read at a time and never waits. What it delivers is what the scanner said: it checks the check
/// sums of its wire, and what fails them is a failure, not data. Whoever moves it on does so whenever an interrupt has
/// brought work, and once a millisecond while a read is under way.
#ifndef CANOPY_SCAN_LINK_H
#define CANOPY_SCAN_LINK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/scan/profile.h"

enum canopy_scan_link_state {
    CANOPY_SCAN_LINK_PENDING = 0,  ///< the read is under way, or none is
    CANOPY_SCAN_LINK_DONE,         ///< the registers are there
    CANOPY_SCAN_LINK_FAILED        ///< they will not come: `failure` says why
};

struct canopy_scan_answer {
    uint16_t registers[CANOPY_SCAN_READ_MAX];  ///< in host order
    size_t count;                              ///< of them
    enum canopy_scan_failure failure;
};

/// What became of a wire, monotonic since the start.
struct canopy_scan_link_counters {
    uint32_t lost_bytes;  ///< received bytes lost on a serial line
    uint32_t recoveries;  ///< times that an I2C bus that was held was freed
};

struct canopy_scan_link {
    void *context;
    /// Begins a read. False: it cannot be begun now or ever (CANOPY_SCAN_LINK failure). The request is copied.
    bool (*begin)(void *context, const struct canopy_profile_request *request, uint64_t now_us);
    /// Moves the read on. Anything but PENDING ends it, and is said once; DONE fills the answer's registers and count,
    /// FAILED its failure.
    enum canopy_scan_link_state (*poll)(void *context, uint64_t now_us, struct canopy_scan_answer *answer);
    void (*count)(void *context, struct canopy_scan_link_counters *to);
};

#endif
