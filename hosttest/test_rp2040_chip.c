// port/rp2040's clock, watchdog and flash against a model of the chip: what an emulator lacks is the microsecond in
// which an alarm is missed, the doubled count of the watchdog, and flash that cannot be read while it is written.
#include <stdlib.h>

#include "hosttest/rp2040_chip.h"
#include "lib/plc/store.h"
#include "port/board.h"

#include "port/rp2040/flash.c"
#include "port/rp2040/timer.c"
#include "port/rp2040/watchdog.c"

// ---- What the watchdog tells

static struct canopy_crash kept;
static bool has_crash;

const struct canopy_crash *canopy_board_last_crash(void) { return has_crash ? &kept : NULL; }
void canopy_crash_keep(const struct canopy_crash *crash) {
    const uint32_t count = has_crash ? kept.count : 0;
    kept = *crash;
    kept.count = count + 1;
    has_crash = true;
}

static uint32_t alarms, warnings;
static void on_alarm(void) {
    canopy_rp2040_clear_alarm(0);
    alarms++;
}
static void on_warning(void) {
    warnings++;
    chip.nmi_mask = 0;  // nothing returns from it
}

static void power_on(void) {
    chip_start();
    chip.handler[RP2040_IRQ_TIMER] = on_alarm;
    chip.nmi = on_warning;
    chip.irqs = 1;
    alarms = warnings = 0;
    has_crash = false;
    period = 0;
}

// ---- Clock

static void test_clock_over_its_halves(void **state) {
    (void)state;
    for (uint64_t turn = 1; turn < 4; turn++)
        for (uint64_t before_ns = 0; before_ns < 400; before_ns += 7) {
            power_on();
            chip.now_ns = (turn << 32) * 1000u - before_ns;
            const uint64_t us = canopy_rp2040_now_us();
            assert_in_range(us, (turn << 32) - 1u, (turn << 32) + 1u);
        }
}

// Set for any moment around now, also over the turn of the lower half: it comes once, in time, and never before.
static void test_alarms_are_never_missed(void **state) {
    (void)state;
    const uint64_t starts_us[] = {1000, 0xFFFFFFF0u, 0x1FFFFFFF8u};
    for (int s = 0; s < 3; s++)
        for (uint64_t phase_ns = 0; phase_ns < 1000; phase_ns += 40)
            for (int64_t ahead_us = -5; ahead_us < 40; ahead_us++) {
                power_on();
                chip.now_ns = starts_us[s] * 1000u + phase_ns;
                const uint64_t at_us = (uint64_t)((int64_t)chip_now_us() + ahead_us);
                canopy_rp2040_set_alarm(0, at_us);
                if (chip_now_us() < at_us)
                    assert_int_equal(alarms, 0);
                chip_pass(41000);
                assert_int_equal(alarms, 1);
                chip_pass(10000000);
                assert_int_equal(alarms, 1);
            }
}

static void test_alarm_is_replaced_and_taken_back(void **state) {
    (void)state;
    power_on();
    canopy_rp2040_set_alarm(0, chip_now_us() + 100);
    canopy_rp2040_set_alarm(0, chip_now_us() + 1000);
    chip_pass(500000);
    assert_int_equal(alarms, 0);
    canopy_rp2040_clear_alarm(0);
    chip_pass(5000000);
    assert_int_equal(alarms, 0);
}

// ---- Watchdog

static void test_watchdog_period(void **state) {
    (void)state;
    power_on();
    assert_false(canopy_rp2040_watchdog_start(999));
    assert_false(canopy_rp2040_watchdog_start(CANOPY_RP2040_WATCHDOG_MOST_US + 1));
    assert_int_equal(chip.dog_control, 0);
    const uint32_t periods[] = {1000, 500000, 2000000, CANOPY_RP2040_WATCHDOG_MOST_US};
    for (int i = 0; i < 4; i++) {
        power_on();
        chip.nmi = NULL;  // the warning goes unheard
        const uint64_t begin = chip.now_ns;
        assert_true(canopy_rp2040_watchdog_start(periods[i]));
        assert_int_equal(chip.dog_control, RP2040_WATCHDOG_ENABLE);
        assert_int_equal(chip.dog_selected, 0x1FFFC);  // all but the two oscillators
        const uint64_t until_us = periods[i] + periods[i] / 8u;
        const uint64_t bite_ns = 1000u * (until_us < 8388607u ? until_us : 8388607u);
        chip_pass(bite_ns - (chip.now_ns - begin) - 500);
        assert_false(chip.bitten);
        chip_pass(3000);
        assert_true(chip.bitten);
    }
}

static void test_fed_it_is_silent_and_unfed_it_warns(void **state) {
    (void)state;
    power_on();
    const struct canopy_watchdog watchdog = canopy_rp2040_watchdog();
    watchdog.feed(watchdog.context);  // not started: nothing
    assert_int_equal(chip.dog_ns, CHIP_NEVER);
    assert_true(canopy_rp2040_watchdog_start(400000));
    for (int i = 0; i < 50; i++) {
        chip_pass(399990000);  // as late as may be
        watchdog.feed(watchdog.context);
    }
    assert_int_equal(warnings, 0);
    chip.masked = 1;  // a program that hangs with interrupts off
    const uint64_t begin = chip.now_ns;
    while (warnings == 0)
        chip_pass(10000);
    assert_in_range(chip.now_ns - begin, 399990000, 400020000);
    assert_false(chip.bitten);
}

// A record of earlier stays until the power goes: it must not hide that the watchdog has bitten since, unrecorded.
static void test_what_the_next_start_knows(void **state) {
    (void)state;
    const struct canopy_crash hard = {.kind = CANOPY_CRASH_HARD};
    for (int started = 0; started < 2; started++)
        for (uint32_t reason = 0; reason < 4; reason++)
            for (uint32_t before = 0; before < 3; before++)
                for (uint32_t recorded = 0; recorded < 2; recorded++) {
                    power_on();
                    for (uint32_t crash = 0; crash < before; crash++)
                        canopy_crash_keep(&hard);
                    if (started != 0)
                        assert_true(canopy_rp2040_watchdog_start(1000000));
                    if (recorded != 0)
                        canopy_crash_keep(&hard);
                    chip.dog_reason = reason;
                    canopy_rp2040_watchdog_look_back();
                    const bool bitten = started != 0 && (reason & 1u) != 0 && recorded == 0;
                    const uint32_t count = before + recorded + (bitten ? 1u : 0u);
                    assert_int_equal(has_crash, count > 0);
                    if (has_crash) {
                        assert_int_equal(kept.count, count);
                        assert_int_equal(kept.kind, bitten ? CANOPY_CRASH_WATCHDOG : CANOPY_CRASH_HARD);
                    }
                    canopy_rp2040_watchdog_look_back();  // once is enough
                    assert_int_equal(has_crash ? kept.count : 0, count);
                }
}

// ---- Flash: a memory that shows garbage while it is not in its fast reading mode

#define OFFSET 0x1FE000u
#define PAGES 2u

static struct canopy_rp2040_flash flash;
static struct canopy_flash stored;
static uint8_t cells[PAGES * 4096u], seen[PAGES * 4096u];
static char steps[24];
static uint32_t erase_us;
static bool worn;

static void note(char step) {
    const size_t length = strlen(steps);
    assert_true(length + 1 < sizeof steps);
    steps[length] = step;
    assert_int_equal(chip.masked, 1);    // no interrupt
    assert_int_equal(chip.nmi_mask, 0);  // and no warning
}

static void hide(void) { memset(seen, 0x5A, sizeof seen); }
static void step_connect(void) { note('c'); }
static void step_exit(void) {
    note('x');
    hide();
}
static void step_erase(uint32_t offset, size_t bytes, uint32_t block, uint8_t instruction) {
    note('e');
    assert_in_range(offset, OFFSET, OFFSET + sizeof cells - 4096);
    assert_int_equal(offset % 4096, 0);
    assert_int_equal(bytes, 4096);
    assert_int_equal(block, 65536);
    assert_int_equal(instruction, 0xD8);
    if (!worn)
        memset(&cells[offset - OFFSET], 0xFF, bytes);
    chip_pass(1000ull * erase_us);
}
static void step_program(uint32_t offset, const uint8_t *from, size_t bytes) {
    note('p');
    assert_in_range(offset, OFFSET, OFFSET + sizeof cells - 256);
    assert_int_equal(offset % 256, 0);
    assert_int_equal(bytes, 256);
    for (size_t i = 0; !worn && i < bytes; i++)
        cells[offset - OFFSET + i] &= from[i];
    chip_pass(3000000);
}
static void step_flush(void) { note('f'); }
static void step_enter(void) {
    note('r');
    memcpy(seen, cells, sizeof seen);
}

static void open_flash(void) {
    power_on();
    memset(cells, 0, sizeof cells);
    memset(steps, 0, sizeof steps);
    memcpy(seen, cells, sizeof seen);
    erase_us = 45000;
    worn = false;
    const struct canopy_rp2040_flash_steps all = {.connect = step_connect,
                                                  .exit_xip = step_exit,
                                                  .erase = step_erase,
                                                  .program = step_program,
                                                  .flush = step_flush,
                                                  .enter_xip = step_enter};
    canopy_rp2040_flash_start(&flash, &all, seen, OFFSET, PAGES);
    stored = canopy_rp2040_flash(&flash);
    assert_int_equal(stored.page_bytes, 4096);
    assert_int_equal(stored.program_bytes, 256);
    assert_int_equal(stored.page_count, PAGES);
}

static void test_flash_steps_and_their_order(void **state) {
    (void)state;
    open_flash();
    assert_int_equal(stored.erase(stored.context, 1), CANOPY_OK);
    assert_string_equal(steps, "cxefr");
    assert_int_equal(chip.masked, 0);
    for (size_t i = 0; i < sizeof cells; i++)
        assert_int_equal(cells[i], i < 4096 ? 0 : 0xFF);

    memset(steps, 0, sizeof steps);
    uint8_t data[512], back[512];
    for (size_t i = 0; i < sizeof data; i++)
        data[i] = (uint8_t)(i * 5u + 1u);
    assert_int_equal(stored.program(stored.context, 1, 256, data, 512), CANOPY_OK);
    assert_string_equal(steps, "cxpfrcxpfr");
    assert_int_equal(stored.read(stored.context, 1, 256, back, 512), CANOPY_OK);
    assert_memory_equal(back, data, 512);
    assert_int_equal(stored.read(stored.context, 1, 4095, back, 1), CANOPY_OK);
    assert_int_equal(back[0], 0xFF);
}

// What is programmed may lie in the flash itself, which nobody can read meanwhile.
static void test_flash_from_flash(void **state) {
    (void)state;
    open_flash();
    assert_int_equal(stored.erase(stored.context, 0), CANOPY_OK);
    assert_int_equal(stored.erase(stored.context, 1), CANOPY_OK);
    memset(steps, 0, sizeof steps);
    for (uint32_t i = 0; i < 256; i++)
        cells[i] = seen[i] = (uint8_t)i;
    assert_int_equal(stored.program(stored.context, 1, 0, seen, 256), CANOPY_OK);
    assert_memory_equal(&cells[4096], cells, 256);
}

static void test_flash_limits(void **state) {
    (void)state;
    open_flash();
    uint8_t data[512] = {0};
    assert_int_equal(stored.erase(stored.context, PAGES), CANOPY_ARGUMENT);
    assert_int_equal(stored.program(stored.context, 0, 1, data, 256), CANOPY_ARGUMENT);
    assert_int_equal(stored.program(stored.context, 0, 0, data, 255), CANOPY_ARGUMENT);
    assert_int_equal(stored.program(stored.context, 0, 3840, data, 512), CANOPY_ARGUMENT);
    assert_int_equal(stored.program(stored.context, PAGES, 0, data, 256), CANOPY_ARGUMENT);
    assert_int_equal(stored.program(stored.context, 0, 256, data, UINT32_MAX - 255u), CANOPY_ARGUMENT);
    assert_int_equal(stored.read(stored.context, 1, 4000, data, 97), CANOPY_ARGUMENT);
    assert_int_equal(stored.read(stored.context, 0, UINT32_MAX, data, 2), CANOPY_ARGUMENT);
    assert_int_equal(stored.read(stored.context, 1, 4096, data, 0), CANOPY_OK);
    assert_string_equal(steps, "");
}

static void test_worn_flash_is_told(void **state) {
    (void)state;
    open_flash();
    worn = true;
    assert_int_equal(stored.erase(stored.context, 0), CANOPY_RANGE);
    worn = false;
    assert_int_equal(stored.erase(stored.context, 0), CANOPY_OK);
    worn = true;
    uint8_t data[256];
    memset(data, 0xFF, sizeof data);
    assert_int_equal(stored.program(stored.context, 0, 0, data, 256), CANOPY_OK);
    for (uint32_t i = 0; i < 256; i += 51) {
        memset(steps, 0, sizeof steps);
        data[i] = 0xF7;
        assert_int_equal(stored.program(stored.context, 0, 0, data, 256), CANOPY_RANGE);
        data[i] = 0xFF;
    }
}

// What is programmed already is programmed again, to clear more of it: so a store wipes a record that does not count.
static void test_flash_is_programmed_twice(void **state) {
    (void)state;
    open_flash();
    assert_int_equal(stored.erase(stored.context, 0), CANOPY_OK);
    uint8_t data[256], more[256], both[256], back[256];
    for (uint32_t i = 0; i < 256; i++) {
        data[i] = (uint8_t)(i * 29u);
        more[i] = i < 4 ? 0 : 0xFF;
        both[i] = data[i] & more[i];
    }
    assert_int_equal(stored.program(stored.context, 0, 0, data, 256), CANOPY_OK);
    assert_int_equal(stored.program(stored.context, 0, 0, more, 256), CANOPY_OK);
    assert_int_equal(stored.read(stored.context, 0, 0, back, 256), CANOPY_OK);
    assert_memory_equal(back, both, 256);
}

// The settings on this flash, when the power goes after any step of storing others: the old ones or the new.
static void test_settings_on_this_flash(void **state) {
    (void)state;
    static const uint8_t old[8] = "the old", new[8] = "the new";
    uint8_t scratch[CANOPY_STORE_OPEN_SCRATCH];
    for (int cut = 0; cut <= 7; cut++) {
        struct canopy_store store;
        open_flash();
        memset(cells, 0xFF, sizeof cells);
        memset(seen, 0xFF, sizeof seen);
        assert_int_equal(canopy_store_open(&store, &stored, scratch).state, CANOPY_STORE_EMPTY);
        assert_true(canopy_store_begin(&store));
        while (canopy_store_is_writing(&store)) {
            memset(steps, 0, sizeof steps);
            assert_in_range(canopy_store_step(&store, 1, old, sizeof old, scratch), CANOPY_OK, CANOPY_MORE);
        }
        assert_true(canopy_store_begin(&store));
        for (int step = 0; step < cut; step++) {
            memset(steps, 0, sizeof steps);
            assert_in_range(canopy_store_step(&store, 1, new, sizeof new, scratch), CANOPY_OK, CANOPY_MORE);
        }
        for (int starts = 0; starts < 3; starts++) {
            memset(steps, 0, sizeof steps);
            const struct canopy_store_record found = canopy_store_open(&store, &stored, scratch);
            assert_int_equal(found.state, cut < 2 || cut == 7 ? CANOPY_STORE_GOOD : CANOPY_STORE_ONE);
            assert_memory_equal(found.payload, cut < 4 ? old : new, sizeof old);
        }
    }
}

// An erase that takes its longest neither warns nor bites, though the period is shorter; afterwards both are as before.
static void test_flash_under_the_watchdog(void **state) {
    (void)state;
    open_flash();
    erase_us = 400000;
    assert_true(canopy_rp2040_watchdog_start(100000));
    chip_pass(80000000);
    assert_int_equal(stored.erase(stored.context, 0), CANOPY_OK);
    assert_int_equal(warnings, 0);
    assert_false(chip.bitten);
    assert_int_equal(chip.nmi_mask, 2);
    const uint64_t begin = chip.now_ns;
    while (warnings == 0)
        chip_pass(10000);
    assert_in_range(chip.now_ns - begin, 98000000, 100000000);
    chip_pass(13000000);
    assert_true(chip.bitten);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_clock_over_its_halves),
        cmocka_unit_test(test_alarms_are_never_missed),
        cmocka_unit_test(test_alarm_is_replaced_and_taken_back),
        cmocka_unit_test(test_watchdog_period),
        cmocka_unit_test(test_fed_it_is_silent_and_unfed_it_warns),
        cmocka_unit_test(test_what_the_next_start_knows),
        cmocka_unit_test(test_flash_steps_and_their_order),
        cmocka_unit_test(test_flash_from_flash),
        cmocka_unit_test(test_flash_limits),
        cmocka_unit_test(test_worn_flash_is_told),
        cmocka_unit_test(test_flash_is_programmed_twice),
        cmocka_unit_test(test_settings_on_this_flash),
        cmocka_unit_test(test_flash_under_the_watchdog),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
