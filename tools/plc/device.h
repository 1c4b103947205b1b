/// What a canopy device says of itself, as values.
#ifndef CANOPY_TOOLS_PLC_DEVICE_H
#define CANOPY_TOOLS_PLC_DEVICE_H

#include <stdbool.h>
#include <stdint.h>

#include "tools/common/fault.h"
#include "tools/common/surrogate.h"
#include "tools/plc/link.h"
#include "tools/plc/map.h"

#define PLC_VALID 1u
#define PLC_INTRUSION 2u
#define PLC_STALE 4u

struct plc_device {
    struct plc_link *link;
    const struct plc_map *map;
    uint32_t value[PLC_ITEM_COUNT];  ///< bits; u16 zero-extended
    uint64_t restarts;               ///< envelopes begun again, because the sequence changed
};

/// Checks that this is a canopy device with this map and word order.
bool plc_device_identify(struct plc_device *device, struct canopy_fault *fault);

/// Reads the items from `first` to `last` into `value`, in as few requests as their addresses allow.
bool plc_device_fetch(struct plc_device *device, enum plc_item first, enum plc_item last, struct canopy_fault *fault);

/// Reads one whole envelope under one sequence and makes a surrogate of it: from registers alone. Repeats when the
/// sequence changes on the way. A fault if nothing is published. Free the surrogate after success.
bool plc_device_envelope(struct plc_device *device, struct canopy_surrogate *surrogate, struct canopy_fault *fault);

float plc_float(uint32_t bits);

/// The value of an item as a number.
double plc_number(const struct plc_device *device, enum plc_item item);

#endif
