/// The generic profile map: what canopy's simulator serves, and a proposal for devices that are free to choose.
///
/// Protocol addresses from 0, FC03 and FC04 alike, 32-bit values high word first (docs/scanners.md has the table).
/// A profile of 400 columns is 406 registers in a row: 4 reads, 864 bytes on an RTU wire.
///
/// ## The same on I2C
///
/// Up to 400 kHz, address 0x29 unless another is set. A read of registers is one transfer:
///
///     START  A<<1  pointer high  pointer low  count  tag
///     repeated START  A<<1|1  count x (register high, register low)  CRC low  CRC high  STOP
///
/// - pointer: the address of the first register, as on Modbus. count: registers that will be read, 1 to 125.
/// - tag: any byte; the master gives another one in each transfer.
/// - CRC: CRC-16/MODBUS (polynomial 0x8005 reflected, start 0xFFFF) over all bytes in front of it as they stand above,
///   both address bytes included. The device takes it over what *it* received. So an answer to another pointer, count,
///   tag or address does not pass: neither when a bit of the request was turned on the wire, nor when a device that
///   missed a request answers an earlier one again, be it for the same registers.
/// - The registers of one answer are of one moment: the device copies them when it is addressed for reading, or before.
///   It may hold the clock meanwhile, for a few milliseconds at most.
/// - A request is answered once. A read without a request before it, and one that cannot be served (a count that is 0
///   or over 125, registers that are not there), is not acknowledged at A<<1|1. A device that cannot refuse its address
///   gives bytes 0xFF, the CRC among them inverted. Reading beyond the CRC gives 0xFF.
/// - STOP and START instead of the repeated START are as good.
///
/// Example: registers 0 and 1, the magic, tag 1: 52 00 00 02 01 | 53 43 4E 50 53 7D 3F.
/// A profile of 400 columns is 4 transfers, together 844 bytes of 9 bits: 19 ms at 400 kHz.
#ifndef CANOPY_SCAN_GENERIC_H
#define CANOPY_SCAN_GENERIC_H

#include "lib/scan/table.h"

#define CANOPY_GENERIC_I2C_ADDRESS 0x29u
#define CANOPY_GENERIC_MAGIC 0x434E5053u  ///< "CNPS"
#define CANOPY_GENERIC_VERSION 1u
#define CANOPY_GENERIC_INVALID 0xFFFFu  ///< height of a column without reading

/// Description block: constant as long as `GENERIC_ID` is.
enum canopy_generic_description {
    CANOPY_GENERIC_DESCRIPTION = 0,     ///< address
    CANOPY_GENERIC_D_MAGIC = 0,         ///< u32
    CANOPY_GENERIC_D_VERSION = 2,       ///< u16
    CANOPY_GENERIC_D_ID = 3,            ///< u16, changes with any register of the block
    CANOPY_GENERIC_D_COLUMNS = 4,       ///< u16
    CANOPY_GENERIC_D_PROFILES = 5,      ///< u16, of a sweep; 0: unknown
    CANOPY_GENERIC_D_X_START = 6,       ///< i32, device units
    CANOPY_GENERIC_D_X_STEP = 8,        ///< i32
    CANOPY_GENERIC_D_Z_OFFSET = 10,     ///< i32, z of height 0
    CANOPY_GENERIC_D_Z_STEP = 12,       ///< u16, device units a height count
    CANOPY_GENERIC_D_UNCERTAINTY = 13,  ///< u16, device units
    CANOPY_GENERIC_D_LOW = 14,          ///< 3 x i32: x, y, z of the box of all readings
    CANOPY_GENERIC_D_HIGH = 20,         ///< 3 x i32
    CANOPY_GENERIC_D_UNIT = 26,         ///< f32: one device unit
    CANOPY_GENERIC_D_COUNT = 28
};

/// The newest profile.
enum canopy_generic_profile {
    CANOPY_GENERIC_PROFILE = 64,    ///< address of the header
    CANOPY_GENERIC_P_SEQUENCE = 0,  ///< u16, 0: none yet; wraps from 65535 to 1
    CANOPY_GENERIC_P_ID = 1,        ///< u16, the description's id
    CANOPY_GENERIC_P_POSITION = 2,  ///< i32, y in device units
    CANOPY_GENERIC_P_VALID = 4,     ///< u16, columns with a reading
    CANOPY_GENERIC_P_COUNT = 5,     ///< registers of the header
    CANOPY_GENERIC_HEIGHTS = CANOPY_GENERIC_PROFILE + CANOPY_GENERIC_P_COUNT  ///< u16 each, then the sequence again
};

extern const struct canopy_profile_table canopy_profile_generic;

#endif
