/// Inside lib/scan: numbers out of registers.
#ifndef CANOPY_SCAN_FIELD_H
#define CANOPY_SCAN_FIELD_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/scan/table.h"

/// Registers of one value: 1 or 2.
static inline uint16_t canopy_scan_words(uint8_t type) { return type >= CANOPY_SCAN_U32 ? 2 : 1; }

/// The value of that type at `registers`, host order.
int64_t canopy_scan_raw(const uint16_t *registers, uint8_t type, uint8_t order);

/// The bits of a field that stands in the block at `registers`, or of a constant; 0 if it is absent.
uint32_t canopy_scan_bits(const struct canopy_profile_table *table, const struct canopy_scan_field *field,
                          const uint16_t *registers);

/// Loads the field in device units if it belongs to block `where` (an absent or other one leaves `to` alone). False if
/// the product with its multiplier does not fit.
bool canopy_scan_load(const struct canopy_profile_table *table, const struct canopy_scan_field *field, uint8_t where,
                      const uint16_t *registers, int32_t *to);

#endif
