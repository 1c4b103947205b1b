// The Linux port: ring, lines, connections, servers, the libmodbus client and the scanner's thread, each with the
// faults that its header speaks of. Times of servers are virtual; where a thread must wait for another, it waits for
// the event.
#include <errno.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <poll.h>
#include <pthread.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <cmocka.h>

#include "lib/scan/generic.h"
#include "port/linux/clock.h"
#include "port/linux/flash_file.h"
#include "port/linux/log.h"
#include "port/linux/modbus_client.h"
#include "port/linux/ring.h"
#include "port/linux/rtu_server.h"
#include "port/linux/scanner.h"
#include "port/linux/tcp_server.h"

static void nap_ms(long ms) {
    const struct timespec time = {.tv_sec = ms / 1000, .tv_nsec = ms % 1000 * 1000000};
    nanosleep(&time, NULL);
}

// ---- Flash in a file

static void test_flash_file(void **state) {
    (void)state;
    char path[] = "/tmp/canopy-flash-XXXXXX";
    assert_non_null(mkdtemp(path));
    char name[64];
    snprintf(name, sizeof name, "%s/settings", path);
    struct canopy_linux_flash_file file, other;
    assert_null(canopy_linux_flash_file_open(&file, name));
    assert_string_equal(canopy_linux_flash_file_open(&other, name), "another program has it");
    assert_int_equal(other.fd, -1);
    assert_true((fcntl(file.fd, F_GETFD) & FD_CLOEXEC) != 0);
    const struct canopy_flash flash = canopy_linux_flash_file(&file);
    assert_int_equal(flash.page_count, 2);
    uint8_t bytes[8] = {0};
    assert_int_equal(flash.read(flash.context, 1, flash.page_bytes - 8, bytes, 8), CANOPY_OK);
    assert_memory_equal(bytes, "\xFF\xFF\xFF\xFF\xFF\xFF\xFF\xFF", 8);
    // only clears bits, wherever it is, and leaves the other page alone
    assert_int_equal(flash.program(flash.context, 1, 3, (const uint8_t *)"\xF0\x0F", 2), CANOPY_OK);
    assert_int_equal(flash.program(flash.context, 1, 2, (const uint8_t *)"\x55\x33\xFF", 3), CANOPY_OK);
    assert_int_equal(flash.program(flash.context, 0, 3, (const uint8_t *)"\x11", 1), CANOPY_OK);
    assert_int_equal(flash.read(flash.context, 1, 0, bytes, 6), CANOPY_OK);
    assert_memory_equal(bytes, "\xFF\xFF\x55\x30\x0F\xFF", 6);
    assert_int_equal(flash.erase(flash.context, 0), CANOPY_OK);
    assert_int_equal(flash.read(flash.context, 0, 3, bytes, 1), CANOPY_OK);
    assert_int_equal(bytes[0], 0xFF);
    // beyond it there is nothing
    assert_int_equal(flash.read(flash.context, 2, 0, bytes, 1), CANOPY_ARGUMENT);
    assert_int_equal(flash.read(flash.context, 0, flash.page_bytes - 7, bytes, 8), CANOPY_ARGUMENT);
    assert_int_equal(flash.program(flash.context, 0, flash.page_bytes, bytes, 1), CANOPY_ARGUMENT);
    assert_int_equal(flash.program(flash.context, 0, 8, bytes, UINT32_MAX), CANOPY_ARGUMENT);
    assert_int_equal(flash.erase(flash.context, 2), CANOPY_ARGUMENT);
    canopy_linux_flash_file_close(&file);
    // what was written stays
    assert_null(canopy_linux_flash_file_open(&file, name));
    assert_int_equal(flash.read(flash.context, 1, 3, bytes, 1), CANOPY_OK);
    assert_int_equal(bytes[0], 0x30);
    // a file that is cut while it is open fails
    assert_int_equal(truncate(name, 100), 0);
    assert_int_equal(flash.read(flash.context, 1, 3, bytes, 1), CANOPY_RANGE);
    assert_int_equal(flash.program(flash.context, 1, 3, bytes, 1), CANOPY_RANGE);
    canopy_linux_flash_file_close(&file);
    assert_int_equal(flash.erase(flash.context, 0), CANOPY_RANGE);
    assert_non_null(canopy_linux_flash_file_open(&file, name));
    assert_int_equal(unlink(name), 0);
    assert_int_equal(rmdir(path), 0);
}

// ---- Clock and log

static void test_clock(void **state) {
    (void)state;
    const struct canopy_clock clock = canopy_linux_clock();
    const uint64_t before = clock.now_us(clock.context);
    nap_ms(20);
    const uint64_t passed = clock.now_us(clock.context) - before;
    assert_in_range(passed, 20000, 10000000);
}

static void test_log_never_waits(void **state) {
    (void)state;
    int ends[2];
    assert_int_equal(pipe(ends), 0);
    fcntl(ends[1], F_SETPIPE_SZ, 4096);
    const int kept = dup(STDERR_FILENO);
    dup2(ends[1], STDERR_FILENO);
    for (int i = 0; i < 1000; i++) {
        canopy_linux_log("line %d\n\x1b[31m and %s", i, "something to fill the pipe with");
    }
    char text[8192];
    ssize_t length = read(ends[0], text, sizeof text - 1);
    canopy_linux_log("last");
    length += read(ends[0], text + length, sizeof text - 1 - (size_t)length);
    dup2(kept, STDERR_FILENO);
    close(kept);
    close(ends[0]);
    close(ends[1]);
    text[length] = '\0';
    assert_non_null(strstr(text, "canopy: line 0??[31m and something"));
    assert_non_null(strstr(text, "lines dropped: standard error was full\ncanopy: last\n"));
    assert_null(strstr(text, "line 999"));
}

// ---- Ring

enum { ITEMS = 300000 };

static void *push_items(void *context) {
    struct canopy_linux_ring *ring = context;
    for (uint32_t i = 0; i < ITEMS; i++) {
        const struct canopy_linux_item item = {
            .kind = CANOPY_LINUX_READING,
            .as.reading = {.point = {(int32_t)i, -(int32_t)i, (int32_t)(i * 7)}, .uncertainty = ~i}};
        while (!canopy_linux_ring_push(ring, &item)) {
            sched_yield();
        }
    }
    return NULL;
}

static void test_ring_between_threads(void **state) {
    (void)state;
    struct canopy_linux_ring *ring = aligned_alloc(64, sizeof *ring);
    assert_non_null(ring);
    canopy_linux_ring_init(ring);
    pthread_t thread;
    assert_int_equal(pthread_create(&thread, NULL, push_items, ring), 0);
    for (uint32_t i = 0; i < ITEMS;) {
        struct canopy_linux_item item;
        if (!canopy_linux_ring_pop(ring, &item)) {
            sched_yield();
            continue;
        }
        assert_true(item.as.reading.point[0] == (int32_t)i && item.as.reading.point[1] == -(int32_t)i &&
                    item.as.reading.point[2] == (int32_t)(i * 7) && item.as.reading.uncertainty == ~i);
        i++;
    }
    pthread_join(thread, NULL);
    assert_true(canopy_linux_ring_empty(ring));
    free(ring);
}

static void test_ring_full_and_wrapping(void **state) {
    (void)state;
    struct canopy_linux_ring *ring = aligned_alloc(64, sizeof *ring);
    assert_non_null(ring);
    canopy_linux_ring_init(ring);
    atomic_store(&ring->head, UINT32_MAX - 5);  // the counters wrap
    atomic_store(&ring->tail, UINT32_MAX - 5);
    struct canopy_linux_item item = {.kind = CANOPY_LINUX_READING};
    for (uint32_t i = 0; i < CANOPY_LINUX_RING_ITEMS; i++) {
        item.as.reading.uncertainty = i;
        assert_true(canopy_linux_ring_push(ring, &item));
    }
    assert_false(canopy_linux_ring_push(ring, &item));
    for (uint32_t i = 0; i < CANOPY_LINUX_RING_ITEMS; i++) {
        assert_true(canopy_linux_ring_pop(ring, &item));
        assert_int_equal(item.as.reading.uncertainty, i);
    }
    assert_false(canopy_linux_ring_pop(ring, &item));
    free(ring);
}

// ---- Serial lines

struct line {
    int master;
    char device[64];
};

static void open_pty(struct line *line) {
    line->master = posix_openpt(O_RDWR | O_NOCTTY);
    assert_true(line->master >= 0);
    assert_int_equal(grantpt(line->master), 0);
    assert_int_equal(unlockpt(line->master), 0);
    assert_int_equal(ptsname_r(line->master, line->device, sizeof line->device), 0);
}

static bool readable(int fd, int ms) {
    struct pollfd wait = {.fd = fd, .events = POLLIN};
    return poll(&wait, 1, ms) == 1 && (wait.revents & POLLIN) != 0;
}

static size_t receive(const struct canopy_stream *stream, uint8_t *to, size_t length) {
    size_t have = 0;
    for (int i = 0; i < 2000 && have < length; i++) {
        have += stream->read(stream->context, to + have, length - have);
        if (have < length) {
            nap_ms(1);
        }
    }
    return have;
}

static void test_serial_line(void **state) {
    (void)state;
    static const struct {
        char parity;
        uint8_t stop_bits;
        tcflag_t flags;
    } forms[] = {{'N', 1, CS8}, {'E', 1, CS8 | PARENB}, {'O', 2, CS8 | PARENB | PARODD | CSTOPB}};
    for (size_t i = 0; i < sizeof forms / sizeof forms[0]; i++) {
        struct line pty;
        open_pty(&pty);
        struct canopy_linux_serial line = {.fd = -1};
        const struct canopy_linux_serial_config config = {
            .device = pty.device, .baud = 19200, .parity = forms[i].parity, .stop_bits = forms[i].stop_bits};
        assert_null(canopy_linux_serial_open(&line, &config));
        struct termios mode;
        assert_int_equal(tcgetattr(line.fd, &mode), 0);
        assert_int_equal(cfgetospeed(&mode), B19200);
        assert_int_equal(mode.c_lflag & (ICANON | ECHO | ISIG), 0);
        const struct canopy_stream stream = canopy_linux_serial_stream(&line);
        uint8_t bytes[300];
        assert_int_equal(stream.read(stream.context, bytes, sizeof bytes), 0);  // does not wait
        for (int b = 0; b < 256; b++) {
            bytes[b] = (uint8_t)b;
        }
        assert_int_equal(write(pty.master, bytes, 256), 256);
        uint8_t back[256] = {0};
        assert_int_equal(receive(&stream, back, 256), 256);
        assert_memory_equal(back, bytes, 256);  // every byte, control characters too
        assert_int_equal(stream.write(stream.context, bytes, 256), 256);
        assert_true(readable(pty.master, 1000));
        size_t have = 0;
        while (have < 256 && readable(pty.master, 1000)) {
            have += (size_t)read(pty.master, back + have, 256 - have);
        }
        assert_memory_equal(back, bytes, 256);
        assert_true(stream.sent(stream.context));
        assert_int_equal(stream.lost(stream.context), 0);
        assert_false(line.gone);
        close(pty.master);
        assert_int_equal(stream.read(stream.context, bytes, sizeof bytes), 0);
        assert_true(line.gone);
        canopy_linux_serial_close(&line);
        canopy_linux_serial_close(&line);
        assert_int_equal(stream.write(stream.context, bytes, 1), 0);
    }
}

static void test_serial_refusals(void **state) {
    (void)state;
    struct canopy_linux_serial line = {.fd = -1};
    struct canopy_linux_serial_config config = {.device = "/dev/null", .baud = 9600, .parity = 'N', .stop_bits = 1};
    assert_string_equal(canopy_linux_serial_open(&line, &config), "this is no serial line");
    config.device = "/nowhere/line";
    assert_string_equal(canopy_linux_serial_open(&line, &config), strerror(ENOENT));
    config.baud = 9601;
    assert_non_null(canopy_linux_serial_open(&line, &config));
    assert_int_equal(line.fd, -1);
    struct line pty;
    open_pty(&pty);
    config = (struct canopy_linux_serial_config){
        .device = pty.device, .baud = 9600, .parity = 'N', .stop_bits = 1, .rs485 = true};
    assert_null(canopy_linux_serial_open(&line, &config));
    assert_false(line.rs485);  // a pseudo-terminal has no driver to switch
    canopy_linux_serial_close(&line);
    close(pty.master);
}

// ---- A bank that counts

struct counting_bank {
    struct canopy_modbus_bank bank;
    unsigned opened[16], reads[16];
};

static uint8_t read_bank(void *context, uint8_t client, uint16_t address, uint16_t count, uint8_t *to) {
    struct counting_bank *bank = context;
    bank->reads[client]++;
    for (uint16_t i = 0; i < count; i++) {
        to[2 * i] = client;
        to[2 * i + 1] = (uint8_t)(address + i);
    }
    return 0;
}

static uint8_t write_bank(void *context, uint8_t client, uint16_t address, uint16_t count, const uint8_t *from,
                          uint8_t function) {
    (void)context, (void)client, (void)address, (void)count, (void)from, (void)function;
    return CANOPY_MODBUS_ILLEGAL_ADDRESS;
}

static void forget(void *context, uint8_t client) {
    struct counting_bank *bank = context;
    bank->opened[client]++;
}

static void start_bank(struct counting_bank *bank) {
    memset(bank, 0, sizeof *bank);
    bank->bank = (struct canopy_modbus_bank){.context = bank, .read = read_bank, .write = write_bank};
}

// ---- RTU server

// `reply` waits at the master's end of the line, or nothing at all.
static size_t master_takes(int master, uint8_t *reply, size_t room, int ms) {
    size_t have = 0;
    while (have < room && readable(master, have == 0 ? ms : 30)) {
        const ssize_t count = read(master, reply + have, room - have);
        if (count <= 0) {
            break;
        }
        have += (size_t)count;
    }
    return have;
}

static size_t with_crc(uint8_t *frame, size_t length) {
    unsigned crc = 0xFFFF;
    for (size_t i = 0; i < length; i++) {
        crc ^= frame[i];
        for (int bit = 0; bit < 8; bit++) {
            crc = crc >> 1 ^ ((crc & 1) != 0 ? 0xA001 : 0);
        }
    }
    frame[length] = (uint8_t)crc;
    frame[length + 1] = (uint8_t)(crc >> 8);
    return length + 2;
}

static size_t exchange(struct canopy_linux_rtu_server *server, int master, uint8_t *frame, size_t length,
                       uint8_t *reply, size_t room) {
    assert_int_equal(write(master, frame, length), length);
    for (int i = 0; i < 40; i++) {
        nap_ms(1);
        canopy_linux_rtu_server_serve(server, canopy_linux_now_us());
    }
    return master_takes(master, reply, room, 0);
}

static void test_rtu_server(void **state) {
    (void)state;
    struct line pty;
    open_pty(&pty);
    struct counting_bank bank;
    start_bank(&bank);
    struct canopy_linux_rtu_server server;
    const struct canopy_linux_rtu_server_config config = {
        .bank = &bank.bank,
        .serial = {.device = pty.device, .baud = 115200, .parity = 'E', .stop_bits = 1},
        .unit = 5,
        .client = 3,
        .forget = forget,
        .context = &bank};
    assert_null(canopy_linux_rtu_server_open(&server, &config));
    assert_int_equal(bank.opened[3], 1);
    uint8_t frame[16] = {5, 3, 0, 8, 0, 2}, reply[64], expected[16] = {5, 3, 4, 3, 8, 3, 9};
    const size_t length = with_crc(frame, 6), wanted = with_crc(expected, 7);
    assert_int_equal(exchange(&server, pty.master, frame, length, reply, sizeof reply), wanted);
    assert_memory_equal(reply, expected, wanted);
    frame[0] = 6;  // a neighbour
    assert_int_equal(exchange(&server, pty.master, frame, with_crc(frame, 6), reply, sizeof reply), 0);
    frame[0] = 5;
    with_crc(frame, 6);
    frame[7] ^= 1;
    assert_int_equal(exchange(&server, pty.master, frame, length, reply, sizeof reply), 0);
    nap_ms(60);
    frame[7] ^= 1;
    assert_int_equal(exchange(&server, pty.master, frame, length, reply, sizeof reply), wanted);
    assert_int_equal(canopy_linux_rtu_server_rx_frames(&server), 2);
    assert_true(canopy_linux_rtu_server_rx_errors(&server) >= 1);
    // The other end goes, and the device with it: it is tried again a second later, and the counters go on.
    close(pty.master);
    const uint64_t now_us = canopy_linux_now_us();
    canopy_linux_rtu_server_serve(&server, now_us);
    assert_int_equal(bank.opened[3], 2);
    assert_in_range(canopy_linux_rtu_server_due(&server), now_us + 900000, now_us + 1100000);
    struct pollfd fd;
    canopy_linux_rtu_server_watch(&server, &fd);
    assert_int_equal(fd.fd, -1);
    assert_int_equal(canopy_linux_rtu_server_rx_frames(&server), 2);
    struct line again;
    open_pty(&again);
    server.config.serial.device = again.device;
    canopy_linux_rtu_server_serve(&server, now_us + 1100000);
    assert_int_equal(exchange(&server, again.master, frame, length, reply, sizeof reply), wanted);
    assert_int_equal(canopy_linux_rtu_server_rx_frames(&server), 3);
    assert_int_equal(canopy_linux_rtu_server_lost(&server), 0);
    canopy_linux_rtu_server_close(&server);
    close(again.master);
}

// ---- TCP server

static int connect_to(uint16_t port) {
    const int fd = socket(AF_INET, SOCK_STREAM, 0);
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons(port)};
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    assert_int_equal(connect(fd, (struct sockaddr *)&address, sizeof address), 0);
    return fd;
}

struct tcp_world {
    struct canopy_linux_tcp_server server;
    struct counting_bank bank;
    uint16_t port;
    uint64_t now_us;
};

static void open_tcp(struct tcp_world *world) {
    start_bank(&world->bank);
    int listener;
    assert_null(canopy_linux_tcp_listen("127.0.0.1", 0, &listener));
    world->port = canopy_linux_tcp_port(listener);
    assert_true(world->port != 0);
    const struct canopy_linux_tcp_server_config config = {.bank = &world->bank.bank,
                                                          .first_client = 2,
                                                          .idle_us = 10000,
                                                          .spare_us = 5000,
                                                          .forget = forget,
                                                          .context = &world->bank};
    canopy_linux_tcp_server_open(&world->server, &config, listener);
    world->now_us = 1000000;
}

static void turn(struct tcp_world *world) {
    struct pollfd fds[CANOPY_LINUX_TCP_FDS];
    canopy_linux_tcp_server_watch(&world->server, world->now_us, fds);
    poll(fds, CANOPY_LINUX_TCP_FDS, 20);
    canopy_linux_tcp_server_serve(&world->server, fds, world->now_us);
}

// Asks for one register; the client number that the answer shows, or -1 if the connection is closed.
static int ask(struct tcp_world *world, int fd) {
    static const uint8_t request[] = {0, 1, 0, 0, 0, 6, 1, 3, 0, 8, 0, 1};
    uint8_t reply[11];
    if (send(fd, request, sizeof request, MSG_NOSIGNAL) != sizeof request) {
        return -1;
    }
    for (int i = 0; i < 5 && !readable(fd, 0); i++) {
        turn(world);
    }
    return recv(fd, reply, sizeof reply, MSG_DONTWAIT) == sizeof reply ? reply[9] : -1;
}

static void test_tcp_clients_come_and_go(void **state) {
    (void)state;
    struct tcp_world world;
    open_tcp(&world);
    int fds[CANOPY_LINUX_TCP_CLIENTS], more;
    for (int i = 0; i < CANOPY_LINUX_TCP_CLIENTS; i++) {
        fds[i] = connect_to(world.port);
        world.now_us += 100;
        assert_int_equal(ask(&world, fds[i]), 2 + i);
        assert_int_equal(world.bank.opened[2 + i], 1);
    }
    more = connect_to(world.port);
    assert_int_equal(ask(&world, more), -1);  // all are busy
    close(more);
    assert_int_equal(world.server.refused, 1);
    world.now_us += 4900;
    for (int i = 1; i < CANOPY_LINUX_TCP_CLIENTS; i++) {
        assert_int_equal(ask(&world, fds[i]), 2 + i);
    }
    more = connect_to(world.port);
    assert_int_equal(ask(&world, more), 2);  // the first was idle the longest
    assert_int_equal(ask(&world, fds[0]), -1);
    assert_int_equal(world.server.evicted, 1);
    assert_int_equal(world.bank.opened[2], 3);  // opened, closed, opened
    assert_int_equal(canopy_linux_tcp_server_rx_frames(&world.server), 16);
    world.now_us += 10000;
    turn(&world);
    for (int i = 1; i < CANOPY_LINUX_TCP_CLIENTS; i++) {
        assert_int_equal(ask(&world, fds[i]), -1);  // idle for too long
    }
    assert_int_equal(canopy_linux_tcp_server_rx_frames(&world.server), 16);
    for (int i = 0; i < CANOPY_LINUX_TCP_CLIENTS; i++) {
        close(fds[i]);
    }
    close(more);
    canopy_linux_tcp_server_close(&world.server);
}

static void test_tcp_client_that_does_not_read(void **state) {
    (void)state;
    struct tcp_world world;
    open_tcp(&world);
    const int deaf = connect_to(world.port), good = connect_to(world.port);
    uint8_t requests[12 * 100];
    for (int i = 0; i < 100; i++) {
        memcpy(requests + 12 * i, (const uint8_t[]){0, 1, 0, 0, 0, 6, 1, 3, 0, 0, 0, 125}, 12);
    }
    fcntl(deaf, F_SETFL, O_NONBLOCK);
    bool blocked = false;
    for (size_t i = 0, gone = 0; i < 30000 && !blocked; i++) {
        const ssize_t count = send(deaf, requests + gone, sizeof requests - gone, MSG_NOSIGNAL);
        gone = count > 0 ? (gone + (size_t)count) % sizeof requests : gone;
        turn(&world);
        struct pollfd fds[CANOPY_LINUX_TCP_FDS];
        canopy_linux_tcp_server_watch(&world.server, world.now_us, fds);
        blocked = fds[0].events == POLLOUT && poll(fds, 1, 0) == 0;
    }
    assert_true(blocked);
    assert_int_equal(ask(&world, good), 3);  // the other one is served all the same
    world.now_us += 9999;
    assert_int_equal(ask(&world, good), 3);
    world.now_us += 1;
    turn(&world);
    assert_int_equal(world.server.clients[0].connection.fd, -1);
    assert_int_equal(ask(&world, good), 3);
    close(deaf);
    close(good);
    canopy_linux_tcp_server_close(&world.server);
}

static void test_tcp_listen_refusals(void **state) {
    (void)state;
    int fd, other;
    assert_non_null(canopy_linux_tcp_listen("no.such.host.invalid", 0, &fd));
    assert_null(canopy_linux_tcp_listen("*", 0, &fd));
    assert_string_equal(canopy_linux_tcp_listen("127.0.0.1", canopy_linux_tcp_port(fd), &other), strerror(EADDRINUSE));
    close(fd);
    assert_int_equal(canopy_linux_tcp_port(-1), 0);
}

// ---- The libmodbus client, against a device that follows a script

struct script {
    int fd;  // listener, or a pty's master
    bool rtu;
    /// One letter a request: a answer, x exception, s silence, c close, w wrong length, l late, b bad CRC, u wrong unit
    const char *acts;
    unsigned requests;
};

static size_t make_answer(char act, const uint8_t *pdu, uint8_t *to) {
    if (act == 'x') {
        to[0] = (uint8_t)(pdu[0] | 0x80);
        to[1] = 6;
        return 2;
    }
    const size_t count = (size_t)(pdu[3] << 8 | pdu[4]) - (act == 'w');
    to[0] = pdu[0];
    to[1] = (uint8_t)(2 * count);
    for (size_t i = 0; i < 2 * count; i++) {
        to[2 + i] = (uint8_t)(pdu[2] + i);
    }
    return 2 + 2 * count;
}

static bool play(struct script *script, int fd, const uint8_t *request, size_t head) {
    const char act = script->acts[script->requests++];
    uint8_t reply[300];
    memcpy(reply, request, head);
    size_t length = head + make_answer(act, request + head, reply + head);
    if (script->rtu) {
        reply[0] = act == 'u' ? (uint8_t)(reply[0] + 1) : reply[0];
        length = with_crc(reply, length);
        reply[length - 1] ^= act == 'b';
    } else {
        reply[4] = (uint8_t)((length - 6) >> 8);
        reply[5] = (uint8_t)(length - 6);
    }
    if (act == 'c') {
        return false;
    }
    if (act == 'l') {
        nap_ms(150);
    }
    if (act != 's') {
        (void)!send(fd, reply, length, MSG_NOSIGNAL);
        if (script->rtu) {
            (void)!write(fd, reply, length);
        }
    }
    return script->acts[script->requests] != '\0';
}

static void *serve_script(void *context) {
    struct script *script = context;
    while (script->acts[script->requests] != '\0') {
        const int fd = script->rtu ? script->fd : accept(script->fd, NULL, NULL);
        uint8_t request[12];
        const size_t wanted = script->rtu ? 8 : 12;
        for (size_t have = 0;;) {
            const ssize_t count = read(fd, request + have, wanted - have);
            if (count <= 0) {
                break;
            }
            have += (size_t)count;
            if (have == wanted) {
                have = 0;
                if (!play(script, fd, request, script->rtu ? 1 : 7)) {
                    break;
                }
            }
        }
        if (!script->rtu) {
            close(fd);
        }
    }
    return NULL;
}

static void expect(struct canopy_linux_modbus_client *client, uint8_t unit, uint16_t address, int outcome) {
    const struct canopy_profile_request request = {.unit = unit, .function = 3, .address = address, .count = 5};
    uint16_t values[CANOPY_SCAN_READ_MAX];
    enum canopy_scan_failure failure = CANOPY_SCAN_FAILURES;
    const uint64_t ready_us = canopy_linux_modbus_ready_us(client), now_us = canopy_linux_now_us();
    if (ready_us > now_us) {
        nap_ms((long)((ready_us - now_us) / 1000 + 1));
    }
    const bool good = canopy_linux_modbus_fetch(client, &request, values, &failure);
    if (outcome < 0) {
        assert_true(good);
        for (unsigned i = 0; i < 5; i++) {
            assert_int_equal(values[i], (uint8_t)(address + 2 * i) << 8 | (uint8_t)(address + 2 * i + 1));
        }
    } else {
        assert_false(good);
        assert_int_equal(failure, outcome);
        assert_true(client->why[0] != '\0');
    }
}

static void test_client_over_tcp(void **state) {
    (void)state;
    struct script script = {.acts = "axaslacaw"};
    assert_null(canopy_linux_tcp_listen("127.0.0.1", 0, &script.fd));
    fcntl(script.fd, F_SETFL, 0);
    char service[8];
    snprintf(service, sizeof service, "%u", canopy_linux_tcp_port(script.fd));
    pthread_t thread;
    assert_int_equal(pthread_create(&thread, NULL, serve_script, &script), 0);
    struct canopy_linux_modbus_client client;
    const struct canopy_linux_modbus_config config = {
        .tcp = true, .host = "127.0.0.1", .service = service, .timeout_us = 100000};
    assert_true(canopy_linux_modbus_open(&client, &config));
    static const int outcomes[] = {-1, CANOPY_SCAN_EXCEPTION, -1, CANOPY_SCAN_TIMEOUT, CANOPY_SCAN_TIMEOUT,
                                   -1, CANOPY_SCAN_LINK,      -1, CANOPY_SCAN_LENGTH};
    for (unsigned i = 0; i < sizeof outcomes / sizeof outcomes[0]; i++) {
        expect(&client, 1, (uint16_t)(10 * i), outcomes[i]);  // what comes late is never taken for the next answer
    }
    pthread_join(thread, NULL);
    close(script.fd);
    // Nobody listens any more: each try fails at once, and the pauses between them grow up to five seconds.
    uint32_t last = 0;
    for (int i = 0; i < 4; i++) {
        expect(&client, 1, 0, CANOPY_SCAN_LINK);
        assert_true(client.back_off_us > last);
        last = client.back_off_us;
    }
    canopy_linux_modbus_close(&client);
    canopy_linux_modbus_close(&client);
}

static void test_client_over_rtu(void **state) {
    (void)state;
    struct line pty;
    open_pty(&pty);
    const int held =
        open(pty.device, O_RDWR | O_NOCTTY);  // so that the script's end sees no hang-up between connections
    struct termios raw;
    tcgetattr(held, &raw);
    cfmakeraw(&raw);
    tcsetattr(held, TCSANOW, &raw);
    struct script script = {.acts = "axabuaslaw", .rtu = true, .fd = pty.master};
    pthread_t thread;
    assert_int_equal(pthread_create(&thread, NULL, serve_script, &script), 0);
    struct canopy_linux_modbus_client client;
    const struct canopy_linux_modbus_config config = {
        .serial = {.device = pty.device, .baud = 115200, .parity = 'E', .stop_bits = 1}, .timeout_us = 100000};
    assert_true(canopy_linux_modbus_open(&client, &config));
    static const int outcomes[] = {
        -1, CANOPY_SCAN_EXCEPTION, -1, CANOPY_SCAN_CRC, CANOPY_SCAN_CRC, -1, CANOPY_SCAN_TIMEOUT, CANOPY_SCAN_TIMEOUT};
    for (unsigned i = 0; i < sizeof outcomes / sizeof outcomes[0]; i++) {
        expect(&client, 9, (uint16_t)(10 * i), outcomes[i]);
    }
    nap_ms(200);  // the late answer arrives, and is nobody's
    expect(&client, 9, 200, -1);
    expect(&client, 9, 210, CANOPY_SCAN_LENGTH);
    pthread_join(thread, NULL);
    canopy_linux_modbus_close(&client);
    close(held);
    close(pty.master);
}

// ---- The scanner's thread

// A generic scanner in memory, of one profile that grows a sequence number with each look, or a wall.
struct device {
    atomic_bool blocked;
    atomic_uint fetches;
    pthread_mutex_t wall;
    uint16_t sequence;
};

enum { COLUMNS = 50 };

static uint16_t device_register(const struct device *device, uint16_t address) {
    static const uint16_t description[CANOPY_GENERIC_D_COUNT] = {
        0x434E, 0x5053, 1, 77, COLUMNS, 0, 0, 100,  0, 2,    0, 1000, 1,      0,
        0,      0,      0, 0,  0,       0, 0, 1000, 0, 1000, 0, 9000, 0x3F80, 0};
    if (address < CANOPY_GENERIC_D_COUNT) {
        return description[address];
    }
    const uint16_t header[] = {device->sequence, 77, 0, device->sequence, COLUMNS};
    const unsigned at = address - CANOPY_GENERIC_PROFILE;
    return at < 5 ? header[at] : at == 5 + COLUMNS ? device->sequence : (uint16_t)(device->sequence * 10 + at);
}

static bool device_fetch(void *context, const struct canopy_profile_request *request, uint16_t *registers,
                         enum canopy_scan_failure *failure) {
    struct device *device = context;
    atomic_fetch_add(&device->fetches, 1);
    if (atomic_load(&device->blocked)) {
        pthread_mutex_lock(&device->wall);
        pthread_mutex_unlock(&device->wall);
        *failure = CANOPY_SCAN_TIMEOUT;
        return false;
    }
    if (request->address == CANOPY_GENERIC_PROFILE) {
        device->sequence = device->sequence == UINT16_MAX ? 1 : (uint16_t)(device->sequence + 1);
    }
    for (uint16_t i = 0; i < request->count; i++) {
        registers[i] = device_register(device, (uint16_t)(request->address + i));
    }
    return true;
}

static struct canopy_linux_scanner scanner;

static void start_scanner(struct device *device) {
    *device = (struct device){.sequence = 0};
    pthread_mutex_init(&device->wall, NULL);
    const struct canopy_linux_registers registers = {.context = device, .fetch = device_fetch};
    assert_null(canopy_linux_scanner_start(&scanner, &canopy_profile_generic, 1, registers));
}

static bool pop_soon(struct canopy_linux_item *item) {
    for (int i = 0; i < 500; i++) {
        if (canopy_linux_ring_pop(&scanner.ring, item)) {
            return true;
        }
        (void)readable(canopy_linux_scanner_event(&scanner), 10);
        canopy_linux_scanner_hear(&scanner);
    }
    return false;
}

static void test_scanner_hands_over_in_order(void **state) {
    (void)state;
    struct device device;
    start_scanner(&device);
    struct canopy_linux_item item;
    assert_true(pop_soon(&item));
    assert_int_equal(item.kind, CANOPY_LINUX_SCENE);  // before any reading
    assert_int_equal(item.as.scene.columns, COLUMNS);
    assert_int_equal(item.as.scene.high[2], 9000);
    // Nobody pops for a while: the ring fills, the thread waits, and nothing is lost or out of order.
    for (int i = 0; i < 2000 && !atomic_load(&device.fetches); i++) {
        nap_ms(1);
    }
    unsigned before;
    do {
        before = atomic_load(&device.fetches);
        nap_ms(100);
    } while (atomic_load(&device.fetches) != before);
    int32_t y = 0;
    for (uint32_t i = 0; i < 3 * CANOPY_LINUX_RING_ITEMS; i++) {
        assert_true(pop_soon(&item));
        assert_int_equal(item.kind, CANOPY_LINUX_READING);
        const uint32_t column = i % COLUMNS;
        y = column == 0 ? item.as.reading.point[1] : y;
        assert_int_equal(y, i / COLUMNS + 1);
        assert_int_equal(item.as.reading.point[0], 100 + 2 * (int32_t)column);
        assert_int_equal(item.as.reading.point[1], y);
        assert_int_equal(item.as.reading.point[2], 1000 + (uint16_t)(y * 10 + 5 + (int32_t)column));
    }
    struct canopy_linux_scanner_status status = {.faulty = true};
    while (!canopy_linux_scanner_look(&scanner, &status)) {}
    assert_false(status.faulty);
    assert_int_equal(status.errors, 0);
    assert_true(status.counters.profiles >= 3 * CANOPY_LINUX_RING_ITEMS / COLUMNS);
    assert_true(canopy_linux_scanner_stop(&scanner, 2000000));  // also while it waits for the ring
    assert_true(canopy_linux_scanner_stop(&scanner, 2000000));
}

static void test_scanner_that_blocks(void **state) {
    (void)state;
    struct device device;
    start_scanner(&device);
    pthread_mutex_lock(&device.wall);
    atomic_store(&device.blocked, true);
    const unsigned before = atomic_load(&device.fetches);
    struct canopy_linux_item item;
    for (int i = 0; i < 2000 && atomic_load(&device.fetches) < before + 1; i++) {
        (void)canopy_linux_ring_pop(&scanner.ring, &item);
        nap_ms(1);
    }
    nap_ms(50);
    while (canopy_linux_ring_pop(&scanner.ring, &item)) {}
    // It hangs: looking at it does not, and stopping it gives up in time.
    struct canopy_linux_scanner_status status = {.updated_us = 0};
    const uint64_t begin_us = canopy_linux_now_us();
    assert_true(canopy_linux_scanner_look(&scanner, &status));
    assert_false(canopy_linux_scanner_stop(&scanner, 100000));
    assert_true(canopy_linux_now_us() - begin_us < 3000000);
    pthread_mutex_unlock(&device.wall);
    assert_true(canopy_linux_scanner_stop(&scanner, 2000000));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_flash_file),
        cmocka_unit_test(test_clock),
        cmocka_unit_test(test_log_never_waits),
        cmocka_unit_test(test_ring_between_threads),
        cmocka_unit_test(test_ring_full_and_wrapping),
        cmocka_unit_test(test_serial_line),
        cmocka_unit_test(test_serial_refusals),
        cmocka_unit_test(test_rtu_server),
        cmocka_unit_test(test_tcp_clients_come_and_go),
        cmocka_unit_test(test_tcp_client_that_does_not_read),
        cmocka_unit_test(test_tcp_listen_refusals),
        cmocka_unit_test(test_client_over_tcp),
        cmocka_unit_test(test_client_over_rtu),
        cmocka_unit_test(test_scanner_hands_over_in_order),
        cmocka_unit_test(test_scanner_that_blocks),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
