/// The test finisher of SiFive's simulations and of QEMU's `virt` (device tree binding sifive,test0): it ends an
/// emulated run with a status, or resets. No chip has it: there, write your own reset.
#ifndef CANOPY_PORT_RISCV_SIFIVE_TEST_H
#define CANOPY_PORT_RISCV_SIFIVE_TEST_H

#include "port/riscv/mmio.h"

#define CANOPY_SIFIVE_TEST_PASS 0x5555u
#define CANOPY_SIFIVE_TEST_FAIL(status) ((uint32_t)(status) << 16 | 0x3333u)
#define CANOPY_SIFIVE_TEST_RESET 0x7777u

static inline _Noreturn void canopy_sifive_test_end(uintptr_t base, uint32_t how) {
    canopy_mmio_write32(base, how);
    for (;;)
        ;
}

#endif
