#include "lib/cover/packed.h"

#include "lib/num/fixed.h"

#define MEDIUM_LOG2 2  // 4 q
#define COARSE_LOG2 4  // 16 q
#define MEDIUM 128     // first code of its kind, and how far below the top it stands, in q
#define COARSE 192
#define MEDIUM_DEPTH 128
#define COARSE_DEPTH 384
#define LAST 254

// A height in multiples of 2^log2 q, rounded up.
static int32_t multiple_of(int32_t height, unsigned log2) {
    return (int32_t)canopy_shift_ceil(height, CANOPY_PACKED_LOG2 + log2);
}

int32_t canopy_packed_top(int32_t height) {
    return multiple_of(height, COARSE_LOG2) * (1 << (CANOPY_PACKED_LOG2 + COARSE_LOG2));
}

uint8_t canopy_packed_code(int32_t height, int32_t top) {
    const int32_t fine_top = multiple_of(top, 0);
    const int32_t medium = fine_top - multiple_of(height, MEDIUM_LOG2) * (1 << MEDIUM_LOG2);
    if (medium < MEDIUM_DEPTH) {
        return (uint8_t)(fine_top - multiple_of(height, 0));
    }
    const int32_t coarse = fine_top - multiple_of(height, COARSE_LOG2) * (1 << COARSE_LOG2);
    if (coarse < COARSE_DEPTH) {
        return (uint8_t)(MEDIUM + ((medium - MEDIUM_DEPTH) >> MEDIUM_LOG2));
    }
    const int32_t code = COARSE + ((coarse - COARSE_DEPTH) >> COARSE_LOG2);
    return (uint8_t)(code < LAST ? code : LAST);
}

int32_t canopy_packed_height(uint8_t code, int32_t top) {
    const int32_t depth = code < MEDIUM   ? code
                          : code < COARSE ? MEDIUM_DEPTH + ((code - MEDIUM) << MEDIUM_LOG2)
                                          : COARSE_DEPTH + ((code - COARSE) << COARSE_LOG2);
    return top - depth * (1 << CANOPY_PACKED_LOG2);
}
