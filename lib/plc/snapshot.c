// Snapshots and holds: who sees which envelope, and for how long.
#include "lib/plc/internal.h"

_Static_assert(CANOPY_BLOCK_WORDS == 2 + 2 * CANOPY_PLC_BLOCK_COEFFICIENTS, "a block is a sequence and coefficients");
_Static_assert(CANOPY_COVERAGE_WORDS == 2 + CANOPY_PLC_BLOCK_CELLS / 16, "a block is a sequence and bits");
_Static_assert(CANOPY_BLOCK_MAX >= CANOPY_PLC_BLOCKS_OF(CANOPY_PLC_CAPACITY_MAX), "the map has all blocks");
_Static_assert(CANOPY_COVERAGE_MAX >= CANOPY_PLC_COVERAGE_OF(CANOPY_PLC_CAPACITY_MAX), "the map has all coverage");
_Static_assert(CANOPY_CHANGED_WORDS == 2 + 2 * CANOPY_PLC_BLOCK_ROWS, "a block is a sequence and rows");
_Static_assert(CANOPY_CHANGED_MAX *CANOPY_PLC_BLOCK_ROWS >= CANOPY_PLC_CAPACITY_MAX / 4, "the map has all rows");
_Static_assert(CANOPY_PLC_HEADER_END - CANOPY_REGISTER_SEQUENCE <= 64, "a bit for each header register");

// ---------------------------------------------------------------------------------------------------------------------
// Numbers

static uint32_t bits_of(float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

// value * 2^power on the bits of a positive normal float; false if the result is not one too.
static bool scale_bits(uint32_t bits, int32_t power, uint32_t *to) {
    const int32_t exponent = (int32_t)(bits >> 23) + power;
    if (exponent < 1 || exponent > 254)
        return false;
    *to = (bits & 0x7FFFFFU) | ((uint32_t)exponent << 23);
    return true;
}

static bool normal(float value) {
    const uint32_t bits = bits_of(value);
    return bits >= 0x00800000U && bits < 0x7F800000U;
}

static uint32_t cells_of(const struct canopy_frame *frame) {
    return (uint32_t)(frame->size[0] - 1) * (uint32_t)(frame->size[1] - 1);
}

// ---------------------------------------------------------------------------------------------------------------------
// Init

static bool acceptable(const struct canopy_plc_config *config) {
    const struct canopy_plc_source *source = &config->source;
    return config->size[0] >= 4 && config->size[1] >= 4 &&
           (uint32_t)config->size[0] * config->size[1] <= CANOPY_PLC_CAPACITY_MAX && config->side <= CANOPY_BELOW &&
           config->scalar <= CANOPY_FX && config->clients >= 1 && config->clients <= 250 && normal(config->unit) &&
           source->live != NULL && source->counters != NULL && source->height != NULL && source->command != NULL;
}

enum canopy_status canopy_plc_init(struct canopy_plc *plc, const struct canopy_plc_config *config, void *arena,
                                   size_t bytes) {
    if (plc == NULL || config == NULL || !acceptable(config))
        return CANOPY_ARGUMENT;
    const uint32_t capacity = (uint32_t)config->size[0] * config->size[1];
    const size_t clients = config->clients, slots = clients + 2, rows = config->size[0];
    struct canopy_arena cut;
    const enum canopy_status status =
        canopy_arena_open(&cut, arena, bytes, CANOPY_PLC_ARENA_FOR(capacity, rows, clients));
    if (status != CANOPY_OK)
        return status;
    *plc = (struct canopy_plc){.config = *config,
                               .capacity = capacity,
                               .shown_bytes = CANOPY_PLC_SHOWN_BYTES(capacity),
                               .slot_count = (uint8_t)slots,
                               .published = CANOPY_PLC_NO_SLOT,
                               .writing = CANOPY_PLC_NO_SLOT};
    plc->clients = canopy_arena_take(&cut, clients * sizeof *plc->clients);
    plc->slots = canopy_arena_take(&cut, slots * sizeof *plc->slots);
    uint8_t *shown = canopy_arena_take(&cut, clients * plc->shown_bytes);
    for (size_t i = 0; i < slots; i++) {
        plc->slots[i] = (struct canopy_plc_slot){0};
        plc->slots[i].envelope.coefficients = canopy_arena_take(&cut, 4U * (size_t)capacity);
        plc->slots[i].envelope.coverage = canopy_arena_take(&cut, ((size_t)capacity + 7U) / 8U);
        plc->slots[i].changed = canopy_arena_take(&cut, 4U * rows);
    }
    for (uint8_t i = 0; i < config->clients; i++) {
        plc->clients[i] =
            (struct canopy_plc_client){.shown_blocks = shown + i * plc->shown_bytes, .hold = CANOPY_PLC_NO_SLOT};
        canopy_plc_forget(plc, i);
    }
    return CANOPY_OK;
}

// ---------------------------------------------------------------------------------------------------------------------
// Publishing

// clients + 2 slots, of which at most `clients` are held and one more is published: there is always one left.
static uint8_t free_slot(const struct canopy_plc *plc) {
    uint8_t slot = 0;
    while (slot == plc->published || plc->slots[slot].holders > 0)
        slot++;
    return slot;
}

enum canopy_status canopy_plc_set_unit(struct canopy_plc *plc, float unit) {
    if (!normal(unit))
        return CANOPY_ARGUMENT;
    if (bits_of(unit) != bits_of(plc->config.unit))
        canopy_plc_withdraw(plc);
    plc->config.unit = unit;
    return CANOPY_OK;
}

struct canopy_envelope *canopy_plc_begin(struct canopy_plc *plc) {
    if (plc->writing == CANOPY_PLC_NO_SLOT) {
        plc->writing = free_slot(plc);
        struct canopy_envelope *envelope = &plc->slots[plc->writing].envelope;
        envelope->frame.side = plc->config.side;
        envelope->scalar = plc->config.scalar;
        envelope->first_row = 0;
    }
    return &plc->slots[plc->writing].envelope;
}

static enum canopy_status publishable(const struct canopy_plc *plc, const struct canopy_plc_slot *slot) {
    const struct canopy_envelope *envelope = &slot->envelope;
    const struct canopy_frame *frame = &envelope->frame;
    if (frame->size[0] < 4 || frame->size[1] < 4 || (uint32_t)frame->size[0] * frame->size[1] > plc->capacity ||
        frame->side != plc->config.side || envelope->scalar != plc->config.scalar || envelope->margin < 0 ||
        frame->pitch[0] == 0 || frame->pitch[1] == 0)
        return CANOPY_ARGUMENT;
    struct canopy_plc_envelope header;
    return canopy_plc_header(plc, slot, &header) ? CANOPY_OK : CANOPY_RANGE;
}

// By how many rows the scene has moved since `old`; false if the coefficients mean something else now.
static bool moved_by(const struct canopy_envelope *old, const struct canopy_envelope *next, uint64_t *rows) {
    const struct canopy_frame *a = &old->frame, *b = &next->frame;
    *rows = (uint64_t)next->first_row - (uint64_t)old->first_row;
    const int first = *rows == 0 ? 0 : 2;  // a scene that moves takes its origin along
    for (int axis = first; axis < 3; axis++)
        if (a->origin[axis] != b->origin[axis])
            return false;
    return memcmp(a->pitch, b->pitch, sizeof a->pitch) == 0 && memcmp(a->size, b->size, sizeof a->size) == 0 &&
           memcmp(a->axis, b->axis, sizeof a->axis) == 0 && a->lsb_log2 == b->lsb_log2 &&
           a->quantum_log2 == b->quantum_log2;
}

// Says of each row of the slot which sequence changed it last. `old` is what was published until now, or NULL.
static void note_changes(const struct canopy_plc *plc, struct canopy_plc_slot *slot,
                         const struct canopy_plc_slot *old) {
    const uint16_t *size = slot->envelope.frame.size;
    const uint32_t known = size[0] < plc->config.size[0] ? size[0] : plc->config.size[0];
    uint64_t moved = 0;
    const bool comparable = old != NULL && moved_by(&old->envelope, &slot->envelope, &moved);
    for (uint32_t i = 0; i < known; i++) {
        const uint64_t was = i + moved;
        const bool same = comparable && was < known &&
                          memcmp(slot->envelope.coefficients + (size_t)i * size[1],
                                 old->envelope.coefficients + (size_t)was * size[1], 4U * (size_t)size[1]) == 0;
        slot->changed[i] = same ? old->changed[was] : slot->sequence;
    }
}

enum canopy_status canopy_plc_commit(struct canopy_plc *plc) {
    if (plc->writing == CANOPY_PLC_NO_SLOT)
        return CANOPY_ARGUMENT;
    struct canopy_plc_slot *slot = &plc->slots[plc->writing];
    const enum canopy_status status = plc->barred ? CANOPY_NOT_SAFE : publishable(plc, slot);
    if (status != CANOPY_OK)
        return status;
    plc->sequence = plc->sequence == UINT32_MAX ? 1 : plc->sequence + 1;  // 0 says that there is no envelope
    plc->publications++;
    slot->sequence = plc->sequence;
    note_changes(plc, slot, plc->published == CANOPY_PLC_NO_SLOT ? NULL : &plc->slots[plc->published]);
    plc->published = plc->writing;
    plc->writing = CANOPY_PLC_NO_SLOT;
    return CANOPY_OK;
}

enum canopy_status canopy_plc_publish(struct canopy_plc *plc, const struct canopy_envelope *envelope) {
    const struct canopy_frame *frame = &envelope->frame;
    const uint32_t count = (uint32_t)frame->size[0] * frame->size[1];
    if (frame->size[0] < 4 || frame->size[1] < 4 || count > plc->capacity)
        return CANOPY_ARGUMENT;
    struct canopy_envelope *to = canopy_plc_begin(plc);
    memcpy(to->coefficients, envelope->coefficients, 4U * (size_t)count);
    memcpy(to->coverage, envelope->coverage, ((size_t)cells_of(frame) + 7U) / 8U);
    to->frame = *frame;
    to->scalar = envelope->scalar;
    to->points = envelope->points;
    to->margin = envelope->margin;
    to->first_row = envelope->first_row;
    return canopy_plc_commit(plc);
}

static void let_go(struct canopy_plc *plc, struct canopy_plc_client *client) {
    if (client->hold < CANOPY_PLC_BROKEN)
        plc->slots[client->hold].holders--;
    client->hold = CANOPY_PLC_NO_SLOT;
}

void canopy_plc_withdraw(struct canopy_plc *plc) {
    if (plc->published != CANOPY_PLC_NO_SLOT)
        plc->withdrawals++;
    plc->published = CANOPY_PLC_NO_SLOT;
    for (uint8_t i = 0; i < plc->config.clients; i++) {
        struct canopy_plc_client *client = &plc->clients[i];
        if (client->hold < CANOPY_PLC_BROKEN) {
            let_go(plc, client);
            client->hold = CANOPY_PLC_BROKEN;
        }
        canopy_plc_unanswered(plc, &client->query);
    }
}

void canopy_plc_bar(struct canopy_plc *plc) {
    plc->barred = true;
    canopy_plc_withdraw(plc);
}

const struct canopy_envelope *canopy_plc_published(const struct canopy_plc *plc) {
    return plc->published == CANOPY_PLC_NO_SLOT ? NULL : &plc->slots[plc->published].envelope;
}

uint32_t canopy_plc_sequence(const struct canopy_plc *plc) {
    return plc->published == CANOPY_PLC_NO_SLOT ? 0 : plc->slots[plc->published].sequence;
}

// ---------------------------------------------------------------------------------------------------------------------
// Holding

void canopy_plc_forget(struct canopy_plc *plc, uint8_t client) {
    if (client >= plc->config.clients)
        return;
    struct canopy_plc_client *it = &plc->clients[client];
    let_go(plc, it);
    it->shown = 0;
    memset(it->shown_blocks, 0, plc->shown_bytes);
    it->query = (struct canopy_plc_query){0};
    it->command = (struct canopy_plc_command){0};
    canopy_plc_unanswered(plc, &it->query);
}

// The header registers of a range as bits.
static uint64_t header_bits(struct canopy_plc_range range) {
    const uint32_t first = CANOPY_REGISTER_SEQUENCE, end = CANOPY_PLC_HEADER_END;
    if (!canopy_plc_overlap(range, first, end))
        return 0;
    const uint32_t from = range.first > first ? range.first - first : 0;
    const uint32_t to = (range.end < end ? range.end : end) - first;
    return (UINT64_MAX >> (64U - (to - from))) << from;
}

// The blocks of a series whose first register lies in a range: [first, end), none beyond `count`.
static struct canopy_plc_range blocks_begun(struct canopy_plc_range range, uint32_t base, uint32_t stride,
                                            size_t count) {
    struct canopy_plc_range blocks = {0, 0};
    if (range.end <= base)
        return blocks;
    blocks.first = range.first > base ? (range.first - base + stride - 1) / stride : 0;
    blocks.end = (range.end - base + stride - 1) / stride;
    if (blocks.end > count)
        blocks.end = (uint32_t)count;
    return blocks;
}

static bool any_shown(const struct canopy_plc_client *client, struct canopy_plc_range blocks, size_t offset) {
    for (size_t k = blocks.first + offset; k < blocks.end + offset; k++)
        if (client->shown_blocks[k / 8] & (1U << (k % 8)))
            return true;
    return false;
}

static void mark_shown(struct canopy_plc_client *client, struct canopy_plc_range blocks, size_t offset) {
    for (size_t k = blocks.first + offset; k < blocks.end + offset; k++)
        client->shown_blocks[k / 8] |= (uint8_t)(1U << (k % 8));
}

static void start_hold(struct canopy_plc *plc, struct canopy_plc_client *client) {
    let_go(plc, client);
    client->shown = 0;
    memset(client->shown_blocks, 0, plc->shown_bytes);
    // While nothing is published there is nothing to hold: the first request after a publication shall see it.
    if (plc->published != CANOPY_PLC_NO_SLOT) {
        client->hold = plc->published;
        plc->slots[plc->published].holders++;
    }
}

const struct canopy_plc_slot *canopy_plc_hold(struct canopy_plc *plc, uint8_t client, struct canopy_plc_range range) {
    struct canopy_plc_client *it = &plc->clients[client];
    const size_t block_count = CANOPY_PLC_BLOCKS_OF(plc->capacity);
    const uint64_t header = header_bits(range);
    const struct canopy_plc_range blocks =
        blocks_begun(range, CANOPY_REGISTER_BLOCK_0, CANOPY_BLOCK_STRIDE, block_count);
    const struct canopy_plc_range coverage =
        blocks_begun(range, CANOPY_REGISTER_COVERAGE_0, CANOPY_COVERAGE_STRIDE, CANOPY_PLC_COVERAGE_OF(plc->capacity));
    const struct canopy_plc_range changes =
        blocks_begun(range, CANOPY_REGISTER_CHANGED_0, CANOPY_CHANGED_STRIDE, block_count);
    if (it->hold == CANOPY_PLC_NO_SLOT || (header & 1U) || (header & it->shown) || any_shown(it, blocks, 0) ||
        any_shown(it, coverage, block_count) || any_shown(it, changes, 2 * block_count))
        start_hold(plc, it);
    it->shown |= header;
    mark_shown(it, blocks, 0);
    mark_shown(it, coverage, block_count);
    mark_shown(it, changes, 2 * block_count);
    return it->hold < CANOPY_PLC_BROKEN ? &plc->slots[it->hold] : NULL;
}

// ---------------------------------------------------------------------------------------------------------------------
// The header

bool canopy_plc_header(const struct canopy_plc *plc, const struct canopy_plc_slot *slot,
                       struct canopy_plc_envelope *to) {
    *to = (struct canopy_plc_envelope){.scalar = plc->config.scalar, .side = plc->config.side};
    to->grid_m = plc->config.size[0];
    to->grid_n = plc->config.size[1];
    bool normals = true;
    if (slot != NULL) {
        const struct canopy_frame *frame = &slot->envelope.frame;
        to->sequence = slot->sequence;
        to->points = slot->envelope.points;
        to->margin = slot->envelope.margin;
        to->first_row_high = (int32_t)(uint32_t)((uint64_t)slot->envelope.first_row >> 32);
        to->first_row_low = (uint32_t)(uint64_t)slot->envelope.first_row;
        normals = scale_bits(bits_of(plc->config.unit), frame->quantum_log2, &to->unit) &&
                  scale_bits(bits_of(1.0f), frame->lsb_log2, &to->lsb);
        memcpy(to->origin, frame->origin, sizeof to->origin);
        memcpy(to->pitch, frame->pitch, sizeof to->pitch);
        memcpy(to->axis, frame->axis, sizeof to->axis);
        to->grid_m = frame->size[0];
        to->grid_n = frame->size[1];
    }
    to->block_count = (uint16_t)CANOPY_PLC_BLOCKS_OF((uint32_t)to->grid_m * to->grid_n);
    to->coverage_count = (uint16_t)CANOPY_PLC_COVERAGE_OF((uint32_t)(to->grid_m - 1) * (uint32_t)(to->grid_n - 1));
    return normals;
}
