/// The PLC's view of the station: publishes envelopes as snapshots and serves the register map.
///
/// Threads: all calls on one object come from one thread (a station's step and its Modbus servers take turns in one
/// loop; a sensor thread hands over readings, never registers). Nothing here waits, locks or retries.
///
/// Snapshots. A publication never changes coefficients that somebody may be reading: it goes to a slot of its own.
/// There are clients + 2 slots: each client can hold one old envelope, one is published, one is being written. So a
/// slot for writing is always there, publication is never delayed by readers, and no reader is ever cut off by one.
///
///     struct canopy_envelope *next = canopy_plc_begin(&plc);
///     … fill it, over as many steps as it takes: frame, points, margin, next->coefficients[], next->coverage[] …
///     status = canopy_plc_commit(&plc);
///
/// Holds. A client (an RTU port or a TCP connection; whoever owns them numbers them from 0) reads an envelope in
/// several requests and sees one sequence in all of them:
///   - a request that contains the first register of `sequence` starts a hold on the newest envelope;
///   - so does any request for the envelope, coverage_* or block_* registers of a client that holds nothing;
///   - so does asking again for a header register, or for the first register of a block, that the hold has shown:
///     who polls, with or without `sequence`, is never stuck on an old envelope;
///   - one request is answered from one envelope, always;
///   - canopy_plc_withdraw() breaks every hold: the client then sees sequence 0, no points and the extreme safe value
///     for every coefficient, until it starts a hold again by one of these rules.
/// Live status, counters, queries and commands are never held.
///
/// Memory: 20 x 20, one RTU client: see CANOPY_PLC_ARENA; `docs/plc.md` has the table.
#ifndef CANOPY_PLC_H
#define CANOPY_PLC_H

#include <stddef.h>
#include <stdint.h>

#include "lib/arena.h"
#include "lib/cover/envelope.h"
#include "lib/modbus/pdu.h"
#include "lib/plc/map.h"
#include "lib/status.h"

/// What the registers show that is not an envelope, and what they set off. Called from canopy_plc_read and
/// canopy_plc_write, in their thread. All must be set.
struct canopy_plc_source {
    void *context;
    /// Fills in the live status as of now. `to` comes zeroed.
    void (*live)(void *context, struct canopy_plc_live *to);
    /// Fills in the counters as of now. `to` comes zeroed.
    void (*counters)(void *context, struct canopy_plc_counters *to);
    /// Evaluates the envelope at (x, y): device units from the origin along u and v. *height is in lsb, rounded to the
    /// safe side (above: up). Returns CANOPY_PLC_QUERY_GOOD, _OUTSIDE, _UNCOVERED or _INTRUSION; *height counts only
    /// with GOOD. Not called while an envelope is not published or the live status says intrusion.
    enum canopy_plc_query_status (*height)(void *context, const struct canopy_envelope *envelope, int32_t x, int32_t y,
                                           int32_t *height);
    /// Runs a command: REFIT, RESTART or WITHDRAW. May publish and withdraw. Returns DONE or REFUSED, at once.
    enum canopy_plc_result (*command)(void *context, enum canopy_plc_command_code code);
};

/// The device around what is published, as far as registers show and change it: groups health and settings, and the
/// commands STORE, DEFAULTS and RESET. lib/station/health.h is one. Called like a canopy_plc_source.
struct canopy_plc_keeper {
    struct canopy_plc_settings settings;  ///< clients write `value`, within its ranges; the rest is the keeper's
    uint32_t fixed;                       ///< settings that cannot be changed: 1 << CANOPY_SETTING_...
    /// Fills in the health as of now. `to` comes zeroed.
    void (*health)(struct canopy_plc_keeper *keeper, struct canopy_plc_health *to);
    /// Runs a command or begins to. Returns DONE or REFUSED, at once.
    enum canopy_plc_result (*keep)(struct canopy_plc_keeper *keeper, enum canopy_plc_command_code code);
};

struct canopy_plc_config {
    uint16_t size[2];  ///< m x n: room for m * n coefficients, at most CANOPY_PLC_CAPACITY_MAX; each at least 4
    uint8_t side;      ///< enum canopy_side of every envelope
    uint8_t scalar;    ///< enum canopy_scalar of every envelope
    uint8_t clients;   ///< 1 to 250
    float unit;        ///< of the scene, > 0 and not subnormal: point = device * unit
    struct canopy_plc_source source;
};

/// The map has room for this many coefficients.
#define CANOPY_PLC_CAPACITY_MAX 16384

#define CANOPY_PLC_BLOCK_COEFFICIENTS 61U
#define CANOPY_PLC_BLOCK_CELLS 1952U
#define CANOPY_PLC_BLOCK_ROWS 61U
#define CANOPY_PLC_BLOCKS_OF(coefficients) (((size_t)(coefficients) + 60U) / CANOPY_PLC_BLOCK_COEFFICIENTS)
#define CANOPY_PLC_COVERAGE_OF(cells) (((size_t)(cells) + 1951U) / CANOPY_PLC_BLOCK_CELLS)

/// One envelope. All members are the object's own.
struct canopy_plc_slot {
    struct canopy_envelope envelope;
    uint32_t *changed;  ///< by row of coefficients: the sequence that changed it last
    uint32_t sequence;
    uint16_t holders;
};

/// One client. All members are the object's own.
struct canopy_plc_client {
    uint64_t shown;         ///< header registers that the hold has shown
    uint8_t *shown_blocks;  ///< the same of the blocks' first registers: coefficients, coverage, changes
    struct canopy_plc_query query;
    struct canopy_plc_command command;
    uint8_t hold;  ///< slot, CANOPY_PLC_NO_SLOT or CANOPY_PLC_BROKEN
};

/// All members are the object's own, but `keeper`.
struct canopy_plc {
    uint8_t slot_count;
    uint8_t published, writing;  ///< slots, or CANOPY_PLC_NO_SLOT
    bool barred;
    struct canopy_plc_config config;
    struct canopy_plc_keeper *keeper;  ///< set after init, or NULL: health reads 0, there are no settings
    struct canopy_plc_client *clients;
    struct canopy_plc_slot *slots;
    size_t shown_bytes;
    uint32_t capacity;  ///< coefficients in a slot
    uint32_t sequence;  ///< of the last publication, 0 before the first
    uint32_t publications, withdrawals, commands;
};

// One bit a block; neither coverage nor changes have more blocks than coefficients have.
#define CANOPY_PLC_SHOWN_BYTES(capacity) ((3U * CANOPY_PLC_BLOCKS_OF(capacity) + 7U) / 8U)
#define CANOPY_PLC_SLOT_BYTES(capacity, rows)                                                                          \
    (CANOPY_ARENA_ROUND(4U * (size_t)(capacity)) + CANOPY_ARENA_ROUND(((size_t)(capacity) + 7U) / 8U) +                \
     CANOPY_ARENA_ROUND(4U * (size_t)(rows)))

/// Bytes of arena for grids of up to m * n coefficients and so many clients: a constant expression.
#define CANOPY_PLC_ARENA(m, n, clients) CANOPY_PLC_ARENA_FOR((size_t)(m) * (size_t)(n), m, (size_t)(clients))
#define CANOPY_PLC_ARENA_FOR(capacity, rows, clients)                                                                  \
    (CANOPY_ARENA_ROUND((clients) * sizeof(struct canopy_plc_client)) +                                                \
     CANOPY_ARENA_ROUND((clients)*CANOPY_PLC_SHOWN_BYTES(capacity)) +                                                  \
     CANOPY_ARENA_ROUND(((clients) + 2U) * sizeof(struct canopy_plc_slot)) +                                           \
     ((clients) + 2U) * CANOPY_PLC_SLOT_BYTES(capacity, rows))

/// Makes an object that has published nothing. `arena`: at least CANOPY_PLC_ARENA(m, n, clients) bytes, aligned to 8;
/// it belongs to the object as long as the object is used. The configuration is copied.
/// CANOPY_ARGUMENT: a member is outside the range given above; CANOPY_ARENA_SHORT, CANOPY_ARENA_ALIGN.
enum canopy_status canopy_plc_init(struct canopy_plc *plc, const struct canopy_plc_config *config, void *arena,
                                   size_t bytes);

/// The unit of envelopes from now on, as in the configuration. What is published under another one is withdrawn.
/// CANOPY_ARGUMENT: not > 0, or subnormal; nothing is changed then.
enum canopy_status canopy_plc_set_unit(struct canopy_plc *plc, float unit);

/// The envelope to fill for the next publication, with room for the configured size behind `coefficients` and
/// `coverage` (do not change these two pointers). Nobody else sees it before canopy_plc_commit(). Calling it again
/// before that gives the same one, with what has been written so far; side and scalar are preset. Never NULL.
/// Cost: one look at each slot.
struct canopy_envelope *canopy_plc_begin(struct canopy_plc *plc);

/// Publishes what canopy_plc_begin() gave: the sequence grows by one (from 2^32 - 1 to 1), holds stay as they are.
/// CANOPY_ARGUMENT: nothing was begun, a size below 4 or with more coefficients than the room, a side or scalar other
/// than configured, a negative margin or a pitch of 0. CANOPY_RANGE: unit * 2^quantum_log2 or 2^lsb_log2 is no normal
/// float. CANOPY_NOT_SAFE: barred. After an error nothing is published, and the envelope is still there to be mended.
/// Compares the rows of coefficients with those of the envelope published until now, to tell which have changed: O(m n)
/// at most.
enum canopy_status canopy_plc_commit(struct canopy_plc *plc);

/// Publishes a copy of `envelope` (not of the one that canopy_plc_begin gave): canopy_plc_begin, a copy,
/// canopy_plc_commit. Same errors. O(m n).
enum canopy_status canopy_plc_publish(struct canopy_plc *plc, const struct canopy_envelope *envelope);

/// Takes the published envelope back, at once and from everybody: nothing is published, all holds break, the results
/// of queries become the extreme safe value. Without a published envelope it only breaks the holds. O(clients).
void canopy_plc_withdraw(struct canopy_plc *plc);

/// Withdraws, and from now on publishes nothing: the device has found itself faulty. There is no way back but init.
void canopy_plc_bar(struct canopy_plc *plc);

/// The newest envelope, NULL if none is published. It stays as it is until the next commit or withdrawal.
const struct canopy_envelope *canopy_plc_published(const struct canopy_plc *plc);

/// Its sequence, 0 if none is published.
uint32_t canopy_plc_sequence(const struct canopy_plc *plc);

/// Forgets all that client `client` held, asked and commanded: to be called when a connection with that number opens or
/// closes. A number out of range is ignored.
void canopy_plc_forget(struct canopy_plc *plc, uint8_t client);

/// The registers as a bank for Modbus servers; `plc` must outlive them.
struct canopy_modbus_bank canopy_plc_bank(struct canopy_plc *plc);

// The bank's functions, for who serves registers in another way; `plc` is a struct canopy_plc *.

/// Serves a read of `count` registers (1 to 125) from `address`: 2 * count bytes, high byte first, to `to`.
/// Any stretch of the map that holds at least one register of the table can be read, across items, blocks and groups;
/// addresses between them read 0. Returns 0 or an enum canopy_modbus_exception: ILLEGAL_ADDRESS, a stretch that has
/// no register in it or reaches beyond the map; ILLEGAL_VALUE, a count outside 1 to 125; FAILURE, no such client.
/// O(count) besides the callbacks.
uint8_t canopy_plc_read(void *plc, uint8_t client, uint16_t address, uint16_t count, uint8_t *to);

/// What canopy_plc_read would return. No effect.
uint8_t canopy_plc_readable(void *plc, uint8_t client, uint16_t address, uint16_t count);

/// Serves a write of `count` registers (1 to 123) from `address`, taken from 2 * count bytes at `from`; `function` is
/// the function code and makes no difference. All or nothing. Returns 0 or an enum canopy_modbus_exception:
/// ILLEGAL_ADDRESS, a register that is not there or cannot be written, or a part of a multi-register value;
/// ILLEGAL_VALUE, a count out of range, an unknown command, or a setting outside of its range; FAILURE, no such client.
uint8_t canopy_plc_write(void *plc, uint8_t client, uint16_t address, uint16_t count, const uint8_t *from,
                         uint8_t function);

/// The text of a device identification object (function 43/14): 0 vendor, 1 product code, 2 revision, 4 product name;
/// NULL for others. Constant.
const char *canopy_plc_identify(void *plc, uint8_t object);

#endif
