/// CRC-32 as in zlib, Ethernet and PNG (reflected polynomial 0xEDB88320), without a table: bounded pieces of anything.
#ifndef CANOPY_CRC32_H
#define CANOPY_CRC32_H

#include <stddef.h>
#include <stdint.h>

/// Goes on from `crc`, 0 at the beginning, over `length` bytes: the CRC of all bytes so far. About 45 instructions a
/// byte. "123456789" gives 0xCBF43926.
uint32_t canopy_crc32(uint32_t crc, const void *bytes, size_t length);

#endif
