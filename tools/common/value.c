#include "tools/common/value.h"

#include <string.h>

unsigned canopy_value_size(enum canopy_value kind) {
    static const unsigned char SIZES[] = {1, 1, 2, 2, 4, 4, 4, 8, 8, 8, 0};
    return SIZES[kind];
}

uint64_t canopy_value_whole(const unsigned char *bytes, unsigned size, bool big_endian) {
    uint64_t value = 0;
    for (unsigned i = 0; i < size; i++) {
        value |= (uint64_t)bytes[big_endian ? size - 1 - i : i] << (8 * i);
    }
    return value;
}

double canopy_value_real(const unsigned char *bytes, enum canopy_value kind, bool big_endian) {
    const uint64_t raw = canopy_value_whole(bytes, canopy_value_size(kind), big_endian);
    float narrow = 0.0F;
    double wide = 0.0;
    const uint32_t low = (uint32_t)raw;
    switch (kind) {
    case CANOPY_INT8: return (double)(int8_t)low;
    case CANOPY_INT16: return (double)(int16_t)low;
    case CANOPY_INT32: return (double)(int32_t)low;
    case CANOPY_INT64: return (double)(int64_t)raw;
    case CANOPY_FLOAT32: memcpy(&narrow, &low, sizeof narrow); return (double)narrow;
    case CANOPY_FLOAT64: memcpy(&wide, &raw, sizeof wide); return wide;
    case CANOPY_UINT8:
    case CANOPY_UINT16:
    case CANOPY_UINT32:
    case CANOPY_UINT64:
    case CANOPY_NO_VALUE:
    default: return (double)raw;
    }
}
