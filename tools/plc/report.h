/// What this program prints.
#ifndef CANOPY_TOOLS_PLC_REPORT_H
#define CANOPY_TOOLS_PLC_REPORT_H

#include "tools/plc/device.h"

/// Everything, an item a line; or one JSON object.
void report_status(const struct plc_device *device, bool json);

/// One line on how things are; or one JSON object in a line.
void report_watch(const struct plc_device *device, bool json);

/// One line on the envelope that was read; or one JSON object in a line.
void report_envelope(const struct plc_device *device, const struct canopy_surrogate *surrogate, const char *path,
                     bool json);

/// "valid", "valid intrusion", "stale", …, "none" of the status bits.
const char *report_bits(uint32_t status, char text[48]);

#endif
