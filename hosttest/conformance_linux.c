// port/board.h on port/linux, so that the conformance suite runs on a Linux process too: the clock, the serial lines
// named in CANOPY_LINES, separated by blanks, and the file CANOPY_FLASH as flash. A Linux port has no I2C, no watchdog
// and no interrupts behind port/board.h; a crash is the kernel's business.
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "port/board.h"
#include "port/linux/clock.h"
#include "port/linux/flash_file.h"
#include "port/linux/serial.h"
#include "port/template/i2c.h"

static struct canopy_linux_serial line[CANOPY_BOARD_LINES];
static struct canopy_linux_flash_file flash = {.fd = -1};

static void do_not_feed(void *context) { (void)context; }

static void stop(const char *what, const char *wrong) {
    fprintf(stderr, "%s: %s\n", what, wrong);
    exit(2);
}

struct canopy_flash canopy_board_flash(void) {
    const char *path = getenv("CANOPY_FLASH");
    const char *wrong = flash.fd >= 0  ? NULL
                        : path == NULL ? "not given in CANOPY_FLASH"
                                       : canopy_linux_flash_file_open(&flash, path);
    if (wrong != NULL) {
        stop("flash", wrong);
    }
    return canopy_linux_flash_file(&flash);
}

static void open_lines(const uint32_t *baud) {
    const char *names = getenv("CANOPY_LINES");
    char list[256];
    snprintf(list, sizeof list, "%s", names != NULL ? names : "");
    char *rest = list;
    for (size_t i = 0; i < CANOPY_BOARD_LINES; i++) {
        const struct canopy_linux_serial_config config = {
            .device = strsep(&rest, " "), .baud = baud[i], .parity = 'N', .stop_bits = 1};
        const char *wrong =
            config.device == NULL ? "not given in CANOPY_LINES" : canopy_linux_serial_open(&line[i], &config);
        if (wrong != NULL) {
            stop("line", wrong);
        }
    }
}

struct canopy_board canopy_board_start(const uint32_t baud[CANOPY_BOARD_LINES]) {
    open_lines(baud);
    return (struct canopy_board){
        .clock = canopy_linux_clock(),
        .line = {canopy_linux_serial_stream(&line[0]), canopy_linux_serial_stream(&line[1])},
        .line_count = CANOPY_BOARD_LINES,
        .i2c = canopy_no_i2c(),
        .flash = canopy_board_flash(),
        .watchdog = {.feed = do_not_feed},
    };
}

// Nothing interrupts a process but signals, and there are none.
uint32_t canopy_board_mask(void) { return 0; }

void canopy_board_restore(uint32_t before) { (void)before; }

bool canopy_board_start_watchdog(uint32_t period_us) {
    (void)period_us;
    return false;
}

// What has come is seen by looking at the lines: no interrupt counts it.
uint32_t canopy_board_activity(void) { return 0; }

void canopy_board_sleep(uint64_t due_us, uint32_t seen) {
    (void)seen;
    const uint64_t now_us = canopy_linux_now_us();
    if (due_us <= now_us) {
        return;
    }
    const uint64_t us = due_us - now_us < 100000U ? due_us - now_us : 100000U;
    const struct timespec time = {.tv_nsec = (long)us * 1000L};
    struct pollfd fds[CANOPY_BOARD_LINES];
    for (size_t i = 0; i < CANOPY_BOARD_LINES; i++) {
        fds[i] = (struct pollfd){.fd = line[i].fd, .events = POLLIN};
    }
    (void)ppoll(fds, CANOPY_BOARD_LINES, &time, NULL);
}

void canopy_board_put(char character) { (void)!write(STDERR_FILENO, &character, 1); }

const struct canopy_crash *canopy_board_last_crash(void) { return NULL; }
void canopy_board_forget_crash(void) {}

// The process begins anew with the same environment; the lines are given back, or it could not open them again.
void canopy_board_reset(void) {
    for (size_t i = 0; i < CANOPY_BOARD_LINES; i++) {
        canopy_linux_serial_close(&line[i]);
    }
    canopy_linux_flash_file_close(&flash);
    char name[] = "/proc/self/exe";
    execv(name, (char *[]){name, NULL});
    _exit(1);
}
