// Passes over files with several threads: what comes out does not depend on how many there are, the first bad line of
// the file is the one that is told, and a file that changes between two passes is noticed.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "tools/common/flow.h"
#include "tools/common/load.h"
#include "tools/common/points.h"
#include "tools/common/random.h"
#include "tools/common/supply.h"

static const unsigned THREADS[] = {1, 2, 3, 8};
#define EACH_THREADS(t) for (size_t t##_ = 0, t = 1; t##_ < 4 && (t = THREADS[t##_], true); t##_++)

static char path[64];

static FILE *create(const char *ending) {
    snprintf(path, sizeof path, "/tmp/canopy-supply-%ld%s", (long)getpid(), ending);
    FILE *file = fopen(path, "wb");
    assert_non_null(file);
    return file;
}

// Lines of many lengths, comments and blanks among them; `bad` holds the numbers of lines that are none.
static void write_lines(unsigned lines, const unsigned *bad, size_t bad_count, uint64_t seed) {
    uint64_t state = seed;
    FILE *file = create(".xyz");
    for (unsigned line = 1; line <= lines; line++) {
        bool is_bad = false;
        for (size_t i = 0; i < bad_count; i++)
            is_bad = is_bad || bad[i] == line;
        const double x = canopy_random_unit(&state) * 100, y = canopy_random_unit(&state), z = sin(x) * y;
        if (is_bad)
            fprintf(file, "%.9g five %u\n", x, line);
        else if (line % 97 == 0)
            fprintf(file, "# %*s\n", (int)(x * 3), "");
        else if (line % 89 == 0)
            fprintf(file, "\r\n");
        else
            fprintf(file, "%.*g\t%.6f %.17g 1 2 3%s", 3 + (int)(x / 10), x, y, z, line < lines ? "\n" : "");
    }
    assert_int_equal(fclose(file), 0);
}

// ---------------------------------------------------------------------------------------------------------------------
// The order of the file

struct seen {
    uint64_t count, place, marks;
    bool ordered;
};

static bool sum_places(void *context, unsigned thread, struct canopy_batch *batch, size_t *bad,
                       struct canopy_fault *fault) {
    (void)context, (void)thread, (void)bad, (void)fault;
    uint64_t sum = *(uint64_t *)batch->result;  // zero, as is promised
    for (size_t i = 0; i < batch->count; i++)
        sum += batch->where[i];
    *(uint64_t *)batch->result = sum;
    return true;
}

static bool see(void *context, struct canopy_batch *batch, struct canopy_fault *fault) {
    struct seen *seen = context;
    (void)fault;
    uint64_t sum = 0;
    for (size_t i = 0; i < batch->count; i++) {
        const uint64_t place = batch->before + batch->where[i];
        seen->ordered = seen->ordered && place > seen->place;
        seen->place = place;
        sum += batch->where[i];
        uint64_t bits;
        for (int k = 0; k < 3; k++) {
            memcpy(&bits, &batch->raw[i][k], sizeof bits);
            seen->marks = (seen->marks ^ bits) * UINT64_C(1099511628211);
        }
    }
    seen->ordered = seen->ordered && sum == *(uint64_t *)batch->result;
    seen->count += batch->count;
    return true;
}

static bool see_one(void *context, const double point[3], uint64_t where, struct canopy_fault *fault) {
    const double(*raw)[3] = (const double(*)[3])(uintptr_t)point;
    uint64_t result = where;
    return see(context, &(struct canopy_batch){.count = 1, .raw = raw, .where = &where, .result = &result}, fault);
}

static void test_points_come_in_the_order_of_the_file(void **state) {
    (void)state;
    write_lines(150000, NULL, 0, 7);
    struct seen want = {.ordered = true};
    struct canopy_points_info info, expected;
    struct canopy_fault fault;
    assert_true(canopy_points_read(path, (struct canopy_points_sink){&want, see_one}, &expected, &fault));
    EACH_THREADS(threads) {
        struct seen seen = {.ordered = true};
        const struct canopy_flow flow = {.stage = "",
                                         .threads = (unsigned)threads,
                                         .result_size = sizeof(uint64_t),
                                         .context = &seen,
                                         .work = sum_places,
                                         .gather = see};
        assert_true(canopy_flow_file(path, &flow, &info, &fault));
        assert_true(seen.ordered && seen.count == expected.count && info.count == expected.count);
        assert_true(seen.marks == want.marks && seen.place == want.place);
    }
    unlink(path);
}

// ---------------------------------------------------------------------------------------------------------------------
// The first fault

static void expect_fault(const char *want, const struct canopy_load_wish *wish) {
    EACH_THREADS(threads) {
        struct canopy_load_wish own = *wish;
        struct canopy_loaded loaded;
        struct canopy_fault fault = {""};
        own.threads = (unsigned)threads;
        assert_false(canopy_load(path, &own, &loaded, &fault));
        assert_string_equal(fault.text, want);
    }
}

static void test_the_first_bad_line_is_told(void **state) {
    (void)state;
    uint64_t random = 3;
    for (unsigned round = 0; round < 12; round++) {
        unsigned bad[5];
        for (size_t i = 0; i < 5; i++)
            bad[i] = 1 + (unsigned)(canopy_random_unit(&random) * 150000);
        write_lines(150000, bad, 5, round);
        struct seen seen = {.ordered = true};
        struct canopy_points_info info;
        struct canopy_fault fault;
        assert_false(canopy_points_read(path, (struct canopy_points_sink){&seen, see_one}, &info, &fault));
        assert_non_null(strstr(fault.text, "'five' in column 2"));
        expect_fault(fault.text, &(struct canopy_load_wish){.scalar = CANOPY_F32, .unit = 1});
        expect_fault(fault.text, &(struct canopy_load_wish){.scalar = CANOPY_FX, .most = 1});
    }
    unlink(path);
}

// A point that no device has, before and behind a line that is none.
static void test_a_point_that_overflows_is_told_in_its_turn(void **state) {
    (void)state;
    for (int first = 0; first < 2; first++) {
        FILE *file = create(".xyz");
        for (unsigned line = 1; line <= 100000; line++) {
            if (line == (first ? 40000U : 40001U))
                fprintf(file, "1 1e30 2\n");
            else if (line == (first ? 40001U : 40000U))
                fprintf(file, "1 2\n");
            else
                fprintf(file, "1 %u 3\n", line);
        }
        fclose(file);
        char want[200];
        snprintf(want, sizeof want,
                 first ? "%s:40000: 1e+30 overflows 32-bit fixed point at unit 1: choose a larger --unit or move the "
                         "origin"
                       : "%s:40000: 2 columns: give x, y and z on every line",
                 path);
        expect_fault(want, &(struct canopy_load_wish){.scalar = CANOPY_FX, .unit = 1});
        expect_fault(want, &(struct canopy_load_wish){.scalar = CANOPY_FX, .unit = 1, .most = 1});
    }
    unlink(path);
}

// ---------------------------------------------------------------------------------------------------------------------
// What is known of a file, and that it is still so

static bool nothing(void *context, struct canopy_batch *batch, struct canopy_fault *fault) {
    (void)fault;
    *(uint64_t *)context += batch->count;
    return true;
}

static void test_a_supply_is_the_same_however_it_is_read(void **state) {
    (void)state;
    write_lines(120000, NULL, 0, 11);
    struct canopy_fault fault;
    for (int scalar = 0; scalar < 2; scalar++) {
        struct canopy_loaded want;
        assert_true(canopy_load(path, &(struct canopy_load_wish){.scalar = (enum canopy_scalar)scalar}, &want, &fault));
        EACH_THREADS(threads) {
            struct canopy_loaded got;
            const struct canopy_load_wish wish = {
                .scalar = (enum canopy_scalar)scalar, .most = 1, .threads = (unsigned)threads};
            assert_true(canopy_load(path, &wish, &got, &fault));
            assert_false(canopy_supply_is_held(&got.supply));
            assert_true(got.unit == want.unit && got.loss == want.loss && got.supply.count == want.list.count);
            assert_memory_equal(&got.supply.low, &want.supply.low, 12);
            assert_memory_equal(&got.supply.high, &want.supply.high, 12);
            assert_true(canopy_supply_hold(&got.supply, &fault));
            assert_memory_equal(got.supply.list.points, want.list.points, want.list.count * 12);
            canopy_supply_free(&got.supply);
        }
        canopy_device_list_free(&want.list);
    }
    unlink(path);
}

static void expect_changed(struct canopy_supply *supply) {
    struct canopy_fault fault;
    uint64_t count = 0;
    const struct canopy_flow flow = {.stage = "", .context = &count, .gather = nothing};
    assert_false(canopy_supply_pass(supply, &flow, &fault));
    assert_non_null(strstr(fault.text, "changed while it was read"));
    assert_non_null(strstr(fault.text, path));
}

static void test_a_file_that_changes_is_noticed(void **state) {
    (void)state;
    write_lines(50000, NULL, 0, 5);
    struct canopy_loaded loaded;
    struct canopy_fault fault;
    uint64_t count = 0;
    const struct canopy_flow flow = {.stage = "", .context = &count, .gather = nothing};
    assert_true(
        canopy_load(path, &(struct canopy_load_wish){.scalar = CANOPY_F32, .most = 1, .threads = 2}, &loaded, &fault));
    assert_true(canopy_supply_pass(&loaded.supply, &flow, &fault) && count == loaded.supply.count);
    FILE *file = fopen(path, "r+b");
    assert_non_null(file);
    fseek(file, 1000, SEEK_SET);
    int digit = 0;
    while (digit < '1' || digit > '8')
        digit = fgetc(file);
    fseek(file, -1, SEEK_CUR);
    fputc(digit + 1, file);
    fclose(file);
    expect_changed(&loaded.supply);
    write_lines(50001, NULL, 0, 5);
    expect_changed(&loaded.supply);
    write_lines(50000, NULL, 0, 5);
    assert_true(canopy_supply_pass(&loaded.supply, &flow, &fault));
    unlink(path);
}

// ---------------------------------------------------------------------------------------------------------------------
// Verdicts of parts

static void test_verdicts_of_parts_are_the_verdict_of_all(void **state) {
    (void)state;
    double coefficients[16] = {0, 1, 2, 3, 1, 5, 3, 2, 2, 0, 1, 4, 1, 2, 1, 0};
    const struct canopy_surrogate surrogate = {.side = CANOPY_ABOVE,
                                               .scalar = CANOPY_F32,
                                               .unit = 1,
                                               .axes = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}},
                                               .pitch = {1, 1},
                                               .size = {4, 4},
                                               .coefficients = coefficients,
                                               .lsb = 1};
    struct canopy_device_list list = {.scalar = CANOPY_F32};
    uint64_t random = 2;
    for (int i = 0; i < 100000; i++) {
        const union canopy_device_point p = {.f32 = {(float)(canopy_random_unit(&random) * 3.0001),
                                                     (float)(canopy_random_unit(&random) * 3.0001),
                                                     (float)(canopy_random_unit(&random) * 2.0)}};
        assert_true(canopy_device_list_add(&list, &p));
    }
    const struct canopy_cloud cloud = canopy_device_list_cloud(&list);
    struct canopy_exact_result want, got;
    uint8_t covered[2][9] = {{0}};
    struct canopy_fault fault;
    assert_true(canopy_exact_check(&surrogate, &cloud, &want));
    assert_true(want.wrong > 1000 && want.outside > 0);
    EACH_THREADS(threads) {
        struct canopy_supply supply = canopy_supply_of(&list);
        supply.threads = (unsigned)threads;
        assert_true(canopy_supply_check(&supply, &surrogate, covered[0], &got, &fault));
        assert_true(got.points == want.points && got.wrong == want.wrong && got.outside == want.outside);
        assert_true(got.first_wrong == want.first_wrong && got.first_outside == want.first_outside);
        assert_true(got.margin == want.margin && got.gap_max == want.gap_max);
        assert_true(got.height_min == want.height_min && got.height_max == want.height_max);
        assert_true(fabs(got.gap_sum - want.gap_sum) < 1e-9 * 100000);
    }
    struct canopy_exact *exact = canopy_exact_open(&surrogate);
    canopy_exact_coverage(exact, &cloud, covered[1]);
    canopy_exact_close(exact);
    assert_memory_equal(covered[0], covered[1], 9);
    canopy_device_list_free(&list);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_points_come_in_the_order_of_the_file),
        cmocka_unit_test(test_the_first_bad_line_is_told),
        cmocka_unit_test(test_a_point_that_overflows_is_told_in_its_turn),
        cmocka_unit_test(test_a_supply_is_the_same_however_it_is_read),
        cmocka_unit_test(test_a_file_that_changes_is_noticed),
        cmocka_unit_test(test_verdicts_of_parts_are_the_verdict_of_all),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
