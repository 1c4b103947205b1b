// The board of lib's programs (port/board.h) on an RP2040: two UARTs, I2C, flash; pins from the board's own board.h.
#include "port/board.h"

#include "board.h"  // of BOARD
#include "port/cortexm/clock.h"
#include "port/cortexm/crash.h"
#include "port/cortexm/semihosting.h"
#include "port/cortexm/startup.h"
#include "port/rp2040/chip.h"
#include "port/rp2040/dw_i2c.h"
#include "port/rp2040/flash.h"
#include "port/rp2040/pl011.h"
#include "port/rp2040/registers.h"
#include "port/rp2040/timer.h"
#include "port/rp2040/watchdog.h"

// The alarms of the timer; the watchdog has its own.
#define ALARM_SLEEP 0u
#define ALARM_LINE0 2u
#define ALARM_I2C 3u

#define FLASH_START 0x10000000u
#define CONSOLE_BAUD 115200u
#define LONGEST_SLEEP_US 100000u
#define PAD_OUTPUT (RP2040_PAD_4_MA | RP2040_PAD_INPUT)
#define PAD_IDLE_HIGH (RP2040_PAD_4_MA | RP2040_PAD_INPUT | RP2040_PAD_SCHMITT | RP2040_PAD_PULL_UP)

static struct canopy_pl011 uart[2];
static uint8_t receive_ring[2][BOARD_RECEIVE_LENGTH];
static uint8_t send_ring[2][BOARD_SEND_LENGTH];
static struct canopy_dw_i2c i2c;
static struct canopy_rp2040_flash flash;
static uint32_t boot2[CANOPY_RP2040_BOOT2_WORDS];
static bool chip_runs, lines_run, counts;

// From the linker: the pages of flash behind the program's room, and how many there are.
extern const uint8_t canopy_settings[], canopy_settings_pages[];

static void on_uart0(void) {
    canopy_pl011_on_interrupt(&uart[0]);
    canopy_cortexm_note_activity();
}

static void on_uart1(void) {
    canopy_pl011_on_interrupt(&uart[1]);
    canopy_cortexm_note_activity();
}

static void on_sleep_alarm(void) {
    canopy_rp2040_clear_alarm(ALARM_SLEEP);
    canopy_cortexm_note_activity();
}

static void on_line0_alarm(void) {
    canopy_pl011_on_alarm(&uart[0]);
    canopy_cortexm_note_activity();
}

static void on_i2c(void) {
    if (canopy_dw_i2c_on_interrupt(&i2c))
        canopy_cortexm_note_activity();
}

static void on_i2c_alarm(void) {
    canopy_dw_i2c_on_alarm(&i2c);
    canopy_cortexm_note_activity();
}

// Low from the first: a direction pin that floats would hold an RS-485 bus.
static void start_output(uint32_t pin) {
    canopy_rp2040_put(RP2040_GPIO_OUT_CLEAR, 1u << pin);
    canopy_rp2040_put(RP2040_GPIO_ENABLE_SET, 1u << pin);
    canopy_rp2040_set_pin(pin, RP2040_FUNCTION_SIO, PAD_OUTPUT);
}

static void start_uart_pins(uint32_t send, uint32_t receive) {
    canopy_rp2040_set_pin(send, RP2040_FUNCTION_UART, PAD_OUTPUT);
    canopy_rp2040_set_pin(receive, RP2040_FUNCTION_UART, PAD_IDLE_HIGH);
}

static void start_chip_and_console(void) {
    canopy_rp2040_start_chip();
    start_output(BOARD_UART0_DIRECTION_PIN);
    start_output(BOARD_LED_PIN);
    start_uart_pins(BOARD_UART1_SEND_PIN, BOARD_UART1_RECEIVE_PIN);
    canopy_pl011_start_printing(RP2040_UART1, RP2040_RESET_UART1, CANOPY_RP2040_CLOCK_HZ, CONSOLE_BAUD);
    chip_runs = true;
}

// Polling at 125 MHz costs 5000 instructions a character. A program that can be interrupted has line 1 send it, and
// sleeps while that is full; what cannot, or counts its instructions, polls, behind what waits there.
void canopy_board_put(char character) {
    if (!chip_runs)
        start_chip_and_console();
    if (lines_run && !counts && canopy_core_takes_interrupts()) {
        while (canopy_pl011_write(&uart[1], (const uint8_t *)&character, 1) == 0)
            canopy_core_wait();
        return;
    }
    if (lines_run)
        canopy_pl011_flush(&uart[1]);
    canopy_pl011_put(RP2040_UART1, character);
}

static void start_lines(const uint32_t baud[CANOPY_BOARD_LINES]) {
    start_uart_pins(BOARD_UART0_SEND_PIN, BOARD_UART0_RECEIVE_PIN);
    canopy_pl011_start(&uart[0], &(struct canopy_pl011_config){.base = RP2040_UART0,
                                                               .reset = RP2040_RESET_UART0,
                                                               .irq = RP2040_IRQ_UART0,
                                                               .clock_hz = CANOPY_RP2040_CLOCK_HZ,
                                                               .baud = baud[0],
                                                               .receive_ring = receive_ring[0],
                                                               .send_ring = send_ring[0],
                                                               .receive_length = BOARD_RECEIVE_LENGTH,
                                                               .send_length = BOARD_SEND_LENGTH,
                                                               .direction = 1u << BOARD_UART0_DIRECTION_PIN,
                                                               .alarm = ALARM_LINE0});
    canopy_pl011_start(&uart[1], &(struct canopy_pl011_config){.base = RP2040_UART1,
                                                               .reset = RP2040_RESET_UART1,
                                                               .irq = RP2040_IRQ_UART1,
                                                               .clock_hz = CANOPY_RP2040_CLOCK_HZ,
                                                               .baud = baud[1],
                                                               .receive_ring = receive_ring[1],
                                                               .send_ring = send_ring[1],
                                                               .receive_length = BOARD_RECEIVE_LENGTH,
                                                               .send_length = BOARD_SEND_LENGTH});
    lines_run = true;
}

static void start_i2c(void) {
    canopy_dw_i2c_start(&i2c, &(struct canopy_dw_i2c_config){.base = RP2040_I2C0,
                                                             .reset = RP2040_RESET_I2C0,
                                                             .irq = RP2040_IRQ_I2C0,
                                                             .clock_hz = CANOPY_RP2040_CLOCK_HZ,
                                                             .data_pin = BOARD_I2C0_DATA_PIN,
                                                             .clock_pin = BOARD_I2C0_CLOCK_PIN,
                                                             .alarm = ALARM_I2C});
}

struct canopy_flash canopy_board_flash(void) {
    const struct canopy_rp2040_flash_steps steps = canopy_rp2040_rom_steps(boot2);
    canopy_rp2040_flash_start(&flash, &steps, canopy_settings, (uint32_t)(uintptr_t)canopy_settings - FLASH_START,
                              (uint32_t)(uintptr_t)canopy_settings_pages);
    return canopy_rp2040_flash(&flash);
}

struct canopy_board canopy_board_start(const uint32_t baud[CANOPY_BOARD_LINES]) {
    if (!chip_runs)
        start_chip_and_console();
    canopy_rp2040_watchdog_look_back();
    canopy_core_enable_irq(RP2040_IRQ_TIMER + ALARM_SLEEP);
    start_lines(baud);
    start_i2c();
    return (struct canopy_board){.clock = canopy_rp2040_clock(),
                                 .line = {canopy_pl011_stream(&uart[0]), canopy_pl011_stream(&uart[1])},
                                 .line_count = 2,
                                 .i2c = canopy_dw_i2c(&i2c),
                                 .flash = canopy_board_flash(),
                                 .watchdog = canopy_rp2040_watchdog()};
}

bool canopy_board_start_watchdog(uint32_t period_us) { return canopy_rp2040_watchdog_start(period_us); }

uint32_t canopy_board_activity(void) { return canopy_cortexm_activity(); }

void canopy_board_sleep(uint64_t due_us, uint32_t seen) {
    const uint64_t now_us = canopy_rp2040_now_us();
    if (due_us <= now_us)
        return;
    const uint64_t most_us = now_us + LONGEST_SLEEP_US;
    canopy_rp2040_set_alarm(ALARM_SLEEP, due_us < most_us ? due_us : most_us);
    canopy_rp2040_put(RP2040_GPIO_OUT_CLEAR, 1u << BOARD_LED_PIN);
    canopy_cortexm_idle(seen);
    canopy_rp2040_put(RP2040_GPIO_OUT_SET, 1u << BOARD_LED_PIN);
}

// What was printed last is still on its way, and a reset would cut it. Bounded, as printing is.
static void end_printing(void) {
    if (lines_run)
        canopy_pl011_flush(&uart[1]);
    for (uint32_t i = 0; chip_runs && i < 100000u; i++)
        if ((canopy_rp2040_get(RP2040_UART1 + RP2040_UART_FR) & RP2040_UART_FR_BUSY) == 0)
            return;
}

void canopy_board_reset(void) {
    end_printing();
    canopy_rp2040_reset();
}

// SysTick counts processor clocks; an emulator that counts lets one pass an instruction. The first call starts it: what
// the station does not use does not wake it.
uint64_t canopy_board_instructions(void) {
    if (!counts) {
        end_printing();
        canopy_cortexm_clock_start(CANOPY_RP2040_CLOCK_HZ);
        counts = true;
    }
    return canopy_cortexm_ticks();
}

void canopy_board_exit(bool good) {
    end_printing();
    canopy_semihosting_exit(good);
}

struct vectors {
    uint32_t *stack_top;
    void (*entry[15 + 32])(void);
};

#define IRQ(number) [15 + (number)]

__attribute__((section(".vectors"), used)) static const struct vectors vectors = {
    .stack_top = canopy_stack_top,
    .entry =
        {
            [0] = canopy_reset,
            [1 ... 13] = canopy_crash_entry,
            [14] = canopy_systick_entry,
            IRQ(RP2040_IRQ_TIMER + ALARM_SLEEP) = on_sleep_alarm,
            IRQ(RP2040_IRQ_TIMER + CANOPY_RP2040_WATCHDOG_ALARM) = canopy_crash_entry,
            IRQ(RP2040_IRQ_TIMER + ALARM_LINE0) = on_line0_alarm,
            IRQ(RP2040_IRQ_TIMER + ALARM_I2C) = on_i2c_alarm,
            [15 + RP2040_IRQ_TIMER + 4 ... 15 + RP2040_IRQ_UART0 - 1] = canopy_crash_entry,
            IRQ(RP2040_IRQ_UART0) = on_uart0,
            IRQ(RP2040_IRQ_UART1) = on_uart1,
            [15 + RP2040_IRQ_UART1 + 1 ... 15 + RP2040_IRQ_I2C0 - 1] = canopy_crash_entry,
            IRQ(RP2040_IRQ_I2C0) = on_i2c,
            [15 + RP2040_IRQ_I2C0 + 1 ... 15 + 31] = canopy_crash_entry,
        },
};
