// canopy-plc: what a PLC does with a canopy device, as a program: reads status and envelope through libmodbus.

#include <argp.h>
#include <inttypes.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lib/version.h"
#include "tools/common/option.h"
#include "tools/common/surrogate.h"
#include "tools/plc/device.h"
#include "tools/plc/report.h"

enum { EXIT_OK = 0, EXIT_LATE = 1, EXIT_INPUT = 2, EXIT_USAGE = 64 };

struct arguments {
    const char *url, *map, *out;
    enum command { NO_COMMAND, READ, STATUS, WATCH } command;
    uint64_t until_points;
    double timeout_s, interval_s;
    uint64_t count;  // lines of watch; 0: no end
    bool json, any;
    struct plc_link_options link;
    struct canopy_fault fault;
};

enum key {
    KEY_MAP = 0x100,
    KEY_UNTIL,
    KEY_TIMEOUT,
    KEY_INTERVAL,
    KEY_COUNT,
    KEY_JSON,
    KEY_ANY,
    KEY_ANSWER,
    KEY_GAP,
    KEY_RETRIES
};

static const struct argp_option table[] = {
    {"output", 'o', "OUT.json", 0, "read: the surrogate file to write", 1},
    {"until-points", KEY_UNTIL, "N", 0, "read, watch: wait for an envelope that covers at least N readings", 1},
    {"timeout", KEY_TIMEOUT, "S", 0, "read, watch: give up after S seconds (10; watch: never)", 1},
    {"any", KEY_ANY, NULL, 0, "read: also an envelope with an intrusion", 1},
    {"interval", KEY_INTERVAL, "S", 0, "read, watch: seconds between two looks (0.2; watch: 1)", 1},
    {"count", KEY_COUNT, "N", 0, "watch: end after N lines", 1},
    {"json", KEY_JSON, NULL, 0, "print JSON, an object a line", 1},
    {"map", KEY_MAP, "registers.json", 0, "addresses of another map version than this program's own", 1},
    {"answer-timeout", KEY_ANSWER, "MS", 0, "for an answer to begin (500)", 2},
    {"gap", KEY_GAP, "MS", 0, "RTU: silence before each request, besides T3.5 (0)", 2},
    {"retries", KEY_RETRIES, "N", 0, "of a failed request (4)", 2},
    {0}};

static const char manual[] =
    "Reads a canopy device as a PLC does. URL is rtu:DEVICE,BAUD,8E1,UNIT or tcp:HOST:PORT.\n\n"
    "  read    one whole envelope under one sequence number, to a surrogate file\n"
    "  status  every register that is no coefficient\n"
    "  watch   a line now and then"
    "\vExit status: 0 done, 1 the device did not give it in time, 2 bad input (one line on standard error, no output "
    "file), 64 wrong usage.";

static bool take_option(struct arguments *a, int key, const char *text) {
    struct canopy_fault *fault = &a->fault;
    switch (key) {
    case KEY_UNTIL: return canopy_option_whole("until-points", text, 0, UINT32_MAX, &a->until_points, fault);
    case KEY_TIMEOUT: return canopy_option_real("timeout", text, 0, 1e6, &a->timeout_s, fault);
    case KEY_INTERVAL: return canopy_option_real("interval", text, 0, 3600, &a->interval_s, fault);
    case KEY_COUNT: return canopy_option_whole("count", text, 1, UINT32_MAX, &a->count, fault);
    case KEY_ANSWER: return canopy_option_whole32("answer-timeout", text, 1, 60000, &a->link.timeout_ms, fault);
    case KEY_GAP: return canopy_option_whole32("gap", text, 0, 10000, &a->link.gap_ms, fault);
    case KEY_RETRIES: return canopy_option_whole32("retries", text, 0, 1000, &a->link.retries, fault);
    case KEY_JSON: a->json = true; break;
    case KEY_ANY: a->any = true; break;
    case KEY_MAP: a->map = text; break;
    case 'o': a->out = text; break;
    default: break;
    }
    return true;
}

static enum command command_of(const char *text) {
    return strcmp(text, "read") == 0     ? READ
           : strcmp(text, "status") == 0 ? STATUS
           : strcmp(text, "watch") == 0  ? WATCH
                                         : NO_COMMAND;
}

static void take_argument(struct arguments *a, const char *text, struct argp_state *state) {
    if (a->url == NULL)
        a->url = text;
    else if (a->command == NO_COMMAND && command_of(text) != NO_COMMAND)
        a->command = command_of(text);
    else
        argp_error(state, "'%s' is none of read, status, watch", text);
}

static error_t take(int key, char *text, struct argp_state *state) {
    struct arguments *a = state->input;
    if (key == ARGP_KEY_ARG) {
        take_argument(a, text, state);
    } else if (key == ARGP_KEY_END) {
        if (a->command == NO_COMMAND)
            argp_error(state, "give a URL and a command");
        if (a->command == READ && a->out == NULL)
            argp_error(state, "read: give -o OUT.json");
    } else if (key != 'o' && key < KEY_MAP) {
        return ARGP_ERR_UNKNOWN;
    } else if (!take_option(a, key, text)) {
        argp_error(state, "%s", a->fault.text);
    }
    return 0;
}

// ---------------------------------------------------------------------------------------------------------------------

static void end(int signal_number) {
    (void)signal_number;
    plc_ended = 1;
}

static int fail(int status, const struct canopy_fault *fault) {
    fflush(stdout);
    fprintf(stderr, "canopy-plc: %s\n", fault->text);
    return status;
}

static bool expired(double timeout_s, uint64_t begin_ms) {
    return plc_ended || (double)(plc_now_ms() - begin_ms) > timeout_s * 1000;
}

// Live status and the head of the envelope; the first look also checks what device this is.
static bool look(struct plc_device *device, bool *known, struct canopy_fault *fault) {
    if (!*known && !plc_device_identify(device, fault))
        return false;
    *known = true;
    return plc_device_fetch(device, PLC_HEARTBEAT, PLC_STALE_AFTER_MS, fault) &&
           plc_device_fetch(device, PLC_SEQUENCE, PLC_COVERAGE_COUNT, fault);
}

static bool is_wanted(const struct arguments *a, const struct plc_device *device) {
    return device->value[PLC_SEQUENCE] != 0 && device->value[PLC_POINTS] >= a->until_points &&
           (a->any || (device->value[PLC_STATUS] & PLC_INTRUSION) == 0);
}

static int write_envelope(const struct arguments *a, struct plc_device *device, struct canopy_surrogate *surrogate) {
    struct canopy_fault fault;
    const bool written = canopy_surrogate_write(a->out, surrogate, &fault);
    if (written)
        report_envelope(device, surrogate, a->out, a->json);
    canopy_surrogate_free(surrogate);
    return written ? EXIT_OK : fail(EXIT_INPUT, &fault);
}

static bool say_waiting(const struct arguments *a, const struct plc_device *device, struct canopy_fault *fault) {
    char text[48];
    const uint32_t *value = device->value;
    if (value[PLC_SEQUENCE] == 0)
        return canopy_fault_set(fault, "no envelope is published: status %s", report_bits(value[PLC_STATUS], text));
    return canopy_fault_set(
        fault, "no envelope of %" PRIu64 " points: sequence %" PRIu32 ", points %" PRIu32 ", status %s",
        a->until_points, value[PLC_SEQUENCE], value[PLC_POINTS], report_bits(value[PLC_STATUS], text));
}

// One try. False: not yet, and `fault` says why.
static bool try_read(const struct arguments *a, struct plc_device *device, bool *known,
                     struct canopy_surrogate *surrogate, struct canopy_fault *fault) {
    if (!look(device, known, fault))
        return false;
    if (!is_wanted(a, device))
        return say_waiting(a, device, fault);
    if (!plc_device_envelope(device, surrogate, fault))
        return false;
    if (is_wanted(a, device))  // it may be newer than what was looked at
        return true;
    canopy_surrogate_free(surrogate);
    return say_waiting(a, device, fault);
}

static int run_read(const struct arguments *a, struct plc_device *device) {
    const double timeout_s = a->timeout_s >= 0 ? a->timeout_s : 10;
    const double interval_s = a->interval_s >= 0 ? a->interval_s : 0.2;
    const uint64_t begin_ms = plc_now_ms();
    struct canopy_surrogate surrogate;
    struct canopy_fault fault = {""};
    bool known = false;
    do {
        if (try_read(a, device, &known, &surrogate, &fault))
            return write_envelope(a, device, &surrogate);
        plc_sleep_ms((uint32_t)(interval_s * 1000));
    } while (!expired(timeout_s, begin_ms));
    return fail(EXIT_LATE, &fault);
}

static int run_status(const struct arguments *a, struct plc_device *device) {
    struct canopy_fault fault;
    if (!plc_device_identify(device, &fault) ||
        !plc_device_fetch(device, (enum plc_item)0, (enum plc_item)(PLC_ITEM_COUNT - 1), &fault))
        return fail(EXIT_LATE, &fault);
    report_status(device, a->json);
    return EXIT_OK;
}

static int run_watch(const struct arguments *a, struct plc_device *device) {
    const double interval_s = a->interval_s >= 0 ? a->interval_s : 1;
    const double timeout_s = a->timeout_s >= 0 ? a->timeout_s : HUGE_VAL;
    const uint64_t begin_ms = plc_now_ms();
    struct canopy_fault fault;
    bool known = false;
    for (uint64_t lines = 0; !plc_ended;) {
        const bool looked =
            look(device, &known, &fault) && plc_device_fetch(device, PLC_RX_FRAMES, PLC_CYCLE_MAX_US, &fault);
        if (looked)
            report_watch(device, a->json);
        else if (!plc_ended)
            fail(EXIT_LATE, &fault);
        lines++;
        if (looked && a->until_points > 0 && is_wanted(a, device))
            return EXIT_OK;
        if (a->count > 0 && lines == a->count)
            return a->until_points > 0 || !looked ? EXIT_LATE : EXIT_OK;
        if (expired(timeout_s, begin_ms))
            return a->until_points > 0 ? EXIT_LATE : EXIT_OK;
        plc_sleep_ms((uint32_t)(interval_s * 1000));
    }
    return EXIT_OK;
}

static void catch_signals(void) {
    struct sigaction action = {.sa_handler = end};  // without SA_RESTART: waits end
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    signal(SIGPIPE, SIG_IGN);
}

int main(int argc, char **argv) {
    static struct arguments a = {
        .timeout_s = -1, .interval_s = -1, .link = {.timeout_ms = 500, .gap_ms = 0, .retries = 4}};
    static const struct argp parser = {.options = table, .parser = take, .args_doc = "URL COMMAND", .doc = manual};
    static struct plc_map map;
    static struct plc_link link;
    argp_program_version = "canopy-plc " CANOPY_VERSION;
    argp_err_exit_status = EXIT_USAGE;
    argp_parse(&parser, argc, argv, 0, NULL, &a);
    plc_map_built_in(&map);
    if (a.map != NULL && !plc_map_load(a.map, &map, &a.fault))
        return fail(EXIT_INPUT, &a.fault);
    if (!plc_link_open(&link, a.url, &a.link, &a.fault))
        return fail(EXIT_INPUT, &a.fault);
    catch_signals();
    struct plc_device device = {.link = &link, .map = &map};
    const int status = a.command == READ     ? run_read(&a, &device)
                       : a.command == STATUS ? run_status(&a, &device)
                                             : run_watch(&a, &device);
    plc_link_close(&link);
    return status;
}
