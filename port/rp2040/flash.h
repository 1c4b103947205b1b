/// The last pages of an RP2040's flash as struct canopy_flash, by the functions of the boot ROM (datasheet 2.8.3.1.3).
///
/// While the flash is erased or programmed nobody can read it, so no code runs from it: interrupts are masked, the
/// watchdog's warning is off, and what runs is in RAM and in the ROM. An erase takes 45 ms, at most 400, and a piece of
/// 256 bytes 0.4 ms, at most 3 (W25Q16JV, 9.6); a received byte that comes meanwhile is lost and counted once. The
/// watchdog is given its longest time for each.
#ifndef CANOPY_PORT_RP2040_FLASH_H
#define CANOPY_PORT_RP2040_FLASH_H

#include "lib/port.h"

#define CANOPY_RP2040_FLASH_PAGE 4096u
#define CANOPY_RP2040_FLASH_PIECE 256u
#define CANOPY_RP2040_BOOT2_WORDS 63u

/// What is done with the flash, one after the other, all of it outside of the flash: five functions of the ROM, and the
/// copy of the boot block that brings back the fast way to read. Offsets are from the start of the flash.
struct canopy_rp2040_flash_steps {
    void (*connect)(void);   ///< pins to the controller
    void (*exit_xip)(void);  ///< the flash obeys instructions
    void (*erase)(uint32_t offset, size_t bytes, uint32_t block, uint8_t instruction);  ///< by blocks where it can
    void (*program)(uint32_t offset, const uint8_t *from, size_t bytes);
    void (*flush)(void);  ///< what the cache knew, and the forced chip select
    void (*enter_xip)(void);
};

/// Private.
struct canopy_rp2040_flash {
    struct canopy_rp2040_flash_steps steps;
    const uint8_t *window;  // where the first page can be read
    uint32_t offset;        // of the first page
    uint32_t page_count;
    uint8_t piece[CANOPY_RP2040_FLASH_PIECE];  // what is programmed may come from flash
};

/// Prepares `page_count` pages from `offset` on, which are seen at `window`.
void canopy_rp2040_flash_start(struct canopy_rp2040_flash *flash, const struct canopy_rp2040_flash_steps *steps,
                               const uint8_t *window, uint32_t offset, uint32_t page_count);

/// The memory of lib/port.h; `flash` must outlive it and be in RAM. What was written is read again: CANOPY_RANGE if a
/// byte is not erased, or a bit that was to be cleared is not.
struct canopy_flash canopy_rp2040_flash(struct canopy_rp2040_flash *flash);

/// The steps on the chip: looks the ROM's up in its table and copies the boot block to `boot2`, RAM that stays.
struct canopy_rp2040_flash_steps canopy_rp2040_rom_steps(uint32_t boot2[CANOPY_RP2040_BOOT2_WORDS]);

#endif
