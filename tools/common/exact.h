/// Is every point on the safe side? Decided exactly, at the price of a double evaluation a point.
///
/// Shares nothing with lib/cover: its own table, its own evaluation, its own arithmetic. Almost every point is decided
/// by one bicubic Horner evaluation in IEEE double with a proved error bound (derived in exact_parts.h); what the bound
/// leaves open, and every doubtful frame edge, is decided in whole numbers of any length (GMP), so a verdict has no
/// rounding in it. The margin that comes out is a true lower bound: raising every coefficient by -margin / lsb makes
/// the surrogate safe, because the B-splines sum to one.
#ifndef CANOPY_TOOLS_COMMON_EXACT_H
#define CANOPY_TOOLS_COMMON_EXACT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "tools/common/surrogate.h"

/// Points as the device holds them, in memory of the caller: separate arrays or triples.
struct canopy_cloud {
    enum canopy_scalar scalar;  ///< CANOPY_F32: the arrays hold float; CANOPY_FX: int32_t
    size_t count;
    size_t stride;        ///< elements from one point to the next: 1 for separate arrays, 3 for x y z triples
    const void *axis[3];  ///< the first x, y and z
};

/// What is known about all points added so far. Heights and margins in device units along axes[2]; a margin is positive
/// on the safe side. Points outside the frame count in `points` and `outside` only. The margin is within 1e-12 of the
/// largest height or coefficient; with axes of any direction, within that times the frame's diagonal over its shorter
/// pitch.
struct canopy_exact_result {
    uint64_t points;
    uint64_t wrong;        ///< on the wrong side, exactly
    uint64_t outside;      ///< outside the frame, exactly (or not finite)
    uint64_t first_wrong;  ///< index of the first such point, counted over all calls; UINT64_MAX if none
    uint64_t first_outside;
    uint64_t decided_by_gmp;  ///< how many the double evaluation left open
    double margin;            ///< lower bound of the smallest margin; +inf without a point
    double gap_sum;           ///< sum of margins, to double accuracy
    double gap_max;           ///< -inf without a point
    double height_min;        ///< smallest and largest height of the points inside; +inf, -inf without a point
    double height_max;
};

struct canopy_exact;

/// Prepares the table: (m-1)(n-1) cells of 136 bytes, about 0.1 us a cell. The surrogate must stay unchanged until
/// canopy_exact_close. NULL if there is no memory.
struct canopy_exact *canopy_exact_open(const struct canopy_surrogate *surrogate);

/// Adds points to `result`, which must have come from canopy_exact_begin. Linear; about 10 ns a point, with windows or
/// rotated axes some tens; a few us for each point that only GMP can decide.
void canopy_exact_add(struct canopy_exact *exact, const struct canopy_cloud *cloud, struct canopy_exact_result *result);

/// A result without points.
struct canopy_exact_result canopy_exact_begin(void);

/// Adds what is known of points that follow: `part` has counted from its own first one.
void canopy_exact_merge(struct canopy_exact_result *result, const struct canopy_exact_result *part);

void canopy_exact_close(struct canopy_exact *exact);

/// All in one: false only if there is no memory.
bool canopy_exact_check(const struct canopy_surrogate *surrogate, const struct canopy_cloud *cloud,
                        struct canopy_exact_result *result);

/// Whether no point is on the wrong side or outside.
static inline bool canopy_exact_is_safe(const struct canopy_exact_result *result) {
    return result->wrong == 0 && result->outside == 0;
}

/// Mean and largest gap in per cent of the points' height range (of 1 if they are all at one height).
double canopy_exact_mean_gap(const struct canopy_exact_result *result);
double canopy_exact_max_gap(const struct canopy_exact_result *result);

/// What those per cents are of, in words.
const char *canopy_exact_gap_base(const struct canopy_exact_result *result);

/// The surface over each point in device units along axes[2] above the origin, in double with an error below 1e-12 of
/// the coefficients; NAN outside the frame (decided exactly) or in a knot cell that `trim` excludes. `heights` has room
/// for cloud->count.
void canopy_exact_heights(struct canopy_exact *exact, const struct canopy_cloud *cloud, double *heights);

/// Sets covered[] (one byte a knot cell, row order) to 1 where the closed cell holds one of the points; others keep
/// what they hold. A cell whose edge comes within 1e-9 of a point counts too.
void canopy_exact_coverage(struct canopy_exact *exact, const struct canopy_cloud *cloud, uint8_t *covered);

#endif
