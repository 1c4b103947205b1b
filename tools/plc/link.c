#include "tools/plc/link.h"

#include <stdio.h>
#include <string.h>
#include <time.h>

#include "port/linux/clock.h"

volatile sig_atomic_t plc_ended;

uint64_t plc_now_ms(void) { return canopy_linux_now_us() / 1000; }

void plc_sleep_ms(uint32_t ms) {
    const uint64_t end_ms = plc_now_ms() + ms;
    for (uint64_t now_ms = plc_now_ms(); now_ms < end_ms && !plc_ended; now_ms = plc_now_ms()) {
        const uint64_t rest_ms = end_ms - now_ms < 50 ? end_ms - now_ms : 50;
        const struct timespec rest = {0, (long)rest_ms * 1000000};
        nanosleep(&rest, NULL);
    }
}

bool plc_link_open(struct plc_link *link, const char *url, const struct plc_link_options *options,
                   struct canopy_fault *fault) {
    memset(link, 0, sizeof *link);
    link->options = *options;
    link->function = 3;
    if (!canopy_wire_url_parse(url, &link->url, fault))
        return false;
    const struct canopy_wire_line *line = &link->url.line;
    if (!link->url.tcp && !canopy_linux_baud_known(line->baud))
        return canopy_fault_set(fault, "%s: %u baud is no standard rate", url, line->baud);
    const struct canopy_linux_modbus_config config = {
        .tcp = link->url.tcp,
        .host = link->url.address.host,
        .service = link->url.address.port,
        .serial = {.device = line->path, .baud = line->baud, .parity = line->parity, .stop_bits = line->stop_bits},
        .timeout_us = options->timeout_ms * 1000};
    return canopy_linux_modbus_open(&link->client, &config) ||
           canopy_fault_set(fault, "%s: libmodbus refuses this device", url);
}

void plc_link_close(struct plc_link *link) { canopy_linux_modbus_close(&link->client); }

static const char *name_of(const struct plc_link *link) {
    return link->url.tcp ? link->url.address.host : link->url.line.path;
}

// After a failure: until whatever still was on its way is through, or a new connection may be tried.
static void stand_back(struct plc_link *link) {
    plc_sleep_ms(link->url.tcp ? 20 : 2 * link->options.timeout_ms);
    const uint64_t ready_us = canopy_linux_modbus_ready_us(&link->client), now_us = canopy_linux_now_us();
    if (ready_us > now_us)
        plc_sleep_ms((uint32_t)((ready_us - now_us) / 1000 + 1));
}

bool plc_link_read(struct plc_link *link, uint16_t address, uint16_t count, uint16_t *to, struct canopy_fault *fault) {
    link->function = link->function == 3 ? 4 : 3;
    const struct canopy_profile_request request = {.unit = link->url.tcp ? link->url.address.unit : link->url.line.unit,
                                                   .function = link->function,
                                                   .address = address,
                                                   .count = count};
    enum canopy_scan_failure failure = CANOPY_SCAN_TIMEOUT;
    for (unsigned attempt = 0; attempt <= link->options.retries && !plc_ended; attempt++) {
        if (!link->url.tcp)
            plc_sleep_ms(link->options.gap_ms);
        link->requests++;
        if (canopy_linux_modbus_fetch(&link->client, &request, to, &failure))
            return true;
        link->failures++;
        if (failure == CANOPY_SCAN_EXCEPTION)
            return canopy_fault_set(fault, "%s: registers %u to %u: %s", name_of(link), address, address + count - 1u,
                                    link->client.why);
        stand_back(link);
    }
    if (plc_ended)
        return canopy_fault_set(fault, "%s: interrupted", name_of(link));
    return canopy_fault_set(fault, "%s: no answer to a read of %u registers at %u: %s", name_of(link), count, address,
                            link->client.why);
}
