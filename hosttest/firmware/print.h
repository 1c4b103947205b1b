/// Text on the board's console, by polling, for images that only an emulator runs.
#ifndef CANOPY_HOSTTEST_FIRMWARE_PRINT_H
#define CANOPY_HOSTTEST_FIRMWARE_PRINT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "port/board.h"

static inline void print_text(const char *text) {
    while (*text != '\0')
        canopy_board_put(*text++);
}

static inline void print_number(int64_t value) {
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
    print_text(&digits[at]);
}

/// A line `name value`: what hosttest/bench_firmware.py collects.
static inline void print_result(const char *name, int64_t value) {
    print_text(name);
    print_text(" ");
    print_number(value);
    print_text("\n");
}

/// Ends the image as failed, saying what went wrong, unless all is well.
static inline void print_must(bool good, const char *what) {
    if (!good) {
        print_text(what);
        print_text("\n");
        canopy_board_exit(false);
    }
}

#endif
