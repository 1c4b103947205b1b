#include "boards/linux/source.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "port/linux/clock.h"

// ---- A sweep in process

static bool sweep_fetch(void *context, const struct canopy_profile_request *request, uint16_t *registers,
                        enum canopy_scan_failure *failure) {
    struct canopy_sweep *sweep = context;
    *failure = CANOPY_SCAN_EXCEPTION;
    if (canopy_sweep_read(sweep, 0, request->address, request->count, registers, canopy_linux_now_us()) != 0) {
        return false;
    }
    canopy_sweep_offered(sweep, 0, false);
    return true;
}

static bool open_sweep(struct canopyd_source *source, const struct canopyd_scanner_url *url, double unit,
                       struct canopy_fault *fault) {
    const struct canopy_sweep_options options = {
        .profiles = url->profiles, .unit = unit, .rate_hz = url->rate_hz, .loop = url->loop, .sequence = 1};
    source->sweep = canopy_sweep_open(url->points, &options, fault);
    source->registers = (struct canopy_linux_registers){.context = source->sweep, .fetch = sweep_fetch};
    return source->sweep != NULL;
}

// ---- A device on Modbus

static bool device_fetch(void *context, const struct canopy_profile_request *request, uint16_t *registers,
                         enum canopy_scan_failure *failure) {
    return canopy_linux_modbus_fetch(context, request, registers, failure);
}

static uint64_t device_ready_us(void *context) { return canopy_linux_modbus_ready_us(context); }

static const char *device_why(void *context) {
    const struct canopy_linux_modbus_client *client = context;
    return client->why;
}

static bool open_device(struct canopyd_source *source, const struct canopyd_scanner_url *url, uint32_t timeout_us,
                        struct canopy_fault *fault) {
    const struct canopy_linux_modbus_config config = {.tcp = url->kind == CANOPYD_TCP_SCANNER,
                                                      .host = url->host,
                                                      .service = url->service,
                                                      .serial = url->serial,
                                                      .timeout_us = timeout_us};
    if (!config.tcp && access(config.serial.device, R_OK | W_OK) != 0) {
        return canopy_fault_set(fault, "%s: %s: give a serial line that can be read and written", config.serial.device,
                                strerror(errno));
    }
    source->registers = (struct canopy_linux_registers){
        .context = &source->modbus, .fetch = device_fetch, .ready_us = device_ready_us, .why = device_why};
    return canopy_linux_modbus_open(&source->modbus, &config) ||
           canopy_fault_set(fault, "--scanner %s: %s: check device and host", url->text, strerror(errno));
}

// ---- Both

static bool no_driver(const char *name, struct canopy_fault *fault) {
    char names[200] = "";
    const struct canopy_profile_table *table;
    for (unsigned i = 0; (table = canopy_profile_at(i)) != NULL; i++) {
        const size_t length = strlen(names);
        snprintf(names + length, sizeof names - length, "%s%s", i == 0 ? "" : ", ", table->name);
    }
    return canopy_fault_set(fault, "driver=%s: no such scanner is built in: give one of: %s", name, names);
}

bool canopyd_source_open(struct canopyd_source *source, const struct canopyd_scanner_url *url, double unit,
                         uint32_t timeout_us, struct canopy_fault *fault) {
    *source = (struct canopyd_source){.table = canopy_profile_find(url->driver)};
    if (source->table == NULL) {
        return no_driver(url->driver, fault);
    }
    return url->kind == CANOPYD_SIMULATED ? open_sweep(source, url, unit, fault)
                                          : open_device(source, url, timeout_us, fault);
}

void canopyd_source_close(struct canopyd_source *source) {
    canopy_sweep_close(source->sweep);
    source->sweep = NULL;
    canopy_linux_modbus_close(&source->modbus);
}
