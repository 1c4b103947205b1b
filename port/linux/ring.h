/// What a scanner's thread hands to the station's: readings and scenes in order, without a lock.
///
/// One thread pushes, one pops; neither ever waits for the other. C11 atomics, one release and one acquire a call.
#ifndef CANOPY_PORT_LINUX_RING_H
#define CANOPY_PORT_LINUX_RING_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/scan/profile.h"

enum canopy_linux_item_kind { CANOPY_LINUX_READING, CANOPY_LINUX_SCENE };

struct canopy_linux_item {
    uint8_t kind;  ///< enum canopy_linux_item_kind
    union {
        struct {
            int32_t point[3];               ///< device units
            uint32_t uncertainty;           ///< the true height is within z +- this
        } reading;                          ///< a valid reading
        struct canopy_profile_scene scene;  ///< of all readings behind it
    } as;
};

#define CANOPY_LINUX_RING_ITEMS 8192u  ///< a power of two; 400 columns are 20 profiles

struct canopy_linux_ring {
    _Alignas(64) atomic_uint head;  // items pushed; written by the pusher
    _Alignas(64) atomic_uint tail;  // items popped; written by the popper
    struct canopy_linux_item items[CANOPY_LINUX_RING_ITEMS];
};

/// Makes it empty, before both threads use it.
void canopy_linux_ring_init(struct canopy_linux_ring *ring);

/// False if it is full; nothing is pushed then.
bool canopy_linux_ring_push(struct canopy_linux_ring *ring, const struct canopy_linux_item *item);

/// False if it is empty.
bool canopy_linux_ring_pop(struct canopy_linux_ring *ring, struct canopy_linux_item *item);

/// Whether there is something to pop; for the popper.
bool canopy_linux_ring_empty(struct canopy_linux_ring *ring);

#endif
