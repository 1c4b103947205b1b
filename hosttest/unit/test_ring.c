// The moving field and the refit of what changed, piece by piece, on the host and on the device. Many random lives in
// exact arithmetic: hosttest/test_ring_properties.c.

#include "hosttest/unit/unit.h"
#include "lib/cover/ring.h"

enum { M = 8, N = 4, Q = 2, PITCH = 20, OPEN = 2 };

static CANOPY_ARENA_DECLARE(arena, CANOPY_RING_ARENA(M, N, Q, 1, OPEN));
static CANOPY_ARENA_DECLARE(other_arena, CANOPY_RING_ARENA(M, N, Q, 1, OPEN));
static struct canopy_ring ring, other;
static int32_t coefficients[M * N];
static uint8_t coverage[CANOPY_COVERAGE_BYTES(M, N)];
static struct canopy_envelope envelope = {.coefficients = coefficients, .coverage = coverage};

static const struct canopy_ring_config plain = {.grid = {{M, N}, Q, CANOPY_ABOVE},
                                                .low = {0, 0, 0},
                                                .high = {(M - 1) * PITCH, (N - 1) * PITCH, 100},
                                                .fit = &canopy_line_fit_fx,
                                                .lines = 1,
                                                .open = OPEN};

static void begin(const struct canopy_ring_config *config) {
    CHECK_EQ(canopy_ring_init(&ring, config, arena, sizeof arena), CANOPY_OK);
}

static enum canopy_status put(int64_t u, int64_t v, int32_t z, uint64_t now_us) {
    const struct canopy_ring_place place = {u, v};
    struct canopy_ring_hit hit;
    return canopy_ring_insert(&ring, &place, z, now_us, &hit);
}

static void refit(void) {
    canopy_refit_begin(&ring.refit);
    enum canopy_status status;
    do {
        status = canopy_refit_step(&ring.refit, 1);
    } while (status == CANOPY_MORE);
    CHECK_EQ(status, CANOPY_OK);
    CHECK(canopy_refit_is_certified(&ring.refit));
    CHECK(!canopy_refit_is_due(&ring.refit));
}

// Fills the rows from `from` up to `end`, each reading at the time of its row.
static void fill(int64_t from, int64_t end) {
    for (int64_t u = from * PITCH; u < end * PITCH; u += 5) {
        (void)canopy_ring_reach(&ring, u);
        for (int64_t v = 0; v <= (N - 1) * PITCH; v += 5) {
            CHECK_EQ(put(u, v, (int32_t)((u * 7 + v * 3) % 50), (uint64_t)u), CANOPY_OK);
        }
    }
}

UNIT(ring_asks_for_its_arena_and_a_sound_configuration) {
    char *bytes = (char *)arena;
    CHECK_EQ(canopy_ring_init(&ring, &plain, bytes, sizeof arena - 1), CANOPY_ARENA_SHORT);
    CHECK_EQ(canopy_ring_init(&ring, &plain, bytes + 4, sizeof arena), CANOPY_ARENA_ALIGN);
    struct canopy_ring_config bad = plain;
    bad.heading = 4;
    CHECK_EQ(canopy_ring_init(&ring, &bad, arena, sizeof arena), CANOPY_ARGUMENT);
    bad = plain;
    bad.open = 0;
    CHECK_EQ(canopy_ring_init(&ring, &bad, arena, sizeof arena), CANOPY_ARGUMENT);
    bad = plain;
    bad.fit = NULL;
    CHECK_EQ(canopy_ring_init(&ring, &bad, arena, sizeof arena), CANOPY_ARGUMENT);
    bad = plain;
    bad.lines = 3;  // does not divide Q
    CHECK_EQ(canopy_ring_init(&ring, &bad, arena, sizeof arena), CANOPY_ARGUMENT);
    bad = plain;
    bad.grid.size[0] = 3;
    CHECK_EQ(canopy_ring_init(&ring, &bad, arena, sizeof arena), CANOPY_ARGUMENT);
    bad = plain;
    bad.high[0] = INT32_MAX;  // with its open rows longer than a coordinate can tell
    CHECK_EQ(canopy_ring_init(&ring, &bad, arena, sizeof arena), CANOPY_ARGUMENT);
    bad = plain;
    bad.heading = CANOPY_AGAINST_X;
    bad.low[0] = INT32_MIN;  // has no opposite
    bad.high[0] = INT32_MIN + 100;
    CHECK_EQ(canopy_ring_init(&ring, &bad, arena, sizeof arena), CANOPY_ARGUMENT);
    begin(&plain);
    CHECK_EQ(canopy_ring_restart(&ring, INT64_MAX / 2), CANOPY_ARGUMENT);
    CHECK_EQ(ring.first, 1 - M);
}

UNIT(ring_says_which_rows_it_has) {
    begin(&plain);
    struct canopy_ring_row row = {.readings = 77};
    CHECK_EQ(canopy_ring_row(&ring, 0, &row), CANOPY_OK);
    CHECK_EQ(row.readings, 0);
    CHECK_EQ(canopy_ring_row(&ring, OPEN, &row), CANOPY_AHEAD);
    CHECK_EQ(put(OPEN * PITCH, 0, 1, 0), CANOPY_AHEAD);
    CHECK_EQ(put(OPEN * PITCH - 1, 0, 1, 5), CANOPY_OK);
    CHECK_EQ(canopy_ring_row(&ring, OPEN - 1, &row), CANOPY_OK);
    CHECK_EQ(row.readings, 1);
    CHECK_EQ(row.oldest_us, 5);
    CHECK_EQ(canopy_ring_reach(&ring, 10 * PITCH - 1), 8);
    CHECK_EQ(canopy_ring_reach(&ring, 10 * PITCH - 1), 0);
    CHECK_EQ(ring.first, 9 - (M - 1) - OPEN + 1);
    CHECK_EQ(canopy_ring_row(&ring, ring.first + 1, &row), CANOPY_OK);
    row.readings = 77;
    CHECK_EQ(canopy_ring_row(&ring, ring.first, &row), CANOPY_DROPPED);  // the guard
    CHECK_EQ(row.readings, 77);
    CHECK_EQ(put((ring.first + 1) * PITCH - 1, 0, 1, 0), CANOPY_DROPPED);
    CHECK_EQ(put((ring.first + 1) * PITCH, 0, 1, 0), CANOPY_OK);
    CHECK_EQ(put(10 * PITCH - 1, (N - 1) * PITCH + 1, 1, 0), CANOPY_OUT_OF_FRAME);
    CHECK_EQ(put(10 * PITCH - 1, -1, 1, 0), CANOPY_OUT_OF_FRAME);
    CHECK_EQ(put(10 * PITCH - 1, 0, 1 << 20, 0), CANOPY_RANGE);
    CHECK_EQ(canopy_ring_row_at(&ring, -1), -1);
    CHECK_EQ(canopy_ring_row_at(&ring, PITCH), 1);
}

UNIT(ring_publishes_closed_rows_only) {
    begin(&plain);
    CHECK_EQ(canopy_ring_publish(&ring, &envelope), CANOPY_EMPTY);
    fill(0, 2);  // both open
    refit();
    CHECK_EQ(canopy_ring_publish(&ring, &envelope), CANOPY_EMPTY);
    (void)canopy_ring_reach(&ring, 2 * PITCH);
    CHECK_EQ(canopy_ring_publish(&ring, &envelope), CANOPY_MORE);
    refit();
    CHECK_EQ(canopy_ring_publish(&ring, &envelope), CANOPY_OK);
    CHECK_EQ(envelope.points, PITCH / 5 * ((N - 1) * PITCH / 5 + 1));
    CHECK_EQ(envelope.first_row, 1 - (M - 1));
    CHECK_EQ(envelope.frame.origin[0], envelope.first_row * PITCH);
    for (uint32_t cell = 0; cell < (M - 1) * (N - 1); cell++) {
        CHECK_EQ(coverage[cell / 8] >> (cell % 8) & 1, cell >= (M - 2) * (N - 1));
    }
}

// A row that closes costs its own two lines, and the certificate of the rows that they shape.
UNIT(refit_does_what_has_changed) {
    begin(&plain);
    for (int64_t row = 0; row < 2 * M; row++) {
        fill(row, row + 1);
        (void)canopy_ring_reach(&ring, (row + OPEN) * PITCH);
        refit();
        CHECK_EQ(ring.refit.fitted, row > 0 ? 2 : M);
    }
    canopy_refit_begin(&ring.refit);
    CHECK_EQ(canopy_refit_step(&ring.refit, 100), CANOPY_OK);
    CHECK_EQ(ring.refit.fitted + ring.refit.certified + ring.refit.solves, 0);
    CHECK(ring.refit.changed_end <= ring.refit.changed_first);
    // A late reading that raises nothing changes nothing; one that does voids the proof of its row.
    CHECK_EQ(put((ring.first + 2) * PITCH, 30, 0, 0), CANOPY_OK);
    CHECK(canopy_refit_is_certified(&ring.refit));
    CHECK_EQ(put((ring.first + 2) * PITCH, 30, 99, 0), CANOPY_OK);
    CHECK(!canopy_refit_is_certified(&ring.refit));
    CHECK_EQ(canopy_ring_publish(&ring, &envelope), CANOPY_MORE);
    refit();
    CHECK_EQ(canopy_ring_publish(&ring, &envelope), CANOPY_OK);
}

// A reading that comes between two steps of a refit is covered when it ends, whatever the refit had done.
UNIT(refit_ends_certified_with_what_came_meanwhile) {
    for (uint32_t after = 0; after < 60; after++) {
        begin(&plain);
        fill(0, M);
        canopy_refit_begin(&ring.refit);
        (void)canopy_refit_step(&ring.refit, after);
        CHECK_EQ(put(3 * PITCH + 3, 17, 100, 0), CANOPY_OK);
        while (canopy_refit_step(&ring.refit, 1) == CANOPY_MORE) {}
        if (!canopy_refit_is_certified(&ring.refit)) {
            refit();  // it had ended already
        }
        struct canopy_certify *certify = &ring.refit.certify;
        canopy_certify_begin(certify, ring.refit.coefficients);
        CHECK_EQ(canopy_certify_step(certify, UINT32_MAX), CANOPY_OK);
    }
}

// In a packed field a reading that raises the top of a knot cell raises what the codes of its other cells can tell.
UNIT(refit_follows_a_packed_field) {
    static CANOPY_ARENA_DECLARE(field_arena, CANOPY_FIELD_PACKED_ARENA(M, N, Q, Q));
    const int32_t low[3] = {0, 0, 0}, high[3] = {(M - 1) * PITCH, (N - 1) * PITCH, 100};
    const uint16_t cells[2] = {Q, Q};
    struct canopy_frame frame;
    struct canopy_field field;
    CHECK_EQ(canopy_frame_around_fx(&frame, &plain.grid, low, high), CANOPY_OK);
    CHECK_EQ(canopy_field_init_packed(&field, &frame, cells, field_arena, sizeof field_arena), CANOPY_OK);
    struct canopy_refit *refit = &other.refit;
    CHECK_EQ(canopy_refit_init(refit, &field, &canopy_line_fit_fx, 1, other_arena, sizeof other_arena), CANOPY_OK);
    uint32_t random = 5;
    for (uint32_t round = 0; round < 40; round++) {
        for (uint32_t i = 0; i < 8; i++) {
            random = random * 1664525U + 1013904223U;
            const int32_t p[3] = {(int32_t)(random >> 8) % high[0], (int32_t)(random >> 12) % high[1],
                                  (int32_t)((random >> 4) % (round + 1) * 2)};
            struct canopy_field_hit hit;
            CHECK_EQ(canopy_field_insert_fx(&field, p, &hit), CANOPY_OK);
            if (hit.raised) {
                canopy_refit_rose(refit, hit.cell);
            }
        }
        canopy_refit_begin(refit);
        CHECK_EQ(canopy_refit_step(refit, UINT32_MAX), CANOPY_OK);
        CHECK(canopy_refit_is_certified(refit));
        canopy_certify_begin(&refit->certify, refit->coefficients);
        CHECK_EQ(canopy_certify_step(&refit->certify, UINT32_MAX), CANOPY_OK);
    }
}

UNIT(ring_runs_through_the_end_of_coordinates) {
    struct canopy_ring_config config = plain;
    config.low[0] = INT32_MAX - (M - 1) * PITCH;
    config.high[0] = INT32_MAX;
    begin(&config);
    int32_t x = config.low[0];
    for (int64_t u = x; u < (int64_t)INT32_MAX + 12 * PITCH; u += 5) {
        const struct canopy_ring_place place = canopy_ring_place_of(&ring, x, 7);
        CHECK_EQ(place.u, u);
        (void)canopy_ring_reach(&ring, place.u);
        CHECK_EQ(put(place.u, place.v, 50, 0), CANOPY_OK);
        x = (int32_t)((uint32_t)x + 5U);
    }
    refit();
    CHECK_EQ(canopy_ring_publish(&ring, &envelope), CANOPY_OK);
    const int64_t start = config.low[0] + envelope.first_row * PITCH;
    CHECK_EQ(envelope.frame.origin[0], (int32_t)(uint32_t)start);
    CHECK(envelope.frame.origin[0] < 0);
}

UNIT(ring_turns_with_the_belt) {
    static const int32_t ways[4][2] = {{1, 0}, {0, 1}, {-1, 0}, {0, -1}};
    for (uint8_t heading = 0; heading < 4; heading++) {
        struct canopy_ring_config config = plain;
        config.heading = heading;
        const int along = heading % 2, across = 1 - along;
        config.low[along] = 1000;
        config.high[along] = 1000 + (M - 1) * PITCH;
        config.low[across] = 300;
        config.high[across] = 300 + (N - 1) * PITCH;
        begin(&config);
        int32_t p[2];
        p[along] = heading < 2 ? 1000 : 1000 + (M - 1) * PITCH;  // where row 0 begins
        p[across] = 310;
        const struct canopy_ring_place place = canopy_ring_place_of(&ring, p[0], p[1]);
        CHECK_EQ(canopy_ring_row_at(&ring, place.u), 0);
        CHECK_EQ(put(place.u, place.v, 5, 0), CANOPY_OK);
        struct canopy_frame frame;
        canopy_ring_frame(&ring, &frame);
        for (int c = 0; c < 2; c++) {
            CHECK_EQ(frame.axis[0][c], ways[heading][c] * CANOPY_AXIS_ONE);
            CHECK_EQ(frame.axis[1][c], (c == 0 ? -ways[heading][1] : ways[heading][0]) * CANOPY_AXIS_ONE);
        }
        const int64_t d[2] = {p[0] - frame.origin[0], p[1] - frame.origin[1]};
        const int64_t u = d[0] * ways[heading][0] + d[1] * ways[heading][1];
        const int64_t v = d[1] * ways[heading][0] - d[0] * ways[heading][1];
        CHECK_EQ(u, (M - 1) * PITCH);
        CHECK(v == 10 || v == (N - 1) * PITCH - 10);
    }
}

UNIT(ring_forgets_rows_by_age) {
    begin(&plain);
    fill(0, M + OPEN);
    refit();
    CHECK_EQ(canopy_ring_publish(&ring, &envelope), CANOPY_OK);
    const uint32_t points = envelope.points;
    struct canopy_ring_row row;
    CHECK_EQ(canopy_ring_row(&ring, ring.first + 1, &row), CANOPY_OK);
    CHECK_EQ(canopy_ring_expire(&ring, row.oldest_us), 0);
    CHECK_EQ(canopy_ring_expire(&ring, row.oldest_us + 1), 1);
    CHECK_EQ(canopy_ring_publish(&ring, &envelope), CANOPY_OK);  // at once: what is left is still proved
    CHECK_EQ(envelope.points, points - row.readings);
    for (uint32_t w = 0; w < 2 * (N - 1); w++) {
        CHECK_EQ(coverage[w / 8] >> (w % 8) & 1, 0);
    }
    CHECK(canopy_refit_is_due(&ring.refit));  // the neighbours may be tighter now
    refit();
    CHECK_EQ(canopy_ring_expire(&ring, UINT64_MAX), M - 3);
    CHECK_EQ(canopy_ring_publish(&ring, &envelope), CANOPY_EMPTY);
}

UNIT(rings_merge_or_say_why_not) {
    begin(&plain);
    CHECK_EQ(canopy_ring_init(&other, &plain, other_arena, sizeof other_arena), CANOPY_OK);
    const struct canopy_ring_place place = {5, 5};
    struct canopy_ring_hit hit;
    CHECK_EQ(canopy_ring_insert(&other, &place, 30, 9, &hit), CANOPY_OK);
    CHECK_EQ(canopy_ring_merge(&ring, &other), CANOPY_OK);
    struct canopy_ring_row row;
    CHECK_EQ(canopy_ring_row(&ring, 0, &row), CANOPY_OK);
    CHECK_EQ(row.readings, 1);
    CHECK_EQ(row.oldest_us, 9);
    (void)canopy_ring_reach(&other, PITCH * OPEN);
    CHECK_EQ(canopy_ring_difference(&ring, &other), CANOPY_DIFFERENT_ORIGIN);
    CHECK_EQ(canopy_ring_merge(&ring, &other), CANOPY_ARGUMENT);
    (void)canopy_ring_reach(&ring, PITCH * OPEN);
    CHECK_EQ(canopy_ring_merge(&ring, &other), CANOPY_OK);
    other.field.frame.side = CANOPY_BELOW;
    CHECK_EQ(canopy_ring_difference(&ring, &other), CANOPY_DIFFERENT_SIDE);
    CHECK_EQ(canopy_ring_merge(&ring, &other), CANOPY_ARGUMENT);
}

UNIT_LIST(ring, ring_asks_for_its_arena_and_a_sound_configuration, ring_says_which_rows_it_has,
          ring_publishes_closed_rows_only, refit_does_what_has_changed, refit_ends_certified_with_what_came_meanwhile,
          refit_follows_a_packed_field, ring_runs_through_the_end_of_coordinates, ring_turns_with_the_belt,
          ring_forgets_rows_by_age, rings_merge_or_say_why_not)
