/// A table of registers as a Modbus bank, and the CRC as the specification writes it: for tests.
#ifndef CANOPY_HOSTTEST_MODBUS_TABLE_H
#define CANOPY_HOSTTEST_MODBUS_TABLE_H

#include <string.h>

#include "lib/modbus/pdu.h"

enum { TABLE_REGISTERS = 300 };

/// Registers [0, TABLE_REGISTERS), all writable, but that 0xDEAD is refused as a value; other addresses do not exist.
struct table {
    uint16_t registers[TABLE_REGISTERS];
    uint8_t fail;            ///< what every access answers, if not 0
    uint32_t reads, writes;  ///< accesses that were carried out
    uint8_t client;          ///< of the last access
    uint8_t function;        ///< of the last write
    const char *objects[7];
};

static inline uint8_t table_check(struct table *table, uint8_t client, uint16_t address, uint16_t count) {
    table->client = client;
    if (table->fail)
        return table->fail;
    return (uint32_t)address + count > TABLE_REGISTERS ? CANOPY_MODBUS_ILLEGAL_ADDRESS : CANOPY_MODBUS_NO_EXCEPTION;
}

static inline uint8_t table_readable(void *context, uint8_t client, uint16_t address, uint16_t count) {
    return table_check(context, client, address, count);
}

static inline uint8_t table_read(void *context, uint8_t client, uint16_t address, uint16_t count, uint8_t *to) {
    struct table *table = context;
    const uint8_t exception = table_check(table, client, address, count);
    if (exception)
        return exception;
    for (uint32_t i = 0; i < count; i++) {
        to[2 * i] = (uint8_t)(table->registers[address + i] >> 8);
        to[2 * i + 1] = (uint8_t)(table->registers[address + i] & 0xFFu);
    }
    table->reads++;
    return CANOPY_MODBUS_NO_EXCEPTION;
}

static inline uint8_t table_write(void *context, uint8_t client, uint16_t address, uint16_t count, const uint8_t *from,
                                  uint8_t function) {
    struct table *table = context;
    const uint8_t exception = table_check(table, client, address, count);
    if (exception)
        return exception;
    for (uint32_t i = 0; i < count; i++)
        if (from[2 * i] == 0xDE && from[2 * i + 1] == 0xAD)
            return CANOPY_MODBUS_ILLEGAL_VALUE;
    for (uint32_t i = 0; i < count; i++)
        table->registers[address + i] = (uint16_t)(from[2 * i] << 8 | from[2 * i + 1]);
    table->writes++;
    table->function = function;
    return CANOPY_MODBUS_NO_EXCEPTION;
}

static inline const char *table_identify(void *context, uint8_t object) {
    const struct table *table = context;
    return table->objects[object];
}

/// Fills the table with address * 7 + 0x1234 and gives it the bank's callbacks.
static inline void table_init(struct table *table, struct canopy_modbus_bank *bank) {
    memset(table, 0, sizeof *table);
    for (uint32_t i = 0; i < TABLE_REGISTERS; i++)
        table->registers[i] = (uint16_t)(i * 7u + 0x1234u);
    *bank = (struct canopy_modbus_bank){table, table_read, table_write, table_identify, table_readable};
}

/// Bit by bit, as in the specification's figure: shares nothing with lib/modbus/crc.c.
static inline size_t table_crc(uint8_t *bytes, size_t length) {
    uint16_t crc = 0xFFFF;
    for (size_t i = 0; i < length; i++) {
        crc = (uint16_t)(crc ^ bytes[i]);
        for (int bit = 0; bit < 8; bit++)
            crc = (uint16_t)(crc & 1u ? (crc >> 1) ^ 0xA001u : crc >> 1);
    }
    bytes[length] = (uint8_t)(crc & 0xFFu);
    bytes[length + 1] = (uint8_t)(crc >> 8);
    return length + 2;
}

#endif
