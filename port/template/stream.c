#include "port/template/stream.h"

static size_t read(void *context, uint8_t *to, size_t length) {
    (void)context;
    (void)to;
    (void)length;
    return 0;
}

static size_t write(void *context, const uint8_t *from, size_t length) {
    (void)context;
    (void)from;
    (void)length;
    return 0;
}

static bool sent(void *context) {
    (void)context;
    return true;
}

static uint32_t lost(void *context) {
    (void)context;
    return 0;
}

struct canopy_stream canopy_no_stream(void) {
    return (struct canopy_stream){.read = read, .write = write, .sent = sent, .lost = lost};
}
