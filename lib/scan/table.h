/// What a profile scanner on Modbus or I2C looks like, as one const table: a new device is a new table, not new code.
///
/// A profile scanner keeps its newest profile in registers: a *header* (sequence number, position, how many readings
/// are valid, …), the *heights*, one a column, and perhaps a second copy of the sequence number behind them. What does
/// not change from profile to profile (columns, x start and step, scale, bounding box of the scene) may stand in the
/// header, in a *description* block of its own that is read once, or here as a constant.
///
/// Device units: every length is a whole int32 of one unit, chosen so that x and y are exact (`multiplier`).
#ifndef CANOPY_SCAN_TABLE_H
#define CANOPY_SCAN_TABLE_H

#include <stdbool.h>
#include <stdint.h>

#define CANOPY_SCAN_READ_MAX 125  ///< registers one Modbus read can carry

enum canopy_scan_type { CANOPY_SCAN_U16 = 0, CANOPY_SCAN_I16, CANOPY_SCAN_U32, CANOPY_SCAN_I32 };

/// Registers of one 32-bit value: ABCD has the high word at the lower address, CDAB the low word.
enum canopy_scan_order { CANOPY_SCAN_ABCD = 0, CANOPY_SCAN_CDAB };

enum canopy_scan_where {
    CANOPY_SCAN_ABSENT = 0,  ///< the device does not say, and nothing is assumed
    CANOPY_SCAN_CONSTANT,    ///< the device does not say; `constant` is the value
    CANOPY_SCAN_HEADER,      ///< at `offset` registers from the start of the header
    CANOPY_SCAN_DESCRIPTION  ///< at `offset` registers from the start of the description
};

/// One number of the device. A register value times `multiplier` (0 counts as 1) is device units; a constant is taken
/// as it is. A product outside int32 makes the block that holds it invalid.
struct canopy_scan_field {
    uint8_t where;  ///< enum canopy_scan_where
    uint8_t type;   ///< enum canopy_scan_type
    uint16_t offset;
    int32_t multiplier;
    int32_t constant;
};

/// Consecutive registers that one read fetches. `count` 0: there is no such block.
struct canopy_scan_block {
    uint16_t address;  ///< protocol address, from 0
    uint16_t count;    ///< at most CANOPY_SCAN_READ_MAX
};

/// Where the sequence number stands a second time. Without it, the driver reads the first one again after the heights.
enum canopy_scan_trailer {
    CANOPY_SCAN_NO_TRAILER = 0,
    CANOPY_SCAN_TRAILER_FOLLOWS,  ///< in the register behind the last height
    CANOPY_SCAN_TRAILER_FIXED     ///< at `trailer_address`, whatever the number of columns
};

/// What stands behind the data of one I2C transfer. It is taken over every byte of the transfer in front of it: address
/// and write bit, pointer, count and tag, address and read bit, data.
enum canopy_scan_check {
    CANOPY_SCAN_UNCHECKED = 0,  ///< nothing: what noise does to data is not seen. For wires of centimetres only
    CANOPY_SCAN_CRC8,           ///< one byte, SMBus' packet error code: 1 of 256 disturbed transfers passes
    CANOPY_SCAN_CRC16           ///< two bytes, CRC-16/MODBUS, low byte first
};

/// The device as a register file on I2C (lib/scan/i2c_link.h). One transfer is: START, address and write bit, pointer,
/// perhaps a count, perhaps a tag; repeated START, address and read bit, registers, check; STOP.
struct canopy_scan_i2c {
    uint8_t address;         ///< 7 bits, 8 to 119, unless the program gives another; 0: the device is not on I2C
    uint8_t pointer_bytes;   ///< 1 or 2
    bool pointer_low_first;  ///< of 2 bytes
    uint8_t pointer_step;    ///< pointer counts a register: 1, or 2 where the pointer counts bytes
    bool counted;            ///< behind the pointer: a byte with the number of registers that will be read
    bool tagged;             ///< then: a byte that the check covers and that is another one in each transfer
    bool low_first;          ///< bytes of a register; false: high byte first
    uint8_t check;           ///< enum canopy_scan_check
    bool stop_between;       ///< STOP and START instead of the repeated START
    uint8_t read_max;        ///< registers in one transfer; 0: as many as `read_max` of the table
};

#define CANOPY_SCAN_INVALID_MAX 4

/// A device. Every offset must lie inside its block; canopy_scan_table_ok() checks the whole table.
struct canopy_profile_table {
    const char *name;
    const char *title;  ///< one line for people

    uint8_t function;  ///< 3 or 4: how everything is read on Modbus
    uint8_t order;     ///< enum canopy_scan_order
    uint8_t read_max;  ///< registers the device gives in one read, 1 to CANOPY_SCAN_READ_MAX
    struct canopy_scan_i2c i2c;

    struct canopy_scan_block description;  ///< read once, and again when the device may have changed
    struct canopy_scan_field magic;        ///< must read `magic_value`, else the device is refused; ABSENT: not checked
    uint32_t magic_value;
    struct canopy_scan_field description_id;         ///< in the description: changes with any register of it
    struct canopy_scan_field header_description_id;  ///< in the header: the same number. Both or neither.

    struct canopy_scan_block header;
    struct canopy_scan_field sequence;  ///< in the header, U16 or U32: one more with each profile, wrapping
    bool sequence_zero_is_none;         ///< 0 means "no profile yet", and wrapping skips it
    struct canopy_scan_field position;  ///< y of the profile
    struct canopy_scan_field valid;     ///< how many readings of the profile are valid; ABSENT: not promised
    struct canopy_scan_field columns;   ///< readings a profile

    struct canopy_scan_field x_start;   ///< x of column 0
    struct canopy_scan_field x_step;    ///< x from one column to the next: not 0, may be negative
    struct canopy_scan_field z_offset;  ///< z of the height value 0
    struct canopy_scan_field z_step;    ///< device units a height count (numerator): 1 to 2^30; ABSENT: 1
    int32_t z_divisor;  ///< denominator, 1 to 2^30; 0 counts as 1. With 1, every device point is exact. Otherwise z is
                        ///< rounded down (floor) and an inexact reading carries one more unit of uncertainty.
    struct canopy_scan_field uncertainty;  ///< half-width of a reading in device units; ABSENT: 0

    uint16_t heights_address;
    uint8_t heights_type;                      ///< enum canopy_scan_type
    uint8_t invalid_count;                     ///< at most CANOPY_SCAN_INVALID_MAX
    int64_t invalid[CANOPY_SCAN_INVALID_MAX];  ///< height values that mean "no reading"
    int64_t height_low, height_high;  ///< outside of these a height is no reading; both 0: the type's whole range

    uint8_t trailer;       ///< enum canopy_scan_trailer
    uint8_t trailer_type;  ///< U16 or U32: the low bits of the sequence number
    uint16_t trailer_address;

    /// The scene, where the device knows it: the box that holds every reading of a sweep. All of `low` and `high` or
    /// none; then `unit`, the IEEE-754 binary32 of metres, millimetres, … a device unit, and the profiles of a sweep.
    struct canopy_scan_field low[3], high[3];
    struct canopy_scan_field profiles;
    struct canopy_scan_field unit;

    uint32_t poll_us;   ///< from one look for a new profile to the next
    uint32_t retry_us;  ///< from a failed read to its repetition
    uint32_t stale_us;  ///< without a new profile for so long, the scanner is stale
    uint8_t retries;    ///< repetitions of one failed read before its profile is given up
};

/// The built-in device of that name, or NULL. Names are lower case.
const struct canopy_profile_table *canopy_profile_find(const char *name);

/// The built-in devices, `index` from 0; NULL behind the last.
const struct canopy_profile_table *canopy_profile_at(unsigned index);

/// Whether a table makes sense: every field inside its block, every number in its range.
bool canopy_scan_table_ok(const struct canopy_profile_table *table);

#endif
