// Self-tests on memory that is good, and on a program that is not what it was.
#include "hosttest/unit/unit.h"
#include "lib/num/crc32.h"
#include "lib/station/selftest.h"

enum { RAM_WORDS = 256, FLASH_WORDS = 61 };

static CANOPY_ARENA_DECLARE(arena, CANOPY_SELFTEST_ARENA);
static uint32_t ram[RAM_WORDS], flash[FLASH_WORDS + 1];
static uint32_t masked, balance;

static uint32_t mask(void) {
    masked++;
    return balance++ + 7;
}

static void restore(uint32_t was) {
    balance--;
    CHECK_EQ(was, balance + 7);
}

static struct canopy_memory memory_of(void) {
    return (struct canopy_memory){.ram = ram,
                                  .ram_end = ram + RAM_WORDS,
                                  .stack = ram,
                                  .stack_end = ram,
                                  .flash = (const uint8_t *)flash,
                                  .flash_end = flash + FLASH_WORDS,
                                  .mask = mask,
                                  .restore = restore};
}

UNIT(crc32_is_the_usual_one) {
    CHECK_EQ(canopy_crc32(0, "123456789", 9), 0xCBF43926U);
    CHECK_EQ(canopy_crc32(canopy_crc32(0, "1234", 4), "56789", 5), 0xCBF43926U);
    CHECK_EQ(canopy_crc32(0, "", 0), 0);
}

UNIT(ram_is_walked_through_and_left_as_it_was) {
    const struct canopy_memory memory = memory_of();
    struct canopy_selftest test;
    canopy_selftest_init(&test, &memory);
    for (uint32_t i = 0; i < RAM_WORDS; i++)
        ram[i] = i * 2654435761U;
    masked = balance = 0;
    for (uint32_t step = 1; step <= 48 * RAM_WORDS / 4; step++) {
        canopy_selftest_ram(&test);
        CHECK_EQ(test.ram_passes, step / (RAM_WORDS / 4));
        CHECK_EQ(masked, step);
        CHECK_EQ(balance, 0);
    }
    CHECK(!test.ram_failed);
    for (uint32_t i = 0; i < RAM_WORDS; i++)
        CHECK_EQ(ram[i], i * 2654435761U);
}

UNIT(the_stack_in_use_is_left_out) {
    struct canopy_memory memory = memory_of();
    struct canopy_selftest test;
    volatile uint32_t here[64];
    for (uint32_t i = 0; i < 64; i++)
        here[i] = i;
    // RAM is what this function stands on, and all of it is in use
    memory.ram = (uint32_t *)(uintptr_t)here;
    memory.ram_end = memory.ram + 64;
    memory.stack = memory.ram;
    memory.stack_end = memory.ram_end;
    canopy_selftest_init(&test, &memory);
    masked = 0;
    for (unsigned step = 0; step < 16; step++)
        canopy_selftest_ram(&test);
    CHECK_EQ(masked, 0);
    CHECK_EQ(test.ram_passes, 1);
    // an end of the stack below it: none of it is
    memory.stack_end = memory.ram;
    canopy_selftest_init(&test, &memory);
    for (unsigned step = 0; step < 16; step++)
        canopy_selftest_ram(&test);
    CHECK_EQ(masked, 16);
    for (uint32_t i = 0; i < 64; i++)
        CHECK_EQ(here[i], i);
}

static void read_all(struct canopy_selftest *test) {
    for (uint32_t at = 0; at < sizeof flash - 4; at += CANOPY_SELFTEST_FLASH_BYTES)
        canopy_selftest_flash(test);
}

UNIT(every_bit_of_the_flash_counts) {
    const struct canopy_memory memory = memory_of();
    struct canopy_selftest test;
    for (uint32_t i = 0; i < FLASH_WORDS; i++)
        flash[i] = ~i * 40503U;
    flash[FLASH_WORDS] = canopy_crc32(0, flash, 4 * FLASH_WORDS);
    canopy_selftest_init(&test, &memory);
    CHECK_EQ(test.flash_crc, 0);
    read_all(&test);
    read_all(&test);
    CHECK_EQ(test.flash_passes, 2);
    CHECK_EQ(test.flash_crc, flash[FLASH_WORDS]);
    for (uint32_t bit = 0; bit < 32 * (FLASH_WORDS + 1); bit += 7) {
        canopy_selftest_init(&test, &memory);
        flash[bit / 32] ^= 1U << bit % 32;
        read_all(&test);
        flash[bit / 32] ^= 1U << bit % 32;
        CHECK(test.flash_failed);
        CHECK_EQ(test.flash_passes, 0);
        read_all(&test);
        CHECK(test.flash_failed);  // for good
        CHECK_EQ(test.flash_passes, 1);
    }
}

UNIT(the_certificate_is_what_is_known) {
    CHECK(canopy_selftest_certificate(&canopy_selftest_fx, arena, sizeof arena));
    CHECK(canopy_selftest_certificate(&canopy_selftest_f32, arena, sizeof arena));
    memset(arena, 0xA5, sizeof arena);
    CHECK(canopy_selftest_certificate(&canopy_selftest_fx, arena, sizeof arena));
}

UNIT(a_certificate_that_is_not_what_is_known_fails) {
    struct canopy_selftest_known known = canopy_selftest_fx;
    known.crc ^= 1;
    CHECK(!canopy_selftest_certificate(&known, arena, sizeof arena));
    known = canopy_selftest_fx;
    known.margin--;
    CHECK(!canopy_selftest_certificate(&known, arena, sizeof arena));
    known = canopy_selftest_fx;
    known.fall++;  // what should be accepted is refused
    CHECK(!canopy_selftest_certificate(&known, arena, sizeof arena));
    known.fall -= 2;  // what should be refused is accepted
    CHECK(!canopy_selftest_certificate(&known, arena, sizeof arena));
    known = canopy_selftest_fx;
    known.fit = &canopy_line_fit_f32;
    CHECK(!canopy_selftest_certificate(&known, arena, sizeof arena));
    CHECK(!canopy_selftest_certificate(&canopy_selftest_fx, arena, sizeof arena - 8));
}

UNIT_LIST(selftest, crc32_is_the_usual_one, ram_is_walked_through_and_left_as_it_was, the_stack_in_use_is_left_out,
          every_bit_of_the_flash_counts, the_certificate_is_what_is_known,
          a_certificate_that_is_not_what_is_known_fails)
