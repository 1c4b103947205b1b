// The driver against the sweep through a bad channel: no faulted reading is ever delivered as a height.
//
// The channel keeps the order of answers, as a serial line does, and is otherwise as bad as can be: it loses, cuts and
// delays answers beyond the timeout, and the carrier never throws a late one away, but takes whatever comes next for
// the answer.
#include <inttypes.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "hosttest/lattice.h"
#include "lib/scan/generic.h"
#include "lib/scan/profile.h"
#include "tools/common/random.h"
#include "tools/common/sweep.h"

#define FIFO 64
#define TIMEOUT_US 100000

// ---------------------------------------------------------------------------------------------------------------------

struct answer {
    uint64_t at_us;
    uint16_t count;  // 0: broken on the way
    uint16_t registers[CANOPY_SCAN_READ_MAX];
};

struct channel {
    uint64_t random;
    double lost, cut, broken, late;
    struct answer fifo[FIFO];
    unsigned first, count;
};

static void send(struct channel *channel, struct canopy_sweep *sweep, const struct canopy_profile_request *request,
                 uint64_t now_us) {
    struct answer answer = {.count = request->count};
    const uint8_t exception = canopy_sweep_read(sweep, 0, request->address, request->count, answer.registers, now_us);
    assert_int_equal(exception, 0);
    if (channel->count == FIFO || canopy_random_chance(&channel->random, channel->lost))
        return;
    bool doubtful = false;
    answer.at_us = now_us + 500 + 20u * request->count;
    if (canopy_random_chance(&channel->random, channel->cut)) {
        answer.count = (uint16_t)(1 + canopy_random_below(&channel->random, CANOPY_SCAN_READ_MAX));
        if (answer.count == request->count)
            answer.count = 0;
    } else if (canopy_random_chance(&channel->random, channel->broken)) {
        answer.count = 0;
    } else if (canopy_random_chance(&channel->random, channel->late)) {
        answer.at_us += canopy_random_below(&channel->random, 4 * TIMEOUT_US);
        doubtful = true;
    }
    if (channel->count > 0) {  // in order
        const uint64_t before_us = channel->fifo[(channel->first + channel->count - 1) % FIFO].at_us;
        answer.at_us = answer.at_us > before_us ? answer.at_us : before_us + 1;
        doubtful = true;
    }
    if (answer.count == request->count)
        canopy_sweep_offered(sweep, 0, doubtful);
    channel->fifo[(channel->first + channel->count++) % FIFO] = answer;
}

// The next thing on the line, or a timeout.
static enum canopy_scan_event receive(struct channel *channel, struct canopy_profile_driver *driver, uint64_t *now_us) {
    const struct answer *answer = &channel->fifo[channel->first];
    if (channel->count == 0 || answer->at_us > *now_us + TIMEOUT_US) {
        *now_us += TIMEOUT_US;
        return canopy_profile_failed(driver, CANOPY_SCAN_TIMEOUT, *now_us);
    }
    *now_us = answer->at_us > *now_us ? answer->at_us : *now_us;
    channel->first = (channel->first + 1) % FIFO;
    channel->count--;
    return answer->count == 0 ? canopy_profile_failed(driver, CANOPY_SCAN_CRC, *now_us)
                              : canopy_profile_answer(driver, answer->registers, answer->count, *now_us);
}

struct tally {
    struct lattice_tally of;
    uint32_t torn, stale, shorts, missed, failures;
};

static void run(const struct lattice *scene, const struct canopy_sweep_options *options, struct channel *channel,
                unsigned profiles, FILE *log, struct tally *tally, struct canopy_sweep_status *status) {
    static uint64_t arena[CANOPY_PROFILE_ARENA(LATTICE_COLUMNS_MOST, 1) / 8];
    struct canopy_profile_driver driver;
    struct canopy_profile_request request;
    struct canopy_fault fault;
    struct canopy_sweep *sweep = canopy_sweep_open(scene->path, options, &fault);
    assert_non_null(sweep);
    canopy_sweep_log(sweep, log);
    const struct canopy_profile_config config = {
        .table = &canopy_profile_generic, .unit = 1, .columns = LATTICE_COLUMNS_MOST};
    uint64_t now_us = 5;
    assert_int_equal(canopy_profile_init(&driver, &config, arena, sizeof arena, now_us), CANOPY_OK);
    const uint64_t limit_us =
        now_us + 48u * 3600u * UINT64_C(1000000);  // a lag that nobody flushes takes long to go away
    while (tally->of.profiles < profiles && now_us < limit_us && !(canopy_sweep_status(sweep).over && driver.stale)) {
        if (!canopy_profile_next(&driver, now_us, &request)) {
            now_us = request.due_us;
            continue;
        }
        send(channel, sweep, &request, now_us);
        if (receive(channel, &driver, &now_us) == CANOPY_SCAN_PROFILE) {
            lattice_check(scene, &driver, &tally->of);
            canopy_profile_done(&driver);
        }
    }
    const struct canopy_profile_counters *counters = canopy_profile_counters(&driver);
    tally->torn += counters->torn;
    tally->stale += counters->stale;
    tally->shorts += counters->short_of;
    tally->missed += counters->missed;
    for (int i = 0; i < CANOPY_SCAN_FAILURES; i++)
        tally->failures += counters->failures[i];
    assert_int_equal(counters->profiles, tally->of.profiles);
    assert_int_equal(counters->readings, tally->of.readings);
    *status = canopy_sweep_status(sweep);
    canopy_sweep_close(sweep);
}

// ---------------------------------------------------------------------------------------------------------------------

static void a_good_channel_loses_nothing(void **state) {
    (void)state;
    struct lattice scene;
    lattice_make(&scene, 403, 60);
    struct channel channel = {.random = 1};
    const struct canopy_sweep_options options = {.unit = 1, .seed = 1};
    struct tally tally = {.of.seen = calloc(scene.profiles, sizeof(bool))};
    struct canopy_sweep_status status;
    run(&scene, &options, &channel, UINT32_MAX, NULL, &tally, &status);
    assert_int_equal(tally.of.profiles, scene.profiles);
    assert_int_equal(tally.of.readings, scene.valid);
    assert_int_equal(status.served, scene.valid);
    assert_int_equal(status.doubtful + status.missed, 0);
    assert_int_equal(tally.of.wrong + tally.torn + tally.shorts + tally.missed + tally.failures, 0);
    free(tally.of.seen);
    unlink(scene.path);
}

// Every fault of the scanner at once, on demand, over a good channel: everything comes through, nothing wrong.
static void a_faulty_scanner_is_read_whole(void **state) {
    (void)state;
    uint64_t torn = 0, stale = 0, shorts = 0, lost = 0;
    for (uint64_t seed = 1; seed <= 20; seed++) {
        struct lattice scene;
        lattice_make(&scene, 260, 80);
        struct channel channel = {.random = seed};
        const struct canopy_sweep_options options = {
            .unit = 1, .seed = seed, .torn = 0.2, .stale = 0.2, .lost = 0.1, .short_of = 0.2, .sequence = 65500};
        struct tally tally = {.of.seen = calloc(scene.profiles, sizeof(bool))};
        struct canopy_sweep_status status;
        run(&scene, &options, &channel, UINT32_MAX, NULL, &tally, &status);
        assert_int_equal(tally.of.wrong, 0);
        assert_int_equal(tally.of.readings, scene.valid);
        assert_int_equal(status.served, scene.valid);
        assert_int_equal(tally.torn, status.torn);
        assert_int_equal(tally.shorts, status.short_of);
        assert_int_equal(tally.failures, 0);
        torn += tally.torn;
        shorts += tally.shorts;
        stale += tally.stale;
        lost += tally.missed;
        free(tally.of.seen);
        unlink(scene.path);
    }
    assert_true(torn > 100 && shorts > 100 && stale > 50 && lost > 100);
}

// Everything at once, on demand and at a rate, for many widths: 60 runs, 30,000 profiles.
static void nothing_wrong_comes_through_a_bad_channel(void **state) {
    (void)state;
    uint64_t readings = 0, failures = 0, torn = 0, missed = 0;
    for (uint64_t seed = 1; seed <= 60; seed++) {
        struct lattice scene;
        uint64_t random = seed * 77;
        const uint32_t columns = 4 + canopy_random_below(&random, LATTICE_COLUMNS_MOST - 4);
        lattice_make(&scene, columns, 50);
        struct channel channel = {.random = seed,
                                  .lost = 0.03 * canopy_random_unit(&random),
                                  .cut = 0.03 * canopy_random_unit(&random),
                                  .broken = 0.03 * canopy_random_unit(&random),
                                  .late = 0.06 * canopy_random_unit(&random)};
        const struct canopy_sweep_options options = {.unit = 1,
                                                     .seed = seed,
                                                     .loop = true,
                                                     .columns = columns,
                                                     .profiles = 50,
                                                     .rate_hz = seed % 3 == 0 ? 5 + (double)seed : 0,
                                                     .torn = 0.1,
                                                     .stale = 0.05,
                                                     .lost = 0.05,
                                                     .short_of = 0.05,
                                                     .dropouts = 0.02};
        struct tally tally = {.of.seen = calloc(scene.profiles, sizeof(bool))};
        struct canopy_sweep_status status;
        run(&scene, &options, &channel, 500, NULL, &tally, &status);
        assert_int_equal(tally.of.wrong, 0);
        assert_int_equal(tally.of.profiles, 500);
        assert_int_equal(lattice_seen(&scene, &tally.of), 50);
        readings += tally.of.readings;
        failures += tally.failures;
        torn += tally.torn;
        missed += tally.missed;
        free(tally.of.seen);
        unlink(scene.path);
    }
    assert_true(readings > 3000000);
    assert_true(failures > 10000 && torn > 500 && missed > 500);
}

// Every reading of the log is exactly one of the scene, once, and its profile was delivered.
static void check_log(const struct lattice *scene, FILE *log, const struct tally *tally, uint64_t served) {
    bool *logged = calloc((size_t)scene->columns * scene->profiles, sizeof *logged);
    double x = 0, y = 0, z = 0;
    uint64_t lines = 0;
    rewind(log);
    while (fscanf(log, "%lf %lf %lf", &x, &y, &z) == 3) {
        const int64_t c = (int64_t)x / 7, p = (int64_t)y / 3;
        assert_true(x == (double)(7 * c) && y == (double)(3 * p) && z == lattice_height(c, p) && !lattice_hole(c, p));
        bool *cell = &logged[(size_t)p * scene->columns + (size_t)c];
        assert_false(*cell);
        *cell = true;
        assert_true(tally->of.seen[p]);
        lines++;
    }
    assert_int_equal(lines, served);
    free(logged);
}

// What the log holds is in the device, whatever the channel did.
static void what_was_served_was_delivered(void **state) {
    (void)state;
    uint64_t doubtful = 0;
    for (uint64_t seed = 1; seed <= 60; seed++) {
        struct lattice scene;
        lattice_make(&scene, 200, 40);
        struct channel channel = {.random = seed, .lost = 0.05, .cut = 0.02, .broken = 0.05, .late = 0.03};
        const struct canopy_sweep_options options = {
            .unit = 1, .seed = seed, .torn = 0.1, .stale = 0.1, .rate_hz = seed % 4 == 0 ? 3 : 0};
        struct tally tally = {.of.seen = calloc(scene.profiles, sizeof(bool))};
        struct canopy_sweep_status status;
        FILE *log = tmpfile();
        assert_non_null(log);
        run(&scene, &options, &channel, UINT32_MAX, log, &tally, &status);
        assert_int_equal(tally.of.wrong, 0);
        assert_int_equal(status.served + status.doubtful + status.missed, scene.valid);
        assert_true(status.rounds == 1 && status.over);
        check_log(&scene, log, &tally, status.served);
        fclose(log);
        doubtful += status.doubtful;
        free(tally.of.seen);
        unlink(scene.path);
    }
    assert_true(doubtful > 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_good_channel_loses_nothing),
        cmocka_unit_test(a_faulty_scanner_is_read_whole),
        cmocka_unit_test(nothing_wrong_comes_through_a_bad_channel),
        cmocka_unit_test(what_was_served_was_delivered),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
