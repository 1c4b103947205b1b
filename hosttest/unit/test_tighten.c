// Tightening on the host and on the device. Many random clouds in exact arithmetic: hosttest/test_tighten_properties.c;
// against the optimum: canopy-tightness.

#include <math.h>

#include "hosttest/unit/unit.h"
#include "lib/cover/certify.h"
#include "lib/cover/envelope.h"
#include "lib/cover/fast.h"
#include "lib/cover/field.h"
#include "lib/cover/tighten.h"
#include "lib/spline/surface.h"

enum { M = 5, N = 4, CELLS = 2, COUNT = M * N, POINTS = 63, ROWS = 160 };

static CANOPY_ARENA_DECLARE(arena, CANOPY_TIGHTEN_ARENA(M, N, CELLS, CELLS, POINTS, ROWS));
static CANOPY_ARENA_DECLARE(field_arena, CANOPY_FIELD_ARENA(M, N, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(certify_arena, CANOPY_CERTIFY_ARENA(N, CELLS, CELLS));
static int32_t points[POINTS][3];
static int32_t b[COUNT];

static struct canopy_frame frame_of(uint8_t side) {
    const struct canopy_grid grid = {{M, N}, CELLS, side};
    const int32_t low[3] = {0, 0, side == CANOPY_ABOVE ? 0 : -1000}, high[3] = {4000, 3000, low[2] + 1000};
    struct canopy_frame frame;
    CHECK_EQ(canopy_frame_around_fx(&frame, &grid, low, high), CANOPY_OK);
    return frame;
}

// A bumpy scene over the whole frame, or over its first quarter.
static void make_points(int32_t extent_u, int32_t extent_v) {
    uint32_t random = 5;
    for (int i = 0; i < POINTS; i++) {
        for (int a = 0; a < 3; a++) {
            random = random * 1664525U + 1013904223U;
            points[i][a] = (int32_t)((random >> 8) % (uint32_t)(a == 0 ? extent_u + 1 : a == 1 ? extent_v + 1 : 300));
        }
        points[i][2] += points[i][0] > 2000 ? 700 : 0;
    }
}

static const struct canopy_tighten_size size = {.points = POINTS, .cells = {CELLS, CELLS}, .rows = ROWS};

static struct canopy_tighten tighten_in(const struct canopy_frame *frame) {
    struct canopy_tighten t;
    CHECK_EQ(canopy_tighten_init(&t, frame, &size, arena, sizeof arena), CANOPY_OK);
    return t;
}

// The lowest that the published surface stands above a point, in steps, as float sees it.
static float lowest_gap(const struct canopy_tighten *t, const struct canopy_frame *frame) {
    float lowest = 1e30f;
    for (int i = 0; i < POINTS; i++) {
        uint32_t interval[2];
        float s[2];
        for (int a = 0; a < 2; a++) {
            const struct canopy_place place =
                canopy_place_of((uint32_t)(points[i][a] - frame->origin[a]), frame->pitch[a], frame->size[a]);
            interval[a] = place.interval;
            s[a] = (float)place.s / (float)CANOPY_UNIT_Q30;
        }
        const float z = ldexpf((float)(points[i][2] - frame->origin[2]), -frame->lsb_log2);
        const float gap =
            canopy_surface_f32(t->b, frame->size, interval, s, NULL) - (frame->side == CANOPY_BELOW ? -z : z);
        lowest = gap < lowest ? gap : lowest;
    }
    return lowest;
}

static void fill(int32_t value) {
    for (int j = 0; j < COUNT; j++) {
        b[j] = value;
    }
}

UNIT(asks_for_its_arena_to_the_byte) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE);
    const size_t bytes = CANOPY_TIGHTEN_ARENA(M, N, CELLS, CELLS, POINTS, ROWS);
    struct canopy_tighten t;
    CHECK_EQ(bytes % 8, 0);
    CHECK_EQ(canopy_tighten_init(&t, &frame, &size, arena, bytes - 1), CANOPY_ARENA_SHORT);
    CHECK_EQ(canopy_tighten_init(&t, &frame, &size, (char *)arena + 4, bytes), CANOPY_ARENA_ALIGN);
    CHECK_EQ(canopy_tighten_init(&t, &frame, &size, NULL, bytes), CANOPY_ARENA_ALIGN);
    static const struct canopy_tighten_size bad[] = {{.rows = ROWS},
                                                     {.points = POINTS, .rows = 2 * COUNT - 1},
                                                     {.cells = {CELLS, 0}, .rows = ROWS},
                                                     {.cells = {CANOPY_CELLS_MAX + 1, CELLS}, .rows = ROWS}};
    for (size_t k = 0; k < sizeof bad / sizeof bad[0]; k++) {
        CHECK_EQ(canopy_tighten_init(&t, &frame, &bad[k], arena, bytes), CANOPY_ARGUMENT);
    }
    CHECK_EQ(canopy_tighten_init(&t, &frame, &size, arena, bytes), CANOPY_OK);
    CHECK(t.flagged + CANOPY_ARENA_ROUND(CANOPY_TIGHTEN_CELLS(M, N)) == (uint8_t *)arena + bytes);
}

UNIT(refuses_what_is_no_cloud) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE);
    struct canopy_tighten t = tighten_in(&frame);
    CHECK_EQ(canopy_tighten_step(&t, 1), CANOPY_EMPTY);
    make_points(4000, 3000);
    CHECK_EQ(canopy_tighten_points_fx(&t, (const int32_t(*)[3])points, 0), CANOPY_EMPTY);
    points[3][0] = -1;
    CHECK_EQ(canopy_tighten_points_fx(&t, (const int32_t(*)[3])points, POINTS), CANOPY_OUT_OF_FRAME);
    CHECK_EQ(canopy_tighten_begin(&t, b, false), CANOPY_EMPTY);
    points[3][0] = 0;
    points[3][2] = 5000000;
    CHECK_EQ(canopy_tighten_points_fx(&t, (const int32_t(*)[3])points, POINTS), CANOPY_RANGE);
    points[3][2] = -5000000;  // too low to matter
    CHECK_EQ(canopy_tighten_points_fx(&t, (const int32_t(*)[3])points, POINTS), CANOPY_OK);
    t.size.points = POINTS - 1;
    CHECK_EQ(canopy_tighten_points_fx(&t, (const int32_t(*)[3])points, POINTS), CANOPY_ARENA_SHORT);
    t.size.points = POINTS;
    const float bad[1][3] = {{10, NAN, 10}}, infinite[1][3] = {{10, 10, INFINITY}};
    CHECK_EQ(canopy_tighten_points_f32(&t, bad, 1), CANOPY_OUT_OF_FRAME);
    CHECK_EQ(canopy_tighten_points_f32(&t, infinite, 1), CANOPY_OUT_OF_FRAME);
    make_points(4000, 3000);
    CHECK_EQ(canopy_tighten_points_fx(&t, (const int32_t(*)[3])points, POINTS), CANOPY_OK);
    fill(0);
    b[7] = CANOPY_COEFFICIENT_LIMIT + 1;
    CHECK_EQ(canopy_tighten_begin(&t, b, false), CANOPY_ARGUMENT);
}

UNIT(is_safe_and_never_worse_at_any_time) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE);
    struct canopy_tighten t = tighten_in(&frame);
    make_points(4000, 3000);
    CHECK_EQ(canopy_tighten_points_fx(&t, (const int32_t(*)[3])points, POINTS), CANOPY_OK);
    fill(t.low);
    CHECK_EQ(canopy_tighten_begin(&t, b, false), CANOPY_OK);
    CHECK_EQ(t.published, 0);
    float gap = 1e30f;
    uint32_t units = 0;
    while (canopy_tighten_step(&t, 1) == CANOPY_MORE) {
        CHECK(units++ < CANOPY_TIGHTEN_ITERATIONS * 64U);
        if (t.published > 0) {
            CHECK(lowest_gap(&t, &frame) > -32.0f);  // of 2^24: what this evaluation itself may be off
            CHECK(t.mean_gap <= gap);
            gap = t.mean_gap;
        }
    }
    CHECK(t.published > 3);
    CHECK(t.bound > 0 && t.bound <= t.mean_gap);
    CHECK(canopy_tighten_excess(&t) < 0.02f);  // proved: within 2 % of the tightest there is
    CHECK_EQ(canopy_tighten_step(&t, 1), CANOPY_OK);
}

UNIT(keeps_a_safe_start_until_it_finds_better) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE);
    struct canopy_tighten t = tighten_in(&frame);
    make_points(4000, 3000);
    CHECK_EQ(canopy_tighten_points_fx(&t, (const int32_t(*)[3])points, POINTS), CANOPY_OK);
    fill(t.low + (int32_t)t.range);
    CHECK_EQ(canopy_tighten_begin(&t, b, true), CANOPY_OK);
    CHECK_EQ(t.published, 1);
    const float first = t.mean_gap;
    while (canopy_tighten_step(&t, 100) == CANOPY_MORE) {}
    CHECK(t.mean_gap < 0.8f * first);
    // from its own end there is nothing to gain, and nothing is lost
    const float best = t.mean_gap;
    CHECK_EQ(canopy_tighten_begin(&t, b, true), CANOPY_OK);
    CHECK_NEAR(t.mean_gap, best, 1.0f);
    while (canopy_tighten_step(&t, 100) == CANOPY_MORE) {}
    CHECK(t.mean_gap <= best);
}

UNIT(a_flat_scene_has_no_gap) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE);
    struct canopy_tighten t = tighten_in(&frame);
    make_points(4000, 3000);
    for (int i = 0; i < POINTS; i++) {
        points[i][2] = 500;
    }
    CHECK_EQ(canopy_tighten_points_fx(&t, (const int32_t(*)[3])points, POINTS), CANOPY_OK);
    fill(t.low);
    CHECK_EQ(canopy_tighten_begin(&t, b, false), CANOPY_OK);
    while (canopy_tighten_step(&t, 100) == CANOPY_MORE) {}
    CHECK(t.mean_gap < 4.0f);  // steps
}

UNIT(below_is_the_mirror_of_above) {
    static int32_t above[COUNT];
    int32_t low = 0;
    for (uint8_t side = CANOPY_ABOVE; side <= CANOPY_BELOW; side++) {
        const struct canopy_frame frame = frame_of(side);
        struct canopy_tighten t = tighten_in(&frame);
        make_points(4000, 3000);
        for (int i = 0; side == CANOPY_BELOW && i < POINTS; i++) {
            points[i][2] = -points[i][2];
        }
        CHECK_EQ(canopy_tighten_points_fx(&t, (const int32_t(*)[3])points, POINTS), CANOPY_OK);
        fill(t.low);
        CHECK_EQ(canopy_tighten_begin(&t, b, false), CANOPY_OK);
        while (canopy_tighten_step(&t, 100) == CANOPY_MORE) {}
        CHECK(lowest_gap(&t, &frame) > -32.0f);
        for (int j = 0; j < COUNT; j++) {
            CHECK(side == CANOPY_ABOVE || b[j] - t.low == above[j] - low);
        }
        memcpy(above, b, sizeof b);
        low = t.low;
    }
}

// Sum of squared second differences, ends repeated.
static float energy(const struct canopy_tighten *t) {
    float sum = 0;
    for (int j = 0; j < COUNT; j++) {
        const int i = j / N, k = j % N, up = i > 0 ? j - N : j, down = i + 1 < M ? j + N : j;
        const int left = k > 0 ? j - 1 : j, right = k + 1 < N ? j + 1 : j, far = k + 1 < N ? down + 1 : down;
        const float u = (float)(b[up] - 2 * b[j] + b[down]) / t->range;
        const float v = (float)(b[left] - 2 * b[j] + b[right]) / t->range;
        const float uv = (float)(b[j] - b[right] - b[down] + b[far]) / t->range;
        sum += u * u + v * v + 2 * uv * uv;
    }
    return sum;
}

UNIT(what_is_free_is_bent_least) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE);
    struct canopy_tighten t = tighten_in(&frame);
    make_points(4000, 999);  // the first column of knot cells: the last column of coefficients is free
    for (int i = 0; i < POINTS; i++) {
        points[i][2] = points[i][0] / 8 + points[i][1] / 16;  // gentle, so that nothing ends at the reach
    }
    CHECK_EQ(canopy_tighten_points_fx(&t, (const int32_t(*)[3])points, POINTS), CANOPY_OK);
    fill(t.low);
    b[COUNT - 1] = 3 * (int32_t)t.range;  // a free one, far out
    CHECK_EQ(canopy_tighten_begin(&t, b, false), CANOPY_OK);
    while (canopy_tighten_step(&t, 100) == CANOPY_MORE) {}
    CHECK(lowest_gap(&t, &frame) > -32.0f);
    const float least = energy(&t);
    for (int j = 0; j < COUNT; j++) {
        CHECK_EQ(t.seen[j], j % N < 3);
        for (int by = -1; by <= 1 && !t.seen[j]; by += 2) {
            const int32_t step = by * (int32_t)(t.range / 16);
            b[j] += step;
            CHECK(energy(&t) > least);
            b[j] -= step;
        }
    }
}

UNIT(from_a_field_it_stays_certified) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE);
    const uint16_t cells[2] = {CELLS, CELLS};
    struct canopy_field field;
    struct canopy_certify certify;
    CHECK_EQ(canopy_field_init(&field, &frame, cells, field_arena, sizeof field_arena), CANOPY_OK);
    CHECK_EQ(canopy_certify_init(&certify, &field, certify_arena, sizeof certify_arena), CANOPY_OK);
    make_points(4000, 3000);
    CHECK_EQ(canopy_field_feed_fx(&field, (const int32_t(*)[3])points, POINTS), 0);
    struct canopy_tighten t = tighten_in(&frame);
    CHECK_EQ(canopy_tighten_field(&t, &field, &certify), CANOPY_OK);
    fill(t.low);
    CHECK_EQ(canopy_tighten_begin(&t, b, false), CANOPY_OK);
    uint32_t published = 0;
    for (enum canopy_status status = CANOPY_MORE; status == CANOPY_MORE;) {
        status = canopy_tighten_step(&t, 1);
        if (t.published > published || status == CANOPY_OK) {
            published = t.published;
            canopy_certify_begin(&certify, b);
            CHECK_EQ(canopy_certify_step(&certify, UINT32_MAX), CANOPY_OK);
            CHECK(certify.margin >= 0);
        }
    }
    CHECK(published > 2);
}

// Above another surface that pokes through the data, on every half-knot cell: so is the difference of the two.
UNIT(stays_above_another_surface) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE);
    static int32_t other[COUNT];
    struct canopy_tighten t = tighten_in(&frame);
    make_points(4000, 999);  // half of the frame is empty
    CHECK_EQ(canopy_tighten_over(&t, other), CANOPY_EMPTY);
    CHECK_EQ(canopy_tighten_points_fx(&t, (const int32_t(*)[3])points, POINTS), CANOPY_OK);
    for (int j = 0; j < COUNT; j++) {
        other[j] = t.low + (int32_t)(t.range * (j % N == 3 ? 0.9f : j % 3 == 0 ? 0.7f : -0.2f));
    }
    other[5] = t.low + 2 * (int32_t)t.range;
    CHECK_EQ(canopy_tighten_over(&t, other), CANOPY_RANGE);
    other[5] = t.low;
    CHECK_EQ(canopy_tighten_over(&t, other), CANOPY_OK);
    fill(t.low);
    CHECK_EQ(canopy_tighten_begin(&t, b, false), CANOPY_OK);
    float gap = 1e30f;
    for (enum canopy_status status = CANOPY_MORE; status == CANOPY_MORE;) {
        status = canopy_tighten_step(&t, 1);
        for (uint32_t k = 0; t.published > 0 && k < 8 * 6; k++) {
            const uint32_t u = k / 6, v = k % 6;
            const float s[2] = {0.5f * (float)(u % 2), 0.5f * (float)(v % 2)};
            const uint32_t interval[2] = {u / 2, v / 2};
            CHECK(canopy_surface_f32(b, frame.size, interval, s, NULL) >
                  canopy_surface_f32(other, frame.size, interval, s, NULL) - 32.0f);
        }
        CHECK(t.published == 0 || lowest_gap(&t, &frame) > -32.0f);
        CHECK(t.published == 0 || t.mean_gap <= gap);
        gap = t.published > 0 ? t.mean_gap : gap;
    }
    CHECK(t.published > 3);
    CHECK(canopy_tighten_excess(&t) < 0.02f);
}

UNIT_LIST(tighten, asks_for_its_arena_to_the_byte, refuses_what_is_no_cloud, is_safe_and_never_worse_at_any_time,
          keeps_a_safe_start_until_it_finds_better, a_flat_scene_has_no_gap, below_is_the_mirror_of_above,
          what_is_free_is_bent_least, from_a_field_it_stays_certified, stays_above_another_surface)
