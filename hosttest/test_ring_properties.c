// What a ring promises (lib/cover/ring.h) in every order of readings, moves, expiries, steps and publications, and that
// fields and rings merge as sets do.
//
// A model that shares nothing with lib/cover keeps every accepted reading with its place along a belt without end, and
// judges what is published as a PLC would use it: from the published frame and coefficients and the device coordinates
// of the readings, differences modulo 2^32 (or the period), in whole numbers of 128 bits. CANOPY_CLOUDS sets how many
// random lives are lived; a failure prints the seed, CANOPY_SEED=n lives that one alone.

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "hosttest/judge.h"
#include "hosttest/seeds.h"
#include "lib/cover/ring.h"
#include "lib/spline/surface.h"
#include "tools/common/random.h"

enum { GRID_MAX = 24, CELLS_MAX = 4, OPEN_MAX = 3, READINGS_MAX = 3000 };

struct reading {
    int64_t u, row;
    int32_t device[2], v, z;
    uint64_t time_us;
};

struct life {
    uint64_t seed, random, now_us;
    struct canopy_ring_config config;
    struct canopy_ring ring;
    uint64_t *arena;
    int64_t base, pitch, first;  // as the model has them
    int64_t head;                // where the belt is
    struct reading readings[READINGS_MAX];
    uint32_t count;
};

static struct { uint64_t published, claimed, dropped, ahead, late, expired, jumps, mended, empty, range; } met;

static struct life life;

#define MUST(condition)                                                                                                \
    do {                                                                                                               \
        if (!(condition)) {                                                                                            \
            fail_msg("CANOPY_SEED=%llu: %s", (unsigned long long)l->seed, #condition);                                 \
        }                                                                                                              \
    } while (0)

static uint32_t below(struct life *l, uint32_t n) { return canopy_random_below(&l->random, n); }
static bool chance(struct life *l, double p) { return canopy_random_chance(&l->random, p); }

static int64_t period_of(const struct life *l) {
    return l->config.period != 0 ? (int64_t)l->config.period : (int64_t)1 << 32;
}

static int64_t rows_of(const struct life *l) { return l->config.grid.size[0] - 1 + l->config.open; }

static bool runs_backward(const struct life *l) { return l->config.heading >= CANOPY_AGAINST_X; }
static bool is_mirrored(const struct life *l) {
    return l->config.heading == CANOPY_ALONG_Y || l->config.heading == CANOPY_AGAINST_X;
}

// ---------------------------------------------------------------------------------------------------------------------
// The judge

// Where a reading is in the published frame, by the frame's axes and origin and the device's coordinates alone.
static void place(const struct life *l, const struct canopy_frame *frame, const struct reading *r, int64_t to[2]) {
    for (int a = 0; a < 2; a++) {
        to[a] = 0;
        for (int c = 0; c < 2; c++) {
            to[a] += frame->axis[a][c] / CANOPY_AXIS_ONE * ((int64_t)r->device[c] - frame->origin[c]);
        }
    }
    to[0] = judge_floor_mod(to[0], period_of(l));
    // Longer than a turn: which turn is meant, the row says.
    const int64_t interval = r->row - l->first;
    while (to[0] < interval * l->pitch) {
        to[0] += period_of(l);
    }
}

static void check_reading(struct life *l, const struct canopy_envelope *envelope, const struct reading *r) {
    const struct canopy_frame *frame = &envelope->frame;
    int64_t at[2];
    place(l, frame, r, at);
    MUST(at[0] == r->u - (l->base + l->first * l->pitch));
    MUST(at[1] >= 0 && at[1] <= (int64_t)canopy_frame_width(frame, 1));
    judge_wide scale;
    MUST(judge_distance(envelope, at, r->z, &scale) >= envelope->margin * scale);
}

static bool is_claimed(const struct life *l, const struct reading *r) {
    return r->row > l->first && r->row < l->first + l->config.grid.size[0] - 1;
}

static void check_envelope(struct life *l, const struct canopy_envelope *envelope) {
    const struct canopy_frame *frame = &envelope->frame;
    const uint32_t across = frame->size[1] - 1U;
    uint8_t coverage[CANOPY_COVERAGE_BYTES(GRID_MAX, GRID_MAX)] = {0};
    uint32_t claimed = 0;
    MUST(envelope->first_row == l->first && frame->lsb_log2 <= 0 && envelope->margin >= 0);
    MUST(memcmp(frame->size, l->config.grid.size, sizeof frame->size) == 0 && frame->side == l->config.grid.side);
    for (uint32_t i = 0; i < l->count; i++) {
        const struct reading *r = &l->readings[i];
        if (is_claimed(l, r)) {
            check_reading(l, envelope, r);
            int64_t at[2];
            place(l, frame, r, at);
            const int64_t w = at[1] / frame->pitch[1];
            const uint32_t bit = (uint32_t)(r->row - l->first) * across + (uint32_t)(w < across ? w : across - 1);
            coverage[bit / 8] |= (uint8_t)(1U << bit % 8);
            claimed++;
        }
    }
    MUST(envelope->points == claimed && claimed > 0);
    MUST(memcmp(coverage, envelope->coverage, CANOPY_COVERAGE_BYTES(frame->size[0], frame->size[1])) == 0);
    met.published++;
    met.claimed += claimed;
}

// ---------------------------------------------------------------------------------------------------------------------
// What happens to a ring

static void forget(struct life *l, bool (*gone)(const struct life *l, const struct reading *r, uint64_t than),
                   uint64_t than) {
    uint32_t kept = 0;
    for (uint32_t i = 0; i < l->count; i++) {
        if (!gone(l, &l->readings[i], than)) {
            l->readings[kept++] = l->readings[i];
        }
    }
    l->count = kept;
}

static bool has_left(const struct life *l, const struct reading *r, uint64_t than) {
    (void)than;
    return r->row <= l->first;
}

static bool is_row(const struct life *l, const struct reading *r, uint64_t than) {
    (void)l;
    return r->row == (int64_t)than;
}

static void do_publish(struct life *l) {
    static int32_t coefficients[GRID_MAX * GRID_MAX];
    static uint8_t coverage[CANOPY_COVERAGE_BYTES(GRID_MAX, GRID_MAX)];
    struct canopy_envelope envelope = {.coefficients = coefficients, .coverage = coverage, .margin = -7};
    switch (canopy_ring_publish(&l->ring, &envelope)) {
    case CANOPY_OK: check_envelope(l, &envelope); break;
    case CANOPY_EMPTY:
        for (uint32_t i = 0; i < l->count; i++) {
            MUST(!is_claimed(l, &l->readings[i]));
        }
        met.empty++;
        MUST(envelope.margin == -7);
        break;
    case CANOPY_MORE: MUST(!canopy_refit_is_certified(&l->ring.refit) && envelope.margin == -7); break;
    default: MUST(false);
    }
}

static void do_reach(struct life *l, int64_t u) {
    const int64_t end = l->first + rows_of(l), row = judge_floor_div(u - l->base, l->pitch);
    const uint64_t by = canopy_ring_reach(&l->ring, u);
    MUST(by == (row >= end ? (uint64_t)(row - end + 1) : 0));
    l->first += (int64_t)by;
    met.jumps += (int64_t)by >= rows_of(l);
    MUST(l->ring.first == l->first);
    forget(l, has_left, 0);
}

// A height of some scene: parts with walls on a rough plane, now and then a spike.
static int32_t height_at(struct life *l, int64_t u, int64_t v) {
    const uint64_t part = canopy_random_mix((uint64_t)judge_floor_div(u, 3 * l->pitch) * 77 + (uint64_t)(v / 90));
    const int32_t plane = (int32_t)below(l, 20), wall = (part & 3) == 0 ? (int32_t)(part >> 8 & 0x3FF) : 0;
    return (int32_t)l->config.low[2] + (chance(l, 0.01) ? 1023 : plane + wall);
}

static void do_reading(struct life *l) {
    const int64_t end = l->base + (l->first + rows_of(l)) * l->pitch, start = l->base + l->first * l->pitch;
    const uint32_t width = (uint32_t)canopy_frame_width(&l->ring.field.frame, 1);
    int64_t u = l->head - below(l, (uint32_t)(2 * l->pitch));
    if (chance(l, 0.1)) {  // anywhere around the ring, but within half a period of its end
        const int64_t reach = end - start + 2 * l->pitch, half = period_of(l) / 2;
        u = end + l->pitch - 1 - below(l, (uint32_t)(reach < half ? reach : half));
    }
    const int across = l->config.heading % 2 == 0 ? 1 : 0, along = 1 - across;
    int64_t v = (int64_t)l->ring.field.frame.origin[1] + below(l, width + 1);
    v = chance(l, 0.01) ? v + width + 1 : v;
    struct reading r = {.u = u, .row = judge_floor_div(u - l->base, l->pitch), .time_us = l->now_us};
    const int64_t counted = judge_floor_mod(runs_backward(l) ? -u : u, period_of(l));
    r.device[along] = (int32_t)(uint32_t)counted;
    r.device[across] = (int32_t)(is_mirrored(l) ? -v : v);
    r.z = height_at(l, u, v - l->ring.field.frame.origin[1]);
    const bool high = chance(l, 0.003), beside = v > (int64_t)l->ring.field.frame.origin[1] + width;
    r.z = high ? (l->config.grid.side == CANOPY_ABOVE ? 1 << 28 : -(1 << 28)) : r.z;
    const struct canopy_ring_place at = canopy_ring_place_of(&l->ring, r.device[0], r.device[1]);
    MUST(at.u == u && at.v == v && canopy_ring_row_at(&l->ring, u) == r.row);
    struct canopy_ring_hit hit;
    const enum canopy_status status = canopy_ring_insert(&l->ring, &at, r.z, l->now_us, &hit);
    const bool dropped = r.row <= l->first, ahead = r.row >= l->first + rows_of(l);
    MUST(status == (beside    ? CANOPY_OUT_OF_FRAME
                    : dropped ? CANOPY_DROPPED
                    : ahead   ? CANOPY_AHEAD
                    : high    ? CANOPY_RANGE
                              : CANOPY_OK));
    met.dropped += !beside && dropped;
    met.ahead += !beside && ahead;
    met.range += status == CANOPY_RANGE;
    struct canopy_ring_row info = {.readings = 4711};
    MUST(canopy_ring_row(&l->ring, r.row, &info) == (dropped ? CANOPY_DROPPED : ahead ? CANOPY_AHEAD : CANOPY_OK));
    MUST(!(dropped || ahead) || info.readings == 4711);
    if (status == CANOPY_OK) {
        MUST(hit.row == r.row && hit.closed == is_claimed(l, &r));
        met.late += hit.closed && hit.raised;
        if (l->count == READINGS_MAX) {
            do_reach(l, end + rows_of(l) * l->pitch);
            l->head = end + rows_of(l) * l->pitch;
        } else {
            l->readings[l->count++] = r;
        }
    }
}

static void do_move(struct life *l) {
    l->head += chance(l, 0.02) ? (int64_t)below(l, (uint32_t)(3 * rows_of(l) * l->pitch))
                               : (int64_t)below(l, (uint32_t)l->pitch);
    const bool first = chance(l, 0.5);
    do_reach(l, first ? l->head : l->head - 1);
}

static void do_expire(struct life *l) {
    const uint64_t before = l->now_us - below(l, 2000000);
    uint32_t gone = 0;
    for (int64_t row = l->first + 1; row < l->first + rows_of(l); row++) {
        uint64_t oldest = UINT64_MAX;
        for (uint32_t i = 0; i < l->count; i++) {
            const struct reading *r = &l->readings[i];
            oldest = r->row == row && r->time_us < oldest ? r->time_us : oldest;
        }
        if (oldest < before) {
            gone += row < l->first + l->config.grid.size[0] - 1;
            forget(l, is_row, (uint64_t)row);
        }
    }
    MUST(canopy_ring_expire(&l->ring, before) == gone);
    met.expired += gone;
}

static void do_step(struct life *l) {
    if (l->ring.refit.stage == CANOPY_REFIT_IDLE || chance(l, 0.02)) {
        canopy_refit_begin(&l->ring.refit);
    }
    const int32_t row = (int32_t)l->ring.refit.certify.failed_cell;
    const enum canopy_status status = canopy_refit_step(&l->ring.refit, below(l, 60));
    met.mended += (int32_t)l->ring.refit.certify.failed_cell != row;
    MUST(status == CANOPY_OK || status == CANOPY_MORE);
    MUST(status != CANOPY_OK || canopy_refit_is_certified(&l->ring.refit));
}

static void random_config(struct life *l) {
    struct canopy_ring_config *c = &l->config;
    const uint16_t q = (uint16_t)(1 + below(l, CELLS_MAX));
    *c = (struct canopy_ring_config){
        .grid = {{(uint16_t)(4 + below(l, GRID_MAX - 3)), (uint16_t)(4 + below(l, 8))}, q, (uint8_t)below(l, 2)}};
    c->heading = (uint8_t)below(l, 4);
    c->fit = canopy_line_fit_of(below(l, 2) ? CANOPY_FX : CANOPY_F32);
    c->open = (uint16_t)(1 + below(l, OPEN_MAX));
    c->lines = chance(l, 0.5) ? 1 : q;
    const int along = c->heading % 2, across = 1 - along;
    const int32_t length = (c->grid.size[0] - 1) * (int32_t)(1 + below(l, 60)) * q, width = (int32_t)below(l, 1000);
    // Near the end of what coordinates are, often, so that they wrap.
    c->low[along] = chance(l, 0.5) ? (int32_t)below(l, 100000) - 50000 : INT32_MAX - length;
    c->high[along] = c->low[along] + length;
    if (runs_backward(l)) {
        const int32_t low = c->low[along];
        c->low[along] = -c->high[along];
        c->high[along] = -low;
    }
    c->low[across] = (int32_t)below(l, 2000) - 1000;
    c->high[across] = c->low[across] + width;
    c->low[2] = (int32_t)below(l, 2000) - 1000;
    c->high[2] = c->low[2] + 1024;
}

static void begin_life(struct life *l, uint64_t seed) {
    uint64_t *old = l->arena;
    free(old);
    memset(l, 0, sizeof *l);
    l->seed = seed;
    l->random = seed;
    l->now_us = 10000000;
    random_config(l);
    const struct canopy_ring_config *c = &l->config;
    const size_t bytes = CANOPY_RING_ARENA(c->grid.size[0], c->grid.size[1], c->grid.cells, c->lines, c->open);
    if (chance(l, 0.3)) {  // a head: a turn is a part of the ring, or more than it
        l->config.period = 1000 + below(l, 20000);
    }
    l->arena = malloc(bytes);  // just as much as asked for: the sanitizer watches the end
    assert_non_null(l->arena);
    MUST(canopy_ring_init(&l->ring, c, l->arena, bytes) == CANOPY_OK);
    l->pitch = l->ring.field.frame.pitch[0];
    l->base = runs_backward(l) ? -(int64_t)c->high[c->heading % 2] : c->low[c->heading % 2];
    l->first = 1 - (int64_t)c->grid.size[0];
    MUST(l->ring.first == l->first);
    if (chance(l, 0.3)) {  // days later
        const int64_t row = (int64_t)(canopy_random_next(&l->random) >> 20) - ((int64_t)1 << 43);
        MUST(canopy_ring_restart(&l->ring, row) == CANOPY_OK);
        l->first += row;
    }
    l->head = l->base + (l->first + rows_of(l)) * l->pitch - 1;
}

static void live(uint64_t seed) {
    struct life *l = &life;
    begin_life(l, seed);
    const uint32_t events = 200 + below(l, 400);
    for (uint32_t e = 0; e < events; e++) {
        l->now_us += below(l, 20000);
        const uint32_t what = below(l, 100);
        if (what < 45) {
            for (uint32_t i = below(l, 12); i > 0; i--) {
                do_reading(l);
            }
        } else if (what < 60) {
            do_move(l);
        } else if (what < 90) {
            do_step(l);
        } else if (what < 97) {
            do_publish(l);
        } else if (what < 98) {
            do_expire(l);
        } else {
            for (uint32_t i = 0; i < 400 && l->ring.refit.stage != CANOPY_REFIT_IDLE; i++) {
                do_step(l);
            }
            do_publish(l);
        }
    }
    do {
        do_step(l);
    } while (!canopy_refit_is_certified(&l->ring.refit));
    do_publish(l);
}

static void every_envelope_covers_what_it_claims(void **state) {
    (void)state;
    seeds_run(1500, live);
    free(life.arena);
    life.arena = NULL;
    if (met.published > 15000) {  // not a few lives by hand
        printf("# %llu envelopes, %llu readings claimed, %llu late, %llu dropped, %llu ahead, %llu rows expired, %llu "
               "jumps, %llu mended\n",
               (unsigned long long)met.published, (unsigned long long)met.claimed, (unsigned long long)met.late,
               (unsigned long long)met.dropped, (unsigned long long)met.ahead, (unsigned long long)met.expired,
               (unsigned long long)met.jumps, (unsigned long long)met.mended);
        assert_true(met.published > 1000 && met.claimed > 1000 && met.late > 1000 && met.dropped > 1000);
        assert_true(met.ahead > 1000 && met.expired > 1000 && met.jumps > 100 && met.mended > 100);
        assert_true(met.empty > 100 && met.range > 100);
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// A belt that runs evenly

enum { M = 24, N = 8, Q = 4, STEPS = 8, ROWS = 90 };  // steps: profiles a knot row

static uint64_t belt_arena[CANOPY_RING_ARENA(M, N, Q, Q, 1) / 8];
static uint64_t fast_arena[CANOPY_FAST_ARENA(M, N, Q, Q) / 8];

static void feed_row(struct canopy_ring *ring, int64_t row, uint64_t *random) {
    for (int64_t p = row * STEPS; p < (row + 1) * STEPS; p++) {
        for (int32_t x = 0; x < 60; x++) {
            const uint64_t part = canopy_random_mix((uint64_t)(p / 17 * 9 + x / 13));
            const struct canopy_ring_place place = {p * 25, x * 25};
            struct canopy_ring_hit hit;
            const int32_t z = (int32_t)(canopy_random_below(random, 30) + ((part & 1) != 0 ? part >> 8 & 0x3FF : 0));
            assert_int_equal(canopy_ring_insert(ring, &place, z, 0, &hit), CANOPY_OK);
        }
    }
}

static void refit(struct canopy_ring *ring) {
    enum canopy_status status;
    canopy_refit_begin(&ring->refit);
    while ((status = canopy_refit_step(&ring->refit, 1)) == CANOPY_MORE) {}
    assert_int_equal(status, CANOPY_OK);
}

// The mean of the surface at the middles of the covered cells, less their heights.
static double mean_gap(const struct canopy_field *field, const int32_t *b) {
    double sum = 0;
    uint32_t count = 0;
    const uint32_t across = field->axis[1].count;
    for (uint32_t c = 0; c < field->axis[0].count * across; c++) {
        if (field->heights[c] != CANOPY_NO_HEIGHT) {
            const uint32_t row = c / across, column = c % across;
            const struct canopy_place u = {row / Q, (int32_t)(2 * (row % Q) + 1) * (CANOPY_UNIT_Q30 / 2 / Q)};
            const struct canopy_place v = {column / Q, (int32_t)(2 * (column % Q) + 1) * (CANOPY_UNIT_Q30 / 2 / Q)};
            sum += canopy_surface_fx(b, field->frame.size, &u, &v, NULL) - (double)field->heights[c];
            count++;
        }
    }
    return sum / count;
}

static double full_gap(const struct canopy_ring *ring, uint16_t lines) {
    struct canopy_fast fast;
    static int32_t b[M * N];
    enum canopy_status status =
        canopy_fast_init(&fast, &ring->field, ring->refit.fast.fit, lines, fast_arena, sizeof fast_arena);
    assert_int_equal(status, CANOPY_OK);
    assert_int_equal(canopy_fast_begin(&fast, b), CANOPY_OK);
    while ((status = canopy_fast_step(&fast, 100)) == CANOPY_MORE) {}
    assert_int_equal(status, CANOPY_OK);
    return mean_gap(&ring->field, b);
}

static const struct canopy_ring_config even = {.grid = {{M, N}, Q, CANOPY_ABOVE},
                                               .high = {(M - 1) * STEPS * 25, 59 * 25, 1100},
                                               .fit = &canopy_line_fit_f32,
                                               .lines = 1,
                                               .open = 1};

static void a_row_costs_its_own_lines_settles_and_is_as_tight(void **state) {
    (void)state;
    for (int scalar = CANOPY_F32; scalar <= CANOPY_FX; scalar++) {
        for (uint16_t lines = 1; lines <= Q; lines = (uint16_t)(lines * Q)) {
            struct canopy_ring_config config = even;
            config.lines = lines;
            config.fit = canopy_line_fit_of((enum canopy_scalar)scalar);
            static struct canopy_ring ring;
            assert_int_equal(canopy_ring_init(&ring, &config, belt_arena, sizeof belt_arena), CANOPY_OK);
            static int32_t settled[ROWS][N];
            uint64_t random = 7;
            double gap = 0, full = 0;
            for (int64_t row = 0; row < ROWS; row++) {
                feed_row(&ring, row, &random);
                assert_int_equal(canopy_ring_reach(&ring, (row + 1) * STEPS * 25), 1);
                refit(&ring);
                assert_int_equal(ring.refit.fitted, row > 0 ? lines + 1 : (M - 1) * lines + 1);
                if (row < M) {
                    continue;
                }
                gap += mean_gap(&ring.field, ring.refit.coefficients);
                full += full_gap(&ring, lines);
                for (int64_t i = ring.first; i <= row + 1; i++) {  // coefficient i stands where row i begins
                    const int32_t *b = ring.refit.coefficients + (i - ring.first) * N;
                    if (i < row - (CANOPY_REFIT_REACH + 3) && row > M) {
                        assert_memory_equal(b, settled[i], sizeof settled[i]);
                    } else if (i < ROWS) {
                        memcpy(settled[i], b, sizeof settled[i]);
                    }
                }
            }
            print_message("# %s, %u lines: %.4f of the gap of full fits\n", scalar ? "fx" : "f32", lines, gap / full);
            assert_true(gap <= 1.01 * full);
        }
    }
}

// A head that turns: all 36 sectors of a turn are covered once it has gone round, wherever that begins and ends.
static void a_head_covers_its_whole_turn(void **state) {
    (void)state;
    enum { SECTORS = 36, PITCH = 40, TURN = SECTORS * PITCH, LONG = SECTORS + 8 };
    static uint64_t arena[CANOPY_RING_ARENA(LONG, 5, 4, 1, 1) / 8];
    static int32_t coefficients[LONG * 5];
    static uint8_t coverage[CANOPY_COVERAGE_BYTES(LONG, 5)];
    const struct canopy_ring_config config = {.grid = {{LONG, 5}, 4, CANOPY_BELOW},
                                              .high = {(LONG - 1) * PITCH, 100, 1000},
                                              .fit = &canopy_line_fit_fx,
                                              .lines = 1,
                                              .open = 1,
                                              .period = TURN};
    static struct canopy_ring ring;
    assert_int_equal(canopy_ring_init(&ring, &config, arena, sizeof arena), CANOPY_OK);
    struct canopy_envelope envelope = {.coefficients = coefficients, .coverage = coverage};
    uint32_t published = 0;
    for (int32_t time = 0; time < 5 * TURN; time += 5) {
        const int32_t angle = time % TURN;
        for (int32_t v = 0; v <= 100; v += 5) {
            const struct canopy_ring_place place = canopy_ring_place_of(&ring, angle, v);
            assert_int_equal(place.u, time);
            if (canopy_ring_reach(&ring, place.u) > 0) {
                refit(&ring);
                assert_int_equal(canopy_ring_publish(&ring, &envelope), CANOPY_OK);
                published++;
                const int64_t start = envelope.first_row * PITCH;
                assert_int_equal(envelope.frame.origin[0], judge_floor_mod(start, TURN));
                for (uint32_t h = 1; time > LONG * PITCH && h < LONG - 1; h++) {  // a turn and more
                    assert_true(coverage[h * 4 / 8] >> (h * 4 % 8) & 1);
                }
            }
            struct canopy_ring_hit hit;
            const int32_t z = 500 + angle / 4 - v;
            assert_int_equal(canopy_ring_insert(&ring, &place, z, 0, &hit), CANOPY_OK);
        }
    }
    assert_true(published > 4 * SECTORS);
}

// ---------------------------------------------------------------------------------------------------------------------
// Merging

enum { FM = 5, FN = 6 };

static struct canopy_field random_field(uint64_t *random, const struct canopy_frame *frame, uint64_t *arena,
                                        size_t bytes, struct canopy_field *all) {
    struct canopy_field field;
    const uint16_t cells[2] = {4, 4};
    assert_int_equal(canopy_field_init(&field, frame, cells, arena, bytes), CANOPY_OK);
    for (uint32_t i = canopy_random_below(random, 200); i > 0; i--) {
        const int32_t p[3] = {(int32_t)canopy_random_below(random, 400), (int32_t)canopy_random_below(random, 400),
                              (int32_t)canopy_random_below(random, 100)};
        struct canopy_field_hit hit;
        assert_int_equal(canopy_field_insert_fx(&field, p, &hit), CANOPY_OK);
        assert_int_equal(canopy_field_insert_fx(all, p, &hit), CANOPY_OK);
    }
    return field;
}

static void fields_merge_as_sets_do(void **state) {
    (void)state;
    static uint64_t arenas[7][CANOPY_FIELD_ARENA(FM, FN, 4, 4) / 8];
    const size_t bytes = sizeof arenas[0];
    uint64_t random = 11;
    for (int i = 0; i < 300; i++) {
        const struct canopy_grid grid = {{FM, FN}, 4, (uint8_t)(i % 2)};
        const int32_t low[3] = {0, 0, 0}, high[3] = {400, 400, 100};
        const uint16_t cells[2] = {4, 4};
        struct canopy_frame frame;
        assert_int_equal(canopy_frame_around_fx(&frame, &grid, low, high), CANOPY_OK);
        struct canopy_field all, f[3];
        assert_int_equal(canopy_field_init(&all, &frame, cells, arenas[0], bytes), CANOPY_OK);
        for (int k = 0; k < 3; k++) {
            f[k] = random_field(&random, &frame, arenas[k + 1], bytes, &all);
        }
        // (a b) c, then c (b a), then all of it again.
        struct canopy_field left, right;
        assert_int_equal(canopy_field_init(&left, &frame, cells, arenas[4], bytes), CANOPY_OK);
        assert_int_equal(canopy_field_init(&right, &frame, cells, arenas[5], bytes), CANOPY_OK);
        for (int k = 0; k < 3; k++) {
            assert_int_equal(canopy_field_merge(&left, &f[k]), CANOPY_OK);
        }
        assert_int_equal(canopy_field_merge(&f[1], &f[0]), CANOPY_OK);
        assert_int_equal(canopy_field_merge(&right, &f[2]), CANOPY_OK);
        assert_int_equal(canopy_field_merge(&right, &f[1]), CANOPY_OK);
        assert_memory_equal(left.heights, all.heights, bytes);
        assert_memory_equal(right.heights, all.heights, bytes);
        assert_int_equal(canopy_field_merge(&left, &right), CANOPY_OK);
        assert_int_equal(canopy_field_merge(&left, &left), CANOPY_OK);
        assert_memory_equal(left.heights, all.heights, bytes);
    }
}

static void check_difference(struct canopy_field *field, struct canopy_field *other, enum canopy_difference expected) {
    static int32_t before[16 * (FM - 1) * (FN - 1)];
    memcpy(before, field->heights, sizeof before);
    assert_int_equal(canopy_field_difference(field, other), expected);
    assert_int_equal(canopy_field_difference(other, field), expected);
    assert_int_equal(canopy_field_merge(field, other), CANOPY_ARGUMENT);
    assert_memory_equal(field->heights, before, sizeof before);
}

static void fields_that_differ_are_refused_by_name(void **state) {
    (void)state;
    static uint64_t arenas[3][CANOPY_FIELD_ARENA(FM, FN, 4, 4) / 8];
    const struct canopy_grid grid = {{FM, FN}, 4, CANOPY_ABOVE};
    const int32_t low[3] = {0, 0, 0}, high[3] = {400, 400, 100};
    const uint16_t cells[2] = {4, 4};
    struct canopy_frame frame;
    uint64_t random = 5;
    assert_int_equal(canopy_frame_around_fx(&frame, &grid, low, high), CANOPY_OK);
    struct canopy_field all;
    assert_int_equal(canopy_field_init(&all, &frame, cells, arenas[2], sizeof arenas[2]), CANOPY_OK);
    struct canopy_field a = random_field(&random, &frame, arenas[0], sizeof arenas[0], &all);
    struct canopy_field b = random_field(&random, &frame, arenas[1], sizeof arenas[1], &all), saved = b;
    assert_int_equal(canopy_field_difference(&a, &b), CANOPY_SAME);
    for (int k = 0; k < 3; k++) {
        b.frame.origin[k]++;
        check_difference(&a, &b, CANOPY_DIFFERENT_ORIGIN);
        b = saved;
        for (int c = 0; c < 3; c++) {
            b.frame.axis[k][c] ^= 1;
            check_difference(&a, &b, CANOPY_DIFFERENT_AXES);
            b = saved;
        }
    }
    for (int k = 0; k < 2; k++) {
        b.frame.pitch[k] += 4;
        check_difference(&a, &b, CANOPY_DIFFERENT_PITCH);
        b = saved;
        b.frame.size[k]++;
        check_difference(&a, &b, CANOPY_DIFFERENT_SIZE);
        b = saved;
        b.axis[k].cells = 2;
        check_difference(&a, &b, CANOPY_DIFFERENT_CELLS);
        b = saved;
    }
    b.frame.cells = 2;
    check_difference(&a, &b, CANOPY_DIFFERENT_CELLS);
    b = saved;
    b.frame.side = CANOPY_BELOW;
    check_difference(&a, &b, CANOPY_DIFFERENT_SIDE);
    b = saved;
    b.frame.lsb_log2++;
    check_difference(&a, &b, CANOPY_DIFFERENT_STEP);
    b = saved;
    b.frame.quantum_log2++;
    check_difference(&a, &b, CANOPY_DIFFERENT_QUANTUM);
}

// Two scanners along one belt, each with a ring of its own, and one ring that saw all.
static void rings_merge_as_if_one_had_seen_all(void **state) {
    (void)state;
    static uint64_t arenas[3][CANOPY_RING_ARENA(M, N, Q, Q, 2) / 8];
    static struct canopy_ring all, rings[2];
    struct canopy_ring_config config = even;
    config.open = 2;
    uint64_t random = 3;
    assert_int_equal(canopy_ring_init(&all, &config, arenas[0], sizeof arenas[0]), CANOPY_OK);
    for (int k = 0; k < 2; k++) {
        assert_int_equal(canopy_ring_init(&rings[k], &config, arenas[k + 1], sizeof arenas[0]), CANOPY_OK);
    }
    for (uint32_t i = 0; i < 30000; i++) {
        const int64_t u = (int64_t)i * STEPS * 25 * 40 / 30000 - canopy_random_below(&random, 200);
        const int32_t v = (int32_t)canopy_random_below(&random, 59 * 25),
                      z = (int32_t)canopy_random_below(&random, 1000);
        const struct canopy_ring_place place = {u, v};
        struct canopy_ring_hit hit;
        for (int k = 0; k < 2; k++) {
            (void)canopy_ring_reach(&rings[k], u + 200);
        }
        (void)canopy_ring_reach(&all, u + 200);
        assert_int_equal(canopy_ring_insert(&rings[i % 2], &place, z, i, &hit), CANOPY_OK);
        assert_int_equal(canopy_ring_insert(&all, &place, z, i, &hit), CANOPY_OK);
        if (i % 1000 == 0) {
            refit(&rings[i / 1000 % 2]);
        }
    }
    assert_int_equal(canopy_ring_difference(&rings[0], &rings[1]), CANOPY_SAME);
    assert_int_equal(canopy_ring_merge(&rings[0], &rings[1]), CANOPY_OK);
    assert_memory_equal(rings[0].field.heights, all.field.heights, 4 * Q * Q * (M + 1) * (N - 1));
    for (int64_t row = all.first + 1; row < all.first + M + 1; row++) {
        struct canopy_ring_row one, other;
        assert_int_equal(canopy_ring_row(&rings[0], row, &one), CANOPY_OK);
        assert_int_equal(canopy_ring_row(&all, row, &other), CANOPY_OK);
        assert_true(one.readings == other.readings && one.oldest_us == other.oldest_us);
    }
    assert_false(canopy_refit_is_certified(&rings[0].refit));
    refit(&rings[0]);
    refit(&all);
    struct canopy_certify certify;
    static uint64_t certify_arena[CANOPY_CERTIFY_ARENA(N, Q, Q) / 8];
    assert_int_equal(canopy_certify_init(&certify, &all.field, certify_arena, sizeof certify_arena), CANOPY_OK);
    canopy_certify_begin(&certify, rings[0].refit.coefficients);
    assert_int_equal(canopy_certify_step(&certify, UINT32_MAX), CANOPY_OK);
    (void)canopy_ring_reach(&all, all.end);
    assert_int_equal(canopy_ring_difference(&rings[0], &all), CANOPY_DIFFERENT_ORIGIN);
    assert_int_equal(canopy_ring_merge(&rings[0], &all), CANOPY_ARGUMENT);
    config.heading = CANOPY_AGAINST_X;
    assert_int_equal(canopy_ring_init(&all, &config, arenas[0], sizeof arenas[0]), CANOPY_OK);
    assert_int_equal(canopy_ring_difference(&rings[0], &all), CANOPY_DIFFERENT_AXES);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(fields_merge_as_sets_do),
        cmocka_unit_test(fields_that_differ_are_refused_by_name),
        cmocka_unit_test(rings_merge_as_if_one_had_seen_all),
        cmocka_unit_test(a_row_costs_its_own_lines_settles_and_is_as_tight),
        cmocka_unit_test(a_head_covers_its_whole_turn),
        cmocka_unit_test(every_envelope_covers_what_it_claims),
    };
    return cmocka_run_group_tests_name("ring", tests, NULL, NULL);
}
