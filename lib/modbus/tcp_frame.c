#include "lib/modbus/tcp_frame.h"

#include <string.h>

enum { HEAD = 6, LENGTH_MIN = 2, LENGTH_MAX = 1 + CANOPY_MODBUS_PDU_MAX };

static size_t stated_length(const struct canopy_modbus_tcp_frame *frame) {
    return canopy_modbus_get16(frame->adu + CANOPY_MODBUS_TCP_LENGTH_AT);
}

void canopy_modbus_tcp_frame_clear(struct canopy_modbus_tcp_frame *frame) { frame->have = 0; }

bool canopy_modbus_tcp_frame_whole(const struct canopy_modbus_tcp_frame *frame) {
    return frame->have > HEAD && frame->have == HEAD + stated_length(frame);
}

size_t canopy_modbus_tcp_frame_room(const struct canopy_modbus_tcp_frame *frame) {
    if (frame->lost)
        return 0;
    if (frame->skip > 0)
        return frame->skip;
    if (frame->have < HEAD)
        return (size_t)HEAD - frame->have;
    return HEAD + stated_length(frame) - frame->have;
}

// The header is there: is it one of ours? What is not is skipped by the length it states.
static void judge_head(struct canopy_modbus_tcp_frame *frame, uint32_t *errors) {
    const size_t length = stated_length(frame);
    const bool modbus = frame->adu[2] == 0 && frame->adu[3] == 0;
    if (modbus && length >= LENGTH_MIN && length <= LENGTH_MAX)
        return;
    *errors += 1;
    frame->have = 0;
    if (length > LENGTH_MAX)
        frame->lost = true;
    else
        frame->skip = (uint16_t)length;
}

size_t canopy_modbus_tcp_frame_feed(struct canopy_modbus_tcp_frame *frame, const uint8_t *bytes, size_t length,
                                    uint32_t *errors) {
    size_t taken = 0;
    while (taken < length && !canopy_modbus_tcp_frame_whole(frame)) {
        if (frame->lost)
            return length;
        const size_t room = canopy_modbus_tcp_frame_room(frame);
        const size_t count = room < length - taken ? room : length - taken;
        if (frame->skip > 0) {
            frame->skip = (uint16_t)(frame->skip - count);
        } else {
            memcpy(frame->adu + frame->have, bytes + taken, count);
            frame->have = (uint16_t)(frame->have + count);
            if (frame->have == HEAD)
                judge_head(frame, errors);
        }
        taken += count;
    }
    return taken;
}

size_t canopy_modbus_tcp_frame_head(uint8_t *adu, uint16_t transaction, uint8_t unit, size_t length) {
    canopy_modbus_put16(adu, transaction);
    canopy_modbus_put16(adu + 2, 0);
    canopy_modbus_put16(adu + CANOPY_MODBUS_TCP_LENGTH_AT, (uint16_t)(length + 1));
    adu[CANOPY_MODBUS_TCP_UNIT_AT] = unit;
    return CANOPY_MODBUS_TCP_PDU_AT + length;
}
