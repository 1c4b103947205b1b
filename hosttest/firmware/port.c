// The Cortex-M port under test: line 1 echoes, line 0 takes one-letter orders and answers each with a line of text.
// hosttest/test_port_cortexm.py plays against it in QEMU.
#include <string.h>

#include "port/board.h"
#include "port/cortexm/clock.h"

#define WATCHDOG_US 500000u

static struct canopy_board board;
static volatile uint32_t sink;

static void send(const char *text) {
    size_t left = strlen(text);
    while (left > 0) {
        const size_t taken = board.line[0].write(board.line[0].context, (const uint8_t *)text, left);
        text += taken;
        left -= taken;
    }
}

static void send_number(uint64_t value, uint32_t radix) {
    char digits[24];
    size_t at = sizeof digits - 1;
    digits[at] = '\0';
    do {
        digits[--at] = "0123456789abcdef"[value % radix];
        value /= radix;
    } while (value != 0);
    send(&digits[at]);
    send(" ");
}

static void send_crash(void) {
    const struct canopy_crash *crash = canopy_board_last_crash();
    if (crash == NULL) {
        send("none");
        return;
    }
    send_number(crash->kind, 10);
    send_number(crash->pc, 16);
    send_number(crash->status, 16);
    send_number(crash->address, 16);
    send_number(crash->count, 10);
}

// Over more than two turns of SysTick.
static bool clock_never_goes_back(void) {
    const uint64_t end = canopy_cortexm_ticks() + 2u * (1u << 24) + 1000000u;
    for (uint64_t before = 0, now = 0; now < end; before = now) {
        now = canopy_cortexm_ticks();
        if (now < before)
            return false;
        board.watchdog.feed(board.watchdog.context);
    }
    return true;
}

// noclone and noinline: the test looks these up by name in the image's symbols.
__attribute__((noinline, noclone)) void fault_by_address(void) { sink = *(volatile uint32_t *)0xF0000000u; }
__attribute__((noinline, noclone)) void fault_by_instruction(void) { __asm volatile("udf #1"); }
__attribute__((noinline, noclone)) void fault_by_hanging(void) {
    for (;;)
        sink++;
}
__attribute__((noinline, noclone)) uint32_t fault_by_stack(uint32_t depth) {
    volatile uint32_t bulk[64];
    bulk[0] = depth;
    return depth == UINT32_MAX ? 0 : fault_by_stack(depth + 1) + bulk[0];
}

static void obey(uint8_t order) {
    switch (order) {
    case 't': send_number(canopy_cortexm_now_us(), 10); break;
    case 'm': send(clock_never_goes_back() ? "forward" : "back"); break;
    case 'l': send_number(board.line[1].lost(board.line[1].context), 10); break;
    case 'q': send(board.line[1].sent(board.line[1].context) ? "sent" : "sending"); break;
    case 'r': send_crash(); break;
    case 'f': canopy_board_forget_crash(); break;
    case 'a': fault_by_address(); break;
    case 'i': fault_by_instruction(); break;
    case 'h': fault_by_hanging(); break;
    case 's': sink = fault_by_stack(1); break;
    default: send("unknown"); break;
    }
    send("\n");
}

// Moves what fits; what does not fit waits in the receive ring.
static void echo(void) {
    static uint8_t held[64];
    static size_t count, done;
    if (done == count) {
        count = board.line[1].read(board.line[1].context, held, sizeof held);
        done = 0;
    }
    done += board.line[1].write(board.line[1].context, &held[done], count - done);
}

int main(void) {
    board = canopy_board_start((const uint32_t[]){115200, 115200});
    (void)canopy_board_start_watchdog(WATCHDOG_US);
    send("started\n");
    for (;;) {
        const uint32_t seen = canopy_board_activity();
        uint8_t order;
        if (board.line[0].read(board.line[0].context, &order, 1) == 1)
            obey(order);
        echo();
        board.watchdog.feed(board.watchdog.context);
        canopy_board_sleep(UINT64_MAX, seen);
    }
}
