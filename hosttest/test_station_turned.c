// A station whose frame is turned keeps the promises of lib/station/station.h: in random lives with random axes,
// scenes, uncertainties, steps and sides, everything published is judged in rational arithmetic
// (tools/common/rational.h), which shares nothing with lib/:
//   - at every publication each reading accepted so far is inside the published frame, and wherever its uncertainty in
//   z
//     may put it inside that frame it is on the safe side;
//   - a reading that may be beyond what is published withdraws the valid bit and sets the intrusion bit before the call
//     that takes it returns; one without uncertainty that is clearly on the safe side does neither;
//   - what the registers say of the frame is the frame, axes included.
// CANOPY_CLOUDS sets how many lives; a failure prints the seed, CANOPY_SEED=n lives that one alone.

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "canopy_registers.h"
#include "hosttest/seeds.h"
#include "lib/cover/axes.h"
#include "lib/spline/surface.h"
#include "lib/station/station.h"
#include "lib/station/turning.h"
#include "tools/common/random.h"
#include "tools/common/rational.h"

enum { GRID_MAX = 7, CELLS_MAX = 4, READINGS_MAX = 200, LIVES = 250, ACTS = 120 };

struct reading {
    int32_t point[3];
    uint32_t uncertainty;
};

struct life {
    uint64_t seed, random, now_us;
    struct canopy_station station;
    struct canopy_station_config config;
    struct canopy_modbus_bank bank;
    int32_t low[3], high[3];
    uint32_t uncertainty_most, count, sequence;
    struct reading readings[READINGS_MAX];
    struct canopy_surrogate published;
    struct canopy_rational *referee;  // of what is published; NULL: nothing is
    double coefficients[GRID_MAX * GRID_MAX];
    bool latched;
};

// What the lives have met, so that nothing is kept only because nothing happened.
static struct { uint32_t publications, beyond, partly, beside, ranges, uncertain; } met;

static struct canopy_station_turning *turning(void) {
    static struct canopy_station_turned turned;
    canopy_station_turned_init(&turned);
    return &turned.part;
}

static CANOPY_ARENA_DECLARE(arena, CANOPY_STATION_ARENA(GRID_MAX, GRID_MAX, CELLS_MAX, 1, 1));

static void need(const struct life *l, bool good, const char *what) {
    if (!good) {
        fail_msg("seed %llu: %s (reading %u, sequence %u, stage %d)", (unsigned long long)l->seed, what, l->count,
                 l->sequence, l->station.stage);
    }
}

static uint32_t below(struct life *l, uint32_t limit) { return canopy_random_below(&l->random, limit); }
static double uniform(struct life *l) { return canopy_random_unit(&l->random); }

// ---- The judge

// The margin of a place in device units, exactly signed; +inf outside the published frame.
static double margin_of(const struct life *l, const int32_t point[3], int64_t z) {
    const double place[3] = {point[0], point[1], (double)z};
    double floor = (double)INFINITY;
    if (canopy_rational_inside(l->referee, place, NULL)) {
        const int sign = canopy_rational_margin(l->referee, place, &floor);
        floor = sign < 0 ? fmin(floor, -1e-300) : fmax(floor, 0);
    }
    return floor;
}

// The least margin of a reading: at the ends of its uncertainty and between.
static double least_margin(const struct life *l, const struct reading *r) {
    double least = (double)INFINITY;
    for (int64_t part = -4; part <= 4; part++) {
        const int64_t z = r->point[2] + (int64_t)r->uncertainty * part / 4;
        least = fmin(least, margin_of(l, r->point, z));
    }
    return least;
}

static void load_published(struct life *l) {
    const struct canopy_envelope *e = canopy_plc_published(&l->station.plc);
    const struct canopy_frame *f = &e->frame;
    if (l->referee != NULL) {
        canopy_rational_close(l->referee);
    }
    l->published = (struct canopy_surrogate){.side = f->side,
                                             .scalar = CANOPY_FX,
                                             .unit = 1,
                                             .size = {f->size[0], f->size[1]},
                                             .pitch = {f->pitch[0], f->pitch[1]},
                                             .lsb = ldexp(1, f->lsb_log2),
                                             .coefficients = l->coefficients};
    for (int i = 0; i < 9; i++) {
        l->published.axes[i / 3][i % 3] = ldexp(f->axis[i / 3][i % 3], -30);
        l->published.origin[i % 3] = f->origin[i % 3];
    }
    for (size_t i = 0; i < CANOPY_COEFFICIENTS(f->size[0], f->size[1]); i++) {
        l->coefficients[i] = e->coefficients[i];
    }
    l->referee = canopy_rational_open(&l->published);
    need(l, l->referee != NULL, "no memory");
}

static int32_t read_long(struct life *l, uint16_t address) {
    uint8_t bytes[4];
    need(l, l->bank.read(l->bank.context, 0, address, 2, bytes) == 0, "a register cannot be read");
    return (int32_t)((uint32_t)bytes[0] << 24 | (uint32_t)bytes[1] << 16 | (uint32_t)bytes[2] << 8 | bytes[3]);
}

static void check_registers(struct life *l) {
    const struct canopy_frame *f = &canopy_plc_published(&l->station.plc)->frame;
    need(l, read_long(l, CANOPY_REGISTER_SEQUENCE) == (int32_t)l->sequence, "the sequence register");
    for (uint16_t i = 0; i < 9; i++) {
        const uint16_t address = (uint16_t)(CANOPY_REGISTER_AXIS_00 + 2 * i);
        need(l, read_long(l, address) == f->axis[i / 3][i % 3], "an axis register");
    }
    for (uint16_t k = 0; k < 3; k++) {
        need(l, read_long(l, (uint16_t)(CANOPY_REGISTER_ORIGIN_X + 2 * k)) == f->origin[k], "an origin register");
    }
}

static uint16_t status_of(struct life *l) {
    uint8_t bytes[2];
    need(l, l->bank.read(l->bank.context, 0, CANOPY_REGISTER_STATUS, 1, bytes) == 0, "the status cannot be read");
    return (uint16_t)(bytes[0] << 8 | bytes[1]);
}

static void check_publication(struct life *l) {
    const uint32_t sequence = canopy_plc_sequence(&l->station.plc);
    if (sequence == l->sequence) {
        return;
    }
    l->sequence = sequence;
    load_published(l);
    check_registers(l);
    met.publications++;
    need(l, canopy_plc_published(&l->station.plc)->points == l->count, "the number of points");
    for (uint32_t i = 0; i < l->count; i++) {
        need(l, isfinite(margin_of(l, l->readings[i].point, l->readings[i].point[2])), "a reading is outside");
        need(l, least_margin(l, &l->readings[i]) >= 0, "a reading is on the wrong side of a publication");
    }
    need(l, (status_of(l) & CANOPY_PLC_INTRUSION) == 0 || l->latched, "an intrusion outlives its publication");
}

// ---- A life

static void choose_axes(struct life *l) {
    int32_t d[3];
    enum canopy_status status;
    do {
        const uint32_t kind = below(l, 4);
        for (int k = 0; k < 3; k++) {
            d[k] = kind == 0 ? (int32_t)below(l, 3) - 1 : (int32_t)(2 * uniform(l) * 0x1p30 - 0x1p30);
        }
        if (kind == 1) {
            d[0] >>= below(l, 30);
            d[1] >>= below(l, 30);
        }
        status = canopy_axes_from_direction_fx(d, l->config.axes);
    } while (status != CANOPY_OK);
}

static void begin(struct life *l) {
    const double size = ldexp(1, 4 + (int)below(l, 18));
    for (int k = 0; k < 3; k++) {
        l->low[k] = (int32_t)((2 * uniform(l) - 1) * 1e8);
        l->high[k] = l->low[k] + (int32_t)(size * (below(l, 5) ? 1 + uniform(l) : 0));
    }
    l->uncertainty_most = below(l, 2) ? 0 : 1 + (uint32_t)(size / 8 * uniform(l));
    need(l, canopy_station_begin_box(&l->station, l->low, l->high) == CANOPY_OK, "a scene is refused");
    need(l, canopy_station_begin_box(&l->station, l->low, l->high) == CANOPY_OK, "the same scene again is refused");
}

static void start(struct life *l, uint64_t seed) {
    *l = (struct life){.seed = seed, .random = seed, .now_us = 1000000};
    l->config = (struct canopy_station_config){
        .grid = {.size = {(uint16_t)(4 + below(l, GRID_MAX - 3)), (uint16_t)(4 + below(l, GRID_MAX - 3))},
                 .cells = (uint16_t)(1 + below(l, CELLS_MAX)),
                 .side = (uint8_t)below(l, 2)},
        .turning = turning(),
        .fit = &canopy_line_fit_fx,
        .lines = 1,
        .clients = 1,
        .unit = 1,
        .stale_after_us = 1000000000,
        .interval_us = 1000,
        .refresh_us = 5000};
    choose_axes(l);
    need(l, canopy_station_init(&l->station, &l->config, arena, sizeof arena, l->now_us) == CANOPY_OK, "no station");
    l->bank = canopy_station_bank(&l->station);
    begin(l);
}

static void choose_reading(struct life *l, struct reading *r) {
    const double spread = below(l, 8) == 0 ? 1.3 : 1, tall = (double)(l->count + 1) / READINGS_MAX;
    for (int k = 0; k < 3; k++) {
        const double extent = (double)l->high[k] - l->low[k], part = k == 2 ? uniform(l) * tall : uniform(l);
        r->point[k] = l->low[k] + (int32_t)(extent * ((part - 0.5) * spread + 0.5));
    }
    if (below(l, 60) == 0) {
        r->point[2] = below(l, 2) ? 2000000000 : -2000000000;
    }
    r->uncertainty = l->uncertainty_most == 0 ? 0 : below(l, l->uncertainty_most);
}

static void do_reading(struct life *l) {
    struct reading r;
    choose_reading(l, &r);
    const uint32_t intrusions = l->station.intrusions;
    const double least = l->referee != NULL ? least_margin(l, &r) : 0;
    const enum canopy_status status = canopy_station_reading(&l->station, r.point, r.uncertainty, l->now_us);
    const bool intruded = l->station.intrusions != intrusions;
    if (status == CANOPY_OK) {
        l->readings[l->count++] = r;
        met.uncertain += r.uncertainty > 0;
    } else {
        need(l, status == CANOPY_OUT_OF_FRAME || status == CANOPY_RANGE, "an odd status");
        l->latched = l->latched || status == CANOPY_RANGE;
        met.ranges += status == CANOPY_RANGE;
        met.beside += status == CANOPY_OUT_OF_FRAME;
        met.partly += status == CANOPY_OUT_OF_FRAME && isfinite(least) && least < 0;
    }
    if (l->referee != NULL && least < 0) {
        met.beyond++;
        need(l, (status_of(l) & CANOPY_PLC_INTRUSION) != 0, "a reading beyond is no intrusion");
        need(l, (status_of(l) & CANOPY_PLC_VALID) == 0, "a reading beyond leaves the envelope valid");
    }
    const double near = (2 * CANOPY_SURFACE_FX_ERROR + 2) * l->published.lsb;
    if (status == CANOPY_OK && r.uncertainty == 0 && intruded) {
        need(l, l->referee != NULL && least <= near, "a reading well inside is an intrusion");
    }
}

static void check_life(uint64_t seed) {
    static struct life life;
    struct life *l = &life;
    start(l, seed);
    for (int act = 0; act < ACTS && l->count < READINGS_MAX; act++) {
        l->now_us += below(l, 2000);
        if (below(l, 3)) {
            do_reading(l);
        } else {
            canopy_station_step(&l->station, below(l, 40), l->now_us);
        }
        check_publication(l);
    }
    for (int n = 0; n < 40; n++) {
        l->now_us += 2000;
        canopy_station_step(&l->station, 1000, l->now_us);
        check_publication(l);
    }
    need(l, l->count == 0 || canopy_plc_published(&l->station.plc)->points == l->count, "it never settles");
    if (l->referee != NULL) {
        canopy_rational_close(l->referee);
    }
}

static void turned_lives(void **state) {
    (void)state;
    seeds_run(LIVES, check_life);
    if (seeds_number("CANOPY_SEED", 0) == 0) {
        assert_true(met.publications > 0 && met.beyond > 0 && met.partly > 0 && met.beside > 0 && met.ranges > 0 &&
                    met.uncertain > 0);
    }
}

static void axes_that_are_no_rotation(void **state) {
    (void)state;
    struct life l = {0};
    l.config = (struct canopy_station_config){.grid = {{4, 4}, 1, CANOPY_ABOVE},
                                              .turning = turning(),
                                              .fit = &canopy_line_fit_fx,
                                              .lines = 1,
                                              .clients = 1,
                                              .unit = 1};
    l.config.axes[0][0] = CANOPY_AXIS_ONE;
    assert_int_equal(canopy_station_init(&l.station, &l.config, arena, sizeof arena, 0), CANOPY_ARGUMENT);
    memset(l.config.axes, 0, sizeof l.config.axes);
    assert_int_equal(canopy_station_init(&l.station, &l.config, arena, sizeof arena, 0), CANOPY_OK);
    struct canopy_frame frame;
    const int32_t low[3] = {0, 0, 0}, high[3] = {100, 100, 10};
    assert_int_equal(canopy_frame_around_fx(&frame, &l.config.grid, low, high), CANOPY_OK);
    frame.axis[0][1] = 1 << 20;
    assert_int_equal(canopy_station_begin(&l.station, &frame), CANOPY_ARGUMENT);
    assert_int_equal(l.station.stage, CANOPY_STATION_WAITING);
}

// A station without that part refuses what is turned, wherever it comes from, and goes on with what it has.
static void a_station_of_straight_axes(void **state) {
    (void)state;
    struct life l = {0};
    l.config = (struct canopy_station_config){
        .grid = {{4, 4}, 1, CANOPY_ABOVE}, .fit = &canopy_line_fit_fx, .lines = 1, .clients = 1, .unit = 1};
    const int32_t slant[3] = {1, 0, 1}, low[3] = {0, 0, 0}, high[3] = {100, 100, 10}, point[3] = {50, 50, 5};
    assert_int_equal(canopy_axes_from_direction_fx(slant, l.config.axes), CANOPY_OK);
    assert_int_equal(canopy_station_init(&l.station, &l.config, arena, sizeof arena, 0), CANOPY_UNSUPPORTED);
    memset(l.config.axes, 0, sizeof l.config.axes);
    assert_int_equal(canopy_station_init(&l.station, &l.config, arena, sizeof arena, 0), CANOPY_OK);
    assert_int_equal(canopy_station_begin_box(&l.station, low, high), CANOPY_OK);
    assert_int_equal(canopy_station_reading(&l.station, point, 0, 0), CANOPY_OK);
    struct canopy_frame frame = l.station.field.frame;
    assert_int_equal(canopy_axes_from_direction_fx(slant, frame.axis), CANOPY_OK);
    assert_int_equal(canopy_station_begin(&l.station, &frame), CANOPY_UNSUPPORTED);
    assert_int_equal(l.station.points, 1);
    assert_int_equal(canopy_station_reading(&l.station, point, 0, 0), CANOPY_OK);
}

// One with so much uncertainty that it may be almost anywhere: nothing can cover it.
static void a_reading_that_may_be_anywhere(void **state) {
    (void)state;
    struct life l = {0};
    l.config = (struct canopy_station_config){.grid = {{4, 4}, 1, CANOPY_ABOVE},
                                              .turning = turning(),
                                              .fit = &canopy_line_fit_fx,
                                              .lines = 1,
                                              .clients = 1,
                                              .unit = 1};
    const int32_t slant[3] = {1, 0, 1}, low[3] = {0, 0, 0}, high[3] = {100, 100, 10}, point[3] = {50, 50, 5};
    assert_int_equal(canopy_axes_from_direction_fx(slant, l.config.axes), CANOPY_OK);
    assert_int_equal(canopy_station_init(&l.station, &l.config, arena, sizeof arena, 0), CANOPY_OK);
    assert_int_equal(canopy_station_reading(&l.station, point, 0, 0), CANOPY_EMPTY);
    assert_int_equal(canopy_station_begin_box(&l.station, low, high), CANOPY_OK);
    assert_int_equal(canopy_station_reading(&l.station, point, UINT32_MAX, 0), CANOPY_RANGE);
    assert_true(l.station.intrusion);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(axes_that_are_no_rotation),
        cmocka_unit_test(a_station_of_straight_axes),
        cmocka_unit_test(a_reading_that_may_be_anywhere),
        cmocka_unit_test(turned_lives),
    };
    return cmocka_run_group_tests_name("turned station", tests, NULL, NULL);
}
