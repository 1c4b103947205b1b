#include "lib/scan/i2c_link.h"

#include <string.h>

#include "lib/num/crc.h"

enum state {
    IDLE,
    QUEUED,  // a transfer is to be started, as soon as nobody else has one under way
    RUNNING
};

enum { ADDRESS_LOW = 8, ADDRESS_HIGH = 119 };  // the others are reserved (UM10204, 3.1.12)

static uint8_t check_bytes(const struct canopy_scan_i2c *kind) {
    return kind->check == CANOPY_SCAN_CRC16 ? 2 : kind->check == CANOPY_SCAN_CRC8 ? 1 : 0;
}

static bool address_ok(unsigned address) { return address >= ADDRESS_LOW && address <= ADDRESS_HIGH; }

static bool kind_ok(const struct canopy_scan_i2c *kind) {
    return address_ok(kind->address) && kind->pointer_bytes >= 1 && kind->pointer_bytes <= 2 &&
           kind->pointer_step >= 1 && kind->pointer_step <= 2 && kind->check <= CANOPY_SCAN_CRC16;
}

// Registers that one transfer can carry.
static uint16_t registers_at_once(const struct canopy_profile_table *table, uint16_t max_transfer) {
    const struct canopy_scan_i2c *kind = &table->i2c;
    const unsigned check = check_bytes(kind), bus = max_transfer > check ? (max_transfer - check) / 2 : 0;
    const unsigned device = kind->read_max > 0 && kind->read_max < table->read_max ? kind->read_max : table->read_max;
    return (uint16_t)(bus < device ? bus : device);
}

enum canopy_status canopy_i2c_link_init(struct canopy_i2c_link *link, const struct canopy_i2c *bus,
                                        const struct canopy_profile_table *table, uint32_t timeout_us) {
    if (timeout_us == 0 || !kind_ok(&table->i2c) || table->read_max > CANOPY_SCAN_READ_MAX)
        return CANOPY_ARGUMENT;
    const uint16_t most = registers_at_once(table, bus->max_transfer);
    if (most < table->header.count || most < table->description.count || most < 2)
        return CANOPY_UNSUPPORTED;
    memset(link, 0, sizeof *link);
    link->bus = bus;
    link->table = table;
    link->timeout_us = timeout_us;
    link->most = (uint8_t)most;
    return CANOPY_OK;
}

// ---- One transfer

static uint8_t write_request(struct canopy_i2c_link *link) {
    const struct canopy_scan_i2c *kind = &link->table->i2c;
    const uint32_t pointer = ((uint32_t)link->address + link->done) * kind->pointer_step;
    const uint8_t low = (uint8_t)(pointer & 0xFFu), high = (uint8_t)(pointer >> 8 & 0xFFu);
    uint8_t length = 0;
    if (kind->pointer_bytes == 2)
        link->out[length++] = kind->pointer_low_first ? low : high;
    link->out[length++] = kind->pointer_bytes == 2 && kind->pointer_low_first ? high : low;
    if (kind->counted)
        link->out[length++] = link->now;
    if (kind->tagged)
        link->out[length++] = link->tag;
    return length;
}

// Behind the registers that are there; the check sum of an earlier transfer is overwritten.
static uint8_t *place(struct canopy_i2c_link *link) { return link->in + 2 * link->done; }

static void start(struct canopy_i2c_link *link) {
    const struct canopy_scan_i2c *kind = &link->table->i2c;
    const unsigned left = (unsigned)(link->count - link->done);
    link->now = (uint8_t)(left < link->most ? left : link->most);
    const struct canopy_i2c_transfer transfer = {.out = link->out,
                                                 .in = place(link),
                                                 .out_length = write_request(link),
                                                 .in_length = (uint16_t)(2 * link->now + check_bytes(kind)),
                                                 .address = link->device,
                                                 .stop_between = kind->stop_between};
    link->state = link->bus->start(link->bus->context, &transfer, link->timeout_us) ? RUNNING : QUEUED;
}

// Every transfer has a tag of its own, also one that repeats another.
static void next_transfer(struct canopy_i2c_link *link) {
    link->tag++;
    start(link);
}

// Whether the check behind the data is the one of request and data.
static bool check_ok(struct canopy_i2c_link *link) {
    const struct canopy_scan_i2c *kind = &link->table->i2c;
    const uint8_t writing = (uint8_t)(link->device << 1), reading = (uint8_t)(link->device << 1 | 1);
    const uint8_t request = write_request(link);
    const uint8_t *data = place(link), *check = data + 2 * link->now;
    if (kind->check == CANOPY_SCAN_CRC16) {
        uint16_t sum = canopy_crc16(CANOPY_CRC16_START, &writing, 1);
        sum = canopy_crc16(sum, link->out, request);
        sum = canopy_crc16(sum, &reading, 1);
        sum = canopy_crc16(sum, data, 2U * link->now);
        return (sum & 0xFFu) == check[0] && sum >> 8 == check[1];
    }
    uint8_t sum = canopy_crc8(CANOPY_CRC8_START, &writing, 1);
    sum = canopy_crc8(sum, link->out, request);
    sum = canopy_crc8(sum, &reading, 1);
    sum = canopy_crc8(sum, data, 2U * link->now);
    return kind->check == CANOPY_SCAN_UNCHECKED || sum == check[0];
}

static enum canopy_scan_failure failure_of(enum canopy_i2c_outcome outcome) {
    switch (outcome) {
    case CANOPY_I2C_NAK_ADDRESS:
    case CANOPY_I2C_NAK_DATA: return CANOPY_SCAN_NAK;
    case CANOPY_I2C_TIMEOUT: return CANOPY_SCAN_TIMEOUT;
    case CANOPY_I2C_ARBITRATION:
    case CANOPY_I2C_HELD: return CANOPY_SCAN_BUS;
    default: return CANOPY_SCAN_LINK;
    }
}

// ---- A read

static enum canopy_scan_link_state fail(struct canopy_i2c_link *link, enum canopy_scan_failure failure,
                                        struct canopy_scan_answer *answer) {
    link->state = IDLE;
    answer->failure = failure;
    return CANOPY_SCAN_LINK_FAILED;
}

static enum canopy_scan_link_state finish(struct canopy_i2c_link *link, struct canopy_scan_answer *answer) {
    const unsigned high = link->table->i2c.low_first ? 1 : 0;
    for (unsigned i = 0; i < link->count; i++)
        answer->registers[i] = (uint16_t)(link->in[2 * i + high] << 8 | link->in[2 * i + 1 - high]);
    answer->count = link->count;
    link->state = IDLE;
    return CANOPY_SCAN_LINK_DONE;
}

// True if the pointer can say all of `count` registers from `address`.
static bool reachable(const struct canopy_scan_i2c *kind, const struct canopy_profile_request *request) {
    const uint32_t last = ((uint32_t)request->address + request->count - 1U) * kind->pointer_step;
    return last <= (kind->pointer_bytes == 1 ? UINT8_MAX : UINT16_MAX);
}

static bool begin(void *context, const struct canopy_profile_request *request, uint64_t now_us) {
    struct canopy_i2c_link *link = context;
    const struct canopy_scan_i2c *kind = &link->table->i2c;
    const uint8_t device = request->unit != 0 ? request->unit : kind->address;
    if (link->state != IDLE || !address_ok(device) || request->count == 0 || request->count > CANOPY_SCAN_READ_MAX ||
        !reachable(kind, request))
        return false;
    link->device = device;
    link->address = request->address;
    link->count = request->count;
    link->done = 0;
    link->begun_us = now_us;
    next_transfer(link);
    return true;
}

static enum canopy_scan_link_state poll(void *context, uint64_t now_us, struct canopy_scan_answer *answer) {
    struct canopy_i2c_link *link = context;
    if (link->state == QUEUED)
        start(link);
    if (link->state == QUEUED && now_us - link->begun_us >= link->timeout_us)
        return fail(link, CANOPY_SCAN_BUS, answer);
    if (link->state != RUNNING)
        return CANOPY_SCAN_LINK_PENDING;
    const enum canopy_i2c_outcome outcome = link->bus->poll(link->bus->context);
    if (outcome == CANOPY_I2C_PENDING)
        return CANOPY_SCAN_LINK_PENDING;
    if (outcome != CANOPY_I2C_DONE)
        return fail(link, failure_of(outcome), answer);
    if (!check_ok(link))
        return fail(link, CANOPY_SCAN_CRC, answer);
    link->done = (uint16_t)(link->done + link->now);
    if (link->done == link->count)
        return finish(link, answer);
    link->begun_us = now_us;
    next_transfer(link);
    return CANOPY_SCAN_LINK_PENDING;
}

static void count(void *context, struct canopy_scan_link_counters *to) {
    const struct canopy_i2c_link *link = context;
    *to = (struct canopy_scan_link_counters){.recoveries = link->bus->recoveries(link->bus->context)};
}

struct canopy_scan_link canopy_i2c_link(struct canopy_i2c_link *link) {
    return (struct canopy_scan_link){.context = link, .begin = begin, .poll = poll, .count = count};
}
