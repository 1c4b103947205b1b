/// The seam: what the library and the programs built on it ask of a platform.
///
/// Every interface is a struct of callbacks with a context pointer, so that a program can have several instances
/// and a test can fake any of them. Nothing here blocks, but for canopy_flash: a call moves what it can move now and
/// returns. What a platform has not is a struct whose callbacks say so (port/template has each of them), never NULL.
#ifndef CANOPY_PORT_H
#define CANOPY_PORT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/status.h"

/// A clock that never goes back. It starts anywhere and does not wrap in the life of a device.
struct canopy_clock {
    void *context;
    uint64_t (*now_us)(void *context);
};

/// A byte stream: a serial line or one TCP connection. One that a platform has not never gives or takes a byte.
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

/// How an I2C transfer ended.
enum canopy_i2c_outcome {
    CANOPY_I2C_PENDING = 0,  ///< it is under way
    CANOPY_I2C_DONE,         ///< every byte was acknowledged or read
    CANOPY_I2C_NAK_ADDRESS,  ///< nobody answers to the address
    CANOPY_I2C_NAK_DATA,     ///< a written byte was refused
    CANOPY_I2C_TIMEOUT,      ///< it took longer than allowed: a clock stretched without end, or a lost interrupt
    CANOPY_I2C_ARBITRATION,  ///< another master took the bus
    CANOPY_I2C_HELD,         ///< a line stays low although nine clocks were given: somebody holds the bus
    CANOPY_I2C_UNSUPPORTED   ///< the platform has no such bus, or cannot do this transfer
};

/// One transfer: START, address, `out`; a repeated START, or STOP and START; address, `in`; STOP. Without `out` or
/// without `in` that half is left out; without both the address alone is asked (a probe).
struct canopy_i2c_transfer {
    const uint8_t *out;
    uint8_t *in;
    uint16_t out_length, in_length;
    uint8_t address;    ///< 7 bits
    bool stop_between;  ///< STOP before the read: for devices that know no repeated START
};

/// A master on an I2C bus. One transfer at a time.
struct canopy_i2c {
    void *context;
    uint16_t max_transfer;  ///< the most bytes of `out` and of `in`; longer ones are unsupported
    /// Begins a transfer, of which the buffers must stay until it has ended. It ends within `timeout_us`, whatever the
    /// bus does, as long as it is polled. False: one is under way, nothing was begun. A platform whose I2C can only
    /// block (Linux's I2C_RDWR) may do the whole transfer here, in a thread whose program waits for nothing else, or
    /// hand it to a thread of its own; poll then tells how it ended.
    bool (*start)(void *context, const struct canopy_i2c_transfer *transfer, uint32_t timeout_us);
    /// Moves the transfer on. Its outcome stays until the next start; before the first it is UNSUPPORTED.
    enum canopy_i2c_outcome (*poll)(void *context);
    /// Times that the bus was freed by nine clocks since the start: monotonic.
    uint32_t (*recoveries)(void *context);
};

/// Memory that keeps what is written without power: pages that are erased whole (to 0xFF) and programmed in pieces.
/// Programming clears bits and leaves those that are 1 in `from` as they were, also where it was programmed before.
/// erase and program block for as long as the memory takes, up to half a second on some chips; received bytes may be
/// lost (and are counted) meanwhile.
struct canopy_flash {
    void *context;
    uint32_t page_bytes;     ///< erased at once
    uint32_t program_bytes;  ///< the unit of programming: offset and length are multiples of it
    uint32_t page_count;     ///< 0: the platform has none
    /// CANOPY_ARGUMENT: outside of the pages; CANOPY_RANGE: the memory failed; CANOPY_UNSUPPORTED: there is none.
    enum canopy_status (*read)(void *context, uint32_t page, uint32_t offset, uint8_t *to, uint32_t length);
    enum canopy_status (*erase)(void *context, uint32_t page);
    enum canopy_status (*program)(void *context, uint32_t page, uint32_t offset, const uint8_t *from, uint32_t length);
};

/// The memory of the program itself, for tests of it (lib/station/selftest.h).
struct canopy_memory {
    uint32_t *ram, *ram_end;    ///< all RAM that the program uses, in whole words
    const uint32_t *stack_end;  ///< within it: the stack's upper end, from which it grows down …
    uint32_t *stack;            ///< … to here
    const uint8_t *flash;       ///< the program, at its lowest address
    const uint32_t *flash_end;  ///< beyond it stands the CRC-32 of it (lib/num/crc32.h): the build puts it there
    uint32_t (*mask)(void);     ///< masks all interrupts; tells how it was before
    void (*restore)(uint32_t was);
};

enum canopy_crash_kind {  // 16 + irq: an interrupt without a handler
    CANOPY_CRASH_NONE = 0,
    CANOPY_CRASH_WATCHDOG = 2,  ///< the program did not feed it
    CANOPY_CRASH_HARD = 3,      ///< a fault of no or unknown kind
    CANOPY_CRASH_MEMORY = 4,    ///< a forbidden address: the end of the stack
    CANOPY_CRASH_BUS = 5,       ///< an address that nothing answers to
    CANOPY_CRASH_USAGE = 6      ///< an instruction that cannot be executed
};

/// What is left of a crash. It survives the reset that ends it.
struct canopy_crash {
    uint32_t kind;     ///< enum canopy_crash_kind
    uint32_t pc;       ///< the instruction that faulted or was interrupted; 0 when it is not known
    uint32_t lr;       ///< its return address; 0 likewise
    uint32_t sp;       ///< the stack pointer then
    uint32_t status;   ///< the processor's own word for why: CFSR on ARMv7-M, mcause on RISC-V, 0 on ARMv6-M
    uint32_t address;  ///< the address that could not be accessed, 0 when the processor does not know it
    uint32_t count;    ///< crashes since power-on, this one included
};

#endif
