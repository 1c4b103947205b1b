/// Device registers. A test on a host has this header's guard and its own devices instead.
#ifndef CANOPY_PORT_RISCV_MMIO_H
#define CANOPY_PORT_RISCV_MMIO_H

#include <stdint.h>

static inline uint32_t canopy_mmio_read32(uintptr_t address) { return *(volatile uint32_t *)address; }
static inline void canopy_mmio_write32(uintptr_t address, uint32_t value) { *(volatile uint32_t *)address = value; }
static inline uint8_t canopy_mmio_read8(uintptr_t address) { return *(volatile uint8_t *)address; }
static inline void canopy_mmio_write8(uintptr_t address, uint8_t value) { *(volatile uint8_t *)address = value; }

#endif
