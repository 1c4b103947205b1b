// Start-up of a processor that takes its stack pointer and its first instruction from a table at the lowest address of
// its flash. Another one begins in assembly (port/riscv/startup.c); a Cortex-M has this and more in port/cortexm.
#include <stdint.h>

#include "port/board.h"

// All from linker/sections.ld
extern uint32_t canopy_stack_top[], canopy_data_load[], canopy_data_start[], canopy_data_end[], canopy_bss_start[],
    canopy_bss_end[];

int main(void);
void canopy_reset(void);

// Turn on what the processor needs (a floating-point unit, faults by their names), forbid the 64 KB below
// canopy_stack_limit where the chip can, and let interrupts in, in front of main. .noinit is left as it is.
void canopy_reset(void) {
    const uint32_t *from = canopy_data_load;
    for (uint32_t *to = canopy_data_start; to != canopy_data_end; to++)
        *to = *from++;
    for (uint32_t *to = canopy_bss_start; to != canopy_bss_end; to++)
        *to = 0;
    (void)main();
    canopy_board_reset();  // a main that returns: record it as a crash once there is a record
}

struct vectors {
    uint32_t *stack_top;
    void (*reset)(void);
};

__attribute__((section(".vectors"), used)) static const struct vectors vectors = {canopy_stack_top, canopy_reset};
