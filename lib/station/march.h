/// March C-, a test of memory: stuck bits, transitions that fail, words that change with others, addresses that reach
/// no word, another or several (A. J. van de Goor, Testing Semiconductor Memories, 1991, 4.4: all such faults between
/// words; those between bits of one word as far as the backgrounds tell the bits apart).
#ifndef CANOPY_STATION_MARCH_H
#define CANOPY_STATION_MARCH_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/inline.h"

/// Patterns that tell any two bits of a word apart: some has them different.
#define CANOPY_MARCH_BACKGROUNDS 6U
CANOPY_INLINE uint32_t canopy_march_background(unsigned k) {
    static const uint32_t backgrounds[CANOPY_MARCH_BACKGROUNDS] = {0,           0x55555555U, 0x33333333U,
                                                                   0x0F0F0F0FU, 0x00FF00FFU, 0x0000FFFFU};
    return backgrounds[k];
}

/// Writes and reads `count` words through `put` and `get`, 10 times each, and tells whether all were read as written.
/// The words are left at the background. In one piece with its two functions where they are known, so that the same
/// text runs on memory and on a model of memory with faults.
CANOPY_INLINE bool canopy_march(void *context, uint32_t (*get)(void *context, unsigned i),
                                void (*put)(void *context, unsigned i, uint32_t value), unsigned count,
                                uint32_t background) {
    // A bit for each: what is expected (the background or its complement), what is written, whether downward. The first
    // only writes, the last only reads.
    static const struct {
        uint8_t expects, writes, down;
    } elements[] = {{0, 0, 0}, {0, 1, 0}, {1, 0, 0}, {0, 1, 1}, {1, 0, 1}, {0, 0, 0}};
    const unsigned last = sizeof elements / sizeof elements[0] - 1U;
    uint32_t wrong = 0;
    for (unsigned e = 0; e <= last; e++) {
        const uint32_t expected = background ^ (0U - (uint32_t)elements[e].expects);
        const uint32_t written = background ^ (0U - (uint32_t)elements[e].writes);
        unsigned i = elements[e].down != 0 ? count - 1U : 0;
        for (unsigned k = 0; k < count; k++) {
            if (e > 0) {
                wrong |= get(context, i) ^ expected;
            }
            if (e < last) {
                put(context, i, written);
            }
            i += elements[e].down != 0 ? (unsigned)-1 : 1U;
        }
    }
    return wrong == 0;
}

#endif
