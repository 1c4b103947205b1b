/// Cuts a caller's memory into pieces, once, at init. Nothing is ever given back.
///
/// Every object of the library that needs memory takes `void *arena, size_t bytes`, with a macro that gives the size
/// at compile time. An arena is aligned to 8 bytes; the pieces keep that alignment, which the macros allow for.
#ifndef CANOPY_ARENA_H
#define CANOPY_ARENA_H

#include <stddef.h>
#include <stdint.h>

#include "lib/status.h"

#define CANOPY_ARENA_ROUND(bytes) (((size_t)(bytes) + 7U) / 8U * 8U)

/// Declares static memory that fits an arena macro.
#define CANOPY_ARENA_DECLARE(name, bytes) _Alignas(8) uint64_t name[((bytes) + 7U) / 8U]

struct canopy_arena {
    unsigned char *next;
    size_t left;
};

/// Begins to cut `arena`, of which `needed` bytes are going to be taken.
/// CANOPY_ARENA_ALIGN, CANOPY_ARENA_SHORT, or CANOPY_OK: every piece up to `needed` bytes is then sure.
enum canopy_status canopy_arena_open(struct canopy_arena *cut, void *arena, size_t bytes, size_t needed);

/// The next piece. The caller has asked canopy_arena_open for at least the sum of all pieces, each rounded up.
void *canopy_arena_take(struct canopy_arena *cut, size_t bytes);

#endif
