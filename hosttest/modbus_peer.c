// One end of a Modbus connection, for hosttest/test_modbus_peers.py: our server, our client, and libmodbus's of each.
//
//     modbus_peer serve    rtu DEVICE | tcp PORT     our server on the test table, unit 17
//     modbus_peer ask      rtu DEVICE | tcp PORT     our client through a list of requests; prints `ok N`
//     modbus_peer libserve rtu DEVICE | tcp PORT     libmodbus's server on the same table
//     modbus_peer libask   rtu DEVICE | tcp PORT     libmodbus's client through the same list
//
// Servers print `ready` when they can be asked and run until they are stopped. RTU is 115200 8N1.
#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <modbus/modbus.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "hosttest/modbus_table.h"
#include "lib/modbus/rtu.h"
#include "lib/modbus/tcp.h"

enum { US = 17, BAUD = 115200, ROUNDS = 20 };

static struct table table;
static struct canopy_modbus_bank bank;

static _Noreturn void die(const char *what) {
    fprintf(stderr, "modbus_peer: %s: %s\n", what, strerror(errno));
    exit(1);
}

static uint64_t now_us(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

static void ready(void) {
    puts("ready");
    fflush(stdout);
}

static int open_line(const char *device) {
    const int fd = open(device, O_RDWR | O_NOCTTY | O_NONBLOCK);
    struct termios line;
    if (fd < 0 || tcgetattr(fd, &line) != 0)
        die(device);
    cfmakeraw(&line);
    cfsetspeed(&line, B115200);
    if (tcsetattr(fd, TCSANOW, &line) != 0)
        die(device);
    return fd;
}

static int tcp_socket(const char *port, struct sockaddr_in *address) {
    const int fd = socket(AF_INET, SOCK_STREAM, 0);
    const int on = 1;
    if (fd < 0)
        die("socket");
    setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    *address = (struct sockaddr_in){
        .sin_family = AF_INET, .sin_port = htons((uint16_t)atoi(port)), .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    return fd;
}

static int listen_on(const char *port) {
    struct sockaddr_in address;
    const int fd = tcp_socket(port, &address);
    if (bind(fd, (struct sockaddr *)&address, sizeof address) != 0 || listen(fd, 4) != 0)
        die(port);
    return fd;
}

static int connect_to(const char *port) {
    struct sockaddr_in address;
    const int fd = tcp_socket(port, &address), on = 1;
    if (connect(fd, (struct sockaddr *)&address, sizeof address) != 0)
        die(port);
    setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    fcntl(fd, F_SETFL, O_NONBLOCK);
    return fd;
}

// Waits until there is something to read, or until `due_us`.
static bool wait_for(int fd, uint64_t due_us) {
    struct pollfd watch = {.fd = fd, .events = POLLIN};
    const uint64_t now = now_us();
    const uint64_t left_us = due_us <= now ? 0 : due_us - now < 1000000 ? due_us - now : 1000000;
    const struct timespec left = {.tv_sec = (time_t)(left_us / 1000000), .tv_nsec = (long)(left_us % 1000000) * 1000};
    return ppoll(&watch, 1, &left, NULL) > 0;
}

// ---------------------------------------------------------------------------------------------------------------------
// Servers

static void serve_rtu(const char *device) {
    static struct canopy_modbus_rtu_server server;
    const struct canopy_modbus_rtu_server_config config = {
        .bank = &bank, .unit = US, .baud = BAUD, .character_bits = 10};
    if (canopy_modbus_rtu_server_init(&server, &config) != CANOPY_OK)
        die("configuration");
    const int fd = open_line(device);
    ready();
    for (;;) {
        uint8_t bytes[64];
        if (wait_for(fd, canopy_modbus_rtu_server_due(&server))) {
            const ssize_t length = read(fd, bytes, sizeof bytes);
            if (length == 0 || (length < 0 && errno != EAGAIN))
                return;
            if (length > 0)
                canopy_modbus_rtu_server_feed(&server, bytes, (size_t)length, now_us());
        }
        const uint8_t *reply;
        const size_t pending = canopy_modbus_rtu_server_poll(&server, now_us(), &reply);
        const ssize_t sent = pending ? write(fd, reply, pending) : 0;
        if (sent > 0)
            canopy_modbus_rtu_server_sent(&server, (size_t)sent, now_us());
    }
}

static void serve_connection(int fd) {
    static struct canopy_modbus_tcp_server server;
    const struct canopy_modbus_tcp_server_config config = {.bank = &bank, .unit = US};
    if (canopy_modbus_tcp_server_init(&server, &config) != CANOPY_OK)
        die("configuration");
    while (!canopy_modbus_tcp_server_lost(&server)) {
        uint8_t bytes[CANOPY_MODBUS_TCP_ADU_MAX];
        const ssize_t length = read(fd, bytes, canopy_modbus_tcp_server_room(&server));
        if (length <= 0)
            break;
        canopy_modbus_tcp_server_feed(&server, bytes, (size_t)length);
        const uint8_t *reply;
        for (size_t pending; (pending = canopy_modbus_tcp_server_pending(&server, &reply)) > 0;) {
            const ssize_t sent = send(fd, reply, pending, MSG_NOSIGNAL);
            if (sent <= 0)
                return;
            canopy_modbus_tcp_server_sent(&server, (size_t)sent);
        }
    }
}

static void serve_tcp(const char *port) {
    const int listener = listen_on(port);
    ready();
    for (;;) {
        const int fd = accept(listener, NULL, NULL);
        if (fd < 0)
            die("accept");
        serve_connection(fd);
        close(fd);
    }
}

static modbus_mapping_t *lib_mapping(void) {
    modbus_mapping_t *mapping = modbus_mapping_new(0, 0, TABLE_REGISTERS, TABLE_REGISTERS);
    if (!mapping)
        die("mapping");
    memcpy(mapping->tab_registers, table.registers, sizeof table.registers);
    memcpy(mapping->tab_input_registers, table.registers, sizeof table.registers);
    return mapping;
}

static void libserve_rtu(const char *device) {
    uint8_t query[MODBUS_RTU_MAX_ADU_LENGTH];
    modbus_t *line = modbus_new_rtu(device, BAUD, 'N', 8, 1);
    modbus_set_slave(line, US);
    if (modbus_connect(line) != 0)
        die(device);
    modbus_mapping_t *mapping = lib_mapping();
    ready();
    for (;;) {
        const int length = modbus_receive(line, query);
        if (length > 0)
            modbus_reply(line, query, length, mapping);
    }
}

static void libserve_tcp(const char *port) {
    uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
    modbus_t *connection = modbus_new_tcp("127.0.0.1", atoi(port));
    int listener = modbus_tcp_listen(connection, 1);
    if (listener < 0)
        die(port);
    modbus_mapping_t *mapping = lib_mapping();
    ready();
    while (modbus_tcp_accept(connection, &listener) >= 0) {
        for (int length; (length = modbus_receive(connection, query)) >= 0;)
            if (length > 0)
                modbus_reply(connection, query, length, mapping);
        modbus_close(connection);
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// Clients. Both go through the same list, written down once on top of these.

struct asker {
    int fd;  // ours
    bool tcp;
    struct canopy_modbus_rtu_client rtu_client;
    struct canopy_modbus_tcp_client tcp_client;
    modbus_t *lib;  // libmodbus's
    unsigned asked;
};

static void feed_client(struct asker *asker) {
    uint8_t bytes[CANOPY_MODBUS_TCP_ADU_MAX];
    const size_t room = asker->tcp ? canopy_modbus_tcp_client_room(&asker->tcp_client) : sizeof bytes;
    const ssize_t length = read(asker->fd, bytes, room);
    if (length == 0)
        die("closed");
    if (length < 0)
        return;
    if (asker->tcp)
        canopy_modbus_tcp_client_feed(&asker->tcp_client, bytes, (size_t)length);
    else
        canopy_modbus_rtu_client_feed(&asker->rtu_client, bytes, (size_t)length, now_us());
}

static void drain_client(struct asker *asker) {
    const uint8_t *bytes;
    const size_t pending = asker->tcp ? canopy_modbus_tcp_client_pending(&asker->tcp_client, &bytes)
                                      : canopy_modbus_rtu_client_pending(&asker->rtu_client, now_us(), &bytes);
    const ssize_t sent = pending ? write(asker->fd, bytes, pending) : 0;
    if (sent <= 0)
        return;
    if (asker->tcp)
        canopy_modbus_tcp_client_sent(&asker->tcp_client, (size_t)sent, now_us());
    else
        canopy_modbus_rtu_client_sent(&asker->rtu_client, (size_t)sent, now_us());
}

// Asks through our client; 0, an exception, or -1 without an answer.
static int ask_ours(struct asker *asker, const struct canopy_modbus_request *request, uint16_t *to) {
    const enum canopy_status status = asker->tcp ? canopy_modbus_tcp_client_start(&asker->tcp_client, request, now_us())
                                                 : canopy_modbus_rtu_client_start(&asker->rtu_client, request);
    if (status != CANOPY_OK)
        return -1;
    for (;;) {
        drain_client(asker);
        if (wait_for(asker->fd, now_us() + 500))
            feed_client(asker);
        const enum canopy_modbus_outcome outcome = asker->tcp
                                                       ? canopy_modbus_tcp_client_poll(&asker->tcp_client, now_us())
                                                       : canopy_modbus_rtu_client_poll(&asker->rtu_client, now_us());
        if (outcome == CANOPY_MODBUS_PENDING)
            continue;
        if (outcome == CANOPY_MODBUS_REFUSED)
            return asker->tcp ? canopy_modbus_tcp_client_exception(&asker->tcp_client)
                              : canopy_modbus_rtu_client_exception(&asker->rtu_client);
        if (outcome != CANOPY_MODBUS_DONE)
            return -1;
        if (asker->tcp)
            canopy_modbus_tcp_client_registers(&asker->tcp_client, to, CANOPY_MODBUS_READ_MAX);
        else
            canopy_modbus_rtu_client_registers(&asker->rtu_client, to, CANOPY_MODBUS_READ_MAX);
        return 0;
    }
}

static int ask_lib(struct asker *asker, const struct canopy_modbus_request *request, uint16_t *to) {
    const int address = request->address, count = request->count;
    int got = -1;
    switch (request->function) {
    case 3: got = modbus_read_registers(asker->lib, address, count, to); break;
    case 4: got = modbus_read_input_registers(asker->lib, address, count, to); break;
    case 6: got = modbus_write_register(asker->lib, address, request->values[0]); break;
    case 16: got = modbus_write_registers(asker->lib, address, count, request->values); break;
    default:
        got = modbus_write_and_read_registers(asker->lib, request->write_address, request->write_count, request->values,
                                              address, count, to);
    }
    if (got >= 0)
        return 0;
    return errno > MODBUS_ENOBASE && errno < MODBUS_ENOBASE + 16 ? errno - MODBUS_ENOBASE : -1;
}

static void ask(struct asker *asker, const struct canopy_modbus_request *request, int wanted, uint16_t *to) {
    const int got = asker->lib ? ask_lib(asker, request, to) : ask_ours(asker, request, to);
    if (got != wanted) {
        fprintf(stderr, "function %d address %d count %d: got %d, wanted %d\n", request->function, request->address,
                request->count, got, wanted);
        exit(1);
    }
    asker->asked++;
}

static void check(bool good, const char *what) {
    if (!good) {
        fprintf(stderr, "wrong registers: %s\n", what);
        exit(1);
    }
}

#define ASK(wanted, ...) ask(asker, &(struct canopy_modbus_request){.unit = US, __VA_ARGS__}, wanted, got)

static void ask_everything(struct asker *asker, unsigned round) {
    uint16_t got[CANOPY_MODBUS_READ_MAX] = {0}, values[CANOPY_MODBUS_WRITE_MAX];
    for (unsigned i = 0; i < CANOPY_MODBUS_WRITE_MAX; i++)
        values[i] = (uint16_t)(1000 * round + i);
    ASK(0, .function = 4, .address = 175, .count = 125);
    for (unsigned i = 0; i < 125; i++)
        check(got[i] == (uint16_t)((175 + i) * 7 + 0x1234), "input");
    ASK(0, .function = 3, .address = 299, .count = 1);
    check(got[0] == 299 * 7 + 0x1234, "holding");
    ASK(0, .function = 6, .address = 3, .count = 1, .values = values);
    ASK(0, .function = 16, .address = 10, .count = 123, .values = values);
    ASK(0, .function = 3, .address = 10, .count = 123);
    check(memcmp(got, values, sizeof values) == 0, "written");
    ASK(0, .function = 23, .address = 9, .count = 3, .write_address = 10, .write_count = 2, .values = values + 50);
    check(got[0] == 9 * 7 + 0x1234 && got[1] == values[50] && got[2] == values[51], "exchanged");
    ASK(0, .function = 23, .address = 0, .count = 125, .write_address = 20, .write_count = 121, .values = values);
    check(got[124] == values[104], "exchanged at most");
    ASK(2, .function = 3, .address = 300, .count = 1);
    ASK(2, .function = 4, .address = 299, .count = 2);
    ASK(2, .function = 6, .address = 60000, .count = 1, .values = values);
    ASK(2, .function = 16, .address = 299, .count = 2, .values = values);
}

static void ask_for_long(struct asker *asker) {
    for (unsigned round = 0; round < ROUNDS; round++)
        ask_everything(asker, round);
    printf("ok %u\n", asker->asked);
}

static void ask_as_ours(const char *kind, const char *where) {
    static struct asker asker;
    asker.tcp = strcmp(kind, "tcp") == 0;
    asker.fd = asker.tcp ? connect_to(where) : open_line(where);
    const struct canopy_modbus_rtu_client_config rtu = {.timeout_us = 2000000, .baud = BAUD, .character_bits = 10};
    const struct canopy_modbus_tcp_client_config tcp = {.timeout_us = 2000000};
    if (canopy_modbus_rtu_client_init(&asker.rtu_client, &rtu, now_us()) != CANOPY_OK ||
        canopy_modbus_tcp_client_init(&asker.tcp_client, &tcp) != CANOPY_OK)
        die("configuration");
    ask_for_long(&asker);
    close(asker.fd);
}

static void ask_as_lib(const char *kind, const char *where) {
    static struct asker asker;
    uint16_t got[8];
    uint8_t bits[8];
    asker.lib =
        strcmp(kind, "tcp") == 0 ? modbus_new_tcp("127.0.0.1", atoi(where)) : modbus_new_rtu(where, BAUD, 'N', 8, 1);
    modbus_set_response_timeout(asker.lib, 2, 0);
    modbus_set_slave(asker.lib, US);
    if (modbus_connect(asker.lib) != 0)
        die(where);
    ask_for_long(&asker);
    check(modbus_read_bits(asker.lib, 0, 1, bits) == -1 && errno == EMBXILFUN, "function 1");
    check(modbus_write_bit(asker.lib, 0, 1) == -1 && errno == EMBXILFUN, "function 5");
    check(modbus_mask_write_register(asker.lib, 0, 1, 1) == -1 && errno == EMBXILFUN, "function 22");
    check(modbus_read_registers(asker.lib, 0, 8, got) == 8, "after what is illegal");
    modbus_close(asker.lib);
    modbus_free(asker.lib);
}

int main(int count, char **words) {
    if (count != 4 || (strcmp(words[2], "rtu") != 0 && strcmp(words[2], "tcp") != 0)) {
        fputs("usage: modbus_peer serve|ask|libserve|libask rtu DEVICE|tcp PORT\n", stderr);
        return 64;
    }
    const bool tcp = strcmp(words[2], "tcp") == 0;
    table_init(&table, &bank);
    table.objects[0] = "canopy";
    table.objects[1] = "peer";
    table.objects[2] = "1.0";
    table.objects[4] = "Modbus test peer";
    if (strcmp(words[1], "serve") == 0)
        (tcp ? serve_tcp : serve_rtu)(words[3]);
    else if (strcmp(words[1], "libserve") == 0)
        (tcp ? libserve_tcp : libserve_rtu)(words[3]);
    else if (strcmp(words[1], "ask") == 0)
        ask_as_ours(words[2], words[3]);
    else if (strcmp(words[1], "libask") == 0)
        ask_as_lib(words[2], words[3]);
    else
        return 64;
    return 0;
}
