// What the files of lib/plc share with each other and with nobody else.
#ifndef CANOPY_PLC_INTERNAL_H
#define CANOPY_PLC_INTERNAL_H

#include <string.h>

#include "canopy_registers.h"
#include "lib/plc/plc.h"

#define CANOPY_PLC_NO_SLOT 0xFFU
#define CANOPY_PLC_BROKEN 0xFEU  ///< a hold whose envelope was withdrawn: shows nothing until it starts again

#define CANOPY_PLC_HEADER_END (CANOPY_REGISTER_FIRST_ROW_LOW + 2U)  ///< beyond the last register of the header

/// A stretch of registers: [first, end).
struct canopy_plc_range {
    uint32_t first, end;
};

static inline bool canopy_plc_overlap(struct canopy_plc_range range, uint32_t first, uint32_t end) {
    return range.first < end && first < range.end;
}

/// The snapshot from which this request of the client is to be answered, NULL for none. Starts, continues or renews
/// the hold and notes what the request shows of it.
const struct canopy_plc_slot *canopy_plc_hold(struct canopy_plc *plc, uint8_t client, struct canopy_plc_range range);

/// The header of a snapshot (NULL: of none) as registers. False if its scales are no normal floats.
bool canopy_plc_header(const struct canopy_plc *plc, const struct canopy_plc_slot *slot,
                       struct canopy_plc_envelope *to);

/// The extreme safe value: what a coefficient or height reads that is not known.
static inline int32_t canopy_plc_extreme(const struct canopy_plc *plc) {
    return plc->config.side == CANOPY_ABOVE ? INT32_MAX : INT32_MIN;
}

/// Evaluates the client's query on the newest envelope.
void canopy_plc_evaluate(struct canopy_plc *plc, uint8_t client);

/// The result of a query while there is no envelope.
void canopy_plc_unanswered(const struct canopy_plc *plc, struct canopy_plc_query *query);

/// The live status as a client is to see it.
void canopy_plc_live_now(const struct canopy_plc *plc, struct canopy_plc_live *to);

static inline void canopy_plc_put(uint8_t *to, uint16_t value) {
    to[0] = (uint8_t)(value >> 8);
    to[1] = (uint8_t)value;
}

#endif
