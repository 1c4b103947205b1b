#include "tools/plc/map.h"

#include <jansson.h>
#include <stdio.h>
#include <string.h>

#include "canopy_registers.h"

const struct plc_item_info plc_items[PLC_ITEM_COUNT] = {
#define PLC_INFO(NAME, name, type, unit) {#name, PLC_##type, unit},
    PLC_ITEMS(PLC_INFO)
#undef PLC_INFO
};

void plc_map_built_in(struct plc_map *map) {
    static const uint16_t addresses[PLC_ITEM_COUNT] = {
#define PLC_ADDRESS(NAME, name, type, unit) CANOPY_REGISTER_##NAME,
        PLC_ITEMS(PLC_ADDRESS)
#undef PLC_ADDRESS
    };
    *map = (struct plc_map){
        .version = CANOPY_MAP_VERSION,
        .blocks = {CANOPY_REGISTER_BLOCK_0, CANOPY_BLOCK_STRIDE, CANOPY_BLOCK_WORDS, CANOPY_BLOCK_MAX},
        .coverage = {CANOPY_REGISTER_COVERAGE_0, CANOPY_COVERAGE_STRIDE, CANOPY_COVERAGE_WORDS, CANOPY_COVERAGE_MAX}};
    memcpy(map->address, addresses, sizeof addresses);
}

// ---------------------------------------------------------------------------------------------------------------------

static const json_t *find(const json_t *registers, const char *name) {
    size_t i = 0;
    const json_t *one = NULL;
    json_array_foreach(registers, i, one) {
        const char *its = json_string_value(json_object_get(one, "name"));
        if (its != NULL && strcmp(its, name) == 0)
            return one;
    }
    return NULL;
}

static bool number(const json_t *object, const char *key, uint16_t *to) {
    const json_t *value = json_object_get(object, key);
    const json_int_t whole = json_integer_value(value);
    *to = (uint16_t)whole;
    return json_is_integer(value) && whole >= 0 && whole <= UINT16_MAX;
}

static bool load_item(const json_t *registers, const struct plc_item_info *info, uint16_t *address,
                      struct canopy_fault *fault) {
    static const char *const types[] = {"u16", "u32", "i32", "f32"};
    const json_t *one = find(registers, info->name);
    const char *type = json_string_value(json_object_get(one, "type"));
    if (one == NULL || type == NULL || !number(one, "address", address))
        return canopy_fault_set(fault, "no register '%s' with address and type: make registers.json anew", info->name);
    return strcmp(type, types[info->type]) == 0 ||
           canopy_fault_set(fault, "register '%s' is %s here, %s is needed", info->name, type, types[info->type]);
}

// Blocks are listed one by one: NAME_0, NAME_1, …
static bool load_series(const json_t *registers, const char *name, struct plc_series *series,
                        struct canopy_fault *fault) {
    char block[32];
    uint16_t address = 0;
    for (series->most = 0; series->most < UINT16_MAX; series->most++) {
        snprintf(block, sizeof block, "%s_%u", name, series->most);
        const json_t *one = find(registers, block);
        if (one == NULL)
            break;
        if (!number(one, "address", &address) || !number(one, "words", &series->words) || series->words < 3 ||
            series->words > 125)
            return canopy_fault_set(fault, "register '%s' has no usable address and words", block);
        if (series->most == 0)
            series->address = address;
        else if (series->most == 1)
            series->stride = (uint16_t)(address - series->address);
        if (address != series->address + series->most * series->stride)
            return canopy_fault_set(fault, "register '%s' is not where the blocks before it lead", block);
    }
    return series->most > 0 || canopy_fault_set(fault, "no register '%s_0'", name);
}

static bool load(const json_t *root, struct plc_map *map, struct canopy_fault *fault) {
    const json_t *registers = json_object_get(root, "registers");
    const char *order = json_string_value(json_object_get(root, "word_order"));
    memset(map, 0, sizeof *map);
    if (!json_is_array(registers) || !number(root, "map_version", &map->version))
        return canopy_fault_set(fault, "no map_version and registers: this is no registers.json");
    if (order == NULL || strcmp(order, "ABCD") != 0)
        return canopy_fault_set(fault, "word_order is not ABCD");
    for (int i = 0; i < PLC_ITEM_COUNT; i++)
        if (!load_item(registers, &plc_items[i], &map->address[i], fault))
            return false;
    return load_series(registers, "block", &map->blocks, fault) &&
           load_series(registers, "coverage", &map->coverage, fault);
}

bool plc_map_load(const char *path, struct plc_map *map, struct canopy_fault *fault) {
    json_error_t error;
    json_t *root = json_load_file(path, 0, &error);
    if (root == NULL)
        return canopy_fault_set(fault, "%s:%d: %s", path, error.line, error.text);
    const bool done = load(root, map, fault) || canopy_fault_prefix(fault, "%s", path);
    json_decref(root);
    return done;
}
