#include "lib/modbus/bytes.h"
#include "lib/modbus/crc.h"
#include "lib/modbus/rtu.h"
#include "lib/modbus/rtu_time.h"

#include <string.h>

_Static_assert(sizeof(struct canopy_modbus_rtu_server) <= 368, "RAM of an RTU server");

enum state {
    COLLECTING,  // buffer[0, have) are received bytes; a frame may start at each of marks, and at burst
    DEAF,        // out of step: everything up to the next silence is ignored
    REPLYING     // buffer[0, have) is a reply, sent of it gone
};

// What is known about the time after the last byte.
enum moment { NO_SILENCE, SILENCE, PAUSE_OVER };

enum kind { NO_FRAME, OURS, NEIGHBOURS_REQUEST, NEIGHBOURS_RESPONSE, NEIGHBOURS };

enum {
    ADU_EXTRA = 3,  // unit and CRC
    ADU_MIN = 4,
    ANY_LENGTH = 0  // awaited_length when it cannot be told
};

struct frame {
    enum kind kind;
    size_t length;
};

// ---------------------------------------------------------------------------------------------------------------------
// Which response is awaited on the line. Only consulted to decide whether bytes that are a whole request may still
// become a longer response.

static void await_nothing(struct canopy_modbus_rtu_server *server) {
    server->awaited.unit = 0;  // from which nothing comes
}

// Length of the frame that answers a neighbour's request.
static uint16_t answer_length(const uint8_t *pdu) {
    switch (pdu[0]) {
    case 0x01:
    case 0x02: return (uint16_t)(5u + (canopy_modbus_get16(pdu + 3) + 7u) / 8u);
    case 0x03:
    case 0x04:
    case 0x17: return (uint16_t)(5u + 2u * canopy_modbus_get16(pdu + 3));
    default: return ANY_LENGTH;
    }
}

static void await_answer_to(struct canopy_modbus_rtu_server *server, const uint8_t *adu) {
    server->awaited.unit = adu[0];
    server->awaited.function = adu[1];
    server->awaited.length = answer_length(adu + 1);
}

// May a response that starts like this, and has this length (0 if that is not known yet), be the one?
static bool is_awaited(const struct canopy_modbus_rtu_server *server, const uint8_t *adu, size_t length) {
    if (adu[0] != server->awaited.unit || (adu[1] & 0x7Fu) != server->awaited.function)
        return false;
    return (adu[1] & 0x80u) || length == 0 || server->awaited.length == ANY_LENGTH || length == server->awaited.length;
}

// ---------------------------------------------------------------------------------------------------------------------
// Frames

// Length of the frame around a PDU: 0 not known yet, more than the buffer: none.
static size_t adu_length(size_t pdu_length) {
    if (pdu_length == CANOPY_MODBUS_LENGTH_MORE)
        return 0;
    return pdu_length + ADU_EXTRA;
}

static bool is_whole(const uint8_t *adu, size_t there, size_t length) {
    return length >= ADU_MIN && length <= there && canopy_modbus_crc_ok(adu, length);
}

static bool is_pending(size_t there, size_t length) {
    return length == 0 || (length > there && length <= CANOPY_MODBUS_RTU_ADU_MAX);
}

static struct frame our_frame(const uint8_t *adu, size_t there) {
    const size_t length = adu_length(canopy_modbus_request_length(adu + 1, there - 1));
    if (is_whole(adu, there, length))
        return (struct frame){OURS, length};
    return (struct frame){NO_FRAME, 0};
}

// A neighbour's bytes are a request or a response. The longer whole one counts; a request stands back while the
// response that is awaited may still come.
static struct frame neighbours_frame(const struct canopy_modbus_rtu_server *server, const uint8_t *adu, size_t there) {
    const size_t request = adu_length(canopy_modbus_request_length(adu + 1, there - 1));
    const size_t response = adu_length(canopy_modbus_response_length(adu + 1, there - 1));
    const bool is_request = is_whole(adu, there, request);
    const bool is_response = is_whole(adu, there, response);
    const bool awaited = is_awaited(server, adu, response);
    if (is_response && !(is_request && (request > response || (request == response && !awaited))))
        return (struct frame){NEIGHBOURS_RESPONSE, response};
    if (is_request && !(awaited && is_pending(there, response)))
        return (struct frame){NEIGHBOURS_REQUEST, request};
    return (struct frame){NO_FRAME, 0};
}

// What the `there` bytes at `adu`, up to a silence, are as one frame, whatever its function says about its length.
//
// Zeros behind a right CRC leave it right. So one in 256 frames has a right CRC without its last byte too: what is too
// short for its function may still go on, and is a frame only when the pause is over. And what has a right CRC at the
// length of its function is no longer frame because zeros follow.
static struct frame frame_of_all(const struct canopy_modbus_rtu_server *server, const uint8_t *adu, size_t there,
                                 bool ours, enum moment moment) {
    if (!canopy_modbus_crc_ok(adu, there))
        return (struct frame){NO_FRAME, 0};
    const size_t request_length = adu_length(canopy_modbus_request_length(adu + 1, there - 1));
    if (ours) {
        const bool goes_on = is_pending(there, request_length) && moment != PAUSE_OVER;
        const bool ended = request_length < there && is_whole(adu, there, request_length);
        return goes_on || ended ? (struct frame){NO_FRAME, 0} : (struct frame){OURS, there};
    }
    const bool request = request_length == there;
    const bool response = adu_length(canopy_modbus_response_length(adu + 1, there - 1)) == there;
    if (response && (!request || is_awaited(server, adu, there)))
        return (struct frame){NEIGHBOURS_RESPONSE, there};
    return (struct frame){request ? NEIGHBOURS_REQUEST : NEIGHBOURS, there};
}

// The frame that starts at `start`.
static struct frame frame_at(const struct canopy_modbus_rtu_server *server, size_t start, enum moment moment) {
    const uint8_t *adu = server->buffer + start;
    const size_t there = server->have - start;
    if (there < ADU_MIN)
        return (struct frame){NO_FRAME, 0};
    const bool ours = adu[0] == server->config.unit || adu[0] == 0;
    struct frame frame = {NO_FRAME, 0};
    if (moment != NO_SILENCE)
        frame = frame_of_all(server, adu, there, ours, moment);
    if (frame.kind == NO_FRAME)
        frame = ours ? our_frame(adu, there) : neighbours_frame(server, adu, there);
    return frame;
}

// Remembers what a frame means for the next one.
static void follow(struct canopy_modbus_rtu_server *server, size_t start, enum kind kind) {
    if (kind == NEIGHBOURS_REQUEST)
        await_answer_to(server, server->buffer + start);
    else
        await_nothing(server);
}

// ---------------------------------------------------------------------------------------------------------------------
// What was collected

static void clear(struct canopy_modbus_rtu_server *server, enum state state) {
    server->have = 0;
    server->sent = 0;
    server->burst = 0;
    server->mark_count = 0;
    server->state = (uint8_t)state;
}

static void drop(struct canopy_modbus_rtu_server *server, enum state state) {
    server->rx_errors++;
    await_nothing(server);
    clear(server, state);
}

// Removes the first `count` bytes; a frame may start behind them.
static void shift(struct canopy_modbus_rtu_server *server, size_t count) {
    uint8_t kept = 0;
    if (server->burst > count) {
        server->burst = (uint16_t)(server->burst - count);
        for (uint8_t i = 1; i < server->mark_count; i++)
            if (server->marks[i] > count)
                server->marks[++kept] = (uint16_t)(server->marks[i] - count);
        server->marks[0] = 0;
        kept++;
    } else {
        server->burst = 0;
    }
    server->mark_count = kept;
    server->have = (uint16_t)(server->have - count);
    memmove(server->buffer, server->buffer + count, server->have);
}

// Carries out a request that nobody waits for: to all, or followed by another frame.
static void carry_out(struct canopy_modbus_rtu_server *server, size_t start, size_t length) {
    server->rx_frames++;
    (void)canopy_modbus_serve(server->config.bank, server->config.client, true, server->buffer + start + 1,
                              length - ADU_EXTRA);
}

static void answer(struct canopy_modbus_rtu_server *server, size_t start, size_t length) {
    uint8_t *adu = server->buffer;
    server->rx_frames++;
    memmove(adu, adu + start, length);
    const size_t reply =
        canopy_modbus_serve(server->config.bank, server->config.client, false, adu + 1, length - ADU_EXTRA);
    clear(server, REPLYING);
    server->have = (uint16_t)canopy_modbus_crc_append(adu, 1 + reply);
}

// True when frames that start at `start` reach the last byte exactly. Changes only what is awaited.
static bool is_chain(struct canopy_modbus_rtu_server *server, size_t start, enum moment moment) {
    while (start < server->have) {
        const struct frame frame = frame_at(server, start, moment);
        if (frame.kind == NO_FRAME)
            return false;
        follow(server, start, frame.kind);
        start += frame.length;
    }
    return true;
}

static void carry_out_chain(struct canopy_modbus_rtu_server *server, size_t start, enum moment moment) {
    while (start < server->have) {
        const struct frame frame = frame_at(server, start, moment);
        follow(server, start, frame.kind);
        if (frame.kind == OURS) {
            if (start + frame.length == server->have && server->buffer[start] != 0) {
                answer(server, start, frame.length);
                return;
            }
            carry_out(server, start, frame.length);
        }
        start += frame.length;
    }
    clear(server, COLLECTING);
}

// Tries the chain that starts at `start`: first looks, then does.
static bool try_chain(struct canopy_modbus_rtu_server *server, size_t start, enum moment moment) {
    const struct canopy_modbus_rtu_awaited before = server->awaited;
    const bool good = is_chain(server, start, moment);
    server->awaited = before;
    if (!good)
        return false;
    if (start > 0)
        server->rx_errors++;
    carry_out_chain(server, start, moment);
    return true;
}

static bool try_chains(struct canopy_modbus_rtu_server *server, enum moment moment) {
    if (server->have > server->burst && try_chain(server, server->burst, moment))
        return true;
    for (uint8_t i = 0; i < server->mark_count; i++)
        if (try_chain(server, server->marks[i], moment))
            return true;
    return false;
}

// A silence ended the last burst: is there a chain of frames up to it?
static void silence(struct canopy_modbus_rtu_server *server) {
    if (server->state == DEAF)
        clear(server, COLLECTING);
    if (server->state != COLLECTING || server->have == server->burst || try_chains(server, SILENCE))
        return;
    // None yet. Where this burst starts is remembered; if there are too many, the oldest ones and the last one are.
    if (server->mark_count == CANOPY_MODBUS_RTU_MARKS)
        server->mark_count--;
    server->marks[server->mark_count++] = server->burst;
    server->burst = server->have;
}

// The line has been silent for that long.
static void silent_for(struct canopy_modbus_rtu_server *server, uint64_t gap_us) {
    if (gap_us < server->config.silence_us)
        return;
    silence(server);
    if (gap_us > server->config.pause_us && server->state == COLLECTING && server->have > 0 &&
        !try_chains(server, PAUSE_OVER))
        drop(server, COLLECTING);
}

// Where a frame may start next after the beginning of the buffer; 0 for nowhere.
static size_t next_start(const struct canopy_modbus_rtu_server *server) {
    return server->mark_count > 1 ? server->marks[1] : server->burst;
}

// The buffer is full without a silence: no frame that starts at 0 can still grow. Is there one to be taken? Not with a
// silence inside: its last bytes may be the first of another. And a request to us only if the next frame is there,
// right behind it, to prove it.
static struct frame settled_frame(const struct canopy_modbus_rtu_server *server) {
    const struct frame none = {NO_FRAME, 0};
    const size_t next = next_start(server);
    const struct frame frame = frame_at(server, 0, NO_SILENCE);
    size_t length = frame.length;
    if (frame.kind == OURS) {
        const struct frame proof = frame_at(server, length, NO_SILENCE);
        if (proof.kind == NO_FRAME)
            return none;
        length += proof.length;
    }
    return next > 0 && next < length ? none : frame;
}

// Takes the frame at the beginning of a full buffer, or goes on to the next place where one may start.
static void make_room(struct canopy_modbus_rtu_server *server) {
    const struct frame frame = settled_frame(server);
    const size_t next = next_start(server);
    if (frame.kind != NO_FRAME) {
        follow(server, 0, frame.kind);
        if (frame.kind == OURS)
            carry_out(server, 0, frame.length);
        shift(server, frame.length);
    } else if (next > 0) {
        server->rx_errors++;
        await_nothing(server);
        shift(server, next);
    } else {
        drop(server, DEAF);
    }
}

static void collect(struct canopy_modbus_rtu_server *server, uint8_t byte) {
    if (server->state == COLLECTING && server->have == CANOPY_MODBUS_RTU_ADU_MAX)
        make_room(server);
    if (server->state == COLLECTING)
        server->buffer[server->have++] = byte;
}

// ---------------------------------------------------------------------------------------------------------------------

enum canopy_status canopy_modbus_rtu_server_init(struct canopy_modbus_rtu_server *server,
                                                 const struct canopy_modbus_rtu_server_config *config) {
    if (!config->bank || !config->bank->read || !config->bank->write || config->unit < 1 || config->unit > 247 ||
        !canopy_modbus_rtu_bits_ok(config->character_bits))
        return CANOPY_ARGUMENT;
    struct canopy_modbus_rtu_server_config whole = *config;
    if (whole.silence_us == 0)
        whole.silence_us = canopy_modbus_rtu_silence_us(whole.baud);
    if (whole.pause_us == 0)
        whole.pause_us = whole.silence_us > CANOPY_MODBUS_RTU_PAUSE_US ? whole.silence_us : CANOPY_MODBUS_RTU_PAUSE_US;
    if (whole.pause_us < whole.silence_us)
        return CANOPY_ARGUMENT;
    memset(server, 0, sizeof *server);
    server->config = whole;
    server->character_q8 = canopy_modbus_rtu_character_q8(whole.baud, whole.character_bits);
    await_nothing(server);
    return CANOPY_OK;
}

void canopy_modbus_rtu_server_feed(struct canopy_modbus_rtu_server *server, const uint8_t *bytes, size_t length,
                                   uint64_t now_us) {
    if (length == 0)
        return;
    const uint64_t wire_us = canopy_modbus_rtu_wire_us(server->character_q8, length);
    // Two times cut to microseconds can lose one of the microseconds between them.
    silent_for(server, canopy_modbus_rtu_since(server->last_us + wire_us, now_us + 1));
    server->last_us = now_us;
    if (server->state == REPLYING) {
        if (server->sent > 0)
            return;
        clear(server, COLLECTING);
    }
    for (size_t i = 0; i < length; i++)
        collect(server, bytes[i]);
}

size_t canopy_modbus_rtu_server_poll(struct canopy_modbus_rtu_server *server, uint64_t now_us, const uint8_t **reply) {
    silent_for(server, canopy_modbus_rtu_since(server->last_us, now_us));
    *reply = server->buffer + server->sent;
    return server->state == REPLYING ? (size_t)server->have - server->sent : 0;
}

void canopy_modbus_rtu_server_sent(struct canopy_modbus_rtu_server *server, size_t count, uint64_t now_us) {
    if (server->state != REPLYING || count == 0)
        return;
    const size_t left = (size_t)server->have - server->sent;
    server->sent = (uint16_t)(server->sent + (count < left ? count : left));
    server->last_us = now_us;
    if (server->sent == server->have)
        clear(server, COLLECTING);
}

bool canopy_modbus_rtu_server_is_replying(const struct canopy_modbus_rtu_server *server) {
    return server->state == REPLYING;
}

uint64_t canopy_modbus_rtu_server_due(const struct canopy_modbus_rtu_server *server) {
    if (server->state == REPLYING)
        return server->last_us;
    if (server->state == DEAF || server->have == 0)
        return CANOPY_MODBUS_RTU_NEVER;
    if (server->have > server->burst)
        return server->last_us + server->config.silence_us;
    return server->last_us + server->config.pause_us + 1;
}
