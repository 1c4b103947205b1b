#include "port/rp2040/chip.h"

#include "port/rp2040/registers.h"

#define CRYSTAL_MHZ (CANOPY_RP2040_CRYSTAL_HZ / 1000000u)

// 2.16.3: the counter counts 256 crystal clocks a step; 1 ms
#define XOSC_STARTUP_DELAY (CANOPY_RP2040_CRYSTAL_HZ / 1000u / 256u + 1u)

// 2.18.2: 12 MHz * 125 = 1500 MHz, / 6 / 2 = 125 MHz
#define PLL_FEEDBACK 125u
#define PLL_DIVIDERS (6u << 16 | 2u << 12)

static void wait_for(uint32_t address, uint32_t bits) {
    while ((canopy_rp2040_get(address) & bits) != bits)
        ;
}

void canopy_rp2040_reset_blocks(uint32_t blocks) {
    canopy_rp2040_set(RP2040_RESETS_RESET, blocks);
    canopy_rp2040_clear(RP2040_RESETS_RESET, blocks);
    wait_for(RP2040_RESETS_DONE, blocks);
}

static void start_crystal(void) {
    canopy_rp2040_put(RP2040_XOSC_CTRL, RP2040_XOSC_1_TO_15_MHZ);
    canopy_rp2040_put(RP2040_XOSC_STARTUP, XOSC_STARTUP_DELAY);
    canopy_rp2040_set(RP2040_XOSC_CTRL, RP2040_XOSC_ENABLE);
    wait_for(RP2040_XOSC_STATUS, RP2040_XOSC_STABLE);
}

// Nothing may run from the PLL while it is set up: clk_sys goes back to clk_ref and that to the ring oscillator, where
// they are after a reset of the whole chip but not after one by a debugger.
static void leave_pll(void) {
    canopy_rp2040_put(RP2040_CLK_SYS_RESUS_CTRL, 0);
    canopy_rp2040_clear(RP2040_CLK_SYS_CTRL, RP2040_CLK_SYS_SOURCE);
    wait_for(RP2040_CLK_SYS_SELECTED, 1u);
    canopy_rp2040_clear(RP2040_CLK_REF_CTRL, RP2040_CLK_REF_SOURCE);
    wait_for(RP2040_CLK_REF_SELECTED, 1u);
}

// 2.18.2.1: dividers before the lock, post dividers after it.
static void start_pll(void) {
    canopy_rp2040_reset_blocks(RP2040_RESET_PLL_SYS);
    canopy_rp2040_put(RP2040_PLL_SYS_CS, 1u);
    canopy_rp2040_put(RP2040_PLL_SYS_FEEDBACK, PLL_FEEDBACK);
    canopy_rp2040_clear(RP2040_PLL_SYS_POWER, RP2040_PLL_POWER_DOWN);
    wait_for(RP2040_PLL_SYS_CS, RP2040_PLL_LOCKED);
    canopy_rp2040_put(RP2040_PLL_SYS_DIVIDERS, PLL_DIVIDERS);
    canopy_rp2040_clear(RP2040_PLL_SYS_POWER, RP2040_PLL_DIVIDERS_DOWN);
}

static void select_clocks(void) {
    canopy_rp2040_put(RP2040_CLK_REF_DIV, RP2040_CLK_DIV_ONE);
    canopy_rp2040_put(RP2040_CLK_REF_CTRL, RP2040_CLK_REF_SOURCE_XOSC);
    wait_for(RP2040_CLK_REF_SELECTED, 1u << RP2040_CLK_REF_SOURCE_XOSC);
    canopy_rp2040_put(RP2040_CLK_SYS_DIV, RP2040_CLK_DIV_ONE);
    canopy_rp2040_put(RP2040_CLK_SYS_CTRL, 0);  // the auxiliary source while it is not selected,
    canopy_rp2040_put(RP2040_CLK_SYS_CTRL, RP2040_CLK_SYS_SOURCE_AUX);  // then the glitchless change to it
    wait_for(RP2040_CLK_SYS_SELECTED, 1u << RP2040_CLK_SYS_SOURCE_AUX);
    canopy_rp2040_put(RP2040_CLK_PERI_CTRL, RP2040_CLK_PERI_ENABLE);
    canopy_rp2040_put(RP2040_WATCHDOG_TICK, RP2040_WATCHDOG_TICK_ENABLE | CRYSTAL_MHZ);
}

void canopy_rp2040_start_chip(void) {
    start_crystal();
    leave_pll();
    start_pll();
    select_clocks();
    canopy_rp2040_set(RP2040_PSM_FORCE_OFF, RP2040_PSM_PROCESSOR1);
    canopy_rp2040_reset_blocks(RP2040_RESET_IO_BANK0 | RP2040_RESET_PADS_BANK0 | RP2040_RESET_SYSCFG |
                               RP2040_RESET_TIMER);
}

void canopy_rp2040_set_pin(uint32_t pin, uint32_t function, uint32_t pad) {
    canopy_rp2040_put(RP2040_PAD(pin), pad);
    canopy_rp2040_put(RP2040_GPIO_CTRL(pin), function);
}
