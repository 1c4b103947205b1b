/// TCP connections of Linux as streams that never block.
#ifndef CANOPY_PORT_LINUX_TCP_H
#define CANOPY_PORT_LINUX_TCP_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/port.h"

/// One connection. The members may be read.
struct canopy_linux_tcp {
    int fd;      ///< -1 when closed
    bool ended;  ///< the peer closed or reset it: close it
};

/// Listens on `host` ("" or "*" for all addresses, else a name or number, IPv6 without brackets) and `port` (0: any
/// free one). NULL, or in a few words what is wrong. May ask a name server, so use it at start only.
const char *canopy_linux_tcp_listen(const char *host, uint16_t port, int *fd);

/// The port a listener has; 0 if it is none.
uint16_t canopy_linux_tcp_port(int fd);

/// Takes a waiting connection; false if there is none. It answers without delay (TCP_NODELAY), and a peer that vanished
/// without a word is found out: by keep-alive within half a minute when idle, within ten seconds when it owes
/// acknowledgements.
bool canopy_linux_tcp_accept(int listener, struct canopy_linux_tcp *connection);

/// Closes; harmless when closed.
void canopy_linux_tcp_close(struct canopy_linux_tcp *connection);

/// The connection as a stream; it must outlive it. `sent` is always true: what was taken is the kernel's business.
struct canopy_stream canopy_linux_tcp_stream(struct canopy_linux_tcp *connection);

#endif
