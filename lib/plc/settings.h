/// What an installer may change of a device, and how it is stored.
///
/// The one table of settings is the group `settings` of lib/plc/registers.csv: addresses, ranges and defaults. A PLC
/// writes the device's own copy through those registers; stored (lib/plc/store.h) it is in force at the next start.
///
/// As bytes a record is the values in the table's order, high byte first, as their registers show them. The table only
/// grows at its end, so a record of an older firmware is a shorter one, and what it lacks has its default. A record
/// that is longer, of a newer version, or in which any value is outside of its range is refused as a whole.
#ifndef CANOPY_SETTINGS_H
#define CANOPY_SETTINGS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/// Raised when a setting's meaning changes, not when settings are added.
#define CANOPY_SETTINGS_VERSION 1U

/// Meaning, unit, range and default of each: docs/registers.md under `set_` and its name.
struct canopy_settings {
    uint32_t plc_baud, scanner_baud;
    uint32_t scanner_timeout_ms, stale_after_ms, interval_ms, refresh_ms, watchdog_ms;
    uint16_t plc_unit, plc_format;
    uint16_t scanner_unit, scanner_i2c, scanner_format;
    uint16_t side;
};

/// One line of the generated table.
struct canopy_settings_item {
    uint32_t low, high, initial;
    uint8_t offset;  ///< of the member in struct canopy_settings
    uint8_t words;   ///< 1: uint16_t, 2: uint32_t
};

/// What the table says. A board may give its device other defaults, within the ranges.
void canopy_settings_defaults(struct canopy_settings *to);

/// Whether all values are in their ranges, but those of the bits in `fixed` (1 << CANOPY_SETTING_...) what they are in
/// `now`.
bool canopy_settings_are_allowed(const struct canopy_settings *settings, const struct canopy_settings *now,
                                 uint32_t fixed);

/// Writes CANOPY_SETTINGS_BYTES (gen/canopy_registers.h) bytes.
void canopy_settings_encode(const struct canopy_settings *settings, uint8_t *to);

/// Reads a record of `version` and `length` bytes over what `settings` holds: the defaults. False, and nothing changed:
/// it is refused, see above; `fixed` as in canopy_settings_are_allowed.
bool canopy_settings_decode(struct canopy_settings *settings, const uint8_t *from, size_t length, uint16_t version,
                            uint32_t fixed);

#endif
