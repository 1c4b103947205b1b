/// The registers and instructions of a Cortex-M (ARMv7-M Architecture Reference Manual, B3; ARMv6-M's, B3, has all but
/// those that stand under `#if __ARM_ARCH > 6`).
#ifndef CANOPY_PORT_CORTEXM_CORE_H
#define CANOPY_PORT_CORTEXM_CORE_H

#include <stdint.h>

#define CANOPY_REGISTER(address) (*(volatile uint32_t *)(address))

#define CANOPY_SYSTICK_CTRL CANOPY_REGISTER(0xE000E010u)
#define CANOPY_SYSTICK_LOAD CANOPY_REGISTER(0xE000E014u)
#define CANOPY_SYSTICK_VAL CANOPY_REGISTER(0xE000E018u)
#define CANOPY_SCB_ICSR CANOPY_REGISTER(0xE000ED04u)
#define CANOPY_SCB_AIRCR CANOPY_REGISTER(0xE000ED0Cu)
#if __ARM_ARCH > 6
#define CANOPY_SCB_CCR CANOPY_REGISTER(0xE000ED14u)
#define CANOPY_SCB_SHCSR CANOPY_REGISTER(0xE000ED24u)
#define CANOPY_SCB_CFSR CANOPY_REGISTER(0xE000ED28u)
#define CANOPY_SCB_HFSR CANOPY_REGISTER(0xE000ED2Cu)
#define CANOPY_SCB_MMFAR CANOPY_REGISTER(0xE000ED34u)
#define CANOPY_SCB_BFAR CANOPY_REGISTER(0xE000ED38u)
#define CANOPY_SCB_CPACR CANOPY_REGISTER(0xE000ED88u)
#endif

#define CANOPY_MPU_TYPE CANOPY_REGISTER(0xE000ED90u)
#define CANOPY_MPU_CTRL CANOPY_REGISTER(0xE000ED94u)
#define CANOPY_MPU_RNR CANOPY_REGISTER(0xE000ED98u)
#define CANOPY_MPU_RBAR CANOPY_REGISTER(0xE000ED9Cu)
#define CANOPY_MPU_RASR CANOPY_REGISTER(0xE000EDA0u)

#define CANOPY_ICSR_SYSTICK_PENDING (1u << 26)

/// Lets an interrupt through the controller; interrupts start out blocked.
static inline void canopy_core_enable_irq(uint32_t irq) {
    CANOPY_REGISTER(0xE000E100u + 4u * (irq / 32u)) = 1u << (irq % 32u);
}

/// Masks all interrupts and tells whether they were masked before. Give that to canopy_core_restore.
static inline uint32_t canopy_core_mask(void) {
    uint32_t before;
    __asm volatile("mrs %0, primask\n\tcpsid i" : "=r"(before)::"memory");
    return before;
}

static inline void canopy_core_restore(uint32_t before) { __asm volatile("msr primask, %0" ::"r"(before) : "memory"); }

/// True if an interrupt would be taken now: none are masked, and no exception is being handled.
static inline int canopy_core_takes_interrupts(void) {
    uint32_t masked, exception;
    __asm volatile("mrs %0, primask\n\tmrs %1, ipsr" : "=r"(masked), "=r"(exception)::"memory");
    return masked == 0 && exception == 0;
}

/// Sleeps until an interrupt is pending, masked or not.
static inline void canopy_core_wait(void) { __asm volatile("dsb\n\twfi" ::: "memory"); }

/// Asks for a system reset and waits for it.
static inline _Noreturn void canopy_core_reset(void) {
    __asm volatile("dsb" ::: "memory");
    CANOPY_SCB_AIRCR = 0x05FA0004u;
    for (;;)
        __asm volatile("dsb" ::: "memory");
}

#endif
