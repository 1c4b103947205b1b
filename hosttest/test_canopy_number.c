// tools/common/number.c against the C library: the same double for every decimal, and the same end.

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tools/common/number.h"
#include "tools/common/option.h"

static uint64_t state = 7;

static unsigned draw(unsigned limit) {
    state = state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (unsigned)(state >> 33) % limit;
}

/// A decimal of up to `most` digits before and after the point, with or without sign, point and exponent.
static void write_decimal(char *to, unsigned most) {
    const unsigned before = draw(most), after = draw(most) + (before == 0);
    static const char *const SIGNS[] = {"", "-", "+"};
    to += sprintf(to, "%s", SIGNS[draw(3)]);
    for (unsigned i = 0; i < before; i++) {
        *to++ = (char)('0' + draw(draw(3) ? 10 : 1));
    }
    if (after > 0 || draw(2)) {
        *to++ = '.';
    }
    for (unsigned i = 0; i < after; i++) {
        *to++ = (char)('0' + draw(draw(3) ? 10 : 1));
    }
    *to = '\0';
    if (draw(2)) {
        sprintf(to, "%c%s%u", draw(2) ? 'e' : 'E', SIGNS[draw(3)], draw(draw(2) ? 30 : 400));
    }
}

static void same_as_strtod(void **unused) {
    (void)unused;
    unsigned large = 0;
    for (int i = 0; i < 300000; i++) {
        char text[200];
        write_decimal(text, i % 10 ? 12 : 45);
        const size_t length = strlen(text);
        strcpy(text + length, i % 3 == 0 ? "" : i % 3 == 1 ? " 7" : ",x");
        const char *end = NULL;
        double value = 0.0;
        const enum canopy_number what = canopy_number_read(text, &end, &value);
        const double expected = strtod(text, NULL);
        assert_ptr_equal(end, text + length);
        large += what == CANOPY_NUMBER_TOO_LARGE;
        if (isfinite(expected)) {
            assert_int_equal(what, CANOPY_NUMBER_OK);
            assert_memory_equal(&value, &expected, sizeof value);
        } else {
            assert_int_equal(what, CANOPY_NUMBER_TOO_LARGE);
        }
    }
    assert_true(large > 100);
}

static void what_is_no_number(void **unused) {
    (void)unused;
    static const struct {
        const char *text;
        enum canopy_number what;
        size_t length;
    } CASES[] = {
        {"", CANOPY_NUMBER_NONE, 0},
        {"x", CANOPY_NUMBER_NONE, 0},
        {"-", CANOPY_NUMBER_NONE, 0},
        {".", CANOPY_NUMBER_NONE, 0},
        {"e5", CANOPY_NUMBER_NONE, 0},
        {"+.e1", CANOPY_NUMBER_NONE, 0},
        {"nan", CANOPY_NUMBER_NOT_FINITE, 0},
        {"-NaN", CANOPY_NUMBER_NOT_FINITE, 0},
        {"inf", CANOPY_NUMBER_NOT_FINITE, 0},
        {"+Infinity", CANOPY_NUMBER_NOT_FINITE, 0},
        {" 1", CANOPY_NUMBER_NONE, 0},
        {"1e400", CANOPY_NUMBER_TOO_LARGE, 5},
        {"-1e400", CANOPY_NUMBER_TOO_LARGE, 6},
        {"1e", CANOPY_NUMBER_OK, 1},
        {"1e+", CANOPY_NUMBER_OK, 1},
        {"0x10", CANOPY_NUMBER_OK, 1},
        {"1_0", CANOPY_NUMBER_OK, 1},
        {"5.", CANOPY_NUMBER_OK, 2},
        {".5", CANOPY_NUMBER_OK, 2},
        {"1e99999999999", CANOPY_NUMBER_TOO_LARGE, 13},
        {"0e99999999999", CANOPY_NUMBER_OK, 13},
        {"1e-99999999999", CANOPY_NUMBER_OK, 14},
    };
    for (size_t i = 0; i < sizeof CASES / sizeof CASES[0]; i++) {
        const char *end = NULL;
        double value = 0.0;
        assert_int_equal(canopy_number_read(CASES[i].text, &end, &value), CASES[i].what);
        assert_int_equal(end - CASES[i].text, CASES[i].length);
    }
}

static void whole_numbers_are_whole(void **unused) {
    (void)unused;
    static const char *const NONE[] = {
        "", "x", "-1", "+1", " 1", "1 ", "1.0", "1e3", "18446744073709551616", "99999999999999999999999"};
    uint64_t value = 0;
    for (size_t i = 0; i < sizeof NONE / sizeof NONE[0]; i++) {
        assert_false(canopy_number_whole(NONE[i], 0, UINT64_MAX, &value));
    }
    assert_true(canopy_number_whole("18446744073709551615", 0, UINT64_MAX, &value) && value == UINT64_MAX);
    assert_true(canopy_number_whole("0007", 7, 7, &value) && value == 7);
    assert_false(canopy_number_whole("6", 7, 9, &value));
    assert_false(canopy_number_whole("10", 7, 9, &value));
    uint32_t narrow = 0;
    assert_true(canopy_number_whole32("4294967295", 0, UINT32_MAX, &narrow) && narrow == UINT32_MAX);
    assert_false(canopy_number_whole32("4294967296", 0, UINT32_MAX, &narrow));
}

static void positive_numbers_stand_alone(void **unused) {
    (void)unused;
    static const char *const NONE[] = {"", "0", "-1", "1 ", "nan", "inf", "1e400", "1x"};
    double value = 0.0;
    for (size_t i = 0; i < sizeof NONE / sizeof NONE[0]; i++) {
        assert_false(canopy_number_positive(NONE[i], &value));
    }
    assert_true(canopy_number_positive("2.5e-3", &value) && value == 2.5e-3);
}

static void grids_are_two_numbers(void **unused) {
    (void)unused;
    static const char *const NONE[] = {"", "4", "4x", "x4", "4x4x", "4X4", "4 x 4", "-4x4", "4x-4", "4294967296x4"};
    uint32_t size[2] = {0, 0};
    for (size_t i = 0; i < sizeof NONE / sizeof NONE[0]; i++) {
        assert_false(canopy_option_grid(NONE[i], size));
    }
    assert_true(canopy_option_grid("12x4294967295", size) && size[0] == 12 && size[1] == UINT32_MAX);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(same_as_strtod), cmocka_unit_test(what_is_no_number),
                                       cmocka_unit_test(whole_numbers_are_whole),
                                       cmocka_unit_test(positive_numbers_stand_alone),
                                       cmocka_unit_test(grids_are_two_numbers)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
