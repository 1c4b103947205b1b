// canopy-scanner as a program, over a real pseudo-terminal: read by the library's own Modbus client and driver.
//
// Times are printed, not judged: how long a pseudo-terminal takes says something about the host, not about us.
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <poll.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <cmocka.h>

#include "lib/modbus/rtu.h"
#include "lib/scan/generic.h"
#include "lib/scan/profile.h"

#define COLUMNS_MOST 488

static bool hole(int64_t column, int64_t profile) { return (column * 5 + profile * 3) % 17 == 0; }

static int32_t height(int64_t column, int64_t profile) { return (int32_t)((profile * 977 + column * 61) % 60000); }

static uint64_t now_us(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

// ---------------------------------------------------------------------------------------------------------------------
// The simulator

struct scanner {
    char directory[32], points[64], served[64], device[64];
    uint32_t columns, profiles, valid;
    pid_t pid;
    int line;
};

static void make_scene(struct scanner *scanner, uint32_t columns, uint32_t profiles) {
    *scanner = (struct scanner){.directory = "/tmp/canopy-wire-XXXXXX", .columns = columns, .profiles = profiles};
    assert_non_null(mkdtemp(scanner->directory));
    snprintf(scanner->points, sizeof scanner->points, "%s/points.xyz", scanner->directory);
    snprintf(scanner->served, sizeof scanner->served, "%s/served.xyz", scanner->directory);
    FILE *out = fopen(scanner->points, "w");
    assert_non_null(out);
    for (uint32_t p = 0; p < profiles; p++)
        for (uint32_t c = 0; c < columns; c++)
            if (!hole(c, p)) {
                fprintf(out, "%u %u %" PRId32 "\n", c * 7, p * 3, height(c, p));
                scanner->valid++;
            }
    fclose(out);
}

// The program under test. Without CANOPY_BUILD (hosttest/run sets it) nobody promised that it was built.
static const char *build_directory(void) {
    const char *build = getenv("CANOPY_BUILD");
    if (build == NULL && access("build/host/canopy-scanner", X_OK) != 0)
        skip();
    return build != NULL ? build : "build";
}

// Runs canopy-scanner with `options` (blanks between them) and opens the line it offers.
static void start(struct scanner *scanner, const char *options) {
    char command[768], word[64] = "", name[64] = "";
    int out[2];
    snprintf(command, sizeof command, "exec %s/host/canopy-scanner %s --unit 1 --rtu pty --served %s %s 2>%s/log",
             build_directory(), scanner->points, scanner->served, options, scanner->directory);
    assert_int_equal(pipe(out), 0);
    scanner->pid = fork();
    if (scanner->pid == 0) {
        dup2(out[1], STDOUT_FILENO);
        close(out[0]);
        close(out[1]);
        execl("/bin/sh", "sh", "-c", command, (char *)NULL);
        _exit(127);
    }
    close(out[1]);
    FILE *said = fdopen(out[0], "r");
    assert_non_null(said);
    while (fscanf(said, "%63s", word) == 1 && strcmp(word, "ready") != 0)
        if (strcmp(word, "rtu") == 0)
            assert_int_equal(fscanf(said, "%63s", name), 1);
    fclose(said);
    assert_string_equal(word, "ready");
    memcpy(scanner->device, name, sizeof name);
    scanner->line = open(scanner->device, O_RDWR | O_NOCTTY | O_NONBLOCK);
    assert_true(scanner->line >= 0);
    struct termios mode;
    assert_int_equal(tcgetattr(scanner->line, &mode), 0);
    cfmakeraw(&mode);
    assert_int_equal(tcsetattr(scanner->line, TCSANOW, &mode), 0);
}

// Ends it and checks that the log has `lines` lines, each a reading of the scene.
static void stop(struct scanner *scanner, uint64_t least, uint64_t most) {
    int status = 0;
    double x = 0, y = 0, z = 0;
    uint64_t lines = 0;
    close(scanner->line);
    kill(scanner->pid, SIGTERM);
    assert_int_equal(waitpid(scanner->pid, &status, 0), scanner->pid);
    assert_true(WIFEXITED(status) && WEXITSTATUS(status) == 0);
    FILE *log = fopen(scanner->served, "r");
    assert_non_null(log);
    while (fscanf(log, "%lf %lf %lf", &x, &y, &z) == 3) {
        const int64_t c = (int64_t)x / 7, p = (int64_t)y / 3;
        assert_true(x == (double)(7 * c) && y == (double)(3 * p) && z == height(c, p) && !hole(c, p));
        lines++;
    }
    fclose(log);
    assert_true(lines >= least && lines <= most);
    char path[64];
    unlink(scanner->points);
    unlink(scanner->served);
    snprintf(path, sizeof path, "%s/log", scanner->directory);
    unlink(path);
    rmdir(scanner->directory);
}

// ---------------------------------------------------------------------------------------------------------------------
// The master: lib/modbus below, lib/scan above

struct master {
    struct canopy_modbus_rtu_client client;
    struct canopy_profile_driver driver;
    bool asked;
    uint64_t readings, wrong, profiles, wire;
    bool seen[1024];
};

static enum canopy_scan_event settle(struct master *master, enum canopy_modbus_outcome outcome) {
    uint16_t registers[CANOPY_SCAN_READ_MAX];
    master->asked = false;
    if (outcome == CANOPY_MODBUS_DONE) {
        const size_t count = canopy_modbus_rtu_client_registers(&master->client, registers, CANOPY_SCAN_READ_MAX);
        return canopy_profile_answer(&master->driver, registers, count, now_us());
    }
    return canopy_profile_failed(
        &master->driver, outcome == CANOPY_MODBUS_REFUSED ? CANOPY_SCAN_EXCEPTION : CANOPY_SCAN_TIMEOUT, now_us());
}

static void take_profile(const struct scanner *scanner, struct master *master) {
    const struct canopy_profile *profile = canopy_profile_get(&master->driver);
    const int64_t p = profile->y / 3;
    assert_true(profile->columns == scanner->columns && profile->y % 3 == 0 && p >= 0 && p < scanner->profiles);
    for (uint16_t c = 0; c < profile->columns; c++) {
        struct canopy_reading reading;
        assert_true(canopy_profile_reading(&master->driver, c, &reading));
        master->readings += reading.valid;
        if (reading.valid)
            master->wrong += hole(c, p) || reading.x != 7 * c || reading.z != height(c, p);
    }
    master->seen[p] = true;
    master->profiles++;
    canopy_profile_done(&master->driver);
}

static void ask(struct master *master) {
    struct canopy_profile_request wanted;
    if (master->asked || !canopy_profile_next(&master->driver, now_us(), &wanted))
        return;
    const struct canopy_modbus_request request = {
        .unit = wanted.unit, .function = wanted.function, .address = wanted.address, .count = wanted.count};
    assert_int_equal(canopy_modbus_rtu_client_start(&master->client, &request), CANOPY_OK);
    master->asked = true;
}

static void move_bytes(struct master *master, int line) {
    uint8_t bytes[300];
    const uint8_t *out = NULL;
    const size_t length = canopy_modbus_rtu_client_pending(&master->client, now_us(), &out);
    if (length > 0) {
        const ssize_t sent = write(line, out, length);
        assert_true(sent >= 0 || errno == EAGAIN);
        canopy_modbus_rtu_client_sent(&master->client, sent > 0 ? (size_t)sent : 0, now_us());
        master->wire += sent > 0 ? (size_t)sent : 0;
    }
    struct pollfd wait = {.fd = line, .events = POLLIN};
    const struct timespec tick = {0, 200000};
    if (ppoll(&wait, 1, &tick, NULL) > 0) {
        const ssize_t count = read(line, bytes, sizeof bytes);
        assert_true(count >= 0 || errno == EAGAIN);
        canopy_modbus_rtu_client_feed(&master->client, bytes, count > 0 ? (size_t)count : 0, now_us());
        master->wire += count > 0 ? (size_t)count : 0;
    }
}

static void begin(struct master *master) {
    static uint64_t arena[CANOPY_PROFILE_ARENA(COLUMNS_MOST, 1) / 8];
    const struct canopy_modbus_rtu_client_config line = {.baud = 0, .timeout_us = 200000};
    const struct canopy_profile_config config = {.table = &canopy_profile_generic, .unit = 1, .columns = COLUMNS_MOST};
    memset(master, 0, sizeof *master);
    assert_int_equal(canopy_modbus_rtu_client_init(&master->client, &line, now_us()), CANOPY_OK);
    assert_int_equal(canopy_profile_init(&master->driver, &config, arena, sizeof arena, now_us()), CANOPY_OK);
}

// Reads until `profiles` profiles are there or `limit_s` is over. Returns the seconds it took.
static double go_on(const struct scanner *scanner, struct master *master, uint64_t profiles, unsigned limit_s) {
    const uint64_t begin_us = now_us();
    while (master->profiles < profiles && now_us() - begin_us < limit_s * UINT64_C(1000000)) {
        ask(master);
        move_bytes(master, scanner->line);
        const enum canopy_modbus_outcome outcome = canopy_modbus_rtu_client_poll(&master->client, now_us());
        if (master->asked && outcome != CANOPY_MODBUS_PENDING && settle(master, outcome) == CANOPY_SCAN_PROFILE)
            take_profile(scanner, master);
    }
    assert_int_equal(master->wrong, 0);
    return (double)(now_us() - begin_us) * 1e-6;
}

static double run(const struct scanner *scanner, struct master *master, uint64_t profiles, unsigned limit_s) {
    begin(master);
    return go_on(scanner, master, profiles, limit_s);
}

static unsigned seen(const struct master *master) {
    unsigned count = 0;
    for (size_t i = 0; i < sizeof master->seen / sizeof master->seen[0]; i++)
        count += master->seen[i];
    return count;
}

// ---------------------------------------------------------------------------------------------------------------------

static struct master master;

static void a_whole_terrain_comes_over_a_pty(void **state) {
    (void)state;
    struct scanner scanner;
    make_scene(&scanner, 403, 344);
    start(&scanner, "");
    const double seconds = run(&scanner, &master, 344, 120);
    printf("# 344 x 403 over a pty, unpaced: %.2f s, %" PRIu64 " bytes, %.0f bytes a profile\n", seconds, master.wire,
           (double)master.wire / 344);
    assert_int_equal(master.profiles, 344);
    assert_int_equal(seen(&master), 344);
    assert_int_equal(master.readings, scanner.valid);
    const struct canopy_profile_counters *counters = canopy_profile_counters(&master.driver);
    assert_int_equal(counters->missed + counters->torn + counters->short_of, 0);
    stop(&scanner, scanner.valid, scanner.valid);
}

static void every_fault_of_the_wire_is_survived(void **state) {
    (void)state;
    static const struct {
        const char *options;
        uint8_t failure;
    } faults[] = {
        {"--bad-crc 0.05", CANOPY_SCAN_TIMEOUT},     {"--truncate 0.05", CANOPY_SCAN_TIMEOUT},
        {"--silence 0.05", CANOPY_SCAN_TIMEOUT},     {"--silence 0.1+0.7", CANOPY_SCAN_TIMEOUT},
        {"--garbage 0.05", CANOPY_SCAN_TIMEOUT},     {"--delay 0.05:250", CANOPY_SCAN_TIMEOUT},
        {"--exception 0.05", CANOPY_SCAN_EXCEPTION},
    };
    for (size_t i = 0; i < sizeof faults / sizeof faults[0]; i++) {
        struct scanner scanner;
        make_scene(&scanner, 300, 40);
        start(&scanner, faults[i].options);
        run(&scanner, &master, 40, 60);
        const struct canopy_profile_counters *counters = canopy_profile_counters(&master.driver);
        printf("# %s: %" PRIu32 " reads failed\n", faults[i].options, counters->failures[faults[i].failure]);
        assert_true(counters->failures[faults[i].failure] > 0);
        assert_true(seen(&master) >= 39);  // a profile whose last answer stayed in doubt may be given up
        const uint64_t doubtful = i == 4 || i == 5 ? scanner.valid : 0;
        stop(&scanner, scanner.valid - doubtful, scanner.valid);
    }
}

static void every_fault_of_the_scanner_is_seen(void **state) {
    (void)state;
    struct scanner scanner;
    make_scene(&scanner, 300, 60);
    start(&scanner, "--torn 0.3 --stale 0.3 --lost 0.3 --short 0.3 --seed 5 --sequence 65530");
    run(&scanner, &master, 60, 60);
    const struct canopy_profile_counters *counters = canopy_profile_counters(&master.driver);
    assert_int_equal(master.readings, scanner.valid);
    assert_true(counters->torn > 5 && counters->short_of > 5 && counters->missed > 5 && counters->stale > 0);
    stop(&scanner, scanner.valid, scanner.valid);
}

static void a_rate_does_not_wait_for_the_slow(void **state) {
    (void)state;
    struct scanner scanner;
    make_scene(&scanner, 100, 200);
    start(&scanner, "--rate 40");
    run(&scanner, &master, 5, 20);
    const struct timespec pause = {0, 500000000};
    nanosleep(&pause, NULL);
    go_on(&scanner, &master, 10, 20);
    const struct canopy_profile_counters *counters = canopy_profile_counters(&master.driver);
    printf("# 40 profiles a second: %" PRIu64 " read, %" PRIu32 " missed\n", master.profiles, counters->missed);
    assert_int_equal(master.profiles, 10);
    assert_true(counters->missed >= 18);
    stop(&scanner, 1, master.readings);
}

// 5 + 300 + 1 registers in three reads are 612 + 39 bytes: 62 ms at 115200 8E1.
static void paced_bytes_take_their_time(void **state) {
    (void)state;
    struct scanner scanner;
    make_scene(&scanner, 300, 10);
    start(&scanner, "--pace");
    const double seconds = run(&scanner, &master, 10, 60);
    const double wire = (double)master.wire * 11 / 115200;
    printf("# paced at 115200 8E1: 10 profiles in %.3f s, %.3f s on the wire\n", seconds, wire);
    assert_int_equal(master.profiles, 10);
    assert_true(seconds >= wire);
    stop(&scanner, scanner.valid, scanner.valid);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_whole_terrain_comes_over_a_pty),   cmocka_unit_test(every_fault_of_the_wire_is_survived),
        cmocka_unit_test(every_fault_of_the_scanner_is_seen), cmocka_unit_test(a_rate_does_not_wait_for_the_slow),
        cmocka_unit_test(paced_bytes_take_their_time),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
