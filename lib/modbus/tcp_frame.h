/// The receiving half of Modbus TCP, common to server and client. Private to lib/modbus.
#ifndef CANOPY_MODBUS_TCP_FRAME_H
#define CANOPY_MODBUS_TCP_FRAME_H

#include "lib/modbus/bytes.h"
#include "lib/modbus/tcp.h"

enum { CANOPY_MODBUS_TCP_LENGTH_AT = 4, CANOPY_MODBUS_TCP_UNIT_AT = 6, CANOPY_MODBUS_TCP_PDU_AT = 7 };

/// Starts a frame.
void canopy_modbus_tcp_frame_clear(struct canopy_modbus_tcp_frame *frame);
/// Bytes that are needed before anything more can be said; at least 1 unless the frame is whole or lost.
size_t canopy_modbus_tcp_frame_room(const struct canopy_modbus_tcp_frame *frame);
/// True when adu holds a whole frame.
bool canopy_modbus_tcp_frame_whole(const struct canopy_modbus_tcp_frame *frame);
/// Takes bytes up to the end of the frame, skipping what is none; returns how many. Adds what was skipped to *errors.
size_t canopy_modbus_tcp_frame_feed(struct canopy_modbus_tcp_frame *frame, const uint8_t *bytes, size_t length,
                                    uint32_t *errors);
/// Length of the PDU of a whole frame.
static inline size_t canopy_modbus_tcp_frame_pdu_length(const struct canopy_modbus_tcp_frame *frame) {
    return frame->have - (size_t)CANOPY_MODBUS_TCP_PDU_AT;
}
/// Writes the header in front of a PDU of `length` bytes; returns the length of the whole.
size_t canopy_modbus_tcp_frame_head(uint8_t *adu, uint16_t transaction, uint8_t unit, size_t length);

#endif
