// What the library takes for granted of a compiler and a processor, checked on each of them.
#include <float.h>
#include <limits.h>
#include <string.h>

#include "hosttest/unit/unit.h"
#include "lib/cover/envelope.h"
#include "lib/port.h"
#include "lib/status.h"

// Values the optimiser must not know.
static volatile int32_t minus_seven = -7;
static volatile float tenth = 0.1f;
static volatile float big = 16777216.0f;

UNIT(negative_numbers_shift_towards_minus_infinity) {
    CHECK_EQ(minus_seven >> 1, -4);
    CHECK_EQ((int64_t)minus_seven >> 40, -1);
    CHECK_EQ(minus_seven / 2, -3);
    CHECK_EQ(minus_seven % 2, -1);
}

UNIT(integers_are_twos_complement) {
    CHECK_EQ((uint32_t)minus_seven, 0xFFFFFFF9u);
    CHECK_EQ((int32_t)(0x80000000u + (uint32_t)(minus_seven + 7)), INT32_MIN);
    CHECK_EQ(CHAR_BIT, 8);
}

// A float that is kept in a wider register voids the error bounds of the float path.
UNIT(floats_round_after_each_operation) {
    CHECK_EQ(FLT_EVAL_METHOD, 0);
    const float sum = big + 1.0f;
    CHECK(sum == 16777216.0f);
    const float back = (big + 3.0f) - big;
    CHECK(back == 4.0f);
}

// A contracted a * b + c would round once and leave the rest of the product.
UNIT(products_round_before_they_are_added) {
    const float product = tenth * tenth;
    CHECK(tenth * tenth - product == 0.0f);
}

UNIT(subnormal_floats_are_kept) {
    volatile float smallest = FLT_MIN;
    CHECK(smallest / 2.0f > 0.0f);
    CHECK(smallest / 2.0f + smallest / 2.0f == smallest);
}

UNIT(wide_products_are_whole) {
    volatile int32_t a = INT32_MIN, b = INT32_MAX;
    CHECK_EQ((int64_t)a * b, -4611686016279904256);
    CHECK_EQ((int64_t)a * a, 4611686018427387904);
}

enum { BYTES = 48 };

static void count_up(uint8_t *bytes) {
    for (unsigned i = 0; i < BYTES; i++) {
        bytes[i] = (uint8_t)(i + 1);
    }
}

// On firmware these are port/common/bytes.c's: every place on a word, every length around one.
UNIT(bytes_are_set_copied_and_compared) {
    _Alignas(8) uint8_t from[BYTES], to[BYTES];
    for (size_t at = 0; at < 8; at++) {
        for (size_t next = 0; next < 8; next++) {
            for (size_t length = 0; length < 20; length++) {
                count_up(from);
                memset(to, 0x5A, sizeof to);
                memcpy(to + at, from + next, length);
                unsigned wrong = 0;
                for (size_t i = 0; i < BYTES; i++) {
                    wrong += to[i] != (i >= at && i < at + length ? from[next + i - at] : 0x5A);
                }
                CHECK(memcmp(to + at, from + next, length) == 0);
                memset(to + at, 0xC3, length);
                for (size_t i = 0; i < BYTES; i++) {
                    wrong += to[i] != (i >= at && i < at + length ? 0xC3 : 0x5A);
                }
                memmove(from + at, from + next, length);  // over each other, either way
                for (size_t i = 0; i < BYTES; i++) {
                    wrong += from[i] != (i >= at && i < at + length ? next + i - at : i) + 1;
                }
                CHECK_EQ(wrong, 0);
            }
        }
    }
    count_up(from);
    memcpy(to, from, BYTES);
    to[13] = 0x80;
    CHECK(memcmp(to, from, BYTES) > 0 && memcmp(from, to, BYTES) < 0 && memcmp(from, to, 13) == 0);
}

UNIT(coverage_has_a_bit_for_each_knot_cell) {
    CHECK_EQ(CANOPY_COVERAGE_BYTES(4, 4), 2);
    CHECK_EQ(CANOPY_COVERAGE_BYTES(5, 5), 2);
    CHECK_EQ(CANOPY_COVERAGE_BYTES(20, 20), 46);
    CHECK_EQ(CANOPY_COEFFICIENTS(20, 20), 400);
}

UNIT_LIST(platform, negative_numbers_shift_towards_minus_infinity, integers_are_twos_complement,
          floats_round_after_each_operation, products_round_before_they_are_added, subnormal_floats_are_kept,
          wide_products_are_whole, bytes_are_set_copied_and_compared, coverage_has_a_bit_for_each_knot_cell)
