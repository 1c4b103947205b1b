/// An I2C bus in memory, as a struct canopy_i2c: its slaves are C objects, its faults are switches.
///
/// Byte by byte, as the wire has them: byte 0 of a transfer is the first address with its read/write bit, and so on
/// through what is written, the second address, and what is read. A fault names the byte, or the bit, at which it
/// strikes; I2C_NEVER is never. Nothing here allocates or does I/O, so that it runs as firmware too.
///
///     static struct i2c_bus bus;
///     i2c_bus_init(&bus);
///     i2c_bus_add(&bus, &slave);
///     const struct canopy_i2c i2c = i2c_bus_port(&bus);
///     bus.flip_at = 8 * 3 + 7;    // the last bit of byte 3 is turned, in every transfer until this is I2C_NEVER
///
/// A second object here, struct i2c_registers, is a slave that serves registers in the wire format of the generic map
/// (lib/scan/generic.h), with its own check sum, and misbehaves on request.
#ifndef CANOPY_HOSTTEST_I2C_BUS_H
#define CANOPY_HOSTTEST_I2C_BUS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "lib/port.h"

#define I2C_NEVER UINT32_MAX
#define I2C_SLAVES 4
#define I2C_RECOVERY_CLOCKS 9

/// What sits at an address. `select` and `write` acknowledge by true; `read` gives the next byte; `stop` ends a
/// transfer (not a repeated START).
struct i2c_slave {
    void *context;
    uint8_t address;
    bool (*select)(void *context, bool reading);
    bool (*write)(void *context, uint8_t byte);
    uint8_t (*read)(void *context);
    void (*stop)(void *context);
};

enum i2c_phase { I2C_BUS_IDLE, I2C_BUS_ADDRESS_OUT, I2C_BUS_OUT, I2C_BUS_ADDRESS_IN, I2C_BUS_IN };

struct i2c_bus {
    // Switches
    uint32_t nak_at;        ///< this byte is not acknowledged (addresses and written bytes)
    uint32_t stretch_at;    ///< the clock is held at this byte without end
    uint32_t lose_at;       ///< another master wins at this byte
    uint32_t flip_at;       ///< bit 8 * byte + 0 (first on the wire) to 7 is turned on its way
    uint32_t flip_also;     ///< a second one
    uint32_t spoilt;        ///< of how many more transfers; I2C_NEVER: all
    uint16_t hung_clocks;   ///< somebody holds the data line until he has been given so many clocks
    bool held;              ///< a line is low, whatever one does
    uint16_t bytes_a_poll;  ///< moved in one poll; 0: all
    uint16_t max_transfer;
    // What happened
    uint32_t transfers;    ///< begun
    uint32_t bytes;        ///< that went over the wire, addresses included
    uint32_t recoveries;   ///< times the bus was freed by clocks
    uint32_t timeout_us;   ///< of the last transfer
    uint8_t address;       ///< of the last transfer
    bool stopped_between;  ///< in the last transfer: STOP and START instead of a repeated START
    uint8_t out[8];        ///< the beginning of what the last transfer wrote, and how much it was
    uint16_t out_length;
    // Its own
    struct i2c_slave *slaves[I2C_SLAVES];
    struct i2c_slave *selected;  // who listens or speaks now
    bool selected_reading;
    uint8_t slave_count;
    uint8_t phase;  // enum i2c_phase
    enum canopy_i2c_outcome outcome;
    struct canopy_i2c_transfer transfer;
    uint32_t at;     // number of the byte on the wire
    uint32_t moved;  // bytes of the phase
};

static inline void i2c_bus_be_well(struct i2c_bus *bus) {
    bus->nak_at = bus->stretch_at = bus->lose_at = bus->flip_at = bus->flip_also = I2C_NEVER;
    bus->spoilt = I2C_NEVER;
    bus->hung_clocks = 0;
    bus->held = false;
}

static inline void i2c_bus_init(struct i2c_bus *bus) {
    memset(bus, 0, sizeof *bus);
    i2c_bus_be_well(bus);
    bus->max_transfer = UINT16_MAX;
    bus->outcome = CANOPY_I2C_UNSUPPORTED;
}

static inline void i2c_bus_add(struct i2c_bus *bus, struct i2c_slave *slave) {
    bus->slaves[bus->slave_count++] = slave;
}

static inline void i2c_bus_end(struct i2c_bus *bus, enum canopy_i2c_outcome outcome) {
    if (bus->selected != NULL)
        bus->selected->stop(bus->selected->context);
    bus->selected = NULL;
    bus->phase = I2C_BUS_IDLE;
    bus->outcome = outcome;
    if (bus->spoilt != I2C_NEVER && bus->spoilt > 0 && --bus->spoilt == 0)
        i2c_bus_be_well(bus);
}

// The byte as it arrives at the other end.
static inline uint8_t i2c_bus_disturbed(const struct i2c_bus *bus, uint8_t byte) {
    uint32_t seen = byte;
    if (bus->flip_at / 8 == bus->at)
        seen ^= 0x80u >> bus->flip_at % 8;
    if (bus->flip_also / 8 == bus->at)
        seen ^= 0x80u >> bus->flip_also % 8;
    return (uint8_t)seen;
}

// An address byte. Whoever hears his own answers, for the direction that he hears.
static inline bool i2c_bus_select(struct i2c_bus *bus, bool reading) {
    const uint8_t heard = i2c_bus_disturbed(bus, (uint8_t)(bus->transfer.address << 1 | (reading ? 1 : 0)));
    if (bus->selected != NULL && bus->transfer.stop_between)
        bus->selected->stop(bus->selected->context);
    bus->selected = NULL;
    for (uint8_t i = 0; i < bus->slave_count; i++) {
        struct i2c_slave *slave = bus->slaves[i];
        if (slave->address == heard >> 1 && slave->select(slave->context, heard & 1)) {
            bus->selected = slave;
            bus->selected_reading = heard & 1;
        }
    }
    return bus->selected != NULL && bus->nak_at != bus->at;
}

// A slave that believes to be read drives no acknowledgement; one that believes to be written to drives no data.
static inline bool i2c_bus_write(struct i2c_bus *bus, uint8_t byte) {
    if (bus->selected == NULL || bus->selected_reading)
        return false;
    return bus->selected->write(bus->selected->context, i2c_bus_disturbed(bus, byte)) && bus->nak_at != bus->at;
}

static inline uint8_t i2c_bus_read(struct i2c_bus *bus) {
    uint8_t byte = 0xFF;
    if (bus->selected != NULL && bus->selected_reading)
        byte = bus->selected->read(bus->selected->context);
    else if (bus->selected != NULL)
        (void)bus->selected->write(bus->selected->context, byte);
    return i2c_bus_disturbed(bus, byte);
}

static inline void i2c_bus_next_phase(struct i2c_bus *bus) {
    const bool reads = bus->transfer.in_length > 0;
    bus->moved = 0;
    if (bus->phase == I2C_BUS_ADDRESS_OUT && bus->transfer.out_length > 0)
        bus->phase = I2C_BUS_OUT;
    else if (bus->phase == I2C_BUS_ADDRESS_IN)
        bus->phase = I2C_BUS_IN;
    else if (bus->phase != I2C_BUS_IN && reads)
        bus->phase = I2C_BUS_ADDRESS_IN;
    else
        i2c_bus_end(bus, CANOPY_I2C_DONE);
}

static inline void i2c_bus_byte(struct i2c_bus *bus) {
    if (bus->at == bus->stretch_at || bus->at == bus->lose_at) {
        i2c_bus_end(bus, bus->at == bus->stretch_at ? CANOPY_I2C_TIMEOUT : CANOPY_I2C_ARBITRATION);
        return;
    }
    bool done = true;
    switch (bus->phase) {
    case I2C_BUS_ADDRESS_OUT:
    case I2C_BUS_ADDRESS_IN:
        if (!i2c_bus_select(bus, bus->phase == I2C_BUS_ADDRESS_IN)) {
            i2c_bus_end(bus, CANOPY_I2C_NAK_ADDRESS);
            return;
        }
        break;
    case I2C_BUS_OUT:
        if (!i2c_bus_write(bus, bus->transfer.out[bus->moved])) {
            i2c_bus_end(bus, CANOPY_I2C_NAK_DATA);
            return;
        }
        done = ++bus->moved == bus->transfer.out_length;
        break;
    default:
        bus->transfer.in[bus->moved] = i2c_bus_read(bus);
        done = ++bus->moved == bus->transfer.in_length;
        break;
    }
    bus->at++;
    bus->bytes++;
    if (done)
        i2c_bus_next_phase(bus);
}

// Frees the bus if nine clocks do.
static inline bool i2c_bus_is_free(struct i2c_bus *bus) {
    if (bus->held)
        return false;
    if (bus->hung_clocks == 0)
        return true;
    bus->hung_clocks = (uint16_t)(bus->hung_clocks > I2C_RECOVERY_CLOCKS ? bus->hung_clocks - I2C_RECOVERY_CLOCKS : 0);
    bus->recoveries += bus->hung_clocks == 0;
    return bus->hung_clocks == 0;
}

static inline bool i2c_bus_start(void *context, const struct canopy_i2c_transfer *transfer, uint32_t timeout_us) {
    struct i2c_bus *bus = context;
    if (bus->phase != I2C_BUS_IDLE)
        return false;
    bus->transfer = *transfer;
    bus->timeout_us = timeout_us;
    bus->address = transfer->address;
    bus->stopped_between = transfer->stop_between;
    bus->out_length = transfer->out_length;
    for (uint16_t i = 0; i < transfer->out_length && i < sizeof bus->out; i++)
        bus->out[i] = transfer->out[i];
    bus->transfers++;
    bus->at = bus->moved = 0;
    bus->phase = transfer->out_length > 0 || transfer->in_length == 0 ? I2C_BUS_ADDRESS_OUT : I2C_BUS_ADDRESS_IN;
    bus->outcome = CANOPY_I2C_PENDING;
    if (transfer->out_length > bus->max_transfer || transfer->in_length > bus->max_transfer)
        i2c_bus_end(bus, CANOPY_I2C_UNSUPPORTED);
    else if (!i2c_bus_is_free(bus))
        i2c_bus_end(bus, CANOPY_I2C_HELD);
    return true;
}

static inline enum canopy_i2c_outcome i2c_bus_poll(void *context) {
    struct i2c_bus *bus = context;
    const uint32_t most = bus->bytes_a_poll > 0 ? bus->bytes_a_poll : UINT32_MAX;
    for (uint32_t i = 0; i < most && bus->phase != I2C_BUS_IDLE; i++)
        i2c_bus_byte(bus);
    return bus->phase == I2C_BUS_IDLE ? bus->outcome : CANOPY_I2C_PENDING;
}

static inline uint32_t i2c_bus_recoveries(void *context) { return ((struct i2c_bus *)context)->recoveries; }

/// The bus as the library sees it. Its max_transfer is what bus->max_transfer is now.
static inline struct canopy_i2c i2c_bus_port(struct i2c_bus *bus) {
    return (struct canopy_i2c){.context = bus,
                               .max_transfer = bus->max_transfer,
                               .start = i2c_bus_start,
                               .poll = i2c_bus_poll,
                               .recoveries = i2c_bus_recoveries};
}

// ---------------------------------------------------------------------------------------------------------------------

/// Registers behind an address, in the wire format of the generic map.
struct i2c_registers {
    struct i2c_slave slave;  ///< for i2c_bus_add
    void *context;
    /// Copies what the registers hold now; false: they do not exist, and the read is refused.
    bool (*load)(void *context, uint16_t address, uint16_t count, uint16_t *to);
    // Switches
    bool deaf;              ///< misses requests: what it answers is what it was asked before
    bool answers_again;     ///< gives the last answer, byte for byte, to whatever it is asked
    uint32_t falls_silent;  ///< drives nothing from this byte of an answer on
    uint32_t skips_at;      ///< leaves this byte of an answer out
    // What happened
    uint32_t answered;  ///< answers that were read to the last byte of their check sum
    // Its own
    uint8_t request[4], have;
    bool used;  // the request has been answered
    uint8_t answer[252];
    uint16_t length, at;
};

static inline void i2c_registers_be_well(struct i2c_registers *file) {
    file->deaf = file->answers_again = false;
    file->falls_silent = file->skips_at = I2C_NEVER;
}

// One bit after the other: shares nothing with the library's.
static inline uint16_t i2c_registers_crc(uint16_t sum, uint8_t byte) {
    for (unsigned bit = 0; bit < 8; bit++) {
        const bool one = ((sum ^ (byte >> bit)) & 1) != 0;
        sum = (uint16_t)(sum >> 1);
        if (one)
            sum = (uint16_t)(sum ^ 0xA001u);
    }
    return sum;
}

static inline bool i2c_registers_prepare(struct i2c_registers *file) {
    uint16_t values[125];
    const uint8_t *request = file->request;
    const uint8_t count = request[2];
    if (file->have != sizeof file->request || (file->used && !file->deaf) || count == 0 || count > 125 ||
        !file->load(file->context, (uint16_t)(request[0] << 8 | request[1]), count, values))
        return false;
    uint16_t sum = i2c_registers_crc(0xFFFF, (uint8_t)(file->slave.address << 1));
    for (unsigned i = 0; i < sizeof file->request; i++)
        sum = i2c_registers_crc(sum, request[i]);
    sum = i2c_registers_crc(sum, (uint8_t)(file->slave.address << 1 | 1));
    for (unsigned i = 0; i < count; i++) {
        file->answer[2 * i] = (uint8_t)(values[i] >> 8);
        file->answer[2 * i + 1] = (uint8_t)(values[i] & 0xFF);
        sum = i2c_registers_crc(i2c_registers_crc(sum, file->answer[2 * i]), file->answer[2 * i + 1]);
    }
    file->answer[2 * count] = (uint8_t)(sum & 0xFF);
    file->answer[2 * count + 1] = (uint8_t)(sum >> 8);
    file->length = (uint16_t)(2 * count + 2);
    return true;
}

static inline bool i2c_registers_select(void *context, bool reading) {
    struct i2c_registers *file = context;
    file->at = 0;
    if (reading)
        return (file->answers_again && file->length > 0) || i2c_registers_prepare(file);
    if (!file->deaf) {
        file->have = 0;
        file->used = false;
    }
    return true;
}

static inline bool i2c_registers_write(void *context, uint8_t byte) {
    struct i2c_registers *file = context;
    if (file->deaf)
        return true;
    if (file->have == sizeof file->request)
        return false;
    file->request[file->have++] = byte;
    return true;
}

static inline uint8_t i2c_registers_read(void *context) {
    struct i2c_registers *file = context;
    const uint32_t at = file->at + (file->at >= file->skips_at ? 1U : 0U);
    file->at++;
    if (at >= file->length || at >= file->falls_silent)
        return 0xFF;
    file->answered += at + 1 == file->length;
    return file->answer[at];
}

static inline void i2c_registers_stop(void *context) {
    struct i2c_registers *file = context;
    file->used = file->used || file->at > 0;
}

static inline void i2c_registers_init(struct i2c_registers *file, uint8_t address,
                                      bool (*load)(void *context, uint16_t address, uint16_t count, uint16_t *to),
                                      void *context) {
    memset(file, 0, sizeof *file);
    file->slave = (struct i2c_slave){.context = file,
                                     .address = address,
                                     .select = i2c_registers_select,
                                     .write = i2c_registers_write,
                                     .read = i2c_registers_read,
                                     .stop = i2c_registers_stop};
    file->load = load;
    file->context = context;
    i2c_registers_be_well(file);
}

#endif
