/// The published surface in whole numbers, for tests: shares nothing with lib/cover. Weights of the uniform cubic
/// B-spline are written down here, in 128 bits nothing is lost: pitches up to 2^12.
#ifndef CANOPY_HOSTTEST_JUDGE_H
#define CANOPY_HOSTTEST_JUDGE_H

#include <stdint.h>

#include "lib/cover/envelope.h"

__extension__ typedef __int128 judge_wide;

static inline int64_t judge_floor_div(int64_t a, int64_t b) { return a / b - (a % b < 0); }
static inline int64_t judge_floor_mod(int64_t a, int64_t b) { return a - b * judge_floor_div(a, b); }

// Six times the four weights at part / pitch, times pitch^3.
static inline void judge_weights(int64_t part, int64_t pitch, int64_t to[4]) {
    const int64_t rest = pitch - part;
    to[0] = rest * rest * rest;
    to[1] = 3 * part * part * part - 6 * part * part * pitch + 4 * pitch * pitch * pitch;
    to[2] = 3 * rest * rest * rest - 6 * rest * rest * pitch + 4 * pitch * pitch * pitch;
    to[3] = part * part * part;
}

// The sum of coefficients and weights, times 36 pu^3 pv^3.
static inline judge_wide judge_surface(const struct canopy_envelope *envelope, const int64_t offset[2]) {
    const struct canopy_frame *frame = &envelope->frame;
    int64_t w[2][4], first[2];
    for (int a = 0; a < 2; a++) {
        int64_t interval = offset[a] / frame->pitch[a];
        interval = interval > frame->size[a] - 2 ? frame->size[a] - 2 : interval;
        judge_weights(offset[a] - interval * frame->pitch[a], frame->pitch[a], w[a]);
        first[a] = interval - 1;
    }
    judge_wide sum = 0;
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            int64_t row = first[0] + i, column = first[1] + j;
            row = row < 0 ? 0 : row >= frame->size[0] ? frame->size[0] - 1 : row;
            column = column < 0 ? 0 : column >= frame->size[1] ? frame->size[1] - 1 : column;
            sum += (judge_wide)(w[0][i] * w[1][j]) * envelope->coefficients[row * frame->size[1] + column];
        }
    }
    return sum;
}

/// How far a height z in quanta, at offsets of whole quanta from the origin, is on the safe side, in steps times
/// *scale; negative beyond the surface. For lsb_log2 of 0 or less.
static inline judge_wide judge_distance(const struct canopy_envelope *envelope, const int64_t offset[2], int32_t z,
                                        judge_wide *scale) {
    const struct canopy_frame *frame = &envelope->frame;
    const judge_wide pu = frame->pitch[0], pv = frame->pitch[1];
    *scale = 36 * pu * pu * pu * pv * pv * pv;
    const judge_wide height = ((judge_wide)z - frame->origin[2]) * ((judge_wide)1 << -frame->lsb_log2);
    const judge_wide gap = judge_surface(envelope, offset) - height * *scale;
    return frame->side == CANOPY_ABOVE ? gap : -gap;
}

#endif
