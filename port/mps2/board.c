// The board of lib's programs (port/board.h) on Arm's MPS2: two CMSDK UARTs, their data from the board's own board.h.
#include "port/board.h"

#include "board.h"  // of BOARD
#include "port/cortexm/clock.h"
#include "port/cortexm/core.h"
#include "port/cortexm/crash.h"
#include "port/cortexm/semihosting.h"
#include "port/cortexm/startup.h"
#include "port/mps2/cmsdk_timer.h"
#include "port/mps2/cmsdk_uart.h"
#include "port/mps2/cmsdk_watchdog.h"
#include "port/template/flash.h"
#include "port/template/i2c.h"

static struct canopy_cmsdk_uart uart[2];
static uint8_t receive_ring[2][BOARD_RECEIVE_LENGTH];
static uint8_t send_ring[2][BOARD_SEND_LENGTH];
static struct canopy_cmsdk_timer timer;
static struct canopy_cmsdk_watchdog watchdog = {.base = BOARD_WATCHDOG_BASE};

static void uart0_receive(void) { canopy_cmsdk_uart_on_receive(&uart[0]); }
static void uart0_transmit(void) { canopy_cmsdk_uart_on_transmit(&uart[0]); }
static void uart1_receive(void) { canopy_cmsdk_uart_on_receive(&uart[1]); }
static void uart1_transmit(void) { canopy_cmsdk_uart_on_transmit(&uart[1]); }
static void timer_alarm(void) { canopy_cmsdk_timer_on_alarm(&timer); }

void canopy_board_put(char character) { canopy_cmsdk_uart_put(BOARD_CONSOLE_BASE, character); }

struct canopy_board canopy_board_start(const uint32_t baud[CANOPY_BOARD_LINES]) {
    canopy_cortexm_clock_start(BOARD_CLOCK_HZ);
    canopy_cmsdk_timer_start(&timer, BOARD_TIMER_BASE, BOARD_CLOCK_HZ, BOARD_TIMER_IRQ);
    struct canopy_cmsdk_uart_config config = {.base = BOARD_UART0_BASE,
                                              .clock_hz = BOARD_CLOCK_HZ,
                                              .baud = baud[0],
                                              .receive_irq = BOARD_UART0_RECEIVE_IRQ,
                                              .transmit_irq = BOARD_UART0_TRANSMIT_IRQ,
                                              .clock = canopy_cortexm_clock(),
                                              .receive_ring = receive_ring[0],
                                              .send_ring = send_ring[0],
                                              .receive_length = BOARD_RECEIVE_LENGTH,
                                              .send_length = BOARD_SEND_LENGTH};
    canopy_cmsdk_uart_start(&uart[0], &config);
    config.base = BOARD_UART1_BASE;
    config.baud = baud[1];
    config.receive_irq = BOARD_UART1_RECEIVE_IRQ;
    config.transmit_irq = BOARD_UART1_TRANSMIT_IRQ;
    config.receive_ring = receive_ring[1];
    config.send_ring = send_ring[1];
    canopy_cmsdk_uart_start(&uart[1], &config);
    return (struct canopy_board){.clock = canopy_cortexm_clock(),
                                 .line = {canopy_cmsdk_uart_stream(&uart[0]), canopy_cmsdk_uart_stream(&uart[1])},
                                 .line_count = 2,
                                 .i2c = canopy_no_i2c(),
                                 .flash = canopy_no_flash(),
                                 .watchdog = canopy_cmsdk_watchdog(&watchdog)};
}

struct canopy_flash canopy_board_flash(void) {
    return canopy_no_flash();
}

bool canopy_board_start_watchdog(uint32_t period_us) {
    if (period_us == 0 || period_us > UINT32_MAX / (BOARD_CLOCK_HZ / 1000000u))
        return false;  // beyond its counter
    canopy_cmsdk_watchdog_start(&watchdog, BOARD_WATCHDOG_BASE, BOARD_CLOCK_HZ, period_us);
    return true;
}

uint32_t canopy_board_activity(void) { return canopy_cortexm_activity(); }

void canopy_board_sleep(uint64_t due_us, uint32_t seen) {
    const uint64_t now_us = canopy_cortexm_now_us();
    if (due_us <= now_us)
        return;
    canopy_cmsdk_timer_alarm(&timer, due_us - now_us < 100000u ? (uint32_t)(due_us - now_us) : 100000u);
    canopy_cortexm_idle(seen);
}

void canopy_board_reset(void) { canopy_core_reset(); }

// Under `qemu -icount shift=0` an instruction takes one nanosecond of virtual time, and SysTick runs at 25 MHz of it.
uint64_t canopy_board_instructions(void) { return canopy_cortexm_ticks() * (1000000000u / BOARD_CLOCK_HZ); }

void canopy_board_exit(bool good) { canopy_semihosting_exit(good); }

struct vectors {
    uint32_t *stack_top;
    void (*entry[15 + BOARD_IRQS])(void);
};

#define IRQ(number) [15 + (number)]

__attribute__((section(".vectors"), used)) static const struct vectors vectors = {
    .stack_top = canopy_stack_top,
    .entry =
        {
            [0] = canopy_reset,
            [1 ... 13] = canopy_crash_entry,
            [14] = canopy_systick_entry,
            IRQ(BOARD_UART0_RECEIVE_IRQ) = uart0_receive,
            IRQ(BOARD_UART0_TRANSMIT_IRQ) = uart0_transmit,
            IRQ(BOARD_UART1_RECEIVE_IRQ) = uart1_receive,
            IRQ(BOARD_UART1_TRANSMIT_IRQ) = uart1_transmit,
            [15 + 4 ... 15 + BOARD_TIMER_IRQ - 1] = canopy_crash_entry,
            IRQ(BOARD_TIMER_IRQ) = timer_alarm,
            [15 + BOARD_TIMER_IRQ + 1 ... 15 + BOARD_IRQS - 1] = canopy_crash_entry,
        },
};
