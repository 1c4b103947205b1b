/// What a device knows of itself, and what of it can be set: self-tests, the last crash, why it started, and settings
/// that are stored. It stands behind the register groups health and settings and their commands (docs/plc.md).
///
///     static struct canopy_health health;
///     static struct canopy_health_kept kept;           // where a reset leaves it alone
///
///     struct canopy_settings settings;
///     canopy_health_open(&health, &config, &settings, scratch);  // before anything uses the settings
///     … start the board …
///     canopy_health_test(&health, crash, &canopy_selftest_fx, arena, sizeof arena);  // before anything uses the arena
///     … canopy_device_init …
///     canopy_device_keep(&device, &health);  // canopy_device_step does the rest
///
/// In the background one window of RAM and a piece of flash are tested every CANOPY_HEALTH_PERIOD_US, with about 4,500
/// instructions. When any test has failed, all that is published is withdrawn, and nothing is published until the power
/// has been off: a reset mends neither RAM nor flash, and the test needs its time to find that again. Nothing is
/// published either when settings were stored and are not in force (settings_state CORRUPT, REFUSED,
/// or NOWHERE with a flash): the defaults may be the other side. Storing takes a step of canopy_store_step each cycle,
/// as long as the flash needs; it and the restart wait until the PLC's answer has left.
#ifndef CANOPY_STATION_HEALTH_H
#define CANOPY_STATION_HEALTH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/plc/plc.h"
#include "lib/plc/settings.h"
#include "lib/plc/store.h"
#include "lib/port.h"
#include "lib/station/selftest.h"
#include "lib/station/show.h"

#define CANOPY_HEALTH_PERIOD_US 10000U

/// Outlives a reset, not the loss of power: in memory that start-up does not clear.
struct canopy_health_kept {
    uint32_t magic;
    uint32_t starts;
    uint32_t crashes;    // that were known at the last start
    uint32_t commanded;  // 1: a reset was asked for
    uint32_t failed;     // enum canopy_plc_selftest_bit: tests that have failed since power-on
    uint32_t check;
};

/// All that is pointed to must outlive the health.
struct canopy_health_config {
    const struct canopy_memory *memory;  ///< NULL: neither RAM nor flash are tested
    const struct canopy_flash *flash;    ///< for the settings
    struct canopy_health_kept *kept;
    void (*defaults)(struct canopy_settings *to);  ///< the device's own: canopy_settings_defaults, or what adjusts them
    uint32_t fixed;                                ///< settings it does not have: 1 << CANOPY_SETTING_...
    void (*reset)(void);                           ///< restarts the device
};

/// Private but for the keeper, whose settings may be looked at.
struct canopy_health {
    struct canopy_plc_keeper keeper;
    struct canopy_health_config config;
    struct canopy_selftest selftest;
    struct canopy_store store;
    const struct canopy_crash *crash;
    struct canopy_plc *plc;
    const struct canopy_station_port *port;
    const struct canopy_profile_counters *scan;
    uint64_t test_us;         // when something was tested last
    uint16_t tests;           // enum canopy_plc_selftest_bit
    uint16_t reset_reason;    // enum canopy_plc_reset_reason
    bool certificate_failed;  // and what has not failed is passed, as it is made at start
    bool to_defaults;         // what is being stored
    bool resetting;
};

/// Bytes of scratch for opening.
#define CANOPY_HEALTH_SCRATCH CANOPY_STORE_OPEN_SCRATCH

/// Reads what is stored: `settings` is then what is in force. `scratch`: CANOPY_HEALTH_SCRATCH bytes.
void canopy_health_open(struct canopy_health *health, const struct canopy_health_config *config,
                        struct canopy_settings *settings, uint8_t *scratch);

/// Finds out why the device started (`crash`: the last one since power-on, or NULL), and makes the tests at start: the
/// certificate, and a first window of RAM. `arena`: CANOPY_SELFTEST_ARENA bytes, aligned to 8, which are nobody's
/// afterwards. Fills what is free of the stack with a pattern, too, to see how deep it goes.
void canopy_health_test(struct canopy_health *health, const struct canopy_crash *crash,
                        const struct canopy_selftest_known *known, void *arena, size_t bytes);

/// Puts the health behind the registers of `plc`. What is known of the wires (`port`) and of the scanner's driver
/// (`scan`, or NULL) is shown, too.
void canopy_health_attach(struct canopy_health *health, struct canopy_plc *plc, const struct canopy_station_port *port,
                          const struct canopy_profile_counters *scan);

/// A piece of what is to be done. `quiet`: the PLC's answer has left.
void canopy_health_step(struct canopy_health *health, uint64_t now_us, bool quiet);

#endif
