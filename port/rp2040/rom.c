// The boot ROM's functions for flash (datasheet 2.8.3): found by two letters in a table.
#include "port/rp2040/flash.h"
#include "port/rp2040/registers.h"

#define ROM_FUNCTIONS 0x14u  // in the lower halves of two words: where the table is, and who finds in it
#define ROM_LOOK_UP 0x18u
#define FLASH_START 0x10000000u

typedef uintptr_t (*look_up_fn)(const uint16_t *table, uint32_t code);

static uintptr_t find(char first, char second) {
    const look_up_fn look_up = (look_up_fn)(uintptr_t)(uint16_t)canopy_rp2040_get(ROM_LOOK_UP);
    const uint16_t *table = (const uint16_t *)(uintptr_t)(uint16_t)canopy_rp2040_get(ROM_FUNCTIONS);
    return look_up(table, (uint32_t)(uint8_t)second << 8 | (uint8_t)first);
}

struct canopy_rp2040_flash_steps canopy_rp2040_rom_steps(uint32_t boot2[CANOPY_RP2040_BOOT2_WORDS]) {
    for (uint32_t i = 0; i < CANOPY_RP2040_BOOT2_WORDS; i++)
        boot2[i] = canopy_rp2040_get(FLASH_START + 4u * i);
    return (struct canopy_rp2040_flash_steps){
        .connect = (void (*)(void))find('I', 'F'),
        .exit_xip = (void (*)(void))find('E', 'X'),
        .erase = (void (*)(uint32_t, size_t, uint32_t, uint8_t))find('R', 'E'),
        .program = (void (*)(uint32_t, const uint8_t *, size_t))find('R', 'P'),
        .flush = (void (*)(void))find('F', 'C'),
        .enter_xip = (void (*)(void))((uintptr_t)boot2 | 1u),
    };
}
