#include "lib/cover/axes.h"

#include <string.h>

// floor(sqrt(square)), or one more where that is nearer.
static uint32_t root_of(uint64_t square) {
    uint64_t root = 0, rest = square;
    for (uint64_t bit = (uint64_t)1 << 62; bit != 0; bit >>= 2) {
        const uint64_t tried = root + bit;
        root >>= 1;
        if (rest >= tried) {
            rest -= tried;
            root += bit;
        }
    }
    return (uint32_t)(rest > root ? root + 1 : root);  // rest = square - root^2 > root: beyond (root + 1/2)^2
}

static uint64_t size_of(int64_t x) { return x < 0 ? -(uint64_t)x : (uint64_t)x; }

static int64_t divide_nearest(int64_t a, int64_t b) { return (a + (a < 0 ? -b / 2 : b / 2)) / b; }

// The direction of v in units of 2^-30, each component within 2 of the exact one; false for 0. |v| < 2^62.
//
// v is brought to where its largest component has 31 bits. Rounded there, it is off by 1/2 in 2^30 each, sideways by
// less than 0.87 of a unit; its length by 1/2 in 2^30, another half unit; and the quotient's rounding is the last half.
static bool normalise(const int64_t v[3], int32_t row[3]) {
    uint64_t most = 0;
    for (int k = 0; k < 3; k++) {
        most = size_of(v[k]) > most ? size_of(v[k]) : most;
    }
    if (most == 0) {
        return false;
    }
    int down = 0;
    for (; most >= (uint64_t)1 << 31; most >>= 1) {
        down++;
    }
    for (; most < (uint64_t)1 << 30; most <<= 1) {
        down--;
    }
    int64_t w[3];
    uint64_t square = 0;
    for (int k = 0; k < 3; k++) {
        w[k] = down > 0 ? (v[k] + ((int64_t)1 << (down - 1))) >> down : v[k] * ((int64_t)1 << -down);
        square += (uint64_t)(w[k] * w[k]);  // at most 3 * 2^62
    }
    const int64_t length = root_of(square);
    for (int k = 0; k < 3; k++) {
        row[k] = (int32_t)divide_nearest(w[k] * CANOPY_AXIS_ONE, length);
    }
    return true;
}

// u and height to v = height x u: within half a unit of orthogonal to both.
static void complete(int32_t axes[3][3]) {
    for (int k = 0; k < 3; k++) {
        const int p = (k + 1) % 3, q = (k + 2) % 3;
        const int64_t product = (int64_t)axes[2][p] * axes[0][q] - (int64_t)axes[2][q] * axes[0][p];
        axes[1][k] = (int32_t)((product + CANOPY_AXIS_ONE / 2) >> 30);
    }
}

#define NINE_TENTHS 966367642  // of 2^30, rounded up

enum canopy_status canopy_axes_from_direction_fx(const int32_t direction[3], int32_t axes[3][3]) {
    const int64_t d[3] = {direction[0], direction[1], direction[2]};
    if (!normalise(d, axes[2])) {
        return CANOPY_ARGUMENT;
    }
    const int32_t *height = axes[2];
    const int start = height[0] >= NINE_TENTHS || height[0] <= -NINE_TENTHS ? 1 : 0;
    int64_t across[3];  // at least 0.43 long: what rounding did to the height axis, it does 2.3 times to this one
    for (int k = 0; k < 3; k++) {
        across[k] = (k == start ? (int64_t)1 << 60 : 0) - (int64_t)height[start] * height[k];
    }
    (void)normalise(across, axes[0]);
    complete(axes);
    return CANOPY_OK;
}

// The cross product of two vectors of 33 bits and a sign, exactly: up to 2^66, as high * 2^16 + low.
static void cross(const int64_t a[3], const int64_t b[3], int64_t high[3], int64_t low[3]) {
    for (int k = 0; k < 3; k++) {
        const int p = (k + 1) % 3, q = (k + 2) % 3;
        high[k] = a[p] * (b[q] >> 16) - a[q] * (b[p] >> 16);
        low[k] = a[p] * (b[q] & 0xFFFF) - a[q] * (b[p] & 0xFFFF);
        high[k] += low[k] >> 16;
        low[k] &= 0xFFFF;
    }
}

// The direction of the cross product: of all its bits while they fit, of all but the last 16 where it is larger.
static bool normal_of(const int64_t a[3], const int64_t b[3], int32_t row[3]) {
    int64_t high[3], low[3];
    uint64_t most = 0;
    cross(a, b, high, low);
    for (int k = 0; k < 3; k++) {
        most = size_of(high[k]) > most ? size_of(high[k]) : most;
    }
    for (int k = 0; k < 3 && most < (uint64_t)1 << 45; k++) {
        high[k] = high[k] * 65536 + low[k];
    }
    return normalise(high, row);
}

enum canopy_status canopy_axes_from_points_fx(const int32_t points[3][3], int32_t axes[3][3]) {
    int64_t along[3], beside[3];
    for (int k = 0; k < 3; k++) {
        along[k] = (int64_t)points[1][k] - points[0][k];
        beside[k] = (int64_t)points[2][k] - points[0][k];
    }
    if (!normal_of(along, beside, axes[2])) {
        return CANOPY_ARGUMENT;
    }
    (void)normalise(along, axes[0]);  // not 0, or the normal were
    complete(axes);
    return CANOPY_OK;
}

// |a . b - expected * 2^30| <= tolerance, all in units of 2^-30 but the products, which have 60 bits.
static bool is_product(const int32_t a[3], const int32_t b[3], int64_t expected, int64_t tolerance) {
    int64_t sum = -expected * CANOPY_AXIS_ONE;
    for (int k = 0; k < 3; k++) {
        sum += (int64_t)a[k] * b[k];
    }
    return sum <= tolerance * CANOPY_AXIS_ONE && sum >= -tolerance * CANOPY_AXIS_ONE;
}

static bool is_unit(int32_t x) { return x >= -CANOPY_AXIS_ONE - 1024 && x <= CANOPY_AXIS_ONE + 1024; }

bool canopy_axes_are_sound(const int32_t axes[3][3]) {
    for (int i = 0; i < 9; i++) {
        if (!is_unit(axes[i / 3][i % 3])) {
            return false;  // and nothing below overflows
        }
    }
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j <= i; j++) {
            if (!is_product(axes[i], axes[j], i == j ? CANOPY_AXIS_ONE : 0, CANOPY_AXES_TOLERANCE)) {
                return false;
            }
        }
    }
    int32_t turned[3][3];
    memcpy(turned, axes, sizeof turned);
    complete(turned);
    return is_product(turned[1], axes[1], CANOPY_AXIS_ONE, CANOPY_AXIS_ONE / 2);  // not -1: left-handed
}

bool canopy_axes_are_straight(const int32_t axes[3][3]) {
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            if (axes[i][k] != (i == k ? CANOPY_AXIS_ONE : 0)) {
                return false;
            }
        }
    }
    return true;
}
