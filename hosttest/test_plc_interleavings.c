// Nobody ever sees two envelopes under one sequence number: every interleaving of publications, withdrawals and reads
// that a small model reaches, and a great many random ones at full size.
//
// The reference is the rule of lib/plc/plc.h written down a second time, for one client at a time and without slots:
// what it holds (nothing, something broken, sequence s) and what the hold has shown. A snapshot's contents are a
// function of its sequence, so each answer is predicted to the bit.
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "canopy_registers.h"
#include "lib/plc/plc.h"

enum { CLIENTS_MAX = 4, BLOCKS_MAX = 7, WORDS_MAX = 125 };

// Contents of the envelope with a sequence: every word differs from its neighbours and from other sequences'.
static uint32_t coefficient(uint32_t sequence, uint32_t index) { return (sequence * 2654435761U) ^ (index * 40503U); }
static bool covered(uint32_t sequence, uint32_t cell) { return (((sequence * 31 + cell) * 2654435761U) >> 13) & 1U; }

// ---------------------------------------------------------------------------------------------------------------------
// The rule, a second time

enum hold { FREE, BROKEN, HELD };

struct reference_client {
    enum hold hold;
    uint32_t sequence;
    uint64_t shown_header;
    uint16_t shown_blocks;
    bool shown_coverage, shown_changes;
};

struct world {
    struct canopy_plc plc;
    uint64_t *arena;
    uint16_t m, n;
    uint8_t clients;
    uint32_t published;  // sequence, 0: none
    uint32_t last;       // of the last publication
    bool begun;
    uint16_t heartbeat;
    struct reference_client reference[CLIENTS_MAX];
};

static uint32_t count_of(const struct world *world) { return (uint32_t)world->m * world->n; }
static uint32_t cells_of(const struct world *world) { return (uint32_t)(world->m - 1) * (uint32_t)(world->n - 1); }

static void live(void *context, struct canopy_plc_live *to) {
    struct world *world = context;
    to->heartbeat = ++world->heartbeat;
    to->status = CANOPY_PLC_VALID;
}

static void counters(void *context, struct canopy_plc_counters *to) {
    (void)context;
    (void)to;
}

static enum canopy_plc_query_status height(void *context, const struct canopy_envelope *envelope, int32_t x, int32_t y,
                                           int32_t *to) {
    (void)context;
    (void)envelope;
    (void)x;
    (void)y;
    (void)to;
    return CANOPY_PLC_QUERY_OUTSIDE;
}

static enum canopy_plc_result command(void *context, enum canopy_plc_command_code code) {
    (void)context;
    (void)code;
    return CANOPY_PLC_RESULT_REFUSED;
}

// Starts in `arena`, which has room for CANOPY_PLC_ARENA(m, n, clients).
static void start(struct world *world, uint16_t m, uint16_t n, uint8_t clients, uint64_t *arena) {
    *world = (struct world){.arena = arena, .m = m, .n = n, .clients = clients};
    const struct canopy_plc_config config = {
        .size = {m, n},
        .side = CANOPY_ABOVE,
        .scalar = CANOPY_FX,
        .clients = clients,
        .unit = 1.0f,
        .source = {.context = world, .live = live, .counters = counters, .height = height, .command = command},
    };
    assert_int_equal(canopy_plc_init(&world->plc, &config, arena, CANOPY_PLC_ARENA(m, n, clients)), CANOPY_OK);
}

// ---------------------------------------------------------------------------------------------------------------------
// What can happen

static void begin(struct world *world) {
    const uint32_t sequence = world->last + 1;
    struct canopy_envelope *to = canopy_plc_begin(&world->plc);
    to->frame.size[0] = world->m;
    to->frame.size[1] = world->n;
    to->frame.pitch[0] = to->frame.pitch[1] = 4;
    to->points = sequence * 7;
    to->margin = (int32_t)sequence;
    for (uint32_t i = 0; i < count_of(world); i++)
        to->coefficients[i] = (int32_t)coefficient(sequence, i);
    memset(to->coverage, 0, (cells_of(world) + 7) / 8);
    for (uint32_t i = 0; i < cells_of(world); i++)
        if (covered(sequence, i))
            to->coverage[i / 8] |= (uint8_t)(1U << (i % 8));
    world->begun = true;
}

static void commit(struct world *world) {
    const enum canopy_status status = canopy_plc_commit(&world->plc);
    assert_int_equal(status, world->begun ? CANOPY_OK : CANOPY_ARGUMENT);
    if (world->begun)
        world->published = ++world->last;
    world->begun = false;
    assert_int_equal(canopy_plc_sequence(&world->plc), world->published);
}

static void withdraw(struct world *world) {
    canopy_plc_withdraw(&world->plc);
    world->published = 0;
    for (uint8_t c = 0; c < world->clients; c++)
        if (world->reference[c].hold == HELD)
            world->reference[c].hold = BROKEN;
}

static void forget(struct world *world, uint8_t client) {
    canopy_plc_forget(&world->plc, client);
    world->reference[client] = (struct reference_client){.hold = FREE};
}

// The sequence that a request for [first, end) must be answered from.
static uint32_t expected_sequence(const struct world *world, struct reference_client *it, uint32_t first,
                                  uint32_t end) {
    uint64_t header = 0;
    uint16_t blocks = 0;
    bool coverage = false, changes = false, anything = false;
    for (uint32_t a = first; a < end; a++) {
        if (a >= CANOPY_REGISTER_SEQUENCE && a <= CANOPY_REGISTER_FIRST_ROW_LOW + 1)
            header |= 1ULL << (a - CANOPY_REGISTER_SEQUENCE);
        for (uint32_t k = 0; k < BLOCKS_MAX; k++)
            if (a == CANOPY_REGISTER_BLOCK_0 + k * CANOPY_BLOCK_STRIDE)
                blocks |= (uint16_t)(1U << k);
        coverage = coverage || a == CANOPY_REGISTER_COVERAGE_0;
        changes = changes || a == CANOPY_REGISTER_CHANGED_0;
        anything = anything || a >= CANOPY_REGISTER_COVERAGE_0;
    }
    if (header == 0 && !anything)
        return 0;
    if (it->hold == FREE || (header & 1U) || (header & it->shown_header) || (blocks & it->shown_blocks) ||
        (coverage && it->shown_coverage) || (changes && it->shown_changes))
        *it = (struct reference_client){.hold = world->published ? HELD : FREE, .sequence = world->published};
    it->shown_header |= header;
    it->shown_blocks |= blocks;
    it->shown_coverage = it->shown_coverage || coverage;
    it->shown_changes = it->shown_changes || changes;
    return it->hold == HELD ? it->sequence : 0;
}

static uint16_t half(uint32_t value, bool low) { return (uint16_t)(low ? value : value >> 16); }

// Register `a` of the envelope with this sequence. Header registers that do not depend on it are not predicted.
static bool predict(const struct world *world, uint32_t sequence, uint32_t a, uint16_t *to) {
    if (a >= CANOPY_REGISTER_CHANGED_0) {  // every coefficient changes with every sequence
        const uint32_t item = (a - CANOPY_REGISTER_CHANGED_0) / 2;
        *to = half(item <= world->m && item < CANOPY_CHANGED_WORDS / 2 ? sequence : 0, a & 1U);
        return true;
    }
    if (a >= CANOPY_REGISTER_BLOCK_0) {
        const uint32_t k = (a - CANOPY_REGISTER_BLOCK_0) / CANOPY_BLOCK_STRIDE;
        const uint32_t word = (a - CANOPY_REGISTER_BLOCK_0) % CANOPY_BLOCK_STRIDE;
        const uint32_t index = k * CANOPY_PLC_BLOCK_COEFFICIENTS + word / 2 - 1;
        const bool there = sequence != 0 && k * CANOPY_PLC_BLOCK_COEFFICIENTS < count_of(world);
        if (word >= CANOPY_BLOCK_WORDS || k >= CANOPY_BLOCK_MAX)
            *to = 0;
        else if (word < 2)
            *to = half(there ? sequence : 0, word & 1U);
        else
            *to = half(there && index < count_of(world) ? coefficient(sequence, index) : INT32_MAX, word & 1U);
        return true;
    }
    if (a >= CANOPY_REGISTER_COVERAGE_0 && a < CANOPY_REGISTER_COVERAGE_0 + CANOPY_COVERAGE_WORDS) {
        const uint32_t word = a - CANOPY_REGISTER_COVERAGE_0;
        *to = word < 2 ? half(sequence, word & 1U) : 0;
        for (uint32_t bit = 0; word >= 2 && sequence != 0 && bit < 16; bit++) {
            const uint32_t cell = 16 * (word - 2) + bit;
            if (cell < cells_of(world) && covered(sequence, cell))
                *to = (uint16_t)(*to | 1U << bit);
        }
        return true;
    }
    const bool low = (a - CANOPY_REGISTER_SEQUENCE) & 1U;
    switch (a & ~1U) {
    case CANOPY_REGISTER_SEQUENCE: *to = half(sequence, low); return true;
    case CANOPY_REGISTER_POINTS: *to = half(sequence * 7, low); return true;
    case CANOPY_REGISTER_MARGIN: *to = half(sequence, low); return true;
    default: return false;
    }
}

// Between 100 and 199, and from the coverage blocks on.
static bool is_register(uint32_t a) {
    if (a >= CANOPY_REGISTER_CHANGED_0)
        return (a - CANOPY_REGISTER_CHANGED_0) % CANOPY_CHANGED_STRIDE < CANOPY_CHANGED_WORDS;
    if (a >= CANOPY_REGISTER_BLOCK_0 + CANOPY_BLOCK_MAX * CANOPY_BLOCK_STRIDE)
        return false;
    if (a >= CANOPY_REGISTER_BLOCK_0)
        return (a - CANOPY_REGISTER_BLOCK_0) % CANOPY_BLOCK_STRIDE < CANOPY_BLOCK_WORDS;
    if (a >= CANOPY_REGISTER_COVERAGE_0)
        return a < CANOPY_REGISTER_COVERAGE_0 + CANOPY_COVERAGE_WORDS;
    return (a >= 100 && a < 108) || (a >= 120 && a < 168) || (a >= 180 && a < 189);
}

// Reads and compares every register that can be predicted. Where there is no register nothing happens.
static void ask(struct world *world, uint8_t client, uint32_t address, uint32_t count) {
    uint8_t answer[2 * WORDS_MAX];
    const uint16_t heartbeat = world->heartbeat;
    bool any = false;
    for (uint32_t a = address; a < address + count; a++)
        any = any || is_register(a);
    const uint8_t exception = canopy_plc_read(&world->plc, client, (uint16_t)address, (uint16_t)count, answer);
    assert_int_equal(exception, any ? 0 : CANOPY_MODBUS_ILLEGAL_ADDRESS);
    if (!any)
        return;
    const uint32_t sequence = expected_sequence(world, &world->reference[client], address, address + count);
    for (uint32_t i = 0; i < count; i++) {
        uint16_t value = 0;
        const uint16_t got = (uint16_t)(answer[2 * i] << 8 | answer[2 * i + 1]);
        if (address + i == CANOPY_REGISTER_HEARTBEAT)
            assert_int_equal(got, (uint16_t)(heartbeat + 1));
        else if (address + i == CANOPY_REGISTER_STATUS)
            assert_int_equal(got, world->published ? CANOPY_PLC_VALID : 0);
        else if (predict(world, sequence, address + i, &value) && got != value)
            fail_msg("register %u: %04X instead of %04X of sequence %u", address + i, got, value, sequence);
    }
}

// Slots are neither lost nor counted twice.
static void check_slots(const struct world *world) {
    uint16_t holders[CLIENTS_MAX + 2] = {0};
    for (uint8_t c = 0; c < world->clients; c++)
        if (world->reference[c].hold == HELD) {
            const uint8_t slot = world->plc.clients[c].hold;
            assert_in_range(slot, 0, world->clients + 1);
            assert_int_equal(world->plc.slots[slot].sequence, world->reference[c].sequence);
            assert_int_not_equal(slot, world->plc.writing);
            holders[slot]++;
        }
    for (int slot = 0; slot < world->clients + 2; slot++)
        assert_int_equal(world->plc.slots[slot].holders, holders[slot]);
}

// ---------------------------------------------------------------------------------------------------------------------
// Every interleaving of a small model: two clients, two blocks

enum { SMALL_M = 4, SMALL_N = 16, SMALL_CLIENTS = 2, DEPTH = 24, PER_CLIENT = 8, OPERATIONS = 3 + 2 * PER_CLIENT };

static void operate(struct world *world, int operation) {
    static const struct {
        uint32_t address, count;
    } reads[PER_CLIENT - 1] = {
        {CANOPY_REGISTER_SEQUENCE, 44},
        {CANOPY_REGISTER_POINTS, 2},
        {CANOPY_REGISTER_HEARTBEAT, 8},
        {CANOPY_REGISTER_BLOCK_0, 124},
        {CANOPY_REGISTER_BLOCK_0 + CANOPY_BLOCK_STRIDE, 8},
        {CANOPY_REGISTER_BLOCK_0 + 62, 62},
        {CANOPY_REGISTER_COVERAGE_0, 5},
    };
    if (operation == 0)
        begin(world);
    else if (operation == 1)
        commit(world);
    else if (operation == 2)
        withdraw(world);
    else {
        const uint8_t client = (uint8_t)((operation - 3) / PER_CLIENT);
        const int which = (operation - 3) % PER_CLIENT;
        if (which == PER_CLIENT - 1)
            forget(world, client);
        else
            ask(world, client, reads[which].address, reads[which].count);
    }
    check_slots(world);
}

// All that the future of a world depends on, in the object and in the reference. Sequences count from the newest.
struct key {
    uint32_t held[SMALL_CLIENTS], object_held[SMALL_CLIENTS];
    uint64_t shown[SMALL_CLIENTS], object_shown[SMALL_CLIENTS];
    uint16_t blocks[SMALL_CLIENTS];
    uint8_t object_blocks[SMALL_CLIENTS], hold[SMALL_CLIENTS], object_hold[SMALL_CLIENTS];
    uint8_t published, begun, object_published, object_begun, same_slot[SMALL_CLIENTS];
};

static struct key key_of(const struct world *world) {
    struct key key;
    memset(&key, 0, sizeof key);  // with its padding: keys are compared as bytes
    for (int c = 0; c < SMALL_CLIENTS; c++) {
        const struct reference_client *it = &world->reference[c];
        const struct canopy_plc_client *object = &world->plc.clients[c];
        const bool holds = object->hold < world->plc.slot_count;
        key.hold[c] = (uint8_t)it->hold;
        key.held[c] = it->hold == HELD ? world->last - it->sequence : 0;
        key.shown[c] = it->shown_header;
        key.blocks[c] = (uint16_t)(it->shown_blocks | (it->shown_coverage ? 0x8000 : 0));
        key.object_hold[c] = holds ? 0 : object->hold;
        key.object_held[c] = holds ? world->last - world->plc.slots[object->hold].sequence : 0;
        key.object_shown[c] = object->shown;
        key.object_blocks[c] = object->shown_blocks[0];
        key.same_slot[c] = object->hold == world->plc.published;
    }
    key.published = world->published != 0;
    key.begun = world->begun;
    key.object_published = world->plc.published < world->plc.slot_count;
    key.object_begun = world->plc.writing < world->plc.slot_count;
    return key;
}

struct state {
    struct key key;
    uint8_t path[DEPTH];
    uint8_t depth;
};

// Open addressing; the states stand in the order in which they were found.
static struct {
    struct state *states;
    uint32_t *index;
    size_t count, room, mask;
} found;

static bool add(const struct state *state) {
    uint64_t hash = 14695981039346656037ULL;
    for (size_t i = 0; i < sizeof state->key; i++)
        hash = (hash ^ ((const uint8_t *)&state->key)[i]) * 1099511628211ULL;
    size_t at = (size_t)(hash ^ hash >> 29) & found.mask;
    for (; found.index[at] != 0; at = (at + 1) & found.mask)
        if (memcmp(&found.states[found.index[at] - 1].key, &state->key, sizeof state->key) == 0)
            return false;
    assert_true(found.count < found.room);
    found.states[found.count++] = *state;
    found.index[at] = (uint32_t)found.count;
    return true;
}

static void every_interleaving_of_a_small_model(void **unused) {
    (void)unused;
    found.room = 1U << 21;
    found.mask = 2 * found.room - 1;
    found.count = 0;
    found.states = malloc(found.room * sizeof *found.states);
    found.index = calloc(found.mask + 1, sizeof *found.index);
    assert_non_null(found.states);
    assert_non_null(found.index);
    const char *told = getenv("CANOPY_DEPTH");
    const int depth = told != NULL ? atoi(told) : 16;
    assert_in_range(depth, 1, DEPTH);
    static CANOPY_ARENA_DECLARE(arena, CANOPY_PLC_ARENA(SMALL_M, SMALL_N, SMALL_CLIENTS));
    static CANOPY_ARENA_DECLARE(kept, CANOPY_PLC_ARENA(SMALL_M, SMALL_N, SMALL_CLIENTS));
    static struct world world, before;
    start(&world, SMALL_M, SMALL_N, SMALL_CLIENTS, arena);
    struct state first = {.key = key_of(&world)};
    add(&first);
    size_t transitions = 0, expanded = 0;
    for (; expanded < found.count && found.states[expanded].depth < depth; expanded++) {
        struct state state = found.states[expanded];
        start(&world, SMALL_M, SMALL_N, SMALL_CLIENTS, arena);
        for (int i = 0; i < state.depth; i++)
            operate(&world, state.path[i]);
        before = world;
        memcpy(kept, arena, sizeof kept);
        for (int operation = 0; operation < OPERATIONS; operation++) {
            world = before;
            memcpy(arena, kept, sizeof kept);
            operate(&world, operation);
            struct state next = state;
            next.key = key_of(&world);
            next.path[next.depth++] = (uint8_t)operation;
            add(&next);
            transitions++;
        }
    }
    printf("# depth %d: %zu states, %zu transitions\n", depth, found.count, transitions);
    assert_true(found.count > 1000);
    free(found.states);
    free(found.index);
}

// ---------------------------------------------------------------------------------------------------------------------
// Random interleavings at full size: four clients that read whole envelopes, as PLCs do, and a station in between

enum { M = 20, N = 20, CLIENTS = 4, BLOCKS = 7, PIECES = BLOCKS + 2 };

static uint64_t seed = 0x9E3779B97F4A7C15ULL;

static uint32_t chance(uint32_t below) {
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (uint32_t)((seed >> 32) * below >> 32);
}

// A client's pass over an envelope: the header, then everything else in an order of its own.
struct pass {
    uint8_t order[PIECES];
    uint8_t next;
    uint32_t sequence;  // that the header said
    uint32_t seen;      // withdrawals and publications during the pass
    bool withdrawn, good;
};

static void shuffle(struct pass *pass) {
    for (uint8_t i = 0; i < PIECES; i++)
        pass->order[i] = i;
    for (uint32_t i = PIECES - 1; i > 1; i--) {
        const uint32_t j = 1 + chance(i);
        const uint8_t kept = pass->order[i];
        pass->order[i] = pass->order[j];
        pass->order[j] = kept;
    }
    pass->next = 0;
    pass->seen = 0;
    pass->withdrawn = false;
    pass->good = true;
}

static uint32_t piece_address(uint8_t piece) {
    if (piece == 0)
        return CANOPY_REGISTER_SEQUENCE;
    return piece <= BLOCKS ? CANOPY_REGISTER_BLOCK_0 + (piece - 1U) * CANOPY_BLOCK_STRIDE : CANOPY_REGISTER_COVERAGE_0;
}

static uint32_t sequence_read(struct world *world, uint8_t client, uint32_t address, uint32_t count) {
    uint8_t answer[2 * WORDS_MAX];
    const uint32_t expected = expected_sequence(world, &world->reference[client], address, address + count);
    assert_int_equal(canopy_plc_read(&world->plc, client, (uint16_t)address, (uint16_t)count, answer), 0);
    const uint32_t sequence =
        (uint32_t)answer[0] << 24 | (uint32_t)answer[1] << 16 | (uint32_t)answer[2] << 8 | answer[3];
    assert_int_equal(sequence, expected);
    for (uint32_t i = 0; i < count; i++) {
        uint16_t value = 0;
        if (predict(world, sequence, address + i, &value))
            assert_int_equal((uint16_t)(answer[2 * i] << 8 | answer[2 * i + 1]), value);
    }
    return sequence;
}

// One request of the pass. What a PLC may conclude is checked as it would check it: from sequence numbers alone.
static void advance(struct world *world, uint8_t client, struct pass *pass) {
    const uint8_t piece = pass->order[pass->next++];
    const uint32_t sequence = sequence_read(world, client, piece_address(piece), piece == 0 ? 44 : 124);
    if (piece == 0)
        pass->sequence = sequence;
    else if (sequence != pass->sequence) {
        // Only an envelope that came after none, or a withdrawal, can interrupt a pass.
        assert_true(pass->sequence == 0 || (sequence == 0 && pass->withdrawn));
        pass->good = false;
    } else if (sequence != 0)
        assert_false(pass->withdrawn);  // a withdrawal is seen by the next request
}

static void random_interleavings_at_full_size(void **unused) {
    (void)unused;
    const char *told = getenv("CANOPY_INTERLEAVINGS");
    const long wanted = told != NULL ? atol(told) : 100000;
    static CANOPY_ARENA_DECLARE(arena, CANOPY_PLC_ARENA(M, N, CLIENTS));
    static struct world world;
    start(&world, M, N, CLIENTS, arena);
    struct pass passes[CLIENTS];
    for (uint8_t c = 0; c < CLIENTS; c++)
        shuffle(&passes[c]);
    long done = 0, interrupted = 0, good = 0;
    while (done < wanted) {
        const uint32_t what = chance(64);
        if (what < 4) {
            const uint32_t last = world.last;
            begin(&world);
            if (chance(2)) {
                commit(&world);
                assert_int_equal(canopy_plc_sequence(&world.plc), last + 1);
                for (uint8_t c = 0; c < CLIENTS; c++)
                    passes[c].seen += passes[c].next > 0;
            }
        } else if (what == 4 && chance(4) == 0) {
            withdraw(&world);
            for (uint8_t c = 0; c < CLIENTS; c++) {
                passes[c].seen += passes[c].next > 0;
                passes[c].withdrawn = passes[c].next > 0;
            }
        } else if (what == 5) {
            const uint8_t client = (uint8_t)chance(CLIENTS);
            ask(&world, client, CANOPY_REGISTER_HEARTBEAT, 8);
        } else {
            const uint8_t client = (uint8_t)chance(CLIENTS);
            struct pass *pass = &passes[client];
            advance(&world, client, pass);
            if (pass->next == PIECES) {
                done++;
                interrupted += pass->seen > 0;
                good += pass->good && pass->sequence != 0;
                shuffle(pass);
            }
        }
        check_slots(&world);
    }
    printf("# %ld passes of 4 clients, %ld with publications or withdrawals within, %ld read whole\n", done,
           interrupted, good);
    assert_true(interrupted > wanted / 4);
    assert_true(good > wanted / 2);
}

// Requests of any place and length, in any order: the rule predicts each register.
static void random_requests(void **unused) {
    (void)unused;
    static CANOPY_ARENA_DECLARE(arena, CANOPY_PLC_ARENA(M, N, CLIENTS));
    static struct world world;
    start(&world, M, N, CLIENTS, arena);
    for (int i = 0; i < 60000; i++) {
        const uint32_t what = chance(16);
        const uint8_t client = (uint8_t)chance(CLIENTS);
        if (what == 0)
            begin(&world);
        else if (what == 1)
            commit(&world);
        else if (what == 2 && chance(8) == 0)
            withdraw(&world);
        else if (what == 3 && chance(8) == 0)
            forget(&world, client);
        else if (what < 6)
            ask(&world, client, 100 + chance(70), 1 + chance(60));
        else if (what == 8)
            ask(&world, client, CANOPY_REGISTER_CHANGED_0 - 2 + chance(40), 3 + chance(80));
        else if (what < 8)
            ask(&world, client, CANOPY_REGISTER_COVERAGE_0 - 20 + chance(60), 30 + chance(95));
        else
            ask(&world, client, CANOPY_REGISTER_BLOCK_0 + chance(9 * CANOPY_BLOCK_STRIDE), 2 + chance(124));
        check_slots(&world);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_interleaving_of_a_small_model),
        cmocka_unit_test(random_interleavings_at_full_size),
        cmocka_unit_test(random_requests),
    };
    return cmocka_run_group_tests_name("plc_interleavings", tests, NULL, NULL);
}
