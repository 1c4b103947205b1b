// Firmware runner: prints TAP on the console and ends the emulator. A fault is a failed test and the end of the list.
#include <setjmp.h>

#include "hosttest/unit/unit.h"
#include "port/cortexm/fault.h"
#include "port/cortexm/semihosting.h"

static jmp_buf failed;

static void put_text(const char *text) {
    while (*text != '\0')
        canopy_fault_put(*text++);
}

static void put_number(int64_t value) {
    char digits[24];
    size_t at = sizeof digits;
    uint64_t rest = value < 0 ? 0u - (uint64_t)value : (uint64_t)value;
    digits[--at] = '\0';
    do {
        digits[--at] = (char)('0' + rest % 10u);
        rest /= 10u;
    } while (rest != 0);
    if (value < 0)
        digits[--at] = '-';
    put_text(&digits[at]);
}

static void put_place(const char *file, int line) {
    put_text("# ");
    put_text(file);
    put_text(":");
    put_number(line);
    put_text(": ");
}

_Noreturn void unit_fail(const char *file, int line, const char *what) {
    put_place(file, line);
    put_text(what);
    put_text("\n");
    longjmp(failed, 1);
}

_Noreturn void unit_fail_integers(const char *file, int line, const char *what, int64_t left, int64_t right) {
    put_place(file, line);
    put_number(left);
    put_text(" is not ");
    put_number(right);
    put_text("\n");
    unit_fail(file, line, what);
}

// Numbers are shown in millionths: enough to see what is wrong, and no formatted output is linked.
static void put_millionths(double value) {
    if (value > 9e12 || value < -9e12 || value != value)
        put_text("(out of range)");
    else {
        put_number((int64_t)(value * 1e6));
        put_text("e-6");
    }
}

_Noreturn void unit_fail_numbers(const char *file, int line, const char *what, double left, double right) {
    put_place(file, line);
    put_millionths(left);
    put_text(" is not near ");
    put_millionths(right);
    put_text("\n");
    unit_fail(file, line, what);
}

_Noreturn void canopy_fault_end(void) { canopy_semihosting_exit(false); }

static bool passes(const struct unit_test *test) {
    if (setjmp(failed) != 0)
        return false;
    test->run();
    return true;
}

int main(void) {
    size_t failures = 0;
    put_text("1..");
    put_number((int64_t)unit_list.count);
    put_text("\n");
    for (size_t i = 0; i < unit_list.count; i++) {
        const bool passed = passes(&unit_list.tests[i]);
        failures += passed ? 0 : 1;
        put_text(passed ? "ok " : "not ok ");
        put_number((int64_t)i + 1);
        put_text(" - ");
        put_text(unit_list.tests[i].name);
        put_text("\n");
    }
    canopy_semihosting_exit(failures == 0);
}
