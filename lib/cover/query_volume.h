/// The volume between a surface and a plane, or between two surfaces, over a window: exact, but for one rounding where
/// the window's edge crosses a knot cell.
///
/// Over a rectangle a bicubic patch has the mean of its 16 Bernstein coefficients. Over a whole knot cell those are
/// exact integers of 1/36 step, so the sum over whole cells is exact: the same as sum b[i][j] w(i) w(j) with the
/// integrals 1, 11, 11 and 1 of 24ths of the four B-splines in a knot interval. Where the window cuts a cell, the mean
/// is known to 3 units of 1/36 step along each axis, and to what the slope makes of an edge moved outward by 2^-26 of a
/// knot interval; the area is exact.
///
/// The volume is signed: where the subject is negative it counts as such. For the volume above a height z, the plane is
/// {z, {0, 0}} in 2^-16 steps. Between two times of one scene, subject {after, before}, it is what was added less what
/// was taken away.
///
/// Overflow: none. A window has less than 2^64 quanta^2 and the subject less than 2^30 steps: with the 576, 104 of the
/// 128 bits that a sum has.
#ifndef CANOPY_COVER_QUERY_VOLUME_H
#define CANOPY_COVER_QUERY_VOLUME_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/cover/query.h"
#include "lib/cover/query_patch.h"

/// A sum of 128 bits.
struct canopy_volume_sum {
    uint64_t low;
    int64_t high;
};

struct canopy_volume {
    struct canopy_query_subject subject;
    struct canopy_query_rect rect;
    struct canopy_patch_span span[2];
    uint32_t next[2];                    // the knot cell to be added; row beyond the window: all have been
    struct canopy_volume_sum low, high;  // quanta^2 * steps / 576
    uint64_t area;                       ///< quanta^2 that counted so far, exact …
    uint32_t cells;                      ///< … and the knot cells that they are in
};

/// low * 2^exponent <= volume <= high * 2^exponent, in device units^3; rounding to this form is outward and costs less
/// than 2^-59 of the larger one. Where a whole number of device units^3 is wanted, see canopy_volume_whole.
struct canopy_volume_answer {
    int64_t low, high;
    int16_t exponent;
};

/// Begins. Errors as canopy_query_check has them; *volume is then of no use.
enum canopy_status canopy_volume_begin(struct canopy_volume *volume, const struct canopy_query_subject *subject,
                                       const struct canopy_query_rect *rect);

/// Adds up to `budget` knot cells: about 1,300 instructions each on a Cortex-M3, 4,000 at the window's edge.
/// CANOPY_MORE; CANOPY_OK: all are added; CANOPY_RANGE: a coefficient is beyond its limit. A window without area, and
/// one in which no cell counts, have volume 0; `cells` tells.
enum canopy_status canopy_volume_step(struct canopy_volume *volume, uint32_t budget);

/// What has been added up so far.
struct canopy_volume_answer canopy_volume_answer(const struct canopy_volume *volume);

/// In whole device units^3, rounded outward. CANOPY_RANGE: beyond 2^63; nothing is changed.
enum canopy_status canopy_volume_whole(const struct canopy_volume_answer *answer, int64_t *low, int64_t *high);

#endif
