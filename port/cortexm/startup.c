#include "port/cortexm/startup.h"

#include "port/board.h"
#include "port/cortexm/core.h"

extern uint32_t canopy_data_load[], canopy_data_start[], canopy_data_end[], canopy_bss_start[], canopy_bss_end[];

int main(void);

// Below the stack there is no memory, but not every chip and no emulator faults there: forbid the 64 KB, where the chip
// can.
static void guard_stack(void) {
    if (CANOPY_MPU_TYPE == 0)
        return;
    CANOPY_MPU_RNR = 0;
    CANOPY_MPU_RBAR = (uint32_t)(uintptr_t)canopy_stack_limit - 65536u;
    CANOPY_MPU_RASR = 1u << 28 | 15u << 1 | 1u;  // no execution, no access, 2^16 bytes, enabled
    CANOPY_MPU_CTRL = 5;                         // the default map elsewhere; on, but not in HardFault and NMI
    __asm volatile("dsb\n\tisb" ::: "memory");
}

void canopy_reset(void) {
    const uint32_t *from = canopy_data_load;
    for (uint32_t *to = canopy_data_start; to != canopy_data_end; to++)
        *to = *from++;
    for (uint32_t *to = canopy_bss_start; to != canopy_bss_end; to++)
        *to = 0;
#if __ARM_ARCH > 6
    CANOPY_SCB_SHCSR |= 7u << 16;  // usage, bus and memory faults by their own names instead of HardFault
    CANOPY_SCB_CCR |= 1u << 4;     // division by zero faults
#endif
#ifdef __ARM_FP
    CANOPY_SCB_CPACR |= 15u << 20;  // full access to the floating-point unit
    __asm volatile("dsb\n\tisb" ::: "memory");
#endif
    guard_stack();
    (void)main();
    __asm volatile("udf #0");
}

uint32_t canopy_board_mask(void) { return canopy_core_mask(); }

void canopy_board_restore(uint32_t before) { canopy_core_restore(before); }
