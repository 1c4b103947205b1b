// The power goes at every step of every erasure and programming: the next start finds the old record or the new one.
//
// The flash is a model that shares nothing with the store. What was interrupted is torn: its bits are the old ones, the
// new ones, or unstable, which read as something else each time. Programming only clears bits; erasing first clears
// what it likes. A run is a chain of starts and writes with a cut in most of them, also while a start settles things.
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

#include "lib/plc/store.h"

enum { PAGES = 2, PAGE = 512, ERASE_STEPS = 64 };

// ---------------------------------------------------------------------------------------------------------------------
// The flash

static struct {
    uint8_t solid[PAGES][PAGE];
    uint8_t unstable[PAGES][PAGE];  // bits that read as anything
    uint32_t page_bytes, unit;
    long steps;    // done so far
    long cut;      // no power from this step on
    long refuse;   // so many operations succeed, then one fails with its status and without effect
    bool off;      // the power is gone: nothing has an effect any more, what is called does not matter
    jmp_buf dark;  // … because the program does not go on either
    uint32_t erased[PAGES];
    bool parallel;  // a unit is programmed at once, not bit by bit
} model;

static uint64_t seed;

static uint32_t any(void) {
    seed = seed * 6364136223846793005U + 1442695040888963407U;
    return (uint32_t)(seed >> 32);
}

static uint8_t any_byte(void) { return (uint8_t)(any() >> 13); }

static enum canopy_status model_read(void *context, uint32_t page, uint32_t offset, uint8_t *to, uint32_t length) {
    (void)context;
    if (page >= PAGES || offset > model.page_bytes || length > model.page_bytes - offset)
        return CANOPY_ARGUMENT;
    for (uint32_t i = 0; i < length; i++) {
        const uint8_t unstable = model.unstable[page][offset + i];
        to[i] = (uint8_t)((model.solid[page][offset + i] & ~unstable) | (any_byte() & unstable));
    }
    return CANOPY_OK;
}

static bool fails(void) { return model.refuse-- == 0; }

// Of `bits` that are on their way to `to`: some have arrived, some have not begun, some are between.
static void tear(uint8_t *solid, uint8_t *unstable, uint8_t bits, uint8_t to) {
    const uint32_t how = any() % 4;  // hardly begun, nearly done, or anything
    const uint8_t moved = how == 0   ? (uint8_t)(any_byte() & any_byte() & any_byte())
                          : how == 1 ? (uint8_t)(any_byte() | any_byte() | any_byte())
                                     : any_byte();
    *solid = (uint8_t)((*solid & ~(bits & moved)) | (to & bits & moved));
    *unstable |= (uint8_t)(bits & (how == 0 || how == 1 ? any_byte() & any_byte() : any_byte()));
}

static _Noreturn void darkness(void) { longjmp(model.dark, 1); }

static enum canopy_status model_erase(void *context, uint32_t page) {
    (void)context;
    if (page >= PAGES)
        return CANOPY_ARGUMENT;
    if (fails())
        return CANOPY_RANGE;
    model.erased[page]++;
    if (model.steps + ERASE_STEPS > model.cut) {
        const long done = model.cut - model.steps;
        const uint32_t manner = any() % 3;
        for (uint32_t i = 0; i < model.page_bytes; i++) {
            uint8_t *solid = &model.solid[page][i], *unstable = &model.unstable[page][i];
            if (done == 0 || manner == 0)  // the weakest beginning: a bit here and there
                *unstable |= (uint8_t)(any() % 16 == 0 ? any_byte() & any_byte() : 0);
            else if (manner == 1)  // the weakest end: all but a bit here and there
                *solid = 0xFF, *unstable = (uint8_t)(any() % 16 == 0 ? any_byte() & any_byte() : 0);
            else
                tear(solid, unstable, 0xFF, any_byte() & 1 ? 0xFF : 0x00);
        }
        model.steps = model.cut;
        darkness();
    }
    model.steps += ERASE_STEPS;
    memset(model.solid[page], 0xFF, model.page_bytes);
    memset(model.unstable[page], 0, model.page_bytes);
    return CANOPY_OK;
}

static enum canopy_status model_program(void *context, uint32_t page, uint32_t offset, const uint8_t *from,
                                        uint32_t length) {
    (void)context;
    assert_int_equal(offset % model.unit, 0);
    assert_int_equal(length % model.unit, 0);
    if (page >= PAGES || offset > model.page_bytes || length > model.page_bytes - offset)
        return CANOPY_ARGUMENT;
    if (fails())
        return CANOPY_RANGE;
    const long steps = 8 * (long)length, left = model.cut - model.steps;
    uint8_t *solid = &model.solid[page][offset], *unstable = &model.unstable[page][offset];
    for (uint32_t i = 0; i < length; i++) {
        const uint8_t clear = (uint8_t)~from[i];
        const long bits = left - 8 * (long)i;  // of this byte that there is power for
        if (steps <= left || (!model.parallel && bits >= 8)) {
            solid[i] &= (uint8_t)~clear;
            unstable[i] &= (uint8_t)~clear;
        } else if (model.parallel) {
            tear(&solid[i], &unstable[i], clear & (solid[i] | unstable[i]), 0);
        } else if (bits >= 0) {
            const uint8_t done = (uint8_t)(clear & ((1U << bits) - 1U)), now = (uint8_t)(clear & (1U << bits));
            solid[i] &= (uint8_t)~done;
            unstable[i] = (uint8_t)((unstable[i] & ~done) | (now & (solid[i] | unstable[i])));
        }
    }
    if (steps > left) {
        model.steps = model.cut;
        darkness();
    }
    model.steps += steps;
    return CANOPY_OK;
}

static struct canopy_flash flash;

static void make(uint32_t page_bytes, uint32_t unit) {
    memset(&model, 0, sizeof model);
    for (uint32_t page = 0; page < PAGES; page++)
        memset(model.solid[page], 0xFF, page_bytes);
    model.page_bytes = page_bytes;
    model.unit = unit;
    model.cut = model.refuse = 1L << 60;
    flash = (struct canopy_flash){.page_bytes = page_bytes,
                                  .program_bytes = unit,
                                  .page_count = PAGES,
                                  .read = model_read,
                                  .erase = model_erase,
                                  .program = model_program};
}

// ---------------------------------------------------------------------------------------------------------------------
// The program

// Record `id` is a payload that only it has; 0 is none.
static uint16_t payload_of(uint32_t id, uint8_t *to) {
    uint32_t state = id * 2654435761U + 12345U;
    const uint16_t length = (uint16_t)(id % 7 == 3 ? CANOPY_STORE_PAYLOAD : 4 + id * 5 % 90);
    for (uint16_t i = 0; i < length; i++) {
        state = state * 1664525U + 1013904223U;
        to[i] = (uint8_t)(state >> 24);
    }
    memcpy(to, &id, 4);
    return length;
}

static uint32_t id_of(const struct canopy_store_record *found) {
    uint8_t expected[CANOPY_STORE_PAYLOAD];
    uint32_t id;
    if (found->state != CANOPY_STORE_GOOD && found->state != CANOPY_STORE_ONE)
        return 0;
    assert_in_range(found->length, 4, CANOPY_STORE_PAYLOAD);
    memcpy(&id, found->payload, 4);
    assert_int_equal(found->length, payload_of(id, expected));
    assert_int_equal(found->version, (uint16_t)(id * 3));
    assert_memory_equal(found->payload, expected, found->length);
    return id;
}

static struct canopy_store store;

// False: the power went.
static bool start(long power, struct canopy_store_record *found, uint32_t *id) {
    static uint8_t scratch[CANOPY_STORE_OPEN_SCRATCH];
    model.cut = model.steps + power;
    if (setjmp(model.dark) != 0)
        return false;
    memset(scratch, 0x77, sizeof scratch);
    *found = canopy_store_open(&store, &flash, scratch);
    *id = id_of(found);
    return true;
}

static enum canopy_status write_all(uint32_t id) {
    uint8_t payload[CANOPY_STORE_PAYLOAD], scratch[CANOPY_STORE_STEP_SCRATCH];
    const uint16_t length = payload_of(id, payload);
    assert_true(canopy_store_begin(&store));
    enum canopy_status status = CANOPY_MORE;
    while (status == CANOPY_MORE) {
        const uint32_t erased = model.erased[0] + model.erased[1];
        memset(scratch, 0x77, sizeof scratch);  // nothing is kept in it
        status = canopy_store_step(&store, (uint16_t)(id * 3), payload, length, scratch);
        assert_in_range(model.erased[0] + model.erased[1] - erased, 0, 1);
    }
    assert_false(canopy_store_is_writing(&store));
    return status;
}

// False: the power went.
static bool write_until(long power, uint32_t id) {
    model.cut = model.steps + power;
    if (setjmp(model.dark) != 0)
        return false;
    assert_int_equal(write_all(id), CANOPY_OK);
    return true;
}

static const long FOREVER = 1L << 59;

static long steps_of_a_write(void) {
    const long before = model.steps;
    assert_true(write_until(FOREVER, 77));
    return model.steps - before;
}

// A start after which nothing but the start itself may have been cut. Returns what is in force.
static uint32_t start_surely(struct canopy_store_record *found, long *cuts) {
    uint32_t id = 0;
    while (any() % 4 == 0)
        if (!start((long)(any() % 80), found, &id))
            ++*cuts;
    assert_true(start(FOREVER, found, &id));
    return id;
}

// A chain: what is in force is what it was, or what was being written when the power went, for good.
static void run_chain(uint32_t first, long cut, long length_of_write, long *cuts) {
    struct canopy_store_record found;
    uint32_t force, id = 1000;
    for (uint32_t i = 1; i <= first; i++) {
        uint32_t old;
        assert_true(start(FOREVER, &found, &old));
        assert_int_equal(old, i - 1);
        assert_true(write_until(FOREVER, i));
    }
    force = first;
    assert_true(start(FOREVER, &found, &id));
    assert_int_equal(id, first);
    id = 1000;
    for (int round = 0; round < 3; round++, id++) {
        const bool whole = write_until(round == 0 ? cut : (long)(any() % (uint32_t)length_of_write), id);
        *cuts += !whole;
        const uint32_t now = start_surely(&found, cuts);
        if (now != id && (whole || now != force))
            fail_msg("step %ld, round %d: neither the old record (%u) nor the new (%u) but %u", cut, round, force, id,
                     now);
        if (whole)
            assert_int_equal(found.state, CANOPY_STORE_GOOD);
        force = now;
        for (int again = 0; again < 2; again++)
            if (start_surely(&found, cuts) != force)
                fail_msg("step %ld, round %d: a start decides otherwise than the one before", cut, round);
    }
    assert_true(write_until(FOREVER, id));  // heals whatever there is
    assert_int_equal(start_surely(&found, cuts), id);
    assert_int_equal(found.state, CANOPY_STORE_GOOD);
}

static const struct {
    uint32_t page_bytes, unit;
    int seeds;
} shapes[] = {{512, 1, 4}, {512, 256, 3}, {256, 8, 3}};

static void the_power_goes_at_every_step(void **unused) {
    (void)unused;
    long runs = 0, cuts = 0;
    for (size_t s = 0; s < sizeof shapes / sizeof shapes[0]; s++) {
        make(shapes[s].page_bytes, shapes[s].unit);
        uint32_t id;
        struct canopy_store_record found;
        assert_true(start(FOREVER, &found, &id));
        assert_int_equal(found.state, CANOPY_STORE_EMPTY);
        const long length = steps_of_a_write();
        for (uint32_t first = 0; first < 3; first++)
            for (long cut = 0; cut <= length; cut++)
                for (int k = 0; k < shapes[s].seeds; k++, runs++) {
                    make(shapes[s].page_bytes, shapes[s].unit);
                    model.parallel = k % 2 == 1;
                    seed = (uint64_t)cut * 1000003U + (uint64_t)k * 101U + first;
                    run_chain(first, cut, length, &cuts);
                }
    }
    printf("# %ld runs, %ld cuts\n", runs, cuts);
    assert_in_range(runs, 100000, 10000000);
}

// ---------------------------------------------------------------------------------------------------------------------
// Rot: bits that change by themselves

static void flip(uint32_t page, uint32_t bits, uint32_t bytes) {
    for (uint32_t i = 0; i < bits; i++) {
        const uint32_t at = any() % bytes;
        model.solid[page][at] ^= (uint8_t)(1U << (any() % 8));
    }
}

static void one_damaged_copy_is_told_and_mended(void **unused) {
    (void)unused;
    struct canopy_store_record found;
    uint32_t id;
    long told = 0;
    for (uint32_t run = 0; run < 20000; run++) {
        seed = run;
        make(512, run % 2 ? 1 : 256);
        assert_true(start(FOREVER, &found, &id));
        assert_true(write_until(FOREVER, 5));
        flip(run / 2 % 2, 1 + any() % 40, run % 3 ? 128 : 20);
        assert_true(start(FOREVER, &found, &id));
        assert_int_equal(id, 5);
        told += found.state == CANOPY_STORE_ONE;  // not where only filling was hit
        assert_true(write_until(FOREVER, 6));
        assert_true(start(FOREVER, &found, &id));
        assert_int_equal(id, 6);
        assert_int_equal(found.state, CANOPY_STORE_GOOD);
    }
    assert_in_range(told, 13000, 20000);
}

static void two_damaged_copies_are_told_and_never_believed(void **unused) {
    (void)unused;
    struct canopy_store_record found;
    uint32_t id;
    long told = 0;
    for (uint32_t run = 0; run < 20000; run++) {
        seed = run;
        make(512, run % 2 ? 1 : 256);
        assert_true(start(FOREVER, &found, &id));
        assert_true(write_until(FOREVER, 3));  // fills its payload: every bit counts
        flip(0, 1 + 2 * (any() % 3), 128);
        flip(1, 1 + 2 * (any() % 3), 128);
        assert_true(start(FOREVER, &found, &id));
        if (found.state == CANOPY_STORE_CORRUPT)
            told++;
        else  // an odd number of flips is a damage, always
            fail_msg("run %u: damage was not seen", run);
        assert_int_equal(store.generation, 0);
        assert_true(write_until(FOREVER, 6));
        assert_true(start(FOREVER, &found, &id));
        assert_int_equal(id, 6);
        assert_int_equal(found.state, CANOPY_STORE_GOOD);
    }
    assert_int_equal(told, 20000);
}

// ---------------------------------------------------------------------------------------------------------------------
// A memory that fails, and one that is none

static void a_failing_memory_is_told_and_leaves_one_of_both(void **unused) {
    (void)unused;
    struct canopy_store_record found;
    uint32_t id;
    for (uint32_t run = 0; run < 4000; run++) {
        seed = run;
        make(512, run % 2 ? 1 : 256);
        assert_true(start(FOREVER, &found, &id));
        assert_true(write_until(FOREVER, 1));
        const long good = run / 2 % 10;
        model.refuse = good;
        const enum canopy_status status = write_all(2);
        const bool failed = model.refuse < 0;
        assert_int_equal(status, failed ? CANOPY_RANGE : CANOPY_OK);
        assert_false(canopy_store_is_writing(&store));
        const uint32_t said = store.generation;
        model.refuse = 1L << 60;
        assert_true(start(FOREVER, &found, &id));
        assert_int_equal(store.generation, said);
        assert_int_equal(id, said == 2 ? 2 : 1);
        if (!failed)
            assert_int_equal(id, 2);
        assert_true(write_until(FOREVER, 3));
        assert_true(start(FOREVER, &found, &id));
        assert_int_equal(id, 3);
    }
}

// A page with a bit that cannot be cleared or set any more.
static enum canopy_status worn_program(void *context, uint32_t page, uint32_t offset, const uint8_t *from,
                                       uint32_t length) {
    const enum canopy_status status = model_program(context, page, offset, from, length);
    if (page == 0)
        model.solid[0][30] |= 0x10;
    return status;
}

static void a_worn_page_is_told_and_the_old_record_stays(void **unused) {
    (void)unused;
    struct canopy_store_record found;
    uint32_t id;
    make(512, 256);
    assert_true(start(FOREVER, &found, &id));
    assert_true(write_until(FOREVER, 1));
    assert_true(start(FOREVER, &found, &id));
    flash.program = worn_program;
    uint32_t next = 2, failures = 0;
    for (; next < 40; next++) {
        const uint32_t before = id;
        const enum canopy_status status = write_all(next);
        failures += status != CANOPY_OK;
        assert_true(start(FOREVER, &found, &id));
        assert_true(id == next || (status != CANOPY_OK && id == before));
    }
    assert_in_range(failures, 1, 38);
}

static enum canopy_status no_read(void *context, uint32_t page, uint32_t offset, uint8_t *to, uint32_t length) {
    (void)context, (void)page, (void)offset, (void)to, (void)length;
    return CANOPY_RANGE;
}

static void what_cannot_be_used_is_nowhere(void **unused) {
    (void)unused;
    struct canopy_store_record found;
    uint32_t id;
    for (int which = 0; which < 6; which++) {
        make(512, 256);
        switch (which) {
        case 0: flash.page_count = 0; break;
        case 1: flash.page_count = 1; break;
        case 2: flash.program_bytes = 0; break;
        case 3: flash.program_bytes = 512; break;
        case 4: flash.page_bytes = 511; break;
        default: flash.read = no_read; break;
        }
        assert_true(start(FOREVER, &found, &id));
        assert_int_equal(found.state, CANOPY_STORE_NOWHERE);
        assert_int_equal(canopy_store_begin(&store), which == 5);
    }
    make(512, 256);
    assert_true(start(FOREVER, &found, &id));
    uint8_t scratch[CANOPY_STORE_STEP_SCRATCH];
    assert_int_equal(canopy_store_step(&store, 1, scratch, 0, scratch), CANOPY_ARGUMENT);
    assert_true(canopy_store_begin(&store));
    assert_int_equal(canopy_store_step(&store, 1, scratch, CANOPY_STORE_PAYLOAD + 1, scratch), CANOPY_ARGUMENT);
}

static void generations_go_round(void **unused) {
    (void)unused;
    struct canopy_store_record found;
    uint32_t id;
    make(512, 1);
    assert_true(start(FOREVER, &found, &id));
    store.generation = UINT32_MAX - 2;
    for (uint32_t next = 1; next < 12; next++) {
        // half of them as far as the first copy: the newer one has to be told from the older
        const bool whole = write_until(next % 2 ? FOREVER : 2 * ERASE_STEPS + 8 * 132, next);
        assert_int_equal(whole, next % 2);
        assert_true(start(FOREVER, &found, &id));
        assert_int_equal(id, next);
        assert_int_equal(found.state, whole ? CANOPY_STORE_GOOD : CANOPY_STORE_ONE);
        assert_int_not_equal(store.generation, 0);
    }
    assert_in_range(store.generation, 1, 20);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_power_goes_at_every_step),
        cmocka_unit_test(one_damaged_copy_is_told_and_mended),
        cmocka_unit_test(two_damaged_copies_are_told_and_never_believed),
        cmocka_unit_test(a_failing_memory_is_told_and_leaves_one_of_both),
        cmocka_unit_test(a_worn_page_is_told_and_the_old_record_stays),
        cmocka_unit_test(what_cannot_be_used_is_nowhere),
        cmocka_unit_test(generations_go_round),
    };
    return cmocka_run_group_tests_name("store_cuts", tests, NULL, NULL);
}
