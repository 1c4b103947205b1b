#include "port/template/flash.h"

static enum canopy_status read(void *context, uint32_t page, uint32_t offset, uint8_t *to, uint32_t length) {
    (void)context;
    (void)page;
    (void)offset;
    (void)to;
    (void)length;
    return CANOPY_UNSUPPORTED;
}

static enum canopy_status erase(void *context, uint32_t page) {
    (void)context;
    (void)page;
    return CANOPY_UNSUPPORTED;
}

static enum canopy_status program(void *context, uint32_t page, uint32_t offset, const uint8_t *from, uint32_t length) {
    (void)context;
    (void)page;
    (void)offset;
    (void)from;
    (void)length;
    return CANOPY_UNSUPPORTED;
}

struct canopy_flash canopy_no_flash(void) {
    return (struct canopy_flash){.read = read, .erase = erase, .program = program};
}
