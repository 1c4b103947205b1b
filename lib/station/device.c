#include "lib/station/serial.h"

#define CHUNK 64U  // bytes moved at once

static uint64_t time_of(const struct canopy_serial *serial) {
    return serial->config.clock.now_us(serial->config.clock.context);
}

static size_t words_of(const struct canopy_profile_table *table) {
    return table->heights_type == CANOPY_SCAN_U32 || table->heights_type == CANOPY_SCAN_I32 ? 2 : 1;
}

enum canopy_status canopy_serial_init(struct canopy_serial *serial, const struct canopy_serial_config *config,
                                      void *arena, size_t bytes) {
    const struct canopy_grid *grid = &config->station.grid;
    const size_t station_bytes =
        CANOPY_STATION_ARENA(grid->size[0], grid->size[1], grid->cells, config->station.lines, 1U);
    const size_t profile_bytes = CANOPY_PROFILE_ARENA(config->columns, words_of(config->table));
    struct canopy_arena cut;
    if (config->readings == 0 || config->budget == 0 || config->station.clients != 1) {
        return CANOPY_ARGUMENT;
    }
    enum canopy_status status = canopy_arena_open(&cut, arena, bytes, station_bytes + profile_bytes);
    if (status != CANOPY_OK) {
        return status;
    }
    *serial = (struct canopy_serial){.config = *config};
    const uint64_t now_us = time_of(serial);
    void *profile_arena = canopy_arena_take(&cut, profile_bytes);
    status = canopy_station_init(&serial->station, &config->station, cut.next, cut.left, now_us);
    if (status == CANOPY_OK) {
        const struct canopy_profile_config profile = {config->table, config->scanner.unit, config->columns};
        status = canopy_profile_init(&serial->driver, &profile, profile_arena, profile_bytes, now_us);
    }
    if (status == CANOPY_OK) {
        const struct canopy_modbus_rtu_client_config client = {.character_bits = config->scanner.character_bits,
                                                               .baud = config->scanner.baud,
                                                               .timeout_us = config->timeout_us};
        status = canopy_modbus_rtu_client_init(&serial->client, &client, now_us);
    }
    if (status == CANOPY_OK) {
        serial->bank = canopy_station_bank(&serial->station);
        const struct canopy_modbus_rtu_server_config server = {.bank = &serial->bank,
                                                               .unit = config->plc.unit,
                                                               .client = 0,
                                                               .character_bits = config->plc.character_bits,
                                                               .baud = config->plc.baud};
        status = canopy_modbus_rtu_server_init(&serial->server, &server);
    }
    if (status == CANOPY_OK && config->frame != NULL) {
        status = canopy_station_begin(&serial->station, config->frame);
    }
    serial->station.scan = canopy_profile_counters(&serial->driver);
    return status;
}

// ---- The PLC's line

static void serve_plc(struct canopy_serial *serial) {
    const struct canopy_stream *line = &serial->config.plc.stream;
    uint8_t bytes[CHUNK];
    size_t count;
    // Bounded by what the port holds: it cannot be filled faster than this empties it.
    while ((count = line->read(line->context, bytes, sizeof bytes)) > 0) {
        canopy_modbus_rtu_server_feed(&serial->server, bytes, count, time_of(serial));
    }
    const uint8_t *reply;
    const size_t length = canopy_modbus_rtu_server_poll(&serial->server, time_of(serial), &reply);
    if (length > 0) {
        const size_t sent = line->write(line->context, reply, length);
        canopy_modbus_rtu_server_sent(&serial->server, sent, time_of(serial));
    }
    serial->station.port.rx_frames = serial->server.rx_frames;
    serial->station.port.rx_errors = serial->server.rx_errors;
    serial->station.port.lost_bytes = line->lost(line->context);
}

// ---- The scanner's line

static void take_event(struct canopy_serial *serial, enum canopy_scan_event event) {
    switch (event) {
    case CANOPY_SCAN_PROFILE: serial->bad = false; break;
    case CANOPY_SCAN_SCENE:
        // Without a frame for it nothing of it is accepted: as bad as a description that makes no sense.
        serial->bad = serial->config.frame == NULL &&
                      canopy_station_begin_scene(&serial->station, canopy_profile_scene(&serial->driver)) != CANOPY_OK;
        break;
    case CANOPY_SCAN_REFUSED:
    case CANOPY_SCAN_STALE:
    case CANOPY_SCAN_DROPPED: serial->bad = true; break;
    default: break;
    }
    serial->station.scan_errors = canopy_profile_errors(&serial->driver);
}

// Silence, unless something came that was no answer.
static enum canopy_scan_failure why_timed_out(const struct canopy_serial *serial) {
    return serial->client.rx_errors != serial->client_errors ? CANOPY_SCAN_CRC : CANOPY_SCAN_TIMEOUT;
}

static void settle_request(struct canopy_serial *serial, uint64_t now_us) {
    uint16_t registers[CANOPY_SCAN_READ_MAX];
    size_t count;
    const enum canopy_modbus_outcome outcome = canopy_modbus_rtu_client_poll(&serial->client, now_us);
    if (outcome == CANOPY_MODBUS_PENDING) {
        return;
    }
    serial->asked = false;
    switch (outcome) {
    case CANOPY_MODBUS_DONE:
        count = canopy_modbus_rtu_client_registers(&serial->client, registers, CANOPY_SCAN_READ_MAX);
        take_event(serial, canopy_profile_answer(&serial->driver, registers, count, now_us));
        break;
    case CANOPY_MODBUS_REFUSED:
        take_event(serial, canopy_profile_failed(&serial->driver, CANOPY_SCAN_EXCEPTION, now_us));
        break;
    default: take_event(serial, canopy_profile_failed(&serial->driver, why_timed_out(serial), now_us)); break;
    }
}

static void ask_scanner(struct canopy_serial *serial, uint64_t now_us) {
    struct canopy_profile_request wanted;
    if (!canopy_profile_next(&serial->driver, now_us, &wanted)) {
        return;
    }
    const struct canopy_modbus_request request = {
        .unit = wanted.unit, .function = wanted.function, .address = wanted.address, .count = wanted.count};
    serial->client_errors = serial->client.rx_errors;
    if (canopy_modbus_rtu_client_start(&serial->client, &request) == CANOPY_OK) {
        serial->asked = true;
    } else {
        take_event(serial, canopy_profile_failed(&serial->driver, CANOPY_SCAN_LINK, now_us));
    }
}

static void poll_scanner(struct canopy_serial *serial) {
    const struct canopy_stream *line = &serial->config.scanner.stream;
    uint8_t bytes[CHUNK];
    size_t count;
    while ((count = line->read(line->context, bytes, sizeof bytes)) > 0) {
        canopy_modbus_rtu_client_feed(&serial->client, bytes, count, time_of(serial));
    }
    const uint64_t now_us = time_of(serial);
    if (serial->asked) {
        settle_request(serial, now_us);
    }
    if (!serial->asked) {
        ask_scanner(serial, now_us);
    }
    const uint8_t *pending;
    count = canopy_modbus_rtu_client_pending(&serial->client, now_us, &pending);
    if (count > 0) {
        canopy_modbus_rtu_client_sent(&serial->client, line->write(line->context, pending, count), time_of(serial));
    }
    serial->station.sensor_faults = serial->bad || canopy_profile_stale(&serial->driver, now_us) ? 1U : 0U;
}

// ---- The cycle

static void measure(struct canopy_serial *serial, uint64_t begin_us) {
    const uint64_t took_us = time_of(serial) - begin_us;
    struct canopy_station_port *port = &serial->station.port;
    port->cycle_us = (uint32_t)took_us;
    if (port->cycle_us > port->cycle_max_us) {
        port->cycle_max_us = port->cycle_us;
    }
}

static uint64_t sooner(uint64_t a, uint64_t b) { return a < b ? a : b; }

uint64_t canopy_serial_step(struct canopy_serial *serial) {
    const uint64_t begin_us = time_of(serial);
    serve_plc(serial);
    poll_scanner(serial);
    const bool taking =
        canopy_station_profile(&serial->station, &serial->driver, &serial->column, serial->config.readings, begin_us);
    canopy_station_step(&serial->station, serial->config.budget, begin_us);
    measure(serial, begin_us);

    const uint8_t stage = serial->station.stage;
    if (taking || (stage != CANOPY_STATION_WAITING && stage != CANOPY_STATION_RESTING)) {
        return begin_us;
    }
    struct canopy_profile_request wanted;
    if (!serial->asked && canopy_profile_next(&serial->driver, begin_us, &wanted)) {
        return begin_us;
    }
    // What else is due, silences before requests and their timeouts, may wait a millisecond.
    return sooner(begin_us + 1000U, canopy_modbus_rtu_server_due(&serial->server));
}
