// Beginning and stepping: the order of the stages.

#include <string.h>

#include "lib/cover/refine_f32.h"
#include "lib/num/cholesky.h"

#define LOOSE -8.0f    // a constraint below is none
#define UNIT_LEAST 64  // steps

// ---- Init

enum canopy_status canopy_refine_init(struct canopy_refine *refine, const struct canopy_frame *frame, const int32_t *b,
                                      const struct canopy_refinement *windows, uint32_t count, size_t rows, void *arena,
                                      size_t bytes) {
    struct canopy_refine *r = refine;
    uint32_t which;
    if (count == 0 || count > CANOPY_REFINEMENTS_MAX || rows == 0 || rows > UINT32_MAX / 2) {
        return CANOPY_ARGUMENT;
    }
    const struct canopy_refinement *window = &windows[count - 1];
    const size_t size = (size_t)window->size[0] * window->size[1];
    struct canopy_arena cut;
    enum canopy_status status =
        canopy_arena_open(&cut, arena, bytes, CANOPY_REFINE_ARENA(window->size[0], window->size[1], rows));
    if (status == CANOPY_OK && window->d != NULL) {
        memset(window->d, 0, 4 * size);
    }
    status = status == CANOPY_OK ? canopy_refine_check(frame, windows, count, &which) : status;
    if (status != CANOPY_OK) {
        return status;
    }
    for (uint32_t k = 0; k < count; k++) {
        if (windows[k].level > window->level) {
            return CANOPY_ARGUMENT;
        }
    }
    *r = (struct canopy_refine){.frame = *frame, .b = b, .count = count, .window = *window, .room = rows};
    memcpy(r->list, windows, count * sizeof *windows);
    r->row = canopy_arena_take(&cut, rows * sizeof *r->row);
    r->low = canopy_arena_take(&cut, 4 * CANOPY_REFINE_CELLS(window->size[0], window->size[1]));
    r->matrix = canopy_arena_take(&cut, 4 * size * CANOPY_REFINE_BAND(window->size[1]));
    float **const vectors[] = {&r->cost, &r->x,        &r->step,     &r->affine,  &r->rhs,    &r->g[0],
                               &r->g[1], &r->reach[0], &r->reach[1], &r->dual[0], &r->dual[1]};
    for (size_t k = 0; k < sizeof vectors / sizeof vectors[0]; k++) {
        *vectors[k] = canopy_arena_take(&cut, 4 * size);
        memset(*vectors[k], 0, 4 * size);
    }
    r->candidate = canopy_arena_take(&cut, 4 * size);
    memset(r->candidate, 0, 4 * size);
    r->seen = canopy_arena_take(&cut, size);
    memset(r->seen, 0, size);
    r->list[count - 1].d = r->candidate;
    for (size_t k = 0; k < CANOPY_REFINE_CELLS(window->size[0], window->size[1]); k++) {
        r->low[k] = CANOPY_NO_HEIGHT;
    }
    r->height[0] = INT32_MAX;
    r->height[1] = INT32_MIN;
    r->cached = UINT32_MAX;
    return CANOPY_OK;
}

// ---- Begin

// Bounds to units; those that no window within its reach can come near are left out.
static void scale_bounds(struct canopy_refine *r) {
    uint32_t kept = 0;
    for (uint32_t k = 0; k < r->rows; k++) {
        struct canopy_refine_row row = r->row[k];
        row.bound *= r->per_step;
        if (row.bound > LOOSE) {
            r->row[kept++] = row;
        }
    }
    r->rows = kept;
}

enum canopy_status canopy_refine_begin(struct canopy_refine *refine) {
    struct canopy_refine *r = refine;
    if (r->stage != CANOPY_REFINE_FILLING) {
        return CANOPY_ARGUMENT;
    }
    if (r->points == 0) {
        return CANOPY_EMPTY;
    }
    const int32_t range = r->height[1] - r->height[0];
    r->unit = fmaxf((float)(range > UNIT_LEAST ? range : UNIT_LEAST), r->gap);
    r->per_step = 1.0f / r->unit;
    const enum canopy_status status = canopy_refine_see_cells(r);
    if (status != CANOPY_OK) {
        return status;
    }
    scale_bounds(r);
    const float each = 1.0f / (float)r->points;
    for (size_t i = 0; i < canopy_refine_coefficients(r); i++) {
        r->cost[i] *= each;
    }
    r->before = r->gap;
    r->after = r->gap;
    r->gap *= r->per_step;
    r->best = r->gap;
    r->stage = CANOPY_REFINE_START;
    return CANOPY_OK;
}

// ---- Steps

typedef void each_row(struct canopy_refine *r, struct canopy_refine_row *row);

// A chunk of a pass, and what follows it behind the last.
static void pass(struct canopy_refine *r, each_row *each, void (*finish)(struct canopy_refine *)) {
    const uint32_t left = r->rows - r->at, count = left < CANOPY_REFINE_CHUNK ? left : CANOPY_REFINE_CHUNK;
    for (uint32_t k = 0; k < count; k++) {
        each(r, &r->row[r->at + k]);
    }
    r->at += count;
    if (r->at == r->rows) {
        finish(r);
    }
}

static void factor(struct canopy_refine *r) {
    const uint32_t n = r->window.size[1];
    canopy_cholesky_factor_f32(r->matrix, CANOPY_REFINE_BAND(n), r->at, r->at + n);
    r->at += n;
    if (r->at == canopy_refine_coefficients(r)) {
        canopy_refine_go(r, CANOPY_REFINE_PREDICT);
    }
}

static void solve(struct canopy_refine *r, float *rhs) {
    canopy_cholesky_solve_f32(r->matrix, CANOPY_REFINE_BAND(r->window.size[1]), (uint32_t)canopy_refine_coefficients(r),
                              rhs);
}

static void predict(struct canopy_refine *r) {
    const size_t bytes = 4 * canopy_refine_coefficients(r);
    memcpy(r->affine, r->rhs, bytes);
    solve(r, r->affine);
    memset(r->g[0], 0, bytes);
    memset(r->g[1], 0, bytes);
    canopy_refine_go(r, CANOPY_REFINE_AFFINE);
}

static void combine(struct canopy_refine *r) {
    solve(r, r->step);
    canopy_refine_go(r, CANOPY_REFINE_STEP);
}

static void step_once(struct canopy_refine *r) {
    switch ((enum canopy_refine_stage)r->stage) {
    case CANOPY_REFINE_START: pass(r, canopy_refine_start_row, canopy_refine_finish_start); break;
    case CANOPY_REFINE_MEASURE: pass(r, canopy_refine_measure_row, canopy_refine_finish_measure); break;
    case CANOPY_REFINE_MEND: pass(r, canopy_refine_mend_row, canopy_refine_finish_mend); break;
    case CANOPY_REFINE_CERTIFY: canopy_refine_certify_candidate(r); break;
    case CANOPY_REFINE_FACTOR: factor(r); break;
    case CANOPY_REFINE_PREDICT: predict(r); break;
    case CANOPY_REFINE_AFFINE: pass(r, canopy_refine_affine_row, canopy_refine_finish_affine); break;
    case CANOPY_REFINE_COMBINE: combine(r); break;
    case CANOPY_REFINE_STEP: pass(r, canopy_refine_step_row, canopy_refine_finish_step); break;
    case CANOPY_REFINE_FILLING:
    case CANOPY_REFINE_DONE: break;
    }
}

enum canopy_status canopy_refine_step(struct canopy_refine *refine, uint32_t budget) {
    if (refine->stage == CANOPY_REFINE_FILLING) {
        return CANOPY_EMPTY;
    }
    for (; budget > 0 && refine->stage != CANOPY_REFINE_DONE; budget--) {
        step_once(refine);
    }
    return refine->stage == CANOPY_REFINE_DONE ? CANOPY_OK : CANOPY_MORE;
}
