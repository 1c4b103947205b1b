// Grids far from square, the device's way: 4 x 1024 and 1024 x 4 coefficients, both scalars, both sides, from a field,
// judged by tools/common/exact. The command's tests (test_refine.py) have the same from points, and tightened.

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "hosttest/cloud.h"
#include "lib/cover/certify.h"
#include "lib/cover/envelope.h"
#include "lib/cover/fast.h"
#include "lib/cover/field.h"
#include "tools/common/exact.h"
#include "tools/common/random.h"

enum { SHORT = CANOPY_SIZE_MIN, LONG = CANOPY_SIZE_MAX, CELLS = 3, POINTS = 5000 };

#define BOTH(macro, ...) CANOPY_MAX(macro(SHORT, LONG, __VA_ARGS__), macro(LONG, SHORT, __VA_ARGS__))
static CANOPY_ARENA_DECLARE(field_arena, BOTH(CANOPY_FIELD_ARENA, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(fast_arena, BOTH(CANOPY_FAST_ARENA, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(certify_arena, CANOPY_CERTIFY_ARENA(LONG, CELLS, CELLS));

static int32_t fx[POINTS][3], b[SHORT * LONG];
static float f32[POINTS][3];
static double coefficients[SHORT * LONG];

static void make_points(void) {
    uint64_t random = 7;
    for (int i = 0; i < POINTS; i++) {
        const double x = canopy_random_unit(&random), y = canopy_random_unit(&random);
        const double p[3] = {90000 * x, 70000 * y, 4000 * sin(9 * x) * cos(7 * y) + 500 * canopy_random_unit(&random)};
        for (int a = 0; a < 3; a++) {
            fx[i][a] = (int32_t)rint(i < 2 && a < 2 ? i * 100000 : p[a]);  // two opposite corners
            f32[i][a] = (float)fx[i][a] / 8;
        }
    }
}

static struct canopy_frame frame_of(enum canopy_scalar scalar, const struct canopy_grid *grid) {
    static const int32_t low[3] = {0, 0, -4500}, high[3] = {100000, 100000, 4500};
    static const float from[3] = {0, 0, -562.5f}, to[3] = {12500, 12500, 562.5f};
    struct canopy_frame frame;
    assert_int_equal(scalar == CANOPY_F32 ? canopy_frame_around_f32(&frame, grid, from, to)
                                          : canopy_frame_around_fx(&frame, grid, low, high),
                     CANOPY_OK);
    return frame;
}

static int32_t fit(enum canopy_scalar scalar, const struct canopy_frame *frame, uint16_t lines) {
    static const uint16_t cells[2] = {CELLS, CELLS};
    struct canopy_field field;
    struct canopy_fast fast;
    struct canopy_certify certify;
    enum canopy_status status;
    assert_int_equal(canopy_field_init(&field, frame, cells, field_arena, sizeof field_arena), CANOPY_OK);
    assert_int_equal(scalar == CANOPY_F32 ? canopy_field_feed_f32(&field, (const float(*)[3])f32, POINTS)
                                          : canopy_field_feed_fx(&field, (const int32_t(*)[3])fx, POINTS),
                     0);
    assert_int_equal(canopy_fast_init(&fast, &field, canopy_line_fit_of(scalar), lines, fast_arena, sizeof fast_arena),
                     CANOPY_OK);
    assert_int_equal(canopy_fast_begin(&fast, b), CANOPY_OK);
    while (canopy_fast_step(&fast, 100) == CANOPY_MORE) {}
    assert_int_equal(canopy_certify_init(&certify, &field, certify_arena, sizeof certify_arena), CANOPY_OK);
    canopy_certify_begin(&certify, b);
    while ((status = canopy_certify_step(&certify, 1)) != CANOPY_OK) {
        if (status == CANOPY_NOT_SAFE) {
            assert_int_equal(canopy_fast_raise(&field, b, certify.failed_cell, certify.missing), CANOPY_OK);
        }
    }
    canopy_fast_orient(frame, b);
    return certify.margin;
}

static struct canopy_exact_result judge(enum canopy_scalar scalar, const struct canopy_frame *frame) {
    const struct canopy_surrogate s = cloud_surrogate(frame, scalar, b, 1, coefficients);
    const struct canopy_cloud cloud = cloud_of(scalar, (const float(*)[3])f32, (const int32_t(*)[3])fx, POINTS);
    struct canopy_exact_result result;
    assert_true(canopy_exact_check(&s, &cloud, &result));
    return result;
}

static void check(uint16_t m, uint16_t n) {
    for (int k = 0; k < 8; k++) {
        const enum canopy_scalar scalar = k % 2 == 0 ? CANOPY_F32 : CANOPY_FX;
        const struct canopy_grid grid = {.size = {m, n}, .cells = CELLS, .side = (uint8_t)(k / 2 % 2)};
        const struct canopy_frame frame = frame_of(scalar, &grid);
        const int32_t margin = fit(scalar, &frame, k < 4 ? 1 : CELLS);
        const struct canopy_exact_result result = judge(scalar, &frame);
        assert_true(canopy_exact_is_safe(&result));
        assert_true(margin >= 0);
        assert_true(result.margin >= margin * ldexp(1, frame.lsb_log2 + frame.quantum_log2) - 1e-6);
        assert_true(canopy_exact_mean_gap(&result) < 60);  // more coefficients than data
    }
}

static void grid_is_long(void **state) {
    (void)state;
    check(LONG, SHORT);
}

static void grid_is_wide(void **state) {
    (void)state;
    check(SHORT, LONG);
}

static void grid_is_odd(void **state) {
    (void)state;
    check(LONG / 2 - 1, SHORT + 3);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(grid_is_long),
        cmocka_unit_test(grid_is_wide),
        cmocka_unit_test(grid_is_odd),
    };
    make_points();
    return cmocka_run_group_tests_name("grids", tests, NULL, NULL);
}
