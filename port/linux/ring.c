#include "port/linux/ring.h"

void canopy_linux_ring_init(struct canopy_linux_ring *ring) {
    atomic_init(&ring->head, 0);
    atomic_init(&ring->tail, 0);
}

bool canopy_linux_ring_push(struct canopy_linux_ring *ring, const struct canopy_linux_item *item) {
    const unsigned head = atomic_load_explicit(&ring->head, memory_order_relaxed);
    if (head - atomic_load_explicit(&ring->tail, memory_order_acquire) == CANOPY_LINUX_RING_ITEMS) {
        return false;
    }
    ring->items[head % CANOPY_LINUX_RING_ITEMS] = *item;
    atomic_store_explicit(&ring->head, head + 1, memory_order_release);
    return true;
}

bool canopy_linux_ring_pop(struct canopy_linux_ring *ring, struct canopy_linux_item *item) {
    const unsigned tail = atomic_load_explicit(&ring->tail, memory_order_relaxed);
    if (tail == atomic_load_explicit(&ring->head, memory_order_acquire)) {
        return false;
    }
    *item = ring->items[tail % CANOPY_LINUX_RING_ITEMS];
    atomic_store_explicit(&ring->tail, tail + 1, memory_order_release);
    return true;
}

bool canopy_linux_ring_empty(struct canopy_linux_ring *ring) {
    return atomic_load_explicit(&ring->tail, memory_order_relaxed) ==
           atomic_load_explicit(&ring->head, memory_order_acquire);
}
