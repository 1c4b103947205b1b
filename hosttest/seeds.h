/// Seeds for tests with random scenes. CANOPY_CLOUDS=n in the environment sets how many, CANOPY_SEED=n runs that one.
#ifndef CANOPY_HOSTTEST_SEEDS_H
#define CANOPY_HOSTTEST_SEEDS_H

#include <stdint.h>
#include <stdlib.h>

/// A number from the environment, or `otherwise`.
static inline uint64_t seeds_number(const char *name, uint64_t otherwise) {
    const char *text = getenv(name);
    return text != NULL ? strtoull(text, NULL, 10) : otherwise;
}

/// Calls `check` for `count` seeds, unless the environment says otherwise. The two compilers' programs have others.
static inline void seeds_run(uint64_t count, void (*check)(uint64_t seed)) {
#ifdef __clang__
    const uint64_t first = 1000000001;
#else
    const uint64_t first = 1;
#endif
    const uint64_t only = seeds_number("CANOPY_SEED", 0), clouds = seeds_number("CANOPY_CLOUDS", count);
    if (only != 0) {
        check(only);
        return;
    }
    for (uint64_t i = 0; i < clouds; i++) {
        check(first + i);
    }
}

#endif
