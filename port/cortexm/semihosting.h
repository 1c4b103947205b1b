/// Ends an emulated run with an exit status. For test images only: without a debugger real hardware faults here.
#ifndef CANOPY_PORT_CORTEXM_SEMIHOSTING_H
#define CANOPY_PORT_CORTEXM_SEMIHOSTING_H

#include <stdbool.h>
#include <stdint.h>

static inline _Noreturn void canopy_semihosting_exit(bool success) {
    // SYS_EXIT with ADP_Stopped_ApplicationExit, or ADP_Stopped_RunTimeErrorUnknown
    register uint32_t operation __asm("r0") = 0x18;
    const uint32_t how = success ? 0x20026 : 0x20023;
    register uint32_t reason __asm("r1") = how;
    for (;;)
        __asm volatile("bkpt 0xab" ::"r"(operation), "r"(reason) : "memory");
}

#endif
