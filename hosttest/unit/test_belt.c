// The belt program on the host and on the device: rows that close are published, status bits say what they are worth.
// Hours of it, judged exactly: hosttest/test_belt.c.

#include "hosttest/unit/unit.h"
#include "lib/station/belt.h"

enum { M = 8, N = 4, Q = 2, OPEN = 2, PITCH = 20 };

static CANOPY_ARENA_DECLARE(arena, CANOPY_BELT_ARENA(M, N, Q, 1, OPEN, 1));
static struct canopy_belt belt;
static struct canopy_modbus_bank bank;
static uint64_t now_us;

static void begin(void) {
    const struct canopy_belt_config config = {.ring = {.grid = {{M, N}, Q, CANOPY_ABOVE},
                                                       .low = {0, 0, 0},
                                                       .high = {(M - 1) * PITCH, (N - 1) * PITCH, 100},
                                                       .fit = &canopy_line_fit_fx,
                                                       .lines = 1,
                                                       .open = OPEN},
                                              .leap = 5,
                                              .clients = 1,
                                              .unit = 0.001F,
                                              .stale_after_us = 1000000,
                                              .expire_after_us = 60000000};
    now_us = 1000000;
    CHECK_EQ(canopy_belt_init(&belt, &config, arena, sizeof arena, now_us), CANOPY_OK);
    bank = canopy_belt_bank(&belt);
}

static enum canopy_status see(int32_t x, int32_t y, int32_t z) {
    const int32_t point[3] = {x, y, z};
    return canopy_belt_reading(&belt, point, 0, now_us);
}

static void run(int32_t from, int32_t to) {
    for (int32_t x = from; x < to; x += 5) {
        now_us += 10000;
        for (int32_t y = 0; y <= (N - 1) * PITCH; y += 10) {
            CHECK_EQ(see(x, y, (x + y) % 40), CANOPY_OK);
        }
        for (int i = 0; i < 50; i++) {
            canopy_belt_step(&belt, 4, now_us);
        }
    }
}

static uint16_t status(void) {
    uint8_t bytes[2];
    CHECK_EQ(bank.read(bank.context, 0, 101, 1, bytes), 0);
    return (uint16_t)(bytes[0] << 8 | bytes[1]);
}

UNIT(belt_publishes_rows_that_it_has_left) {
    begin();
    CHECK_EQ(status(), CANOPY_PLC_STALE);
    run(1000, 1000 + PITCH);
    CHECK(canopy_plc_published(&belt.plc) == NULL);  // its row is still open
    run(1000 + PITCH, 1000 + 3 * PITCH);
    const struct canopy_envelope *envelope = canopy_plc_published(&belt.plc);
    CHECK(envelope != NULL);
    CHECK_EQ(envelope->points, 2 * PITCH / 5 * ((N - 1) * PITCH / 10 + 1));
    CHECK_EQ(envelope->first_row, 1000 / PITCH + 2 - (M - 1));
    CHECK_EQ(status(), CANOPY_PLC_VALID);
    CHECK_EQ(belt.coverage_pct, 100 * 2 / (M - 2));
    run(1000 + 3 * PITCH, 1000 + 20 * PITCH);
    CHECK_EQ(belt.coverage_pct, 100);
    CHECK_EQ(canopy_plc_sequence(&belt.plc), 19);
    CHECK_EQ(see(1000, 10, 5), CANOPY_DROPPED);
    CHECK_EQ(see(1000 + 30 * PITCH, 10, 5), CANOPY_AHEAD);  // leaps
    CHECK_EQ(see(1000 + 20 * PITCH, -1, 5), CANOPY_OUT_OF_FRAME);
    CHECK_EQ(belt.rejected, 3);
    CHECK_EQ(belt.overruns + belt.fits_failed, 0);
}

UNIT(belt_says_what_is_beyond_stale_or_too_old) {
    begin();
    run(0, 12 * PITCH);
    CHECK_EQ(status(), CANOPY_PLC_VALID);
    CHECK_EQ(see(9 * PITCH + 3, 31, 99), CANOPY_OK);  // late, and high
    CHECK_EQ(status(), CANOPY_PLC_INTRUSION);
    for (int i = 0; i < 200; i++) {
        canopy_belt_step(&belt, 4, now_us);
    }
    CHECK_EQ(status(), CANOPY_PLC_VALID);
    CHECK_EQ(see(11 * PITCH, 31, 99), CANOPY_OK);  // in a row of which nothing is claimed
    CHECK_EQ(status(), CANOPY_PLC_VALID);
    CHECK_EQ(see(9 * PITCH + 3, 31, 1 << 20), CANOPY_RANGE);
    CHECK_EQ(status(), CANOPY_PLC_INTRUSION);
    run(12 * PITCH, 16 * PITCH);
    CHECK_EQ(status(), CANOPY_PLC_INTRUSION);  // its row is still there
    run(16 * PITCH, 17 * PITCH);
    CHECK_EQ(status(), CANOPY_PLC_VALID);
    now_us += 1100000;
    canopy_belt_step(&belt, 1, now_us);
    CHECK_EQ(status(), CANOPY_PLC_STALE);
    now_us += 60000000;
    canopy_belt_step(&belt, 1, now_us);
    CHECK(canopy_plc_published(&belt.plc) == NULL);
    CHECK_EQ(status(), CANOPY_PLC_STALE);
}

// The belt runs on before the next envelope is out: rows that the ring has dropped are still published.
UNIT(belt_cannot_vouch_for_a_row_that_it_has_dropped) {
    begin();
    run(0, 12 * PITCH);
    const int64_t last = canopy_plc_published(&belt.plc)->first_row + 1;
    CHECK_EQ(see((int32_t)last * PITCH + 3, 31, 5), CANOPY_OK);
    CHECK_EQ(see(14 * PITCH + 3, 31, 5), CANOPY_OK);  // so far on
    CHECK_EQ(status(), CANOPY_PLC_VALID);
    CHECK_EQ(see((int32_t)(last - 1) * PITCH + 3, 31, 99), CANOPY_DROPPED);  // of the guard nothing is claimed
    CHECK_EQ(status(), CANOPY_PLC_VALID);
    CHECK_EQ(see((int32_t)last * PITCH + 3, 31, 99), CANOPY_DROPPED);
    CHECK_EQ(status(), CANOPY_PLC_INTRUSION);
    run(15 * PITCH, 17 * PITCH);
    CHECK_EQ(status(), CANOPY_PLC_VALID);
}

UNIT_LIST(belt, belt_publishes_rows_that_it_has_left, belt_says_what_is_beyond_stale_or_too_old,
          belt_cannot_vouch_for_a_row_that_it_has_dropped)
