// Candidates: rounding, mending, publishing.

#include <string.h>

#include "lib/cover/refine_f32.h"

#define TRIES 6            // to mend a cell by raising all that is in sight
#define FRACTION_RAISED 4  // afterwards a negative coefficient goes this part of its way to zero, at least

// The window's share of the mean gap, in units, for whole coefficients.
static float share(const struct canopy_refine *r, const int32_t *d) {
    float sum = 0;
    for (size_t i = 0; i < canopy_refine_coefficients(r); i++) {
        sum += r->cost[i] * ((float)d[i] * r->per_step);
    }
    return sum;
}

void canopy_refine_begin_candidate(struct canopy_refine *r) {
    for (size_t i = 0; i < canopy_refine_coefficients(r); i++) {
        r->candidate[i] = r->seen[i] ? (int32_t)ceilf(r->x[i] * r->unit) : 0;
    }
    if (!(r->gap + share(r, r->candidate) < r->best)) {
        canopy_refine_next(r);
        return;
    }
    r->raised = false;
    r->tries = 0;
    r->tried = UINT32_MAX;
    canopy_refine_go(r, CANOPY_REFINE_MEND);
    if (r->certify != NULL) {
        canopy_refine_go(r, CANOPY_REFINE_CERTIFY);
        if (canopy_refine_certify_begin(r->certify, r->b, r->list, r->count) != CANOPY_OK) {
            canopy_refine_next(r);
        }
    }
}

static void publish(struct canopy_refine *r) {
    const float gap = r->gap + share(r, r->candidate);
    if (gap < r->best) {
        memcpy(r->window.d, r->candidate, 4 * canopy_refine_coefficients(r));
        r->best = gap;
        r->after = gap * r->unit;
        r->published++;
    }
    canopy_refine_next(r);
}

// ---- Mending

// Raises what is in sight of a cell by as much as `by`, at the tries-th try at it. The first few raise all alike: that
// is enough where the window's edge cuts nothing off. Afterwards negative ones go towards zero, where the window lowers
// nothing.
static void raise(struct canopy_refine *r, const struct canopy_refine_sight *sight, int32_t by, uint32_t tries) {
    const uint32_t n = r->window.size[1];
    for (uint32_t a = 0; a < sight->rows; a++) {
        int32_t *d = r->candidate + (size_t)(sight->i + a) * n + sight->j;
        for (uint32_t e = 0; e < sight->columns; e++) {
            if (tries < TRIES) {
                d[e] += by;
            } else if (d[e] < 0) {
                const int32_t rise = -d[e] / FRACTION_RAISED + 1;
                d[e] = d[e] + rise < 0 ? d[e] + rise : 0;
            }
        }
    }
}

static float largest(const struct canopy_refine *r, const struct canopy_refine_sight *sight, bool *lowers) {
    const uint32_t n = r->window.size[1];
    float most = 0;
    *lowers = false;
    for (uint32_t a = 0; a < sight->rows; a++) {
        const int32_t *d = r->candidate + (size_t)(sight->i + a) * n + sight->j;
        for (uint32_t e = 0; e < sight->columns; e++) {
            *lowers = *lowers || d[e] < 0;
            most = fmaxf(most, fabsf((float)d[e]));
        }
    }
    return most;
}

void canopy_refine_mend_row(struct canopy_refine *r, struct canopy_refine_row *row) {
    const struct canopy_refine_weights w = canopy_refine_weights_of(r, row);
    const uint32_t n = r->window.size[1];
    bool lowers;
    const float most = largest(r, &w.sight, &lowers);
    if (!lowers) {
        return;
    }
    float sum = 0;
    for (uint32_t a = 0; a < w.sight.rows; a++) {
        const int32_t *d = r->candidate + (size_t)(w.sight.i + a) * n + w.sight.j;
        float inner = 0;
        for (uint32_t e = 0; e < w.sight.columns; e++) {
            inner += w.v[e] * (float)d[e];
        }
        sum += w.u[a] * inner;
    }
    const float bound = row->bound * r->unit * (1.0f - 0x1p-20f), missing = bound - (sum - CANOPY_REFINE_ERROR * most);
    if (missing > 0) {
        raise(r, &w.sight, (int32_t)ceilf(missing) + 1, r->tries);
        r->raised = true;
    }
}

void canopy_refine_finish_mend(struct canopy_refine *r) {
    if (r->raised) {
        r->raised = false;
        r->tries++;
        canopy_refine_go(r, CANOPY_REFINE_MEND);
    } else {
        publish(r);
    }
}

// Raises what the certificate misses. False: the window cannot mend it.
static bool mend_field(struct canopy_refine *r) {
    const struct canopy_field *field = r->certify->field;
    const uint32_t columns = field->axis[1].count, cell = r->certify->failed_cell;
    const uint32_t at[2] = {cell / columns / ((uint32_t)field->axis[0].cells >> r->window.level),
                            cell % columns / ((uint32_t)field->axis[1].cells >> r->window.level)};
    if (!canopy_refinement_meets(&r->window, r->window.level, at)) {
        return false;
    }
    const uint32_t row = (uint32_t)((int32_t)at[0] - r->window.first[0] + 2);
    const uint32_t column = (uint32_t)((int32_t)at[1] - r->window.first[1] + 2);
    const struct canopy_refine_sight sight = canopy_refine_sight_of(r, row * canopy_refine_across(r) + column);
    bool lowers;
    (void)largest(r, &sight, &lowers);
    if (!lowers) {
        return false;
    }
    r->tries = cell == r->tried ? r->tries + 1 : 0;
    r->tried = cell;
    const int32_t most = CANOPY_REFINED_LIMIT >> (TRIES + 4);
    raise(r, &sight, (r->certify->missing < most ? r->certify->missing : most) << r->tries % TRIES, r->tries);
    return true;
}

void canopy_refine_certify_candidate(struct canopy_refine *r) {
    const enum canopy_status status = canopy_refine_certify_step(r->certify, CANOPY_REFINE_CHUNK);
    if (status == CANOPY_OK) {
        publish(r);
    } else if (status != CANOPY_MORE && (status != CANOPY_NOT_SAFE || !mend_field(r))) {
        canopy_refine_next(r);
    }
}
