// Host runner without cmocka, for the 32-bit variants (Debian has cmocka for one word size at a time). Prints TAP.
#include <setjmp.h>
#include <stdio.h>

#include "hosttest/unit/unit.h"

static jmp_buf failed;

_Noreturn void unit_fail(const char *file, int line, const char *what) {
    printf("# %s:%d: %s\n", file, line, what);
    longjmp(failed, 1);
}

_Noreturn void unit_fail_integers(const char *file, int line, const char *what, int64_t left, int64_t right) {
    printf("# %s:%d: %lld is not %lld\n", file, line, (long long)left, (long long)right);
    unit_fail(file, line, what);
}

_Noreturn void unit_fail_numbers(const char *file, int line, const char *what, double left, double right) {
    printf("# %s:%d: %.17g is not near %.17g\n", file, line, left, right);
    unit_fail(file, line, what);
}

static bool passes(const struct unit_test *test) {
    if (setjmp(failed) != 0)
        return false;
    test->run();
    return true;
}

int main(void) {
    size_t failures = 0;
    printf("1..%zu\n", unit_list.count);
    for (size_t i = 0; i < unit_list.count; i++) {
        const bool passed = passes(&unit_list.tests[i]);
        failures += passed ? 0 : 1;
        printf("%s %zu - %s\n", passed ? "ok" : "not ok", i + 1, unit_list.tests[i].name);
        fflush(stdout);
    }
    return failures == 0 ? 0 : 1;
}
