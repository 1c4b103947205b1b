#include "lib/arena.h"

enum canopy_status canopy_arena_open(struct canopy_arena *cut, void *arena, size_t bytes, size_t needed) {
    if (arena == NULL || ((uintptr_t)arena & 7U) != 0) {
        return CANOPY_ARENA_ALIGN;
    }
    if (bytes < needed) {
        return CANOPY_ARENA_SHORT;
    }
    cut->next = (unsigned char *)arena;
    cut->left = bytes;
    return CANOPY_OK;
}

void *canopy_arena_take(struct canopy_arena *cut, size_t bytes) {
    const size_t rounded = CANOPY_ARENA_ROUND(bytes);
    void *piece = cut->next;
    cut->next += rounded;
    cut->left -= rounded;
    return piece;
}
