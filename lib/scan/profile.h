/// The driver for profile scanners: registers in, validated profiles out.
///
/// Sans I/O. The driver says which registers it wants next and is given them, or why they did not come; who fetches
/// them (lib/modbus on bare metal, libmodbus on Linux, a function call in a simulator) is not its business:
///
///     struct canopy_profile_request request;
///     if (canopy_profile_next(&driver, now_us, &request)) {
///         … read request.count registers at request.address of request.unit with request.function …
///         event = canopy_profile_answer(&driver, registers, count, now_us);   // or canopy_profile_failed(…)
///     }
///     const struct canopy_profile *profile = canopy_profile_get(&driver);
///     if (profile != NULL) {
///         for (uint16_t i = 0; i < profile->columns; i++) { canopy_profile_reading(&driver, i, &reading); … }
///         canopy_profile_done(&driver);
///     }
///
/// What it guarantees: a profile is delivered only when every register of it was read while one sequence number stood,
/// in answers of exactly the length asked for, and its number of valid readings is the number the scanner promised. A
/// torn, short, stale or failed profile is counted and dropped as a whole; an invalid reading is delivered as invalid
/// with its reason, never as a height. No profile is delivered twice.
///
/// Blocks of one profile all have different lengths, strictly falling from `read_max` and none equal to the header's or
/// the description's (as far as `read_max` allows): an RTU answer says neither address nor time, so this is what keeps
/// one that came too late from being taken for the answer to the next request.
///
/// A scanner that is read while it goes on by its own clock must give a profile at least the time its read takes. After
/// a torn one the driver waits for the next to appear and reads that from its beginning, in step with the scanner.
///
/// Wire cost: 400 columns of u16 on the generic map are 4 reads, 864 bytes. While profiles come as fast as they are
/// read, the first look for a profile already is its first block; while the driver waits, a look reads the header only.
///
/// Memory: the driver and one arena for the raw heights of one profile. Work: O(count) a call, O(columns) for a
/// profile's last answer; a reading is O(1). `now_us` is any clock that never goes back, the same in every call.
#ifndef CANOPY_SCAN_PROFILE_H
#define CANOPY_SCAN_PROFILE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/scan/table.h"
#include "lib/status.h"

/// Bytes of the arena for profiles of up to `columns` readings of `words` registers each (1, or 2 for 32-bit heights).
#define CANOPY_PROFILE_ARENA(columns, words) ((((size_t)(columns) * (size_t)(words) + 2) * 2 + 7) / 8 * 8)

#define CANOPY_PROFILE_NEVER UINT64_MAX

struct canopy_profile_request {
    uint8_t unit;  ///< on I2C the device's address, 0: the table's
    uint8_t function;
    uint16_t address;
    uint16_t count;   ///< registers, 1 to CANOPY_SCAN_READ_MAX
    uint64_t due_us;  ///< not before
};

/// Why registers did not come. Each has its counter.
enum canopy_scan_failure {
    CANOPY_SCAN_TIMEOUT = 0,  ///< silence; on I2C a clock held for too long
    CANOPY_SCAN_CRC,          ///< a frame with a wrong checksum, or one that made no sense
    CANOPY_SCAN_LENGTH,       ///< an answer with another number of registers
    CANOPY_SCAN_EXCEPTION,    ///< a Modbus exception
    CANOPY_SCAN_LINK,         ///< the line or connection is down, or cannot carry such a read
    CANOPY_SCAN_NAK,          ///< I2C: nobody acknowledged the address, or a byte was refused
    CANOPY_SCAN_BUS,          ///< I2C: a line held low, another master in the way
    CANOPY_SCAN_FAILURES
};

/// What an answer or a failure brought about.
enum canopy_scan_event {
    CANOPY_SCAN_NOTHING = 0,  ///< go on
    CANOPY_SCAN_PROFILE,      ///< a profile is complete: canopy_profile_get()
    CANOPY_SCAN_SCENE,        ///< the description was read or has changed: canopy_profile_scene() is new
    CANOPY_SCAN_TORN,         ///< dropped: the sequence number changed while the profile was read
    CANOPY_SCAN_SHORT,        ///< dropped: the number of valid readings is not the one promised
    CANOPY_SCAN_STALE,        ///< no new profile within the stale limit, or an older sequence number came back
    CANOPY_SCAN_REFUSED,      ///< this is not the device of the table, or it contradicts itself or the arena
    CANOPY_SCAN_RETRY,        ///< the read failed and will be repeated
    CANOPY_SCAN_DROPPED       ///< the read failed too often: its profile is given up, the description is read again
};

enum canopy_reading_reason {
    CANOPY_READING_VALID = 0,
    CANOPY_READING_NONE,     ///< the scanner saw nothing there
    CANOPY_READING_LIMIT,    ///< a height outside the device's range
    CANOPY_READING_OVERFLOW  ///< x or z does not fit int32
};

/// One reading, in device units. x, y and z are 0 where `valid` is false.
struct canopy_reading {
    int32_t x, y, z;
    uint32_t uncertainty;  ///< the true height is within z +- this
    bool valid;
    uint8_t reason;  ///< enum canopy_reading_reason
};

struct canopy_profile {
    uint32_t sequence;
    int32_t y;
    uint16_t columns;
    uint16_t valid;    ///< readings that are valid
    uint64_t time_us;  ///< when its last register came
};

/// What the scanner says of the whole scene, if it does.
struct canopy_profile_scene {
    int32_t low[3], high[3];  ///< box that holds every reading, device units
    uint32_t profiles;        ///< of a sweep; 0: unknown
    uint32_t uncertainty;     ///< of any reading, as far as table and description say
    uint16_t columns;         ///< of a profile; 0: unknown before the first header
    float unit;               ///< one device unit, > 0; 1 if the device does not say
};

/// Monotonic; they wrap at 2^32.
struct canopy_profile_counters {
    uint32_t profiles;    ///< delivered
    uint32_t readings;    ///< valid readings in them
    uint32_t invalid;     ///< invalid readings in them
    uint32_t missed;      ///< sequence numbers passed over: profiles that were never delivered, for whatever reason
    uint32_t torn;        ///< profiles dropped: the sequence number changed
    uint32_t short_of;    ///< profiles dropped: another number of valid readings than promised
    uint32_t stale;       ///< stale limits that passed without a new profile, and older sequence numbers seen
    uint32_t refused;     ///< descriptions and headers that were not acceptable
    uint32_t dropped;     ///< reads given up after all repetitions
    uint32_t unexpected;  ///< answers nobody had asked for; ignored
    uint32_t failures[CANOPY_SCAN_FAILURES];  ///< failed reads, by reason
    uint32_t last_failure;  ///< no counter: why the last one failed, 1 + enum canopy_scan_failure; 0: none has
};

struct canopy_profile_config {
    const struct canopy_profile_table *table;  ///< stays with the caller, as long as the driver lives
    uint8_t unit;                              ///< of the scanner: Modbus unit; I2C address, 0: the table's
    uint16_t columns;                          ///< the arena's: a scanner with more is refused
};

/// All members are the driver's own.
struct canopy_profile_driver {
    const struct canopy_profile_table *table;
    uint16_t *raw;  ///< heights and trailer of the profile being read
    uint8_t unit;
    uint8_t phase;
    uint8_t attempts;
    bool scene_known, started, have_candidate, eager, waited, asked, stale, out_of_step, passing;
    uint16_t capacity;       ///< columns the arena holds
    uint16_t promised;       ///< valid readings the header promised
    uint16_t filled, total;  ///< registers of `raw`: there, and wanted
    uint16_t previous;       ///< length of the last block of this profile
    int32_t x_start, x_step, z_offset, z_step;
    uint32_t uncertainty;
    uint32_t description_id;
    uint32_t passed;         ///< a profile that stood already, passed over …
    uint32_t last_sequence;  ///< of the last delivered profile
    uint32_t candidate;      ///< an older sequence number that may mean a restart
    struct canopy_profile_request request;
    struct canopy_profile profile;  ///< the one being read, or held
    uint64_t fresh_us;              ///< when the last profile was delivered or the last stale limit passed
    uint64_t standstill_us;         ///< when `candidate` was first seen
    uint64_t begin_us;              ///< when the header of the profile being read came
    uint64_t in_step_us;            ///< … until then
    struct canopy_profile_scene scene;
    struct canopy_profile_counters counters;
};

/// Makes a driver that has read nothing. `arena`: at least CANOPY_PROFILE_ARENA(config->columns, words of a height)
/// bytes, aligned to 8; it belongs to the driver as long as the driver is used.
/// CANOPY_ARGUMENT: the table contradicts itself (an offset outside its block, a block of more than 125, …) or
/// columns is 0; CANOPY_ARENA_SHORT, CANOPY_ARENA_ALIGN. A driver whose init failed must not be used.
enum canopy_status canopy_profile_init(struct canopy_profile_driver *driver, const struct canopy_profile_config *config,
                                       void *arena, size_t bytes, uint64_t now_us);

/// The same for a table that canopy_scan_table_ok has been asked about before it was built in, as the library's own
/// have been by its tests: without looking at it again, which is 0.6 KB of a Cortex-M0+.
enum canopy_status canopy_profile_init_known(struct canopy_profile_driver *driver,
                                             const struct canopy_profile_config *config, void *arena, size_t bytes,
                                             uint64_t now_us);

/// The read the driver wants. True: it is due now. False: not before request->due_us, which is CANOPY_PROFILE_NEVER
/// while a complete profile is held. It is the same request until it is answered, failed or the driver is started anew.
bool canopy_profile_next(struct canopy_profile_driver *driver, uint64_t now_us, struct canopy_profile_request *request);

/// The answer to the last request: `count` registers in host order. Another count than asked for is a failed read
/// (CANOPY_SCAN_LENGTH). The registers are not kept.
enum canopy_scan_event canopy_profile_answer(struct canopy_profile_driver *driver, const uint16_t *registers,
                                             size_t count, uint64_t now_us);

/// The last request came to nothing. `failure` is an enum canopy_scan_failure.
enum canopy_scan_event canopy_profile_failed(struct canopy_profile_driver *driver, enum canopy_scan_failure failure,
                                             uint64_t now_us);

/// The complete profile, or NULL. It stays, and nothing is requested, until canopy_profile_done().
const struct canopy_profile *canopy_profile_get(const struct canopy_profile_driver *driver);

/// Decodes reading `column` of the held profile from its registers. False, and an invalid reading, if there is no
/// profile or no such column. O(1), no division when z_divisor is 1.
bool canopy_profile_reading(const struct canopy_profile_driver *driver, uint16_t column, struct canopy_reading *to);

/// Gives the held profile back; the next one may overwrite it.
void canopy_profile_done(struct canopy_profile_driver *driver);

/// What the scanner knows of its scene, or NULL if it does not say or has not been asked yet.
const struct canopy_profile_scene *canopy_profile_scene(const struct canopy_profile_driver *driver);

/// True while no new profile has come for longer than the table's stale limit (before the first one: since init).
bool canopy_profile_stale(const struct canopy_profile_driver *driver, uint64_t now_us);

const struct canopy_profile_counters *canopy_profile_counters(const struct canopy_profile_driver *driver);

/// Everything that went wrong, in one number for a register: failed reads, torn, short, stale and refused ones.
uint32_t canopy_profile_errors(const struct canopy_profile_driver *driver);

#endif
