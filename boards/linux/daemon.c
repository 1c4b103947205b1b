#include "boards/linux/daemon.h"

#include <errno.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/signalfd.h>
#include <time.h>
#include <unistd.h>

#include "boards/linux/frame.h"
#include "port/linux/clock.h"
#include "port/linux/log.h"

enum {
    TAKE_US = 300,       // for readings, a turn
    STEP_US = 500,       // for the station, a turn
    TAKE_AT_ONCE = 64,   // readings between two looks at the clock
    STEP_AT_ONCE = 4,    // units of work between two
    REST_US = 10000,     // a turn without events
    SPARE_US = 5000000,  // a TCP client idle for so long makes room for another
    HANG_US = 3000000,   // a scanner's thread silent for so long hangs in a read
    CALM_US = 1000000,   // between two lines about the status
    STOP_US = 1000000,
    DESCRIPTORS_SPARE = 16  // standard streams, signals, events, the scanner's link, a file being read
};

#define CELLS_MOST (1U << 20)  // a fit begins, and a publication ends, with one look at all of them: a few ms

// ---- Opening

static void forget(void *context, uint8_t client) {
    struct canopyd *daemon = context;
    canopy_plc_forget(&daemon->station.plc, client);
}

static bool open_tcp(struct canopyd *daemon, const struct canopyd_modbus_url *url, uint8_t client, uint32_t idle_ms,
                     struct canopy_fault *fault) {
    int listener;
    const char *wrong = canopy_linux_tcp_listen(url->host, url->port, &listener);
    if (wrong != NULL) {
        return canopy_fault_set(fault, "--modbus tcp:%s:%u: %s: choose another address or port", url->host, url->port,
                                wrong);
    }
    const struct canopy_linux_tcp_server_config config = {.bank = &daemon->bank,
                                                          .first_client = client,
                                                          .idle_us = idle_ms * 1000U,
                                                          .spare_us = SPARE_US,
                                                          .forget = forget,
                                                          .context = daemon};
    canopy_linux_tcp_server_open(&daemon->tcp[daemon->tcp_count++], &config, listener);
    canopy_linux_log("modbus: listening on tcp:%s:%u", url->host, canopy_linux_tcp_port(listener));
    return true;
}

static bool open_rtu(struct canopyd *daemon, const struct canopyd_modbus_url *url, uint8_t client,
                     struct canopy_fault *fault) {
    const struct canopy_linux_rtu_server_config config = {.bank = &daemon->bank,
                                                          .serial = url->serial,
                                                          .unit = url->unit,
                                                          .client = client,
                                                          .forget = forget,
                                                          .context = daemon};
    const char *wrong = canopy_linux_rtu_server_open(&daemon->rtu[daemon->rtu_count], &config);
    if (wrong != NULL) {
        return canopy_fault_set(fault, "--modbus rtu: %s: %s: give a free serial line", url->serial.device, wrong);
    }
    daemon->rtu_count++;
    canopy_linux_log("modbus: unit %u on rtu:%s", url->unit, url->serial.device);
    return true;
}

static unsigned places(const struct canopyd_modbus_url *url) { return url->tcp ? CANOPY_LINUX_TCP_CLIENTS : 1; }

static bool open_servers(struct canopyd *daemon, const struct canopyd_options *options, struct canopy_fault *fault) {
    unsigned client = 0;
    for (unsigned i = 0; i < options->modbus_count; i++) {
        const struct canopyd_modbus_url *url = &options->modbus[i];
        if (!(url->tcp ? open_tcp(daemon, url, (uint8_t)client, options->idle_ms, fault)
                       : open_rtu(daemon, url, (uint8_t)client, fault))) {
            return false;
        }
        client += places(url);
    }
    return true;
}

// Larger ones would keep PLCs waiting: there is work that looks once at every coefficient.
enum { TIGHT_MOST = 4096 };

static bool open_tightening(struct canopyd *daemon, const struct canopy_grid *grid, struct canopy_fault *fault) {
    const uint16_t m = grid->size[0], n = grid->size[1];
    if (m * n > TIGHT_MOST) {
        return canopy_fault_set(fault,
                                "method tight takes at most %d coefficients, not %ux%u: choose another grid, or fast",
                                TIGHT_MOST, m, n);
    }
    const uint32_t rows = CANOPY_TIGHTEN_ROWS(m, n);
    const size_t bytes = CANOPY_STATION_TIGHTENING_ARENA(m, n, grid->cells, rows);
    daemon->tightening_arena = aligned_alloc(64, (bytes + 63) / 64 * 64);
    if (daemon->tightening_arena == NULL) {
        return canopy_fault_set(fault, "no memory to tighten a grid of %ux%u: choose a smaller one, or fast", m, n);
    }
    memset(daemon->tightening_arena, 0, bytes);
    if (canopy_station_tightening_init(&daemon->tightening, grid, rows, daemon->tightening_arena, bytes) != CANOPY_OK) {
        return canopy_fault_set(fault, "a grid of %ux%u cannot be tightened: choose another, or fast", m, n);
    }
    daemon->station.spare = &daemon->tightening.spare;
    return true;
}

static bool open_station(struct canopyd *daemon, const struct canopyd_options *options, const struct canopy_grid *grid,
                         struct canopy_fault *fault) {
    unsigned clients = 0;
    for (unsigned i = 0; i < options->modbus_count; i++) {
        clients += places(&options->modbus[i]);
    }
    canopy_station_turned_init(&daemon->turned);
    struct canopy_station_config config = {.grid = *grid,
                                           .turning = &daemon->turned.part,
                                           .fit = &canopy_line_fit_fx,
                                           .lines = options->lines,
                                           .clients = (uint8_t)clients,
                                           .unit = daemon->told_unit > 0 ? (float)daemon->told_unit : 1.0F,
                                           .stale_after_us = options->stale_after_ms * 1000U,
                                           .interval_us = options->interval_ms * 1000U,
                                           .refresh_us = options->refresh_ms * 1000U};
    memcpy(config.axes, options->axes, sizeof config.axes);
    const uint16_t m = grid->size[0], n = grid->size[1], q = grid->cells;
    const size_t bytes = CANOPY_STATION_ARENA(m, n, q, options->lines, clients);
    daemon->arena = aligned_alloc(64, (bytes + 63) / 64 * 64);
    if (daemon->arena == NULL) {
        return canopy_fault_set(fault, "no memory for a grid of %ux%u with %u cells: choose fewer", m, n, q);
    }
    memset(daemon->arena, 0, bytes);  // now, not page by page while PLCs wait
    if (canopy_station_init(&daemon->station, &config, daemon->arena, bytes, canopy_linux_now_us()) != CANOPY_OK) {
        return canopy_fault_set(fault, "a grid of %ux%u with %u cells and %u lines is refused: choose others", m, n, q,
                                options->lines);
    }
    daemon->bank = canopy_station_bank(&daemon->station);
    daemon->station.scan = &daemon->scan.counters;
    return !options->tight || open_tightening(daemon, grid, fault);
}

// Reads what frame there is to keep to, and what is known of the unit.
static bool plan(struct canopyd *daemon, const struct canopyd_options *options, struct canopy_grid *grid,
                 struct canopy_frame *frame, struct canopy_fault *fault) {
    *grid = (struct canopy_grid){
        .size = {options->size[0], options->size[1]}, .cells = options->field, .side = options->side};
    daemon->told_unit = options->unit;
    if (options->frame != NULL) {
        static const uint16_t any[2];
        double unit;
        if (!canopyd_frame_read(options->frame, options->size_given ? options->size : any, grid, frame, &unit, fault)) {
            return false;
        }
        const float wanted = (float)options->unit, has = (float)unit;
        if (options->unit > 0 && memcmp(&wanted, &has, sizeof has) != 0) {
            return canopy_fault_set(fault, "%s: its unit is %g, not that of --unit: leave --unit out", options->frame,
                                    unit);
        }
        daemon->told_unit = unit;
        daemon->framed = true;
    }
    const uint64_t cells = (uint64_t)grid->cells * grid->cells * (grid->size[0] - 1U) * (grid->size[1] - 1U);
    return cells <= CELLS_MOST ||
           canopy_fault_set(fault,
                            "--field %u: a grid of %ux%u has %llu cells then, over %u: "
                            "choose a smaller one",
                            grid->cells, grid->size[0], grid->size[1], (unsigned long long)cells, CELLS_MOST);
}

static bool open_scanner(struct canopyd *daemon, const struct canopyd_options *options, struct canopy_fault *fault) {
    const struct canopyd_scanner_url *url = &options->scanner;
    if (!canopyd_source_open(&daemon->source, url, daemon->told_unit, options->timeout_ms * 1000U, fault)) {
        return false;
    }
    if (daemon->source.table->low[0].where == CANOPY_SCAN_ABSENT && !daemon->framed) {
        return canopy_fault_set(fault, "driver=%s: this scanner does not tell its scene: give a --frame", url->driver);
    }
    return true;
}

// So that no connection is ever refused for want of a descriptor, and poll takes the whole list.
static bool enough_descriptors(const struct canopyd_options *options, struct canopy_fault *fault) {
    struct rlimit limit;
    rlim_t needed = DESCRIPTORS_SPARE;
    for (unsigned i = 0; i < options->modbus_count; i++) {
        needed += options->modbus[i].tcp ? CANOPY_LINUX_TCP_FDS + 1 : 1;  // a newcomer is taken before it is sent away
    }
    return getrlimit(RLIMIT_NOFILE, &limit) != 0 || limit.rlim_cur >= needed ||
           canopy_fault_set(fault, "only %llu open files are allowed: give %llu by ulimit -n, or fewer --modbus",
                            (unsigned long long)limit.rlim_cur, (unsigned long long)needed);
}

static bool block_signals(struct canopyd *daemon, struct canopy_fault *fault) {
    sigset_t set;
    sigemptyset(&set);
    sigaddset(&set, SIGINT);
    sigaddset(&set, SIGTERM);
    pthread_sigmask(SIG_BLOCK, &set, NULL);
    signal(SIGPIPE, SIG_IGN);
    daemon->signals = signalfd(-1, &set, SFD_NONBLOCK | SFD_CLOEXEC);
    return daemon->signals >= 0 || canopy_fault_set(fault, "signals: %s", strerror(errno));
}

bool canopyd_open(struct canopyd *daemon, struct canopyd_options *options, struct canopy_fault *fault) {
    memset(daemon, 0, sizeof *daemon);
    daemon->signals = -1;
    daemon->keep.file.fd = -1;
    struct canopy_grid grid;
    struct canopy_frame frame;
    if (!block_signals(daemon, fault) || !enough_descriptors(options, fault) ||
        !canopyd_keep_open(&daemon->keep, options, fault) || !plan(daemon, options, &grid, &frame, fault) ||
        !open_scanner(daemon, options, fault) || !open_station(daemon, options, &grid, fault)) {
        return false;
    }
    if (daemon->framed && canopy_station_begin(&daemon->station, &frame) != CANOPY_OK) {
        return canopy_fault_set(fault, "%s: this frame is refused: give one made with canopy fit --scalar fx",
                                options->frame);
    }
    canopyd_keep_attach(&daemon->keep, &daemon->station);
    if (!open_servers(daemon, options, fault)) {
        return false;
    }
    const char *wrong = canopy_linux_scanner_start(&daemon->scanner, daemon->source.table, options->scanner.unit,
                                                   daemon->source.registers);
    return wrong == NULL || canopy_fault_set(fault, "--scanner %s: %s", options->scanner.text, wrong);
}

// ---- One turn

static void begin_scene(struct canopyd *daemon, const struct canopy_profile_scene *scene) {
    const float told = (float)daemon->told_unit;
    daemon->deaf = daemon->told_unit > 0 && memcmp(&told, &scene->unit, sizeof told) != 0;
    if (daemon->deaf) {
        canopy_linux_log("scanner: its unit is %g, not %g as told: its readings are refused", (double)scene->unit,
                         daemon->told_unit);
        return;
    }
    if (daemon->framed) {
        return;
    }
    const enum canopy_status status = canopy_station_begin_scene(&daemon->station, scene);
    daemon->deaf = status != CANOPY_OK;
    if (daemon->deaf) {
        canopy_linux_log("scanner: no frame holds this scene (status %d): its readings are refused", (int)status);
    }
}

static void take(struct canopyd *daemon, const struct canopy_linux_item *item, uint64_t now_us) {
    if (item->kind == CANOPY_LINUX_SCENE) {
        begin_scene(daemon, &item->as.scene);
    } else if (!daemon->deaf) {
        (void)canopy_station_reading(&daemon->station, item->as.reading.point, item->as.reading.uncertainty, now_us);
    }
}

// Takes readings while there are any and the time lasts.
static void take_readings(struct canopyd *daemon) {
    canopy_linux_scanner_hear(&daemon->scanner);
    const uint64_t begin_us = canopy_linux_now_us();
    for (uint64_t now_us = begin_us; now_us - begin_us < TAKE_US; now_us = canopy_linux_now_us()) {
        for (int i = 0; i < TAKE_AT_ONCE; i++) {
            struct canopy_linux_item item;
            if (!canopy_linux_ring_pop(&daemon->scanner.ring, &item)) {
                return;
            }
            take(daemon, &item, now_us);
        }
    }
}

static bool is_busy(const struct canopyd *daemon) { return canopy_station_is_working(&daemon->station); }

static void step(struct canopyd *daemon) {
    const uint64_t begin_us = canopy_linux_now_us();
    uint64_t now_us = begin_us;
    do {
        canopy_station_step(&daemon->station, STEP_AT_ONCE, now_us);
        now_us = canopy_linux_now_us();
    } while (is_busy(daemon) && now_us - begin_us < STEP_US);
}

static void count(struct canopyd *daemon, uint64_t now_us) {
    struct canopy_station_port port = {.cycle_us = (uint32_t)(now_us - daemon->turn_us)};
    for (unsigned i = 0; i < daemon->tcp_count; i++) {
        port.rx_frames += canopy_linux_tcp_server_rx_frames(&daemon->tcp[i]);
        port.rx_errors += canopy_linux_tcp_server_rx_errors(&daemon->tcp[i]);
    }
    for (unsigned i = 0; i < daemon->rtu_count; i++) {
        port.rx_frames += canopy_linux_rtu_server_rx_frames(&daemon->rtu[i]);
        port.rx_errors += canopy_linux_rtu_server_rx_errors(&daemon->rtu[i]);
        port.lost_bytes += canopy_linux_rtu_server_lost(&daemon->rtu[i]);
    }
    daemon->cycle_max_us = port.cycle_us > daemon->cycle_max_us ? port.cycle_us : daemon->cycle_max_us;
    port.cycle_max_us = daemon->cycle_max_us;
    daemon->station.port = port;
    (void)canopy_linux_scanner_look(&daemon->scanner, &daemon->scan);  // else the last look stands
    daemon->station.scan_errors = daemon->scan.errors;
    const bool hangs = now_us > daemon->scan.updated_us && now_us - daemon->scan.updated_us > HANG_US;
    daemon->station.sensor_faults = daemon->deaf || daemon->scan.faulty || hangs;
}

// Logs what the status says when it has changed, but not more often than once a second.
static void tell(struct canopyd *daemon, uint64_t now_us) {
    struct canopy_plc_live live = {0};
    daemon->station.plc.config.source.live(daemon->station.plc.config.source.context, &live);
    if (live.status == daemon->status || now_us - daemon->status_us < CALM_US) {
        return;
    }
    daemon->status = live.status;
    daemon->status_us = now_us;
    if (canopy_plc_sequence(&daemon->station.plc) == 0) {
        canopy_linux_log("no envelope");
        return;
    }
    canopy_linux_log("envelope %u of %u readings, %u %% covered: %s%s%s", canopy_plc_sequence(&daemon->station.plc),
                     daemon->station.published_points, live.coverage_pct,
                     (live.status & CANOPY_PLC_VALID) != 0 ? "valid" : "not valid",
                     (live.status & CANOPY_PLC_INTRUSION) != 0 ? ", intrusion" : "",
                     (live.status & CANOPY_PLC_STALE) != 0 ? ", stale" : "");
}

// ---- The loop

enum { FDS_MOST = 2 + CANOPYD_MODBUS_MAX * CANOPY_LINUX_TCP_FDS };

static unsigned watch(const struct canopyd *daemon, struct pollfd *fds, uint64_t now_us, uint64_t *due_us) {
    unsigned count = 0;
    *due_us = now_us + REST_US;
    fds[count++] = (struct pollfd){.fd = daemon->signals, .events = POLLIN};
    fds[count++] = (struct pollfd){.fd = canopy_linux_scanner_event(&daemon->scanner), .events = POLLIN};
    for (unsigned i = 0; i < daemon->rtu_count; i++) {
        const uint64_t due = canopy_linux_rtu_server_due(&daemon->rtu[i]);
        *due_us = due < *due_us ? due : *due_us;
        canopy_linux_rtu_server_watch(&daemon->rtu[i], &fds[count++]);
    }
    for (unsigned i = 0; i < daemon->tcp_count; i++, count += CANOPY_LINUX_TCP_FDS) {
        canopy_linux_tcp_server_watch(&daemon->tcp[i], now_us, &fds[count]);
    }
    return count;
}

static void serve(struct canopyd *daemon, const struct pollfd *fds) {
    const struct pollfd *next = fds + 2;
    for (unsigned i = 0; i < daemon->rtu_count; i++, next++) {
        canopy_linux_rtu_server_serve(&daemon->rtu[i], canopy_linux_now_us());
    }
    for (unsigned i = 0; i < daemon->tcp_count; i++, next += CANOPY_LINUX_TCP_FDS) {
        canopy_linux_tcp_server_serve(&daemon->tcp[i], next, canopy_linux_now_us());
    }
}

enum turn { GO_ON, SIGNALLED, RESTART, BROKEN };

static enum turn turn(struct canopyd *daemon) {
    struct pollfd fds[FDS_MOST];
    uint64_t due_us, now_us = canopy_linux_now_us();
    const unsigned count_fds = watch(daemon, fds, now_us, &due_us);
    const bool at_once = is_busy(daemon) || !canopy_linux_ring_empty(&daemon->scanner.ring) || due_us <= now_us;
    const long wait_ns = at_once ? 0 : (long)(due_us - now_us) * 1000;
    const struct timespec wait = {.tv_sec = 0, .tv_nsec = wait_ns};
    if (ppoll(fds, count_fds, &wait, NULL) < 0 && errno != EINTR) {
        canopy_linux_log("poll: %s", strerror(errno));
        return BROKEN;
    }
    daemon->turn_us = canopy_linux_now_us();
    if (fds[0].revents != 0) {
        canopy_linux_log("ended by a signal");
        return SIGNALLED;
    }
    serve(daemon, fds);
    take_readings(daemon);
    step(daemon);
    now_us = canopy_linux_now_us();
    count(daemon, now_us);
    tell(daemon, now_us);
    if (!canopyd_keep_step(&daemon->keep, now_us)) {
        canopy_linux_log("restarted by a PLC");
        return RESTART;
    }
    return GO_ON;
}

enum canopyd_end canopyd_run(struct canopyd *daemon) {
    enum turn last;
    do {
        last = turn(daemon);
    } while (last == GO_ON);
    return last == SIGNALLED ? CANOPYD_SIGNALLED : last == RESTART ? CANOPYD_RESTART : CANOPYD_FAILED;
}

bool canopyd_close(struct canopyd *daemon) {
    for (unsigned i = 0; i < daemon->tcp_count; i++) {
        canopy_linux_tcp_server_close(&daemon->tcp[i]);
    }
    for (unsigned i = 0; i < daemon->rtu_count; i++) {
        canopy_linux_rtu_server_close(&daemon->rtu[i]);
    }
    if (!canopy_linux_scanner_stop(&daemon->scanner, STOP_US)) {
        return false;
    }
    canopyd_source_close(&daemon->source);
    canopyd_keep_close(&daemon->keep);
    free(daemon->arena);
    free(daemon->tightening_arena);
    daemon->arena = daemon->tightening_arena = NULL;
    if (daemon->signals >= 0) {
        close(daemon->signals);
    }
    daemon->signals = -1;
    return true;
}
