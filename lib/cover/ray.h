/// The first hit of a ray with an envelope, missing nothing, and whether a segment is surely free.
///
/// A ray is a straight line u(t), v(t), r(t) in the frame: along u and v, and its height. It is *free* at t where it is
/// on the side of the surface that holds no data: above an envelope above, below an envelope below. The answer is the
/// first t from which on that is not proved:
///
/// - Up to the hit the ray is free, exactly: no rounding of this library is on the other side. A ray that is reported
///   free is free all along. This is the safe side: a ray that touches, or comes so close that the error bound cannot
///   tell, is a hit, and a hit is never behind the true one.
/// - The hit is not long before the true one either. Let M be the largest minus the smallest of the 16 coefficients
///   around the hit's cell, and D what the ray's height changes by over one knot interval of its way. What is left
///   between the ray and the surface at a settled hit is less than 6 * 2^-23 (M + D) + 2^-5 steps; of a million random
///   and adversarial rays none had more than 1.6 * 2^-23 (M + D). In the local parameter that is as much over the
///   slope. `settled` is false for a hit in whose search the steps ran out: a touch of high order, one of 300,000.
///   A hit where the ray comes into a cell may be a touch just behind.
///
/// Method. Per knot cell in the order of the ray, S(u(t), v(t)) - r(t) is a polynomial of degree 6 in the local
/// parameter of the piece within the cell. Its Bernstein coefficients are convex combinations of the 16 coefficients
/// around the cell: the patch's Bezier points over the box of the piece (values of the blossom, B-splines' weights that
/// are not negative and sum to one), combined along the diagonal. The first zero is found by lib/spline/roots.h. Both
/// scalars become the same integers first (struct canopy_ray_line), so there is one algorithm and one proof. Positions
/// are carried as cell and local part: a global t would lose digits.
///
/// Error bound of a Bernstein coefficient, M the largest minus the smallest of the cell's 16 coefficients. Weights are
/// Q30, off by less than 1.4, 2.2, 4.9 and 1.4 units and sum to one exactly: 4.9 * 2^-30 M a direction. The local
/// ends are off by up to 1.5 * 2^-30 in u and in v, where the slope is at most M: 3 * 2^-30 M. Floors: 7 units of the
/// scaled integers, in which M is between 2^28 and 2^29. A line that was rounded, or whose crossings were, is off by
/// sigma knots: M sigma, and 2^29 sigma^2 for what the slope changes by. All of it is subtracted before the zero is
/// searched for; for an exact line it is about 2^-24.6 M. The search ends where p is below 2^-23 of its largest
/// coefficient and 16 units, and its floors have lost at most CANOPY_ROOT_LOSS: with the bound, twice, that is the 6.
///
/// Cost: at most m + n - 3 cells. A cell whose 16 coefficients are all below the piece costs a look at them; another
/// costs about 130 products, and a root at most CANOPY_ROOT_STEPS splits of 21 products. No memory but the stack: below
/// 1.5 KB on a Cortex-M3, where the code takes 10 KB. Numbers: docs/queries.md.
#ifndef CANOPY_COVER_RAY_H
#define CANOPY_COVER_RAY_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/cover/envelope.h"
#include "lib/cover/line.h"
#include "lib/spline/roots.h"
#include "lib/spline/surface.h"
#include "lib/status.h"

#define CANOPY_RAY_ERROR_LOG2 -21      ///< 4 ulp of a float: see above
#define CANOPY_RAY_SIZE_MAX 16384      ///< largest m and n
#define CANOPY_RAY_FX_MAX (1LL << 36)  ///< the farthest start of a fixed-point ray, quanta from the frame's origin

/// What became of a ray.
enum canopy_ray_outcome {
    CANOPY_RAY_FREE = 0,      ///< it crosses or enters the frame and is free all along
    CANOPY_RAY_BESIDE,        ///< it never enters the frame, about which alone the envelope speaks
    CANOPY_RAY_HIT,           ///< free up to the hit
    CANOPY_RAY_STARTS_UNDER,  ///< it starts in the frame, not free (or too close to tell): the hit is its start
    CANOPY_RAY_ENTERS_UNDER,  ///< it comes into the frame through its side, and is not free there: the hit is there
    CANOPY_RAY_NO_DIRECTION,  ///< a ray with a direction of 0, 0, 0 (a segment may be a point)
    CANOPY_RAY_NOT_FINITE,    ///< a coordinate is NaN or infinite
    CANOPY_RAY_TOO_FAR,       ///< it starts too far away for its place in the frame to be known: see the lines below
    CANOPY_RAY_BAD_ENVELOPE   ///< a coefficient is beyond CANOPY_COEFFICIENT_LIMIT, or the size out of range
};

struct canopy_ray_hit {
    uint8_t outcome;               ///< enum canopy_ray_outcome; the rest but `cells` and `steps` is for hits only
    bool covered;                  ///< the hit's knot cell holds data; false: the surface is only a continuation there
    bool settled;                  ///< the hit is as near to the true one as stated
    uint8_t steps;                 ///< the most root-finder steps in one cell
    uint16_t cells;                ///< knot cells looked at
    struct canopy_place place[2];  ///< cell and local part along u and v
    int32_t height;                ///< of the ray there, steps (rounded down); as in the envelope, not mirrored
    int32_t gradient[2];           ///< of the surface there, steps a knot interval
    uint64_t t;                    ///< t * 2^t_log2 times `along` from the start; a segment's end is at 1
    int16_t t_log2;
};

/// A line in integers: what both scalars become, and what a program with coordinates of its own makes. From `from` on;
/// lateral units are such that the frame is `width` wide, from 0; a unit of height is 2^height_log2 steps above the
/// frame's origin.
///
/// |from|, |to| < 2^42, width 1 to 2^40, height_log2 -10 to 18. The finer the better: width from 2^39 on makes the
/// rounding of positions vanish against the other errors. A ray that is no segment must go on as canopy_ray_reach says.
struct canopy_ray_line {
    int64_t from[3], to[3];
    int64_t width[2];
    int16_t height_log2;
    int16_t t_log2;   ///< `to` is at t = 2^t_log2
    uint8_t rounded;  ///< the true line's ends are within so many units of these, along each axis; 0: they are exact
};

#define CANOPY_RAY_ROOM 39           ///< keep starts and widths below 2^39 units,
#define CANOPY_RAY_FAST 41           ///< and let the fastest coordinate of a ray run 2^40 to 2^41: out of any frame
#define CANOPY_RAY_NEVER 100000      ///< the log2 of t at which a coordinate that stands still has run so far
#define CANOPY_RAY_HEIGHT_LEAST -10  ///< of height_log2
#define CANOPY_RAY_HEIGHT_MOST 18

/// How far a ray's line must go on: `log2` of its last t. `line` has from, width and height_log2; runs[a] is the log2
/// of the t at which axis a has run 2^CANOPY_RAY_FAST. A ray that starts beside the frame must go on until it has left
/// the frame's columns, however low it is by then: `coarser` says by how many bits the unit of heights must grow for
/// that. It goes on for 2^58 steps at least, 2^34 times the range of the data: what is deeper is not followed.
void canopy_ray_reach(const struct canopy_ray_line *line, const int runs[3], int *log2, int *coarser);

/// Lines from a point in a direction. Coordinates are along the frame's axes from its origin: axes (p - origin).
/// _fx: whole quanta; |from| <= CANOPY_RAY_FX_MAX, else CANOPY_RAY_TOO_FAR.
/// _f32: device units; rounded to 2^-39 of the frame or of the distance, whichever is larger. Beyond 2^39 quanta
/// sideways (2^14 times the largest float at which the frame's edges could be), or 2^55 steps up: CANOPY_RAY_TOO_FAR.
/// The outcome is FREE for a good line, NO_DIRECTION, NOT_FINITE or TOO_FAR.
enum canopy_ray_outcome canopy_ray_line_fx(const struct canopy_frame *frame, const int64_t from[3],
                                           const int32_t along[3], struct canopy_ray_line *line);
enum canopy_ray_outcome canopy_ray_line_f32(const struct canopy_frame *frame, const float from[3], const float along[3],
                                            struct canopy_ray_line *line);

/// Lines from point to point; both may be the same.
enum canopy_ray_outcome canopy_ray_segment_fx(const struct canopy_frame *frame, const int64_t from[3],
                                              const int64_t to[3], struct canopy_ray_line *line);
enum canopy_ray_outcome canopy_ray_segment_f32(const struct canopy_frame *frame, const float from[3], const float to[3],
                                               struct canopy_ray_line *line);

/// The first hit of a line. The envelope's coverage may be NULL: all cells are covered then. CANOPY_ARGUMENT with
/// BAD_ENVELOPE or TOO_FAR (the line's rounding reaches 2^-6 knots or 2^19 steps, or its numbers are out of range),
/// else CANOPY_OK.
enum canopy_status canopy_ray_cast(const struct canopy_envelope *envelope, const struct canopy_ray_line *line,
                                   struct canopy_ray_hit *hit);

/// Both in one, of a ray. CANOPY_OK, or CANOPY_ARGUMENT: hit->outcome says what is wrong.
enum canopy_status canopy_ray_first_fx(const struct canopy_envelope *envelope, const int64_t from[3],
                                       const int32_t along[3], struct canopy_ray_hit *hit);
enum canopy_status canopy_ray_first_f32(const struct canopy_envelope *envelope, const float from[3],
                                        const float along[3], struct canopy_ray_hit *hit);

/// Conservative occlusion: whether every point of the segment is surely free, or outside the frame. False: perhaps
/// occluded, and also for anything that is no segment; *hit (may be NULL) says where or why.
bool canopy_ray_is_free_fx(const struct canopy_envelope *envelope, const int64_t from[3], const int64_t to[3],
                           struct canopy_ray_hit *hit);
bool canopy_ray_is_free_f32(const struct canopy_envelope *envelope, const float from[3], const float to[3],
                            struct canopy_ray_hit *hit);

/// Whether there is a hit.
static inline bool canopy_ray_is_hit(const struct canopy_ray_hit *hit) {
    return hit->outcome >= CANOPY_RAY_HIT && hit->outcome <= CANOPY_RAY_ENTERS_UNDER;
}

/// The hit's t as a float: the nearest there is, which may be behind it.
float canopy_ray_t_f32(const struct canopy_ray_hit *hit);

/// The surface's unit normal at a hit, along the frame's axes, on the side that is free (up for above).
void canopy_ray_normal_f32(const struct canopy_frame *frame, const struct canopy_ray_hit *hit, float normal[3]);

#endif
