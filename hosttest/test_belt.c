// Hours of an endless belt, in virtual time, through the end of its coordinates: what lib/station/belt.h promises.
//
// Line scanners look down on a belt that runs, stops, jerks back and loses its position; the second one stands some way
// behind the first. A model that shares nothing with lib/cover keeps every accepted reading that is still in the ring
// and judges each published envelope in whole numbers of 128 bits, from the published frame and the device coordinates:
//   - it covers exactly the readings accepted so far in its rows, `points` of them, by `margin` at least; its coverage
//     is their cells; no row is in it that should have been forgotten by age;
//   - the intrusion bit stands, and bit 0 is clear, if a reading since lies beyond it, at once and until a publication;
//     it comes only with a reading that is at least nearly beyond;
//   - stale and age are what the model says; and the registers say which row is the first.
// CANOPY_CLOUDS sets how many belts, each an hour long; CANOPY_SEED=n runs that one alone.

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "canopy_registers.h"
#include "hosttest/judge.h"
#include "hosttest/seeds.h"
#include "lib/scan/generic.h"
#include "lib/spline/surface.h"
#include "lib/station/belt.h"
#include "tools/common/random.h"

enum { M = 16, N = 6, Q = 2, OPEN = 4, PROFILES = 4, COLUMNS = 16, PROFILE_MS = 600, HOUR = 3600 * 1000 / PROFILE_MS };
enum { READINGS_MAX = 60000 };  // a belt that stands fills one row

struct reading {
    int64_t row;
    int32_t point[3];  // z at the unsafe end of its uncertainty
    uint64_t time_us;
};

struct world {
    uint64_t seed, random, now_us, last_us;
    struct canopy_belt_config config;
    struct canopy_belt belt;
    struct canopy_modbus_bank bank;
    uint64_t arena[CANOPY_BELT_ARENA(M, N, Q, Q, OPEN, 2) / 8];
    int64_t position, base, pitch;
    struct reading readings[READINGS_MAX];
    uint32_t count;
    struct canopy_envelope published;
    int32_t coefficients[M * N];
    uint8_t coverage[CANOPY_COVERAGE_BYTES(M, N)];
    uint32_t sequence;
    bool beyond, have_last;  // a reading since lies beyond what is published
    int64_t beyond_row;      // the last row with a reading that no envelope can cover
};

static struct {
    uint64_t hours_ms, published, claimed, intrusions, late, expired, overruns, leaps, ranges, dropped, restarts,
        wrapped;
} met;

static struct world world;

#define MUST(condition)                                                                                                \
    do {                                                                                                               \
        if (!(condition)) {                                                                                            \
            fail_msg("CANOPY_SEED=%llu at %llu ms: %s", (unsigned long long)w->seed,                                   \
                     (unsigned long long)(w->now_us / 1000), #condition);                                              \
        }                                                                                                              \
    } while (0)

static uint32_t below(struct world *w, uint32_t n) { return canopy_random_below(&w->random, n); }
static bool chance(struct world *w, double p) { return canopy_random_chance(&w->random, p); }

static bool is_backward(const struct world *w) { return w->config.ring.heading >= CANOPY_AGAINST_X; }
static bool is_mirrored(const struct world *w) {
    return w->config.ring.heading == CANOPY_ALONG_Y || w->config.ring.heading == CANOPY_AGAINST_X;
}

// ---------------------------------------------------------------------------------------------------------------------
// The judge

// Offsets in the published frame, as a PLC finds them: differences modulo 2^32.
static void place(const struct world *w, const struct reading *r, int64_t to[2]) {
    const struct canopy_frame *frame = &w->published.frame;
    for (int a = 0; a < 2; a++) {
        uint32_t sum = 0;
        for (int c = 0; c < 2; c++) {
            const uint32_t d = (uint32_t)r->point[c] - (uint32_t)frame->origin[c];
            sum += (uint32_t)(frame->axis[a][c] / CANOPY_AXIS_ONE) * d;
        }
        to[a] = sum;
    }
}

static bool is_claimed(const struct world *w, int64_t row) {
    return w->sequence != 0 && row > w->published.first_row && row < w->published.first_row + M - 1;
}

// The distance to the safe side, in steps times *scale.
static judge_wide distance(const struct world *w, const struct reading *r, judge_wide *scale) {
    int64_t at[2];
    place(w, r, at);
    MUST(at[0] / w->pitch == r->row - w->published.first_row);
    return judge_distance(&w->published, at, r->point[2], scale);
}

static void check_publication(struct world *w) {
    const struct canopy_envelope *envelope = canopy_plc_published(&w->belt.plc);
    w->published = *envelope;
    w->published.coefficients = memcpy(w->coefficients, envelope->coefficients, sizeof w->coefficients);
    w->published.coverage = memcpy(w->coverage, envelope->coverage, sizeof w->coverage);
    uint8_t coverage[sizeof w->coverage] = {0};
    uint32_t claimed = 0;
    MUST(envelope->margin >= 0 && envelope->frame.lsb_log2 <= 0);
    for (uint32_t i = 0; i < w->count; i++) {
        const struct reading *r = &w->readings[i];
        if (!is_claimed(w, r->row)) {
            continue;
        }
        judge_wide scale;
        MUST(distance(w, r, &scale) >= envelope->margin * scale);
        MUST(w->config.expire_after_us == 0 || w->now_us - r->time_us <= w->config.expire_after_us);
        int64_t at[2];
        place(w, r, at);
        int64_t v = at[1] / envelope->frame.pitch[1];
        v = v < N - 1 ? v : N - 2;
        const uint32_t bit = (uint32_t)((r->row - envelope->first_row) * (N - 1) + v);
        coverage[bit / 8] |= (uint8_t)(1U << bit % 8);
        claimed++;
    }
    MUST(envelope->points == claimed && claimed > 0);
    MUST(memcmp(coverage, w->coverage, CANOPY_COVERAGE_BYTES(M, N)) == 0);
    met.published++;
    met.claimed += claimed;
}

static uint32_t long_at(const uint8_t *bytes) {
    return (uint32_t)bytes[0] << 24 | (uint32_t)bytes[1] << 16 | (uint32_t)bytes[2] << 8 | bytes[3];
}

// What must hold after every call.
static void check(struct world *w) {
    const uint32_t sequence = canopy_plc_sequence(&w->belt.plc);
    if (sequence != w->sequence) {
        w->sequence = sequence;
        w->beyond = false;
        if (sequence != 0) {
            check_publication(w);
        }
    }
    uint8_t live[16], header[2 * 48];
    MUST(w->bank.read(w->bank.context, 0, CANOPY_REGISTER_HEARTBEAT, 8, live) == 0);
    const uint16_t status = (uint16_t)(live[2] << 8 | live[3]);
    const bool stale = !w->have_last || w->now_us - w->last_us > w->config.stale_after_us;
    const bool intrusion = (status & CANOPY_PLC_INTRUSION) != 0;
    MUST(((status & CANOPY_PLC_STALE) != 0) == stale);
    MUST(((status & CANOPY_PLC_VALID) != 0) == (sequence != 0 && !stale && !intrusion));
    MUST(intrusion || !w->beyond);
    MUST(intrusion || !w->have_last || w->beyond_row <= w->belt.ring.first);
    MUST(w->bank.read(w->bank.context, 0, CANOPY_REGISTER_SEQUENCE, 48, header) == 0);
    MUST(long_at(header) == sequence);
    const int64_t first = (int64_t)((uint64_t)long_at(header + 88) << 32 | long_at(header + 92));
    MUST(sequence == 0 || first == w->published.first_row);
}

// Forgets what the ring has dropped or forgotten, which must have been due. Whether it has forgotten a closed row.
static bool prune(struct world *w) {
    const int64_t first = w->belt.ring.first;
    uint32_t here[M - 1 + OPEN] = {0}, kept = 0;
    bool old[M - 1 + OPEN] = {false}, gone[M - 1 + OPEN] = {false}, closed = false;
    for (uint32_t i = 0; i < w->count; i++) {
        const int64_t at = w->readings[i].row - first;
        if (at > 0) {
            here[at]++;
            old[at] = old[at] || w->now_us - w->readings[i].time_us > w->config.expire_after_us;
        }
    }
    for (int64_t at = 1; at < M - 1 + OPEN; at++) {
        struct canopy_ring_row info;
        MUST(canopy_ring_row(&w->belt.ring, first + at, &info) == CANOPY_OK);
        gone[at] = info.readings != here[at];
        MUST(!gone[at] || (info.readings == 0 && w->config.expire_after_us != 0 && old[at]));
        met.expired += gone[at];
        closed = closed || (gone[at] && at < M - 1);
    }
    for (uint32_t i = 0; i < w->count; i++) {
        const int64_t at = w->readings[i].row - first;
        if (at > 0 && !gone[at]) {
            w->readings[kept++] = w->readings[i];
        }
    }
    w->count = kept;
    return closed;
}

// ---------------------------------------------------------------------------------------------------------------------
// The belt and its scanners

static void forget_scene(struct world *w) {
    w->count = 0;
    w->have_last = w->beyond = false;
    w->beyond_row = INT64_MIN;
}

static int32_t height_at(struct world *w, int64_t u, int64_t v) {
    const uint64_t part = canopy_random_mix((uint64_t)judge_floor_div(u, 170) * 31 + (uint64_t)(v / 130));
    return (int32_t)(below(w, 12) + ((part & 3) == 0 ? part >> 8 & 0x1FF : 0));
}

static void scan_point(struct world *w, int64_t u, int64_t across, int32_t z, uint32_t uncertainty) {
    const int along_axis = w->config.ring.heading % 2, across_axis = 1 - along_axis;
    const bool above = w->config.ring.grid.side == CANOPY_ABOVE;
    int32_t point[3] = {0};
    point[along_axis] = (int32_t)(uint32_t)(uint64_t)(is_backward(w) ? -u : u);
    point[across_axis] = (int32_t)(is_mirrored(w) ? -across : across);
    point[2] = z;
    struct reading r = {.row = judge_floor_div(u - w->base, w->pitch), .time_us = w->now_us};
    memcpy(r.point, point, sizeof point);
    r.point[2] = above ? z + (int32_t)uncertainty : z - (int32_t)uncertainty;
    const bool claimed = is_claimed(w, r.row);
    bool near = false;
    if (claimed && w->have_last) {
        judge_wide scale;
        const judge_wide gap = distance(w, &r, &scale);
        near = gap < (2 * CANOPY_SURFACE_FX_ERROR + 1) * scale;
        w->beyond = w->beyond || gap < 0;
        met.intrusions += gap < 0;
    }
    const bool restarted = !w->belt.running;
    const uint32_t intrusions = w->belt.intrusions;
    const enum canopy_status status = canopy_belt_reading(&w->belt, point, uncertainty, w->now_us);
    met.late += status == CANOPY_OK && claimed;
    switch (status) {
    case CANOPY_OK:
        MUST(restarted || w->belt.intrusions == intrusions || near);
        MUST(w->count < READINGS_MAX);
        w->readings[w->count++] = r;
        w->last_us = w->now_us;
        w->have_last = true;
        break;
    case CANOPY_RANGE:
        MUST(z > 100000 || z < -100000);
        w->beyond_row = r.row > w->beyond_row ? r.row : w->beyond_row;
        met.ranges++;
        break;
    case CANOPY_AHEAD: MUST(w->config.leap != 0); break;
    case CANOPY_DROPPED:
        MUST(r.row <= w->belt.ring.first);
        MUST(!claimed || w->belt.intrusion);  // it can no longer be compared with what is still published of its row
        met.dropped++;
        break;
    default: MUST(false);
    }
    check(w);
}

static void scan_profile(struct world *w, int64_t u, bool wild) {
    const int64_t left = w->belt.ring.field.frame.origin[1];
    const uint32_t width = (uint32_t)canopy_frame_width(&w->belt.ring.field.frame, 1);
    for (uint32_t c = 0; c < COLUMNS; c++) {
        const int64_t across = left + (int64_t)c * width / (COLUMNS - 1);
        int32_t z = height_at(w, u, across - left);
        z = chance(w, 0.0005) ? 600 : z;
        z = chance(w, 0.00004) ? (w->config.ring.grid.side == CANOPY_ABOVE ? 1 << 20 : -(1 << 20)) : z;
        if (!chance(w, 0.1)) {  // some see nothing
            scan_point(w, u, across, z, below(w, 3));
        }
        if (wild) {
            break;
        }
    }
}

static void move_belt(struct world *w) {
    static int64_t speed;
    if (chance(w, 0.01)) {
        speed = chance(w, 0.2) ? 0 : chance(w, 0.1) ? -10 : w->pitch / PROFILES + below(w, 20);
    }
    w->position += speed;
}

static void work(struct world *w) {
    const bool slow = w->seed % 2 == 1 && w->now_us / 120000000 % 5 == 3;  // a busy processor, now and then a minute
    for (uint32_t i = slow ? 1 : 1 + below(w, 40); i > 0; i--) {
        const bool idle = !w->belt.working && !w->belt.due;
        const uint32_t sequence = w->sequence;
        canopy_belt_step(&w->belt, slow ? 1 : 1 + below(w, 8), w->now_us);
        const bool withdrawn = prune(w);
        check(w);
        MUST(!(idle && withdrawn) || w->sequence != sequence || sequence == 0);  // rows too old go at once
    }
}

static void begin_world(struct world *w, uint64_t seed) {
    memset(w, 0, sizeof *w);
    w->seed = seed;
    w->random = seed;
    w->now_us = 1000000;
    w->pitch = 40 + 2 * (int64_t)below(w, 50);
    struct canopy_ring_config *ring = &w->config.ring;
    *ring = (struct canopy_ring_config){.grid = {{M, N}, Q, (uint8_t)below(w, 2)},
                                        .heading = (uint8_t)below(w, 4),
                                        .fit = &canopy_line_fit_fx,
                                        .lines = (uint16_t)(1 + below(w, 2)),
                                        .open = OPEN};
    // Half an hour at the usual speed before coordinates end.
    const int64_t start = INT32_MAX - (int64_t)HOUR / 2 * (w->pitch / PROFILES + 10);
    const int along = ring->heading % 2, across = 1 - along;
    ring->low[along] = (int32_t)(is_backward(w) ? -start - (M - 1) * w->pitch : start);
    ring->high[along] = (int32_t)(is_backward(w) ? -start : start + (M - 1) * w->pitch);
    ring->low[across] = -300;
    ring->high[across] = 300;
    ring->low[2] = 0;
    ring->high[2] = 700;
    w->config.lag = (uint16_t)below(w, 2);
    w->config.leap = 10;
    w->config.clients = 2;
    w->config.unit = 0.001f;
    w->config.stale_after_us = 1500000;
    w->config.expire_after_us = seed % 2 == 0 ? 45000000 : 0;
    MUST(canopy_belt_init(&w->belt, &w->config, w->arena, sizeof w->arena, w->now_us) == CANOPY_OK);
    MUST(w->belt.ring.field.frame.pitch[0] == w->pitch);
    w->base = w->position = start;
    w->bank = canopy_belt_bank(&w->belt);
    forget_scene(w);
    check(w);
}

static void run_an_hour(uint64_t seed) {
    struct world *w = &world;
    begin_world(w, seed);
    for (uint32_t p = 0; p < HOUR; p++) {
        w->now_us += PROFILE_MS * 1000;
        move_belt(w);
        scan_profile(w, w->position, false);
        if (w->config.lag > 0) {
            scan_profile(w, w->position - w->pitch + 7, false);
        }
        if (chance(w, 0.004)) {
            scan_profile(w, w->position - (int64_t)below(w, (uint32_t)((M - 2) * w->pitch)), false);
        }
        if (chance(w, 0.004)) {  // the encoder is wrong for once
            const uint32_t accepted = w->belt.accepted;
            scan_profile(w, w->position + 12 * w->pitch + below(w, 1 << 30), true);
            MUST(w->belt.accepted == accepted);
            met.leaps++;
        }
        if (chance(w, 0.0006)) {
            const uint8_t restart[2] = {(uint8_t)(1 + below(w, 250)), CANOPY_PLC_COMMAND_RESTART};
            MUST(w->bank.write(w->bank.context, 1, CANOPY_REGISTER_COMMAND, 1, restart, 6) == 0);
            MUST(canopy_plc_sequence(&w->belt.plc) == 0);
            forget_scene(w);
            w->position += chance(w, 0.5) ? 0 : (int64_t)below(w, 1 << 20);
            met.restarts++;
            check(w);
            continue;
        }
        work(w);
    }
    met.hours_ms += HOUR * PROFILE_MS;
    met.overruns += w->belt.overruns;
    met.wrapped += w->position > INT32_MAX;
    MUST(w->belt.fits_failed == 0);
}

static void hours_of_belt(void **state) {
    (void)state;
    seeds_run(4, run_an_hour);
    printf(
        "# %llu minutes of belt, %llu envelopes, %llu readings claimed, %llu beyond, %llu late, %llu rows too old, "
        "%llu "
        "overruns, %llu leaps, %llu out of range, %llu dropped, %llu restarts, %llu through the end of coordinates\n",
        (unsigned long long)met.hours_ms / 60000, (unsigned long long)met.published, (unsigned long long)met.claimed,
        (unsigned long long)met.intrusions, (unsigned long long)met.late, (unsigned long long)met.expired,
        (unsigned long long)met.overruns, (unsigned long long)met.leaps, (unsigned long long)met.ranges,
        (unsigned long long)met.dropped, (unsigned long long)met.restarts, (unsigned long long)met.wrapped);
    if (met.hours_ms >= 4ULL * 3600 * 1000) {
        assert_true(met.published > 5000 && met.intrusions > 100 && met.late > 1000 && met.expired > 50);
        assert_true(met.overruns > 5 && met.leaps > 50 && met.ranges > 5 && met.dropped > 10 && met.restarts > 5);
        assert_true(met.wrapped > 2);
    }
}

static void bad_configurations_are_refused(void **state) {
    (void)state;
    struct world *w = &world;
    begin_world(w, 1);
    struct canopy_belt_config bad = w->config;
    bad.lag = OPEN;
    assert_int_equal(canopy_belt_init(&w->belt, &bad, w->arena, sizeof w->arena, 0), CANOPY_ARGUMENT);
    bad = w->config;
    bad.unit = 0;
    assert_int_equal(canopy_belt_init(&w->belt, &bad, w->arena, sizeof w->arena, 0), CANOPY_ARGUMENT);
    bad = w->config;
    bad.ring.grid.size[0] = 3;
    assert_int_equal(canopy_belt_init(&w->belt, &bad, w->arena, sizeof w->arena, 0), CANOPY_ARGUMENT);
    const size_t least = CANOPY_BELT_ARENA(M, N, Q, w->config.ring.lines, OPEN, 2);
    assert_int_equal(canopy_belt_init(&w->belt, &w->config, w->arena, least - 1, 0), CANOPY_ARENA_SHORT);
    assert_int_equal(canopy_belt_init(&w->belt, &w->config, w->arena, least, 0), CANOPY_OK);
    const uint8_t refit[2] = {1, CANOPY_PLC_COMMAND_REFIT};
    uint8_t result[2];
    assert_int_equal(w->bank.write(w->bank.context, 0, CANOPY_REGISTER_COMMAND, 1, refit, 6), 0);
    assert_int_equal(w->bank.read(w->bank.context, 0, CANOPY_REGISTER_COMMAND_RESULT, 1, result), 0);
    assert_int_equal(result[1], CANOPY_PLC_RESULT_REFUSED);  // there is nothing yet
    const int32_t beside[3] = {INT32_MAX, INT32_MAX, 0};
    assert_int_equal(canopy_belt_reading(&w->belt, beside, 0, 0), CANOPY_OUT_OF_FRAME);
    assert_false(w->belt.running);
}

// ---------------------------------------------------------------------------------------------------------------------
// A line scanner on the generic map, its position that of an encoder which wraps

static uint16_t space[CANOPY_GENERIC_HEIGHTS + COLUMNS + 2];

static void put_long(unsigned address, int32_t value) {
    space[address] = (uint16_t)((uint32_t)value >> 16);
    space[address + 1] = (uint16_t)value;
}

static void show_profile(uint16_t sequence, int32_t y) {
    const unsigned at = CANOPY_GENERIC_PROFILE;
    space[at + CANOPY_GENERIC_P_SEQUENCE] = sequence;
    space[at + CANOPY_GENERIC_P_ID] = 1;
    put_long(at + CANOPY_GENERIC_P_POSITION, y);
    space[at + CANOPY_GENERIC_P_VALID] = COLUMNS - 1;
    for (unsigned c = 0; c < COLUMNS; c++) {
        space[CANOPY_GENERIC_HEIGHTS + c] = c == sequence % COLUMNS ? CANOPY_GENERIC_INVALID : (uint16_t)(c * 9);
    }
    space[CANOPY_GENERIC_HEIGHTS + COLUMNS] = sequence;
}

static void start_scanner(struct canopy_profile_driver *driver, void *arena, size_t bytes) {
    put_long(CANOPY_GENERIC_D_MAGIC, (int32_t)CANOPY_GENERIC_MAGIC);
    space[CANOPY_GENERIC_D_VERSION] = CANOPY_GENERIC_VERSION;
    space[CANOPY_GENERIC_D_ID] = 1;
    space[CANOPY_GENERIC_D_COLUMNS] = COLUMNS;
    put_long(CANOPY_GENERIC_D_X_START, -300);
    put_long(CANOPY_GENERIC_D_X_STEP, 40);
    space[CANOPY_GENERIC_D_Z_STEP] = 1;
    space[CANOPY_GENERIC_D_UNCERTAINTY] = 2;
    for (unsigned i = 0; i < 3; i++) {
        put_long(CANOPY_GENERIC_D_LOW + 2 * i, INT32_MIN);
        put_long(CANOPY_GENERIC_D_HIGH + 2 * i, INT32_MAX);
    }
    put_long(CANOPY_GENERIC_D_UNIT, 0x3F800000);
    const struct canopy_profile_config config = {.table = &canopy_profile_generic, .unit = 1, .columns = COLUMNS};
    assert_int_equal(canopy_profile_init(driver, &config, arena, bytes, 0), CANOPY_OK);
}

// Answers the driver until it holds a profile.
static void fetch(struct canopy_profile_driver *driver, uint64_t *now_us) {
    struct canopy_profile_request request;
    while (canopy_profile_get(driver) == NULL) {
        if (canopy_profile_next(driver, *now_us, &request)) {
            (void)canopy_profile_answer(driver, space + request.address, request.count, *now_us);
        } else {
            *now_us = request.due_us;
        }
    }
}

static void a_scanner_feeds_a_belt_along_its_position(void **state) {
    (void)state;
    static uint64_t profile_arena[CANOPY_PROFILE_ARENA(COLUMNS, 1) / 8];
    static struct canopy_profile_driver driver;
    struct world *w = &world;
    begin_world(w, 2);
    w->config.ring.heading = CANOPY_ALONG_Y;
    w->config.ring.lines = 1;
    w->config.lag = 0;
    w->config.expire_after_us = 0;
    const int32_t start = INT32_MAX - 50 * 100;
    w->config.ring.low[0] = -300;
    w->config.ring.high[0] = 300;
    w->config.ring.low[1] = start;
    w->config.ring.high[1] = start + (M - 1) * 100;
    assert_int_equal(canopy_belt_init(&w->belt, &w->config, w->arena, sizeof w->arena, 0), CANOPY_OK);
    start_scanner(&driver, profile_arena, sizeof profile_arena);
    w->belt.scan = canopy_profile_counters(&driver);
    uint64_t now_us = 0;
    uint16_t column = 0;
    for (uint16_t profile = 1; profile <= 400; profile++) {
        show_profile(profile, (int32_t)((uint32_t)start + 25U * profile));
        fetch(&driver, &now_us);
        while (canopy_belt_profile(&w->belt, &driver, &column, 5, now_us)) {
            canopy_belt_step(&w->belt, 10, now_us);
        }
        for (int i = 0; i < 40; i++) {
            canopy_belt_step(&w->belt, 10, now_us);
        }
    }
    assert_false(canopy_belt_profile(&w->belt, &driver, &column, 5, now_us));  // none is held
    assert_int_equal(w->belt.accepted, 400 * (COLUMNS - 1));
    assert_int_equal(w->belt.rejected, 0);
    const struct canopy_envelope *envelope = canopy_plc_published(&w->belt.plc);
    assert_non_null(envelope);
    assert_int_equal(envelope->points, (M - 2) * 4 * (COLUMNS - 1));
    assert_int_equal(envelope->first_row, 100 - (M - 1));
    assert_int_equal(envelope->frame.origin[1], (int32_t)((uint32_t)start + 100U * (100 - (M - 1))));
    assert_int_equal(envelope->frame.origin[0], 300);  // v runs against x
    assert_true(envelope->frame.origin[1] < 0 && envelope->frame.axis[0][1] == CANOPY_AXIS_ONE);
    for (uint32_t c = 0; c < COLUMNS; c++) {  // in the middle of the window, at each column
        const int64_t at[2] = {(int64_t)(M / 2) * 100 + 50, 600 - (int64_t)c * 40};
        judge_wide scale;
        assert_true(judge_distance(envelope, at, (int32_t)(c * 9 + 2), &scale) >= 0);
    }
    assert_int_equal(w->belt.coverage_pct, 100);
    uint8_t profiles[4];
    assert_int_equal(w->bank.read(w->bank.context, 0, CANOPY_REGISTER_PROFILES, 2, profiles), 0);
    assert_int_equal(long_at(profiles), 400);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(bad_configurations_are_refused),
        cmocka_unit_test(a_scanner_feeds_a_belt_along_its_position),
        cmocka_unit_test(hours_of_belt),
    };
    return cmocka_run_group_tests_name("belt", tests, NULL, NULL);
}
