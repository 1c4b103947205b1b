/// The certificate of a surface with windows, from the field: is it above every point of every covered cell?
///
/// It goes beside canopy_certify, which is about the base alone: where no window reaches, the base's certificate is the
/// surface's. Where one does, each fine cell (a quarter of a knot interval, or half of one where the field's cells
/// allow no more) is one spline of 4 x 4 coefficients (canopy_refined_cell, exact but for a last floor). Over each of
/// the field's cells in it, S lies above the least of its 16 Bernstein coefficients (lib/spline/bezier.h), rounded down
/// first along u and then along v: none of their weights is negative, so that both floors lower the bound.
///
/// A cell may be safe although that bound is too low: where a window has no negative coefficient in sight it does not
/// lower the surface, so the cell is safe without it if it is safe at all. The list is therefore tried whole, then
/// without its last window, and so on as long as what is left out has no negative coefficient there; without any
/// window the base's own certificate decides. A surface that was certified stays so when a window is added to the end
/// of its list that is nowhere negative.
///
/// Nothing here comes from the fit: not its numbers, not its code.
#ifndef CANOPY_COVER_REFINE_CERTIFY_H
#define CANOPY_COVER_REFINE_CERTIFY_H

#include <stddef.h>
#include <stdint.h>

#include "lib/arena.h"
#include "lib/cover/certify.h"
#include "lib/cover/field.h"
#include "lib/spline/bezier.h"
#include "lib/spline/refined.h"
#include "lib/status.h"

/// Bytes of arena to certify windows on a field of cu x cv cells a knot interval: 18 bytes a cell along each axis.
#define CANOPY_REFINE_CERTIFY_ARENA(cu, cv)                                                                            \
    (CANOPY_ARENA_ROUND(12U * CANOPY_BEZIER_LATTICE((size_t)(cu) / 2U)) +                                              \
     CANOPY_ARENA_ROUND(12U * CANOPY_BEZIER_LATTICE((size_t)(cv) / 2U)))

struct canopy_refine_certify {
    const struct canopy_field *field;
    struct canopy_certify *base;
    const int32_t *b;
    const struct canopy_refinement *windows;
    uint32_t count;
    uint8_t level;         // of the fine cells
    int32_t *weights[2];   // lattices of u and v
    uint32_t next;         // fine cell to be looked at, over the whole grid, row order
    int32_t margin;        ///< least bound minus height so far, of the cells that a window reaches
    uint32_t failed_cell;  ///< after CANOPY_NOT_SAFE: the first cell of the field whose bound is too low …
    int32_t missing;       ///< … and by how much
};

/// Prepares to certify on `field`; `base` is a certificate of the same field. CANOPY_ARGUMENT: the field is not exact,
/// or its cells a knot interval are odd.
enum canopy_status canopy_refine_certify_init(struct canopy_refine_certify *certify, const struct canopy_field *field,
                                              struct canopy_certify *base, void *arena, size_t bytes);

/// Begins with coefficients and windows in the library's orientation: above, mirrored for the side below. `base` has
/// certified the coefficients and is left alone until the end. CANOPY_ARGUMENT: a level is none, or 2 where the
/// field's cells a knot interval are no multiple of 4.
enum canopy_status canopy_refine_certify_begin(struct canopy_refine_certify *certify, const int32_t *coefficients,
                                               const struct canopy_refinement *windows, uint32_t count);

/// Looks at up to `cells` fine cells, windows reaching them or not. CANOPY_MORE: not finished; CANOPY_OK: every covered
/// cell that a window reaches is safe, by certify->margin at least, and with the base's certificate the whole surface;
/// CANOPY_NOT_SAFE: certify->failed_cell lacks certify->missing. If coefficients of windows are then raised (never
/// lowered), the next call goes on from the fine cell that failed. CANOPY_RANGE: a coefficient is beyond its limit.
enum canopy_status canopy_refine_certify_step(struct canopy_refine_certify *certify, uint32_t cells);

#endif
