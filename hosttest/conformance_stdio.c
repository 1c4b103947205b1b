// Orders for the conformance program on a platform that has no serial line: standard input and output.
#include <stdlib.h>
#include <unistd.h>

#include "hosttest/firmware/conformance.h"

static size_t read_orders(void *context, uint8_t *to, size_t length) {
    (void)context;
    const ssize_t count = read(STDIN_FILENO, to, length);
    if (count <= 0) {
        _exit(0);
    }
    return (size_t)count;
}

static size_t write_answer(void *context, const uint8_t *from, size_t length) {
    (void)context;
    const ssize_t count = write(STDOUT_FILENO, from, length);
    if (count < 0) {
        _exit(1);
    }
    return (size_t)count;
}

static bool is_sent(void *context) {
    (void)context;
    return true;
}

static uint32_t lost(void *context) {
    (void)context;
    return 0;
}

struct canopy_stream conformance_orders(const struct canopy_board *of) {
    (void)of;
    return (struct canopy_stream){.read = read_orders, .write = write_answer, .sent = is_sent, .lost = lost};
}
