/// What the files of the exact verdict share, and why it may be believed. Nobody else includes this.
///
///     exact_table.c   a surrogate to its table of cells
///     exact_block.c   points to cells and local parameters: which are inside
///     exact_height.c  those to heights of the surface and what rounding may have done to them
///     exact.c         heights to verdicts
#ifndef CANOPY_TOOLS_COMMON_EXACT_PARTS_H
#define CANOPY_TOOLS_COMMON_EXACT_PARTS_H

// The error bound. Let e = 2^-53, B = lsb * the largest |coefficient| that reaches the point's knot cell or one of its
// eight neighbours, and g_n = n e / (1 - n e).
//
// Table. Along one direction the power-basis coefficients of 6 N are whole combinations of four b's with absolute
// weight sums 6 W, W = (1, 1, 2, 4/3), at most 4 roundings each; twice, then times fl(lsb / 36): each c_kl is within
// g_11 W_k W_l B. Horner in s, then in t, s and t in [0, 1]: at most 12 roundings on any path. Together g_23 (1 + 1 + 2
// + 4/3)^2 B < 656 e B.
//
// Argument, axes along the coordinates. d = fl(p - o) has one rounding, 1/pitch one, their product one: u is off by at
// most 3.001 e (m - 1); clamping into [0, m-1] does not move it away from a true u inside. (s = u - cell is exact.) A
// slope of S is a convex combination of differences of neighbouring coefficients, so at most 2 B, in this cell and the
// next, where u may truly be. Both directions: 6.01 e (m + n - 2) B.
//
// Height and difference. w = fl(p - o) is off by e |w| (1 + e); fl(S - w) and the last subtraction of the slack add at
// most 2 e (B (1 + ...) + |w|) each ... all in all the slack
//
//     SLACK_BASE e B + SLACK_SIZE e (m + n) B + 2^-51 |w| + 2^-800,   SLACK_BASE = 720, SLACK_SIZE = 8
//
// leaves room for the roundings of the slack itself. 2^-800 covers underflow: see `is_ordinary`.
//
// Other axes: each q = a . d has error at most 4.01 e g with g = |d0| + |d1| + |d2| (|a| <= 1 + 1e-6), so u is off by
// at most 6.1 e g / pitch, and the slack is SLACK_BASE e B + e g (16 B (1/pu + 1/pv) + 8) + 2^-800.
//
// Windows: level k, coefficients at most B' in height. u = cell + s rounds once more, so it is off by 4.001 e (m - 1),
// with other axes by 6.1 e g / pitch beside; 2^k u is exact and x = 2^k u - i0 adds e |x|. The slope by x is a convex
// combination of differences of neighbours, zeros outside among them: at most 2 B', also across the window's edge.
// With k <= 2 that makes e B' (32.01 (m + n - 2) + 48.8 g (1/pu + 1/pv) + 2 (|x| + |y|)). Each weight is off by less
// than 6 e (its intermediate results are at most 6, and it is a sixth of them), the four of an axis by less than 16 e;
// 16 products and their sum take 20 roundings: below 60 e B'. Adding the windows up and to S: (2 + count) e sum B'. The
// slack takes 800 + 4 count + 8 (4.1 (m + n) + 6.2 g (1/pu + 1/pv)) + 4 (|x| + |y|), all times e sum B'.
//
// Points that this leaves open (margin within the slack, frame edge in doubt) go to rational.c.

#include <float.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "tools/common/exact.h"
#include "tools/common/rational.h"

#if FLT_EVAL_METHOD != 0 || defined(__FAST_MATH__)
#error "The error bound needs IEEE double arithmetic: no x87, no -ffast-math."
#endif

#define CANOPY_EXACT_BLOCK 256
#define CANOPY_EXACT_EPSILON 0x1p-53  // e

/// Two doubles that the compiler keeps in one register.
typedef double canopy_pair __attribute__((vector_size(16)));

/// Power-basis coefficients of one knot cell in height units, sign turned so that bigger is safer:
/// S(s, t) = sum_k s^k (c[k][0] + c[k][1] t + c[k][2] t^2 + c[k][3] t^3), a row as two pairs.
struct canopy_exact_cell {
    canopy_pair c[4][2];
};

struct canopy_exact {
    const struct canopy_surrogate *surrogate;
    struct canopy_rational *rational;
    struct canopy_exact_cell *cells;
    double *slack;      ///< a cell: what of the slack does not depend on the point
    double *reach;      ///< a cell: B
    bool ordinary;      ///< magnitudes are such that the bound holds; otherwise every point goes to GMP
    bool aligned;       ///< each axis is plus or minus a coordinate axis
    int coordinate[3];  ///< then: which
    double sign[3];     ///< and its sign
    double inverse[2];  ///< 1 / pitch
    double limit[2];    ///< (m-1) pitch rounded
    bool limit_exact[2];
    double windows_reach;
};

/// A block on its way through the stages.
struct canopy_exact_block {
    double q[3][CANOPY_EXACT_BLOCK];  ///< along the axes; q[2] with the side's sign
    double g[CANOPY_EXACT_BLOCK];     ///< |d0| + |d1| + |d2|, for axes of any direction
    double s[CANOPY_EXACT_BLOCK];
    double t[CANOPY_EXACT_BLOCK];
    int32_t hu[CANOPY_EXACT_BLOCK];
    int32_t hv[CANOPY_EXACT_BLOCK];
    double surface[CANOPY_EXACT_BLOCK];
    double slack[CANOPY_EXACT_BLOCK];
    uint32_t origin[CANOPY_EXACT_BLOCK];  ///< index within the block as it was loaded
    size_t count;
};

static inline int canopy_exact_clamp(int i, int limit) { return i < 0 ? 0 : i < limit ? i : limit - 1; }

static inline double canopy_exact_coordinate(const struct canopy_cloud *cloud, int k, size_t index) {
    const size_t at = index * cloud->stride;
    return cloud->scalar == CANOPY_F32 ? (double)((const float *)cloud->axis[k])[at]
                                       : (double)((const int32_t *)cloud->axis[k])[at];
}

static inline void canopy_exact_point(const struct canopy_cloud *cloud, size_t index, double point[3]) {
    for (int k = 0; k < 3; k++) {
        point[k] = canopy_exact_coordinate(cloud, k, index);
    }
}

/// Whether p - o has no rounding error. With |p| >= |o| the difference p - d is exact (Dekker 1971), so comparing it
/// with o tells; with |p| < |o| the same holds of o + d and p.
static inline bool canopy_exact_subtracts(double p, double o) {
    const double d = p - o;
    return d + o == p && p - d == o;
}

/// Loads a whole block of memory from point `first` on, of which b->count points are meant, and finds their cells.
/// Points outside land in some cell. Loops run over CANOPY_EXACT_BLOCK, a constant, so that compilers make vectors of
/// them; what lies behind `count` is not counted.
void canopy_exact_load(const struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first,
                       struct canopy_exact_block *b);

/// Counts in `result` which of them are outside, and moves the rest together. `before`: points of earlier calls.
void canopy_exact_keep_inside(const struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first,
                              uint64_t before, struct canopy_exact_block *b, struct canopy_exact_result *result);

/// b->surface, windows included, and the part of b->slack that axes along the coordinates need.
void canopy_exact_evaluate(const struct canopy_exact *e, struct canopy_exact_block *b);

/// Adds the point's share of the slack with axes of any direction.
void canopy_exact_add_turned_slack(const struct canopy_exact *e, struct canopy_exact_block *b);

#endif
