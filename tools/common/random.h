/// Small reproducible random numbers for simulators (splitmix64, Steele, Lea and Flood 2014). Not for secrets.
#ifndef CANOPY_TOOLS_COMMON_RANDOM_H
#define CANOPY_TOOLS_COMMON_RANDOM_H

#include <stdbool.h>
#include <stdint.h>

static inline uint64_t canopy_random_mix(uint64_t z) {
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

/// The next 64 bits of the stream whose state is `*state`; any state is a good start.
static inline uint64_t canopy_random_next(uint64_t *state) {
    *state += 0x9E3779B97F4A7C15u;
    return canopy_random_mix(*state);
}

/// [0, 1)
static inline double canopy_random_unit(uint64_t *state) { return (double)(canopy_random_next(state) >> 11) * 0x1p-53; }

/// True with probability p; takes nothing from the stream when p is 0.
static inline bool canopy_random_chance(uint64_t *state, double p) { return p > 0 && canopy_random_unit(state) < p; }

/// 0 to below - 1; `below` at least 1. The bias is below 2^-32.
static inline uint32_t canopy_random_below(uint64_t *state, uint32_t below) {
    return (uint32_t)(((canopy_random_next(state) >> 32) * below) >> 32);
}

#endif
