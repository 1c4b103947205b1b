#include "port/rp2040/flash.h"

#include <string.h>

#include "port/rp2040/registers.h"
#include "port/rp2040/watchdog.h"

#define ERASED 0xFFu
#define BLOCK_BYTES 65536u  // that the ROM would erase by BLOCK_ERASE
#define BLOCK_ERASE 0xD8u

// In RAM with all its constants. It is too far for a branch: the linker makes a detour, in flash, on the way there.
#ifdef __arm__
#define IN_RAM __attribute__((section(".ramfunc"), noinline, used))
#else
#define IN_RAM
#endif

// From exit_xip to enter_xip nothing may touch the flash: hosttest/test_uf2.py looks for what would.
IN_RAM static void write_flash(const struct canopy_rp2040_flash *flash, uint32_t offset, bool erase) {
    flash->steps.connect();
    flash->steps.exit_xip();
    if (erase)
        flash->steps.erase(offset, CANOPY_RP2040_FLASH_PAGE, BLOCK_BYTES, BLOCK_ERASE);
    else
        flash->steps.program(offset, flash->piece, CANOPY_RP2040_FLASH_PIECE);
    flash->steps.flush();
    flash->steps.enter_xip();
}

static void write_undisturbed(const struct canopy_rp2040_flash *flash, uint32_t offset, bool erase) {
    const uint32_t before = canopy_core_mask();
    canopy_rp2040_watchdog_hold();
    write_flash(flash, offset, erase);
    canopy_rp2040_watchdog_resume();
    canopy_core_restore(before);
}

static bool is_inside(const struct canopy_rp2040_flash *flash, uint32_t page, uint32_t offset, uint32_t length) {
    return page < flash->page_count && offset <= CANOPY_RP2040_FLASH_PAGE &&
           length <= CANOPY_RP2040_FLASH_PAGE - offset;
}

static enum canopy_status read(void *context, uint32_t page, uint32_t offset, uint8_t *to, uint32_t length) {
    const struct canopy_rp2040_flash *flash = context;
    if (!is_inside(flash, page, offset, length))
        return CANOPY_ARGUMENT;
    if (length > 0)
        memcpy(to, &flash->window[page * CANOPY_RP2040_FLASH_PAGE + offset], length);
    return CANOPY_OK;
}

static enum canopy_status erase(void *context, uint32_t page) {
    const struct canopy_rp2040_flash *flash = context;
    if (!is_inside(flash, page, 0, 0))
        return CANOPY_ARGUMENT;
    write_undisturbed(flash, flash->offset + page * CANOPY_RP2040_FLASH_PAGE, true);
    const uint8_t *seen = &flash->window[page * CANOPY_RP2040_FLASH_PAGE];
    for (uint32_t i = 0; i < CANOPY_RP2040_FLASH_PAGE; i++)
        if (seen[i] != ERASED)
            return CANOPY_RANGE;
    return CANOPY_OK;
}

// Whether all that was to be 0 is 0. The rest is what it was: memory is also programmed a second time, to clear more of
// it, and what a loss of power has left there may read as anything.
static bool is_cleared(const uint8_t *seen, const uint8_t *piece) {
    for (uint32_t i = 0; i < CANOPY_RP2040_FLASH_PIECE; i++)
        if ((seen[i] & (uint8_t)~piece[i]) != 0)
            return false;
    return true;
}

static enum canopy_status program(void *context, uint32_t page, uint32_t offset, const uint8_t *from, uint32_t length) {
    struct canopy_rp2040_flash *flash = context;
    if (!is_inside(flash, page, offset, length) || offset % CANOPY_RP2040_FLASH_PIECE != 0 ||
        length % CANOPY_RP2040_FLASH_PIECE != 0)
        return CANOPY_ARGUMENT;
    for (uint32_t done = 0; done < length; done += CANOPY_RP2040_FLASH_PIECE) {
        const uint32_t at = page * CANOPY_RP2040_FLASH_PAGE + offset + done;
        memcpy(flash->piece, &from[done], CANOPY_RP2040_FLASH_PIECE);
        write_undisturbed(flash, flash->offset + at, false);
        if (!is_cleared(&flash->window[at], flash->piece))
            return CANOPY_RANGE;
    }
    return CANOPY_OK;
}

void canopy_rp2040_flash_start(struct canopy_rp2040_flash *flash, const struct canopy_rp2040_flash_steps *steps,
                               const uint8_t *window, uint32_t offset, uint32_t page_count) {
    flash->steps = *steps;
    flash->window = window;
    flash->offset = offset;
    flash->page_count = page_count;
}

struct canopy_flash canopy_rp2040_flash(struct canopy_rp2040_flash *flash) {
    return (struct canopy_flash){.context = flash,
                                 .page_bytes = CANOPY_RP2040_FLASH_PAGE,
                                 .program_bytes = CANOPY_RP2040_FLASH_PIECE,
                                 .page_count = flash->page_count,
                                 .read = read,
                                 .erase = erase,
                                 .program = program};
}
