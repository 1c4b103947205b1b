// Scenes made on the device, for what measures instructions: heights of 0 to 8191 by column and profile.
//
//     hills    value noise of six octaves, as rough as a terrain (the smallest waves are shorter than a field cell)
//     boxes    parts with vertical walls on a plane
#ifndef CANOPY_HOSTTEST_FIRMWARE_SCENE_H
#define CANOPY_HOSTTEST_FIRMWARE_SCENE_H

#include <stdbool.h>
#include <stdint.h>

static uint32_t hash(uint32_t x, uint32_t y) {
    uint32_t h = x * 0x9E3779B1u ^ y * 0x85EBCA77u;
    h = (h ^ h >> 15) * 0x2C1B3C6Du;
    h = (h ^ h >> 12) * 0x297A2D39u;
    return h ^ h >> 15;
}

// Values of 0 to 65535 on a lattice of 2^log2 columns, bilinear between.
static int32_t noise(uint32_t x, uint32_t y, unsigned log2) {
    const uint32_t i = x >> log2, j = y >> log2, size = 1u << log2;
    const uint32_t s = x & (size - 1), t = y & (size - 1);
    const uint32_t low = (hash(i, j) & 0xFFFF) * (size - s) + (hash(i + 1, j) & 0xFFFF) * s;
    const uint32_t high = (hash(i, j + 1) & 0xFFFF) * (size - s) + (hash(i + 1, j + 1) & 0xFFFF) * s;
    return (int32_t)(((uint64_t)low * (size - t) + (uint64_t)high * t) >> (2 * log2));
}

static inline int32_t hills(uint32_t x, uint32_t y) {
    int32_t height = 0;
    for (unsigned octave = 0; octave < 6; octave++)
        height += noise(x, y, 7 - octave) >> octave;
    return height / 16;
}

static inline int32_t boxes(uint32_t x, uint32_t y) {
    const uint32_t part = hash(x / 57, y / 61);
    const bool inside = x % 57 > 10 && y % 61 > 12 && (part & 3) != 0;
    return (inside ? 1000 + (int32_t)(part >> 8 & 0x7FF) : 0) + (int32_t)(hash(x, y) & 15);
}

#endif
