// One byte a cell: its code, and the field that is made of it.

#include "hosttest/unit/unit.h"
#include "lib/cover/certify.h"
#include "lib/cover/fast.h"
#include "lib/cover/field.h"
#include "lib/cover/packed.h"

enum { Q = 1 << CANOPY_PACKED_LOG2 };

static uint32_t next_random(uint32_t *state) {
    *state = *state * 1664525U + 1013904223U;
    return *state >> 6;
}

static int32_t random_height(uint32_t *state) {
    const int32_t any = (int32_t)(next_random(state) % (2U * CANOPY_HEIGHT_LIMIT + 1)) - CANOPY_HEIGHT_LIMIT;
    return next_random(state) % 4 == 0 ? any / Q * Q : any;
}

UNIT(code_stands_for_no_less_than_the_height) {
    uint32_t random = 1;
    for (int i = 0; i < 20000; i++) {
        const int32_t height = random_height(&random), other = random_height(&random);
        const int32_t top = canopy_packed_top(height > other ? height : other);
        const uint8_t code = canopy_packed_code(height, top);
        const int32_t stands = canopy_packed_height(code, top), depth = top - height;
        CHECK(code != CANOPY_PACKED_NONE && stands >= height && stands <= top);
        const int32_t step = depth < 124 * Q ? Q : depth < 368 * Q ? 4 * Q : 16 * Q;
        CHECK(stands - height < step || stands == top - CANOPY_PACKED_DEPTH);
        CHECK_EQ(canopy_packed_code(stands, top), code);
    }
}

UNIT(codes_fall_with_the_height) {
    const int32_t top = 0;
    for (uint8_t code = 0; code + 1 < CANOPY_PACKED_NONE; code++) {
        const int32_t here = canopy_packed_height(code, top), next = canopy_packed_height((uint8_t)(code + 1), top);
        CHECK(here > next);
        CHECK_EQ(canopy_packed_code(here, top), code);
        CHECK_EQ(canopy_packed_code(next + 1, top), code);
    }
    CHECK_EQ(canopy_packed_height(CANOPY_PACKED_NONE - 1, top), top - CANOPY_PACKED_DEPTH);
}

// What a height becomes when the top rises is what it would have been under the higher top from the start.
UNIT(rising_tops_leave_no_trace) {
    uint32_t random = 2;
    for (int i = 0; i < 20000; i++) {
        const int32_t height = random_height(&random);
        int32_t top = canopy_packed_top(height), kept = canopy_packed_height(canopy_packed_code(height, top), top);
        for (int rise = 0; rise < 8; rise++) {
            top += (int32_t)(next_random(&random) % (rise < 4 ? 12 : 40)) * 16 * Q;
            kept = canopy_packed_height(canopy_packed_code(kept, top), top);
            CHECK_EQ(kept, canopy_packed_height(canopy_packed_code(height, top), top));
        }
    }
}

// ---- Fields

enum { M = 5, N = 6, CELLS = 5 };

static CANOPY_ARENA_DECLARE(packed_arena[3], CANOPY_FIELD_PACKED_ARENA(M, N, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(plain_arena, CANOPY_FIELD_ARENA(M, N, CELLS, CELLS));

static struct canopy_frame frame_of(uint8_t side) {
    const struct canopy_grid grid = {{M, N}, CELLS, side};
    const int32_t low[3] = {0, 0, 0}, high[3] = {1000, 1000, 3000};
    struct canopy_frame frame;
    CHECK_EQ(canopy_frame_around_fx(&frame, &grid, low, high), CANOPY_OK);
    return frame;
}

static struct canopy_field packed_field(const struct canopy_frame *frame, int which) {
    const uint16_t cells[2] = {CELLS, CELLS};
    struct canopy_field field;
    CHECK_EQ(canopy_field_init_packed(&field, frame, cells, packed_arena[which], sizeof packed_arena[which]),
             CANOPY_OK);
    return field;
}

static void random_point(uint32_t *state, int32_t point[3]) {
    for (int k = 0; k < 3; k++) {
        point[k] = (int32_t)(next_random(state) % 1001);
    }
    point[2] = next_random(state) % 8 == 0 ? 3 * point[2] : point[2] / 4;
}

static void feed(struct canopy_field *field, uint32_t seed, int count) {
    for (; count > 0; count--) {
        int32_t point[3];
        random_point(&seed, point);
        CHECK_EQ(canopy_field_feed_fx(field, (const int32_t(*)[3])point, 1), 0);
    }
}

static bool are_same(const struct canopy_field *a, const struct canopy_field *b) {
    for (uint32_t c = 0; c < a->axis[0].count * a->axis[1].count; c++) {
        if (a->codes[c] != b->codes[c]) {
            return false;
        }
    }
    for (uint32_t k = 0; k < (M - 1) * (N - 1); k++) {
        if (a->tops[k] != b->tops[k]) {
            return false;
        }
    }
    return true;
}

UNIT(packed_field_is_never_below_the_plain_one) {
    for (uint8_t side = CANOPY_ABOVE; side <= CANOPY_BELOW; side++) {
        const struct canopy_frame frame = frame_of(side);
        const uint16_t cells[2] = {CELLS, CELLS};
        struct canopy_field plain, packed = packed_field(&frame, 0);
        CHECK_EQ(canopy_field_init(&plain, &frame, cells, plain_arena, sizeof plain_arena), CANOPY_OK);
        feed(&plain, 7, 300);
        feed(&packed, 7, 300);
        uint8_t coverage[2][CANOPY_ARENA_ROUND((M - 1) * (N - 1))];
        CHECK_EQ(canopy_field_coverage(&plain, coverage[0]), canopy_field_coverage(&packed, coverage[1]));
        int higher = 0;
        for (uint32_t c = 0; c < plain.axis[0].count * plain.axis[1].count; c++) {
            const int32_t exact = canopy_field_height(&plain, c), coded = canopy_field_height(&packed, c);
            CHECK_EQ(exact == CANOPY_NO_HEIGHT, coded == CANOPY_NO_HEIGHT);
            CHECK(coded >= exact);
            higher += coded > exact + Q;
        }
        CHECK(higher > 0);  // the deep ones
        canopy_field_clear(&packed);
        CHECK_EQ(canopy_field_coverage(&packed, coverage[1]), 0);
    }
}

UNIT(packed_field_says_what_was_raised) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE);
    struct canopy_field field = packed_field(&frame, 0);
    uint32_t random = 9;
    for (int i = 0; i < 2000; i++) {
        int32_t point[3];
        random_point(&random, point);
        struct canopy_field before = packed_field(&frame, 1), hit_field = field;
        CHECK_EQ(canopy_field_merge(&before, &field), CANOPY_OK);
        struct canopy_field_hit hit;
        CHECK_EQ(canopy_field_insert_fx(&hit_field, point, &hit), CANOPY_OK);
        CHECK(canopy_field_height(&field, hit.cell) >= hit.height);
        if (!hit.raised) {
            CHECK(are_same(&before, &field));
        }
    }
}

UNIT(packed_fields_do_not_depend_on_order) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE);
    for (uint32_t seed = 1; seed <= 20; seed++) {
        struct canopy_field a = packed_field(&frame, 0), b = packed_field(&frame, 1);
        feed(&a, seed, 100);
        feed(&a, seed + 1000, 100);
        feed(&b, seed + 1000, 100);
        feed(&b, seed, 100);
        feed(&b, seed, 100);
        CHECK(are_same(&a, &b));
    }
}

UNIT(packed_fields_merge_as_sets_do) {
    const struct canopy_frame frame = frame_of(CANOPY_BELOW);
    for (uint32_t seed = 1; seed <= 20; seed++) {
        struct canopy_field all = packed_field(&frame, 0), some = packed_field(&frame, 1);
        struct canopy_field rest = packed_field(&frame, 2);
        feed(&all, seed, 90);
        feed(&all, seed + 1000, 60);
        feed(&some, seed, 90);
        feed(&rest, seed + 1000, 60);
        CHECK_EQ(canopy_field_merge(&some, &rest), CANOPY_OK);
        CHECK(are_same(&some, &all));
        CHECK_EQ(canopy_field_merge(&rest, &some), CANOPY_OK);
        CHECK(are_same(&rest, &all));
        CHECK_EQ(canopy_field_merge(&some, &some), CANOPY_OK);
        CHECK(are_same(&some, &all));
    }
}

UNIT(packed_field_is_fitted_and_certified) {
    static CANOPY_ARENA_DECLARE(fast_arena, CANOPY_FAST_ARENA(M, N, CELLS, CELLS));
    static CANOPY_ARENA_DECLARE(certify_arena, CANOPY_CERTIFY_ARENA(N, CELLS, CELLS));
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE);
    for (uint32_t seed = 1; seed <= 10; seed++) {
        struct canopy_field field = packed_field(&frame, 0);
        feed(&field, seed, (int)(seed * seed));
        struct canopy_fast fast;
        int32_t b[M * N];
        CHECK_EQ(canopy_fast_init(&fast, &field, &canopy_line_fit_fx, 1, fast_arena, sizeof fast_arena), CANOPY_OK);
        CHECK_EQ(canopy_fast_begin(&fast, b), CANOPY_OK);
        while (canopy_fast_step(&fast, 1) == CANOPY_MORE) {}
        struct canopy_certify certify;
        CHECK_EQ(canopy_certify_init(&certify, &field, certify_arena, sizeof certify_arena), CANOPY_OK);
        canopy_certify_begin(&certify, b);
        CHECK_EQ(canopy_certify_step(&certify, UINT32_MAX), CANOPY_OK);
    }
}

UNIT(packed_field_asks_for_its_arena) {
    const struct canopy_frame frame = frame_of(CANOPY_ABOVE);
    const uint16_t cells[2] = {CELLS, CELLS}, none[2] = {0, CELLS};
    const size_t bytes = CANOPY_FIELD_PACKED_ARENA(M, N, CELLS, CELLS);
    struct canopy_field field;
    CHECK_EQ(canopy_field_init_packed(&field, &frame, cells, packed_arena[0], bytes), CANOPY_OK);
    CHECK_EQ(canopy_field_init_packed(&field, &frame, cells, packed_arena[0], bytes - 1), CANOPY_ARENA_SHORT);
    CHECK_EQ(canopy_field_init_packed(&field, &frame, cells, NULL, bytes), CANOPY_ARENA_ALIGN);
    CHECK_EQ(canopy_field_init_packed(&field, &frame, none, packed_arena[0], bytes), CANOPY_ARGUMENT);
    CHECK_EQ(CANOPY_FIELD_PACKED_ARENA(20, 20, 16, 16), 92416 + 1448);
}

UNIT_LIST(packed, code_stands_for_no_less_than_the_height, codes_fall_with_the_height, rising_tops_leave_no_trace,
          packed_field_is_never_below_the_plain_one, packed_field_says_what_was_raised,
          packed_fields_do_not_depend_on_order, packed_fields_merge_as_sets_do, packed_field_is_fitted_and_certified,
          packed_field_asks_for_its_arena)
