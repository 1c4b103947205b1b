// A port under test: does what it is told, one order a line, and answers each with a line of text.
// hosttest/conformance.py plays against it, docs/conformance.md lists the orders.
//
// It knows port/board.h alone, so it is the same program on every board. Orders come on line 0, which a board with one
// line shares with its tests: an order says how many bytes are not orders.
#include <string.h>

#include "hosttest/firmware/conformance.h"
#include "lib/modbus/rtu.h"

#define BAUD 115200u
#define ORDER_LENGTH 240u  // within every port's receive ring
#define ARGUMENTS 6u
#define BYTES 1040u  // of a transfer, a page or a piece of it: 1 KiB and a little beyond
#define PATIENCE_US 10000000u
#define PATTERN 94u  // printable, so that an answer's end of line ends the pattern too

static struct canopy_board board;
static struct canopy_stream orders;
static uint8_t out[BYTES], in[BYTES];
static volatile uint32_t sink;
static uint32_t nap_us = 1000000;  // at most, while no order comes

__attribute__((weak)) struct canopy_stream conformance_orders(const struct canopy_board *of) { return of->line[0]; }

static uint64_t now_us(void) { return board.clock.now_us(board.clock.context); }
static void feed(void) { board.watchdog.feed(board.watchdog.context); }
static uint8_t pattern(uint64_t at) { return (uint8_t)('!' + at % PATTERN); }

static size_t read_line(uint32_t line, uint8_t *to, size_t length) {
    return board.line[line].read(board.line[line].context, to, length);
}

static size_t write_line(uint32_t line, const uint8_t *from, size_t length) {
    return board.line[line].write(board.line[line].context, from, length);
}

static bool is_sent(uint32_t line) { return board.line[line].sent(board.line[line].context); }
static uint32_t lost_of(uint32_t line) { return board.line[line].lost(board.line[line].context); }

// ---- Answers

static void send(const struct canopy_stream *stream, const uint8_t *bytes, size_t left) {
    while (left > 0) {
        const size_t taken = stream->write(stream->context, bytes, left);
        bytes += taken;
        left -= taken;
        feed();
    }
}

static void say(const char *text) { send(&orders, (const uint8_t *)text, strlen(text)); }

static void say_number(uint64_t value) {
    char digits[24];
    size_t at = sizeof digits - 1;
    digits[at] = '\0';
    do {
        digits[--at] = (char)('0' + value % 10u);
        value /= 10u;
    } while (value != 0);
    say(&digits[at]);
    say(" ");
}

static void say_bytes(const uint8_t *bytes, size_t count) {
    for (size_t i = 0; i < count; i++)
        say((const char[]){"0123456789abcdef"[bytes[i] >> 4], "0123456789abcdef"[bytes[i] & 15], '\0'});
}

// ---- What the board has, and its clock

static void about(const uint32_t *argument, const char *rest) {
    (void)argument;
    (void)rest;
    say_number(board.line_count);
    say_number(board.i2c.max_transfer);
    say_number(board.flash.page_count);
    say_number(board.flash.page_bytes);
    say_number(board.flash.program_bytes);
}

static void tell_time(const uint32_t *argument, const char *rest) {
    (void)argument;
    (void)rest;
    say_number(now_us());
}

// clock READS: steps back, the smallest step forward, the largest, the last value. Steps from one order to the next
// count too.
static void read_clock(const uint32_t *argument, const char *rest) {
    static uint64_t before;
    uint64_t back = 0, smallest = UINT64_MAX, largest = 0;
    (void)rest;
    for (uint32_t i = 0; i < argument[0]; i++) {
        const uint64_t now = now_us();
        if (now < before)
            back++;
        else if (now > before) {
            smallest = now - before < smallest ? now - before : smallest;
            largest = i > 0 && now - before > largest ? now - before : largest;
        }
        before = now;
        if (i % 1024u == 0)
            feed();
    }
    say_number(back);
    say_number(smallest);
    say_number(largest);
    say_number(before);
}

// sleep US TURNS: the smallest and the largest lateness.
static void sleep_often(const uint32_t *argument, const char *rest) {
    uint64_t least = UINT64_MAX, most = 0;
    (void)rest;
    for (uint32_t i = 0; i < argument[1]; i++) {
        const uint64_t due_us = now_us() + argument[0];
        while (now_us() < due_us) {
            canopy_board_sleep(due_us, canopy_board_activity());
            feed();
        }
        const uint64_t late = now_us() - due_us;
        least = late < least ? late : least;
        most = late > most ? late : most;
    }
    say_number(least);
    say_number(most);
}

// nap US: how long one sleep lasts that nothing disturbs, of a due time so far ahead.
static void sleep_once(const uint32_t *argument, const char *rest) {
    (void)rest;
    while (!orders.sent(orders.context))
        feed();
    const uint64_t begin_us = now_us();
    canopy_board_sleep(begin_us + argument[0], canopy_board_activity());
    say_number(now_us() - begin_us);
}

static void spin(uint64_t us) {
    for (const uint64_t end_us = now_us() + us; now_us() < end_us;)
        feed();
}

// wake LINE BUSY_US SLEEP_US: after "ready" busy for a while, then asleep until a byte comes or SLEEP_US have passed.
// How long it slept, and how many bytes were there then.
static void wake(const uint32_t *argument, const char *rest) {
    (void)rest;
    say("ready\n");
    while (!orders.sent(orders.context))
        feed();
    uint32_t seen = canopy_board_activity();
    spin(argument[1]);
    const uint64_t begin_us = now_us(), due_us = begin_us + argument[2];
    size_t count = 0;
    while (count == 0 && now_us() < due_us) {
        canopy_board_sleep(due_us, seen);
        feed();
        seen = canopy_board_activity();
        count = read_line(argument[0], in, sizeof in);
    }
    say_number(now_us() - begin_us);
    say_number(count);
}

// mask US: after "ready" busy for so long with interrupts masked. Whether one came meanwhile, whether one has at last,
// whether they were masked when asked again, and whether they were before.
static void be_masked(const uint32_t *argument, const char *rest) {
    (void)rest;
    say("ready\n");
    while (!orders.sent(orders.context))
        feed();
    const uint32_t outer = canopy_board_mask();
    const uint32_t seen = canopy_board_activity();
    spin(argument[0]);
    const bool came = canopy_board_activity() != seen;
    const uint32_t inner = canopy_board_mask();
    canopy_board_restore(inner);
    spin(1000);
    const bool came_in_between = canopy_board_activity() != seen;
    canopy_board_restore(outer);
    spin(1000);
    say_number(came || came_in_between);
    say_number(canopy_board_activity() != seen);
    say_number(inner != 0);
    say_number(outer != 0);
}

// ---- Serial lines

// Waits for work, unless some has come since `seen`; false when none has for long.
static bool goes_on(uint64_t since_us, uint32_t seen) {
    feed();
    canopy_board_sleep(since_us + PATIENCE_US, seen);
    return now_us() - since_us < PATIENCE_US;
}

// echo LINE COUNT CHUNK: sends the next COUNT bytes back, reading at most CHUNK at a time. How many there were, how
// many of all were lost.
static void echo(const uint32_t *argument, const char *rest) {
    const size_t chunk = argument[2] < sizeof in ? argument[2] : sizeof in;
    uint32_t done = 0;
    size_t have = 0, gone = 0;
    uint64_t since_us = now_us();
    (void)rest;
    for (uint32_t seen = canopy_board_activity(); done < argument[1] && goes_on(since_us, seen);) {
        seen = canopy_board_activity();
        if (gone == have) {
            const uint32_t left = argument[1] - done;
            have = read_line(argument[0], in, left < chunk ? left : chunk);
            gone = 0;
        }
        const size_t moved = write_line(argument[0], &in[gone], have - gone);
        gone += moved;
        done += (uint32_t)moved;
        since_us = moved > 0 ? now_us() : since_us;
    }
    say_number(done);
    say_number(lost_of(argument[0]));
}

struct duplex {
    uint32_t sent, received, wrong;
};

// Sends at most WINDOW bytes more than have come: whoever keeps to that on both ends never loses one.
static bool move_both_ways(uint32_t line, struct duplex *duplex, uint32_t count, uint32_t window) {
    const struct duplex before = *duplex;
    while (duplex->sent < count && duplex->sent < duplex->received + window) {
        const uint8_t byte = pattern(duplex->sent);
        if (write_line(line, &byte, 1) == 0)
            break;
        duplex->sent++;
    }
    const uint32_t left = count - duplex->received;
    const size_t got = read_line(line, in, left < 64 ? left : 64);
    for (size_t i = 0; i < got; i++)
        duplex->wrong += in[i] != pattern(duplex->received++ + line) ? 1 : 0;
    return duplex->sent != before.sent || duplex->received != before.received;
}

// duplex COUNT WINDOW: on all lines at once, sends the pattern and takes the far end's, which is ahead by the line's
// number. For each line: sent, received, wrong, lost.
static void run_duplex(const uint32_t *argument, const char *rest) {
    struct duplex duplex[CANOPY_BOARD_LINES] = {0};
    bool moves = true;
    uint64_t since_us = now_us();
    (void)rest;
    for (uint32_t seen = canopy_board_activity(); moves || goes_on(since_us, seen);) {
        seen = canopy_board_activity();
        moves = false;
        bool done = true;
        for (uint32_t line = 0; line < board.line_count; line++) {
            moves = move_both_ways(line, &duplex[line], argument[0], argument[1]) || moves;
            done = done && duplex[line].sent == argument[0] && duplex[line].received == argument[0];
        }
        since_us = moves ? now_us() : since_us;
        feed();
        if (done)
            break;
    }
    for (uint32_t line = 0; line < board.line_count; line++) {
        say_number(duplex[line].sent);
        say_number(duplex[line].received);
        say_number(duplex[line].wrong);
        say_number(lost_of(line));
    }
}

static void fill_out(uint64_t from) {
    for (size_t i = 0; i < sizeof out; i++)
        out[i] = pattern(from + i);
}

// fill LINE: writes the pattern until a write takes less than it was given. Behind a new line: bytes taken in all, by
// the last write, and given to it.
static void fill(const uint32_t *argument, const char *rest) {
    uint64_t all = 0;
    size_t taken = sizeof out;
    (void)rest;
    for (uint32_t i = 0; i < 1024u && taken == sizeof out; i++) {
        fill_out(all);
        taken = write_line(argument[0], out, sizeof out);
        all += taken;
        feed();
    }
    say("\n");
    say_number(all);
    say_number(taken);
    say_number(sizeof out);
}

// write LINE COUNT: all of the pattern. Whether it was sent right behind the last write, after how many microseconds it
// was, and whether it stayed so.
static void write_all(const uint32_t *argument, const char *rest) {
    (void)rest;
    fill_out(0);
    while (!is_sent(argument[0]))
        feed();
    send(&board.line[argument[0]], out, argument[1] < sizeof out ? argument[1] : sizeof out);
    const bool at_once = is_sent(argument[0]);
    const uint64_t begin_us = now_us();
    while (!is_sent(argument[0]) && now_us() - begin_us < PATIENCE_US)
        feed();
    const uint64_t sent_us = now_us();
    bool stays = true;
    while (now_us() - sent_us < 2000u)
        stays = stays && is_sent(argument[0]);
    say_number(at_once);
    say_number(sent_us - begin_us);
    say_number(stays);
}

static bool is_sent_soon(uint32_t line) {
    for (uint32_t turns = 0; turns < 1000000u && !is_sent(line); turns++)
        feed();
    return is_sent(line);
}

// look LINE: how many bytes there are to read, whether all is sent soon, how many were lost.
static void look(const uint32_t *argument, const char *rest) {
    const size_t count = read_line(argument[0], in, sizeof in);
    const bool sent = is_sent_soon(argument[0]);
    (void)rest;
    say_number(count);
    say_number(sent);
    say_number(lost_of(argument[0]));
}

// deaf LINE US COUNT: after "ready" does not read for so long, then reads until COUNT bytes are read or lost. How many
// were read, how many of them from the first on were the pattern, how many were lost.
static void be_deaf(const uint32_t *argument, const char *rest) {
    const uint32_t lost_before = lost_of(argument[0]);
    uint32_t count = 0, right = 0;
    (void)rest;
    say("ready\n");
    for (const uint64_t end_us = now_us() + argument[1]; now_us() < end_us; feed())
        canopy_board_sleep(end_us, canopy_board_activity());
    uint64_t since_us = now_us();
    for (uint32_t seen = canopy_board_activity(); count + lost_of(argument[0]) - lost_before < argument[2];) {
        if (!goes_on(since_us, seen))
            break;
        seen = canopy_board_activity();
        const size_t got = read_line(argument[0], in, sizeof in);
        for (size_t i = 0; i < got; i++, count++)
            right += right == count && in[i] == pattern(count) ? 1 : 0;
        since_us = got > 0 ? now_us() : since_us;
    }
    say_number(count);
    say_number(right);
    say_number(lost_of(argument[0]) - lost_before);
}

// ---- Modbus RTU: T3.5

static uint8_t read_bank(void *context, uint8_t client, uint16_t address, uint16_t count, uint8_t *to) {
    (void)context;
    (void)client;
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t value = (address + i) * 7u + 3u;
        to[2 * i] = (uint8_t)(value >> 8);
        to[2 * i + 1] = (uint8_t)value;
    }
    return 0;
}

static uint8_t write_bank(void *context, uint8_t client, uint16_t address, uint16_t count, const uint8_t *from,
                          uint8_t function) {
    *(bool *)context = true;
    (void)client;
    (void)address;
    (void)count;
    (void)from;
    (void)function;
    return CANOPY_MODBUS_ILLEGAL_ADDRESS;
}

struct serving {
    struct canopy_modbus_rtu_server server;
    uint64_t heard_us, least_us, most_us;
    uint32_t answers;
    bool answering, done;
};

static void serve_once(struct serving *serving, uint32_t line) {
    uint8_t bytes[64];
    for (size_t got = read_line(line, bytes, sizeof bytes); got > 0; got = read_line(line, bytes, sizeof bytes)) {
        serving->heard_us = now_us();
        canopy_modbus_rtu_server_feed(&serving->server, bytes, got, serving->heard_us);
    }
    const uint8_t *reply;
    const uint64_t at_us = now_us();
    const size_t length = canopy_modbus_rtu_server_poll(&serving->server, at_us, &reply);
    if (length > 0 && !serving->answering) {
        const uint64_t delay_us = at_us - serving->heard_us;
        serving->least_us = delay_us < serving->least_us ? delay_us : serving->least_us;
        serving->most_us = delay_us > serving->most_us ? delay_us : serving->most_us;
        serving->answers++;
    }
    serving->answering = length > 0;
    if (length > 0)
        canopy_modbus_rtu_server_sent(&serving->server, write_line(line, reply, length), at_us);
}

// serve LINE SILENCE_US US: a server, unit 1, after "ready" until something is written, or for so long. Its frames and
// errors, its answers, and the shortest and longest time from a request's last byte to its answer's first.
static void serve(const uint32_t *argument, const char *rest) {
    static struct serving serving;
    const struct canopy_modbus_bank bank = {.context = &serving.done, .read = read_bank, .write = write_bank};
    const struct canopy_modbus_rtu_server_config config = {
        .bank = &bank, .unit = 1, .silence_us = argument[1], .pause_us = argument[1]};
    (void)rest;
    serving = (struct serving){.least_us = UINT64_MAX};
    if (canopy_modbus_rtu_server_init(&serving.server, &config) != CANOPY_OK) {
        say("no such silence");
        return;
    }
    say("ready\n");
    const uint64_t end_us = now_us() + argument[2];
    while (now_us() < end_us && (!serving.done || serving.answering)) {
        const uint32_t seen = canopy_board_activity();
        serve_once(&serving, argument[0]);
        feed();
        const uint64_t due_us = canopy_modbus_rtu_server_due(&serving.server);
        canopy_board_sleep(due_us < end_us ? due_us : end_us, seen);
    }
    say_number(serving.server.rx_frames);
    say_number(serving.server.rx_errors);
    say_number(serving.answers);
    say_number(serving.least_us);
    say_number(serving.most_us);
}

// ---- I2C and flash

static uint32_t digit_of(char c) {
    return c >= '0' && c <= '9' ? (uint32_t)(c - '0') : c >= 'a' && c <= 'f' ? (uint32_t)(c - 'a') + 10u : 16u;
}

// Hexadecimal bytes to `out`; behind them it counts up.
static void take_bytes(const char *hex) {
    size_t count = 0;
    for (; digit_of(hex[0]) < 16u && digit_of(hex[1]) < 16u && count < sizeof out; hex += 2)
        out[count++] = (uint8_t)(digit_of(hex[0]) << 4 | digit_of(hex[1]));
    for (; count < sizeof out; count++)
        out[count] = (uint8_t)count;
}

// i2c ADDRESS STOP TIMEOUT_US OUT IN AWAY_US HEX: one transfer, which nobody looks after for AWAY_US. How it ended, in
// how many microseconds, whether a second one was refused meanwhile, whether the outcome stays, and what was read.
static void transfer(const uint32_t *argument, const char *rest) {
    const struct canopy_i2c_transfer wanted = {.out = out,
                                               .in = in,
                                               .out_length = (uint16_t)argument[3],
                                               .in_length = (uint16_t)argument[4],
                                               .address = (uint8_t)argument[0],
                                               .stop_between = argument[1] != 0};
    take_bytes(rest);
    memset(in, 0xEE, sizeof in);
    const uint64_t begin_us = now_us();
    const bool began = board.i2c.start(board.i2c.context, &wanted, argument[2]);
    const bool refused = !board.i2c.start(board.i2c.context, &wanted, argument[2]);
    spin(argument[5]);
    enum canopy_i2c_outcome outcome = board.i2c.poll(board.i2c.context);
    while (outcome == CANOPY_I2C_PENDING && now_us() - begin_us < argument[2] + PATIENCE_US) {
        feed();
        outcome = board.i2c.poll(board.i2c.context);
    }
    const uint64_t took_us = now_us() - begin_us;
    say_number(began ? outcome : 99u);
    say_number(took_us);
    say_number(refused);
    say_number(board.i2c.poll(board.i2c.context) == outcome ? 1u : 0u);
    say_bytes(in, argument[4] <= board.i2c.max_transfer && argument[4] < sizeof in ? argument[4] : 0);
}

static void poll_i2c(const uint32_t *argument, const char *rest) {
    (void)argument;
    (void)rest;
    say_number(board.i2c.poll(board.i2c.context));
    say_number(board.i2c.recoveries(board.i2c.context));
}

// erase PAGE
static void erase(const uint32_t *argument, const char *rest) {
    (void)rest;
    say_number(board.flash.erase(board.flash.context, argument[0]));
}

// program PAGE OFFSET LENGTH HEX
static void program(const uint32_t *argument, const char *rest) {
    take_bytes(rest);
    say_number(board.flash.program(board.flash.context, argument[0], argument[1], out, argument[2]));
}

// read PAGE OFFSET LENGTH
static void read_flash(const uint32_t *argument, const char *rest) {
    const uint32_t length = argument[2] < sizeof in ? argument[2] : sizeof in;
    (void)rest;
    memset(in, 0xEE, sizeof in);
    const enum canopy_status status = board.flash.read(board.flash.context, argument[0], argument[1], in, length);
    say_number(status);
    say_bytes(in, status == CANOPY_OK ? length : 0);
}

// sum PAGE: its bytes that are not 0xFF, and the sum of byte times place, from 1 on, modulo 2^32.
static void sum_page(const uint32_t *argument, const char *rest) {
    uint32_t written = 0, sum = 0;
    (void)rest;
    for (uint32_t at = 0; at < board.flash.page_bytes; at += 256u) {
        const uint32_t left = board.flash.page_bytes - at, length = left < 256u ? left : 256u;
        memset(in, 0, length);
        (void)board.flash.read(board.flash.context, argument[0], at, in, length);
        for (uint32_t i = 0; i < length; i++) {
            written += in[i] != 0xFF ? 1 : 0;
            sum += in[i] * (at + i + 1u);
        }
        feed();
    }
    say_number(written);
    say_number(sum);
}

// early: the flash as it was before the start: its pages, their bytes, its unit, and a read of the first bytes.
static struct {
    struct canopy_flash flash;
    enum canopy_status status;
    uint8_t bytes[8];
} before_start;

static void look_before_start(void) {
    before_start.flash = canopy_board_flash();
    before_start.status =
        before_start.flash.read(before_start.flash.context, 0, 0, before_start.bytes, sizeof before_start.bytes);
}

static void tell_before_start(const uint32_t *argument, const char *rest) {
    (void)argument;
    (void)rest;
    say_number(before_start.flash.page_count);
    say_number(before_start.flash.page_bytes);
    say_number(before_start.flash.program_bytes);
    say_number(before_start.status);
    say_bytes(before_start.bytes, before_start.status == CANOPY_OK ? sizeof before_start.bytes : 0);
}

// ---- Crashes

// crash: none, or kind, pc, lr, sp, status, address, count.
static void tell_crash(const uint32_t *argument, const char *rest) {
    const struct canopy_crash *crash = canopy_board_last_crash();
    (void)argument;
    (void)rest;
    if (crash == NULL) {
        say("none");
        return;
    }
    say_number(crash->kind);
    say_number(crash->pc);
    say_number(crash->lr);
    say_number(crash->sp);
    say_number(crash->status);
    say_number(crash->address);
    say_number(crash->count);
}

static void forget(const uint32_t *argument, const char *rest) {
    (void)argument;
    (void)rest;
    canopy_board_forget_crash();
}

// watch PERIOD_US
static void watch(const uint32_t *argument, const char *rest) {
    (void)rest;
    const bool started = canopy_board_start_watchdog(argument[0]);
    if (started)
        nap_us = argument[0] / 4u;  // in which the next order may come, however late
    say_number(started);
}

static void put(const uint32_t *argument, const char *rest) {
    (void)argument;
    while (*rest != '\0')
        canopy_board_put(*rest++);
}

static void reset(const uint32_t *argument, const char *rest) {
    (void)argument;
    (void)rest;
    canopy_board_reset();
}

// The test looks these up by name in the image's symbols.
#ifdef __clang__
#define FINDABLE __attribute__((noinline))
#else
#define FINDABLE __attribute__((noinline, noclone))
#endif

FINDABLE void fault_by_address(uint32_t address) { sink = *(volatile uint32_t *)(uintptr_t)address; }
FINDABLE void fault_by_instruction(void) {
#if defined __arm__
    __asm volatile("udf #1");
#elif defined __riscv
    __asm volatile("unimp");
#else
    __builtin_trap();
#endif
}
FINDABLE void fault_by_hanging(void) {
    for (;;)
        sink++;
}
FINDABLE uint32_t fault_by_stack(uint32_t depth) {
    volatile uint32_t bulk[64];
    bulk[0] = depth;
    return depth == UINT32_MAX ? 0 : fault_by_stack(depth + 1) + bulk[0];
}

// fault KIND ADDRESS: 0 an address, 1 an instruction, 2 the stack, 3 a hang. None of them answers.
static void fault(const uint32_t *argument, const char *rest) {
    (void)rest;
    switch (argument[0]) {
    case 0: fault_by_address(argument[1]); break;
    case 1: fault_by_instruction(); break;
    case 2: sink = fault_by_stack(1); break;
    default: fault_by_hanging(); break;
    }
}

// ---- Orders

static const struct order {
    const char *name;
    void (*obey)(const uint32_t *argument, const char *rest);
    uint8_t arguments;
    bool of_line;  // the first argument is a line's number
} ORDERS[] = {
    {"about", about, 0, false},       {"now", tell_time, 0, false},
    {"clock", read_clock, 1, false},  {"sleep", sleep_often, 2, false},
    {"nap", sleep_once, 1, false},    {"wake", wake, 3, true},
    {"echo", echo, 3, true},          {"fill", fill, 1, true},
    {"duplex", run_duplex, 2, false}, {"write", write_all, 2, true},
    {"look", look, 1, true},          {"deaf", be_deaf, 3, true},
    {"serve", serve, 3, true},        {"i2c", transfer, 6, false},
    {"bus", poll_i2c, 0, false},      {"erase", erase, 1, false},
    {"program", program, 3, false},   {"read", read_flash, 3, false},
    {"sum", sum_page, 1, false},      {"crash", tell_crash, 0, false},
    {"forget", forget, 0, false},     {"early", tell_before_start, 0, false},
    {"mask", be_masked, 1, false},    {"watch", watch, 1, false},
    {"put", put, 0, false},           {"reset", reset, 0, false},
    {"fault", fault, 2, false},
};

// A number, decimal, and the space behind it; NULL when there is none.
static const char *take_number(const char *text, uint32_t *value) {
    *value = 0;
    if (digit_of(*text) > 9u)
        return NULL;
    for (; digit_of(*text) < 10u; text++)
        *value = *value * 10u + digit_of(*text);
    return *text == ' ' ? text + 1 : text;
}

static void obey(const char *text) {
    const size_t length = strcspn(text, " ");
    for (size_t i = 0; i < sizeof ORDERS / sizeof ORDERS[0]; i++) {
        const struct order *order = &ORDERS[i];
        if (strncmp(order->name, text, length) != 0 || order->name[length] != '\0')
            continue;
        uint32_t argument[ARGUMENTS] = {0};
        const char *rest = text[length] == ' ' ? &text[length + 1] : &text[length];
        for (uint8_t k = 0; k < order->arguments && rest != NULL; k++)
            rest = take_number(rest, &argument[k]);
        if (rest == NULL || (order->of_line && argument[0] >= CANOPY_BOARD_LINES))
            say("wrong arguments");
        else
            order->obey(argument, rest);
        return;
    }
    say("no such order");
}

int main(void) {
    static char order[ORDER_LENGTH + 1];
    size_t have = 0;
    look_before_start();
    board = canopy_board_start((const uint32_t[]){BAUD, BAUD});
    orders = conformance_orders(&board);
    say("started\n");
    for (;;) {
        const uint32_t seen = canopy_board_activity();
        uint8_t byte;
        const bool came = orders.read(orders.context, &byte, 1) == 1;
        if (came && byte == '\n') {
            order[have] = '\0';
            have = 0;
            obey(order);
            say("\n");
        } else if (came && have < ORDER_LENGTH)
            order[have++] = (char)byte;
        feed();
        if (!came)
            canopy_board_sleep(now_us() + nap_us, seen);
    }
}
