#include "port/template/i2c.h"

static bool start(void *context, const struct canopy_i2c_transfer *transfer, uint32_t timeout_us) {
    (void)context;
    (void)transfer;
    (void)timeout_us;
    return true;  // begun, and over: poll says how
}

static enum canopy_i2c_outcome poll(void *context) {
    (void)context;
    return CANOPY_I2C_UNSUPPORTED;
}

static uint32_t recoveries(void *context) {
    (void)context;
    return 0;
}

struct canopy_i2c canopy_no_i2c(void) {
    return (struct canopy_i2c){
        .context = NULL, .max_transfer = 0, .start = start, .poll = poll, .recoveries = recoveries};
}
