#include "tools/plc/device.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lib/cover/frame.h"

#define MAGIC 0x434E5059u
#define PROBE 0x12345678u
#define PROBE_SWAPPED 0x56781234u
#define READ_MOST 125u
#define GAP_MOST 16u  // addresses read in vain rather than by another request
#define RESTARTS 20u  // a device that publishes faster than it can be read

static uint32_t long_at(const uint16_t *registers) { return (uint32_t)registers[0] << 16 | registers[1]; }

float plc_float(uint32_t bits) {
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

double plc_number(const struct plc_device *device, enum plc_item item) {
    const uint32_t bits = device->value[item];
    switch (plc_items[item].type) {
    case PLC_I32: return (int32_t)bits;
    case PLC_F32: return (double)plc_float(bits);
    default: return bits;
    }
}

static uint32_t end_of(const struct plc_map *map, int item) {
    return (uint32_t)map->address[item] + plc_words(plc_items[item].type);
}

// Reads the registers from `start` up to `end` and takes the items of [first, last] that lie in them.
static bool fetch_span(struct plc_device *device, int first, int last, uint32_t start, uint32_t end,
                       struct canopy_fault *fault) {
    uint16_t registers[READ_MOST];
    if (!plc_link_read(device->link, (uint16_t)start, (uint16_t)(end - start), registers, fault))
        return false;
    for (int i = first; i <= last; i++) {
        if (device->map->address[i] < start || end_of(device->map, i) > end)
            continue;
        const uint16_t *at = registers + (device->map->address[i] - start);
        device->value[i] = plc_items[i].type == PLC_U16 ? at[0] : long_at(at);
    }
    return true;
}

// The lowest address at or above `from` that belongs to an item of [first, last]; UINT32_MAX if there is none.
static uint32_t next_address(const struct plc_map *map, int first, int last, uint32_t from) {
    uint32_t lowest = UINT32_MAX;
    for (int i = first; i <= last; i++)
        if (map->address[i] >= from && map->address[i] < lowest)
            lowest = map->address[i];
    return lowest;
}

// Where a read that starts at `start` best ends.
static uint32_t span_end(const struct plc_map *map, int first, int last, uint32_t start) {
    uint32_t end = start;
    for (;;) {
        const uint32_t next = next_address(map, first, last, end);
        if (next == UINT32_MAX || next > end + GAP_MOST)
            return end;
        uint32_t reach = end;
        for (int i = first; i <= last; i++)
            if (map->address[i] == next && end_of(map, i) > reach)
                reach = end_of(map, i);
        if (reach - start > READ_MOST)
            return end;
        end = reach;
    }
}

bool plc_device_fetch(struct plc_device *device, enum plc_item first, enum plc_item last, struct canopy_fault *fault) {
    const int low = (int)first, high = (int)last;
    uint32_t start = next_address(device->map, low, high, 0);
    while (start != UINT32_MAX) {
        const uint32_t end = span_end(device->map, low, high, start);
        if (!fetch_span(device, low, high, start, end, fault))
            return false;
        start = next_address(device->map, low, high, end);
    }
    return true;
}

bool plc_device_identify(struct plc_device *device, struct canopy_fault *fault) {
    if (!plc_device_fetch(device, PLC_MAGIC, PLC_CAPACITY, fault))
        return false;
    const uint32_t *value = device->value;
    if (value[PLC_PROBE_U32] == PROBE_SWAPPED)
        return canopy_fault_set(fault, "probe_u32 reads 56781234: something on the way swaps words, set it to ABCD");
    if (value[PLC_MAGIC] != MAGIC)
        return canopy_fault_set(fault, "magic reads %08X, not %08X: this is no canopy device", value[PLC_MAGIC], MAGIC);
    if (value[PLC_PROBE_U32] != PROBE || plc_float(value[PLC_PROBE_F32]) != 1.0f)
        return canopy_fault_set(fault, "the probe words read %08X and %08X: the word order is wrong",
                                value[PLC_PROBE_U32], value[PLC_PROBE_F32]);
    if (value[PLC_MAP_VERSION] != device->map->version)
        return canopy_fault_set(fault, "the device has map version %u, this is %u: give its registers.json as --map",
                                value[PLC_MAP_VERSION], device->map->version);
    return true;
}

// ---------------------------------------------------------------------------------------------------------------------
// The envelope

enum outcome { DONE, CHANGED, FAILED };

// Reads blocks that hold `registers` registers in all, behind their sequences, into `to`.
static enum outcome read_series(struct plc_device *device, const struct plc_series *series, uint32_t sequence,
                                size_t registers, uint16_t *to, struct canopy_fault *fault) {
    uint16_t block[READ_MOST];
    const size_t room = series->words - 2u;
    for (size_t k = 0, done = 0; done < registers; k++) {
        const size_t count = registers - done < room ? registers - done : room;
        const uint16_t address = (uint16_t)(series->address + k * series->stride);
        if (!plc_link_read(device->link, address, (uint16_t)(count + 2), block, fault))
            return FAILED;
        if (long_at(block) != sequence)
            return CHANGED;
        memcpy(to + done, block + 2, count * sizeof *to);
        done += count;
    }
    return DONE;
}

// A header that makes sense before memory is given to it.
static bool header_ok(const struct plc_device *device, struct canopy_fault *fault) {
    const uint32_t *value = device->value;
    const uint32_t m = value[PLC_GRID_M], n = value[PLC_GRID_N];
    const uint32_t room = device->map->blocks.most * ((device->map->blocks.words - 2u) / 2);
    const uint32_t bits = device->map->coverage.most * (device->map->coverage.words - 2u) * 16;
    if (m < 4 || n < 4 || m > CANOPY_SURROGATE_GRID_MAX || n > CANOPY_SURROGATE_GRID_MAX || m * n > room ||
        (m - 1) * (n - 1) > bits)
        return canopy_fault_set(fault, "a grid of %u x %u does not fit the map", m, n);
    const float lsb = plc_float(value[PLC_LSB]), unit = plc_float(value[PLC_UNIT]);
    int exponent = 0;
    if (!isnormal(lsb) || frexpf(lsb, &exponent) != 0.5f)
        return canopy_fault_set(fault, "lsb reads %g: it must be a power of two", (double)lsb);
    if (!isnormal(unit) || unit < 0)
        return canopy_fault_set(fault, "unit reads %g: it must be positive", (double)unit);
    if (value[PLC_SIDE] > 1 || value[PLC_SCALAR] > 1 || value[PLC_PITCH_U] == 0 || value[PLC_PITCH_V] == 0)
        return canopy_fault_set(fault, "side %u, scalar %u, pitch %u and %u: no such envelope", value[PLC_SIDE],
                                value[PLC_SCALAR], value[PLC_PITCH_U], value[PLC_PITCH_V]);
    return true;
}

static unsigned digits_of(float value, double *shortest) {
    char text[32];
    unsigned digits = 1;
    for (; digits <= 9; digits++) {
        snprintf(text, sizeof text, "%.*e", (int)digits - 1, (double)value);
        if (strtof(text, NULL) == value)
            break;
    }
    *shortest = strtod(text, NULL);
    return digits;
}

// The unit that the float stands for: its shortest decimal. With float points it may be folded with a power of two
// (the quantum), which no decimal shows; then the split with the fewest digits is meant.
static double unit_of(float value, uint32_t scalar) {
    double best = 0;
    unsigned fewest = digits_of(value, &best);
    for (int k = -64; scalar == CANOPY_F32 && k <= 64; k++) {
        double decimal = 0;
        const float split = ldexpf(value, -k);
        if (isnormal(split) && digits_of(split, &decimal) < fewest) {
            fewest = digits_of(split, &decimal);
            best = ldexp(decimal, k);
        }
    }
    return best;
}

static void take_header(const struct plc_device *device, struct canopy_surrogate *s) {
    const uint32_t *value = device->value;
    s->side = value[PLC_SIDE] == 0 ? CANOPY_ABOVE : CANOPY_BELOW;
    s->scalar = value[PLC_SCALAR] == 0 ? CANOPY_F32 : CANOPY_FX;
    s->unit = unit_of(plc_float(value[PLC_UNIT]), value[PLC_SCALAR]);
    for (int i = 0; i < 3; i++) {
        s->origin[i] = plc_number(device, (enum plc_item)(PLC_ORIGIN_X + i));
        for (int j = 0; j < 3; j++)
            s->axes[i][j] = plc_number(device, (enum plc_item)(PLC_AXIS_00 + 3 * i + j)) / CANOPY_AXIS_ONE;
    }
    s->pitch[0] = value[PLC_PITCH_U];
    s->pitch[1] = value[PLC_PITCH_V];
    s->size[0] = value[PLC_GRID_M];
    s->size[1] = value[PLC_GRID_N];
    s->lsb = plc_number(device, PLC_LSB);
    s->certified = true;
    s->margin = plc_number(device, PLC_MARGIN) * s->lsb;
    s->points = value[PLC_POINTS];
}

// Coefficients and coverage, once the header is there.
static enum outcome read_blocks(struct plc_device *device, struct canopy_surrogate *s, struct canopy_fault *fault) {
    const size_t coefficients = (size_t)s->size[0] * s->size[1], cells = (size_t)(s->size[0] - 1) * (s->size[1] - 1);
    const size_t words = (cells + 15) / 16;
    const uint32_t sequence = device->value[PLC_SEQUENCE];
    uint16_t *registers = calloc(coefficients * 2 + words, sizeof *registers);
    s->coefficients = calloc(coefficients, sizeof *s->coefficients);
    s->trim = calloc(cells, sizeof *s->trim);
    if (registers == NULL || s->coefficients == NULL || s->trim == NULL) {
        free(registers);
        canopy_fault_set(fault, "no memory for an envelope");
        return FAILED;
    }
    uint16_t *bits = registers + coefficients * 2;
    enum outcome outcome = read_series(device, &device->map->blocks, sequence, coefficients * 2, registers, fault);
    if (outcome == DONE)
        outcome = read_series(device, &device->map->coverage, sequence, words, bits, fault);
    for (size_t i = 0; outcome == DONE && i < coefficients; i++)
        s->coefficients[i] = (int32_t)long_at(registers + 2 * i);
    for (size_t i = 0; outcome == DONE && i < cells; i++)
        s->trim[i] = (uint8_t)(bits[i / 16] >> (i % 16) & 1u);
    free(registers);
    return outcome;
}

static enum outcome read_once(struct plc_device *device, struct canopy_surrogate *s, struct canopy_fault *fault) {
    memset(s, 0, sizeof *s);
    if (!plc_device_fetch(device, PLC_SEQUENCE, PLC_COVERAGE_COUNT, fault))
        return FAILED;
    if (device->value[PLC_SEQUENCE] == 0) {
        canopy_fault_set(fault, "no envelope is published");
        return FAILED;
    }
    if (!header_ok(device, fault))
        return FAILED;
    take_header(device, s);
    const enum outcome outcome = read_blocks(device, s, fault);
    if (outcome != DONE)
        canopy_surrogate_free(s);
    return outcome;
}

bool plc_device_envelope(struct plc_device *device, struct canopy_surrogate *surrogate, struct canopy_fault *fault) {
    for (unsigned i = 0; i <= RESTARTS; i++) {
        const enum outcome outcome = read_once(device, surrogate, fault);
        if (outcome != CHANGED)
            return outcome == DONE;
        device->restarts++;
    }
    return canopy_fault_set(fault, "the envelope changed %u times while it was read", RESTARTS + 1);
}
