#include "lib/scan/field.h"

int64_t canopy_scan_raw(const uint16_t *registers, uint8_t type, uint8_t order) {
    if (type == CANOPY_SCAN_U16)
        return registers[0];
    if (type == CANOPY_SCAN_I16)
        return registers[0] >= 0x8000u ? (int64_t)registers[0] - 0x10000 : registers[0];
    const uint16_t high = registers[order == CANOPY_SCAN_CDAB ? 1 : 0];
    const uint16_t low = registers[order == CANOPY_SCAN_CDAB ? 0 : 1];
    const int64_t value = ((int64_t)high << 16) | low;
    return type == CANOPY_SCAN_I32 && high >= 0x8000u ? value - ((int64_t)1 << 32) : value;
}

uint32_t canopy_scan_bits(const struct canopy_profile_table *table, const struct canopy_scan_field *field,
                          const uint16_t *registers) {
    if (field->where == CANOPY_SCAN_ABSENT)
        return 0;
    if (field->where == CANOPY_SCAN_CONSTANT)
        return (uint32_t)field->constant;
    return (uint32_t)canopy_scan_raw(registers + field->offset, field->type, table->order);
}

bool canopy_scan_load(const struct canopy_profile_table *table, const struct canopy_scan_field *field, uint8_t where,
                      const uint16_t *registers, int32_t *to) {
    if (field->where != where || where == CANOPY_SCAN_ABSENT)
        return true;
    if (where == CANOPY_SCAN_CONSTANT) {
        *to = field->constant;
        return true;
    }
    const int64_t multiplier = field->multiplier == 0 ? 1 : field->multiplier;
    const int64_t value = canopy_scan_raw(registers + field->offset, field->type, table->order) * multiplier;
    if (value < INT32_MIN || value > INT32_MAX)
        return false;
    *to = (int32_t)value;
    return true;
}
