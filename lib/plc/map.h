/// The contents of the register map's groups as C structs.
///
/// Which member stands at which address is said in one place, lib/plc/registers.csv; what a member means is said
/// there too (docs/registers.md). A float is kept as its IEEE bits, so that no device needs floating point to serve it.
#ifndef CANOPY_PLC_MAP_H
#define CANOPY_PLC_MAP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/plc/settings.h"
#include "lib/port.h"

/// Bits of canopy_plc_live.status.
enum canopy_plc_status_bit {
    CANOPY_PLC_VALID = 1,      ///< a certified, fresh envelope is published
    CANOPY_PLC_INTRUSION = 2,  ///< a reading lies beyond the published envelope
    CANOPY_PLC_STALE = 4       ///< age_ms > stale_after_ms
};

/// What query_status says. Other than CANOPY_PLC_QUERY_GOOD, the height is the extreme safe value.
enum canopy_plc_query_status {
    CANOPY_PLC_QUERY_GOOD = 0,
    CANOPY_PLC_QUERY_NONE = 1,       ///< no envelope is published
    CANOPY_PLC_QUERY_OUTSIDE = 2,    ///< outside the frame
    CANOPY_PLC_QUERY_UNCOVERED = 3,  ///< the place has no readings
    CANOPY_PLC_QUERY_INTRUSION = 4,  ///< the published envelope is known to be wrong somewhere
    CANOPY_PLC_QUERY_RANGE = 5       ///< the height does not fit 32 bits of device units
};

/// Low byte of a command word.
enum canopy_plc_command_code {
    CANOPY_PLC_COMMAND_NOTHING = 0,   ///< tests the path; answered by lib/plc itself
    CANOPY_PLC_COMMAND_REFIT = 1,     ///< refit now
    CANOPY_PLC_COMMAND_RESTART = 2,   ///< withdraw the envelope and forget all readings
    CANOPY_PLC_COMMAND_WITHDRAW = 3,  ///< withdraw the envelope until the next publication
    CANOPY_PLC_COMMAND_STORE = 4,     ///< store the settings
    CANOPY_PLC_COMMAND_DEFAULTS = 5,  ///< store that all settings are the defaults
    CANOPY_PLC_COMMAND_RESET = 6,     ///< restart the device
    CANOPY_PLC_COMMANDS               ///< how many there are
};

/// What command_result says.
enum canopy_plc_result {
    CANOPY_PLC_RESULT_NONE = 0,    ///< no command yet
    CANOPY_PLC_RESULT_DONE = 1,    ///< done, or begun where it takes longer than a step
    CANOPY_PLC_RESULT_REFUSED = 2  ///< not in the present state
};

struct canopy_plc_identity {
    uint32_t magic, probe_u32, probe_f32, map_crc, firmware_version, capacity;
    uint16_t map_version, clients;
    char vendor[16], product[16], revision[16];
};

/// Filled by the station whenever a client reads it.
struct canopy_plc_live {
    uint32_t age_ms, stale_after_ms;
    uint16_t heartbeat;
    uint16_t status;         ///< enum canopy_plc_status_bit; VALID is masked out while nothing is published
    uint16_t sensor_faults;  ///< bit per sensor
    uint16_t coverage_pct;   ///< 0 to 100, rounded down
};

/// Filled by the station whenever a client reads it, but for the last three, which lib/plc counts itself.
struct canopy_plc_counters {
    uint32_t rx_frames, rx_errors, lost_bytes;
    uint32_t scan_errors, points_rejected, points_accepted, readings_invalid;
    uint32_t profiles, profiles_missed, profiles_torn, profiles_short, profiles_stale, profiles_refused;
    uint32_t intrusions, fits_failed;
    uint32_t uptime_s, cycle_us, cycle_max_us;
    uint32_t publications, withdrawals, commands;
};

/// The envelope's header as registers.
struct canopy_plc_envelope {
    uint32_t sequence, points, unit, lsb;
    int32_t margin, origin[3];
    uint32_t pitch[2];
    int32_t axis[3][3];
    int32_t first_row_high;
    uint32_t first_row_low;
    uint16_t scalar, side, grid_m, grid_n, block_count, coverage_count;
};

struct canopy_plc_query {
    int32_t x, y, height;
    uint32_t sequence;
    uint16_t status;  ///< enum canopy_plc_query_status
};

struct canopy_plc_command {
    uint16_t command, echo, result;
};

/// Bits of a device's self-tests.
enum canopy_plc_selftest_bit {
    CANOPY_PLC_SELFTEST_RAM = 1,
    CANOPY_PLC_SELFTEST_FLASH = 2,
    CANOPY_PLC_SELFTEST_CERTIFICATE = 4
};

/// Why a device started.
enum canopy_plc_reset_reason {
    CANOPY_PLC_RESET_POWER = 0,
    CANOPY_PLC_RESET_WATCHDOG = 1,
    CANOPY_PLC_RESET_CRASH = 2,
    CANOPY_PLC_RESET_COMMAND = 3,
    CANOPY_PLC_RESET_OTHER = 4
};

/// What a device started with.
enum canopy_plc_settings_state {
    CANOPY_PLC_SETTINGS_NONE = 0,     ///< nothing is stored: defaults
    CANOPY_PLC_SETTINGS_STORED = 1,   ///< what is stored
    CANOPY_PLC_SETTINGS_MENDED = 2,   ///< what is stored, one of the two copies is damaged or older
    CANOPY_PLC_SETTINGS_CORRUPT = 3,  ///< both copies are damaged: defaults
    CANOPY_PLC_SETTINGS_NOWHERE = 4,  ///< no memory for it: defaults
    CANOPY_PLC_SETTINGS_REFUSED = 5   ///< of a newer firmware or another device: defaults
};

/// How far the last storing is.
enum canopy_plc_settings_stored {
    CANOPY_PLC_STORE_NONE = 0,
    CANOPY_PLC_STORE_UNDER_WAY = 1,
    CANOPY_PLC_STORE_DONE = 2,
    CANOPY_PLC_STORE_FAILED = 3
};

/// Filled by the device whenever a client reads it.
struct canopy_plc_health {
    struct canopy_crash crash;  ///< the last one; its count is not shown from here
    uint32_t starts, crash_count, ram_passes, flash_passes, flash_crc, i2c_recoveries, scanner_lost_bytes;
    uint16_t tests, passed, failed;  ///< enum canopy_plc_selftest_bit
    uint16_t reset_reason;           ///< enum canopy_plc_reset_reason
    uint16_t scanner_failure;        ///< 1 + enum canopy_scan_failure; 0: none
    uint16_t stack_unused;
};

struct canopy_plc_settings {
    struct canopy_settings value;  ///< what clients write and command 4 stores
    uint32_t generation;
    uint16_t state;   ///< enum canopy_plc_settings_state
    uint16_t stored;  ///< enum canopy_plc_settings_stored
};

/// A member of a group's struct and the registers that show it: one is a uint16_t; two are a uint32_t or int32_t, high
/// word first; more are characters, two a register. Entries stand in the order of addresses, and a group has no gaps:
/// so an entry's address is where the one before it ends.
struct canopy_plc_entry {
    uint8_t offset;
    uint8_t shape;  ///< how many registers, and CANOPY_PLC_WRITABLE
};

#define CANOPY_PLC_WRITABLE 0x80U

struct canopy_plc_group {
    uint16_t address, end;  ///< from its first register to beyond its last
    uint16_t first;         ///< of its entries
};

#endif
