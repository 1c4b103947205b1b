/// Numbers as binary point files hold them: whole or IEEE 754, of either byte order, at any address.
#ifndef CANOPY_TOOLS_COMMON_VALUE_H
#define CANOPY_TOOLS_COMMON_VALUE_H

#include <stdbool.h>
#include <stdint.h>

enum canopy_value {
    CANOPY_INT8,
    CANOPY_UINT8,
    CANOPY_INT16,
    CANOPY_UINT16,
    CANOPY_INT32,
    CANOPY_UINT32,
    CANOPY_FLOAT32,
    CANOPY_FLOAT64,
    CANOPY_INT64,
    CANOPY_UINT64,
    CANOPY_NO_VALUE
};

/// Bytes of a value of that kind, 1 to 8.
unsigned canopy_value_size(enum canopy_value kind);

/// A whole number of `size` bytes, 1 to 8.
uint64_t canopy_value_whole(const unsigned char *bytes, unsigned size, bool big_endian);

/// The number as a double: exactly, but for whole numbers of 64 bits beyond 2^53, which are rounded.
double canopy_value_real(const unsigned char *bytes, enum canopy_value kind, bool big_endian);

#endif
