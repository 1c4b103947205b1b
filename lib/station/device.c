#include "lib/station/device.h"

#define CHUNK 64U  // bytes moved at once

static uint64_t time_of(const struct canopy_device *device) { return device->clock.now_us(device->clock.context); }

static size_t words_of(const struct canopy_profile_table *table) {
    return table->heights_type == CANOPY_SCAN_U32 || table->heights_type == CANOPY_SCAN_I32 ? 2 : 1;
}

enum canopy_status canopy_device_init(struct canopy_device *device, const struct canopy_device_config *config,
                                      void *arena, size_t bytes) {
    const struct canopy_grid *grid = &config->station.grid;
    const struct canopy_device_scanner *scanner = &config->scanner;
    const size_t station_bytes =
        CANOPY_STATION_ARENA(grid->size[0], grid->size[1], grid->cells, config->station.lines, 1U);
    const size_t profile_bytes = CANOPY_PROFILE_ARENA(scanner->columns, words_of(scanner->table));
    struct canopy_arena cut;
    if (config->readings == 0 || config->budget == 0 || config->station.clients != 1 ||
        (config->frame == NULL && scanner->table->low[0].where == CANOPY_SCAN_ABSENT)) {
        return CANOPY_ARGUMENT;
    }
    enum canopy_status status = canopy_arena_open(&cut, arena, bytes, station_bytes + profile_bytes);
    if (status != CANOPY_OK) {
        return status;
    }
    *device = (struct canopy_device){.framed = config->frame != NULL,
                                     .readings = config->readings,
                                     .budget = config->budget,
                                     .clock = config->clock,
                                     .link = scanner->link,
                                     .plc = config->plc.stream};
    const uint64_t now_us = time_of(device);
    void *profile_arena = canopy_arena_take(&cut, profile_bytes);
    status = canopy_station_init(&device->station, &config->station, cut.next, cut.left, now_us);
    if (status == CANOPY_OK) {
        const struct canopy_profile_config profile = {scanner->table, scanner->unit, scanner->columns};
        status = canopy_profile_init_known(&device->driver, &profile, profile_arena, profile_bytes, now_us);
    }
    if (status == CANOPY_OK) {
        device->bank = canopy_station_bank(&device->station);
        const struct canopy_modbus_rtu_server_config server = {.bank = &device->bank,
                                                               .unit = config->plc.unit,
                                                               .client = 0,
                                                               .character_bits = config->plc.character_bits,
                                                               .baud = config->plc.baud};
        status = canopy_modbus_rtu_server_init(&device->server, &server);
    }
    if (status == CANOPY_OK && config->frame != NULL) {
        status = canopy_station_begin(&device->station, config->frame);
    }
    device->station.scan = canopy_profile_counters(&device->driver);
    return status;
}

void canopy_device_keep(struct canopy_device *device, struct canopy_health *health) {
    device->health = health;
    canopy_health_attach(health, &device->station.plc, &device->station.port, device->station.scan);
}

// ---- The PLC

static void serve_plc(struct canopy_device *device) {
    const struct canopy_stream *line = &device->plc;
    uint8_t bytes[CHUNK];
    size_t count;
    // Bounded by what the port holds: it cannot be filled faster than this empties it.
    while ((count = line->read(line->context, bytes, sizeof bytes)) > 0) {
        canopy_modbus_rtu_server_feed(&device->server, bytes, count, time_of(device));
    }
    const uint8_t *reply;
    const size_t length = canopy_modbus_rtu_server_poll(&device->server, time_of(device), &reply);
    if (length > 0) {
        const size_t sent = line->write(line->context, reply, length);
        canopy_modbus_rtu_server_sent(&device->server, sent, time_of(device));
    }
    device->station.port.rx_frames = device->server.rx_frames;
    device->station.port.rx_errors = device->server.rx_errors;
    device->station.port.lost_bytes = line->lost(line->context);
}

// ---- The scanner

static void take_event(struct canopy_device *device, enum canopy_scan_event event) {
    switch (event) {
    case CANOPY_SCAN_PROFILE: device->bad = false; break;
    case CANOPY_SCAN_SCENE:
        // Without a frame for it nothing of it is accepted: as bad as a description that makes no sense.
        device->bad = !device->framed &&
                      canopy_station_begin_scene(&device->station, canopy_profile_scene(&device->driver)) != CANOPY_OK;
        break;
    case CANOPY_SCAN_REFUSED:
    case CANOPY_SCAN_STALE:
    case CANOPY_SCAN_DROPPED: device->bad = true; break;
    default: break;
    }
    device->station.scan_errors = canopy_profile_errors(&device->driver);
}

// What the read that is under way has come to, if it is over.
static enum canopy_scan_event hear_scanner(struct canopy_device *device, uint64_t now_us) {
    const struct canopy_scan_link *link = &device->link;
    struct canopy_scan_answer answer;
    switch (link->poll(link->context, now_us, &answer)) {
    case CANOPY_SCAN_LINK_DONE:
        device->asked = false;
        return canopy_profile_answer(&device->driver, answer.registers, answer.count, now_us);
    case CANOPY_SCAN_LINK_FAILED:
        device->asked = false;
        return canopy_profile_failed(&device->driver, answer.failure, now_us);
    default: return CANOPY_SCAN_NOTHING;
    }
}

static void ask_scanner(struct canopy_device *device, uint64_t now_us) {
    const struct canopy_scan_link *link = &device->link;
    struct canopy_profile_request wanted;
    if (!canopy_profile_next(&device->driver, now_us, &wanted)) {
        return;
    }
    device->asked = link->begin(link->context, &wanted, now_us);
    if (!device->asked) {
        take_event(device, canopy_profile_failed(&device->driver, CANOPY_SCAN_LINK, now_us));
    }
}

static void poll_scanner(struct canopy_device *device) {
    const struct canopy_scan_link *link = &device->link;
    const uint64_t now_us = time_of(device);
    const bool asked = device->asked;
    const enum canopy_scan_event event = hear_scanner(device, now_us);
    if (asked && !device->asked) {
        take_event(device, event);
    }
    if (!device->asked) {
        ask_scanner(device, now_us);
    }
    device->station.sensor_faults = device->bad || canopy_profile_stale(&device->driver, now_us) ? 1U : 0U;
    link->count(link->context, &device->station.port.scan);
}

// ---- The cycle

static void measure(struct canopy_device *device, uint64_t begin_us) {
    const uint64_t took_us = time_of(device) - begin_us;
    struct canopy_station_port *port = &device->station.port;
    port->cycle_us = (uint32_t)took_us;
    if (port->cycle_us > port->cycle_max_us) {
        port->cycle_max_us = port->cycle_us;
    }
}

// Whether the PLC has its answer.
static bool is_quiet(const struct canopy_device *device) {
    const struct canopy_stream *line = &device->plc;
    return !canopy_modbus_rtu_server_is_replying(&device->server) && line->sent(line->context);
}

static uint64_t sooner(uint64_t a, uint64_t b) { return a < b ? a : b; }

uint64_t canopy_device_step(struct canopy_device *device) {
    const uint64_t begin_us = time_of(device);
    serve_plc(device);
    poll_scanner(device);
    const bool taking =
        canopy_station_profile(&device->station, &device->driver, &device->column, device->readings, begin_us);
    canopy_station_step(&device->station, device->budget, begin_us);
    measure(device, begin_us);
    if (device->health != NULL) {
        canopy_health_step(device->health, begin_us, is_quiet(device));
    }

    if (taking || canopy_station_is_working(&device->station)) {
        return begin_us;
    }
    struct canopy_profile_request wanted;
    if (!device->asked && canopy_profile_next(&device->driver, begin_us, &wanted)) {
        return begin_us;
    }
    // What else is due, the link and its timeouts, may wait a millisecond.
    return sooner(begin_us + 1000U, canopy_modbus_rtu_server_due(&device->server));
}
