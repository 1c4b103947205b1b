/// The seam: what the library and the programs built on it ask of a platform.
///
/// Every interface is a struct of callbacks with a context pointer, so that a program can have several instances
/// and a test can fake any of them. Nothing here blocks: a call moves what it can move now and returns.
#ifndef CANOPY_PORT_H
#define CANOPY_PORT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/// A clock that never goes back. It starts anywhere and does not wrap in the life of a device.
struct canopy_clock {
    void *context;
    uint64_t (*now_us)(void *context);
};

/// A byte stream: a serial line or one TCP connection.
struct canopy_stream {
    void *context;
    /// Moves at most `length` received bytes to `to`; returns how many there were, 0 if none.
    size_t (*read)(void *context, uint8_t *to, size_t length);
    /// Accepts at most `length` bytes for sending; returns how many were taken, 0 if there is no room now.
    size_t (*write)(void *context, const uint8_t *from, size_t length);
    /// True when every accepted byte has left the wire (the last stop bit, not the last register write).
    bool (*sent)(void *context);
    /// Received bytes lost to overrun, framing or parity errors since start: monotonic.
    uint32_t (*lost)(void *context);
};

/// A watchdog: once started, the platform resets unless it is fed within its period.
struct canopy_watchdog {
    void *context;
    void (*feed)(void *context);
};

#endif
