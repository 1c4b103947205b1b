#include "lib/station/rtu_link.h"

#define CHUNK 64U  // bytes moved at once

static uint64_t time_of(const struct canopy_rtu_link *link) { return link->clock.now_us(link->clock.context); }

static void receive(struct canopy_rtu_link *link) {
    uint8_t bytes[CHUNK];
    size_t count;
    // Bounded by what the port holds: it cannot be filled faster than this empties it.
    while ((count = link->stream.read(link->stream.context, bytes, sizeof bytes)) > 0) {
        canopy_modbus_rtu_client_feed(&link->client, bytes, count, time_of(link));
    }
}

static void transmit(struct canopy_rtu_link *link) {
    const uint8_t *pending;
    const size_t count = canopy_modbus_rtu_client_pending(&link->client, time_of(link), &pending);
    if (count > 0) {
        const size_t taken = link->stream.write(link->stream.context, pending, count);
        canopy_modbus_rtu_client_sent(&link->client, taken, time_of(link));
    }
}

static bool begin(void *context, const struct canopy_profile_request *request, uint64_t now_us) {
    struct canopy_rtu_link *link = context;
    const struct canopy_modbus_request asked = {
        .unit = request->unit, .function = request->function, .address = request->address, .count = request->count};
    (void)now_us;
    if (canopy_modbus_rtu_client_start(&link->client, &asked) != CANOPY_OK) {
        return false;
    }
    link->errors = link->client.rx_errors;
    link->asked = true;
    transmit(link);
    return true;
}

// Silence, unless something came that was no answer.
static enum canopy_scan_failure why_timed_out(const struct canopy_rtu_link *link) {
    return link->client.rx_errors != link->errors ? CANOPY_SCAN_CRC : CANOPY_SCAN_TIMEOUT;
}

static enum canopy_scan_link_state settle(struct canopy_rtu_link *link, struct canopy_scan_answer *answer) {
    const enum canopy_modbus_outcome outcome = canopy_modbus_rtu_client_poll(&link->client, time_of(link));
    if (outcome == CANOPY_MODBUS_PENDING) {
        return CANOPY_SCAN_LINK_PENDING;
    }
    link->asked = false;
    if (outcome == CANOPY_MODBUS_DONE) {
        answer->count = canopy_modbus_rtu_client_registers(&link->client, answer->registers, CANOPY_SCAN_READ_MAX);
        return CANOPY_SCAN_LINK_DONE;
    }
    answer->failure = outcome == CANOPY_MODBUS_REFUSED ? CANOPY_SCAN_EXCEPTION : why_timed_out(link);
    return CANOPY_SCAN_LINK_FAILED;
}

static enum canopy_scan_link_state poll(void *context, uint64_t now_us, struct canopy_scan_answer *answer) {
    struct canopy_rtu_link *link = context;
    (void)now_us;
    receive(link);
    const enum canopy_scan_link_state state = link->asked ? settle(link, answer) : CANOPY_SCAN_LINK_PENDING;
    transmit(link);
    return state;
}

static void count(void *context, struct canopy_scan_link_counters *to) {
    const struct canopy_rtu_link *link = context;
    *to = (struct canopy_scan_link_counters){.lost_bytes = link->stream.lost(link->stream.context)};
}

enum canopy_status canopy_rtu_link_init(struct canopy_rtu_link *link, const struct canopy_rtu_link_config *config) {
    *link = (struct canopy_rtu_link){.clock = config->clock, .stream = config->stream};
    const struct canopy_modbus_rtu_client_config client = {
        .character_bits = config->character_bits, .baud = config->baud, .timeout_us = config->timeout_us};
    return canopy_modbus_rtu_client_init(&link->client, &client, time_of(link));
}

struct canopy_scan_link canopy_rtu_link(struct canopy_rtu_link *link) {
    return (struct canopy_scan_link){.context = link, .begin = begin, .poll = poll, .count = count};
}
