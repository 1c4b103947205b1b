#include "port/linux/scanner.h"

#include <errno.h>
#include <poll.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <time.h>
#include <unistd.h>

#include "port/linux/clock.h"
#include "port/linux/log.h"

enum { NAP_US = 20000, FULL_NAP_US = 500 };

static const char *const FAILURES[CANOPY_SCAN_FAILURES] = {
    [CANOPY_SCAN_TIMEOUT] = "no answer",
    [CANOPY_SCAN_CRC] = "broken answers",
    [CANOPY_SCAN_LENGTH] = "answers of the wrong length",
    [CANOPY_SCAN_EXCEPTION] = "a Modbus exception",
    [CANOPY_SCAN_LINK] = "no connection",
    [CANOPY_SCAN_NAK] = "nobody at its address",
    [CANOPY_SCAN_BUS] = "the bus is held",
};

static void ring_bell(int event) {
    const uint64_t one = 1;
    (void)!write(event, &one, sizeof one);  // full means that it rings already
}

static bool stopping(const struct canopy_linux_scanner *scanner) {
    return atomic_load_explicit(&scanner->stop, memory_order_relaxed);
}

// Sleeps until stopped, but no longer.
static void nap(const struct canopy_linux_scanner *scanner, uint64_t us) {
    struct pollfd fd = {.fd = scanner->stop_event, .events = POLLIN};
    const struct timespec time = {.tv_sec = (time_t)(us / 1000000U), .tv_nsec = (long)(us % 1000000U) * 1000};
    (void)ppoll(&fd, 1, &time, NULL);
}

// Pushes; waits while the ring is full. False when it is stopped meanwhile.
static bool push(struct canopy_linux_scanner *scanner, const struct canopy_linux_item *item) {
    while (!canopy_linux_ring_push(&scanner->ring, item)) {
        ring_bell(scanner->news_event);
        if (stopping(scanner)) {
            return false;
        }
        nap(scanner, FULL_NAP_US);
    }
    return true;
}

static void push_profile(struct canopy_linux_scanner *scanner) {
    const struct canopy_profile *profile = canopy_profile_get(&scanner->driver);
    for (uint16_t column = 0; column < profile->columns; column++) {
        struct canopy_reading reading;
        if (!canopy_profile_reading(&scanner->driver, column, &reading) || !reading.valid) {
            continue;
        }
        const struct canopy_linux_item item = {
            .kind = CANOPY_LINUX_READING,
            .as.reading = {.point = {reading.x, reading.y, reading.z}, .uncertainty = reading.uncertainty}};
        if (!push(scanner, &item)) {
            break;
        }
    }
    canopy_profile_done(&scanner->driver);
    ring_bell(scanner->news_event);
}

static void push_scene(struct canopy_linux_scanner *scanner) {
    const struct canopy_profile_scene *scene = canopy_profile_scene(&scanner->driver);
    if (scene == NULL) {
        return;
    }
    canopy_linux_log("scanner: %u columns, %u profiles, unit %g, box %d %d %d to %d %d %d", scene->columns,
                     scene->profiles, (double)scene->unit, scene->low[0], scene->low[1], scene->low[2], scene->high[0],
                     scene->high[1], scene->high[2]);
    const struct canopy_linux_item item = {.kind = CANOPY_LINUX_SCENE, .as.scene = *scene};
    (void)push(scanner, &item);
    ring_bell(scanner->news_event);
}

static void publish_status(struct canopy_linux_scanner *scanner, uint64_t now_us) {
    const bool stale = canopy_profile_stale(&scanner->driver, now_us);
    pthread_mutex_lock(&scanner->lock);
    scanner->status.counters = *canopy_profile_counters(&scanner->driver);
    scanner->status.errors = canopy_profile_errors(&scanner->driver);
    scanner->status.faulty = stale || scanner->mood == CANOPY_LINUX_SCANNER_DOWN;
    scanner->status.updated_us = now_us;
    pthread_mutex_unlock(&scanner->lock);
}

// Says once that it went down or came up; repeated failures are in the counters.
static void note(struct canopy_linux_scanner *scanner, enum canopy_scan_event event, bool fetched,
                 enum canopy_scan_failure failure) {
    if (event == CANOPY_SCAN_PROFILE && scanner->mood != CANOPY_LINUX_SCANNER_UP) {
        scanner->mood = CANOPY_LINUX_SCANNER_UP;
        canopy_linux_log("scanner: profiles are coming in");
        return;
    }
    const bool lost = !fetched && (failure == CANOPY_SCAN_LINK || event == CANOPY_SCAN_DROPPED);
    if (scanner->mood == CANOPY_LINUX_SCANNER_DOWN || (!lost && event != CANOPY_SCAN_REFUSED)) {
        return;
    }
    scanner->mood = CANOPY_LINUX_SCANNER_DOWN;
    if (!lost) {
        canopy_linux_log("scanner: refused: this is not the device that driver=%s means, or it contradicts itself",
                         scanner->driver.table->name);
        return;
    }
    const char *why = scanner->registers.why != NULL ? scanner->registers.why(scanner->registers.context) : "";
    canopy_linux_log("scanner: %s (%s); trying again", FAILURES[failure], why);
}

static void ask(struct canopy_linux_scanner *scanner, const struct canopy_profile_request *request) {
    uint16_t values[CANOPY_SCAN_READ_MAX];
    enum canopy_scan_failure failure = CANOPY_SCAN_LINK;
    const bool fetched = scanner->registers.fetch(scanner->registers.context, request, values, &failure);
    const uint64_t now_us = canopy_linux_now_us();
    const enum canopy_scan_event event = fetched
                                             ? canopy_profile_answer(&scanner->driver, values, request->count, now_us)
                                             : canopy_profile_failed(&scanner->driver, failure, now_us);
    note(scanner, event, fetched, failure);
    if (event == CANOPY_SCAN_SCENE) {
        push_scene(scanner);
    }
    if (canopy_profile_get(&scanner->driver) != NULL) {
        push_profile(scanner);
    }
}

static uint64_t ready_us(const struct canopy_linux_scanner *scanner) {
    return scanner->registers.ready_us != NULL ? scanner->registers.ready_us(scanner->registers.context) : 0;
}

static void *run(void *context) {
    struct canopy_linux_scanner *scanner = context;
    while (!stopping(scanner)) {
        struct canopy_profile_request request;
        const uint64_t now_us = canopy_linux_now_us();
        const bool due = canopy_profile_next(&scanner->driver, now_us, &request);
        const uint64_t ready = ready_us(scanner);
        if (due && ready <= now_us) {
            ask(scanner, &request);
        } else {
            const uint64_t next_us = request.due_us > ready ? request.due_us : ready;
            const uint64_t wait_us = next_us > now_us ? next_us - now_us : 0;
            nap(scanner, wait_us < NAP_US ? wait_us : NAP_US);
        }
        publish_status(scanner, canopy_linux_now_us());
    }
    return NULL;
}

// The thread leaves all signals to the others.
static int start_thread(struct canopy_linux_scanner *scanner) {
    sigset_t all, before;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    const int error = pthread_create(&scanner->thread, NULL, run, scanner);
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    return error;
}

static void release(struct canopy_linux_scanner *scanner) {
    if (scanner->stop_event >= 0) {
        close(scanner->stop_event);
    }
    if (scanner->news_event >= 0) {
        close(scanner->news_event);
    }
    scanner->stop_event = scanner->news_event = -1;
    free(scanner->arena);
    scanner->arena = NULL;
    pthread_mutex_destroy(&scanner->lock);
}

static const char *prepare(struct canopy_linux_scanner *scanner, const struct canopy_profile_table *table,
                           uint8_t unit) {
    const size_t bytes = CANOPY_PROFILE_ARENA(CANOPY_LINUX_SCANNER_COLUMNS, 2);
    scanner->arena = calloc(1, bytes);
    if (scanner->arena == NULL || scanner->stop_event < 0 || scanner->news_event < 0) {
        return strerror(errno);
    }
    const struct canopy_profile_config config = {.table = table, .unit = unit, .columns = CANOPY_LINUX_SCANNER_COLUMNS};
    if (canopy_profile_init(&scanner->driver, &config, scanner->arena, bytes, canopy_linux_now_us()) != CANOPY_OK) {
        return "the driver's table contradicts itself";
    }
    scanner->status.updated_us = canopy_linux_now_us();
    const int error = start_thread(scanner);
    return error == 0 ? NULL : strerror(error);
}

const char *canopy_linux_scanner_start(struct canopy_linux_scanner *scanner, const struct canopy_profile_table *table,
                                       uint8_t unit, struct canopy_linux_registers registers) {
    memset(scanner, 0, sizeof *scanner);
    scanner->registers = registers;
    canopy_linux_ring_init(&scanner->ring);
    atomic_init(&scanner->stop, false);
    pthread_mutex_init(&scanner->lock, NULL);
    scanner->stop_event = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    scanner->news_event = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    const char *wrong = prepare(scanner, table, unit);
    if (wrong != NULL) {
        release(scanner);
    }
    scanner->running = wrong == NULL;
    return wrong;
}

int canopy_linux_scanner_event(const struct canopy_linux_scanner *scanner) { return scanner->news_event; }

void canopy_linux_scanner_hear(struct canopy_linux_scanner *scanner) {
    uint64_t count;
    (void)!read(scanner->news_event, &count, sizeof count);  // nothing to read is as good
}

bool canopy_linux_scanner_look(struct canopy_linux_scanner *scanner, struct canopy_linux_scanner_status *to) {
    if (pthread_mutex_trylock(&scanner->lock) != 0) {
        return false;
    }
    *to = scanner->status;
    pthread_mutex_unlock(&scanner->lock);
    return true;
}

bool canopy_linux_scanner_stop(struct canopy_linux_scanner *scanner, uint32_t wait_us) {
    if (!scanner->running) {
        return true;
    }
    atomic_store_explicit(&scanner->stop, true, memory_order_relaxed);
    ring_bell(scanner->stop_event);
    struct timespec until;
    clock_gettime(CLOCK_REALTIME, &until);
    until.tv_sec += wait_us / 1000000U;
    until.tv_nsec += (long)(wait_us % 1000000U) * 1000;
    if (until.tv_nsec >= 1000000000L) {
        until.tv_nsec -= 1000000000L;
        until.tv_sec++;
    }
    if (pthread_timedjoin_np(scanner->thread, NULL, &until) != 0) {
        return false;
    }
    scanner->running = false;
    release(scanner);
    return true;
}
