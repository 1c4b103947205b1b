/// A ring of bytes between a program and an interrupt: one of them writes, the other reads, and neither ever waits or
/// masks. Loads and stores alone, so that processors without exclusive accesses (ARMv6-M) have it, too.
#ifndef CANOPY_PORT_COMMON_BYTE_RING_H
#define CANOPY_PORT_COMMON_BYTE_RING_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/// The counts grow without end; their difference is what is inside.
struct canopy_byte_ring {
    uint8_t *bytes;
    uint32_t capacity;    ///< a power of two
    atomic_uint written;  ///< stored by the writer alone
    atomic_uint read;     ///< stored by the reader alone
    atomic_uint lost;     ///< stored by the writer alone: what canopy_byte_ring_lose counted
};

/// Makes it empty, before both sides use it. `bytes` stay the caller's; `capacity` is a power of two.
void canopy_byte_ring_init(struct canopy_byte_ring *ring, uint8_t *bytes, uint32_t capacity);

/// The writer's: false if it is full, nothing is put then.
bool canopy_byte_ring_put(struct canopy_byte_ring *ring, uint8_t byte);

/// The writer's: puts as many as there is room for and returns their number.
size_t canopy_byte_ring_write(struct canopy_byte_ring *ring, const uint8_t *from, size_t length);

/// The writer's: counts a byte that was lost before it could be put, or because there was no room.
void canopy_byte_ring_lose(struct canopy_byte_ring *ring);

/// The reader's: false if it is empty.
bool canopy_byte_ring_take(struct canopy_byte_ring *ring, uint8_t *byte);

/// The reader's: takes at most `length` bytes and returns their number.
size_t canopy_byte_ring_read(struct canopy_byte_ring *ring, uint8_t *to, size_t length);

/// For either side: whether nothing is inside, and how many bytes were lost since the start.
bool canopy_byte_ring_empty(const struct canopy_byte_ring *ring);
uint32_t canopy_byte_ring_lost(const struct canopy_byte_ring *ring);

#endif
