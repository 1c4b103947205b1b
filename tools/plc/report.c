#include "tools/plc/report.h"

#include <inttypes.h>
#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define NO_READING UINT32_MAX  // age_ms while there is no reading

const char *report_bits(uint32_t status, char text[48]) {
    snprintf(text, 48, "%s%s%s%s", (status & PLC_VALID) != 0 ? "valid " : "",
             (status & PLC_INTRUSION) != 0 ? "intrusion " : "", (status & PLC_STALE) != 0 ? "stale " : "",
             (status & (PLC_VALID | PLC_INTRUSION | PLC_STALE)) == 0 ? "none " : "");
    text[strlen(text) - 1] = '\0';
    return text;
}

static json_t *number_of(const struct plc_device *device, int item) {
    if (plc_items[item].type == PLC_F32)
        return json_real(plc_number(device, (enum plc_item)item));
    return json_integer((json_int_t)plc_number(device, (enum plc_item)item));
}

static void print_object(json_t *object) {
    json_dumpf(object, stdout, JSON_REAL_PRECISION(9));
    putchar('\n');
    fflush(stdout);
    json_decref(object);
}

static json_t *object_of(const struct plc_device *device, const enum plc_item *items, size_t count) {
    json_t *object = json_object();
    for (size_t i = 0; i < count; i++)
        json_object_set_new(object, plc_items[items[i]].name, number_of(device, (int)items[i]));
    char text[48];
    json_object_set_new(object, "status_text", json_string(report_bits(device->value[PLC_STATUS], text)));
    return object;
}

// A float by its shortest decimal, which is the one meant; a whole number with all its digits.
static void print_number(const struct plc_device *device, enum plc_item item) {
    const double value = plc_number(device, item);
    int digits = plc_items[item].type == PLC_F32 ? 1 : 10;
    char text[32];
    do {
        snprintf(text, sizeof text, "%.*g", digits, value);
    } while (digits++ < 9 && strtof(text, NULL) != (float)value);
    printf("%s%s%s", text, plc_items[item].unit[0] != '\0' ? " " : "", plc_items[item].unit);
}

void report_status(const struct plc_device *device, bool json) {
    enum plc_item all[PLC_ITEM_COUNT];
    char text[48];
    for (int i = 0; i < PLC_ITEM_COUNT; i++)
        all[i] = (enum plc_item)i;
    if (json) {
        print_object(object_of(device, all, PLC_ITEM_COUNT));
        return;
    }
    const uint32_t version = device->value[PLC_FIRMWARE_VERSION];
    for (int i = 0; i < PLC_ITEM_COUNT; i++) {
        printf("%-18s ", plc_items[i].name);
        if (i == PLC_STATUS)
            printf("%s", report_bits(device->value[i], text));
        else if (i == PLC_FIRMWARE_VERSION)
            printf("%" PRIu32 ".%" PRIu32 ".%" PRIu32, version >> 16, version >> 8 & 0xFFu, version & 0xFFu);
        else if (i == PLC_MAGIC || i == PLC_MAP_CRC || i == PLC_PROBE_U32)
            printf("%08" PRIX32, device->value[i]);
        else if (i == PLC_SIDE)
            printf("%s", device->value[i] == 0 ? "above" : "below");
        else if (i == PLC_SCALAR)
            printf("%s", device->value[i] == 0 ? "f32" : "fx");
        else if (i == PLC_AGE_MS && device->value[i] == NO_READING)
            printf("no reading yet");
        else
            print_number(device, (enum plc_item)i);
        putchar('\n');
    }
    printf("%-18s %" PRIu64 ", %" PRIu64 " failed\n", "(our requests)", device->link->requests, device->link->failures);
}

void report_watch(const struct plc_device *device, bool json) {
    static const enum plc_item items[] = {PLC_HEARTBEAT, PLC_STATUS,    PLC_AGE_MS,       PLC_SENSOR_FAULTS,
                                          PLC_SEQUENCE,  PLC_POINTS,    PLC_COVERAGE_PCT, PLC_MARGIN,
                                          PLC_PROFILES,  PLC_RX_ERRORS, PLC_SCAN_ERRORS,  PLC_POINTS_REJECTED};
    const uint32_t *value = device->value;
    char text[48];
    if (json) {
        print_object(object_of(device, items, sizeof items / sizeof items[0]));
        return;
    }
    printf("heartbeat %" PRIu32 " status %s sequence %" PRIu32 " points %" PRIu32 " coverage %" PRIu32
           " %% profiles %" PRIu32 " scan_errors %" PRIu32 " rejected %" PRIu32 " rx_errors %" PRIu32,
           value[PLC_HEARTBEAT], report_bits(value[PLC_STATUS], text), value[PLC_SEQUENCE], value[PLC_POINTS],
           value[PLC_COVERAGE_PCT], value[PLC_PROFILES], value[PLC_SCAN_ERRORS], value[PLC_POINTS_REJECTED],
           value[PLC_RX_ERRORS]);
    if (value[PLC_AGE_MS] == NO_READING)
        printf(" no reading yet\n");
    else
        printf(" age %" PRIu32 " ms\n", value[PLC_AGE_MS]);
    fflush(stdout);
}

void report_envelope(const struct plc_device *device, const struct canopy_surrogate *s, const char *path, bool json) {
    static const enum plc_item items[] = {PLC_SEQUENCE, PLC_POINTS, PLC_GRID_M,      PLC_GRID_N,
                                          PLC_STATUS,   PLC_AGE_MS, PLC_COVERAGE_PCT};
    const char *side = s->side == CANOPY_ABOVE ? "above" : "below";
    const char *scalar = s->scalar == CANOPY_F32 ? "f32" : "fx";
    char text[48];
    if (json) {
        json_t *object = object_of(device, items, sizeof items / sizeof items[0]);
        json_object_set_new(object, "side", json_string(side));
        json_object_set_new(object, "scalar", json_string(scalar));
        json_object_set_new(object, "unit", json_real(s->unit));
        json_object_set_new(object, "margin", json_real(s->margin));
        json_object_set_new(object, "requests", json_integer((json_int_t)device->link->requests));
        json_object_set_new(object, "failures", json_integer((json_int_t)device->link->failures));
        json_object_set_new(object, "restarts", json_integer((json_int_t)device->restarts));
        json_object_set_new(object, "file", json_string(path));
        print_object(object);
        return;
    }
    printf("%s: sequence %" PRIu32 ", grid %" PRIu32 " x %" PRIu32 " %s, %s, unit %.9g, points %.0f, coverage %" PRIu32
           " %%, margin %.9g, status %s; %" PRIu64 " requests, %" PRIu64 " failed, %" PRIu64 " restarts\n",
           path, device->value[PLC_SEQUENCE], s->size[0], s->size[1], side, scalar, s->unit, s->points,
           device->value[PLC_COVERAGE_PCT], s->margin * s->unit, report_bits(device->value[PLC_STATUS], text),
           device->link->requests, device->link->failures, device->restarts);
}
