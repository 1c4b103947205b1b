/// The registers of the RP2040 that this port uses, by the sections of its datasheet (RP2040 Datasheet, Raspberry Pi
/// Ltd), and how they are reached.
///
/// On the chip an access is one load or one store. On a host it is a function of the test that plays the chip, so that
/// what an emulator lacks (a full transmitter, a line held low, flash that is busy) is tested with this very code.
#ifndef CANOPY_PORT_RP2040_REGISTERS_H
#define CANOPY_PORT_RP2040_REGISTERS_H

#include <stdint.h>

#ifdef __arm__
#include "port/cortexm/core.h"

static inline uint32_t canopy_rp2040_get(uint32_t address) { return CANOPY_REGISTER(address); }
static inline void canopy_rp2040_put(uint32_t address, uint32_t value) { CANOPY_REGISTER(address) = value; }
#else
uint32_t canopy_rp2040_get(uint32_t address);
void canopy_rp2040_put(uint32_t address, uint32_t value);
uint32_t canopy_core_mask(void);
void canopy_core_restore(uint32_t before);
void canopy_core_enable_irq(uint32_t irq);
#endif

/// 2.1.2: writes here set or clear bits of the register below, in one bus access. Not for SIO.
#define RP2040_SET 0x2000u
#define RP2040_CLEAR 0x3000u

static inline void canopy_rp2040_set(uint32_t address, uint32_t bits) { canopy_rp2040_put(address + RP2040_SET, bits); }
static inline void canopy_rp2040_clear(uint32_t address, uint32_t bits) {
    canopy_rp2040_put(address + RP2040_CLEAR, bits);
}

// 2.3.2 interrupts
#define RP2040_IRQ_TIMER 0u  // and the three after it: one an alarm
#define RP2040_IRQ_UART0 20u
#define RP2040_IRQ_UART1 21u
#define RP2040_IRQ_I2C0 23u
#define RP2040_IRQ_I2C1 24u

// 2.3.1.7 SIO: GPIO outputs and inputs, a bit a pin
#define RP2040_GPIO_IN 0xD0000004u
#define RP2040_GPIO_OUT_SET 0xD0000014u
#define RP2040_GPIO_OUT_CLEAR 0xD0000018u
#define RP2040_GPIO_ENABLE_SET 0xD0000024u
#define RP2040_GPIO_ENABLE_CLEAR 0xD0000028u

// 2.13.5 power-on state machine
#define RP2040_PSM_FORCE_OFF 0x40010004u
#define RP2040_PSM_WATCHDOG_SELECT 0x40010008u
#define RP2040_PSM_OSCILLATORS 0x00003u
#define RP2040_PSM_PROCESSOR1 0x10000u
#define RP2040_PSM_ALL 0x1FFFFu

// 2.14.3 subsystem resets
#define RP2040_RESETS_RESET 0x4000C000u
#define RP2040_RESETS_DONE 0x4000C008u
#define RP2040_RESET_I2C0 (1u << 3)
#define RP2040_RESET_I2C1 (1u << 4)
#define RP2040_RESET_IO_BANK0 (1u << 5)
#define RP2040_RESET_PADS_BANK0 (1u << 8)
#define RP2040_RESET_PLL_SYS (1u << 12)
#define RP2040_RESET_SYSCFG (1u << 18)
#define RP2040_RESET_TIMER (1u << 21)
#define RP2040_RESET_UART0 (1u << 22)
#define RP2040_RESET_UART1 (1u << 23)

// 2.15.7 clocks
#define RP2040_CLK_REF_CTRL 0x40008030u
#define RP2040_CLK_REF_DIV 0x40008034u
#define RP2040_CLK_REF_SELECTED 0x40008038u
#define RP2040_CLK_SYS_CTRL 0x4000803Cu
#define RP2040_CLK_SYS_DIV 0x40008040u
#define RP2040_CLK_SYS_SELECTED 0x40008044u
#define RP2040_CLK_PERI_CTRL 0x40008048u
#define RP2040_CLK_SYS_RESUS_CTRL 0x40008078u
#define RP2040_CLK_REF_SOURCE_XOSC 2u
#define RP2040_CLK_REF_SOURCE 3u
#define RP2040_CLK_SYS_SOURCE_AUX 1u  // with AUXSRC 0: PLL_SYS
#define RP2040_CLK_SYS_SOURCE 1u
#define RP2040_CLK_PERI_ENABLE (1u << 11)  // with AUXSRC 0: clk_sys
#define RP2040_CLK_DIV_ONE 0x100u

// 2.16.7 crystal oscillator
#define RP2040_XOSC_CTRL 0x40024000u
#define RP2040_XOSC_STATUS 0x40024004u
#define RP2040_XOSC_STARTUP 0x4002400Cu
#define RP2040_XOSC_1_TO_15_MHZ 0xAA0u
#define RP2040_XOSC_ENABLE (0xFABu << 12)
#define RP2040_XOSC_STABLE (1u << 31)

// 2.18.4 PLL
#define RP2040_PLL_SYS_CS 0x40028000u
#define RP2040_PLL_SYS_POWER 0x40028004u
#define RP2040_PLL_SYS_FEEDBACK 0x40028008u
#define RP2040_PLL_SYS_DIVIDERS 0x4002800Cu
#define RP2040_PLL_LOCKED (1u << 31)
#define RP2040_PLL_POWER_DOWN (1u << 0 | 1u << 5)  // the whole, its oscillator
#define RP2040_PLL_DIVIDERS_DOWN (1u << 3)

// 2.19.6 GPIO: function, and pads
#define RP2040_GPIO_CTRL(pin) (0x40014004u + 8u * (pin))
#define RP2040_PAD(pin) (0x4001C004u + 4u * (pin))
#define RP2040_FUNCTION_UART 2u
#define RP2040_FUNCTION_I2C 3u
#define RP2040_FUNCTION_SIO 5u
#define RP2040_PAD_SCHMITT (1u << 1)
#define RP2040_PAD_PULL_DOWN (1u << 2)
#define RP2040_PAD_PULL_UP (1u << 3)
#define RP2040_PAD_4_MA (1u << 4)
#define RP2040_PAD_INPUT (1u << 6)

// 2.21.2 SYSCFG: interrupts of processor 0 that are non-maskable
#define RP2040_SYSCFG_NMI_MASK 0x40004000u

// 4.2.8 UART (PL011): offsets; Arm's PrimeCell UART (PL011) technical reference, 3.3, says more
#define RP2040_UART0 0x40034000u
#define RP2040_UART1 0x40038000u
#define RP2040_UART_DR 0x00u
#define RP2040_UART_FR 0x18u
#define RP2040_UART_IBRD 0x24u
#define RP2040_UART_FBRD 0x28u
#define RP2040_UART_LCR_H 0x2Cu
#define RP2040_UART_CR 0x30u
#define RP2040_UART_IMSC 0x38u
#define RP2040_UART_MIS 0x40u
#define RP2040_UART_ICR 0x44u
#define RP2040_UART_DR_BAD (7u << 8)  // framing, parity, break
#define RP2040_UART_FR_BUSY (1u << 3)
#define RP2040_UART_FR_RECEIVE_EMPTY (1u << 4)
#define RP2040_UART_FR_SEND_FULL (1u << 5)
#define RP2040_UART_LCR_PARITY (1u << 1)
#define RP2040_UART_LCR_EVEN (1u << 2)
#define RP2040_UART_LCR_8_BITS (3u << 5)
#define RP2040_UART_CR_ON (1u | 1u << 8 | 1u << 9)  // the whole, transmitter, receiver
#define RP2040_UART_INT_RECEIVE (1u << 4)
#define RP2040_UART_INT_SEND (1u << 5)
#define RP2040_UART_INT_OVERRUN (1u << 10)

// 4.3.17 I2C (DW_apb_i2c): offsets
#define RP2040_I2C0 0x40044000u
#define RP2040_I2C1 0x40048000u
#define RP2040_I2C_CON 0x00u
#define RP2040_I2C_TAR 0x04u
#define RP2040_I2C_DATA_CMD 0x10u
#define RP2040_I2C_FS_SCL_HCNT 0x1Cu
#define RP2040_I2C_FS_SCL_LCNT 0x20u
#define RP2040_I2C_INTR_MASK 0x30u
#define RP2040_I2C_RAW_INTR_STAT 0x34u
#define RP2040_I2C_RX_TL 0x38u
#define RP2040_I2C_TX_TL 0x3Cu
#define RP2040_I2C_CLR_INTR 0x40u
#define RP2040_I2C_CLR_TX_ABRT 0x54u
#define RP2040_I2C_CLR_STOP_DET 0x60u
#define RP2040_I2C_ENABLE 0x6Cu
#define RP2040_I2C_STATUS 0x70u
#define RP2040_I2C_TXFLR 0x74u
#define RP2040_I2C_RXFLR 0x78u
#define RP2040_I2C_SDA_HOLD 0x7Cu
#define RP2040_I2C_TX_ABRT_SOURCE 0x80u
#define RP2040_I2C_ENABLE_STATUS 0x9Cu
#define RP2040_I2C_FS_SPKLEN 0xA0u
#define RP2040_I2C_CON_MASTER (1u << 0 | 1u << 6)  // master, and the slave of the block off: both or neither
#define RP2040_I2C_CON_FAST (2u << 1)
#define RP2040_I2C_CON_RESTART (1u << 5)
#define RP2040_I2C_CMD_READ (1u << 8)
#define RP2040_I2C_CMD_STOP (1u << 9)
#define RP2040_I2C_CMD_RESTART (1u << 10)
#define RP2040_I2C_INT_TX_EMPTY (1u << 4)
#define RP2040_I2C_INT_TX_ABRT (1u << 6)
#define RP2040_I2C_INT_STOP_DET (1u << 9)
#define RP2040_I2C_STATUS_MASTER_ACTIVE (1u << 5)
#define RP2040_I2C_ABRT_NO_ADDRESS (1u << 0 | 1u << 4)  // of a device, of a general call
#define RP2040_I2C_ABRT_NO_DATA (1u << 3)
#define RP2040_I2C_ABRT_ARBITRATION (1u << 12)
#define RP2040_I2C_FIFO 16u

// 4.6.5 timer
#define RP2040_TIMER_ALARM(number) (0x40054010u + 4u * (number))
#define RP2040_TIMER_ARMED 0x40054020u
#define RP2040_TIMER_RAW_HIGH 0x40054024u
#define RP2040_TIMER_RAW_LOW 0x40054028u
#define RP2040_TIMER_INTR 0x40054034u
#define RP2040_TIMER_INTE 0x40054038u
#define RP2040_TIMER_INTF 0x4005403Cu

// 4.7.6 watchdog
#define RP2040_WATCHDOG_CTRL 0x40058000u
#define RP2040_WATCHDOG_LOAD 0x40058004u
#define RP2040_WATCHDOG_REASON 0x40058008u
#define RP2040_WATCHDOG_SCRATCH2 0x40058014u
#define RP2040_WATCHDOG_TICK 0x4005802Cu
#define RP2040_WATCHDOG_TRIGGER (1u << 31)
#define RP2040_WATCHDOG_ENABLE (1u << 30)
#define RP2040_WATCHDOG_LOAD_MOST 0xFFFFFFu
#define RP2040_WATCHDOG_REASON_TIMER (1u << 0)
#define RP2040_WATCHDOG_TICK_ENABLE (1u << 9)

#endif
