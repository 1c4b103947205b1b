// The board of lib's programs (port/board.h) on a RISC-V hart with CLINT, PLIC and one 16550 UART, their data from the
// board's own board.h.
#include "port/board.h"

#include "board.h"  // of BOARD
#include "port/riscv/clint.h"
#include "port/riscv/core.h"
#include "port/riscv/ns16550.h"
#include "port/riscv/plic.h"
#include "port/riscv/semihosting.h"
#include "port/riscv/sifive_test.h"
#include "port/riscv/trap.h"
#include "port/template/flash.h"
#include "port/template/i2c.h"
#include "port/template/stream.h"

#define SLEEP_MOST_US 100000u
#define CODE_TIMER 7u
#define CODE_EXTERNAL 11u

static struct canopy_clint clint;
static struct canopy_ns16550 uart;
static uint8_t receive_ring[BOARD_RECEIVE_LENGTH];
static uint8_t send_ring[BOARD_SEND_LENGTH];
static volatile uint32_t activity;

void canopy_board_put(char character) { canopy_semihosting_put(character); }

struct canopy_board canopy_board_start(const uint32_t baud[CANOPY_BOARD_LINES]) {
    const struct canopy_ns16550_config config = {.base = BOARD_UART_BASE,
                                                 .stride = BOARD_UART_STRIDE,
                                                 .clock_hz = BOARD_UART_CLOCK_HZ,
                                                 .baud = baud[0],
                                                 .receive_ring = receive_ring,
                                                 .send_ring = send_ring,
                                                 .receive_length = BOARD_RECEIVE_LENGTH,
                                                 .send_length = BOARD_SEND_LENGTH};
    canopy_clint_start(&clint, BOARD_CLINT_BASE, BOARD_MTIME_HZ);
    canopy_ns16550_start(&uart, &config);
    canopy_plic_enable(BOARD_PLIC_BASE, BOARD_UART_IRQ);
    CANOPY_CSR_SET(mie, CANOPY_MIE_TIMER | CANOPY_MIE_EXTERNAL);
    return (struct canopy_board){.clock = canopy_clint_clock(&clint),
                                 .line = {canopy_ns16550_stream(&uart), canopy_no_stream()},
                                 .line_count = 1,
                                 .i2c = canopy_no_i2c(),
                                 .flash = canopy_no_flash(),
                                 .watchdog = canopy_clint_watchdog(&clint)};
}

static void take_external(const struct canopy_trap_place *place) {
    const uint32_t irq = canopy_plic_claim(BOARD_PLIC_BASE);
    if (irq == BOARD_UART_IRQ)
        canopy_ns16550_on_interrupt(&uart);
    else if (irq != 0)
        canopy_trap_crash(16u + irq, place);
    canopy_plic_complete(BOARD_PLIC_BASE, irq);
}

bool canopy_trap_interrupt(uint32_t code, const struct canopy_trap_place *place) {
    activity++;
    if (code == CODE_EXTERNAL)
        take_external(place);
    else if (code == CODE_TIMER && canopy_clint_on_timer(&clint) == CANOPY_CLINT_HANG)
        canopy_trap_crash(CANOPY_CRASH_WATCHDOG, place);
    return code == CODE_TIMER || code == CODE_EXTERNAL;
}

struct canopy_flash canopy_board_flash(void) {
    return canopy_no_flash();
}

bool canopy_board_start_watchdog(uint32_t period_us) {
    const uint32_t before = canopy_core_mask();
    const bool started = canopy_clint_start_watchdog(&clint, period_us);
    canopy_core_restore(before);
    return started;
}

uint32_t canopy_board_activity(void) { return activity; }

void canopy_board_sleep(uint64_t due_us, uint32_t seen) {
    const uint64_t now_us = canopy_clint_now_us(&clint);
    if (due_us <= now_us)
        return;
    // Masked, so that an interrupt between the look and the sleep still ends the sleep.
    const uint32_t before = canopy_core_mask();
    if (activity == seen) {
        canopy_clint_alarm(&clint, due_us - now_us < SLEEP_MOST_US ? due_us : now_us + SLEEP_MOST_US);
        canopy_core_wait();
    }
    canopy_core_restore(before);
}

void canopy_board_reset(void) { canopy_sifive_test_end(BOARD_TEST_BASE, CANOPY_SIFIVE_TEST_RESET); }

uint64_t canopy_board_instructions(void) { return canopy_core_instructions(); }

void canopy_board_exit(bool good) {
    canopy_sifive_test_end(BOARD_TEST_BASE, good ? CANOPY_SIFIVE_TEST_PASS : CANOPY_SIFIVE_TEST_FAIL(1));
}
