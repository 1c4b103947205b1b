#include "lib/modbus/tcp_frame.h"

#include <string.h>

enum canopy_status canopy_modbus_tcp_server_init(struct canopy_modbus_tcp_server *server,
                                                 const struct canopy_modbus_tcp_server_config *config) {
    if (!config->bank || !config->bank->read || !config->bank->write)
        return CANOPY_ARGUMENT;
    memset(server, 0, sizeof *server);
    server->config = *config;
    return CANOPY_OK;
}

size_t canopy_modbus_tcp_server_room(const struct canopy_modbus_tcp_server *server) {
    return server->reply ? 0 : canopy_modbus_tcp_frame_room(&server->frame);
}

static bool is_for_us(const struct canopy_modbus_tcp_server *server, uint8_t unit) {
    return server->config.any_unit || unit == server->config.unit || unit == 0 || unit == 255;
}

// A whole request becomes its reply where it stands.
static void answer(struct canopy_modbus_tcp_server *server) {
    struct canopy_modbus_tcp_frame *frame = &server->frame;
    uint8_t *adu = frame->adu;
    if (!is_for_us(server, adu[CANOPY_MODBUS_TCP_UNIT_AT])) {
        canopy_modbus_tcp_frame_clear(frame);
        return;
    }
    server->rx_frames++;
    const size_t length =
        canopy_modbus_serve(server->config.bank, server->config.client, false, adu + CANOPY_MODBUS_TCP_PDU_AT,
                            canopy_modbus_tcp_frame_pdu_length(frame));
    server->reply =
        (uint16_t)canopy_modbus_tcp_frame_head(adu, canopy_modbus_get16(adu), adu[CANOPY_MODBUS_TCP_UNIT_AT], length);
    server->sent = 0;
}

size_t canopy_modbus_tcp_server_feed(struct canopy_modbus_tcp_server *server, const uint8_t *bytes, size_t length) {
    size_t taken = 0;
    while (!server->reply && taken < length) {
        taken += canopy_modbus_tcp_frame_feed(&server->frame, bytes + taken, length - taken, &server->rx_errors);
        if (canopy_modbus_tcp_frame_whole(&server->frame))
            answer(server);
    }
    return taken;
}

size_t canopy_modbus_tcp_server_pending(const struct canopy_modbus_tcp_server *server, const uint8_t **bytes) {
    *bytes = server->frame.adu + server->sent;
    return (size_t)server->reply - server->sent;
}

void canopy_modbus_tcp_server_sent(struct canopy_modbus_tcp_server *server, size_t count) {
    const size_t left = (size_t)server->reply - server->sent;
    server->sent = (uint16_t)(server->sent + (count < left ? count : left));
    if (server->reply && server->sent == server->reply) {
        server->reply = 0;
        server->sent = 0;
        canopy_modbus_tcp_frame_clear(&server->frame);
    }
}

bool canopy_modbus_tcp_server_lost(const struct canopy_modbus_tcp_server *server) { return server->frame.lost; }
