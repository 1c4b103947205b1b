// Fixed point says which way it rounds; the banded solver solves, or says that it did not.

#include "hosttest/unit/unit.h"
#include "lib/num/band.h"
#include "lib/num/fixed.h"

UNIT(shifts_round_their_way) {
    for (int64_t a = -1000; a <= 1000; a++) {
        for (unsigned shift = 1; shift < 6; shift++) {
            const int64_t one = (int64_t)1 << shift;
            const int64_t down = canopy_shift_floor(a, shift), up = canopy_shift_ceil(a, shift);
            CHECK(down * one <= a && a < (down + 1) * one);
            CHECK(up * one >= a && a > (up - 1) * one);
        }
    }
    CHECK_EQ(canopy_shift_floor(INT64_MIN, 62), -2);
    CHECK_EQ(canopy_shift_floor(-1, 40), -1);
}

UNIT(divisions_round_their_way) {
    for (int64_t a = -300; a <= 300; a++) {
        for (int64_t b = 1; b < 20; b++) {
            const int64_t up = canopy_div_ceil(a, b);
            CHECK(up * b >= a && a > (up - 1) * b);
        }
    }
}

UNIT(divisions_without_a_sign_round_up) {
    for (uint64_t b = 1; b < 20; b++) {
        for (uint64_t a = 0; a <= 300; a++) {
            const uint64_t up = canopy_div_up(a, b);
            CHECK(up * b >= a && up * b < a + b);
        }
    }
    CHECK_EQ((int64_t)canopy_div_up((uint64_t)1 << 62, 3), (int64_t)(((uint64_t)1 << 62) / 3 + 1));
}

// Against the compiler's own, on every pair of numbers near a power of two and of many between.
UNIT(products_by_digits_are_exact) {
    int32_t numbers[33 * 4 + 64];
    size_t count = 0;
    for (unsigned k = 0; k < 33; k++) {
        const uint32_t power = (uint32_t)((uint64_t)1 << k);
        for (uint32_t beside = 0; beside < 3; beside++) {
            numbers[count++] = (int32_t)(power + beside - 1);
        }
        numbers[count++] = (int32_t)(0U - power);
    }
    for (uint32_t x = 12345; count < sizeof numbers / sizeof numbers[0]; count++) {
        x = x * 1664525U + 1013904223U;
        numbers[count] = (int32_t)x;
    }
    for (size_t i = 0; i < count; i++) {
        for (size_t j = 0; j < count; j++) {
            const int32_t a = numbers[i], b = numbers[j];
            CHECK(canopy_product_by_digits(a, b) == (int64_t)a * b && canopy_wide(a, b) == (int64_t)a * b);
            const uint32_t high = (uint32_t)((uint64_t)(uint32_t)a * (uint32_t)b >> 32);
            CHECK(canopy_product_high_by_digits((uint32_t)a, (uint32_t)b) == high);
            CHECK(canopy_product_high((uint32_t)a, (uint32_t)b) == high);
        }
    }
}

UNIT(saturation_is_a_flag) {
    bool lost = false;
    CHECK_EQ(canopy_narrow(INT32_MAX, &lost), INT32_MAX);
    CHECK_EQ(canopy_narrow(INT32_MIN, &lost), INT32_MIN);
    CHECK(!lost);
    CHECK_EQ(canopy_narrow((int64_t)INT32_MAX + 1, &lost), INT32_MAX);
    CHECK(lost);
    CHECK_EQ(canopy_narrow(0, &lost), 0);
    CHECK(lost);  // and it stays
    lost = false;
    CHECK_EQ(canopy_narrow((int64_t)INT32_MIN - 1, &lost), INT32_MIN);
    CHECK(lost);
}

UNIT(log2_is_exact) {
    CHECK_EQ(canopy_log2_ceil(0), 0);
    CHECK_EQ(canopy_log2_ceil(1), 0);
    for (unsigned k = 1; k < 62; k++) {
        CHECK_EQ(canopy_log2_ceil((uint64_t)1 << k), k);
        CHECK_EQ(canopy_log2_ceil(((uint64_t)1 << k) + 1), k + 1);
    }
}

enum { LARGEST = 24 };

// A system like those of the line fit: dominant diagonal, entries from a small generator, solution known.
struct system {
    int32_t a[LARGEST][5];
    int32_t x[LARGEST];
    int64_t value[LARGEST];  // in 1/1024
    size_t count;
};

static uint32_t next_random(uint32_t *state) {
    *state = *state * 1664525U + 1013904223U;
    return *state >> 8;
}

static struct system make_system(uint32_t seed, size_t count) {
    struct system s = {.count = count};
    for (size_t i = 0; i < count; i++) {
        s.x[i] = (int32_t)(next_random(&seed) % 2000001U) - 1000000;
        for (size_t c = 0; c < 5; c++) {
            const bool outside = i + c < 2 || i + c - 2 >= count;
            s.a[i][c] = outside ? 0 : (int32_t)(next_random(&seed) % 300U) - 150;  // 1/1024
        }
        s.a[i][2] = 700 + (int32_t)(next_random(&seed) % 300U);
    }
    for (size_t i = 0; i < count; i++) {
        for (size_t c = 0; c < 5; c++) {
            if (s.a[i][c] != 0) {
                s.value[i] += (int64_t)s.a[i][c] * s.x[i + c - 2];
            }
        }
    }
    return s;
}

UNIT(band_solves_in_float) {
    for (uint32_t seed = 1; seed <= 200; seed++) {
        const struct system s = make_system(seed, 1 + seed % LARGEST);
        struct canopy_band_row_f32 rows[LARGEST];
        for (size_t i = 0; i < s.count; i++) {
            for (size_t c = 0; c < 5; c++) {
                rows[i].a[c] = (float)s.a[i][c] / 1024.0f;
            }
            rows[i].value = (float)s.value[i] / 1024.0f;
        }
        CHECK(canopy_band_solve_f32(rows, s.count));
        for (size_t i = 0; i < s.count; i++) {
            CHECK_NEAR(rows[i].value, s.x[i], 8.0);
        }
    }
}

UNIT(band_solves_in_fixed_point) {
    for (uint32_t seed = 1; seed <= 200; seed++) {
        const struct system s = make_system(seed, 1 + seed % LARGEST);
        struct canopy_band_row_fx rows[LARGEST];
        for (size_t i = 0; i < s.count; i++) {
            for (size_t c = 0; c < 5; c++) {
                rows[i].a[c] = s.a[i][c] * (1 << 14);  // Q24
            }
            rows[i].value = (int32_t)(s.value[i] / 1024);
        }
        CHECK(canopy_band_solve_fx(rows, s.count));
        for (size_t i = 0; i < s.count; i++) {
            CHECK_NEAR(rows[i].value, s.x[i], 64.0);
        }
    }
}

UNIT(band_says_when_it_is_close_to_singular) {
    struct canopy_band_row_f32 f[2] = {{{0, 0, 0.5f, 0.5f, 0}, 1.0f}, {{0, 0.5f, 0.51f, 0, 0}, 1.0f}};
    CHECK(!canopy_band_solve_f32(f, 2));  // second pivot 0.01
    struct canopy_band_row_fx x[2] = {{{0, 0, 1 << 23, 1 << 23, 0}, 1000},
                                      {{0, 1 << 23, (1 << 23) + (1 << 17), 0, 0}, 9}};
    CHECK(!canopy_band_solve_fx(x, 2));
    struct canopy_band_row_f32 none[1] = {{{0}, 1.0f}};
    CHECK(!canopy_band_solve_f32(none, 1));
    struct canopy_band_row_fx nothing[1] = {{{0}, 1}};
    CHECK(!canopy_band_solve_fx(nothing, 1));
}

// -90 over a pivot of 0.05 is -1800, which 32 bits of Q24 would wrap to a harmless -8.
UNIT(band_says_when_an_entry_does_not_fit) {
    const int32_t one = 1 << 24, tenth = one / 10;
    struct canopy_band_row_f32 f[3] = {
        {{0, 0, 0.1f, 0, 3}, 1.0f}, {{0, 3, 0.05f, 0, 0}, 1.0f}, {{0, 0, 1, 0, 0}, 1.0f}};
    struct canopy_band_row_fx x[3] = {
        {{0, 0, tenth, 0, 3 * one}, 1}, {{0, 3 * one, tenth / 2, 0, 0}, 1}, {{0, 0, one, 0, 0}, 1}};
    CHECK(!canopy_band_solve_f32(f, 3));
    CHECK(!canopy_band_solve_fx(x, 3));
}

UNIT(band_says_when_a_value_does_not_fit) {
    struct canopy_band_row_fx rows[3];
    for (size_t i = 0; i < 3; i++) {
        rows[i] = (struct canopy_band_row_fx){{0, i > 0 ? -(3 << 23) : 0, 1 << 22, 0, 0}, 1 << 30};
    }
    CHECK(!canopy_band_solve_fx(rows, 3));
}

UNIT_LIST(num, shifts_round_their_way, divisions_round_their_way, divisions_without_a_sign_round_up,
          products_by_digits_are_exact, saturation_is_a_flag, log2_is_exact, band_solves_in_float,
          band_solves_in_fixed_point, band_says_when_it_is_close_to_singular, band_says_when_an_entry_does_not_fit,
          band_says_when_a_value_does_not_fit)
