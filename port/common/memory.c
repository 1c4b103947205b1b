// The program's own memory, as linker/sections.ld lays it out.
#include "port/board.h"

extern uint32_t canopy_ram_start[], canopy_ram_end[], canopy_stack_limit[], canopy_stack_top[];
extern const uint8_t canopy_flash_start[];
extern const uint32_t canopy_flash_end[];

struct canopy_memory canopy_board_memory(void) {
    return (struct canopy_memory){.ram = canopy_ram_start,
                                  .ram_end = canopy_ram_end,
                                  .stack_end = canopy_stack_top,
                                  .stack = canopy_stack_limit,
                                  .flash = canopy_flash_start,
                                  .flash_end = canopy_flash_end,
                                  .mask = canopy_board_mask,
                                  .restore = canopy_board_restore};
}
