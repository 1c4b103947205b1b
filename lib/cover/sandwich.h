/// The sandwich: one safe surface above all points and one below, of one frame, that cross nowhere in it.
///
/// Safe alone does not make them so: between the points two safe surfaces may pass through each other, and on real
/// scans they do (docs/sandwich.md). What keeps them apart is what is proved here, over the whole frame and exactly:
/// on every half-knot cell all 16 Bernstein coefficients of their difference are at least 0. The difference of two
/// splines of one frame is the spline of the coefficients' differences, and over a cell a polynomial is a mean of its
/// Bernstein coefficients, whose weights are not negative.
///
/// *Fast*: both sides are fitted, then every coefficient of the upper surface is raised to the lower surface's where it
/// is below it. B-splines are not negative, so a coefficient that rises lowers the surface nowhere: it stays above all
/// points. And each Bernstein coefficient is a mean of coefficients with weights that are not negative, so differences
/// of coefficients that are none of them negative are enough.
///
/// *Tight*: one side is tightened (tighten.h) with the other, which does not move, as a surface to keep above:
/// canopy_sandwich_over. From a fast sandwich the lower side first, then the upper one: at every moment what the two
/// publish is a sandwich. Measured with linear programs on three scenes and two grids, one side after the other costs
/// at most 0.7 % of the gap, the optimum of both together at most 0.45 % (docs/sandwich.md).
///
/// Coefficients are whole steps in the library's orientation: the lower surface is mirrored, and canopy_fast_orient
/// turns it into an envelope's. So "the upper is not below the lower" reads upper + lower >= 0.
#ifndef CANOPY_COVER_SANDWICH_H
#define CANOPY_COVER_SANDWICH_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/arena.h"
#include "lib/cover/certify.h"
#include "lib/cover/fast.h"
#include "lib/cover/field.h"
#include "lib/cover/tighten.h"
#include "lib/status.h"

#define CANOPY_SANDWICH_UNITS 2304  ///< distances are in 1/2304 of a step, in which they are whole

// ---- What any two surfaces are asked

/// The least Bernstein coefficient of upper - lower over the half-knot cells of row `row` of knot cells (0 to m-2), in
/// 1/CANOPY_SANDWICH_UNITS steps, exact: the surfaces are at least so far apart there. Coefficients within
/// +-CANOPY_COEFFICIENT_LIMIT; size = {m, n}. On a Cortex-M3 1,400 instructions a knot cell. Stack: 600 bytes. Shares
/// nothing with the fits.
int64_t canopy_sandwich_least(const int32_t *upper, const int32_t *lower, const uint16_t size[2], uint32_t row);

/// Raises every upper coefficient to the lower surface's where it is below: the two then cross nowhere. Returns how
/// many it raised.
uint32_t canopy_sandwich_raise(int32_t *upper, const int32_t *lower, size_t count);

// ---- Both sides, fast, from two fields

/// Bytes of arena: see canopy_fast_init and canopy_certify_init, which take turns in it.
#define CANOPY_SANDWICH_ARENA(m, n, cu, cv, lines)                                                                     \
    CANOPY_MAX(CANOPY_FAST_ARENA(m, n, cv, lines), CANOPY_CERTIFY_ARENA(n, cu, cv))

enum canopy_sandwich_stage {
    CANOPY_SANDWICH_IDLE,
    CANOPY_SANDWICH_FIT,      // one side, then the other
    CANOPY_SANDWICH_CERTIFY,  // the same, the upper one after it has been raised
    CANOPY_SANDWICH_CHECK,
    CANOPY_SANDWICH_DONE,
    CANOPY_SANDWICH_FAILED
};

struct canopy_sandwich {
    const struct canopy_field *field[2];  // by enum canopy_side
    int32_t *b[2];                        // the caller's coefficients
    void *arena;
    size_t bytes;
    const struct canopy_line_fit *fit;  ///< of both sides
    struct canopy_fast fast;
    struct canopy_certify certify;
    uint8_t stage;       ///< enum canopy_sandwich_stage
    uint8_t side;        // in work
    uint8_t failure;     // enum canopy_status
    uint16_t lines;      ///< lines a knot interval of u
    uint32_t row;        // next row of knot cells to check
    uint32_t solves;     ///< banded solves of both sides
    uint32_t unsettled;  ///< lines and columns of both that did not end by themselves and were lifted
    uint32_t raised;     ///< upper coefficients that were raised to the lower surface's
    int32_t margin[2];   ///< certified, in steps: each side's distance from the field's cells
    int64_t least;       ///< proved: how far the surfaces are apart everywhere, in 1/CANOPY_SANDWICH_UNITS steps
};

/// Two fields with the same points: `above` keeps the highest, `below`, whose frame differs in nothing but its side,
/// the lowest. Both must be exact and have the same cells, which `lines` divides (canopy_fast_init), else
/// CANOPY_ARGUMENT.
enum canopy_status canopy_sandwich_init(struct canopy_sandwich *sandwich, const struct canopy_field *above,
                                        const struct canopy_field *below, const struct canopy_line_fit *fit,
                                        uint16_t lines, void *arena, size_t bytes);

/// Takes `count` points into both fields in one pass; returns how many of them either refused. A point that one has
/// refused may be in the other, where it does no harm.
size_t canopy_sandwich_feed_fx(struct canopy_field *above, struct canopy_field *below, const int32_t (*points)[3],
                               size_t count);
size_t canopy_sandwich_feed_f32(struct canopy_field *above, struct canopy_field *below, const float (*points)[3],
                                size_t count);

/// Begins to fit `upper` and `lower`, each m x n, which the caller leaves alone until it is done. CANOPY_EMPTY: the
/// field above has no data.
enum canopy_status canopy_sandwich_begin(struct canopy_sandwich *sandwich, int32_t *upper, int32_t *lower);

/// Does at most `budget` units of work: iterations of a line, rows of cells certified (coefficients raised where
/// something is missing), or rows of knot cells checked. CANOPY_MORE, or CANOPY_OK: both sides are certified on their
/// fields by margin[side] and the two cross nowhere, by `least`. CANOPY_RANGE: a coefficient left its limit;
/// CANOPY_EMPTY: the field below has no data. Without CANOPY_OK the coefficients are of no use.
///
/// The fields may rise while it works: as after any certificate, a cell that rises after its row was looked at is for
/// canopy_certify_cell.
enum canopy_status canopy_sandwich_step(struct canopy_sandwich *sandwich, uint32_t budget);

// ---- One side, tight

/// Asks a tightening that has its points to keep clear of the other side's surface `opposite`, everywhere in the frame.
/// `mirror`, m x n, is for the tightening and stays as it is until that has ended. Where `opposite` leaves no room
/// within the reach (a coefficient beyond 1.875 height ranges from this side's lowest point), its coefficients are
/// raised, away from this side, which keeps it safe. CANOPY_EMPTY: no points yet; nothing is changed.
enum canopy_status canopy_sandwich_over(struct canopy_tighten *tighten, int32_t *opposite, int32_t *mirror);

// ---- What is free

/// A tight side has no free coefficients: what keeps it clear of the other one shapes it everywhere, and where there
/// are no points it flares out to the reach. Smoother is what free.h makes of the coefficients that nothing covered can
/// see; but filled so, the two may cross. This takes of a wish as much as keeps them apart: in a knot cell where the
/// wishes cross, they go half of the way back to the pair, again and again, and from the ninth sweep on all of it.
struct canopy_sandwich_ease {
    const int32_t *pair[2];
    int32_t *wish[2];
    uint16_t size[2], row, sweeps;
    bool moved, done;
};

/// `pair`: upper and lower coefficients that do not cross, which stay as they are. `wish`: the same but for what is
/// free; what is to be published when it is done.
void canopy_sandwich_ease_begin(struct canopy_sandwich_ease *ease, const uint16_t size[2], const int32_t *const pair[2],
                                int32_t *const wish[2]);

/// Looks at up to `rows` rows of knot cells. CANOPY_MORE, or CANOPY_OK: the wishes do not cross, by
/// canopy_sandwich_least. At most 64 sweeps over the frame; three where nothing crosses for long.
enum canopy_status canopy_sandwich_ease_step(struct canopy_sandwich_ease *ease, uint32_t rows);

#endif
