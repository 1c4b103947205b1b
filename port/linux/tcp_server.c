#include "port/linux/tcp_server.h"

#include <errno.h>
#include <string.h>
#include <unistd.h>

enum { REQUESTS_A_TURN = 4, DEAF_US = 100000 };

static uint8_t number_of(const struct canopy_linux_tcp_server *server, const struct canopy_linux_tcp_client *client) {
    return (uint8_t)(server->config.first_client + (client - server->clients));
}

static void forget(const struct canopy_linux_tcp_server *server, const struct canopy_linux_tcp_client *client) {
    if (server->config.forget != NULL) {
        server->config.forget(server->config.context, number_of(server, client));
    }
}

static void drop(struct canopy_linux_tcp_server *server, struct canopy_linux_tcp_client *client) {
    server->rx_frames += client->modbus.rx_frames;
    server->rx_errors += client->modbus.rx_errors;
    client->modbus.rx_frames = client->modbus.rx_errors = 0;
    canopy_linux_tcp_close(&client->connection);
    forget(server, client);
}

void canopy_linux_tcp_server_open(struct canopy_linux_tcp_server *server,
                                  const struct canopy_linux_tcp_server_config *config, int listener) {
    memset(server, 0, sizeof *server);
    server->config = *config;
    server->listener = listener;
    for (int i = 0; i < CANOPY_LINUX_TCP_CLIENTS; i++) {
        server->clients[i].connection.fd = -1;
    }
}

void canopy_linux_tcp_server_watch(const struct canopy_linux_tcp_server *server, uint64_t now_us, struct pollfd *fds) {
    for (int i = 0; i < CANOPY_LINUX_TCP_CLIENTS; i++) {
        const struct canopy_linux_tcp_client *client = &server->clients[i];
        const uint8_t *bytes;
        const bool waits = client->connection.fd >= 0 && canopy_modbus_tcp_server_pending(&client->modbus, &bytes) > 0;
        fds[i] = (struct pollfd){.fd = client->connection.fd, .events = waits ? POLLOUT : POLLIN};
    }
    fds[CANOPY_LINUX_TCP_CLIENTS] =
        (struct pollfd){.fd = now_us < server->deaf_until_us ? -1 : server->listener, .events = POLLIN};
}

// A free place, or that of the client idle the longest if it can be spared; NULL if all are busy.
static struct canopy_linux_tcp_client *make_room(struct canopy_linux_tcp_server *server, uint64_t now_us) {
    struct canopy_linux_tcp_client *idle = &server->clients[0];
    for (int i = 0; i < CANOPY_LINUX_TCP_CLIENTS; i++) {
        struct canopy_linux_tcp_client *client = &server->clients[i];
        if (client->connection.fd < 0) {
            return client;
        }
        idle = client->active_us < idle->active_us ? client : idle;
    }
    if (now_us - idle->active_us < server->config.spare_us) {
        return NULL;
    }
    drop(server, idle);
    server->evicted++;
    return idle;
}

static void admit(struct canopy_linux_tcp_server *server, struct canopy_linux_tcp connection, uint64_t now_us) {
    struct canopy_linux_tcp_client *client = make_room(server, now_us);
    if (client == NULL) {
        server->refused++;
        canopy_linux_tcp_close(&connection);
        return;
    }
    client->connection = connection;
    client->active_us = now_us;
    const struct canopy_modbus_tcp_server_config modbus = {
        .bank = server->config.bank, .any_unit = true, .client = number_of(server, client)};
    if (canopy_modbus_tcp_server_init(&client->modbus, &modbus) != CANOPY_OK) {
        canopy_linux_tcp_close(&client->connection);
        return;
    }
    server->accepted++;
    forget(server, client);
}

static void welcome(struct canopy_linux_tcp_server *server, uint64_t now_us) {
    struct canopy_linux_tcp connection;
    for (int i = 0; i < CANOPY_LINUX_TCP_CLIENTS; i++) {
        errno = 0;
        if (!canopy_linux_tcp_accept(server->listener, &connection)) {
            // Without descriptors the listener stays ready for ever: look away for a while instead of spinning.
            if (errno == EMFILE || errno == ENFILE || errno == ENOBUFS || errno == ENOMEM) {
                server->deaf_until_us = now_us + DEAF_US;
            }
            return;
        }
        admit(server, connection, now_us);
    }
}

// Sends what waits; false while something is left.
static bool flush(struct canopy_linux_tcp_client *client, const struct canopy_stream *stream) {
    const uint8_t *bytes;
    for (size_t length; (length = canopy_modbus_tcp_server_pending(&client->modbus, &bytes)) > 0;) {
        const size_t count = stream->write(stream->context, bytes, length);
        if (count == 0) {
            return false;
        }
        canopy_modbus_tcp_server_sent(&client->modbus, count);
    }
    return true;
}

static void serve_client(struct canopy_linux_tcp_client *client, uint64_t now_us) {
    const struct canopy_stream stream = canopy_linux_tcp_stream(&client->connection);
    for (int i = 0; i < REQUESTS_A_TURN && flush(client, &stream); i++) {
        uint8_t bytes[CANOPY_MODBUS_TCP_ADU_MAX];
        const uint32_t before = client->modbus.rx_frames;
        const size_t room = canopy_modbus_tcp_server_room(&client->modbus);
        const size_t count = stream.read(stream.context, bytes, room < sizeof bytes ? room : sizeof bytes);
        if (count == 0) {
            return;
        }
        (void)canopy_modbus_tcp_server_feed(&client->modbus, bytes, count);
        client->active_us = client->modbus.rx_frames != before ? now_us : client->active_us;
    }
    (void)flush(client, &stream);
}

static bool is_done(const struct canopy_linux_tcp_server *server, const struct canopy_linux_tcp_client *client,
                    uint64_t now_us) {
    return client->connection.ended || canopy_modbus_tcp_server_lost(&client->modbus) ||
           (server->config.idle_us > 0 && now_us - client->active_us >= server->config.idle_us);
}

void canopy_linux_tcp_server_serve(struct canopy_linux_tcp_server *server, const struct pollfd *fds, uint64_t now_us) {
    for (int i = 0; i < CANOPY_LINUX_TCP_CLIENTS; i++) {
        struct canopy_linux_tcp_client *client = &server->clients[i];
        if (client->connection.fd < 0) {
            continue;
        }
        if (fds[i].revents != 0) {
            serve_client(client, now_us);
        }
        if (is_done(server, client, now_us)) {
            server->evicted += !client->connection.ended;
            drop(server, client);
        }
    }
    if (fds[CANOPY_LINUX_TCP_CLIENTS].revents != 0) {
        welcome(server, now_us);
    }
}

uint32_t canopy_linux_tcp_server_rx_frames(const struct canopy_linux_tcp_server *server) {
    uint32_t sum = server->rx_frames;
    for (int i = 0; i < CANOPY_LINUX_TCP_CLIENTS; i++) {
        sum += server->clients[i].modbus.rx_frames;
    }
    return sum;
}

uint32_t canopy_linux_tcp_server_rx_errors(const struct canopy_linux_tcp_server *server) {
    uint32_t sum = server->rx_errors;
    for (int i = 0; i < CANOPY_LINUX_TCP_CLIENTS; i++) {
        sum += server->clients[i].modbus.rx_errors;
    }
    return sum;
}

void canopy_linux_tcp_server_close(struct canopy_linux_tcp_server *server) {
    for (int i = 0; i < CANOPY_LINUX_TCP_CLIENTS; i++) {
        if (server->clients[i].connection.fd >= 0) {
            drop(server, &server->clients[i]);
        }
    }
    if (server->listener >= 0) {
        close(server->listener);
    }
    server->listener = -1;
}
