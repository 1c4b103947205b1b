// Reading and writing registers: from addresses to members and blocks.
#include "canopy_register_table.h"
#include "lib/plc/internal.h"
#include "lib/version.h"

// ---------------------------------------------------------------------------------------------------------------------
// Which addresses there are

static bool series_has(struct canopy_plc_range range, uint32_t base, uint32_t stride, uint32_t words, uint32_t count) {
    if (!canopy_plc_overlap(range, base, base + (count - 1) * stride + words))
        return false;
    if (range.first <= base)
        return true;
    const uint32_t within = (range.first - base) % stride;
    return within < words || range.end - range.first > stride - within;
}

static bool group_in(struct canopy_plc_range range, const struct canopy_plc_group *group) {
    return canopy_plc_overlap(range, group->address, group->end);
}

// A group has no gaps: tools/registers.py sees to that.
static bool any_register(struct canopy_plc_range range) {
    if (series_has(range, CANOPY_REGISTER_BLOCK_0, CANOPY_BLOCK_STRIDE, CANOPY_BLOCK_WORDS, CANOPY_BLOCK_MAX) ||
        series_has(range, CANOPY_REGISTER_COVERAGE_0, CANOPY_COVERAGE_STRIDE, CANOPY_COVERAGE_WORDS,
                   CANOPY_COVERAGE_MAX) ||
        series_has(range, CANOPY_REGISTER_CHANGED_0, CANOPY_CHANGED_STRIDE, CANOPY_CHANGED_WORDS, CANOPY_CHANGED_MAX))
        return true;
    for (size_t g = 0; g < CANOPY_PLC_GROUPS; g++)
        if (group_in(range, &canopy_plc_groups[g]))
            return true;
    return false;
}

// Whether every address of the range is a register of one group or one block: then nothing needs to be cleared.
static bool is_solid(struct canopy_plc_range range) {
    for (size_t g = 0; g < CANOPY_PLC_GROUPS; g++)
        if (range.first >= canopy_plc_groups[g].address && range.end <= canopy_plc_groups[g].end)
            return true;
    const uint32_t count = range.end - range.first;
    if (range.first >= CANOPY_REGISTER_CHANGED_0)
        return (range.first - CANOPY_REGISTER_CHANGED_0) % CANOPY_CHANGED_STRIDE + count <= CANOPY_CHANGED_WORDS;
    if (range.first >= CANOPY_REGISTER_BLOCK_0)
        return (range.first - CANOPY_REGISTER_BLOCK_0) % CANOPY_BLOCK_STRIDE + count <= CANOPY_BLOCK_WORDS;
    return range.first >= CANOPY_REGISTER_COVERAGE_0 && range.end <= CANOPY_REGISTER_COVERAGE_0 + CANOPY_COVERAGE_WORDS;
}

uint8_t canopy_plc_readable(void *plc, uint8_t client, uint16_t address, uint16_t count) {
    const struct canopy_plc *it = plc;
    const struct canopy_plc_range range = {address, (uint32_t)address + count};
    if (client >= it->config.clients)
        return CANOPY_MODBUS_FAILURE;
    if (count < 1 || count > CANOPY_MODBUS_READ_MAX)
        return CANOPY_MODBUS_ILLEGAL_VALUE;
    return range.end <= CANOPY_MAP_END && any_register(range) ? CANOPY_MODBUS_NO_EXCEPTION
                                                              : CANOPY_MODBUS_ILLEGAL_ADDRESS;
}

// ---------------------------------------------------------------------------------------------------------------------
// Groups: members of a struct

union image {
    struct canopy_plc_identity identity;
    struct canopy_plc_live live;
    struct canopy_plc_envelope envelope;
    struct canopy_plc_query query;
    struct canopy_plc_command command;
    struct canopy_plc_counters counters;
    struct canopy_plc_health health;
    struct canopy_plc_settings settings;
};

static void identity_now(const struct canopy_plc *plc, struct canopy_plc_identity *to) {
    *to = (struct canopy_plc_identity){.magic = 0x434E5059U,
                                       .probe_u32 = 0x12345678U,
                                       .probe_f32 = 0x3F800000U,
                                       .map_crc = CANOPY_MAP_CRC,
                                       .firmware_version = CANOPY_VERSION_MAJOR * 65536U + CANOPY_VERSION_MINOR * 256U +
                                                           CANOPY_VERSION_PATCH,
                                       .capacity = plc->capacity,
                                       .map_version = CANOPY_MAP_VERSION,
                                       .clients = plc->config.clients,
                                       .vendor = CANOPY_VENDOR,
                                       .product = CANOPY_PRODUCT,
                                       .revision = CANOPY_VERSION};
}

void canopy_plc_live_now(const struct canopy_plc *plc, struct canopy_plc_live *to) {
    *to = (struct canopy_plc_live){0};
    plc->config.source.live(plc->config.source.context, to);
    if (plc->published == CANOPY_PLC_NO_SLOT)
        to->status &= (uint16_t)~CANOPY_PLC_VALID;
}

static void counters_now(const struct canopy_plc *plc, struct canopy_plc_counters *to) {
    *to = (struct canopy_plc_counters){0};
    plc->config.source.counters(plc->config.source.context, to);
    to->publications = plc->publications;
    to->withdrawals = plc->withdrawals;
    to->commands = plc->commands;
}

static void health_now(const struct canopy_plc *plc, struct canopy_plc_health *to) {
    *to = (struct canopy_plc_health){0};
    if (plc->keeper != NULL)
        plc->keeper->health(plc->keeper, to);
}

static void settings_now(const struct canopy_plc *plc, struct canopy_plc_settings *to) {
    *to = (struct canopy_plc_settings){.state = CANOPY_PLC_SETTINGS_NOWHERE};
    if (plc->keeper != NULL)
        *to = plc->keeper->settings;
}

static void fill(struct canopy_plc *plc, uint8_t client, size_t group, struct canopy_plc_range range,
                 const struct canopy_plc_slot *snapshot, union image *to) {
    switch (group) {
    case CANOPY_PLC_GROUP_IDENTITY: identity_now(plc, &to->identity); break;
    case CANOPY_PLC_GROUP_LIVE: canopy_plc_live_now(plc, &to->live); break;
    case CANOPY_PLC_GROUP_ENVELOPE: (void)canopy_plc_header(plc, snapshot, &to->envelope); break;
    case CANOPY_PLC_GROUP_QUERY:
        if (canopy_plc_overlap(range, CANOPY_REGISTER_QUERY_HEIGHT, CANOPY_REGISTER_QUERY_HEIGHT + 1))
            canopy_plc_evaluate(plc, client);
        to->query = plc->clients[client].query;
        break;
    case CANOPY_PLC_GROUP_COMMAND: to->command = plc->clients[client].command; break;
    case CANOPY_PLC_GROUP_HEALTH: health_now(plc, &to->health); break;
    case CANOPY_PLC_GROUP_SETTINGS: settings_now(plc, &to->settings); break;
    default: counters_now(plc, &to->counters); break;
    }
}

static uint32_t words_of(const struct canopy_plc_entry *entry) { return entry->shape & ~CANOPY_PLC_WRITABLE; }

// Register `word` of an entry, from the bytes of its member.
static uint16_t word_of(const struct canopy_plc_entry *entry, const void *image, uint32_t word) {
    const unsigned char *member = (const unsigned char *)image + entry->offset;
    uint16_t single;
    uint32_t pair;
    switch (words_of(entry)) {
    case 1: memcpy(&single, member, sizeof single); return single;
    case 2: memcpy(&pair, member, sizeof pair); return (uint16_t)(word == 0 ? pair >> 16 : pair);
    default: return (uint16_t)(member[2 * word] << 8 | member[2 * word + 1]);
    }
}

static void read_group(const struct canopy_plc_group *group, const union image *image, struct canopy_plc_range range,
                       uint8_t *to) {
    const struct canopy_plc_entry *entry = &canopy_plc_entries[group->first];
    uint32_t word = 0;
    for (uint32_t address = group->address; address < group->end && address < range.end; address++) {
        if (address >= range.first)
            canopy_plc_put(to + 2 * (address - range.first), word_of(entry, image, word));
        if (++word == words_of(entry)) {
            entry++;
            word = 0;
        }
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// Blocks

static uint16_t half(uint32_t value, uint32_t word) { return (uint16_t)(word & 1U ? value : value >> 16); }

// What blocks are read from: a snapshot with its sizes, or nothing.
struct blocks {
    const struct canopy_plc_slot *snapshot;
    uint32_t coefficients, cells, extreme;
    uint32_t rows, noted;  // the snapshot says of the first `noted` rows when they changed
};

static uint32_t sequence_of(const struct blocks *from, bool exists) { return exists ? from->snapshot->sequence : 0; }

// Item `item` of coefficient block k: its sequence, then its coefficients.
static uint32_t block_item(const struct blocks *from, uint32_t k, uint32_t item) {
    const uint32_t before = k * CANOPY_PLC_BLOCK_COEFFICIENTS, index = before + item - 1;
    if (item == 0)
        return sequence_of(from, before < from->coefficients);
    return index < from->coefficients ? (uint32_t)from->snapshot->envelope.coefficients[index] : from->extreme;
}

static uint8_t *put_pair(uint8_t *to, uint32_t value) {
    canopy_plc_put(to, (uint16_t)(value >> 16));
    canopy_plc_put(to + 2, (uint16_t)value);
    return to + 4;
}

// Items [item, end) of coefficient block k, whole. Most of what a PLC ever reads passes through here.
static uint8_t *put_items(const struct blocks *from, uint32_t k, uint32_t item, uint32_t end, uint8_t *to) {
    const uint32_t before = k * CANOPY_PLC_BLOCK_COEFFICIENTS;
    if (item == 0 && item < end)
        to = put_pair(to, block_item(from, k, item++));
    if (before + item - 1 < from->coefficients && item < end) {
        const int32_t *next = from->snapshot->envelope.coefficients + before + item - 1;
        const uint32_t left = from->coefficients - (before + item - 1);
        const int32_t *const stop = next + (end - item < left ? end - item : left);
        item += (uint32_t)(stop - next);
        while (next < stop)
            to = put_pair(to, (uint32_t)*next++);
    }
    for (; item < end; item++)
        to = put_pair(to, from->extreme);
    return to;
}

// Registers [first, end) of coefficient block k.
static void read_block(const struct blocks *from, uint32_t k, uint32_t first, uint32_t end, uint8_t *to) {
    if (first & 1U) {
        canopy_plc_put(to, (uint16_t)block_item(from, k, first / 2));
        to += 2;
        first++;
    }
    to = put_items(from, k, first / 2, end / 2, to);
    if ((end & 1U) && first < end)
        canopy_plc_put(to, (uint16_t)(block_item(from, k, end / 2) >> 16));
}

// The 16 cells from `cell` on as bits; the bytes end with the last cell.
static uint16_t cells_from(const struct blocks *from, uint32_t cell) {
    if (cell >= from->cells)
        return 0;
    const uint8_t *bytes = from->snapshot->envelope.coverage + cell / 8;
    const uint32_t left = from->cells - cell;
    const uint32_t bits = bytes[0] | (left > 8 ? (uint32_t)bytes[1] << 8 : 0U);
    return (uint16_t)(left < 16 ? bits & ((1U << left) - 1U) : bits);
}

// Registers [first, end) of coverage block k.
static void read_coverage(const struct blocks *from, uint32_t k, uint32_t first, uint32_t end, uint8_t *to) {
    const uint32_t before = k * CANOPY_PLC_BLOCK_CELLS;
    for (uint32_t word = first; word < end; word++, to += 2)
        canopy_plc_put(to, word < 2 ? half(sequence_of(from, before < from->cells), word)
                                    : cells_from(from, before + 16 * (word - 2)));
}

// Item `item` of change block k: its sequence, then when its rows changed last.
static uint32_t change_item(const struct blocks *from, uint32_t k, uint32_t item) {
    const uint32_t before = k * CANOPY_PLC_BLOCK_ROWS, row = before + item - 1;
    if (item == 0)
        return sequence_of(from, before < from->rows);
    return row < from->noted ? from->snapshot->changed[row] : sequence_of(from, row < from->rows);
}

// Registers [first, end) of change block k.
static void read_changes(const struct blocks *from, uint32_t k, uint32_t first, uint32_t end, uint8_t *to) {
    for (uint32_t word = first; word < end; word++, to += 2)
        canopy_plc_put(to, half(change_item(from, k, word / 2), word));
}

struct series {
    uint32_t base, stride, words, count;
    void (*read)(const struct blocks *from, uint32_t k, uint32_t first, uint32_t end, uint8_t *to);
};

static void read_series(const struct series *series, const struct blocks *from, struct canopy_plc_range range,
                        uint8_t *to) {
    uint32_t k = range.first > series->base ? (range.first - series->base) / series->stride : 0;
    for (; k < series->count && series->base + k * series->stride < range.end; k++) {
        const uint32_t address = series->base + k * series->stride;
        const uint32_t first = range.first > address ? range.first - address : 0;
        const uint32_t end = range.end - address < series->words ? range.end - address : series->words;
        if (first < end)
            series->read(from, k, first, end, to + 2 * (address + first - range.first));
    }
}

static const struct series coefficient_blocks = {CANOPY_REGISTER_BLOCK_0, CANOPY_BLOCK_STRIDE, CANOPY_BLOCK_WORDS,
                                                 CANOPY_BLOCK_MAX, read_block};
static const struct series coverage_blocks = {CANOPY_REGISTER_COVERAGE_0, CANOPY_COVERAGE_STRIDE, CANOPY_COVERAGE_WORDS,
                                              CANOPY_COVERAGE_MAX, read_coverage};
static const struct series change_blocks = {CANOPY_REGISTER_CHANGED_0, CANOPY_CHANGED_STRIDE, CANOPY_CHANGED_WORDS,
                                            CANOPY_CHANGED_MAX, read_changes};

static struct blocks blocks_of(const struct canopy_plc *plc, const struct canopy_plc_slot *snapshot) {
    struct blocks from = {.snapshot = snapshot, .extreme = (uint32_t)canopy_plc_extreme(plc)};
    if (snapshot != NULL) {
        const uint16_t *size = snapshot->envelope.frame.size;
        from.coefficients = (uint32_t)size[0] * size[1];
        from.cells = (uint32_t)(size[0] - 1) * (uint32_t)(size[1] - 1);
        from.rows = size[0];
        from.noted = size[0] < plc->config.size[0] ? size[0] : plc->config.size[0];
    }
    return from;
}

// ---------------------------------------------------------------------------------------------------------------------
// Reading

// Only what is held starts or renews a hold: who polls live status between two blocks keeps it.
static bool held(struct canopy_plc_range range) {
    return canopy_plc_overlap(range, CANOPY_REGISTER_SEQUENCE, CANOPY_PLC_HEADER_END) ||
           range.end > CANOPY_REGISTER_COVERAGE_0;
}

uint8_t canopy_plc_read(void *plc, uint8_t client, uint16_t address, uint16_t count, uint8_t *to) {
    struct canopy_plc *it = plc;
    const uint8_t exception = canopy_plc_readable(plc, client, address, count);
    if (exception != CANOPY_MODBUS_NO_EXCEPTION)
        return exception;
    const struct canopy_plc_range range = {address, (uint32_t)address + count};
    if (!is_solid(range))
        memset(to, 0, 2U * (size_t)count);
    const struct canopy_plc_slot *snapshot = held(range) ? canopy_plc_hold(it, client, range) : NULL;
    for (size_t g = 0; g < CANOPY_PLC_GROUPS && range.first < canopy_plc_groups[CANOPY_PLC_GROUPS - 1].end; g++)
        if (group_in(range, &canopy_plc_groups[g])) {
            union image image;
            fill(it, client, g, range, snapshot, &image);
            read_group(&canopy_plc_groups[g], &image, range, to);
        }
    const struct blocks from = blocks_of(it, snapshot);
    read_series(&coverage_blocks, &from, range, to);
    read_series(&coefficient_blocks, &from, range, to);
    read_series(&change_blocks, &from, range, to);
    return CANOPY_MODBUS_NO_EXCEPTION;
}

// ---------------------------------------------------------------------------------------------------------------------
// Queries

void canopy_plc_unanswered(const struct canopy_plc *plc, struct canopy_plc_query *query) {
    query->height = canopy_plc_extreme(plc);
    query->status = CANOPY_PLC_QUERY_NONE;
    query->sequence = 0;
}

// A height in device units, rounded to the safe side; false if it does not fit.
static bool device_height(const struct canopy_frame *frame, int32_t steps, int32_t *to) {
    const int64_t height = steps;
    const int shift = frame->lsb_log2 < 0 ? (frame->lsb_log2 > -32 ? -frame->lsb_log2 : 32)
                                          : (frame->lsb_log2 < 31 ? frame->lsb_log2 : 31);
    int64_t units = height * ((int64_t)1 << shift);
    if (frame->lsb_log2 < 0)
        units = frame->side == CANOPY_ABOVE ? -(-height >> shift) : height >> shift;
    if (units > INT32_MAX || units < INT32_MIN || (frame->lsb_log2 > 31 && steps != 0))
        return false;
    *to = (int32_t)units;
    return true;
}

void canopy_plc_evaluate(struct canopy_plc *plc, uint8_t client) {
    const struct canopy_plc_source *source = &plc->config.source;
    struct canopy_plc_query *query = &plc->clients[client].query;
    const struct canopy_envelope *envelope = canopy_plc_published(plc);
    canopy_plc_unanswered(plc, query);
    if (envelope == NULL)
        return;
    query->sequence = canopy_plc_sequence(plc);
    struct canopy_plc_live live;
    canopy_plc_live_now(plc, &live);
    if (live.status & CANOPY_PLC_INTRUSION) {
        query->status = CANOPY_PLC_QUERY_INTRUSION;
        return;
    }
    int32_t steps = query->height;
    query->status = (uint16_t)source->height(source->context, envelope, query->x, query->y, &steps);
    if (query->status == CANOPY_PLC_QUERY_GOOD && !device_height(&envelope->frame, steps, &query->height))
        query->status = CANOPY_PLC_QUERY_RANGE;
}

// ---------------------------------------------------------------------------------------------------------------------
// Writing

// The group in which every register of the range can be written and no value is cut, or CANOPY_PLC_GROUPS.
static size_t writable_group(struct canopy_plc_range range) {
    for (size_t g = 0; g < CANOPY_PLC_GROUPS; g++) {
        const struct canopy_plc_group *group = &canopy_plc_groups[g];
        const struct canopy_plc_entry *entry = &canopy_plc_entries[group->first];
        uint32_t covered = 0;
        for (uint32_t address = group->address, next; address < group->end; address = next, entry++) {
            next = address + words_of(entry);
            if ((entry->shape & CANOPY_PLC_WRITABLE) != 0 && address >= range.first && next <= range.end)
                covered += next - address;
        }
        if (covered > 0)
            return covered == range.end - range.first ? g : CANOPY_PLC_GROUPS;
    }
    return CANOPY_PLC_GROUPS;
}

static uint16_t word_at(const uint8_t *from) { return (uint16_t)(from[0] << 8 | from[1]); }

// Puts registers into the members that they are.
static void take(size_t g, struct canopy_plc_range range, const uint8_t *from, void *image) {
    const struct canopy_plc_group *group = &canopy_plc_groups[g];
    const struct canopy_plc_entry *entry = &canopy_plc_entries[group->first];
    for (uint32_t address = group->address; address < range.end; address += words_of(entry++)) {
        if (address < range.first)
            continue;
        const uint8_t *at = from + 2 * (address - range.first);
        unsigned char *member = (unsigned char *)image + entry->offset;
        const uint16_t single = word_at(at);
        if (words_of(entry) == 2) {
            const uint32_t pair = (uint32_t)single << 16 | word_at(at + 2);
            memcpy(member, &pair, sizeof pair);
        } else {
            memcpy(member, &single, sizeof single);
        }
    }
}

static enum canopy_plc_result result_of(struct canopy_plc *plc, enum canopy_plc_command_code code) {
    if (code == CANOPY_PLC_COMMAND_NOTHING)
        return CANOPY_PLC_RESULT_DONE;
    if (code <= CANOPY_PLC_COMMAND_WITHDRAW)
        return plc->config.source.command(plc->config.source.context, code);
    return plc->keeper != NULL ? plc->keeper->keep(plc->keeper, code) : CANOPY_PLC_RESULT_REFUSED;
}

static uint8_t run(struct canopy_plc *plc, struct canopy_plc_command *mine, uint16_t word) {
    const uint8_t code = (uint8_t)word;
    if (code >= CANOPY_PLC_COMMANDS)
        return CANOPY_MODBUS_ILLEGAL_VALUE;
    mine->command = word;
    if (word >> 8 != 0 && word == mine->echo)
        return CANOPY_MODBUS_NO_EXCEPTION;  // a master repeats a request whose answer it did not get
    plc->commands++;
    mine->echo = word;
    mine->result = (uint16_t)result_of(plc, (enum canopy_plc_command_code)code);
    return CANOPY_MODBUS_NO_EXCEPTION;
}

// All of a write is allowed, or nothing of it is taken.
static uint8_t change_settings(const struct canopy_plc *plc, struct canopy_plc_range range, const uint8_t *from) {
    if (plc->keeper == NULL)
        return CANOPY_MODBUS_ILLEGAL_ADDRESS;
    struct canopy_plc_settings *mine = &plc->keeper->settings, wanted = *mine;
    take(CANOPY_PLC_GROUP_SETTINGS, range, from, &wanted);
    if (!canopy_settings_are_allowed(&wanted.value, &mine->value, plc->keeper->fixed))
        return CANOPY_MODBUS_ILLEGAL_VALUE;
    *mine = wanted;
    return CANOPY_MODBUS_NO_EXCEPTION;
}

uint8_t canopy_plc_write(void *plc, uint8_t client, uint16_t address, uint16_t count, const uint8_t *from,
                         uint8_t function) {
    (void)function;
    struct canopy_plc *it = plc;
    const struct canopy_plc_range range = {address, (uint32_t)address + count};
    if (client >= it->config.clients)
        return CANOPY_MODBUS_FAILURE;
    if (count < 1 || count > CANOPY_MODBUS_WRITE_MAX)
        return CANOPY_MODBUS_ILLEGAL_VALUE;
    struct canopy_plc_client *mine = &it->clients[client];
    struct canopy_plc_command command = {0};
    switch (writable_group(range)) {
    case CANOPY_PLC_GROUP_QUERY:
        take(CANOPY_PLC_GROUP_QUERY, range, from, &mine->query);
        canopy_plc_evaluate(it, client);
        return CANOPY_MODBUS_NO_EXCEPTION;
    case CANOPY_PLC_GROUP_COMMAND:
        take(CANOPY_PLC_GROUP_COMMAND, range, from, &command);
        return run(it, &mine->command, command.command);
    case CANOPY_PLC_GROUP_SETTINGS: return change_settings(it, range, from);
    default: return CANOPY_MODBUS_ILLEGAL_ADDRESS;
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// Identification

const char *canopy_plc_identify(void *plc, uint8_t object) {
    (void)plc;
    switch (object) {
    case 0: return CANOPY_VENDOR;
    case 1: return CANOPY_PRODUCT;
    case 2: return CANOPY_VERSION;
    case 4: return CANOPY_PRODUCT_NAME;
    default: return NULL;
    }
}

struct canopy_modbus_bank canopy_plc_bank(struct canopy_plc *plc) {
    return (struct canopy_modbus_bank){.context = plc,
                                       .read = canopy_plc_read,
                                       .write = canopy_plc_write,
                                       .identify = canopy_plc_identify,
                                       .readable = canopy_plc_readable};
}
