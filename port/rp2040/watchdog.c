#include "port/rp2040/watchdog.h"

#include "port/board.h"
#include "port/common/crash_record.h"
#include "port/rp2040/registers.h"
#include "port/rp2040/timer.h"

// In a scratch register, which a reset by the watchdog leaves: this program started it. The crashes until then are
// added: where there are more at the next start, this one has been recorded.
#define STARTED 0x43414E57u

static uint32_t period;  // us; 0 until the start

static void load(uint32_t us) {
    const uint32_t count = 2u * us;  // RP2040-E1
    canopy_rp2040_put(RP2040_WATCHDOG_LOAD, count < RP2040_WATCHDOG_LOAD_MOST ? count : RP2040_WATCHDOG_LOAD_MOST);
}

static void feed(void *context) {
    (void)context;
    if (period == 0)
        return;
    load(period + period / 8u);
    canopy_rp2040_set_alarm(CANOPY_RP2040_WATCHDOG_ALARM, canopy_rp2040_now_us() + period);
}

static void warn(bool wanted) {
    canopy_rp2040_put(RP2040_SYSCFG_NMI_MASK, wanted ? 1u << (RP2040_IRQ_TIMER + CANOPY_RP2040_WATCHDOG_ALARM) : 0);
}

// 2.13: everything but the oscillators, which run on so that the reason and the scratch registers stay true.
static void choose_what_is_reset(void) {
    canopy_rp2040_put(RP2040_PSM_WATCHDOG_SELECT, RP2040_PSM_ALL & ~RP2040_PSM_OSCILLATORS);
}

static uint32_t started(void) {
    const struct canopy_crash *crash = canopy_board_last_crash();
    return STARTED + (crash != NULL ? crash->count : 0);
}

void canopy_rp2040_watchdog_look_back(void) {
    const bool bitten = (canopy_rp2040_get(RP2040_WATCHDOG_REASON) & RP2040_WATCHDOG_REASON_TIMER) != 0 &&
                        canopy_rp2040_get(RP2040_WATCHDOG_SCRATCH2) == started();
    canopy_rp2040_put(RP2040_WATCHDOG_SCRATCH2, 0);
    if (bitten)
        canopy_crash_keep(&(struct canopy_crash){.kind = CANOPY_CRASH_WATCHDOG});
}

bool canopy_rp2040_watchdog_start(uint32_t period_us) {
    if (period_us < 1000u || period_us > CANOPY_RP2040_WATCHDOG_MOST_US)
        return false;
    canopy_rp2040_clear(RP2040_WATCHDOG_CTRL, RP2040_WATCHDOG_ENABLE);
    choose_what_is_reset();
    canopy_rp2040_put(RP2040_WATCHDOG_SCRATCH2, started());
    period = period_us;
    feed(NULL);
    warn(true);
    canopy_rp2040_set(RP2040_WATCHDOG_CTRL, RP2040_WATCHDOG_ENABLE);
    return true;
}

struct canopy_watchdog canopy_rp2040_watchdog(void) {
    return (struct canopy_watchdog){.context = NULL, .feed = feed};
}

void canopy_rp2040_watchdog_hold(void) {
    if (period == 0)
        return;
    warn(false);
    load(CANOPY_RP2040_WATCHDOG_MOST_US);
}

void canopy_rp2040_watchdog_resume(void) {
    if (period == 0)
        return;
    feed(NULL);  // takes back a warning that came due meanwhile
    warn(true);
}

_Noreturn void canopy_rp2040_reset(void) {
    choose_what_is_reset();
    canopy_rp2040_set(RP2040_WATCHDOG_CTRL, RP2040_WATCHDOG_TRIGGER);
    for (;;)
        ;
}
