#include "port/common/byte_ring.h"

void canopy_byte_ring_init(struct canopy_byte_ring *ring, uint8_t *bytes, uint32_t capacity) {
    ring->bytes = bytes;
    ring->capacity = capacity;
    atomic_init(&ring->written, 0);
    atomic_init(&ring->read, 0);
    atomic_init(&ring->lost, 0);
}

bool canopy_byte_ring_put(struct canopy_byte_ring *ring, uint8_t byte) {
    const unsigned written = atomic_load_explicit(&ring->written, memory_order_relaxed);
    if (written - atomic_load_explicit(&ring->read, memory_order_acquire) == ring->capacity)
        return false;
    ring->bytes[written & (ring->capacity - 1u)] = byte;
    atomic_store_explicit(&ring->written, written + 1u, memory_order_release);
    return true;
}

size_t canopy_byte_ring_write(struct canopy_byte_ring *ring, const uint8_t *from, size_t length) {
    size_t count = 0;
    while (count < length && canopy_byte_ring_put(ring, from[count]))
        count++;
    return count;
}

void canopy_byte_ring_lose(struct canopy_byte_ring *ring) {
    // Only the writer stores it: no read-modify-write is needed.
    atomic_store_explicit(&ring->lost, atomic_load_explicit(&ring->lost, memory_order_relaxed) + 1u,
                          memory_order_relaxed);
}

bool canopy_byte_ring_take(struct canopy_byte_ring *ring, uint8_t *byte) {
    const unsigned read = atomic_load_explicit(&ring->read, memory_order_relaxed);
    if (atomic_load_explicit(&ring->written, memory_order_acquire) == read)
        return false;
    *byte = ring->bytes[read & (ring->capacity - 1u)];
    atomic_store_explicit(&ring->read, read + 1u, memory_order_release);
    return true;
}

size_t canopy_byte_ring_read(struct canopy_byte_ring *ring, uint8_t *to, size_t length) {
    size_t count = 0;
    while (count < length && canopy_byte_ring_take(ring, &to[count]))
        count++;
    return count;
}

bool canopy_byte_ring_empty(const struct canopy_byte_ring *ring) {
    return atomic_load_explicit(&ring->read, memory_order_relaxed) ==
           atomic_load_explicit(&ring->written, memory_order_relaxed);
}

uint32_t canopy_byte_ring_lost(const struct canopy_byte_ring *ring) {
    return atomic_load_explicit(&ring->lost, memory_order_relaxed);
}
