#include "boards/linux/keep.h"

#include <string.h>

#include "canopy_registers.h"
#include "port/linux/log.h"

#define ANSWER_US 50000U  // after a command, for its answer to leave

#define BIT(name) (1U << CANOPY_SETTING_##name)

// One canopyd in a process: what its options say, as settings, and whether it is to be restarted.
static struct canopy_settings told;
static bool restart;

static void tell_defaults(struct canopy_settings *to) { *to = told; }

static void ask_restart(void) { restart = true; }

// ---- Options as settings

// The RTU line to PLCs, if there is one and no other.
static struct canopyd_modbus_url *plc_line(struct canopyd_options *options) {
    struct canopyd_modbus_url *found = NULL;
    for (unsigned i = 0; i < options->modbus_count; i++) {
        if (!options->modbus[i].tcp) {
            if (found != NULL) {
                return NULL;
            }
            found = &options->modbus[i];
        }
    }
    return found;
}

// 8N1 and 8E1 are settings; other formats cannot be told by one.
static bool has_format(const struct canopy_linux_serial_config *line) {
    return line->stop_bits == 1 && (line->parity == 'N' || line->parity == 'E');
}

static uint32_t tell_plc_line(const struct canopyd_modbus_url *line) {
    if (line == NULL) {
        return BIT(PLC_UNIT) | BIT(PLC_FORMAT) | BIT(PLC_BAUD);
    }
    told.plc_unit = line->unit;
    told.plc_baud = line->serial.baud;
    told.plc_format = line->serial.parity == 'E';
    return has_format(&line->serial) ? 0 : BIT(PLC_FORMAT);
}

static uint32_t tell_scanner(const struct canopyd_scanner_url *scanner) {
    uint32_t fixed = 0;
    if (scanner->kind == CANOPYD_RTU_SCANNER) {
        told.scanner_baud = scanner->serial.baud;
        told.scanner_format = scanner->serial.parity == 'E';
        fixed |= has_format(&scanner->serial) ? 0 : BIT(SCANNER_FORMAT);
    } else {
        fixed |= BIT(SCANNER_BAUD) | BIT(SCANNER_FORMAT);
    }
    if (scanner->kind == CANOPYD_RTU_SCANNER || scanner->kind == CANOPYD_TCP_SCANNER) {
        told.scanner_unit = scanner->unit;
    } else {
        fixed |= BIT(SCANNER_UNIT) | BIT(SCANNER_TIMEOUT_MS);
    }
    return fixed;
}

// Options may be where no setting can: then they stay.
static uint32_t out_of_range(void) {
    uint32_t fixed = 0;
    for (unsigned k = 0; k < CANOPY_SETTINGS; k++) {
        fixed |= canopy_settings_are_allowed(&told, &told, ~(1U << k)) ? 0 : 1U << k;
    }
    return fixed;
}

static uint32_t tell(struct canopyd_options *options) {
    canopy_settings_defaults(&told);
    uint32_t fixed = BIT(SCANNER_I2C) | BIT(WATCHDOG_MS) | tell_plc_line(plc_line(options));
    fixed |= tell_scanner(&options->scanner);
    fixed |= options->frame != NULL ? BIT(SIDE) : 0;  // a frame has its own side
    told.side = options->side;
    told.stale_after_ms = options->stale_after_ms;
    told.interval_ms = options->interval_ms;
    told.refresh_ms = options->refresh_ms;
    told.scanner_timeout_ms = options->timeout_ms;
    return fixed | out_of_range();
}

// ---- Settings as options

// Any rate is in range, but a system knows some only.
static bool is_possible(const struct canopy_settings *settings, uint32_t fixed) {
    return ((fixed & BIT(PLC_BAUD)) != 0 || canopy_linux_baud_known(settings->plc_baud)) &&
           ((fixed & BIT(SCANNER_BAUD)) != 0 || canopy_linux_baud_known(settings->scanner_baud));
}

static void set_line(struct canopy_linux_serial_config *line, uint32_t baud, uint16_t format, bool format_is_fixed) {
    line->baud = baud;
    if (!format_is_fixed) {
        line->parity = format == 1 ? 'E' : 'N';
    }
}

static void apply(const struct canopy_settings *settings, uint32_t fixed, struct canopyd_options *options) {
    struct canopyd_modbus_url *plc = plc_line(options);
    if (plc != NULL) {
        plc->unit = (uint8_t)settings->plc_unit;
        set_line(&plc->serial, settings->plc_baud, settings->plc_format, (fixed & BIT(PLC_FORMAT)) != 0);
    }
    if (options->scanner.kind == CANOPYD_RTU_SCANNER) {
        set_line(&options->scanner.serial, settings->scanner_baud, settings->scanner_format,
                 (fixed & BIT(SCANNER_FORMAT)) != 0);
    }
    if ((fixed & BIT(SCANNER_UNIT)) == 0) {
        options->scanner.unit = (uint8_t)settings->scanner_unit;
    }
    options->side = (uint8_t)settings->side;
    options->stale_after_ms = settings->stale_after_ms;
    options->interval_ms = settings->interval_ms;
    options->refresh_ms = settings->refresh_ms;
    options->timeout_ms = settings->scanner_timeout_ms;
}

// ---- Opening

static void say_state(const char *path, uint16_t state) {
    static const char *const states[] = {
        "nothing is stored yet",
        "stored settings are in force",
        "stored settings are in force, but one copy is damaged or older",
        "both copies are damaged: nothing is published until a PLC stores settings",
        "it cannot be read: nothing is published",
        "it is not for this canopyd: nothing is published until a PLC stores settings"};
    canopy_linux_log("settings: %s: %s", path, states[state]);
}

bool canopyd_keep_open(struct canopyd_keep *keep, struct canopyd_options *options, struct canopy_fault *fault) {
    static CANOPY_ARENA_DECLARE(arena, CANOPY_SELFTEST_ARENA + CANOPY_HEALTH_SCRATCH);
    const uint32_t fixed = tell(options);
    const struct canopy_health_config config = {
        .flash = &keep->flash, .kept = &keep->kept, .defaults = tell_defaults, .fixed = fixed, .reset = ask_restart};
    keep->file.fd = -1;
    restart = false;
    if (options->settings != NULL) {
        const char *wrong = canopy_linux_flash_file_open(&keep->file, options->settings);
        if (wrong != NULL) {
            return canopy_fault_set(fault,
                                    "--settings %s: %s: give a file that canopyd has made and may write, or one "
                                    "that is not there yet in a directory that it may write",
                                    options->settings, wrong);
        }
        keep->flash = canopy_linux_flash_file(&keep->file);
    }
    struct canopy_settings settings;
    canopy_health_open(&keep->health, &config, &settings, (uint8_t *)arena);
    canopy_health_test(&keep->health, NULL, &canopy_selftest_fx, arena, sizeof arena);
    struct canopy_plc_settings *shown = &keep->health.keeper.settings;
    if (!is_possible(&settings, fixed)) {
        shown->value = settings = told;
        shown->state = CANOPY_PLC_SETTINGS_REFUSED;
    }
    apply(&settings, fixed, options);
    if (options->settings != NULL) {
        say_state(options->settings, shown->state);
    }
    return true;
}

void canopyd_keep_attach(struct canopyd_keep *keep, struct canopy_station *station) {
    canopy_health_attach(&keep->health, &station->plc, &station->port, station->scan);
}

// ---- Turns

bool canopyd_keep_step(struct canopyd_keep *keep, uint64_t now_us) {
    const uint32_t commands = keep->health.plc->commands;
    if (commands != keep->commands) {
        keep->commands = commands;
        keep->command_us = now_us;
    }
    const struct canopy_plc_settings *shown = &keep->health.keeper.settings;
    const uint16_t before = shown->stored;
    canopy_health_step(&keep->health, now_us, now_us - keep->command_us >= ANSWER_US);
    if (shown->stored != before && shown->stored == CANOPY_PLC_STORE_DONE) {
        canopy_linux_log("settings: stored, in force at the next start");
    } else if (shown->stored != before && shown->stored == CANOPY_PLC_STORE_FAILED) {
        canopy_linux_log("settings: the file could not be written");
    }
    return !restart;
}

void canopyd_keep_close(struct canopyd_keep *keep) { canopy_linux_flash_file_close(&keep->file); }
