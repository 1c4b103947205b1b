/// Coefficients that nothing covered can see, and what they are set to.
///
/// Two kinds of freedom must be told apart (cover.md 2). A *row* of a line's system without a node is free in the
/// solve: its second difference is zero (line.h), but its coefficient still shapes covered cells. A *coefficient* is
/// free only if none of the 4 x 4 knot cells of its support is covered. Only such a one may be set at will: the surface
/// over every covered cell, its bound and its certificate do not know it.
///
/// What a user wants of it is a surface that goes on smoothly over a hole and beyond a silhouette, and no wild values.
/// Three rules, each from the result of the one before:
///
///   nearest    the value of the nearest coefficient of the column that is seen; columns without one: of the nearest
///              column. Holes have a seam in the middle, silhouettes are drawn out along u.
///   straight   second differences vanish: along u and v together, D_u + D_v = 0, the ends repeated as everywhere. In
///              one direction that is the paper's free break-point: a straight line across a gap, a constant beyond the
///              last datum. It makes every free coefficient the mean of its neighbours, so none is higher or lower than
///              what is around it. The method's own choice.
///   bent       least bending energy, sum of D_u^2 + 2 D_uv^2 + D_v^2: slopes go on into holes. Beyond a silhouette,
///              where slopes are steep, they go on too, up to the reach.
///
/// The *reach*, for all three and at any time: no free coefficient is lower than the lowest that is seen, or higher
/// than the highest. Straight and bent are found by relaxation (successive over-relaxation, projected on the reach),
/// which can stop after any step. It ends by itself when no coefficient moves by more than 2^-10 (bent: 2^-16) of the
/// reach's width, or after CANOPY_FREE_SWEEPS (bent: CANOPY_FREE_BENT_SWEEPS) sweeps over the grid. Straight, a hole 16
/// coefficients wide is then filled to half a per cent of the reach, one of 64 to 5 %; wider ones keep more of the
/// seam.
///
///     canopy_free_see(size, envelope.coverage, seen);
///     if (canopy_free_begin(&work, size, seen, coefficients) == CANOPY_OK) {
///         canopy_free_straighten(&work);
///         while (canopy_free_step(&work, 1) == CANOPY_MORE) {}
///     }
#ifndef CANOPY_COVER_FREE_H
#define CANOPY_COVER_FREE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/status.h"

#define CANOPY_FREE_SWEEPS 64
#define CANOPY_FREE_BENT_SWEEPS 4096
#define CANOPY_FREE_UNIT 512  ///< coefficients looked at in a unit of work, or one row if that is longer

/// Bytes of one bit a coefficient, (i, j) at bit i n + j (lib/num/bits.h).
#define CANOPY_FREE_SEEN_BYTES(m, n) (((size_t)(m) * (size_t)(n) + 7U) / 8U)

struct canopy_free;

/// What a coefficient should move by, times its stiffness; `step` receives the step per pull, Q16.
typedef int64_t (*canopy_free_pull)(const struct canopy_free *work, uint32_t i, uint32_t j, int32_t *step);

struct canopy_free {
    int32_t *b;           // the caller's coefficients
    const uint8_t *seen;  // the caller's marks
    canopy_free_pull pull;
    uint16_t size[2];
    uint16_t sweeps;    ///< sweeps begun so far
    uint16_t most;      // cap on them
    uint16_t row;       // next row of the present sweep
    int32_t low, high;  ///< the reach
    int32_t enough;     // a sweep that moves nothing further is the last
    int32_t moved;      // how far the present one has moved any coefficient
};

/// Marks the coefficients that a covered knot cell can see, and no others: `coverage` as in struct canopy_envelope,
/// `seen` CANOPY_FREE_SEEN_BYTES. size = {m, n}.
void canopy_free_see(const uint16_t size[2], const uint8_t *coverage, uint8_t *seen);

/// Gives every coefficient of b (m x n, row order, within +- CANOPY_COEFFICIENT_LIMIT) that is not marked the nearest
/// value. `b` and `seen` are not copied. Linear in m n; where the value of an unmarked coefficient was, does not
/// matter. CANOPY_EMPTY: nothing is marked; nothing is changed.
enum canopy_status canopy_free_begin(struct canopy_free *work, const uint16_t size[2], const uint8_t *seen, int32_t *b);

/// What the next steps are to do: make second differences vanish, or lower the bending energy. After canopy_free_begin;
/// a rule that was on its way ends where it is.
void canopy_free_straighten(struct canopy_free *work);
void canopy_free_bend(struct canopy_free *work);

/// At most `budget` units of work. CANOPY_MORE, or CANOPY_OK when it is done. A sweep looks at every mark; a free
/// coefficient costs a look at its 4 neighbours, bent at 12.
enum canopy_status canopy_free_step(struct canopy_free *work, uint32_t budget);

#endif
