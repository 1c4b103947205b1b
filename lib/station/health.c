#include "lib/station/health.h"

#include "canopy_registers.h"

#define KEPT 0x43484B31U
#define UNUSED_STACK 0xC5C5C5C5U
#define STACK_MARGIN 256U  // below the variables of who fills it

// ---- Why it started

static uint32_t check_of(const struct canopy_health_kept *kept) {
    return ~(kept->magic ^ kept->starts * 3U ^ kept->crashes * 5U ^ kept->commanded * 7U ^ kept->failed * 11U);
}

static uint16_t reason_of(const struct canopy_health_kept *kept, const struct canopy_crash *crash) {
    if (kept->magic != KEPT || kept->check != check_of(kept)) {
        return CANOPY_PLC_RESET_POWER;
    }
    if (crash != NULL && crash->count != kept->crashes) {
        return crash->kind == CANOPY_CRASH_WATCHDOG ? CANOPY_PLC_RESET_WATCHDOG : CANOPY_PLC_RESET_CRASH;
    }
    return kept->commanded == 1 ? CANOPY_PLC_RESET_COMMAND : CANOPY_PLC_RESET_OTHER;
}

static void keep(struct canopy_health_kept *kept, const struct canopy_health_kept *news) {
    *kept = *news;
    kept->magic = KEPT;
    kept->check = check_of(kept);
}

static uint32_t crashes_of(const struct canopy_crash *crash) { return crash != NULL ? crash->count : 0; }

static void note_start(struct canopy_health *health) {
    struct canopy_health_kept *kept = health->config.kept;
    health->reset_reason = reason_of(kept, health->crash);
    const bool powered = health->reset_reason == CANOPY_PLC_RESET_POWER;
    keep(kept, &(struct canopy_health_kept){.starts = (powered ? 0 : kept->starts) + 1,
                                            .crashes = crashes_of(health->crash),
                                            .failed = powered ? 0 : kept->failed});
}

// ---- Registers

static uint16_t failed_of(const struct canopy_health *health) {
    return (uint16_t)(health->config.kept->failed | (health->selftest.ram_failed ? CANOPY_PLC_SELFTEST_RAM : 0) |
                      (health->selftest.flash_failed ? CANOPY_PLC_SELFTEST_FLASH : 0) |
                      (health->certificate_failed ? CANOPY_PLC_SELFTEST_CERTIFICATE : 0));
}

static uint16_t unused_stack(const struct canopy_memory *memory) {
    const uint32_t *at = memory->stack;
    while (at < memory->stack_end && *at == UNUSED_STACK) {
        at++;
    }
    const size_t bytes = (size_t)(at - memory->stack) * sizeof *at;
    return (uint16_t)(bytes < UINT16_MAX ? bytes : UINT16_MAX);
}

static void show_health(struct canopy_plc_keeper *keeper, struct canopy_plc_health *to) {
    const struct canopy_health *health = (const void *)keeper;  // its first member
    const struct canopy_health_config *config = &health->config;
    const struct canopy_selftest *selftest = &health->selftest;
    to->tests = health->tests;
    to->failed = failed_of(health);
    to->passed =
        (uint16_t)(((selftest->ram_passes > 0 ? CANOPY_PLC_SELFTEST_RAM : 0) |
                    (selftest->flash_passes > 0 ? CANOPY_PLC_SELFTEST_FLASH : 0) | CANOPY_PLC_SELFTEST_CERTIFICATE) &
                   health->tests & ~to->failed);
    to->reset_reason = health->reset_reason;
    to->starts = config->kept->starts;
    to->crash_count = crashes_of(health->crash);
    if (health->crash != NULL) {
        to->crash = *health->crash;
    }
    to->ram_passes = selftest->ram_passes;
    to->flash_passes = selftest->flash_passes;
    to->flash_crc = selftest->flash_crc;
    to->i2c_recoveries = health->port->scan.recoveries;
    to->scanner_lost_bytes = health->port->scan.lost_bytes;
    to->scanner_failure = health->scan != NULL ? (uint16_t)health->scan->last_failure : 0;
    to->stack_unused = config->memory != NULL ? unused_stack(config->memory) : 0;
}

static enum canopy_plc_result run_command(struct canopy_plc_keeper *keeper, enum canopy_plc_command_code code) {
    struct canopy_health *health = (void *)keeper;
    if (code == CANOPY_PLC_COMMAND_RESET) {
        health->resetting = true;
        return CANOPY_PLC_RESULT_DONE;
    }
    if (canopy_store_is_writing(&health->store) || !canopy_store_begin(&health->store)) {
        return CANOPY_PLC_RESULT_REFUSED;
    }
    health->to_defaults = code == CANOPY_PLC_COMMAND_DEFAULTS;
    if (health->to_defaults) {
        health->config.defaults(&keeper->settings.value);
    }
    keeper->settings.stored = CANOPY_PLC_STORE_UNDER_WAY;
    return CANOPY_PLC_RESULT_DONE;
}

// Something was stored, or may be, and is not in force. Defaults may be the other side, and call readings fresh for
// longer: what they give is not what the installer has asked for.
static bool are_settings_lost(const struct canopy_health *health) {
    switch (health->keeper.settings.state) {
    case CANOPY_PLC_SETTINGS_CORRUPT:
    case CANOPY_PLC_SETTINGS_REFUSED: return true;
    case CANOPY_PLC_SETTINGS_NOWHERE: return health->config.flash->page_count > 0;
    default: return false;
    }
}

// ---- Start

void canopy_health_open(struct canopy_health *health, const struct canopy_health_config *config,
                        struct canopy_settings *settings, uint8_t *scratch) {
    static const uint8_t states[] = {
        [CANOPY_STORE_EMPTY] = CANOPY_PLC_SETTINGS_NONE,      [CANOPY_STORE_GOOD] = CANOPY_PLC_SETTINGS_STORED,
        [CANOPY_STORE_ONE] = CANOPY_PLC_SETTINGS_MENDED,      [CANOPY_STORE_CORRUPT] = CANOPY_PLC_SETTINGS_CORRUPT,
        [CANOPY_STORE_NOWHERE] = CANOPY_PLC_SETTINGS_NOWHERE,
    };
    *health = (struct canopy_health){.config = *config};
    struct canopy_plc_settings *mine = &health->keeper.settings;
    health->keeper.fixed = config->fixed;
    health->keeper.health = show_health;
    health->keeper.keep = run_command;
    config->defaults(&mine->value);
    const struct canopy_store_record found = canopy_store_open(&health->store, config->flash, scratch);
    mine->state = states[found.state];
    mine->generation = health->store.generation;
    if (found.payload != NULL &&
        !canopy_settings_decode(&mine->value, found.payload, found.length, found.version, config->fixed)) {
        mine->state = CANOPY_PLC_SETTINGS_REFUSED;
    }
    *settings = mine->value;
}

// Down to the end of the stack, from below what is in use.
static void fill_stack(const struct canopy_memory *memory) {
    const volatile uint32_t here = 0;
    const uintptr_t end = (uintptr_t)&here - STACK_MARGIN;
    for (volatile uint32_t *at = memory->stack; at < memory->stack_end && (uintptr_t)at < end; at++) {
        *at = UNUSED_STACK;
    }
}

void canopy_health_test(struct canopy_health *health, const struct canopy_crash *crash,
                        const struct canopy_selftest_known *known, void *arena, size_t bytes) {
    const struct canopy_memory *memory = health->config.memory;
    health->crash = crash;
    note_start(health);
    health->tests = CANOPY_PLC_SELFTEST_CERTIFICATE;
    if (memory != NULL) {
        health->tests |= CANOPY_PLC_SELFTEST_RAM | CANOPY_PLC_SELFTEST_FLASH;
        fill_stack(memory);
        canopy_selftest_init(&health->selftest, memory);
        canopy_selftest_ram(&health->selftest);
    }
    health->certificate_failed = !canopy_selftest_certificate(known, arena, bytes);
}

void canopy_health_attach(struct canopy_health *health, struct canopy_plc *plc, const struct canopy_station_port *port,
                          const struct canopy_profile_counters *scan) {
    health->plc = plc;
    health->port = port;
    health->scan = scan;
    plc->keeper = &health->keeper;
}

// ---- Cycle

static void store(struct canopy_health *health) {
    struct canopy_plc_settings *mine = &health->keeper.settings;
    uint8_t payload[CANOPY_SETTINGS_BYTES], scratch[CANOPY_STORE_STEP_SCRATCH];
    canopy_settings_encode(&mine->value, payload);
    // All defaults, whatever they are when they are read, are a record of nothing.
    const uint16_t length = health->to_defaults ? 0 : (uint16_t)sizeof payload;
    const enum canopy_status status =
        canopy_store_step(&health->store, CANOPY_SETTINGS_VERSION, payload, length, scratch);
    if (status != CANOPY_MORE) {
        mine->stored = status == CANOPY_OK ? CANOPY_PLC_STORE_DONE : CANOPY_PLC_STORE_FAILED;
    }
    mine->generation = health->store.generation;
}

static void test(struct canopy_health *health, uint64_t now_us) {
    if (health->config.memory != NULL && now_us - health->test_us >= CANOPY_HEALTH_PERIOD_US) {
        health->test_us = now_us;
        canopy_selftest_ram(&health->selftest);
        canopy_selftest_flash(&health->selftest);
    }
    const uint16_t failed = failed_of(health);
    if (failed != health->config.kept->failed) {
        struct canopy_health_kept news = *health->config.kept;
        news.failed = failed;
        keep(health->config.kept, &news);
    }
    if ((failed != 0 || are_settings_lost(health)) && !health->plc->barred) {
        canopy_plc_bar(health->plc);
    }
}

void canopy_health_step(struct canopy_health *health, uint64_t now_us, bool quiet) {
    test(health, now_us);
    if (!quiet) {
        return;
    }
    if (canopy_store_is_writing(&health->store)) {
        store(health);
    } else if (health->resetting) {
        struct canopy_health_kept news = *health->config.kept;
        news.crashes = crashes_of(health->crash);
        news.commanded = 1;
        keep(health->config.kept, &news);
        health->config.reset();
    }
}
