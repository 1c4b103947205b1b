#include "port/rp2040/dw_i2c.h"

#include "port/rp2040/chip.h"
#include "port/rp2040/registers.h"
#include "port/rp2040/timer.h"

#define PAD (RP2040_PAD_4_MA | RP2040_PAD_INPUT | RP2040_PAD_SCHMITT | RP2040_PAD_PULL_UP)
#define REFILL_AT 8u          // commands left in the FIFO: 0.18 ms at 400 kHz until it is empty
#define HALF_CLOCK_US 5u      // of the nine clocks: 100 kHz, which every device follows
#define STRETCH_US 50u        // that a device may hold one of them
#define SETTLE_READS 100u     // of a status bit that follows within some clocks
#define RECOVERY_CLOCKS 9     // a byte and its acknowledgement
#define ADDRESS_MOST 0x7Fu    // 7 bits
#define TRANSFER_MOST 65535u  // what the lengths can say

static uint32_t get(const struct canopy_dw_i2c *i2c, uint32_t offset) {
    return canopy_rp2040_get(i2c->config.base + offset);
}

static void put(const struct canopy_dw_i2c *i2c, uint32_t offset, uint32_t value) {
    canopy_rp2040_put(i2c->config.base + offset, value);
}

static uint32_t data_bit(const struct canopy_dw_i2c *i2c) { return 1u << i2c->config.data_pin; }
static uint32_t clock_bit(const struct canopy_dw_i2c *i2c) { return 1u << i2c->config.clock_pin; }
static bool is_high(uint32_t bits) { return (canopy_rp2040_get(RP2040_GPIO_IN) & bits) == bits; }

// ---- The controller

// 4.3.14.1: a low period takes LCNT + 1 clocks, a high one HCNT + SPKLEN + 7. Of 2.5 us 1.4 are low (at least 1.3) and
// 1.1 high (at least 0.6); rising edges come on top. The data line is held for 0.3 us behind a falling clock.
static void set_speed(const struct canopy_dw_i2c *i2c) {
    const uint32_t clocks_10us = i2c->config.clock_hz / 100000u;
    const uint32_t spike = clocks_10us / 200u + 1u;  // 50 ns
    const uint32_t low = clocks_10us * 14u / 100u, period = clocks_10us / 4u + 1u;
    put(i2c, RP2040_I2C_FS_SPKLEN, spike);
    put(i2c, RP2040_I2C_FS_SCL_LCNT, low - 1u);
    put(i2c, RP2040_I2C_FS_SCL_HCNT, period - low - spike - 7u);
    put(i2c, RP2040_I2C_SDA_HOLD, clocks_10us * 3u / 100u + 1u);
}

static void set_up(const struct canopy_dw_i2c *i2c) {
    canopy_rp2040_reset_blocks(i2c->config.reset);
    put(i2c, RP2040_I2C_ENABLE, 0);
    put(i2c, RP2040_I2C_INTR_MASK, 0);
    put(i2c, RP2040_I2C_CON, RP2040_I2C_CON_MASTER | RP2040_I2C_CON_FAST | RP2040_I2C_CON_RESTART);
    put(i2c, RP2040_I2C_TX_TL, REFILL_AT);
    set_speed(i2c);
}

static void use_pins(const struct canopy_dw_i2c *i2c, uint32_t function) {
    canopy_rp2040_set_pin(i2c->config.data_pin, function, PAD);
    canopy_rp2040_set_pin(i2c->config.clock_pin, function, PAD);
}

// ---- The bus as two open drains: an output that is 0 whenever it is one

static void pull_low(uint32_t bit) { canopy_rp2040_put(RP2040_GPIO_ENABLE_SET, bit); }
static void let_go(uint32_t bit) { canopy_rp2040_put(RP2040_GPIO_ENABLE_CLEAR, bit); }

static void wait_us(uint32_t us) {
    for (const uint64_t end_us = canopy_rp2040_now_us() + us; canopy_rp2040_now_us() < end_us;)
        ;
}

static void raise_clock(const struct canopy_dw_i2c *i2c) {
    const uint64_t end_us = canopy_rp2040_now_us() + STRETCH_US;
    let_go(clock_bit(i2c));
    while (!is_high(clock_bit(i2c)) && canopy_rp2040_now_us() < end_us)
        ;
    wait_us(HALF_CLOCK_US);
}

static void lower_clock(const struct canopy_dw_i2c *i2c) {
    pull_low(clock_bit(i2c));
    wait_us(HALF_CLOCK_US);
}

static void give_stop(const struct canopy_dw_i2c *i2c) {
    lower_clock(i2c);
    pull_low(data_bit(i2c));
    wait_us(HALF_CLOCK_US);
    raise_clock(i2c);
    let_go(data_bit(i2c));
    wait_us(HALF_CLOCK_US);
}

// Brings the bus to rest; false if somebody goes on holding a line.
static bool free_bus(struct canopy_dw_i2c *i2c) {
    const uint32_t both = data_bit(i2c) | clock_bit(i2c);
    canopy_rp2040_put(RP2040_GPIO_OUT_CLEAR, both);
    let_go(both);
    use_pins(i2c, RP2040_FUNCTION_SIO);
    raise_clock(i2c);
    const bool held = !is_high(data_bit(i2c));
    if (is_high(clock_bit(i2c))) {
        for (int clock = 0; clock < RECOVERY_CLOCKS && !is_high(data_bit(i2c)); clock++) {
            lower_clock(i2c);
            raise_clock(i2c);
        }
        give_stop(i2c);
    }
    const bool free = is_high(both);
    if (held && free)
        i2c->recoveries++;
    use_pins(i2c, RP2040_FUNCTION_I2C);
    return free;
}

// ---- A transfer

static uint32_t command_count(const struct canopy_i2c_transfer *t) { return (uint32_t)t->out_length + t->in_length; }

// The controller's command for each byte in turn: what it writes or that it reads, and what goes around that.
static uint32_t command(const struct canopy_i2c_transfer *t, uint32_t index) {
    const bool reads_then = t->in_length > 0, writes_first = t->out_length > 0;
    if (index < t->out_length) {
        const bool stop = index + 1u == t->out_length && (!reads_then || t->stop_between);
        return t->out[index] | (stop ? RP2040_I2C_CMD_STOP : 0);
    }
    const bool restart = index == t->out_length && writes_first && !t->stop_between;
    const bool stop = index + 1u == command_count(t);
    return RP2040_I2C_CMD_READ | (restart ? RP2040_I2C_CMD_RESTART : 0) | (stop ? RP2040_I2C_CMD_STOP : 0);
}

// What is under way of reading never exceeds the FIFO it will come to.
static bool has_room(const struct canopy_dw_i2c *i2c) {
    const uint32_t out = i2c->transfer.out_length;
    const uint32_t asked = i2c->issued > out ? i2c->issued - out - i2c->received : 0;
    return asked < RP2040_I2C_FIFO && get(i2c, RP2040_I2C_TXFLR) < RP2040_I2C_FIFO;
}

static void issue(struct canopy_dw_i2c *i2c) {
    const uint32_t count = command_count(&i2c->transfer);
    for (; i2c->issued < count && has_room(i2c); i2c->issued++)
        put(i2c, RP2040_I2C_DATA_CMD, command(&i2c->transfer, i2c->issued));
    put(i2c, RP2040_I2C_INTR_MASK,
        RP2040_I2C_INT_TX_ABRT | RP2040_I2C_INT_STOP_DET | (i2c->issued < count ? RP2040_I2C_INT_TX_EMPTY : 0));
}

static void take_received(struct canopy_dw_i2c *i2c) {
    while (i2c->received < i2c->transfer.in_length && get(i2c, RP2040_I2C_RXFLR) > 0)
        i2c->transfer.in[i2c->received++] = (uint8_t)get(i2c, RP2040_I2C_DATA_CMD);
}

static enum canopy_i2c_outcome outcome_of(uint32_t source) {
    if ((source & RP2040_I2C_ABRT_ARBITRATION) != 0)
        return CANOPY_I2C_ARBITRATION;
    if ((source & RP2040_I2C_ABRT_NO_ADDRESS) != 0)
        return CANOPY_I2C_NAK_ADDRESS;
    return (source & RP2040_I2C_ABRT_NO_DATA) != 0 ? CANOPY_I2C_NAK_DATA : CANOPY_I2C_UNSUPPORTED;
}

// The controller empties its FIFO when it breaks off and keeps it so until this is read.
static void take_refusal(struct canopy_dw_i2c *i2c) {
    i2c->refused = outcome_of(get(i2c, RP2040_I2C_TX_ABRT_SOURCE));
    (void)get(i2c, RP2040_I2C_CLR_TX_ABRT);
    put(i2c, RP2040_I2C_INTR_MASK, RP2040_I2C_INT_STOP_DET);
}

static bool is_idle(const struct canopy_dw_i2c *i2c) {
    for (uint32_t reads = 0; reads < SETTLE_READS; reads++)
        if ((get(i2c, RP2040_I2C_STATUS) & RP2040_I2C_STATUS_MASTER_ACTIVE) == 0)
            return true;
    return false;
}

static bool is_carried_out(const struct canopy_dw_i2c *i2c) {
    return i2c->stopped && i2c->issued == command_count(&i2c->transfer) && i2c->received == i2c->transfer.in_length &&
           get(i2c, RP2040_I2C_TXFLR) == 0;
}

static void finish(struct canopy_dw_i2c *i2c, enum canopy_i2c_outcome outcome) {
    put(i2c, RP2040_I2C_INTR_MASK, 0);
    canopy_rp2040_clear_alarm(i2c->config.alarm);
    i2c->outcome = outcome;
}

// Moves a transfer on. Runs in the interrupt, or with interrupts masked. The bytes before a STOP are there when it is.
static void move(struct canopy_dw_i2c *i2c) {
    const uint32_t happened = get(i2c, RP2040_I2C_RAW_INTR_STAT);
    take_received(i2c);
    if ((happened & RP2040_I2C_INT_STOP_DET) != 0) {
        (void)get(i2c, RP2040_I2C_CLR_STOP_DET);
        i2c->stopped = true;
    }
    if ((happened & RP2040_I2C_INT_TX_ABRT) != 0)
        take_refusal(i2c);
    if (i2c->refused == CANOPY_I2C_PENDING)
        issue(i2c);
    if ((i2c->refused != CANOPY_I2C_PENDING || is_carried_out(i2c)) && is_idle(i2c))
        finish(i2c, i2c->refused != CANOPY_I2C_PENDING ? i2c->refused : CANOPY_I2C_DONE);
}

bool canopy_dw_i2c_on_interrupt(struct canopy_dw_i2c *i2c) {
    if (i2c->outcome != CANOPY_I2C_PENDING)
        put(i2c, RP2040_I2C_INTR_MASK, 0);
    else
        move(i2c);
    return i2c->outcome != CANOPY_I2C_PENDING || i2c->stopped || i2c->refused != CANOPY_I2C_PENDING;
}

void canopy_dw_i2c_on_alarm(struct canopy_dw_i2c *i2c) { canopy_rp2040_clear_alarm(i2c->config.alarm); }

// ---- lib/port.h

static bool is_possible(const struct canopy_i2c_transfer *t) {
    return t->address <= ADDRESS_MOST && (t->out_length == 0 || t->out != NULL) && (t->in_length == 0 || t->in != NULL);
}

// 4.3.10.3. An idle controller is off at once.
static void switch_off(const struct canopy_dw_i2c *i2c) {
    put(i2c, RP2040_I2C_ENABLE, 0);
    for (uint32_t reads = 0; reads < SETTLE_READS && (get(i2c, RP2040_I2C_ENABLE_STATUS) & 1u) != 0; reads++)
        ;
}

// 4.3.10.2: the address can be changed only while the controller is off.
static void switch_on(const struct canopy_dw_i2c *i2c) {
    (void)get(i2c, RP2040_I2C_CLR_INTR);
    put(i2c, RP2040_I2C_TAR, i2c->transfer.address);
    put(i2c, RP2040_I2C_ENABLE, 1);
}

static bool start(void *context, const struct canopy_i2c_transfer *transfer, uint32_t timeout_us) {
    struct canopy_dw_i2c *i2c = context;
    if (i2c->outcome == CANOPY_I2C_PENDING)
        return false;
    if (!is_possible(transfer)) {
        i2c->outcome = CANOPY_I2C_UNSUPPORTED;
        return true;
    }
    i2c->transfer = *transfer;
    if (command_count(transfer) == 0) {
        i2c->transfer.in = &i2c->probed;
        i2c->transfer.in_length = 1;
    }
    i2c->deadline_us = canopy_rp2040_now_us() + timeout_us;
    i2c->issued = i2c->received = 0;
    i2c->stopped = false;
    i2c->refused = CANOPY_I2C_PENDING;
    switch_off(i2c);
    if (!is_high(data_bit(i2c)) && !free_bus(i2c)) {
        i2c->outcome = CANOPY_I2C_HELD;
        return true;
    }
    switch_on(i2c);
    const uint32_t before = canopy_core_mask();
    i2c->outcome = CANOPY_I2C_PENDING;
    canopy_rp2040_set_alarm(i2c->config.alarm, i2c->deadline_us);
    move(i2c);
    canopy_core_restore(before);
    return true;
}

// The transfer is over, whatever the bus does.
static void give_up(struct canopy_dw_i2c *i2c) {
    finish(i2c, CANOPY_I2C_TIMEOUT);
    set_up(i2c);
    if (!free_bus(i2c))
        i2c->outcome = CANOPY_I2C_HELD;
}

static enum canopy_i2c_outcome poll(void *context) {
    struct canopy_dw_i2c *i2c = context;
    const uint32_t before = canopy_core_mask();
    if (i2c->outcome == CANOPY_I2C_PENDING)
        move(i2c);
    const bool late = i2c->outcome == CANOPY_I2C_PENDING && canopy_rp2040_now_us() >= i2c->deadline_us;
    if (late)
        put(i2c, RP2040_I2C_INTR_MASK, 0);
    canopy_core_restore(before);
    if (late)
        give_up(i2c);
    return i2c->outcome;
}

static uint32_t recoveries(void *context) {
    const struct canopy_dw_i2c *i2c = context;
    return i2c->recoveries;
}

void canopy_dw_i2c_start(struct canopy_dw_i2c *i2c, const struct canopy_dw_i2c_config *config) {
    *i2c = (struct canopy_dw_i2c){.config = *config, .outcome = CANOPY_I2C_UNSUPPORTED};
    set_up(i2c);
    use_pins(i2c, RP2040_FUNCTION_I2C);
    canopy_core_enable_irq(config->irq);
    canopy_core_enable_irq(RP2040_IRQ_TIMER + config->alarm);
}

struct canopy_i2c canopy_dw_i2c(struct canopy_dw_i2c *i2c) {
    return (struct canopy_i2c){
        .context = i2c, .max_transfer = TRANSFER_MOST, .start = start, .poll = poll, .recoveries = recoveries};
}
