#include "port/cortexm/startup.h"

#include "port/cortexm/core.h"

extern uint32_t canopy_data_load[], canopy_data_start[], canopy_data_end[], canopy_bss_start[], canopy_bss_end[];

int main(void);

void canopy_reset(void) {
    const uint32_t *from = canopy_data_load;
    for (uint32_t *to = canopy_data_start; to != canopy_data_end; to++)
        *to = *from++;
    for (uint32_t *to = canopy_bss_start; to != canopy_bss_end; to++)
        *to = 0;
    CANOPY_SCB_SHCSR |= 7u << 16;  // usage, bus and memory faults by their own names instead of HardFault
    CANOPY_SCB_CCR |= 1u << 4;     // division by zero faults
    (void)main();
    __asm volatile("udf #0");
}
