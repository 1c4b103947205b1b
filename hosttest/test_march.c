// The march over a model of memory with one fault, every fault of its kind: each must be found, and good memory passed.
// And over real memory in which two addresses reach one word.
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cmocka.h>

#include "lib/station/march.h"
#include "lib/station/selftest.h"

enum { WORDS = 8, BITS = 32 * WORDS, NOWHERE = WORDS };

enum kind {
    GOOD,
    STUCK,       // bit a is always `to`
    TRANSITION,  // bit a cannot be written to `to`
    STATE,       // while bit a is `from`, bit b is `to`
    IDEMPOTENT,  // when bit a becomes `from`, bit b becomes `to`
    INVERSION,   // when bit a becomes `from`, bit b turns over
    ADDRESS,     // word a is reached by no address: the address reaches word b, or nothing, which reads as `to`
    TWO_WORDS,   // address a reaches word a and word b; reading is the and (`to` 0) or the or of them
};

static struct {
    enum kind kind;
    unsigned a, b;
    bool from, to;
    uint32_t cells[WORDS + 1];
} model;

static bool bit(unsigned i) { return (model.cells[i / 32] >> i % 32 & 1U) != 0; }

static void set(unsigned i, bool value) {
    model.cells[i / 32] = (model.cells[i / 32] & ~(1U << i % 32)) | (uint32_t)value << i % 32;
}

static void store(unsigned word, uint32_t value) {
    const bool was = model.kind >= STUCK && model.kind <= INVERSION && bit(model.a);
    model.cells[word] = value;
    switch (model.kind) {
    case STUCK: set(model.a, model.to); break;
    case TRANSITION:
        if (was != model.to && bit(model.a) == model.to)
            set(model.a, was);
        break;
    case STATE:
        if (bit(model.a) == model.from)
            set(model.b, model.to);
        break;
    case IDEMPOTENT:
        if (was != bit(model.a) && bit(model.a) == model.from)
            set(model.b, model.to);
        break;
    case INVERSION:
        if (was != bit(model.a) && bit(model.a) == model.from)
            set(model.b, !bit(model.b));
        break;
    default: break;
    }
}

static void put(void *context, unsigned i, uint32_t value) {
    (void)context;
    if (model.kind == ADDRESS && i == model.a) {
        store(model.b, value);
    } else {
        store(i, value);
        if (model.kind == TWO_WORDS && i == model.a)
            store(model.b, value);
    }
}

static uint32_t get(void *context, unsigned i) {
    (void)context;
    if (model.kind == ADDRESS && i == model.a)
        return model.b == NOWHERE ? 0U - (uint32_t)model.to : model.cells[model.b];
    if (model.kind == TWO_WORDS && i == model.a)
        return model.to ? model.cells[i] | model.cells[model.b] : model.cells[i] & model.cells[model.b];
    return model.cells[i];
}

static long faults;

// Whether a march with the first `backgrounds` patterns finds the fault, whatever was in memory.
static bool finds(enum kind kind, unsigned a, unsigned b, bool from, bool to, unsigned backgrounds) {
    bool good = true;
    model.kind = kind;
    model.a = a;
    model.b = b;
    model.from = from;
    model.to = to;
    faults += kind != GOOD;
    for (unsigned word = 0; word <= WORDS; word++)
        model.cells[word] = (uint32_t)faults * 2654435761U + word * 40503U;
    for (unsigned k = 0; k < backgrounds; k++)
        good &= canopy_march(NULL, get, put, WORDS, canopy_march_background(k));
    return !good;
}

static void good_memory_passes(void **unused) {
    (void)unused;
    assert_false(finds(GOOD, 0, 0, false, false, CANOPY_MARCH_BACKGROUNDS));
}

static void bits_that_are_stuck_or_slow_are_found(void **unused) {
    (void)unused;
    for (unsigned a = 0; a < BITS; a++)
        for (unsigned to = 0; to < 2; to++) {
            assert_true(finds(STUCK, a, 0, false, to, 1));
            assert_true(finds(TRANSITION, a, 0, false, to, 1));
        }
}

static void words_that_change_with_others_are_found(void **unused) {
    (void)unused;
    for (unsigned a = 0; a < BITS; a++)
        for (unsigned b = 0; b < BITS; b++)
            for (unsigned how = 0; how < 4 && a / 32 != b / 32; how++) {
                assert_true(finds(STATE, a, b, how & 1, how & 2, 1));
                assert_true(finds(IDEMPOTENT, a, b, how & 1, how & 2, 1));
                assert_true(finds(INVERSION, a, b, how & 1, false, 1));
            }
}

static void bits_of_one_word_that_hold_each_other_are_found(void **unused) {
    (void)unused;
    for (unsigned a = 0; a < BITS; a++)
        for (unsigned b = a / 32 * 32; b < a / 32 * 32 + 32; b++)
            for (unsigned how = 0; how < 4 && a != b; how++)
                assert_true(finds(STATE, a, b, how & 1, how & 2, CANOPY_MARCH_BACKGROUNDS));
}

static void wrong_addresses_are_found(void **unused) {
    (void)unused;
    for (unsigned a = 0; a < WORDS; a++)
        for (unsigned b = 0; b <= WORDS; b++)
            for (unsigned to = 0; to < 2 && a != b; to++) {
                assert_true(finds(ADDRESS, a, b, false, to, 1));
                if (b != NOWHERE)
                    assert_true(finds(TWO_WORDS, a, b, false, to, 1));
            }
    printf("# %ld faults\n", faults);
}

// ---------------------------------------------------------------------------------------------------------------------

static uint32_t no_mask(void) { return 0; }
static void no_restore(uint32_t was) { (void)was; }

// An address line that is not connected: what stands at an address stands at another one, too.
static void an_address_line_that_is_dead_is_found(void **unused) {
    (void)unused;
    const size_t page = (size_t)sysconf(_SC_PAGESIZE);
    const int file = memfd_create("ram", 0);
    assert_true(file >= 0);
    assert_int_equal(ftruncate(file, (off_t)(4 * page)), 0);
    for (unsigned line = 0; line < 3; line++) {  // 2: none is dead
        unsigned char *at = mmap(NULL, 8 * page, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
        assert_true(at != MAP_FAILED);
        at += (4 * page - (uintptr_t)at % (4 * page)) % (4 * page);
        for (unsigned k = 0; k < 4; k++) {
            const size_t from = line < 2 ? k & ~(1U << line) : k;
            assert_true(mmap(at + k * page, page, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_FIXED, file,
                             (off_t)(from * page)) != MAP_FAILED);
        }
        const struct canopy_memory memory = {.ram = (uint32_t *)(void *)at,
                                             .ram_end = (uint32_t *)(void *)(at + 4 * page),
                                             .mask = no_mask,
                                             .restore = no_restore};
        struct canopy_selftest test;
        canopy_selftest_init(&test, &memory);
        while (test.ram_passes < 16)
            canopy_selftest_ram(&test);
        assert_int_equal(test.ram_failed, line < 2);
        assert_int_equal(munmap(at, 4 * page), 0);
    }
    close(file);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(good_memory_passes),
        cmocka_unit_test(bits_that_are_stuck_or_slow_are_found),
        cmocka_unit_test(words_that_change_with_others_are_found),
        cmocka_unit_test(bits_of_one_word_that_hold_each_other_are_found),
        cmocka_unit_test(wrong_addresses_are_found),
        cmocka_unit_test(an_address_line_that_is_dead_is_found),
    };
    return cmocka_run_group_tests_name("march", tests, NULL, NULL);
}
