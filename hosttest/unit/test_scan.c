// lib/scan against a fake scanner that is nothing but registers: every fault at every request.
#include "hosttest/unit/unit.h"
#include "lib/scan/generic.h"
#include "lib/scan/profile.h"

// ---------------------------------------------------------------------------------------------------------------------
// A fake scanner on the generic map, 400 columns unless told: x = -1000 + 7 c, z = 500 + 3 h, some columns without
// reading. Heights tell profile and column, so that a mixture of two profiles cannot go unseen.

#define COLUMNS 400
#define SPACE (CANOPY_GENERIC_HEIGHTS + COLUMNS + 2)

static uint16_t space[SPACE];
static uint64_t arena[CANOPY_PROFILE_ARENA(COLUMNS, 2) / 8];
static struct canopy_profile_driver driver;
static uint64_t now;

static void put32(unsigned address, int32_t value) {
    space[address] = (uint16_t)((uint32_t)value >> 16);
    space[address + 1] = (uint16_t)((uint32_t)value & 0xFFFFu);
}

static bool is_invalid(uint32_t sequence, unsigned column) { return (column * 7 + sequence) % 11 == 0; }

static uint16_t height_of(uint32_t sequence, unsigned column) {
    return is_invalid(sequence, column) ? CANOPY_GENERIC_INVALID : (uint16_t)(sequence * 31 + column * 2);
}

static uint16_t columns_now(void) { return space[CANOPY_GENERIC_D_COLUMNS]; }

static void fake_description(uint16_t id, uint16_t columns) {
    put32(CANOPY_GENERIC_D_MAGIC, (int32_t)CANOPY_GENERIC_MAGIC);
    space[CANOPY_GENERIC_D_VERSION] = CANOPY_GENERIC_VERSION;
    space[CANOPY_GENERIC_D_ID] = id;
    space[CANOPY_GENERIC_D_COLUMNS] = columns;
    space[CANOPY_GENERIC_D_PROFILES] = 40;
    put32(CANOPY_GENERIC_D_X_START, -1000);
    put32(CANOPY_GENERIC_D_X_STEP, 7);
    put32(CANOPY_GENERIC_D_Z_OFFSET, 500);
    space[CANOPY_GENERIC_D_Z_STEP] = 3;
    space[CANOPY_GENERIC_D_UNCERTAINTY] = 2;
    for (unsigned i = 0; i < 3; i++) {
        put32(CANOPY_GENERIC_D_LOW + 2 * i, -2000 - (int32_t)i);
        put32(CANOPY_GENERIC_D_HIGH + 2 * i, 70000 + (int32_t)i);
    }
    put32(CANOPY_GENERIC_D_UNIT, 0x3DCCCCCD);  // 0.1f
}

static void fake_heights(uint16_t sequence) {
    for (unsigned c = 0; c < columns_now(); c++)
        space[CANOPY_GENERIC_HEIGHTS + c] = height_of(sequence, c);
    space[CANOPY_GENERIC_HEIGHTS + columns_now()] = sequence;
}

static void fake_profile(uint16_t sequence) {
    uint16_t valid = 0;
    for (unsigned c = 0; c < columns_now(); c++)
        valid = (uint16_t)(valid + !is_invalid(sequence, c));
    const unsigned at = CANOPY_GENERIC_PROFILE;
    space[at + CANOPY_GENERIC_P_SEQUENCE] = sequence;
    space[at + CANOPY_GENERIC_P_ID] = space[CANOPY_GENERIC_D_ID];
    put32(at + CANOPY_GENERIC_P_POSITION, 100 * sequence);
    space[at + CANOPY_GENERIC_P_VALID] = valid;
    fake_heights(sequence);
}

static enum canopy_status start_with(const struct canopy_profile_table *table, uint16_t columns) {
    const struct canopy_profile_config config = {.table = table, .unit = 9, .columns = columns};
    now = 1000;
    return canopy_profile_init(&driver, &config, arena, sizeof arena, now);
}

static void start(uint16_t columns) {
    memset(space, 0, sizeof space);
    fake_description(1, columns);
    CHECK_EQ(start_with(&canopy_profile_generic, columns), CANOPY_OK);
}

// The next request, at the moment it is due.
static struct canopy_profile_request next(void) {
    struct canopy_profile_request request;
    if (!canopy_profile_next(&driver, now, &request)) {
        CHECK(request.due_us != CANOPY_PROFILE_NEVER);
        CHECK(request.due_us > now);
        now = request.due_us;
        CHECK(canopy_profile_next(&driver, now, &request));
    }
    CHECK(request.count >= 1);
    CHECK(request.count <= CANOPY_SCAN_READ_MAX);
    CHECK(request.address + request.count <= SPACE);
    return request;
}

static enum canopy_scan_event answer(void) {
    const struct canopy_profile_request request = next();
    now += 100;
    return canopy_profile_answer(&driver, space + request.address, request.count, now);
}

// Answers until something happens, at most `most` times.
static enum canopy_scan_event run(unsigned most) {
    enum canopy_scan_event event = CANOPY_SCAN_NOTHING;
    for (unsigned i = 0; i < most && event == CANOPY_SCAN_NOTHING; i++)
        event = answer();
    return event;
}

// The held profile is exactly the fake's profile `sequence`.
static void check_profile(uint16_t sequence) {
    const struct canopy_profile *profile = canopy_profile_get(&driver);
    CHECK(profile != NULL);
    CHECK_EQ(profile->sequence, sequence);
    CHECK_EQ(profile->y, 100 * sequence);
    CHECK_EQ(profile->columns, columns_now());
    unsigned valid = 0;
    for (uint16_t c = 0; c < profile->columns; c++) {
        struct canopy_reading reading;
        CHECK(canopy_profile_reading(&driver, c, &reading));
        CHECK_EQ(reading.valid, !is_invalid(sequence, c));
        CHECK_EQ(reading.reason, reading.valid ? CANOPY_READING_VALID : CANOPY_READING_NONE);
        CHECK_EQ(reading.x, reading.valid ? -1000 + 7 * (int32_t)c : 0);
        CHECK_EQ(reading.y, reading.valid ? 100 * (int32_t)sequence : 0);
        CHECK_EQ(reading.z, reading.valid ? 500 + 3 * (int32_t)height_of(sequence, c) : 0);
        CHECK_EQ(reading.uncertainty, reading.valid ? 2 : 0);
        valid += reading.valid;
    }
    CHECK_EQ(profile->valid, valid);
}

// Reads one whole profile without a fault.
static void deliver(uint16_t sequence) {
    fake_profile(sequence);
    CHECK_EQ(run(10), CANOPY_SCAN_PROFILE);
    check_profile(sequence);
    canopy_profile_done(&driver);
}

static void start_described(uint16_t columns) {
    start(columns);
    CHECK_EQ(answer(), CANOPY_SCAN_SCENE);
}

static uint32_t failures(void) {
    uint32_t sum = 0;
    for (int i = 0; i < CANOPY_SCAN_FAILURES; i++)
        sum += canopy_profile_counters(&driver)->failures[i];
    return sum;
}

// ---------------------------------------------------------------------------------------------------------------------

UNIT(drivers_are_found_by_name) {
    CHECK(canopy_profile_find("generic") == &canopy_profile_generic);
    CHECK(canopy_profile_find("Generic") == NULL);
    CHECK(canopy_profile_find("") == NULL);
    unsigned count = 0;
    while (canopy_profile_at(count) != NULL) {
        CHECK(canopy_profile_find(canopy_profile_at(count)->name) == canopy_profile_at(count));
        CHECK(canopy_scan_table_ok(canopy_profile_at(count)));  // what canopy_profile_init_known relies on
        count++;
    }
    CHECK(count >= 1);
}

UNIT(arena_is_checked) {
    struct canopy_profile_config config = {.table = &canopy_profile_generic, .columns = COLUMNS};
    const size_t size = CANOPY_PROFILE_ARENA(COLUMNS, 1);
    CHECK_EQ(canopy_profile_init(&driver, &config, arena, size, 0), CANOPY_OK);
    CHECK_EQ(canopy_profile_init(&driver, &config, arena, size - 1, 0), CANOPY_ARENA_SHORT);
    CHECK_EQ(canopy_profile_init(&driver, &config, arena, 0, 0), CANOPY_ARENA_SHORT);
    CHECK_EQ(canopy_profile_init(&driver, &config, NULL, size, 0), CANOPY_ARENA_SHORT);
    for (unsigned off = 1; off < 8; off++)
        CHECK_EQ(canopy_profile_init(&driver, &config, (uint8_t *)arena + off, size - 8, 0), CANOPY_ARENA_ALIGN);
    config.columns = 0;
    CHECK_EQ(canopy_profile_init(&driver, &config, arena, size, 0), CANOPY_ARGUMENT);
    config.columns = UINT16_MAX;
    CHECK_EQ(canopy_profile_init(&driver, &config, arena, SIZE_MAX, 0), CANOPY_ARGUMENT);
}

UNIT(contradictory_tables_are_refused) {
#define WRONG(change)                                                                                                  \
    do {                                                                                                               \
        struct canopy_profile_table table = canopy_profile_generic;                                                    \
        CHECK_EQ(start_with(&table, 10), CANOPY_OK);                                                                   \
        change;                                                                                                        \
        CHECK_EQ(start_with(&table, 10), CANOPY_ARGUMENT);                                                             \
    } while (0)
    WRONG(table.function = 6);
    WRONG(table.order = 2);
    WRONG(table.read_max = 126);
    WRONG(table.read_max = 0);
    WRONG(table.read_max = 20);  // less than the description
    WRONG(table.header.count = 0);
    WRONG(table.header.count = 126);
    WRONG(table.description.count = 27);  // the unit sticks out
    WRONG(table.sequence.where = CANOPY_SCAN_DESCRIPTION);
    WRONG(table.sequence.type = CANOPY_SCAN_I16);
    WRONG(table.sequence.offset = 5);
    WRONG(table.position.type = 9);
    WRONG(table.position.where = CANOPY_SCAN_ABSENT);
    WRONG(table.position.offset = 4);  // its second word sticks out
    WRONG(table.columns.where = 7);
    WRONG(table.valid.where = CANOPY_SCAN_DESCRIPTION);
    WRONG(table.header_description_id.where = CANOPY_SCAN_ABSENT);
    WRONG(table.low[1].where = CANOPY_SCAN_ABSENT);
    WRONG(table.high[2].where = CANOPY_SCAN_HEADER);
    WRONG(table.unit.type = CANOPY_SCAN_U16);
    WRONG(table.heights_type = 4);
    WRONG(table.invalid_count = CANOPY_SCAN_INVALID_MAX + 1);
    WRONG(table.height_low = 1);  // above height_high
    WRONG(table.z_divisor = -1);
    WRONG(table.heights_address = 0xFFFE);
    WRONG(table.trailer = 3);
    WRONG(table.trailer_type = CANOPY_SCAN_I16);
    WRONG(table.stale_us = 0);
}

UNIT(a_profile_is_read_in_four_blocks) {
    start(COLUMNS);
    struct canopy_profile_request request = next();
    CHECK_EQ(request.unit, 9);
    CHECK_EQ(request.function, 3);
    CHECK_EQ(request.address, CANOPY_GENERIC_DESCRIPTION);
    CHECK_EQ(request.count, CANOPY_GENERIC_D_COUNT);
    CHECK(canopy_profile_scene(&driver) == NULL);
    CHECK_EQ(answer(), CANOPY_SCAN_SCENE);
    const struct canopy_profile_scene *scene = canopy_profile_scene(&driver);
    CHECK(scene != NULL);
    for (int i = 0; i < 3; i++) {
        CHECK_EQ(scene->low[i], -2000 - i);
        CHECK_EQ(scene->high[i], 70000 + i);
    }
    CHECK_EQ(scene->profiles, 40);
    CHECK_EQ(scene->columns, COLUMNS);
    CHECK_EQ(scene->uncertainty, 2);
    const uint32_t tenth = 0x3DCCCCCD;
    CHECK_BYTES(&scene->unit, &tenth, sizeof tenth);
    fake_profile(5);
    // 5 + 400 + 1 registers: the first read carries header and heights, each next one is shorter
    const struct { unsigned address, count; } blocks[] = {{64, 125}, {189, 124}, {313, 123}, {436, 34}};
    unsigned wire = 0;
    for (unsigned i = 0; i < 4; i++) {
        request = next();
        wire += 8 + 5 + 2u * request.count;
        CHECK_EQ(request.address, blocks[i].address);
        CHECK_EQ(request.count, blocks[i].count);
        CHECK(canopy_profile_get(&driver) == NULL);
        CHECK_EQ(answer(), i < 3 ? CANOPY_SCAN_NOTHING : CANOPY_SCAN_PROFILE);
    }
    CHECK_EQ(wire, 864);
    check_profile(5);
    CHECK_EQ(canopy_profile_get(&driver)->time_us, now);
    // While it is held, nothing is requested and an answer is nobody's.
    CHECK(!canopy_profile_next(&driver, now + 1000000, &request));
    CHECK(request.due_us == CANOPY_PROFILE_NEVER);
    CHECK_EQ(canopy_profile_answer(&driver, space, 5, now), CANOPY_SCAN_NOTHING);
    CHECK_EQ(canopy_profile_failed(&driver, CANOPY_SCAN_TIMEOUT, now), CANOPY_SCAN_NOTHING);
    CHECK_EQ(canopy_profile_counters(&driver)->unexpected, 2);
    check_profile(5);
    struct canopy_reading reading = {.valid = true};
    CHECK(!canopy_profile_reading(&driver, COLUMNS, &reading));
    CHECK(!reading.valid);
    canopy_profile_done(&driver);
    CHECK(canopy_profile_get(&driver) == NULL);
    CHECK(!canopy_profile_reading(&driver, 0, &reading));
    CHECK_EQ(canopy_profile_counters(&driver)->profiles, 1);
    CHECK_EQ(canopy_profile_counters(&driver)->readings + canopy_profile_counters(&driver)->invalid, COLUMNS);
    CHECK_EQ(canopy_profile_errors(&driver), 0);
}

UNIT(block_lengths_differ_at_every_width) {
    for (uint16_t columns = 1; columns <= COLUMNS; columns++) {
        start_described(columns);
        fake_profile(1);
        uint16_t lengths[8];
        unsigned count = 0, sum = 0;
        enum canopy_scan_event event = CANOPY_SCAN_NOTHING;
        while (event == CANOPY_SCAN_NOTHING) {
            CHECK(count < 8);
            lengths[count] = next().count;
            for (unsigned i = 0; i < count; i++)
                CHECK(lengths[i] != lengths[count]);
            if (count > 0)
                CHECK(lengths[count] != CANOPY_GENERIC_P_COUNT && lengths[count] != CANOPY_GENERIC_D_COUNT);
            sum += lengths[count++];
            event = answer();
        }
        CHECK_EQ(event, CANOPY_SCAN_PROFILE);
        CHECK_EQ(sum, CANOPY_GENERIC_P_COUNT + columns + 1);
        CHECK(count <= (sum + 121) / 122 + 1);
        check_profile(1);
    }
}

UNIT(waiting_looks_at_the_header_only) {
    start_described(COLUMNS);
    deliver(7);
    CHECK_EQ(next().count, 125);  // the first look may already be the first block …
    CHECK_EQ(answer(), CANOPY_SCAN_NOTHING);
    for (int i = 0; i < 10; i++) {  // … but as long as nothing comes, a look is short and not too often
        const uint64_t before = now;
        CHECK_EQ(next().count, CANOPY_GENERIC_P_COUNT);
        CHECK_EQ(now - before, canopy_profile_generic.poll_us);
        CHECK_EQ(answer(), CANOPY_SCAN_NOTHING);
    }
    deliver(8);
    CHECK_EQ(next().count, CANOPY_GENERIC_P_COUNT);  // this scanner makes us wait
    deliver(9);
    CHECK_EQ(next().count, 125);  // now it does not
    CHECK_EQ(canopy_profile_counters(&driver)->profiles, 3);
    CHECK_EQ(canopy_profile_counters(&driver)->missed, 0);
}

UNIT(no_profile_yet_is_no_profile) {
    start_described(20);
    for (int i = 0; i < 5; i++)
        CHECK_EQ(answer(), CANOPY_SCAN_NOTHING);
    CHECK(canopy_profile_get(&driver) == NULL);
    deliver(1);
}

UNIT(torn_profiles_are_dropped_wherever_they_tear) {
    for (unsigned at = 0; at < 5; at++) {
        for (unsigned whole = 0; whole < 2; whole++) {
            start_described(COLUMNS);
            deliver(1);
            fake_profile(2);
            for (unsigned i = 0; i < at; i++)
                CHECK_EQ(answer(), i == 3 ? CANOPY_SCAN_PROFILE : CANOPY_SCAN_NOTHING);
            if (at == 4) {  // complete before it could tear
                check_profile(2);
                canopy_profile_done(&driver);
            }
            if (whole)
                fake_profile(3);  // header and all
            else
                fake_heights(3);  // the header lags behind
            if (at == 0 && !whole)
                fake_profile(3);  // nothing was read yet: a lagging header would only be an inconsistent profile
            const enum canopy_scan_event event = run(10);
            if (at >= 1 && at <= 3) {
                CHECK_EQ(event, CANOPY_SCAN_TORN);
                CHECK_EQ(canopy_profile_counters(&driver)->torn, 1);
                CHECK(canopy_profile_get(&driver) == NULL);
                deliver(3);
                CHECK_EQ(canopy_profile_counters(&driver)->missed, 1);
                CHECK_EQ(canopy_profile_errors(&driver), 1);
            } else if (at == 0 || whole) {
                CHECK_EQ(event, CANOPY_SCAN_PROFILE);
                check_profile(3);
                CHECK_EQ(canopy_profile_counters(&driver)->torn, 0);
            }
        }
    }
}

// A profile takes 4 reads of 100 us and stands for 600: read from any moment on it would be torn two times in three.
UNIT(a_scanner_little_slower_than_its_read_is_read_in_step) {
    struct canopy_profile_table table = canopy_profile_generic;
    table.poll_us = 10;
    memset(space, 0, sizeof space);
    fake_description(1, COLUMNS);
    CHECK_EQ(start_with(&table, COLUMNS), CANOPY_OK);
    CHECK_EQ(answer(), CANOPY_SCAN_SCENE);
    uint16_t standing = 0;
    unsigned delivered = 0;
    while (now < 200u * 600u) {
        const struct canopy_profile_request request = next();
        now += 100;
        const uint16_t sequence = (uint16_t)((now + 300) / 600);
        if (sequence != standing)
            fake_profile(standing = sequence);
        if (canopy_profile_answer(&driver, space + request.address, request.count, now) == CANOPY_SCAN_PROFILE) {
            delivered++;
            canopy_profile_done(&driver);
        }
    }
    CHECK(canopy_profile_counters(&driver)->torn >= 1);
    CHECK(canopy_profile_counters(&driver)->torn <= 10);
    CHECK(delivered >= 180);
}

UNIT(without_a_trailer_the_header_is_read_again) {
    struct canopy_profile_table table = canopy_profile_generic;
    table.trailer = CANOPY_SCAN_NO_TRAILER;
    for (unsigned tear = 0; tear < 2; tear++) {
        memset(space, 0, sizeof space);
        fake_description(1, 40);
        CHECK_EQ(start_with(&table, 40), CANOPY_OK);
        CHECK_EQ(answer(), CANOPY_SCAN_SCENE);
        fake_profile(4);
        CHECK_EQ(next().count, 45);
        CHECK_EQ(answer(), CANOPY_SCAN_NOTHING);
        CHECK_EQ(next().address, CANOPY_GENERIC_PROFILE);
        CHECK_EQ(next().count, CANOPY_GENERIC_P_COUNT);
        if (tear)
            fake_profile(5);
        CHECK_EQ(answer(), tear ? CANOPY_SCAN_TORN : CANOPY_SCAN_PROFILE);
        canopy_profile_done(&driver);
        deliver(6);
    }
}

UNIT(a_trailer_may_stand_anywhere) {
    struct canopy_profile_table table = canopy_profile_generic;
    table.trailer = CANOPY_SCAN_TRAILER_FIXED;
    table.trailer_address = 60;
    table.trailer_type = CANOPY_SCAN_U32;
    for (unsigned tear = 0; tear < 2; tear++) {
        memset(space, 0, sizeof space);
        fake_description(1, 40);
        CHECK_EQ(start_with(&table, 40), CANOPY_OK);
        CHECK_EQ(answer(), CANOPY_SCAN_SCENE);
        fake_profile(4);
        put32(60, tear ? 5 : 4);
        CHECK_EQ(answer(), CANOPY_SCAN_NOTHING);
        CHECK_EQ(next().address, 60);
        CHECK_EQ(next().count, 2);
        CHECK_EQ(answer(), tear ? CANOPY_SCAN_TORN : CANOPY_SCAN_PROFILE);
    }
}

UNIT(a_standing_sequence_is_stale_and_never_delivered_twice) {
    start_described(30);
    deliver(1);
    CHECK(!canopy_profile_stale(&driver, now));
    const uint64_t since = now;
    unsigned stale = 0;
    while (now < since + 3 * canopy_profile_generic.stale_us + 100000) {
        const enum canopy_scan_event event = answer();
        CHECK(event == CANOPY_SCAN_NOTHING || event == CANOPY_SCAN_STALE);
        stale += event == CANOPY_SCAN_STALE;
    }
    CHECK_EQ(stale, 3);
    CHECK_EQ(canopy_profile_counters(&driver)->stale, 3);
    CHECK_EQ(canopy_profile_counters(&driver)->profiles, 1);
    CHECK(canopy_profile_stale(&driver, now));
    deliver(2);
    CHECK(!canopy_profile_stale(&driver, now));
    CHECK(canopy_profile_stale(&driver, now + canopy_profile_generic.stale_us + 1));
}

UNIT(an_older_sequence_is_stale_until_it_goes_on) {
    start_described(30);
    deliver(100);
    fake_profile(99);  // an old frame once more
    CHECK_EQ(answer(), CANOPY_SCAN_STALE);
    CHECK_EQ(answer(), CANOPY_SCAN_NOTHING);
    deliver(101);
    CHECK_EQ(canopy_profile_counters(&driver)->missed, 0);
    fake_profile(1);  // a scanner that restarted
    CHECK_EQ(answer(), CANOPY_SCAN_STALE);
    CHECK_EQ(answer(), CANOPY_SCAN_NOTHING);
    deliver(2);
    CHECK_EQ(canopy_profile_counters(&driver)->missed, 0);
    CHECK_EQ(canopy_profile_counters(&driver)->stale, 2);
    fake_profile(40000);  // more than half around is older, too
    CHECK_EQ(answer(), CANOPY_SCAN_STALE);
    deliver(40001);
    CHECK_EQ(canopy_profile_counters(&driver)->missed, 0);
}

UNIT(a_restarted_scanner_that_waits_to_be_read_is_read) {
    start_described(30);
    deliver(100);
    fake_profile(1);
    const uint64_t since = now;
    enum canopy_scan_event event = CANOPY_SCAN_NOTHING;
    while (event != CANOPY_SCAN_PROFILE && now < since + 10 * canopy_profile_generic.stale_us)
        event = answer();
    CHECK_EQ(event, CANOPY_SCAN_PROFILE);
    check_profile(1);
    CHECK(now - since >= canopy_profile_generic.stale_us);
    CHECK(now - since < 2 * canopy_profile_generic.stale_us);
    canopy_profile_done(&driver);
    deliver(2);
}

UNIT(missed_profiles_are_counted_across_the_wrap) {
    start_described(12);
    deliver(65533);
    deliver(65535);
    CHECK_EQ(canopy_profile_counters(&driver)->missed, 1);
    deliver(1);  // 0 is no profile: nothing missed
    CHECK_EQ(canopy_profile_counters(&driver)->missed, 1);
    deliver(5);
    CHECK_EQ(canopy_profile_counters(&driver)->missed, 4);
    deliver(6);
    CHECK_EQ(canopy_profile_counters(&driver)->missed, 4);
}

UNIT(another_valid_count_than_promised_is_short) {
    for (int wrong = -1; wrong <= 1; wrong += 2) {
        start_described(COLUMNS);
        fake_profile(3);
        uint16_t *promised = &space[CANOPY_GENERIC_PROFILE + CANOPY_GENERIC_P_VALID];
        *promised = (uint16_t)(*promised + wrong);
        CHECK_EQ(run(10), CANOPY_SCAN_SHORT);
        CHECK(canopy_profile_get(&driver) == NULL);
        CHECK_EQ(canopy_profile_counters(&driver)->short_of, 1);
        CHECK_EQ(canopy_profile_counters(&driver)->profiles, 0);
        deliver(3);  // once it is whole it is taken, under the same number
    }
}

UNIT(a_scanner_that_is_another_device_is_refused) {
    const struct {
        unsigned address;
        uint16_t value;
    } wrongs[] = {
        {CANOPY_GENERIC_D_MAGIC, 0x4242},  {CANOPY_GENERIC_D_COLUMNS, 31},  // more than the arena
        {CANOPY_GENERIC_D_COLUMNS, 0},                                      // none
        {CANOPY_GENERIC_D_UNIT, 0xBDCC},                                    // negative
        {CANOPY_GENERIC_D_UNIT, 0x7FC0},                                    // not a number
        {CANOPY_GENERIC_D_LOW, 0x7FFF},                                     // above high
        {CANOPY_GENERIC_D_UNCERTAINTY, 0},                                  // fine: see below
    };
    for (unsigned i = 0; i < sizeof wrongs / sizeof wrongs[0]; i++) {
        const bool fine = i + 1 == sizeof wrongs / sizeof wrongs[0];
        start(30);
        const uint16_t right = space[wrongs[i].address];
        space[wrongs[i].address] = wrongs[i].value;
        CHECK_EQ(answer(), fine ? CANOPY_SCAN_SCENE : CANOPY_SCAN_REFUSED);
        CHECK_EQ(canopy_profile_counters(&driver)->refused, !fine);
        CHECK_EQ(canopy_profile_scene(&driver) != NULL, fine);
        space[wrongs[i].address] = right;
        if (!fine)
            CHECK_EQ(run(4), CANOPY_SCAN_SCENE);
    }
    // What only shows with the first profile: steps that cannot be.
    start(30);
    space[CANOPY_GENERIC_D_Z_STEP] = 0;
    CHECK_EQ(answer(), CANOPY_SCAN_SCENE);
    fake_profile(1);
    CHECK_EQ(answer(), CANOPY_SCAN_REFUSED);
    fake_description(2, 30);
    CHECK_EQ(run(3), CANOPY_SCAN_SCENE);
    deliver(1);
}

UNIT(a_changed_description_is_read_again) {
    start_described(30);
    deliver(500);
    fake_description(2, 20);
    fake_profile(3);  // another scene: an older number means nothing
    CHECK_EQ(run(4), CANOPY_SCAN_SCENE);
    CHECK_EQ(canopy_profile_scene(&driver)->columns, 20);
    CHECK_EQ(run(5), CANOPY_SCAN_PROFILE);
    check_profile(3);
    CHECK_EQ(canopy_profile_counters(&driver)->missed, 0);
}

// Every number of registers but the right one, at every request of a profile, description included.
UNIT(only_the_right_length_is_an_answer) {
    for (unsigned at = 0; at < 5; at++) {
        for (size_t length = 0; length <= CANOPY_SCAN_READ_MAX + 1; length++) {
            start(COLUMNS);
            fake_profile(1);
            for (unsigned i = 0; i < at; i++)
                answer();
            const struct canopy_profile_request request = next();
            if (length == request.count)
                continue;
            const enum canopy_scan_event event =
                canopy_profile_answer(&driver, space + SPACE - (CANOPY_SCAN_READ_MAX + 1), length, now);
            CHECK_EQ(event, CANOPY_SCAN_RETRY);
            CHECK_EQ(canopy_profile_counters(&driver)->failures[CANOPY_SCAN_LENGTH], 1);
            const struct canopy_profile_request again = next();
            CHECK_EQ(again.address, request.address);
            CHECK_EQ(again.count, request.count);
            while (canopy_profile_get(&driver) == NULL)
                answer();
            check_profile(1);
            CHECK_EQ(failures(), 1);
        }
    }
}

// Every failure at every request, once to three times in a row: repeated, then given up, then well again.
UNIT(every_failure_at_every_request_is_survived) {
    const unsigned retries = canopy_profile_generic.retries;
    for (unsigned failure = 0; failure < CANOPY_SCAN_FAILURES; failure++) {
        for (unsigned at = 0; at < 5; at++) {
            for (unsigned times = 1; times <= 2 * retries + 1; times++) {
                start(COLUMNS);
                fake_profile(1);
                for (unsigned i = 0; i < at; i++)
                    answer();
                for (unsigned i = 1; i <= times; i++) {
                    next();
                    const enum canopy_scan_event event =
                        canopy_profile_failed(&driver, (enum canopy_scan_failure)failure, now);
                    CHECK_EQ(event, i % (retries + 1) == 0 ? CANOPY_SCAN_DROPPED : CANOPY_SCAN_RETRY);
                    struct canopy_profile_request request;
                    CHECK(!canopy_profile_next(&driver, now, &request));
                    CHECK_EQ(request.due_us - now, canopy_profile_generic.retry_us);
                    CHECK(canopy_profile_get(&driver) == NULL);
                }
                CHECK_EQ(canopy_profile_counters(&driver)->failures[failure], times);
                CHECK_EQ(canopy_profile_counters(&driver)->last_failure, 1 + failure);
                CHECK_EQ(canopy_profile_counters(&driver)->dropped, times / (retries + 1));
                CHECK_EQ(canopy_profile_errors(&driver), times);
                while (canopy_profile_get(&driver) == NULL)
                    answer();
                check_profile(1);
                canopy_profile_done(&driver);
                deliver(2);
            }
        }
    }
}

UNIT(silence_is_stale_too) {
    start_described(30);
    deliver(1);
    const uint64_t since = now;
    while (now < since + canopy_profile_generic.stale_us + 50000) {
        next();
        canopy_profile_failed(&driver, CANOPY_SCAN_TIMEOUT, now);
    }
    CHECK(canopy_profile_stale(&driver, now));
    CHECK_EQ(canopy_profile_counters(&driver)->stale, 1);
    CHECK(canopy_profile_scene(&driver) != NULL);
}

// ---------------------------------------------------------------------------------------------------------------------
// Types, orders, scales: a device without description, everything in header and table.

static const struct canopy_profile_table plain = {
    .name = "plain",
    .title = "a device of the test",
    .function = 4,
    .read_max = 16,
    .header = {10, 2},
    .sequence = {.where = CANOPY_SCAN_HEADER, .type = CANOPY_SCAN_U32},
    .position = {.where = CANOPY_SCAN_CONSTANT, .constant = -77},
    .columns = {.where = CANOPY_SCAN_CONSTANT, .constant = 5},
    .x_start = {.where = CANOPY_SCAN_CONSTANT, .constant = 40},
    .x_step = {.where = CANOPY_SCAN_CONSTANT, .constant = -20},
    .z_offset = {.where = CANOPY_SCAN_CONSTANT, .constant = 0},
    .heights_address = 30,
    .stale_us = 1000000,
};

// Reads one profile of `table` from `heights` (already words) and decodes it.
static void read_plain(const struct canopy_profile_table *table, const uint16_t *heights, unsigned words,
                       struct canopy_reading *to) {
    CHECK_EQ(start_with(table, 5), CANOPY_OK);
    memset(space, 0, sizeof space);
    space[10] = table->order == CANOPY_SCAN_CDAB ? 2 : 1;
    space[11] = table->order == CANOPY_SCAN_CDAB ? 1 : 2;
    memcpy(space + 30, heights, (size_t)5 * words * sizeof *heights);
    CHECK_EQ(run(10), CANOPY_SCAN_PROFILE);
    CHECK_EQ(canopy_profile_get(&driver)->sequence, 0x10002);
    for (uint16_t c = 0; c < 5; c++)
        CHECK(canopy_profile_reading(&driver, c, &to[c]));
}

UNIT(every_type_and_word_order) {
    const int64_t values[4][5] = {
        {0, 1, 0x7FFF, 0x8000, 0xFFFF},
        {0, 1, 0x7FFF, -0x8000, -1},
        {0, 1, 0x7FFFFFFF, 0x12345678, 0x10000},
        {0, 1, 0x7FFFFFFF, -0x7FFFFFFF - 1, -2},
    };
    for (uint8_t order = CANOPY_SCAN_ABCD; order <= CANOPY_SCAN_CDAB; order++) {
        for (uint8_t type = CANOPY_SCAN_U16; type <= CANOPY_SCAN_I32; type++) {
            struct canopy_profile_table table = plain;
            struct canopy_reading readings[5];
            uint16_t words[10];
            const unsigned width = type >= CANOPY_SCAN_U32 ? 2 : 1;
            table.order = order;
            table.heights_type = type;
            for (unsigned c = 0; c < 5; c++) {
                const uint32_t bits = (uint32_t)((uint64_t)values[type][c] & 0xFFFFFFFFu);
                const bool swap = order == CANOPY_SCAN_CDAB && width == 2;
                words[c * width] = (uint16_t)(width == 1 || swap ? bits & 0xFFFFu : bits >> 16);
                if (width == 2)
                    words[c * 2 + 1] = (uint16_t)(swap ? bits >> 16 : bits & 0xFFFFu);
            }
            read_plain(&table, words, width, readings);
            for (unsigned c = 0; c < 5; c++) {
                CHECK(readings[c].valid);
                CHECK_EQ(readings[c].x, 40 - 20 * (int32_t)c);
                CHECK_EQ(readings[c].y, -77);
                CHECK_EQ(readings[c].z, values[type][c]);
                CHECK_EQ(readings[c].uncertainty, 0);
            }
        }
    }
}

UNIT(an_invalid_reading_has_a_reason_and_no_height) {
    struct canopy_profile_table table = plain;
    struct canopy_reading readings[5];
    table.heights_type = CANOPY_SCAN_I16;
    table.invalid_count = 2;
    table.invalid[0] = -1;
    table.invalid[1] = 4500;
    table.height_low = -100;
    table.height_high = 5000;
    const uint16_t heights[] = {0xFFFF, 4500, 5001, (uint16_t)-101, 4501};
    read_plain(&table, heights, 1, readings);
    const uint8_t reasons[] = {CANOPY_READING_NONE, CANOPY_READING_NONE, CANOPY_READING_LIMIT, CANOPY_READING_LIMIT,
                               CANOPY_READING_VALID};
    for (unsigned c = 0; c < 5; c++) {
        CHECK_EQ(readings[c].reason, reasons[c]);
        CHECK_EQ(readings[c].valid, c == 4);
        CHECK_EQ(readings[c].z, c == 4 ? 4501 : 0);
    }
    CHECK_EQ(canopy_profile_get(&driver)->valid, 1);
    CHECK_EQ(canopy_profile_counters(&driver)->invalid, 4);
}

UNIT(a_divided_scale_rounds_down_and_says_so) {
    struct canopy_profile_table table = plain;
    struct canopy_reading readings[5];
    table.heights_type = CANOPY_SCAN_I16;
    table.z_step = (struct canopy_scan_field){.where = CANOPY_SCAN_CONSTANT, .constant = 3};
    table.z_divisor = 4;
    table.z_offset.constant = 10;
    table.uncertainty = (struct canopy_scan_field){.where = CANOPY_SCAN_CONSTANT, .constant = 6};
    const uint16_t heights[] = {0, 1, 4, (uint16_t)-1, (uint16_t)-4};  // 0, 0.75, 3, -0.75, -3
    const int32_t z[] = {10, 10, 13, 9, 7};
    const uint32_t uncertainty[] = {6, 7, 6, 7, 6};
    read_plain(&table, heights, 1, readings);
    for (unsigned c = 0; c < 5; c++) {
        CHECK_EQ(readings[c].z, z[c]);
        CHECK_EQ(readings[c].uncertainty, uncertainty[c]);
    }
}

UNIT(what_does_not_fit_int32_is_invalid) {
    struct canopy_profile_table table = plain;
    struct canopy_reading readings[5];
    table.heights_type = CANOPY_SCAN_U32;
    table.z_offset.constant = 1;
    const uint16_t heights[] = {0x7FFF, 0xFFFF, 0x7FFF, 0xFFFE, 0xFFFF, 0xFFFF, 0, 0, 0, 1};
    read_plain(&table, heights, 2, readings);
    const bool valid[] = {false, true, false, true, true};
    for (unsigned c = 0; c < 5; c++) {
        CHECK_EQ(readings[c].valid, valid[c]);
        CHECK_EQ(readings[c].reason, valid[c] ? CANOPY_READING_VALID : CANOPY_READING_OVERFLOW);
    }
    CHECK_EQ(readings[1].z, INT32_MAX);
    table.z_step = (struct canopy_scan_field){.where = CANOPY_SCAN_CONSTANT, .constant = 1 << 30};
    read_plain(&table, heights, 2, readings);
    CHECK(!readings[0].valid && !readings[1].valid && !readings[2].valid && readings[3].valid);
    CHECK_EQ(readings[4].z, (1 << 30) + 1);
    table.x_start.constant = INT32_MIN + 50;
    read_plain(&table, heights, 2, readings);
    CHECK(readings[3].valid == false && readings[4].valid == false);
    CHECK_EQ(readings[3].reason, CANOPY_READING_OVERFLOW);
}

UNIT(a_multiplier_that_overflows_refuses_the_header) {
    struct canopy_profile_table table = canopy_profile_generic;
    table.position.multiplier = 1000;
    memset(space, 0, sizeof space);
    fake_description(1, 10);
    CHECK_EQ(start_with(&table, 10), CANOPY_OK);
    CHECK_EQ(answer(), CANOPY_SCAN_SCENE);
    fake_profile(1);
    put32(CANOPY_GENERIC_PROFILE + CANOPY_GENERIC_P_POSITION, 2147484);
    CHECK_EQ(answer(), CANOPY_SCAN_REFUSED);
    put32(CANOPY_GENERIC_PROFILE + CANOPY_GENERIC_P_POSITION, -2147483);
    CHECK_EQ(run(1), CANOPY_SCAN_STALE);  // the description once more, after the stale limit
    CHECK_EQ(run(5), CANOPY_SCAN_PROFILE);
    CHECK_EQ(canopy_profile_get(&driver)->y, -2147483000);
}

UNIT_LIST(scan, drivers_are_found_by_name, arena_is_checked, contradictory_tables_are_refused,
          a_profile_is_read_in_four_blocks, block_lengths_differ_at_every_width, waiting_looks_at_the_header_only,
          no_profile_yet_is_no_profile, torn_profiles_are_dropped_wherever_they_tear,
          a_scanner_little_slower_than_its_read_is_read_in_step, without_a_trailer_the_header_is_read_again,
          a_trailer_may_stand_anywhere, a_standing_sequence_is_stale_and_never_delivered_twice,
          an_older_sequence_is_stale_until_it_goes_on, a_restarted_scanner_that_waits_to_be_read_is_read,
          missed_profiles_are_counted_across_the_wrap, another_valid_count_than_promised_is_short,
          a_scanner_that_is_another_device_is_refused, a_changed_description_is_read_again,
          only_the_right_length_is_an_answer, every_failure_at_every_request_is_survived, silence_is_stale_too,
          every_type_and_word_order, an_invalid_reading_has_a_reason_and_no_height,
          a_divided_scale_rounds_down_and_says_so, what_does_not_fit_int32_is_invalid,
          a_multiplier_that_overflows_refuses_the_header)
