/// Questions to a published surface: height, slope and normal at a place; and what the other questions have in common.
///
///     query_extreme.h  the guaranteed highest or lowest over a window; clearance of two surfaces, or to a plane
///     query_volume.h   the volume over a window, above a height, a plane or another surface
///     query_regrid.h   the same surface on a finer or coarser grid, on the safe side
///
/// Heights and coefficients are whole steps in both scalars, and so is everything here: one integer code, with directed
/// rounding, answers for both. Nothing allocates, nothing depends on how the surface was fitted, and nothing is
/// changed. Coefficients must stand within +- CANOPY_COEFFICIENT_LIMIT, as those of every published envelope do; where
/// a call looks at them anyway, it says CANOPY_RANGE if they do not.
///
/// What is said is said of the *surface* in the envelope. That the surface is on the safe side of the points, its
/// certificate says, and only where the envelope is covered.
#ifndef CANOPY_COVER_QUERY_H
#define CANOPY_COVER_QUERY_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/cover/envelope.h"
#include "lib/status.h"

// ---- At a place

/// How far the gradient may be from the true one, in steps a knot interval, either way. See query.c.
#define CANOPY_QUERY_GRADIENT_ERROR 16

struct canopy_query_point {
    int32_t low, high;    ///< bounds of the height in steps, as canopy_envelope_height has them
    int32_t gradient[2];  ///< of the height by u and by v in steps a knot interval, +- CANOPY_QUERY_GRADIENT_ERROR
    int32_t normal[3];    ///< unit vector along the frame's axes, away from the ground, Q30; see below
    bool covered;         ///< the knot cell has data
};

/// Everything about the surface at (u, v), quanta from the frame's origin along its axes.
///
/// The normal is that of the true lengths (pitch and step). Its direction is that of (-dh/du, -dh/dv, 1); it is off by
/// less than 2^-27 plus what the gradient's error turns it by, which is CANOPY_QUERY_GRADIENT_ERROR steps over a pitch
/// in each direction, as an angle. Where a slope is beyond 2^30 or the reverse, the small component reads 0.
/// CANOPY_OUT_OF_FRAME: beside the frame; *answer is unchanged. 3,500 instructions on a Cortex-M3, of which
/// canopy_envelope_height alone takes 700.
enum canopy_status canopy_query_at(const struct canopy_envelope *envelope, uint32_t u, uint32_t v,
                                   struct canopy_query_point *answer);

// ---- What the other questions are about

/// A part of the frame, corners included, in quanta from the origin along its axes. It may be a line or a point.
struct canopy_query_rect {
    uint32_t low[2], high[2];
};

/// The whole frame.
struct canopy_query_rect canopy_query_whole(const struct canopy_frame *frame);

/// A plane over the frame: steps at (u, v) = (0, 0), and rise a knot interval in u and in v, each times 2^16.
struct canopy_query_plane {
    int64_t at_origin, rise[2];
};

#define CANOPY_QUERY_PLANE_ONE ((int64_t)1 << 16)
#define CANOPY_QUERY_PLANE_LIMIT (1 << 28)  ///< the plane stands within +- this many steps over the frame

/// The function that is asked about: surface - minus - plane. With `covered`, only over the knot cells that are covered
/// by data, in both surfaces if there are two. The envelopes must not change while a question is being answered.
struct canopy_query_subject {
    const struct canopy_envelope *surface;
    const struct canopy_envelope *minus;     ///< of the same frame, side and cells aside; NULL: none
    const struct canopy_query_plane *plane;  ///< NULL: none
    bool covered;
};

/// In what the frames of two envelopes differ. The side and the field's cells do not matter here: two sides of a scene,
/// and fits from fields of two resolutions, can be compared.
enum canopy_difference canopy_query_difference(const struct canopy_envelope *a, const struct canopy_envelope *b);

/// CANOPY_ARGUMENT: the frames differ (canopy_query_difference says in what), or the window's corners are in the wrong
/// order; CANOPY_OUT_OF_FRAME: the window reaches beyond the frame; CANOPY_RANGE: the plane leaves its limit.
enum canopy_status canopy_query_check(const struct canopy_query_subject *subject, const struct canopy_query_rect *rect);

/// Whether the subject counts knot cell (row, column).
bool canopy_query_counts(const struct canopy_query_subject *subject, uint32_t row, uint32_t column);

// ---- Coverage of two envelopes of one frame

struct canopy_query_coverage {
    uint32_t gained, lost, kept;  ///< knot cells covered after but not before, before but not after, in both
};

/// What two times of one scene have seen. CANOPY_ARGUMENT: the frames differ; *answer is unchanged.
enum canopy_status canopy_query_coverage(const struct canopy_envelope *before, const struct canopy_envelope *after,
                                         struct canopy_query_coverage *answer);

/// Guaranteed bounds of the subject over one knot cell, in steps: its least and largest Bernstein coefficient, rounded
/// outward, whether the cell counts or not. For subject {after, before}, how much the surface has risen (positive) or
/// fallen there. 1,600 instructions on a Cortex-M3. The subject must have passed canopy_query_check; a coefficient
/// beyond its limit is CANOPY_RANGE.
enum canopy_status canopy_query_cell(const struct canopy_query_subject *subject, uint32_t row, uint32_t column,
                                     int32_t *low, int32_t *high);

#endif
