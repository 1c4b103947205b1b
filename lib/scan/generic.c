#include "lib/scan/generic.h"

#define IN_DESCRIPTION(place, kind)                                                                                    \
    { .where = CANOPY_SCAN_DESCRIPTION, .type = (kind), .offset = (place) }
#define IN_HEADER(place, kind)                                                                                         \
    { .where = CANOPY_SCAN_HEADER, .type = (kind), .offset = (place) }

const struct canopy_profile_table canopy_profile_generic = {
    .name = "generic",
    .title = "generic profile map (the simulator's)",
    .function = 3,
    .order = CANOPY_SCAN_ABCD,
    .read_max = CANOPY_SCAN_READ_MAX,
    .i2c = {.address = CANOPY_GENERIC_I2C_ADDRESS,
            .pointer_bytes = 2,
            .pointer_step = 1,
            .counted = true,
            .tagged = true,
            .check = CANOPY_SCAN_CRC16},

    .description = {CANOPY_GENERIC_DESCRIPTION, CANOPY_GENERIC_D_COUNT},
    .magic = IN_DESCRIPTION(CANOPY_GENERIC_D_MAGIC, CANOPY_SCAN_U32),
    .magic_value = CANOPY_GENERIC_MAGIC,
    .description_id = IN_DESCRIPTION(CANOPY_GENERIC_D_ID, CANOPY_SCAN_U16),
    .header_description_id = IN_HEADER(CANOPY_GENERIC_P_ID, CANOPY_SCAN_U16),

    .header = {CANOPY_GENERIC_PROFILE, CANOPY_GENERIC_P_COUNT},
    .sequence = IN_HEADER(CANOPY_GENERIC_P_SEQUENCE, CANOPY_SCAN_U16),
    .sequence_zero_is_none = true,
    .position = IN_HEADER(CANOPY_GENERIC_P_POSITION, CANOPY_SCAN_I32),
    .valid = IN_HEADER(CANOPY_GENERIC_P_VALID, CANOPY_SCAN_U16),
    .columns = IN_DESCRIPTION(CANOPY_GENERIC_D_COLUMNS, CANOPY_SCAN_U16),

    .x_start = IN_DESCRIPTION(CANOPY_GENERIC_D_X_START, CANOPY_SCAN_I32),
    .x_step = IN_DESCRIPTION(CANOPY_GENERIC_D_X_STEP, CANOPY_SCAN_I32),
    .z_offset = IN_DESCRIPTION(CANOPY_GENERIC_D_Z_OFFSET, CANOPY_SCAN_I32),
    .z_step = IN_DESCRIPTION(CANOPY_GENERIC_D_Z_STEP, CANOPY_SCAN_U16),
    .z_divisor = 1,
    .uncertainty = IN_DESCRIPTION(CANOPY_GENERIC_D_UNCERTAINTY, CANOPY_SCAN_U16),

    .heights_address = CANOPY_GENERIC_HEIGHTS,
    .heights_type = CANOPY_SCAN_U16,
    .invalid_count = 1,
    .invalid = {CANOPY_GENERIC_INVALID},
    .trailer = CANOPY_SCAN_TRAILER_FOLLOWS,
    .trailer_type = CANOPY_SCAN_U16,

    .low = {IN_DESCRIPTION(CANOPY_GENERIC_D_LOW, CANOPY_SCAN_I32),
            IN_DESCRIPTION(CANOPY_GENERIC_D_LOW + 2, CANOPY_SCAN_I32),
            IN_DESCRIPTION(CANOPY_GENERIC_D_LOW + 4, CANOPY_SCAN_I32)},
    .high = {IN_DESCRIPTION(CANOPY_GENERIC_D_HIGH, CANOPY_SCAN_I32),
             IN_DESCRIPTION(CANOPY_GENERIC_D_HIGH + 2, CANOPY_SCAN_I32),
             IN_DESCRIPTION(CANOPY_GENERIC_D_HIGH + 4, CANOPY_SCAN_I32)},
    .profiles = IN_DESCRIPTION(CANOPY_GENERIC_D_PROFILES, CANOPY_SCAN_U16),
    .unit = IN_DESCRIPTION(CANOPY_GENERIC_D_UNIT, CANOPY_SCAN_U32),

    .poll_us = 2000,
    .retry_us = 20000,
    .stale_us = 1000000,
    .retries = 2,
};
