/// A Modbus TCP server: one listener, up to eight clients, never waiting for any of them.
///
/// Each connection has a client number of its own towards the bank. A connection that has completed no request for
/// `idle_us` is closed, whatever bytes it trickles; when a ninth client comes, the one idle the longest makes room if
/// it has been idle for `spare_us`, else the newcomer is closed.
#ifndef CANOPY_PORT_LINUX_TCP_SERVER_H
#define CANOPY_PORT_LINUX_TCP_SERVER_H

#include <poll.h>
#include <stdint.h>

#include "lib/modbus/tcp.h"
#include "port/linux/tcp.h"

#define CANOPY_LINUX_TCP_CLIENTS 8
#define CANOPY_LINUX_TCP_FDS (CANOPY_LINUX_TCP_CLIENTS + 1)

struct canopy_linux_tcp_server_config {
    const struct canopy_modbus_bank *bank;  ///< must outlive the server
    uint8_t first_client;                   ///< connection i is client first_client + i of the bank
    uint32_t idle_us;                       ///< 0: connections may idle for ever
    uint32_t spare_us;                      ///< how long a client must be idle to make room for another
    /// Called when a connection with that client number opens and when it closes. May be NULL.
    void (*forget)(void *context, uint8_t client);
    void *context;
};

struct canopy_linux_tcp_client {
    struct canopy_linux_tcp connection;
    struct canopy_modbus_tcp_server modbus;
    uint64_t active_us;  // when it was opened or last completed a request
};

/// All members are the server's own but the counters.
struct canopy_linux_tcp_server {
    struct canopy_linux_tcp_server_config config;
    struct canopy_linux_tcp_client clients[CANOPY_LINUX_TCP_CLIENTS];
    int listener;
    uint64_t deaf_until_us;         // the listener is left alone: the process has no descriptors left
    uint32_t rx_frames, rx_errors;  // of connections that are closed
    uint32_t accepted;              ///< connections taken; monotonic
    uint32_t evicted;               ///< connections closed to make room, for idling or for bytes that are no Modbus
    uint32_t refused;               ///< connections closed at once: all clients were busy
};

/// Serves the listening socket `listener`, which becomes the server's own.
void canopy_linux_tcp_server_open(struct canopy_linux_tcp_server *server,
                                  const struct canopy_linux_tcp_server_config *config, int listener);

/// What to poll for: exactly CANOPY_LINUX_TCP_FDS entries, unused ones with fd -1.
void canopy_linux_tcp_server_watch(const struct canopy_linux_tcp_server *server, uint64_t now_us, struct pollfd *fds);

/// Serves what `fds` (as watch filled them and poll answered) says is ready: at most a few requests of each client, the
/// rest at the next call. Work: at most 32 requests and 8 new connections.
void canopy_linux_tcp_server_serve(struct canopy_linux_tcp_server *server, const struct pollfd *fds, uint64_t now_us);

/// Requests and errors of all connections since open; monotonic.
uint32_t canopy_linux_tcp_server_rx_frames(const struct canopy_linux_tcp_server *server);
uint32_t canopy_linux_tcp_server_rx_errors(const struct canopy_linux_tcp_server *server);

/// Closes everything.
void canopy_linux_tcp_server_close(struct canopy_linux_tcp_server *server);

#endif
