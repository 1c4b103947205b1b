#include "port/linux/rtu_server.h"

#include <string.h>

#include "port/linux/clock.h"
#include "port/linux/log.h"

enum { RETRY_US = 1000000, READS_A_TURN = 4 };

static void forget(const struct canopy_linux_rtu_server *server) {
    if (server->config.forget != NULL) {
        server->config.forget(server->config.context, server->config.client);
    }
}

static uint8_t character_bits(const struct canopy_linux_serial_config *serial) {
    return (uint8_t)(9 + (serial->parity != 'N') + serial->stop_bits);
}

static const char *start(struct canopy_linux_rtu_server *server) {
    const struct canopy_linux_serial_config *serial = &server->config.serial;
    const uint8_t bits = character_bits(serial);
    const struct canopy_modbus_rtu_server_config modbus = {.bank = server->config.bank,
                                                           .unit = server->config.unit,
                                                           .client = server->config.client,
                                                           .character_bits = bits > 11 ? 11 : bits,
                                                           .baud = serial->baud};
    if (canopy_modbus_rtu_server_init(&server->modbus, &modbus) != CANOPY_OK) {
        return "this unit is none of 1 to 247";
    }
    server->blocked = false;
    const char *wrong = canopy_linux_serial_open(&server->line, serial);
    if (wrong == NULL) {
        forget(server);
    }
    return wrong;
}

const char *canopy_linux_rtu_server_open(struct canopy_linux_rtu_server *server,
                                         const struct canopy_linux_rtu_server_config *config) {
    memset(server, 0, sizeof *server);
    server->config = *config;
    server->line.fd = -1;
    const char *wrong = start(server);
    if (wrong == NULL && config->serial.rs485 && !server->line.rs485) {
        canopy_linux_log("%s: the kernel has no RS-485 mode for this line: the adapter must switch its driver itself",
                         config->serial.device);
    }
    return wrong;
}

static void stop(struct canopy_linux_rtu_server *server) {
    server->rx_frames += server->modbus.rx_frames;
    server->rx_errors += server->modbus.rx_errors;
    server->modbus.rx_frames = server->modbus.rx_errors = 0;
    canopy_linux_serial_close(&server->line);
    forget(server);
}

void canopy_linux_rtu_server_watch(const struct canopy_linux_rtu_server *server, struct pollfd *fd) {
    *fd = (struct pollfd){.fd = server->line.fd, .events = server->blocked ? POLLIN | POLLOUT : POLLIN};
}

uint64_t canopy_linux_rtu_server_due(const struct canopy_linux_rtu_server *server) {
    if (server->line.fd < 0) {
        return server->retry_us;
    }
    return server->blocked ? CANOPY_MODBUS_RTU_NEVER : canopy_modbus_rtu_server_due(&server->modbus);
}

static void come_back(struct canopy_linux_rtu_server *server, uint64_t now_us) {
    if (now_us < server->retry_us) {
        return;
    }
    server->retry_us = now_us + RETRY_US;
    if (start(server) == NULL) {
        canopy_linux_log("%s: the line is back", server->config.serial.device);
    }
}

static void receive(struct canopy_linux_rtu_server *server, const struct canopy_stream *stream) {
    for (int i = 0; i < READS_A_TURN; i++) {
        uint8_t bytes[CANOPY_MODBUS_RTU_ADU_MAX];
        const size_t count = stream->read(stream->context, bytes, sizeof bytes);
        if (count == 0) {
            return;
        }
        canopy_modbus_rtu_server_feed(&server->modbus, bytes, count, canopy_linux_now_us());
    }
}

static void answer(struct canopy_linux_rtu_server *server, const struct canopy_stream *stream, uint64_t now_us) {
    const uint8_t *reply;
    const size_t length = canopy_modbus_rtu_server_poll(&server->modbus, now_us, &reply);
    const size_t count = length > 0 ? stream->write(stream->context, reply, length) : 0;
    server->blocked = count < length;
    if (count > 0) {
        canopy_modbus_rtu_server_sent(&server->modbus, count, canopy_linux_now_us());
    }
}

void canopy_linux_rtu_server_serve(struct canopy_linux_rtu_server *server, uint64_t now_us) {
    if (server->line.fd < 0) {
        come_back(server, now_us);
        return;
    }
    const struct canopy_stream stream = canopy_linux_serial_stream(&server->line);
    receive(server, &stream);
    answer(server, &stream, canopy_linux_now_us());
    if (server->line.gone) {
        canopy_linux_log("%s: the line has gone", server->config.serial.device);
        stop(server);
        server->retry_us = now_us + RETRY_US;
    }
}

uint32_t canopy_linux_rtu_server_rx_frames(const struct canopy_linux_rtu_server *server) {
    return server->rx_frames + server->modbus.rx_frames;
}

uint32_t canopy_linux_rtu_server_rx_errors(const struct canopy_linux_rtu_server *server) {
    return server->rx_errors + server->modbus.rx_errors;
}

uint32_t canopy_linux_rtu_server_lost(struct canopy_linux_rtu_server *server) {
    const struct canopy_stream stream = canopy_linux_serial_stream(&server->line);
    return stream.lost(stream.context);
}

void canopy_linux_rtu_server_close(struct canopy_linux_rtu_server *server) {
    if (server->line.fd >= 0) {
        stop(server);
    }
}
