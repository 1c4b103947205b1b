#include "lib/modbus/tcp_frame.h"

#include <string.h>

enum canopy_status canopy_modbus_tcp_client_init(struct canopy_modbus_tcp_client *client,
                                                 const struct canopy_modbus_tcp_client_config *config) {
    if (config->timeout_us == 0)
        return CANOPY_ARGUMENT;
    memset(client, 0, sizeof *client);
    client->config = *config;
    client->state = CANOPY_MODBUS_IDLE;
    return CANOPY_OK;
}

enum canopy_status canopy_modbus_tcp_client_start(struct canopy_modbus_tcp_client *client,
                                                  const struct canopy_modbus_request *request, uint64_t now_us) {
    if (client->state == CANOPY_MODBUS_PENDING || client->frame.lost)
        return CANOPY_ARGUMENT;
    const size_t length =
        canopy_modbus_request_write(request, client->out + CANOPY_MODBUS_TCP_PDU_AT, &client->expected);
    if (length == 0)
        return CANOPY_ARGUMENT;
    // The last answer was kept in the frame for the caller; a frame that is still under way must be taken to its end.
    if (canopy_modbus_tcp_frame_whole(&client->frame))
        canopy_modbus_tcp_frame_clear(&client->frame);
    client->transaction++;
    client->unit = request->unit;
    client->request = (uint16_t)canopy_modbus_tcp_frame_head(client->out, client->transaction, request->unit, length);
    client->sent = 0;
    client->deadline_us = now_us + client->config.timeout_us;
    client->state = CANOPY_MODBUS_PENDING;
    return CANOPY_OK;
}

size_t canopy_modbus_tcp_client_pending(const struct canopy_modbus_tcp_client *client, const uint8_t **bytes) {
    *bytes = client->out + client->sent;
    return client->state == CANOPY_MODBUS_PENDING ? (size_t)client->request - client->sent : 0;
}

void canopy_modbus_tcp_client_sent(struct canopy_modbus_tcp_client *client, size_t count, uint64_t now_us) {
    const size_t left = (size_t)client->request - client->sent;
    if (client->state != CANOPY_MODBUS_PENDING || left == 0)
        return;
    client->sent = (uint16_t)(client->sent + (count < left ? count : left));
    client->deadline_us = now_us + client->config.timeout_us;
}

size_t canopy_modbus_tcp_client_room(const struct canopy_modbus_tcp_client *client) {
    return client->state == CANOPY_MODBUS_PENDING ? canopy_modbus_tcp_frame_room(&client->frame) : 0;
}

// A whole frame: the answer, or something that is dropped.
static void judge(struct canopy_modbus_tcp_client *client) {
    const uint8_t *adu = client->frame.adu;
    const enum canopy_modbus_verdict verdict = canopy_modbus_response_check(
        &client->expected, adu + CANOPY_MODBUS_TCP_PDU_AT, canopy_modbus_tcp_frame_pdu_length(&client->frame));
    if (canopy_modbus_get16(adu) != client->transaction || adu[CANOPY_MODBUS_TCP_UNIT_AT] != client->unit ||
        client->sent < client->request || verdict == CANOPY_MODBUS_MISMATCH) {
        client->rx_errors++;
        canopy_modbus_tcp_frame_clear(&client->frame);
        return;
    }
    client->rx_frames++;
    client->state = verdict == CANOPY_MODBUS_ANSWER ? CANOPY_MODBUS_DONE : CANOPY_MODBUS_REFUSED;
}

size_t canopy_modbus_tcp_client_feed(struct canopy_modbus_tcp_client *client, const uint8_t *bytes, size_t length) {
    size_t taken = 0;
    while (client->state == CANOPY_MODBUS_PENDING && taken < length) {
        taken += canopy_modbus_tcp_frame_feed(&client->frame, bytes + taken, length - taken, &client->rx_errors);
        if (canopy_modbus_tcp_frame_whole(&client->frame))
            judge(client);
    }
    return taken;
}

enum canopy_modbus_outcome canopy_modbus_tcp_client_poll(struct canopy_modbus_tcp_client *client, uint64_t now_us) {
    if (client->state == CANOPY_MODBUS_PENDING && (client->frame.lost || now_us >= client->deadline_us)) {
        client->state = CANOPY_MODBUS_TIMED_OUT;
        // Half a request is on its way: whatever is sent next would be taken for its rest.
        if (client->sent > 0 && client->sent < client->request)
            client->frame.lost = true;
    }
    return (enum canopy_modbus_outcome)client->state;
}

bool canopy_modbus_tcp_client_lost(const struct canopy_modbus_tcp_client *client) { return client->frame.lost; }

const uint8_t *canopy_modbus_tcp_client_response(const struct canopy_modbus_tcp_client *client, size_t *length) {
    const bool there = client->state == CANOPY_MODBUS_DONE || client->state == CANOPY_MODBUS_REFUSED;
    *length = there ? canopy_modbus_tcp_frame_pdu_length(&client->frame) : 0;
    return client->frame.adu + CANOPY_MODBUS_TCP_PDU_AT;
}

size_t canopy_modbus_tcp_client_registers(const struct canopy_modbus_tcp_client *client, uint16_t *to, size_t count) {
    if (client->state != CANOPY_MODBUS_DONE)
        return 0;
    return canopy_modbus_registers(&client->expected, client->frame.adu + CANOPY_MODBUS_TCP_PDU_AT, to, count);
}

uint8_t canopy_modbus_tcp_client_exception(const struct canopy_modbus_tcp_client *client) {
    return client->state == CANOPY_MODBUS_REFUSED ? client->frame.adu[CANOPY_MODBUS_TCP_PDU_AT + 1] : 0;
}
