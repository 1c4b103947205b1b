// Firmware runner: prints TAP on the console and ends the emulator. A fault is a failed test and the end of the list.
#include <setjmp.h>

#include "hosttest/firmware/print.h"
#include "hosttest/unit/unit.h"
#include "port/board.h"

static jmp_buf failed;

static void put_place(const char *file, int line) {
    print_text("# ");
    print_text(file);
    print_text(":");
    print_number(line);
    print_text(": ");
}

_Noreturn void unit_fail(const char *file, int line, const char *what) {
    put_place(file, line);
    print_text(what);
    print_text("\n");
    longjmp(failed, 1);
}

_Noreturn void unit_fail_integers(const char *file, int line, const char *what, int64_t left, int64_t right) {
    put_place(file, line);
    print_number(left);
    print_text(" is not ");
    print_number(right);
    print_text("\n");
    unit_fail(file, line, what);
}

// Numbers are shown in millionths: enough to see what is wrong, and no formatted output is linked.
static void put_millionths(double value) {
    if (value > 9e12 || value < -9e12 || value != value)
        print_text("(out of range)");
    else {
        print_number((int64_t)(value * 1e6));
        print_text("e-6");
    }
}

_Noreturn void unit_fail_numbers(const char *file, int line, const char *what, double left, double right) {
    put_place(file, line);
    put_millionths(left);
    print_text(" is not near ");
    put_millionths(right);
    print_text("\n");
    unit_fail(file, line, what);
}

_Noreturn void canopy_crash_end(void) { canopy_board_exit(false); }

static bool passes(const struct unit_test *test) {
    if (setjmp(failed) != 0)
        return false;
    test->run();
    return true;
}

int main(void) {
    size_t failures = 0;
    print_text("1..");
    print_number((int64_t)unit_list.count);
    print_text("\n");
    for (size_t i = 0; i < unit_list.count; i++) {
        const bool passed = passes(&unit_list.tests[i]);
        failures += passed ? 0 : 1;
        print_text(passed ? "ok " : "not ok ");
        print_number((int64_t)i + 1);
        print_text(" - ");
        print_text(unit_list.tests[i].name);
        print_text("\n");
    }
    canopy_board_exit(failures == 0);
}
