#include "lib/modbus/crc.h"
#include "lib/modbus/rtu.h"
#include "lib/modbus/rtu_time.h"

#include <string.h>

enum state {
    IDLE,
    QUEUED,      // waiting for silence, or sending: buffer[0, have) is the request
    AWAITING,    // buffer[0, have) is what came of the response
    DEAF,        // awaiting, but out of step until the next silence
    TURNAROUND,  // a broadcast was sent
    DONE,        // buffer[0, have) is the response
    REFUSED,
    TIMED_OUT
};

enum { ADU_EXTRA = 3, WRITE_RESPONSE = 8 };

enum canopy_status canopy_modbus_rtu_client_init(struct canopy_modbus_rtu_client *client,
                                                 const struct canopy_modbus_rtu_client_config *config,
                                                 uint64_t now_us) {
    if (config->timeout_us == 0 || !canopy_modbus_rtu_bits_ok(config->character_bits))
        return CANOPY_ARGUMENT;
    memset(client, 0, sizeof *client);
    client->config = *config;
    if (client->config.silence_us == 0)
        client->config.silence_us = canopy_modbus_rtu_silence_us(config->baud);
    if (client->config.turnaround_us == 0)
        client->config.turnaround_us = CANOPY_MODBUS_RTU_TURNAROUND_US;
    client->character_q8 = canopy_modbus_rtu_character_q8(config->baud, config->character_bits);
    client->last_us = now_us;
    return CANOPY_OK;
}

static bool is_pending(const struct canopy_modbus_rtu_client *client) {
    return client->state >= QUEUED && client->state <= TURNAROUND;
}

enum canopy_status canopy_modbus_rtu_client_start(struct canopy_modbus_rtu_client *client,
                                                  const struct canopy_modbus_request *request) {
    if (is_pending(client) || request->unit > 247)
        return CANOPY_ARGUMENT;
    const size_t length = canopy_modbus_request_write(request, client->buffer + 1, &client->expected);
    if (length == 0)
        return CANOPY_ARGUMENT;
    client->unit = request->unit;
    client->buffer[0] = request->unit;
    client->have = (uint16_t)canopy_modbus_crc_append(client->buffer, 1 + length);
    client->sent = 0;
    client->deadline_us = 0;
    client->state = QUEUED;
    return CANOPY_OK;
}

size_t canopy_modbus_rtu_client_pending(const struct canopy_modbus_rtu_client *client, uint64_t now_us,
                                        const uint8_t **bytes) {
    *bytes = client->buffer + client->sent;
    if (client->state != QUEUED ||
        (client->sent == 0 && canopy_modbus_rtu_since(client->last_us, now_us) < client->config.silence_us))
        return 0;
    return (size_t)client->have - client->sent;
}

// The longest the awaited response can be on the wire.
static size_t response_length(const struct canopy_modbus_rtu_client *client) {
    if (client->expected.function == CANOPY_MODBUS_IDENTIFY)
        return CANOPY_MODBUS_RTU_ADU_MAX;
    return client->expected.bytes ? 5u + client->expected.bytes : (size_t)WRITE_RESPONSE;
}

static void await(struct canopy_modbus_rtu_client *client) {
    client->have = 0;
    client->burst = 0;
    client->state = client->unit ? AWAITING : TURNAROUND;
    client->deadline_us = client->last_us + client->config.turnaround_us;
    if (client->unit)
        client->deadline_us = client->last_us + client->config.timeout_us +
                              canopy_modbus_rtu_wire_us(client->character_q8, response_length(client));
}

void canopy_modbus_rtu_client_sent(struct canopy_modbus_rtu_client *client, size_t count, uint64_t now_us) {
    if (client->state != QUEUED || count == 0)
        return;
    const size_t left = (size_t)client->have - client->sent;
    const size_t gone = count < left ? count : left;
    client->sent = (uint16_t)(client->sent + gone);
    // Handed over is not sent: they leave one after the other from now on.
    if (client->last_us < now_us)
        client->last_us = now_us;
    client->last_us += canopy_modbus_rtu_wire_us(client->character_q8, gone);
    if (client->sent == client->have)
        await(client);
}

// What the bytes so far are to the request; PENDING while more must come.
static enum canopy_modbus_outcome look(const struct canopy_modbus_rtu_client *client, size_t *length) {
    const uint8_t *adu = client->buffer;
    if (client->have < 2)
        return client->have == 1 && adu[0] != client->unit ? CANOPY_MODBUS_TIMED_OUT : CANOPY_MODBUS_PENDING;
    if (adu[0] != client->unit || (adu[1] & 0x7Fu) != client->expected.function)
        return CANOPY_MODBUS_TIMED_OUT;
    const size_t pdu_length = canopy_modbus_response_length(adu + 1, client->have - 1u);
    if (pdu_length > CANOPY_MODBUS_PDU_MAX)
        return CANOPY_MODBUS_TIMED_OUT;
    *length = pdu_length + ADU_EXTRA;
    if (pdu_length == CANOPY_MODBUS_LENGTH_MORE || client->have < *length)
        return client->have < CANOPY_MODBUS_RTU_ADU_MAX ? CANOPY_MODBUS_PENDING : CANOPY_MODBUS_TIMED_OUT;
    if (!canopy_modbus_crc_ok(adu, *length))
        return CANOPY_MODBUS_TIMED_OUT;
    switch (canopy_modbus_response_check(&client->expected, adu + 1, pdu_length)) {
    case CANOPY_MODBUS_ANSWER: return CANOPY_MODBUS_DONE;
    case CANOPY_MODBUS_EXCEPTION: return CANOPY_MODBUS_REFUSED;
    default: return CANOPY_MODBUS_TIMED_OUT;
    }
}

// Looks at what came; what is no answer is dropped up to the last silence.
static void judge(struct canopy_modbus_rtu_client *client) {
    size_t length = 0;
    enum canopy_modbus_outcome outcome = look(client, &length);
    while (outcome == CANOPY_MODBUS_TIMED_OUT && client->burst > 0) {
        client->rx_errors++;
        client->have = (uint16_t)(client->have - client->burst);
        memmove(client->buffer, client->buffer + client->burst, client->have);
        client->burst = 0;
        outcome = look(client, &length);
    }
    if (outcome == CANOPY_MODBUS_TIMED_OUT) {
        client->rx_errors++;
        client->state = DEAF;
    } else if (outcome != CANOPY_MODBUS_PENDING) {
        client->rx_frames++;
        client->have = (uint16_t)length;
        client->state = outcome == CANOPY_MODBUS_DONE ? DONE : REFUSED;
    }
}

static void silence(struct canopy_modbus_rtu_client *client) {
    if (client->state == DEAF) {
        client->state = AWAITING;
        client->have = 0;
        client->burst = 0;
    } else if (client->state == AWAITING) {
        client->burst = client->have;
    } else if (client->state != QUEUED || client->sent == 0) {
        client->rx_errors++;  // a burst that nobody asked for
    }
}

void canopy_modbus_rtu_client_feed(struct canopy_modbus_rtu_client *client, const uint8_t *bytes, size_t length,
                                   uint64_t now_us) {
    if (length == 0)
        return;
    const uint64_t wire_us = canopy_modbus_rtu_wire_us(client->character_q8, length);
    // Two times cut to microseconds can lose one of the microseconds between them.
    if (canopy_modbus_rtu_since(client->last_us, now_us + 1) >= client->config.silence_us + wire_us)
        silence(client);
    if (client->last_us < now_us)
        client->last_us = now_us;
    for (size_t i = 0; i < length && client->state == AWAITING; i++) {
        client->buffer[client->have++] = bytes[i];
        judge(client);
    }
}

enum canopy_modbus_outcome canopy_modbus_rtu_client_poll(struct canopy_modbus_rtu_client *client, uint64_t now_us) {
    if (client->state == QUEUED && client->sent == 0 && client->deadline_us == 0)
        client->deadline_us = now_us + client->config.timeout_us + client->config.silence_us;
    const bool late = now_us >= client->deadline_us;
    if (late && client->state == TURNAROUND) {
        client->state = DONE;
    } else if (late &&
               (client->state == AWAITING || client->state == DEAF || (client->state == QUEUED && client->sent == 0))) {
        if (client->state == AWAITING && client->have > 0)
            client->rx_errors++;
        client->state = TIMED_OUT;
    }
    switch (client->state) {
    case IDLE: return CANOPY_MODBUS_IDLE;
    case DONE: return CANOPY_MODBUS_DONE;
    case REFUSED: return CANOPY_MODBUS_REFUSED;
    case TIMED_OUT: return CANOPY_MODBUS_TIMED_OUT;
    default: return CANOPY_MODBUS_PENDING;
    }
}

void canopy_modbus_rtu_client_abandon(struct canopy_modbus_rtu_client *client) { client->state = IDLE; }

const uint8_t *canopy_modbus_rtu_client_response(const struct canopy_modbus_rtu_client *client, size_t *length) {
    const bool there = (client->state == DONE && client->unit != 0) || client->state == REFUSED;
    *length = there ? (size_t)client->have - ADU_EXTRA : 0;
    return client->buffer + 1;
}

size_t canopy_modbus_rtu_client_registers(const struct canopy_modbus_rtu_client *client, uint16_t *to, size_t count) {
    if (client->state != DONE)
        return 0;
    return canopy_modbus_registers(&client->expected, client->buffer + 1, to, count);
}

uint8_t canopy_modbus_rtu_client_exception(const struct canopy_modbus_rtu_client *client) {
    return client->state == REFUSED ? client->buffer[2] : 0;
}
