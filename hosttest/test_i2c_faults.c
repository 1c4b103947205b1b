// The driver against the sweep over an I2C bus that fails in every way it can: no faulted reading is ever delivered as
// a height. What is turned on the wire stays within what the check sum is sure to find (up to three bits of a
// transfer).
#include <inttypes.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include <cmocka.h>

#include "hosttest/i2c_bus.h"
#include "hosttest/lattice.h"
#include "lib/scan/generic.h"
#include "lib/scan/i2c_link.h"
#include "tools/common/random.h"
#include "tools/common/sweep.h"

#define TIMEOUT_US 30000u
#define BYTE_US 23u  // nine bits at 400 kHz

struct world {
    struct lattice scene;
    struct canopy_sweep *sweep;
    struct i2c_bus bus;
    struct i2c_registers file;
    struct canopy_i2c port;
    struct canopy_i2c_link link;
    struct canopy_scan_link seam;
    struct canopy_profile_driver driver;
    uint64_t random, now_us;
    double faults;  // probability that a transfer is disturbed
    struct lattice_tally tally;
    uint64_t disturbed;
};

static bool load(void *context, uint16_t address, uint16_t count, uint16_t *to) {
    const struct world *world = context;
    return canopy_sweep_read(world->sweep, 0, address, count, to, world->now_us) == 0;
}

// One transfer's fault, each as likely as the others.
static void disturb(struct world *world) {
    struct i2c_bus *bus = &world->bus;
    const uint32_t byte = canopy_random_below(&world->random, 260), bits = 8 * 260;
    bus->spoilt = 1;
    switch (canopy_random_below(&world->random, 10)) {
    case 0: bus->nak_at = byte % 6; break;
    case 1: bus->lose_at = byte; break;
    case 2: bus->stretch_at = byte; break;
    case 3: bus->hung_clocks = (uint16_t)(1 + canopy_random_below(&world->random, 40)); break;
    case 4:
        bus->held = true;
        bus->spoilt = 1 + canopy_random_below(&world->random, 5);
        break;
    case 5: bus->flip_also = canopy_random_below(&world->random, bits);  // fall through
    case 6: bus->flip_at = canopy_random_below(&world->random, bits); break;
    case 7: world->file.falls_silent = byte; break;
    case 8: world->file.skips_at = byte; break;
    default:
        world->file.deaf = canopy_random_chance(&world->random, 0.5);
        world->file.answers_again = !world->file.deaf;
        break;
    }
    world->disturbed++;
}

static void prepare_transfer(struct world *world) {
    i2c_registers_be_well(&world->file);
    world->bus.bytes_a_poll = (uint16_t)(1 + canopy_random_below(&world->random, 300));
    if (world->bus.spoilt == I2C_NEVER && world->bus.hung_clocks == 0 &&
        canopy_random_chance(&world->random, world->faults))
        disturb(world);
}

// One read of the driver, to its end. What the master took was offered to it.
static enum canopy_scan_event carry_out(struct world *world, const struct canopy_profile_request *request) {
    struct canopy_scan_answer answer;
    prepare_transfer(world);
    assert_true(world->seam.begin(world->seam.context, request, world->now_us));
    for (;;) {
        const uint32_t transfers = world->bus.transfers;
        world->now_us += (uint64_t)BYTE_US * world->bus.bytes_a_poll;
        switch (world->seam.poll(world->seam.context, world->now_us, &answer)) {
        case CANOPY_SCAN_LINK_DONE:
            canopy_sweep_offered(world->sweep, 0, false);
            return canopy_profile_answer(&world->driver, answer.registers, answer.count, world->now_us);
        case CANOPY_SCAN_LINK_FAILED:
            world->now_us += answer.failure == CANOPY_SCAN_TIMEOUT ? TIMEOUT_US : 0;
            return canopy_profile_failed(&world->driver, answer.failure, world->now_us);
        default: break;
        }
        if (world->bus.transfers != transfers) {  // the next piece of the same read
            canopy_sweep_offered(world->sweep, 0, false);
            prepare_transfer(world);
        }
    }
}

static void start(struct world *world, const struct canopy_sweep_options *options, uint16_t max_transfer) {
    static uint64_t arena[CANOPY_PROFILE_ARENA(LATTICE_COLUMNS_MOST, 1) / 8];
    struct canopy_fault fault;
    world->sweep = canopy_sweep_open(world->scene.path, options, &fault);
    assert_non_null(world->sweep);
    i2c_bus_init(&world->bus);
    world->bus.max_transfer = max_transfer;
    i2c_registers_init(&world->file, CANOPY_GENERIC_I2C_ADDRESS, load, world);
    i2c_bus_add(&world->bus, &world->file.slave);
    world->port = i2c_bus_port(&world->bus);
    world->seam = canopy_i2c_link(&world->link);
    const struct canopy_profile_config config = {.table = &canopy_profile_generic, .columns = LATTICE_COLUMNS_MOST};
    world->now_us = 5;
    assert_int_equal(canopy_i2c_link_init(&world->link, &world->port, &canopy_profile_generic, TIMEOUT_US), CANOPY_OK);
    assert_int_equal(canopy_profile_init(&world->driver, &config, arena, sizeof arena, world->now_us), CANOPY_OK);
    world->tally = (struct lattice_tally){.seen = calloc(world->scene.profiles, sizeof(bool))};
}

static void run(struct world *world, uint64_t profiles) {
    struct canopy_profile_request request;
    while (world->tally.profiles < profiles && !(canopy_sweep_status(world->sweep).over && world->driver.stale)) {
        assert_true(world->now_us < UINT64_C(3600000000));
        if (!canopy_profile_next(&world->driver, world->now_us, &request)) {
            world->now_us = request.due_us;
        } else if (carry_out(world, &request) == CANOPY_SCAN_PROFILE) {
            lattice_check(&world->scene, &world->driver, &world->tally);
            canopy_profile_done(&world->driver);
        }
    }
}

static void finish(struct world *world) {
    canopy_sweep_close(world->sweep);
    free(world->tally.seen);
    unlink(world->scene.path);
}

static void a_good_bus_loses_nothing(void **state) {
    (void)state;
    for (uint16_t max_transfer = 58; max_transfer < 260; max_transfer += 3) {
        static struct world world;
        world = (struct world){.random = max_transfer};
        lattice_make(&world.scene, 403, 12);
        const struct canopy_sweep_options options = {.unit = 1, .seed = 1};
        start(&world, &options, max_transfer);
        run(&world, UINT64_MAX);
        assert_int_equal(world.tally.profiles, world.scene.profiles);
        assert_int_equal(world.tally.readings, world.scene.valid);
        assert_int_equal(world.tally.wrong, 0);
        const struct canopy_profile_counters *counters = canopy_profile_counters(&world.driver);
        assert_int_equal(counters->torn + counters->short_of + counters->missed + counters->dropped, 0);
        finish(&world);
    }
}

// What docs/scanners.md says of the time that a profile takes.
static void a_profile_of_400_columns_is_four_transfers_of_844_bytes(void **state) {
    (void)state;
    static struct world world;
    world = (struct world){.random = 1};
    lattice_make(&world.scene, 400, 12);
    const struct canopy_sweep_options options = {.unit = 1, .seed = 1};
    start(&world, &options, UINT16_MAX);
    run(&world, 12);
    const uint32_t description = 6 + 2 * CANOPY_GENERIC_D_COUNT + 2;
    assert_int_equal(world.bus.transfers, 1 + 12 * 4);
    assert_int_equal(world.bus.bytes, description + 12 * 844);
    finish(&world);
}

// 300 scanners and buses: widths, faults of scanner and bus, profiles on demand and by the clock.
static void nothing_wrong_comes_over_a_bad_bus(void **state) {
    (void)state;
    uint64_t readings = 0, disturbed = 0, torn = 0, failures[CANOPY_SCAN_FAILURES] = {0};
    for (uint64_t seed = 1; seed <= 300; seed++) {
        static struct world world;
        world = (struct world){.random = seed * 91};
        const uint32_t columns = 4 + canopy_random_below(&world.random, LATTICE_COLUMNS_MOST - 4);
        world.faults = 0.4 * canopy_random_unit(&world.random);
        lattice_make(&world.scene, columns, 30);
        const struct canopy_sweep_options options = {.unit = 1,
                                                     .seed = seed,
                                                     .loop = true,
                                                     .columns = columns,
                                                     .profiles = 30,
                                                     .rate_hz = seed % 3 == 0 ? 5 + (double)(seed % 20) : 0,
                                                     .torn = 0.1,
                                                     .stale = 0.05,
                                                     .lost = 0.05,
                                                     .short_of = 0.05,
                                                     .dropouts = 0.02};
        const uint16_t max_transfer = (uint16_t)(seed % 2 == 0 ? 58 + seed % 200 : UINT16_MAX);
        start(&world, &options, max_transfer);
        run(&world, 120);
        assert_int_equal(world.tally.wrong, 0);
        assert_int_equal(world.tally.profiles, 120);
        readings += world.tally.readings;
        disturbed += world.disturbed;
        torn += canopy_profile_counters(&world.driver)->torn;
        for (int i = 0; i < CANOPY_SCAN_FAILURES; i++)
            failures[i] += canopy_profile_counters(&world.driver)->failures[i];
        finish(&world);
    }
    printf("# %" PRIu64 " readings, %" PRIu64 " transfers disturbed\n", readings, disturbed);
    assert_true(readings > 5000000 && disturbed > 30000 && torn > 1000);
    assert_true(failures[CANOPY_SCAN_TIMEOUT] > 1000 && failures[CANOPY_SCAN_CRC] > 1000);
    assert_true(failures[CANOPY_SCAN_NAK] > 1000 && failures[CANOPY_SCAN_BUS] > 1000);
    assert_int_equal(failures[CANOPY_SCAN_LINK] + failures[CANOPY_SCAN_LENGTH] + failures[CANOPY_SCAN_EXCEPTION], 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_good_bus_loses_nothing),
        cmocka_unit_test(a_profile_of_400_columns_is_four_transfers_of_844_bytes),
        cmocka_unit_test(nothing_wrong_comes_over_a_bad_bus),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
