// Questions to a surface: bounds over windows, clearance, volume, change, other grids. What numbers alone can say; the
// guarantees against a reference are in hosttest/test_query_properties.c.

#include "hosttest/unit/unit.h"
#include "lib/cover/certify.h"
#include "lib/cover/fast.h"
#include "lib/cover/query.h"
#include "lib/cover/query_extreme.h"
#include "lib/cover/query_regrid.h"
#include "lib/cover/query_volume.h"

enum { M = 6, N = 5, PITCH = 120 };

static int32_t heights[2][M * N];
static uint8_t covered[2][CANOPY_COVERAGE_BYTES(M, N)];
static struct canopy_envelope envelopes[2];

static struct canopy_frame frame_of(void) {
    struct canopy_frame frame = {.size = {M, N}, .pitch = {PITCH, PITCH}, .cells = 4};
    for (int k = 0; k < 3; k++) {
        frame.axis[k][k] = CANOPY_AXIS_ONE;
    }
    return frame;
}

// Two surfaces of one height each, all covered.
static void flat(int32_t first, int32_t second) {
    for (int k = 0; k < 2; k++) {
        for (int i = 0; i < M * N; i++) {
            heights[k][i] = k == 0 ? first : second;
        }
        memset(covered[k], 255, sizeof covered[k]);
        envelopes[k] =
            (struct canopy_envelope){.frame = frame_of(), .coefficients = heights[k], .coverage = covered[k]};
    }
}

static struct canopy_extreme_answer find(const struct canopy_query_subject *subject,
                                         const struct canopy_query_rect *rect, enum canopy_extreme_kind kind) {
    struct canopy_extreme_answer answer;
    CHECK_EQ(canopy_extreme_find(subject, rect, kind, 2, 1000, &answer), CANOPY_OK);
    return answer;
}

UNIT(a_flat_surface_is_bounded_to_a_step) {
    flat(1000, -7);
    const struct canopy_query_subject subject = {.surface = &envelopes[0]};
    const struct canopy_query_rect rects[] = {
        canopy_query_whole(&envelopes[0].frame), {{7, 9}, {7, 9}}, {{0, 0}, {1, 1}}, {{PITCH, PITCH}, {PITCH, 300}}};
    for (int i = 0; i < 4; i++) {
        const struct canopy_extreme_answer high = find(&subject, &rects[i], CANOPY_HIGHEST);
        const struct canopy_extreme_answer low = find(&subject, &rects[i], CANOPY_LOWEST);
        CHECK(high.found && low.found);
        CHECK(high.bound >= 1000 && high.bound <= 1001 && high.attained <= 1000 && high.attained >= 999);
        CHECK(low.bound <= 1000 && low.bound >= 999 && low.attained >= 1000 && low.attained <= 1001);
    }
}

// One raised coefficient: the B-spline's own peak is 4/9 of it, at the knot.
UNIT(a_hump_is_found_where_it_is) {
    flat(0, 0);
    heights[0][3 * N + 2] = 900000;
    const struct canopy_query_subject subject = {.surface = &envelopes[0]};
    const struct canopy_query_rect whole = canopy_query_whole(&envelopes[0].frame);
    const struct canopy_extreme_answer high = find(&subject, &whole, CANOPY_HIGHEST);
    CHECK(high.bound >= 400000 && high.attained <= 400000 && high.bound - high.attained <= 4);
    CHECK_EQ(high.at[0], 3 * PITCH);
    CHECK_EQ(high.at[1], 2 * PITCH);
    // Beside it the highest place of the window is its edge, half an interval away: 23/48 * 2/3.
    const struct canopy_query_rect beside = {{3 * PITCH + PITCH / 2, 0}, {4 * PITCH, 4 * PITCH}};
    const struct canopy_extreme_answer edge = find(&subject, &beside, CANOPY_HIGHEST);
    CHECK(edge.bound >= 287500 && edge.attained <= 287500 && edge.bound - edge.attained <= 4);
    CHECK_EQ(edge.at[0], 3 * PITCH + PITCH / 2);
    CHECK_EQ(edge.at[1], 2 * PITCH);
}

UNIT(a_search_can_stop_anywhere) {
    flat(0, 0);
    uint32_t random = 7;
    for (int i = 0; i < M * N; i++) {
        random = random * 1664525U + 1013904223U;
        heights[0][i] = (int32_t)(random >> 8) - (1 << 23);
    }
    const struct canopy_query_subject subject = {.surface = &envelopes[0]};
    const struct canopy_query_rect whole = canopy_query_whole(&envelopes[0].frame);
    struct canopy_extreme_node nodes[CANOPY_EXTREME_NODES];
    struct canopy_extreme search;
    CHECK_EQ(canopy_extreme_begin(&search, &subject, &whole, CANOPY_HIGHEST, 2, nodes, CANOPY_EXTREME_NODES),
             CANOPY_OK);
    CHECK(!canopy_extreme_answer(&search).found);
    CHECK_EQ(canopy_extreme_step(&search, 0), CANOPY_MORE);
    int32_t last = canopy_extreme_answer(&search).bound;
    enum canopy_status status = CANOPY_MORE;
    for (int i = 0; i < 1000 && status == CANOPY_MORE; i++) {
        status = canopy_extreme_step(&search, 1);
        const struct canopy_extreme_answer now = canopy_extreme_answer(&search);
        CHECK(now.bound <= last && now.attained <= now.bound);
        last = now.bound;
    }
    CHECK_EQ(status, CANOPY_OK);
    CHECK(last - canopy_extreme_answer(&search).attained <= 4);
}

UNIT(clearance_of_two_and_to_a_plane) {
    flat(5000, 2000);
    heights[1][2 * N + 2] += 4500;  // rises by 2000
    const struct canopy_query_rect whole = canopy_query_whole(&envelopes[0].frame);
    struct canopy_query_subject subject = {.surface = &envelopes[0], .minus = &envelopes[1]};
    const struct canopy_extreme_answer least = find(&subject, &whole, CANOPY_LOWEST);
    CHECK(least.bound <= 1000 && least.bound >= 997);
    CHECK_EQ(least.at[0], 2 * PITCH);
    // 10 steps an interval up in u, 20 down in v: over the frame 1000 + 50 at most
    const struct canopy_query_plane plane = {1000 * CANOPY_QUERY_PLANE_ONE,
                                             {10 * CANOPY_QUERY_PLANE_ONE, -20 * CANOPY_QUERY_PLANE_ONE}};
    subject = (struct canopy_query_subject){.surface = &envelopes[0], .plane = &plane};
    const struct canopy_extreme_answer to_plane = find(&subject, &whole, CANOPY_LOWEST);
    CHECK(to_plane.bound <= 3950 && to_plane.bound >= 3948);
    CHECK(to_plane.at[0] == (M - 1) * PITCH && to_plane.at[1] == 0);
}

UNIT(only_what_is_covered_counts) {
    flat(0, 0);
    heights[0][0] = 1 << 20;
    memset(covered[0], 0, sizeof covered[0]);
    const struct canopy_query_rect whole = canopy_query_whole(&envelopes[0].frame);
    const struct canopy_query_subject subject = {.surface = &envelopes[0], .covered = true};
    struct canopy_extreme_answer answer = {.bound = 77};
    CHECK_EQ(canopy_extreme_find(&subject, &whole, CANOPY_HIGHEST, 2, 1000, &answer), CANOPY_EMPTY);
    CHECK_EQ(answer.bound, 77);
    covered[0][2] = 4;  // cell 18: row 4, column 2, out of reach
    CHECK(find(&subject, &whole, CANOPY_HIGHEST).bound <= 1);
    struct canopy_query_coverage coverage;
    CHECK_EQ(canopy_query_coverage(&envelopes[0], &envelopes[1], &coverage), CANOPY_OK);
    CHECK(coverage.gained == (M - 1) * (N - 1) - 1 && coverage.lost == 0 && coverage.kept == 1);
}

UNIT(what_cannot_be_asked_says_why) {
    flat(0, 0);
    struct canopy_extreme_answer answer = {.bound = 77};
    struct canopy_query_rect rect = canopy_query_whole(&envelopes[0].frame);
    struct canopy_query_subject subject = {.surface = &envelopes[0], .minus = &envelopes[1]};
    envelopes[1].frame.side = CANOPY_BELOW;
    envelopes[1].frame.cells = 2;
    CHECK_EQ(canopy_query_difference(&envelopes[0], &envelopes[1]), CANOPY_SAME);
    envelopes[1].frame.lsb_log2 = 1;
    CHECK_EQ(canopy_query_difference(&envelopes[0], &envelopes[1]), CANOPY_DIFFERENT_STEP);
    CHECK_EQ(canopy_extreme_find(&subject, &rect, CANOPY_HIGHEST, 2, 9, &answer), CANOPY_ARGUMENT);
    struct canopy_query_coverage coverage = {.kept = 5};
    CHECK_EQ(canopy_query_coverage(&envelopes[0], &envelopes[1], &coverage), CANOPY_ARGUMENT);
    CHECK_EQ(coverage.kept, 5);
    subject.minus = NULL;
    rect.high[1]++;
    CHECK_EQ(canopy_extreme_find(&subject, &rect, CANOPY_HIGHEST, 2, 9, &answer), CANOPY_OUT_OF_FRAME);
    rect.high[1] = 3;
    rect.low[1] = 4;
    CHECK_EQ(canopy_extreme_find(&subject, &rect, CANOPY_HIGHEST, 2, 9, &answer), CANOPY_ARGUMENT);
    rect.low[1] = 3;
    const struct canopy_query_plane plane = {0, {INT64_MAX, 0}};
    subject.plane = &plane;
    CHECK_EQ(canopy_extreme_find(&subject, &rect, CANOPY_HIGHEST, 2, 9, &answer), CANOPY_RANGE);
    subject.plane = NULL;
    heights[0][0] = CANOPY_COEFFICIENT_LIMIT + 1;
    CHECK_EQ(canopy_extreme_find(&subject, &rect, CANOPY_HIGHEST, 2, 9, &answer), CANOPY_RANGE);
    CHECK_EQ(answer.bound, 77);
    struct canopy_volume volume;
    CHECK_EQ(canopy_volume_begin(&volume, &subject, &rect), CANOPY_OK);
    CHECK_EQ(canopy_volume_step(&volume, 100), CANOPY_RANGE);
}

UNIT(slopes_and_normals) {
    flat(0, 0);
    for (uint32_t i = 0; i < M * N; i++) {
        heights[0][i] = (int32_t)(i / N) * 300;  // 300 steps an interval along u, but at the edges
    }
    envelopes[0].frame.lsb_log2 = -1;  // 150 quanta to 120: normal (-5/4, 0, 1) / sqrt(41)/4
    struct canopy_query_point point;
    CHECK_EQ(canopy_query_at(&envelopes[0], 300, 100, &point), CANOPY_OK);
    CHECK(point.low <= 750 && point.high >= 750 && point.high - point.low == 24 && point.covered);
    CHECK_NEAR(point.gradient[0], 300, CANOPY_QUERY_GRADIENT_ERROR);
    CHECK_NEAR(point.gradient[1], 0, CANOPY_QUERY_GRADIENT_ERROR);
    CHECK_NEAR(point.normal[0] / 1073741824.0, -0.78086881, 1e-2);
    CHECK_NEAR(point.normal[2] / 1073741824.0, 0.62469505, 1e-2);
    flat(-3, 0);
    envelopes[0].frame.lsb_log2 = 30;  // steps far larger than quanta, but level
    CHECK_EQ(canopy_query_at(&envelopes[0], 0, 0, &point), CANOPY_OK);
    CHECK(point.normal[0] == 0 && point.normal[1] == 0 && point.normal[2] == CANOPY_AXIS_ONE);
    CHECK_EQ(canopy_query_at(&envelopes[0], 0, (N - 1) * PITCH + 1, &point), CANOPY_OUT_OF_FRAME);
}

UNIT(volumes_of_boxes) {
    flat(50, 20);
    const struct canopy_query_rect rects[] = {canopy_query_whole(&envelopes[0].frame), {{10, 20}, {40, 500 - 20}}};
    const int64_t areas[] = {(int64_t)(M - 1) * (N - 1) * PITCH * PITCH, 30 * (int64_t)460};
    for (int i = 0; i < 2; i++) {
        const struct canopy_query_plane plane = {-7 * CANOPY_QUERY_PLANE_ONE, {0, 0}};
        const struct canopy_query_subject subject = {.surface = &envelopes[0], .minus = &envelopes[1], .plane = &plane};
        struct canopy_volume volume;
        CHECK_EQ(canopy_volume_begin(&volume, &subject, &rects[i]), CANOPY_OK);
        CHECK_EQ(canopy_volume_step(&volume, 3), CANOPY_MORE);
        CHECK_EQ(canopy_volume_step(&volume, 100), CANOPY_OK);
        CHECK_EQ(volume.area, (uint64_t)areas[i]);
        const struct canopy_volume_answer answer = canopy_volume_answer(&volume);
        int64_t low, high;
        CHECK_EQ(canopy_volume_whole(&answer, &low, &high), CANOPY_OK);
        CHECK(low <= 37 * areas[i] && high >= 37 * areas[i] && high - low <= areas[i]);
    }
    const struct canopy_volume_answer far = {.low = 5, .high = 6, .exponent = 62};
    int64_t low = 1, high = 2;
    CHECK_EQ(canopy_volume_whole(&far, &low, &high), CANOPY_RANGE);
    CHECK(low == 1 && high == 2);
    const struct canopy_volume_answer tiny = {.low = -1, .high = 1, .exponent = -200};
    CHECK_EQ(canopy_volume_whole(&tiny, &low, &high), CANOPY_OK);
    CHECK(low == -1 && high == 1);
}

UNIT(change_of_one_cell) {
    flat(100, 300);
    const struct canopy_query_subject change = {.surface = &envelopes[1], .minus = &envelopes[0]};
    int32_t low, high;
    CHECK_EQ(canopy_query_cell(&change, 2, 1, &low, &high), CANOPY_OK);
    CHECK(low == 200 && high == 200);
    heights[1][2 * N + 1] += 36;
    CHECK_EQ(canopy_query_cell(&change, 2, 1, &low, &high), CANOPY_OK);
    CHECK(low == 201 && high == 216);  // 1/36 to 16/36 of it
    CHECK_EQ(canopy_query_cell(&change, 4, 3, &low, &high), CANOPY_OK);
    CHECK(low == 200 && high == 200);
}

UNIT(halving_keeps_a_line_and_rounds_up) {
    static int32_t fine_heights[(2 * M - 1) * N];
    static uint8_t fine_covered[CANOPY_COVERAGE_BYTES(2 * M - 1, N)];
    struct canopy_envelope fine = {.coefficients = fine_heights, .coverage = fine_covered};
    for (int side = CANOPY_ABOVE; side <= CANOPY_BELOW; side++) {
        flat(0, 0);
        const int32_t sign = side == CANOPY_ABOVE ? 1 : -1;
        for (int i = 0; i < M * N; i++) {
            heights[0][i] = sign * (i / N) * 81;
        }
        envelopes[0].frame.side = (uint8_t)side;
        envelopes[0].first_row = -7;
        CHECK_EQ(canopy_regrid_halve(&envelopes[0], 0, &fine), CANOPY_OK);
        CHECK_EQ(fine.first_row, -14);
        CHECK(fine.frame.size[0] == 2 * M - 1 && fine.frame.pitch[0] == PITCH / 2 && fine.frame.cells == 4);
        for (int k = 1; k < 2 * (M - 1); k++) {
            CHECK_EQ(fine_heights[k * N], sign * (k * 81 + 1) / 2);  // 40.5 a half interval, rounded away from 0
        }
        CHECK_EQ(fine_heights[0], sign * 11);                 // 81/8
        CHECK_EQ(fine_heights[2 * (M - 1) * N], sign * 397);  // (9 * 405 + 324)/10 = 396.9
    }
    envelopes[0].frame.pitch[0] = 11;
    CHECK_EQ(canopy_regrid_halve(&envelopes[0], 0, &fine), CANOPY_ARGUMENT);
    CHECK_EQ(fine.frame.pitch[0], PITCH / 2);
}

UNIT(another_grid_stands_above) {
    static CANOPY_ARENA_DECLARE(field_arena, CANOPY_FIELD_ARENA(4, 4, 2, 2));
    static CANOPY_ARENA_DECLARE(fast_arena, CANOPY_FAST_ARENA(4, 4, 2, 1));
    static int32_t coarse_heights[16];
    static struct canopy_regrid regrid;
    flat(0, 0);
    heights[0][2 * N + 2] = 90000;  // 40000 high
    const struct canopy_query_rect whole = canopy_query_whole(&envelopes[0].frame);
    const struct canopy_grid grid = {.size = {4, 4}, .cells = 2};
    const uint16_t cells[2] = {2, 2};
    struct canopy_envelope coarse = {.coefficients = coarse_heights};
    struct canopy_field field;
    struct canopy_fast fast;
    CHECK_EQ(canopy_regrid_frame(&envelopes[0].frame, &whole, &grid, &coarse.frame), CANOPY_OK);
    CHECK(coarse.frame.pitch[0] == 200 && coarse.frame.pitch[1] == 160);
    CHECK_EQ(canopy_field_init(&field, &coarse.frame, cells, field_arena, sizeof field_arena), CANOPY_OK);
    CHECK_EQ(canopy_fast_init(&fast, &field, &canopy_line_fit_fx, 1, fast_arena, sizeof fast_arena), CANOPY_OK);
    canopy_regrid_begin(&regrid, &envelopes[0], whole.low, 0, 4, &field);
    CHECK_EQ(canopy_regrid_step(&regrid, 5), CANOPY_MORE);
    CHECK_EQ(canopy_regrid_step(&regrid, 1000), CANOPY_OK);
    CHECK(field.heights[2 * 6 + 3] >= 40000 && field.heights[2 * 6 + 3] <= 40100);
    CHECK_EQ(canopy_fast_begin(&fast, coarse_heights), CANOPY_OK);
    while (canopy_fast_step(&fast, 1) == CANOPY_MORE) {}
    int32_t low, high;
    CHECK_EQ(canopy_envelope_height(&coarse, 2 * PITCH, 2 * PITCH, &low, &high), CANOPY_OK);
    CHECK(high >= 40000);
    struct canopy_query_rect beyond = whole;
    beyond.high[0]++;
    CHECK_EQ(canopy_regrid_frame(&envelopes[0].frame, &beyond, &grid, &coarse.frame), CANOPY_OUT_OF_FRAME);
    memset(covered[0], 0, sizeof covered[0]);
    canopy_regrid_begin(&regrid, &envelopes[0], whole.low, 0, 4, &field);
    CHECK_EQ(canopy_regrid_step(&regrid, 1000), CANOPY_EMPTY);
}

// A packed field takes the old surface, too; and cells that are widened reach it from beyond its edge.
UNIT(another_grid_fills_any_field) {
    static CANOPY_ARENA_DECLARE(field_arena, CANOPY_FIELD_PACKED_ARENA(4, 4, 2, 2));
    static struct canopy_regrid regrid;
    flat(40000, 0);
    const struct canopy_query_rect part = {{0, 0}, {200, 200}}, whole = canopy_query_whole(&envelopes[0].frame);
    const struct canopy_grid grid = {.size = {4, 4}, .cells = 2};
    const uint16_t cells[2] = {2, 2};
    struct canopy_frame frame;
    struct canopy_field field;
    CHECK_EQ(canopy_regrid_frame(&envelopes[0].frame, &part, &grid, &frame), CANOPY_OK);
    CHECK_EQ(canopy_field_init_packed(&field, &frame, cells, field_arena, sizeof field_arena), CANOPY_OK);
    canopy_regrid_begin(&regrid, &envelopes[0], whole.low, 0, 4, &field);
    CHECK_EQ(canopy_regrid_step(&regrid, 1000), CANOPY_OK);
    for (uint32_t c = 0; c < 36; c++) {
        CHECK(canopy_field_height(&field, c) >= 40000);
    }
    const uint32_t end[2] = {whole.high[0] - 34, 0};  // the second row of cells begins at the old edge
    canopy_regrid_begin(&regrid, &envelopes[0], end, 1, 4, &field);
    CHECK_EQ(canopy_regrid_step(&regrid, 1000), CANOPY_OK);
    CHECK(canopy_field_height(&field, 6) >= 40000);
    CHECK_EQ(canopy_field_height(&field, 12), CANOPY_NO_HEIGHT);
    memset(covered[0], 0, sizeof covered[0]);
    canopy_regrid_begin(&regrid, &envelopes[0], whole.low, 0, 4, &field);
    CHECK_EQ(canopy_regrid_step(&regrid, 1000), CANOPY_EMPTY);
    // A part that ends on a knot, where a covered knot cell begins, and the knot is its own.
    const struct canopy_query_rect to_knot = {{0, 0}, {2 * PITCH, 200}};
    covered[0][1] = 0x0F;  // of row 2
    CHECK_EQ(canopy_regrid_frame(&envelopes[0].frame, &to_knot, &grid, &frame), CANOPY_OK);
    CHECK_EQ(canopy_frame_width(&frame, 0), 2 * PITCH);
    CHECK_EQ(canopy_field_init_packed(&field, &frame, cells, field_arena, sizeof field_arena), CANOPY_OK);
    canopy_regrid_begin(&regrid, &envelopes[0], whole.low, 0, 4, &field);
    CHECK_EQ(canopy_regrid_step(&regrid, 1000), CANOPY_OK);
    for (uint32_t c = 0; c < 36; c++) {
        CHECK_EQ(canopy_field_height(&field, c) >= 40000, c >= 30);
    }
}

UNIT_LIST(query, a_flat_surface_is_bounded_to_a_step, a_hump_is_found_where_it_is, a_search_can_stop_anywhere,
          clearance_of_two_and_to_a_plane, only_what_is_covered_counts, what_cannot_be_asked_says_why,
          slopes_and_normals, volumes_of_boxes, change_of_one_cell, halving_keeps_a_line_and_rounds_up,
          another_grid_stands_above, another_grid_fills_any_field)
