#include "port/linux/tcp.h"

#include <errno.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

static void set(int fd, int level, int option, int value) { (void)setsockopt(fd, level, option, &value, sizeof value); }

// Listens on one address; -1 with errno if that fails.
static int listen_on(const struct addrinfo *address) {
    const int fd =
        socket(address->ai_family, address->ai_socktype | SOCK_NONBLOCK | SOCK_CLOEXEC, address->ai_protocol);
    if (fd < 0) {
        return -1;
    }
    set(fd, SOL_SOCKET, SO_REUSEADDR, 1);
    if (bind(fd, address->ai_addr, address->ai_addrlen) == 0 && listen(fd, 16) == 0) {
        return fd;
    }
    const int error = errno;
    close(fd);
    errno = error;
    return -1;
}

const char *canopy_linux_tcp_listen(const char *host, uint16_t port, int *fd) {
    const bool any = host[0] == '\0' || strcmp(host, "*") == 0;
    const struct addrinfo hints = {.ai_socktype = SOCK_STREAM, .ai_flags = AI_PASSIVE | AI_NUMERICSERV};
    struct addrinfo *addresses = NULL;
    char service[8];
    snprintf(service, sizeof service, "%u", (unsigned)port);
    const int failed = getaddrinfo(any ? NULL : host, service, &hints, &addresses);
    if (failed != 0) {
        return failed == EAI_SYSTEM ? strerror(errno) : gai_strerror(failed);
    }
    *fd = -1;
    for (const struct addrinfo *address = addresses; address != NULL && *fd < 0; address = address->ai_next) {
        *fd = listen_on(address);
    }
    const int error = errno;
    freeaddrinfo(addresses);
    return *fd < 0 ? strerror(error) : NULL;
}

uint16_t canopy_linux_tcp_port(int fd) {
    struct sockaddr_storage address;
    socklen_t length = sizeof address;
    memset(&address, 0, sizeof address);
    if (getsockname(fd, (struct sockaddr *)&address, &length) != 0) {
        return 0;
    }
    uint16_t port = 0;  // in both families at the same place, behind the family
    memcpy(&port, (const char *)&address + offsetof(struct sockaddr_in, sin_port), sizeof port);
    return ntohs(port);
}

bool canopy_linux_tcp_accept(int listener, struct canopy_linux_tcp *connection) {
    const int fd = accept4(listener, NULL, NULL, SOCK_NONBLOCK | SOCK_CLOEXEC);
    if (fd < 0) {
        return false;
    }
    set(fd, IPPROTO_TCP, TCP_NODELAY, 1);
    set(fd, SOL_SOCKET, SO_KEEPALIVE, 1);
    set(fd, IPPROTO_TCP, TCP_KEEPIDLE, 10);
    set(fd, IPPROTO_TCP, TCP_KEEPINTVL, 5);
    set(fd, IPPROTO_TCP, TCP_KEEPCNT, 3);
    set(fd, IPPROTO_TCP, TCP_USER_TIMEOUT, 10000);
    *connection = (struct canopy_linux_tcp){.fd = fd};
    return true;
}

void canopy_linux_tcp_close(struct canopy_linux_tcp *connection) {
    if (connection->fd >= 0) {
        close(connection->fd);
    }
    connection->fd = -1;
}

static size_t moved(struct canopy_linux_tcp *connection, ssize_t count) {
    if (count < 0 && errno != EAGAIN && errno != EINTR) {
        connection->ended = true;
    }
    return count > 0 ? (size_t)count : 0;
}

static size_t read_some(void *context, uint8_t *to, size_t length) {
    struct canopy_linux_tcp *connection = context;
    if (connection->fd < 0 || length == 0) {
        return 0;
    }
    const ssize_t count = recv(connection->fd, to, length, 0);
    connection->ended = connection->ended || count == 0;
    return moved(connection, count);
}

static size_t write_some(void *context, const uint8_t *from, size_t length) {
    struct canopy_linux_tcp *connection = context;
    return connection->fd < 0 ? 0 : moved(connection, send(connection->fd, from, length, MSG_NOSIGNAL));
}

static bool all_sent(void *context) {
    (void)context;
    return true;
}

static uint32_t none_lost(void *context) {
    (void)context;
    return 0;
}

struct canopy_stream canopy_linux_tcp_stream(struct canopy_linux_tcp *connection) {
    return (struct canopy_stream){
        .context = connection, .read = read_some, .write = write_some, .sent = all_sent, .lost = none_lost};
}
