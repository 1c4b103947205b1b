/// What every RP2040 needs before its devices: clocks, resets, pins.
#ifndef CANOPY_PORT_RP2040_CHIP_H
#define CANOPY_PORT_RP2040_CHIP_H

#include <stdint.h>

#define CANOPY_RP2040_CRYSTAL_HZ 12000000u
#define CANOPY_RP2040_CLOCK_HZ 125000000u

/// Starts the crystal (1 ms), PLL_SYS and from it clk_sys and clk_peri at 125 MHz, clk_ref and the microsecond tick
/// from the crystal; holds processor 1 in reset; takes timer, pins and SYSCFG out of theirs. Call it once: pins and
/// timer start anew. Without a crystal it does not return.
void canopy_rp2040_start_chip(void);

/// Resets blocks (RP2040_RESET_...), takes them out of reset and waits until they are.
void canopy_rp2040_reset_blocks(uint32_t blocks);

/// Gives a pin a function (RP2040_FUNCTION_...) and its pad these bits (RP2040_PAD_...).
void canopy_rp2040_set_pin(uint32_t pin, uint32_t function, uint32_t pad);

#endif
