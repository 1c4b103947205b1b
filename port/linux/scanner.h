/// A profile scanner in a thread of its own: the driver of lib/scan, fed by reads that may block.
///
/// Only valid readings of complete profiles, and scenes, leave the thread, through a ring; when the ring is full the
/// scanner waits, the station never does. How the scanner fares is copied out under a lock that the station only tries.
#ifndef CANOPY_PORT_LINUX_SCANNER_H
#define CANOPY_PORT_LINUX_SCANNER_H

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>

#include "lib/scan/profile.h"
#include "port/linux/ring.h"

/// Where registers come from. Both are called from the scanner's thread alone.
struct canopy_linux_registers {
    void *context;
    /// Reads request->count registers, host order; may block for some seconds. False: *failure says why.
    bool (*fetch)(void *context, const struct canopy_profile_request *request, uint16_t *registers,
                  enum canopy_scan_failure *failure);
    /// No fetch before this time, 0 for any time. May be NULL.
    uint64_t (*ready_us)(void *context);
    /// In words, why the last fetch failed. May be NULL.
    const char *(*why)(void *context);
};

struct canopy_linux_scanner_status {
    struct canopy_profile_counters counters;
    uint32_t errors;      ///< canopy_profile_errors()
    bool faulty;          ///< silent or stale, refused, or not reached
    uint64_t updated_us;  ///< when this was true
};

/// All members are the scanner's own but `ring`, from which one other thread pops.
struct canopy_linux_scanner {
    struct canopy_linux_registers registers;
    struct canopy_profile_driver driver;
    struct canopy_linux_ring ring;
    void *arena;
    pthread_t thread;
    pthread_mutex_t lock;  // of status
    struct canopy_linux_scanner_status status;
    atomic_bool stop;
    int stop_event;  // wakes the thread
    int news_event;  // wakes the popper: readable when something was pushed
    bool running;
    enum { CANOPY_LINUX_SCANNER_NEW, CANOPY_LINUX_SCANNER_UP, CANOPY_LINUX_SCANNER_DOWN } mood;  // what was logged last
};

#define CANOPY_LINUX_SCANNER_COLUMNS 8192u  ///< a scanner with more is refused

/// Starts the thread on a device that looks like `table`. NULL, or in a few words what is wrong. `scanner` is large
/// (half a megabyte) and must not move.
const char *canopy_linux_scanner_start(struct canopy_linux_scanner *scanner, const struct canopy_profile_table *table,
                                       uint8_t unit, struct canopy_linux_registers registers);

/// A descriptor that becomes readable when something was pushed; canopy_linux_scanner_hear() makes it quiet again.
int canopy_linux_scanner_event(const struct canopy_linux_scanner *scanner);
void canopy_linux_scanner_hear(struct canopy_linux_scanner *scanner);

/// Copies the status unless the thread is writing it just now: false then, and *to is unchanged. Never waits.
bool canopy_linux_scanner_look(struct canopy_linux_scanner *scanner, struct canopy_linux_scanner_status *to);

/// Ends the thread: waits for a read that is under way, `wait_us` at most. False: the thread still hangs, and neither
/// the scanner nor what its registers need may be freed; end the process.
bool canopy_linux_scanner_stop(struct canopy_linux_scanner *scanner, uint32_t wait_us);

#endif
