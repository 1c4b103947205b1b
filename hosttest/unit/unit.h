/// Unit tests that run on the host and on the device from one text.
///
/// A file hosttest/unit/test_<room>.c has tests and, at its end, one list named after the room:
///
///     #include "hosttest/unit/unit.h"
///     UNIT(adds) { CHECK_EQ(1 + 1, 2); }
///     UNIT(is_near) { CHECK_NEAR(0.1 + 0.2, 0.3, 1e-12); }
///     UNIT_LIST(arithmetic, adds, is_near)
///
/// Each file becomes one program for every host variant and one firmware image; a runner that is linked to it walks
/// the list (run_cmocka.c, run_plain.c, run_firmware.c). A failed check ends its test, also from inside a function
/// that the test called, and the next test starts. Tests use no libc I/O and at most 8 KB of static memory each.
#ifndef CANOPY_HOSTTEST_UNIT_H
#define CANOPY_HOSTTEST_UNIT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

struct unit_test {
    const char *name;
    void (*run)(void);
};

struct unit_list {
    const char *name;
    const struct unit_test *tests;
    size_t count;
};

/// The list of the program; UNIT_LIST defines it.
extern const struct unit_list unit_list;

/// Ends the running test as failed. Runners define it; the checks below call it.
_Noreturn void unit_fail(const char *file, int line, const char *what);
_Noreturn void unit_fail_integers(const char *file, int line, const char *what, int64_t left, int64_t right);
_Noreturn void unit_fail_numbers(const char *file, int line, const char *what, double left, double right);

static inline void unit_check_integers(const char *file, int line, const char *what, int64_t left, int64_t right) {
    if (left != right)
        unit_fail_integers(file, line, what, left, right);
}

static inline void unit_check_near(const char *file, int line, const char *what, double left, double right,
                                   double tolerance) {
    const double difference = left < right ? right - left : left - right;
    if (!(difference <= tolerance))  // not >, so that a NaN fails
        unit_fail_numbers(file, line, what, left, right);
}

#define UNIT(test) static void unit_##test(void)

#define CHECK(condition) ((condition) ? (void)0 : unit_fail(__FILE__, __LINE__, #condition))

/// Integers, booleans and enumerations of any width.
#define CHECK_EQ(left, right)                                                                                          \
    unit_check_integers(__FILE__, __LINE__, #left " == " #right, (int64_t)(left), (int64_t)(right))

/// Floating point: |left - right| <= tolerance. A NaN anywhere fails.
#define CHECK_NEAR(left, right, tolerance)                                                                             \
    unit_check_near(__FILE__, __LINE__, #left " ~ " #right, (double)(left), (double)(right), (double)(tolerance))

/// `length` bytes at `left` and `right` are equal.
#define CHECK_BYTES(left, right, length)                                                                               \
    (memcmp((left), (right), (length)) == 0 ? (void)0                                                                  \
                                            : unit_fail(__FILE__, __LINE__, #left " has the bytes of " #right))

// Maps each name to { "name", unit_name }: UNIT_EACH asks to be scanned again until no name is left, up to 256 times.
#define UNIT_PARENTHESES ()
#define UNIT_SCAN_1(...) __VA_ARGS__
#define UNIT_SCAN_4(...) UNIT_SCAN_1(UNIT_SCAN_1(UNIT_SCAN_1(UNIT_SCAN_1(__VA_ARGS__))))
#define UNIT_SCAN_16(...) UNIT_SCAN_4(UNIT_SCAN_4(UNIT_SCAN_4(UNIT_SCAN_4(__VA_ARGS__))))
#define UNIT_SCAN_64(...) UNIT_SCAN_16(UNIT_SCAN_16(UNIT_SCAN_16(UNIT_SCAN_16(__VA_ARGS__))))
#define UNIT_SCAN(...) UNIT_SCAN_64(UNIT_SCAN_64(UNIT_SCAN_64(UNIT_SCAN_64(__VA_ARGS__))))
#define UNIT_AGAIN() UNIT_EACH
#define UNIT_EACH(test, ...) {#test, unit_##test}, __VA_OPT__(UNIT_AGAIN UNIT_PARENTHESES(__VA_ARGS__))

/// Ends a file: the name of its list, then its tests in the order in which they run.
#define UNIT_LIST(list, ...)                                                                                           \
    static const struct unit_test unit_tests[] = {UNIT_SCAN(UNIT_EACH(__VA_ARGS__))};                                  \
    const struct unit_list unit_list = {#list, unit_tests, sizeof unit_tests / sizeof unit_tests[0]};

#endif
