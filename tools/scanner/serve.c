#include "tools/scanner/serve.h"

#include <errno.h>
#include <netdb.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "lib/modbus/rtu.h"
#include "lib/modbus/tcp.h"
#include "tools/scanner/outbox.h"

#define CONNECTIONS (CANOPY_SWEEP_CLIENTS - 1)
#define LINE_CLIENT 0  // the line is client 0 of the sweep, connection i is client i + 1

// On a pseudo-terminal a silence means little: frames are found by length and CRC, and this only ends them.
#define UNPACED_SILENCE_US 300

struct connection {
    int file;  // -1: free
    struct canopy_modbus_tcp_server engine;
    struct outbox outbox;
};

struct server {
    struct serve_options options;
    struct canopy_sweep *sweep;
    struct canopy_modbus_bank bank;
    struct serve_report report;
    struct line line;
    struct canopy_modbus_rtu_server engine;
    struct outbox outbox;
    size_t heard;  // bytes since the last reply
    int listener;
    char address[160];
    bool read_last;  // the last thing the bank was asked for was a read that went well
    struct connection connections[CONNECTIONS];
};

uint64_t serve_now_us(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

// ---------------------------------------------------------------------------------------------------------------------
// The registers

static uint8_t bank_read(void *context, uint8_t client, uint16_t address, uint16_t count, uint8_t *to) {
    struct server *server = context;
    uint16_t registers[CANOPY_MODBUS_READ_MAX];
    const uint8_t exception = canopy_sweep_read(server->sweep, client, address, count, registers, serve_now_us());
    for (uint16_t i = 0; exception == 0 && i < count; i++) {
        to[2 * i] = (uint8_t)(registers[i] >> 8);
        to[2 * i + 1] = (uint8_t)(registers[i] & 0xFFu);
    }
    server->read_last = exception == 0;
    return exception;
}

static uint8_t bank_write(void *context, uint8_t client, uint16_t address, uint16_t count, const uint8_t *from,
                          uint8_t function) {
    struct server *server = context;
    (void)client, (void)address, (void)count, (void)from, (void)function;
    server->read_last = false;
    return CANOPY_MODBUS_ILLEGAL_ADDRESS;  // a scanner of this map has nothing to be set
}

static const char *bank_identify(void *context, uint8_t object) {
    struct server *server = context;
    static const char *const objects[] = {"canopy", "canopy-scanner", "1", NULL, "simulated line scanner"};
    server->read_last = false;
    return object < sizeof objects / sizeof objects[0] ? objects[object] : NULL;
}

// ---------------------------------------------------------------------------------------------------------------------
// Replies

// Treats a reply and posts it. What the master will get of it decides whether its registers count as offered.
static void reply(struct server *server, bool rtu, uint8_t client, struct outbox *outbox, const uint8_t *bytes,
                  size_t length, uint64_t start_us, uint64_t now_us) {
    struct outbox_message *message = outbox_next(outbox);
    server->report.requests++;
    if (message == NULL)
        return;  // the other side does not listen
    message->start_us = start_us;
    const enum mischief_fate fate = mischief_do(&server->report.mischief, rtu, bytes, length, now_us, message);
    if (server->read_last && fate != MISCHIEF_SPOILT)
        canopy_sweep_offered(server->sweep, client, fate == MISCHIEF_DOUBTFUL);
    if (message->length == 0)
        return;
    server->report.replies++;
    outbox_post(outbox);
    if (rtu)
        server->report.wire_bytes += message->length;
}

// ---------------------------------------------------------------------------------------------------------------------
// The line

static void line_engine(struct server *server, uint64_t now_us) {
    const uint8_t *bytes = NULL;
    server->read_last = false;
    const size_t length = canopy_modbus_rtu_server_poll(&server->engine, now_us, &bytes);
    if (length == 0)
        return;
    // Paced: the request's own bytes would still have been coming in when a pseudo-terminal had delivered all of them.
    const uint64_t late_us = (uint64_t)((double)server->heard * server->outbox.byte_us);
    server->heard = 0;
    reply(server, true, LINE_CLIENT, &server->outbox, bytes, length, now_us + late_us, now_us);
    canopy_modbus_rtu_server_sent(&server->engine, length, now_us);
}

static bool line_input(struct server *server, uint64_t now_us) {
    uint8_t bytes[512];
    const ssize_t count = read(server->line.file, bytes, sizeof bytes);
    if (count < 0)
        return errno == EAGAIN || errno == EINTR;
    if (count == 0)
        return false;
    server->heard += (size_t)count;
    server->report.wire_bytes += (uint64_t)count;
    canopy_modbus_rtu_server_feed(&server->engine, bytes, (size_t)count, now_us);
    return true;
}

static bool open_line(struct server *server, struct canopy_fault *fault) {
    const struct serve_options *o = &server->options;
    if (!line_open(&o->line, &server->line, fault))
        return false;
    const bool paced = o->pace;
    const struct canopy_modbus_rtu_server_config config = {
        .bank = &server->bank,
        .unit = o->line.unit,
        .client = LINE_CLIENT,
        .character_bits = 11,
        .silence_us = paced ? canopy_modbus_rtu_silence_us(o->line.baud) : UNPACED_SILENCE_US};
    if (canopy_modbus_rtu_server_init(&server->engine, &config) != CANOPY_OK)
        return canopy_fault_set(fault, "%s: the line cannot be served", o->line.path);
    server->outbox.byte_us = paced ? 1e6 * canopy_wire_character_bits(&o->line) / o->line.baud : 0;
    return true;
}

// ---------------------------------------------------------------------------------------------------------------------
// Connections

static void disconnect(struct connection *connection) {
    close(connection->file);
    connection->file = -1;
    connection->outbox.count = 0;
}

static void accept_one(struct server *server) {
    const int file = accept4(server->listener, NULL, NULL, SOCK_NONBLOCK | SOCK_CLOEXEC);
    if (file < 0)
        return;
    for (uint8_t i = 0; i < CONNECTIONS; i++) {
        struct connection *connection = &server->connections[i];
        if (connection->file >= 0)
            continue;
        const struct canopy_modbus_tcp_server_config config = {
            .bank = &server->bank, .unit = server->options.address.unit, .client = (uint8_t)(i + 1)};
        canopy_modbus_tcp_server_init(&connection->engine, &config);
        canopy_sweep_forget(server->sweep, (uint8_t)(i + 1));
        connection->file = file;
        return;
    }
    close(file);
}

static void connection_replies(struct server *server, struct connection *connection, uint64_t now_us) {
    const uint8_t *bytes = NULL;
    const size_t length = canopy_modbus_tcp_server_pending(&connection->engine, &bytes);
    if (length == 0)
        return;
    const uint8_t client = connection->engine.config.client;
    reply(server, false, client, &connection->outbox, bytes, length, now_us, now_us);
    canopy_modbus_tcp_server_sent(&connection->engine, length);
}

static void connection_input(struct server *server, struct connection *connection, uint64_t now_us) {
    uint8_t bytes[CANOPY_MODBUS_TCP_ADU_MAX];
    const size_t room = canopy_modbus_tcp_server_room(&connection->engine);
    const ssize_t count = read(connection->file, bytes, room < sizeof bytes ? room : sizeof bytes);
    if (count == 0 || (count < 0 && errno != EAGAIN && errno != EINTR)) {
        disconnect(connection);
        return;
    }
    server->read_last = false;
    if (count > 0)
        canopy_modbus_tcp_server_feed(&connection->engine, bytes, (size_t)count);
    connection_replies(server, connection, now_us);
    if (canopy_modbus_tcp_server_lost(&connection->engine))
        disconnect(connection);
}

static int listen_on(const struct addrinfo *where) {
    const int file = socket(where->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0), yes = 1;
    if (file < 0)
        return -1;
    setsockopt(file, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
    if (bind(file, where->ai_addr, where->ai_addrlen) == 0 && listen(file, CONNECTIONS) == 0)
        return file;
    const int error = errno;
    close(file);
    errno = error;
    return -1;
}

static bool open_listener(struct server *server, struct canopy_fault *fault) {
    const char *host = server->options.address.host, *port = server->options.address.port;
    const struct addrinfo hints = {.ai_socktype = SOCK_STREAM, .ai_flags = AI_PASSIVE | AI_NUMERICSERV};
    struct addrinfo *found = NULL;
    const int error = getaddrinfo(host[0] == '\0' ? NULL : host, port, &hints, &found);
    if (error != 0)
        return canopy_fault_set(fault, "--tcp %s:%s: %s", host, port, gai_strerror(error));
    server->listener = listen_on(found);
    freeaddrinfo(found);
    if (server->listener < 0)
        return canopy_fault_set(fault, "--tcp %s:%s: %s", host, port, strerror(errno));
    struct sockaddr_storage bound;
    socklen_t length = sizeof bound;
    char number[16] = "";
    if (getsockname(server->listener, (struct sockaddr *)&bound, &length) == 0)
        getnameinfo((struct sockaddr *)&bound, length, NULL, 0, number, sizeof number, NI_NUMERICSERV);
    snprintf(server->address, sizeof server->address, "%s:%s", host[0] == '\0' ? "0.0.0.0" : host, number);
    return true;
}

// ---------------------------------------------------------------------------------------------------------------------
// The loop

struct server *serve_open(const struct serve_options *options, struct canopy_sweep *sweep, struct canopy_fault *fault) {
    struct server *server = calloc(1, sizeof *server);
    if (server == NULL) {
        canopy_fault_set(fault, "no memory");
        return NULL;
    }
    server->options = *options;
    server->sweep = sweep;
    server->listener = -1;
    server->line = (struct line){.file = -1, .keeper = -1};
    server->report.mischief = (struct mischief){.options = options->mischief, .random = options->mischief_seed};
    server->bank = (struct canopy_modbus_bank){
        .context = server, .read = bank_read, .write = bank_write, .identify = bank_identify};
    for (int i = 0; i < CONNECTIONS; i++)
        server->connections[i].file = -1;
    if ((!options->rtu || open_line(server, fault)) && (!options->tcp || open_listener(server, fault)))
        return server;
    serve_close(server);
    return NULL;
}

void serve_close(struct server *server) {
    for (int i = 0; i < CONNECTIONS; i++)
        if (server->connections[i].file >= 0)
            close(server->connections[i].file);
    if (server->listener >= 0)
        close(server->listener);
    if (server->line.file >= 0)
        line_close(&server->line);
    free(server);
}

const char *serve_device(const struct server *server) { return server->line.device; }

const char *serve_address(const struct server *server) { return server->address; }

struct serve_report serve_report(const struct server *server) {
    struct serve_report report = server->report;
    report.rx_errors = server->engine.rx_errors;
    return report;
}

static uint64_t sooner(uint64_t a, uint64_t b) { return a < b ? a : b; }

static uint64_t next_due(const struct server *server, uint64_t now_us) {
    uint64_t due = UINT64_MAX;
    if (server->line.file >= 0) {
        due = sooner(due, canopy_modbus_rtu_server_due(&server->engine));
        due = sooner(due, outbox_due(&server->outbox, now_us));
    }
    for (int i = 0; i < CONNECTIONS; i++)
        if (server->connections[i].file >= 0)
            due = sooner(due, outbox_due(&server->connections[i].outbox, now_us));
    return due;
}

// Line, listener, connections, in this order; -1 where there is none, which poll() skips. A connection whose replies
// are not gone yet is not listened to.
static void watch_list(const struct server *server, struct pollfd *list) {
    list[0] = (struct pollfd){.fd = server->line.file, .events = POLLIN};
    list[1] = (struct pollfd){.fd = server->listener, .events = POLLIN};
    for (int i = 0; i < CONNECTIONS; i++) {
        const struct connection *connection = &server->connections[i];
        const bool full = connection->outbox.count == OUTBOX_MESSAGES;
        list[2 + i] = (struct pollfd){.fd = full ? -1 : connection->file, .events = POLLIN};
    }
}

bool serve_once(struct server *server, uint64_t wait_us) {
    struct pollfd list[2 + CONNECTIONS];
    uint64_t now_us = serve_now_us();
    const uint64_t due_us = sooner(next_due(server, now_us), now_us + wait_us);
    const uint64_t rest_us = due_us > now_us ? due_us - now_us : 0;
    const struct timespec rest = {(time_t)(rest_us / 1000000u), (long)(rest_us % 1000000u) * 1000};
    watch_list(server, list);
    if (ppoll(list, 2 + CONNECTIONS, &rest, NULL) < 0)
        return true;  // a signal
    now_us = serve_now_us();
    if (server->line.file >= 0) {
        if (list[0].revents != 0 && !line_input(server, now_us))
            return false;
        line_engine(server, now_us);
        if (!outbox_pump(&server->outbox, server->line.file, serve_now_us()))
            return false;
    }
    for (int i = 0; i < CONNECTIONS; i++) {
        struct connection *connection = &server->connections[i];
        if (connection->file >= 0 && list[2 + i].revents != 0)
            connection_input(server, connection, now_us);
        if (connection->file >= 0 && !outbox_pump(&connection->outbox, connection->file, serve_now_us()))
            disconnect(connection);
    }
    if (list[1].revents != 0)
        accept_one(server);
    return true;
}
