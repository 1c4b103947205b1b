/// Where the registers stand, and what a reader does with each: addresses from the generated header or registers.json.
#ifndef CANOPY_TOOLS_PLC_MAP_H
#define CANOPY_TOOLS_PLC_MAP_H

#include <stdbool.h>
#include <stdint.h>

#include "tools/common/fault.h"

enum plc_type { PLC_U16, PLC_U32, PLC_I32, PLC_F32 };

/// Every scalar register that this program knows: X(NAME, name, type, unit of its value).
#define PLC_ITEMS(X)                                                                                                   \
    X(MAGIC, magic, U32, "")                                                                                           \
    X(PROBE_U32, probe_u32, U32, "")                                                                                   \
    X(PROBE_F32, probe_f32, F32, "")                                                                                   \
    X(MAP_CRC, map_crc, U32, "")                                                                                       \
    X(FIRMWARE_VERSION, firmware_version, U32, "")                                                                     \
    X(MAP_VERSION, map_version, U16, "")                                                                               \
    X(CLIENTS, clients, U16, "")                                                                                       \
    X(CAPACITY, capacity, U32, "coefficients")                                                                         \
    X(HEARTBEAT, heartbeat, U16, "")                                                                                   \
    X(STATUS, status, U16, "")                                                                                         \
    X(AGE_MS, age_ms, U32, "ms")                                                                                       \
    X(SENSOR_FAULTS, sensor_faults, U16, "")                                                                           \
    X(COVERAGE_PCT, coverage_pct, U16, "%")                                                                            \
    X(STALE_AFTER_MS, stale_after_ms, U32, "ms")                                                                       \
    X(SEQUENCE, sequence, U32, "")                                                                                     \
    X(POINTS, points, U32, "")                                                                                         \
    X(SCALAR, scalar, U16, "")                                                                                         \
    X(SIDE, side, U16, "")                                                                                             \
    X(GRID_M, grid_m, U16, "")                                                                                         \
    X(GRID_N, grid_n, U16, "")                                                                                         \
    X(UNIT, unit, F32, "")                                                                                             \
    X(LSB, lsb, F32, "device units")                                                                                   \
    X(MARGIN, margin, I32, "lsb")                                                                                      \
    X(ORIGIN_X, origin_x, I32, "device units")                                                                         \
    X(ORIGIN_Y, origin_y, I32, "device units")                                                                         \
    X(ORIGIN_Z, origin_z, I32, "device units")                                                                         \
    X(PITCH_U, pitch_u, U32, "device units")                                                                           \
    X(PITCH_V, pitch_v, U32, "device units")                                                                           \
    X(AXIS_00, axis_00, I32, "2^-30")                                                                                  \
    X(AXIS_01, axis_01, I32, "2^-30")                                                                                  \
    X(AXIS_02, axis_02, I32, "2^-30")                                                                                  \
    X(AXIS_10, axis_10, I32, "2^-30")                                                                                  \
    X(AXIS_11, axis_11, I32, "2^-30")                                                                                  \
    X(AXIS_12, axis_12, I32, "2^-30")                                                                                  \
    X(AXIS_20, axis_20, I32, "2^-30")                                                                                  \
    X(AXIS_21, axis_21, I32, "2^-30")                                                                                  \
    X(AXIS_22, axis_22, I32, "2^-30")                                                                                  \
    X(BLOCK_COUNT, block_count, U16, "")                                                                               \
    X(COVERAGE_COUNT, coverage_count, U16, "")                                                                         \
    X(RX_FRAMES, rx_frames, U32, "")                                                                                   \
    X(RX_ERRORS, rx_errors, U32, "")                                                                                   \
    X(SCAN_ERRORS, scan_errors, U32, "")                                                                               \
    X(POINTS_REJECTED, points_rejected, U32, "")                                                                       \
    X(POINTS_ACCEPTED, points_accepted, U32, "")                                                                       \
    X(READINGS_INVALID, readings_invalid, U32, "")                                                                     \
    X(PROFILES, profiles, U32, "")                                                                                     \
    X(PROFILES_MISSED, profiles_missed, U32, "")                                                                       \
    X(PROFILES_TORN, profiles_torn, U32, "")                                                                           \
    X(PROFILES_SHORT, profiles_short, U32, "")                                                                         \
    X(PROFILES_STALE, profiles_stale, U32, "")                                                                         \
    X(PROFILES_REFUSED, profiles_refused, U32, "")                                                                     \
    X(INTRUSIONS, intrusions, U32, "")                                                                                 \
    X(PUBLICATIONS, publications, U32, "")                                                                             \
    X(WITHDRAWALS, withdrawals, U32, "")                                                                               \
    X(FITS_FAILED, fits_failed, U32, "")                                                                               \
    X(COMMANDS, commands, U32, "")                                                                                     \
    X(LOST_BYTES, lost_bytes, U32, "")                                                                                 \
    X(UPTIME_S, uptime_s, U32, "s")                                                                                    \
    X(CYCLE_US, cycle_us, U32, "us")                                                                                   \
    X(CYCLE_MAX_US, cycle_max_us, U32, "us")

enum plc_item {
#define PLC_ENUM(NAME, name, type, unit) PLC_##NAME,
    PLC_ITEMS(PLC_ENUM)
#undef PLC_ENUM
        PLC_ITEM_COUNT
};

struct plc_item_info {
    const char *name;
    enum plc_type type;
    const char *unit;
};

extern const struct plc_item_info plc_items[PLC_ITEM_COUNT];

/// A row of equal blocks: each a sequence (u32) and `words` - 2 registers more.
struct plc_series {
    uint16_t address, stride, words, most;
};

struct plc_map {
    uint16_t version;
    uint16_t address[PLC_ITEM_COUNT];
    struct plc_series blocks, coverage;
};

/// The map this program was built with.
void plc_map_built_in(struct plc_map *map);

/// The map of a registers.json. Every item must be there with its type.
bool plc_map_load(const char *path, struct plc_map *map, struct canopy_fault *fault);

static inline uint16_t plc_words(enum plc_type type) { return type == PLC_U16 ? 1 : 2; }

#endif
