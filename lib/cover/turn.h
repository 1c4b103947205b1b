/// Points and frames in axes of any direction.
///
/// q = axes (p - origin), with the frame's integers, is what a surrogate means; here it is made with every error on the
/// safe side.
///
///   fixed point   q * 2^30 is a whole number and is made exactly: rows of a rotation and coordinates of 32 bits keep
///                 every partial sum of axes p - axes origin below 1.7321 * 2^62 (Cauchy-Schwarz), so 64 bits hold it.
///                 Cell edges are whole quanta: the cell is exact. Only the height is rounded, up, to whole steps.
///   float         u and v are intervals and the height is the upper end of one; CANOPY_TURN_ERROR_F32 derives how
///   wide.
///
/// A reading's uncertainty is a box in device axes, +- its half-widths; in the frame's axes that is within a box with
/// half-widths sum |axis| * uncertainty, and every cell the box meets is raised to the top of it (cover.md 5). So the
/// height uncertainty of a scanner that looks askew becomes, in part, one of the place.
///
/// For the side below, heights are mirrored as everywhere in the library.
///
/// Cost of a point without uncertainty on a Cortex-M3, fixed point: docs/numbers.md.
#ifndef CANOPY_COVER_TURN_H
#define CANOPY_COVER_TURN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/cover/axes.h"
#include "lib/cover/field.h"
#include "lib/cover/frame.h"
#include "lib/inline.h"
#include "lib/status.h"

#define CANOPY_TURN_UNCERTAINTY_MAX (1U << 28)  ///< quanta: with that no sum overflows

// ---------------------------------------------------------------------------------------------------------------------
// Fixed point

/// A frame made ready to turn points into. Members are its own, but `axis`.
struct canopy_turn_fx {
    int32_t axis[3][3];  ///< the frame's; the height axis mirrored for the side below
    int64_t start[3];    // - axes origin
    int64_t top;         // what makes the shift to steps one that rounds up
    uint64_t limit[2];   // the far edges, times 2^30
    uint32_t reach;      // within +- reach * 2^32 heights are ordinary: their steps fit. 0: none is
    uint8_t shift;       // from heights times 2^30 to steps
};

/// CANOPY_ARGUMENT: the axes are not sound (canopy_axes_are_sound), the quantum is not a device unit, or a step is
/// finer than 2^-30 or coarser than 2^10 quanta, which canopy_frame_around_* never makes. CANOPY_RANGE: the frame is
/// turned and 2^32 quanta wide, or wider. *turn is then unchanged.
enum canopy_status canopy_turn_init_fx(struct canopy_turn_fx *turn, const struct canopy_frame *frame);

/// q * 2^30, exactly, of any point: u and v from the frame's origin, and the height (mirrored for the side below).
CANOPY_INLINE void canopy_turn_point_fx(const struct canopy_turn_fx *turn, const int32_t point[3], int64_t q[3]) {
    for (int i = 0; i < 3; i++) {
        const int32_t *axis = turn->axis[i];
        q[i] = turn->start[i] + (int64_t)axis[0] * point[0] + (int64_t)axis[1] * point[1] + (int64_t)axis[2] * point[2];
    }
}

/// Whether a turned point is inside the frame, its edges included: exactly.
static inline bool canopy_turn_is_inside_fx(const struct canopy_turn_fx *turn, const int64_t q[3]) {
    return (uint64_t)q[0] <= turn->limit[0] && (uint64_t)q[1] <= turn->limit[1];
}

/// The box in which a reading is: q +- sum |axis| * uncertainty, exactly. uncertainty: half-widths along the device's
/// axes, quanta. CANOPY_RANGE: one is over CANOPY_TURN_UNCERTAINTY_MAX; *box is unchanged.
enum canopy_status canopy_turn_box_fx(const struct canopy_turn_fx *turn, const int64_t q[3],
                                      const uint32_t uncertainty[3], struct canopy_field_box_fx *box);

/// Takes one point without uncertainty, as canopy_field_insert_fx does for axes x, y, z, and with the same statuses:
/// inside or outside is exact, the height is rounded up. `turn` was made from the field's frame.
enum canopy_status canopy_turn_insert_fx(struct canopy_field *field, const struct canopy_turn_fx *turn,
                                         const int32_t point[3], struct canopy_field_hit *hit);

/// Takes `count` points without uncertainty; returns how many of them were refused.
size_t canopy_turn_feed_fx(struct canopy_field *field, const struct canopy_turn_fx *turn, const int32_t (*points)[3],
                           size_t count);

/// The box of a cloud in turned axes, a point at a time: axes p * 2^30, exactly.
struct canopy_turned_box_fx {
    int64_t low[3], high[3];
};

/// Nothing yet: low above high.
void canopy_turned_box_begin_fx(struct canopy_turned_box_fx *box);
void canopy_turned_box_add_fx(struct canopy_turned_box_fx *box, const int32_t axes[3][3], const int32_t point[3]);

/// A small frame with these axes that holds every point of the box, exactly: 0 <= u <= m - 1, 0 <= v <= n - 1. The
/// origin is a point of whole device units; with axes that are not along the coordinates it stands up to sqrt(3) units
/// beside the box's corner, so that a side is at most that and the pitch's rounding longer than it must be. With axes
/// x, y and z it is canopy_frame_around_fx. CANOPY_ARGUMENT: the grid is out of range, the box is empty, the axes are
/// not sound. CANOPY_RANGE: a corner of the box is beyond 32 bits although its points are not, or the frame is 2^32
/// units wide or high. *frame is then unchanged.
enum canopy_status canopy_frame_around_turned_fx(struct canopy_frame *frame, const struct canopy_grid *grid,
                                                 const int32_t axes[3][3], const struct canopy_turned_box_fx *box);

// ---------------------------------------------------------------------------------------------------------------------
// Float

/// q as computed is within CANOPY_TURN_ERROR_F32 * g + CANOPY_TURN_LEAST_F32 of the true one, and so are the ends of
/// the interval q +- that, rounded; g = |d0| + |d1| + |d2| as computed, d = p - origin.
///
/// With e = 2^-24: an axis' component as a float is a (1 + e1), a difference d (1 + e2), their product rounds, and so
/// do two sums: five factors (1 + e) on each of the three terms, |a| <= 1 + 2^-20: 5.0001 e g. q +- E rounds once more,
/// |q| + E <= 1.0001 g: 1.0002 e g. g as computed is at least (1 - e)^3 of the true one and E has two roundings itself.
/// Together less than 6.01 e g; 7 e leaves room. What underflows loses less than 2^-126 in each of ten operations, even
/// where a chip flushes subnormal numbers to zero.
#define CANOPY_TURN_ERROR_F32 (7 * 0x1p-24f)
#define CANOPY_TURN_LEAST_F32 0x1p-120f

/// A float frame made ready. Members are its own.
struct canopy_turn_f32 {
    float axis[3][3], origin[3];
    bool straight;  // axes x, y, z: nothing is rounded, and u and v are the coordinates themselves
};

/// CANOPY_ARGUMENT: the axes are not sound, or the frame is turned and its origin or its width needs more than 24 bits
/// (canopy_frame_around_turned_f32 makes none such); *turn is unchanged.
enum canopy_status canopy_turn_init_f32(struct canopy_turn_f32 *turn, const struct canopy_frame *frame);

/// The box in which a reading is for sure: device units along the frame's axes, as canopy_field_insert_box_f32 takes
/// them. uncertainty: half-widths along the device's axes, not negative; NULL: none. What is not finite gives a box
/// that a field refuses.
void canopy_turn_box_f32(const struct canopy_turn_f32 *turn, const float point[3], const float uncertainty[3],
                         struct canopy_field_box_f32 *box);

/// Takes `count` points without uncertainty; returns how many of them were refused. A point that is not inside the
/// frame for sure is one of them, and so is one whose error spans more cells than a box may (a point very far away).
size_t canopy_turn_feed_f32(struct canopy_field *field, const struct canopy_turn_f32 *turn, const float (*points)[3],
                            size_t count);

/// The box of a cloud in turned axes: points are measured from the first one, so that what rounding loses is in
/// proportion to the cloud's extent, not to its distance from zero. The cloud is within `low` and `high` for sure.
struct canopy_turned_box_f32 {
    float anchor[3], low[3], high[3];
    bool any, bad;
};

void canopy_turned_box_begin_f32(struct canopy_turned_box_f32 *box);

/// A point that is not finite makes the box one that no frame holds.
void canopy_turned_box_add_f32(struct canopy_turned_box_f32 *box, const int32_t axes[3][3], const float point[3]);

/// A small frame with these axes that holds every point of the box for sure, in exact arithmetic and as
/// canopy_turn_box_f32 sees them: the box, grown by twice the error of a point at its far corner and the rounding of
/// the origin to whole quanta. The quantum is the smallest power of two for which the origin's coordinates and the
/// width have at most 24 bits.
/// CANOPY_ARGUMENT: the grid is out of range, the box is empty or not finite, a corner is beyond
/// +- CANOPY_FRAME_F32_MAX / 4, or the axes are not sound. *frame is then unchanged.
enum canopy_status canopy_frame_around_turned_f32(struct canopy_frame *frame, const struct canopy_grid *grid,
                                                  const int32_t axes[3][3], const struct canopy_turned_box_f32 *box);

#endif
