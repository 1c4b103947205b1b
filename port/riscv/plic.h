/// The platform-level interrupt controller (RISC-V PLIC specification 1.0.0) for one context: hart 0 in machine mode,
/// which is context 0.
#ifndef CANOPY_PORT_RISCV_PLIC_H
#define CANOPY_PORT_RISCV_PLIC_H

#include "port/riscv/mmio.h"

#define CANOPY_PLIC_PRIORITY(irq) (4u * (irq))
#define CANOPY_PLIC_ENABLE(irq) (0x2000u + 4u * ((irq) / 32u))
#define CANOPY_PLIC_THRESHOLD 0x200000u
#define CANOPY_PLIC_CLAIM 0x200004u  // reading claims, writing completes

/// Lets the interrupt through; all have one priority, so that none interrupts another.
static inline void canopy_plic_enable(uintptr_t base, uint32_t irq) {
    const uintptr_t enable = base + CANOPY_PLIC_ENABLE(irq);
    canopy_mmio_write32(base + CANOPY_PLIC_PRIORITY(irq), 1);
    canopy_mmio_write32(enable, canopy_mmio_read32(enable) | 1u << (irq % 32u));
    canopy_mmio_write32(base + CANOPY_PLIC_THRESHOLD, 0);
}

/// The interrupt to be handled, 0 if it has gone.
static inline uint32_t canopy_plic_claim(uintptr_t base) { return canopy_mmio_read32(base + CANOPY_PLIC_CLAIM); }

static inline void canopy_plic_complete(uintptr_t base, uint32_t irq) {
    canopy_mmio_write32(base + CANOPY_PLIC_CLAIM, irq);
}

#endif
