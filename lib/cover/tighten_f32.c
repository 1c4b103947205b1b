// Beginning and stepping: the order of the stages.

#include <string.h>

#include "lib/cover/tighten_f32.h"
#include "lib/num/cholesky.h"

#define CLEAR_ROWS 64  // of the matrix, in one unit of work
#define FACTOR_ROWS 4
#define SOLVE_ROWS 64  // of down and up together

// ---- Init

static bool is_acceptable(const struct canopy_frame *frame, const struct canopy_tighten_size *size) {
    const uint16_t m = frame->size[0], n = frame->size[1];
    return m >= CANOPY_SIZE_MIN && n >= CANOPY_SIZE_MIN && m <= CANOPY_SIZE_MAX && n <= CANOPY_SIZE_MAX &&
           size->points <= UINT32_MAX / 2 && size->cells[0] <= CANOPY_CELLS_MAX && size->cells[1] <= CANOPY_CELLS_MAX &&
           (size->cells[0] == 0) == (size->cells[1] == 0) && (size->points > 0 || size->cells[0] > 0) &&
           size->rows >= 2U * m * n;
}

enum canopy_status canopy_tighten_init(struct canopy_tighten *tighten, const struct canopy_frame *frame,
                                       const struct canopy_tighten_size *size, void *arena, size_t bytes) {
    if (!is_acceptable(frame, size)) {
        return CANOPY_ARGUMENT;
    }
    const uint16_t m = frame->size[0], n = frame->size[1];
    struct canopy_arena cut;
    const enum canopy_status status = canopy_arena_open(
        &cut, arena, bytes, CANOPY_TIGHTEN_ARENA(m, n, size->cells[0], size->cells[1], size->points, size->rows));
    if (status != CANOPY_OK) {
        return status;
    }
    struct canopy_tighten *t = tighten;
    *t = (struct canopy_tighten){.frame = *frame, .size = *size};
    const size_t cells = CANOPY_TIGHTEN_CELLS(m, n), unknowns = 4U * (size_t)m * n;
    if (size->points > 0) {
        t->blocks = canopy_arena_take(&cut, (size->points / LANES + cells) * sizeof *t->blocks);
        t->first = canopy_arena_take(&cut, 4 * (cells + 1));
        t->half_low = canopy_arena_take(&cut, 16 * cells);
    }
    t->rows = canopy_arena_take(&cut, (size->rows + LANES - 1U) / LANES * sizeof *t->rows);
    for (int a = 0; a < 2; a++) {
        t->lattice[a] = canopy_arena_take(&cut, 16 * CANOPY_TIGHTEN_LATTICE(size->cells[a]));
    }
    t->matrix = canopy_arena_take(&cut, unknowns * CANOPY_TIGHTEN_BAND(n));
    float **const vectors[] = {&t->cost,    &t->x,       &t->step,       &t->affine,     &t->g[0],      &t->g[1],
                               &t->dual[0], &t->dual[1], &t->dual_by[0], &t->dual_by[1], &t->target[0], &t->target[1]};
    for (size_t k = 0; k < sizeof vectors / sizeof vectors[0]; k++) {
        *vectors[k] = canopy_arena_take(&cut, unknowns);
    }
    t->candidate = canopy_arena_take(&cut, unknowns);
    t->seen = canopy_arena_take(&cut, unknowns / 4);
    t->live = canopy_arena_take(&cut, cells);
    t->flagged = canopy_arena_take(&cut, cells);
    canopy_tighten_tables(t);
    return CANOPY_OK;
}

enum canopy_status canopy_tighten_begin(struct canopy_tighten *tighten, int32_t *coefficients, bool safe) {
    struct canopy_tighten *t = tighten;
    const size_t count = canopy_tighten_coefficients(t);
    if (t->points == 0 || t->stage == CANOPY_TIGHTEN_TAKE) {
        return CANOPY_EMPTY;
    }
    for (size_t j = 0; j < count; j++) {
        if (coefficients[j] > CANOPY_COEFFICIENT_LIMIT || coefficients[j] < -CANOPY_COEFFICIENT_LIMIT) {
            return CANOPY_ARGUMENT;
        }
    }
    t->b = coefficients;
    t->safe = safe;
    t->lid = false;
    t->pending = t->ending = false;
    t->iterations = 0;
    t->published = 0;
    t->bound = 0;
    if (safe) {
        canopy_tighten_publish_start(t);
    } else {
        canopy_tighten_begin_start(t);
    }
    return CANOPY_OK;
}

// ---- The step

// The end of the next piece of a job of `count` rows, and on to `stage` behind the last.
static uint32_t piece(struct canopy_tighten *t, uint32_t rows, uint32_t count, enum canopy_tighten_stage stage) {
    const uint32_t end = t->at + rows < count ? t->at + rows : count;
    if (end == count) {
        canopy_tighten_go(t, stage);
    } else {
        t->at = end;
    }
    return end;
}

static void clear_rows(struct canopy_tighten *t, enum canopy_tighten_stage next) {
    const size_t stride = CANOPY_TIGHTEN_BAND(t->frame.size[1]);
    const uint32_t from = t->at, to = piece(t, CLEAR_ROWS, (uint32_t)canopy_tighten_coefficients(t), next);
    memset(t->matrix + from * stride, 0, 4 * (to - from) * stride);
}

static void factor_rows(struct canopy_tighten *t, enum canopy_tighten_stage next) {
    const uint32_t from = t->at, to = piece(t, FACTOR_ROWS, (uint32_t)canopy_tighten_coefficients(t), next);
    canopy_cholesky_factor_f32(t->matrix, CANOPY_TIGHTEN_BAND(t->frame.size[1]), from, to);
}

static void solve(struct canopy_tighten *t, float *rhs, void (*finish)(struct canopy_tighten *)) {
    const uint32_t count = (uint32_t)canopy_tighten_coefficients(t), from = t->at;
    const uint32_t to = from + SOLVE_ROWS < 2 * count ? from + SOLVE_ROWS : 2 * count;
    canopy_cholesky_solve_rows_f32(t->matrix, CANOPY_TIGHTEN_BAND(t->frame.size[1]), count, rhs, from, to);
    t->at = to;
    if (to == 2 * count) {
        finish(t);
    }
}

static void pass(struct canopy_tighten *t, enum canopy_tighten_pass which, void (*finish)(struct canopy_tighten *)) {
    if (canopy_tighten_pass(t, which)) {
        finish(t);
    }
}

static void choose(struct canopy_tighten *t) {
    if (canopy_tighten_look(t, CANOPY_TIGHTEN_LOOK_CHOOSE, NULL, 0) == CANOPY_OK) {
        canopy_tighten_sift_rows(t);
        canopy_tighten_take_rows(t);
        canopy_tighten_go(t, CANOPY_TIGHTEN_SLACKS);
    }
}

static void look(struct canopy_tighten *t) {
    if (canopy_tighten_look(t, CANOPY_TIGHTEN_LOOK_STEP, NULL, 0) == CANOPY_OK) {
        canopy_tighten_finish_look(t);
    }
}

static void drop(struct canopy_tighten *t) {
    canopy_tighten_drop_rows(t);
    canopy_tighten_go(t, CANOPY_TIGHTEN_LOOK);
}

static void add(struct canopy_tighten *t) {
    canopy_tighten_take_rows(t);
    canopy_tighten_go(t, CANOPY_TIGHTEN_MOVE);
}

static void step_once(struct canopy_tighten *t) {
    switch (t->stage) {
    case CANOPY_TIGHTEN_START: canopy_tighten_raise_start(t); break;
    case CANOPY_TIGHTEN_START_MEND: canopy_tighten_mend_start(t); break;
    case CANOPY_TIGHTEN_CHOOSE: choose(t); break;
    case CANOPY_TIGHTEN_SLACKS: pass(t, CANOPY_TIGHTEN_PASS_SLACKS, canopy_tighten_first_duals); break;
    case CANOPY_TIGHTEN_CLEAR: clear_rows(t, CANOPY_TIGHTEN_MEASURE); break;
    case CANOPY_TIGHTEN_BEND_CLEAR: clear_rows(t, CANOPY_TIGHTEN_BEND); break;
    case CANOPY_TIGHTEN_MEASURE: pass(t, CANOPY_TIGHTEN_PASS_MEASURE, canopy_tighten_finish_measure); break;
    case CANOPY_TIGHTEN_FACTOR: factor_rows(t, CANOPY_TIGHTEN_PREDICT); break;
    case CANOPY_TIGHTEN_PREDICT: solve(t, t->affine, canopy_tighten_finish_predict); break;
    case CANOPY_TIGHTEN_AFFINE: pass(t, CANOPY_TIGHTEN_PASS_AFFINE, canopy_tighten_finish_affine); break;
    case CANOPY_TIGHTEN_COMBINE: solve(t, t->step, canopy_tighten_finish_combine); break;
    case CANOPY_TIGHTEN_STEP: pass(t, CANOPY_TIGHTEN_PASS_STEP, canopy_tighten_finish_step); break;
    case CANOPY_TIGHTEN_CENTRE: pass(t, CANOPY_TIGHTEN_PASS_CENTRE, canopy_tighten_finish_centre); break;
    case CANOPY_TIGHTEN_RECENTRE: solve(t, t->affine, canopy_tighten_finish_recentre); break;
    case CANOPY_TIGHTEN_TRY: pass(t, CANOPY_TIGHTEN_PASS_TRY, canopy_tighten_finish_try); break;
    case CANOPY_TIGHTEN_ACCEPT: pass(t, CANOPY_TIGHTEN_PASS_ACCEPT, canopy_tighten_finish_accept); break;
    case CANOPY_TIGHTEN_DROP: drop(t); break;
    case CANOPY_TIGHTEN_LOOK: look(t); break;
    case CANOPY_TIGHTEN_ADD: add(t); break;
    case CANOPY_TIGHTEN_MOVE: canopy_tighten_take_step(t); break;
    case CANOPY_TIGHTEN_PUBLISH: canopy_tighten_raise_candidate(t); break;
    case CANOPY_TIGHTEN_MEND: canopy_tighten_mend_candidate(t); break;
    case CANOPY_TIGHTEN_BEND: canopy_tighten_bend_row(t); break;
    case CANOPY_TIGHTEN_BEND_FACTOR: factor_rows(t, CANOPY_TIGHTEN_BEND_SOLVE); break;
    case CANOPY_TIGHTEN_BEND_SOLVE: solve(t, t->step, canopy_tighten_finish_bend); break;
    default: break;
    }
}

enum canopy_status canopy_tighten_step(struct canopy_tighten *tighten, uint32_t budget) {
    if (tighten->stage == CANOPY_TIGHTEN_IDLE || tighten->stage == CANOPY_TIGHTEN_TAKE) {
        return CANOPY_EMPTY;
    }
    for (; budget > 0 && tighten->stage != CANOPY_TIGHTEN_DONE; budget--) {
        step_once(tighten);
    }
    return tighten->stage == CANOPY_TIGHTEN_DONE ? CANOPY_OK : CANOPY_MORE;
}
