// Host runner: the list as a cmocka group. CMOCKA_MESSAGE_OUTPUT=TAP gives what hosttest/run reads.
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#include <cmocka.h>

#include "hosttest/unit/unit.h"

_Noreturn void unit_fail(const char *file, int line, const char *what) {
    printf("# %s:%d: %s\n", file, line, what);
    _fail(file, line);
    abort();  // not reached: _fail jumps back to the group
}

_Noreturn void unit_fail_integers(const char *file, int line, const char *what, int64_t left, int64_t right) {
    printf("# %s:%d: %lld is not %lld\n", file, line, (long long)left, (long long)right);
    unit_fail(file, line, what);
}

_Noreturn void unit_fail_numbers(const char *file, int line, const char *what, double left, double right) {
    printf("# %s:%d: %.17g is not near %.17g\n", file, line, left, right);
    unit_fail(file, line, what);
}

static void run(void **state) {
    const struct unit_test *test = *state;
    test->run();
}

int main(void) {
    struct CMUnitTest *group = calloc(unit_list.count, sizeof *group);
    if (group == NULL)
        return 1;
    for (size_t i = 0; i < unit_list.count; i++) {
        // cmocka hands the initial state on without writing to it, so the const may go.
        union {
            const void *from;
            void *to;
        } state = {.from = &unit_list.tests[i]};
        group[i] = (struct CMUnitTest){.name = unit_list.tests[i].name, .test_func = run, .initial_state = state.to};
    }
    const int failed = _cmocka_run_group_tests(unit_list.name, group, unit_list.count, NULL, NULL);
    free(group);
    return failed == 0 ? 0 : 1;
}
