// The interior-point iteration: what follows each pass over the rows in use, and the vectors between.

#include <string.h>

#include "lib/cover/tighten_f32.h"

#define FRESH 0.2f     // the first iterate stands this much above the start
#define BURIED 200.0f  // largest 1/slack of a first iterate that is of use
#define RIDGE 1e-6f    // added to the matrix, of its mean diagonal
#define CORRECTORS 2   // centrality correctors an iteration, at most
#define LONG 0.8f      // steps that need none
#define AIM 0.3f       // by how much longer a step a corrector aims at …
#define WORTH 0.1f     // … and which part of it makes it worth taking
#define SHORT 0.95f    // how much of the way to the boundary is gone
#define HELD 0.7f      // the same where a constraint not in use stood in the way
#define ENOUGH 5e-4f   // of the mean gap: complementarity at which it ends
#define PROVED 0.01f   // of the gap may be between it and the bound then
#define NOTHING 5e-6f  // of the mean gap: complementarity at which it ends anyway
#define LAME 0.3f      // a step as short as that is followed by one …
#define RECOVER 0.5f   // that leaves so much of the complementarity and centres
#define STALLED 1e-4f  // as do steps that are both shorter

static inline float slack_of(const struct canopy_tighten *t, int side, size_t j) {
    return canopy_tighten_reach_slack(t, side, j);
}
static inline float sign_of(int side) { return side == 0 ? 1.0f : -1.0f; }
static float longest(float most) { return most > 1.0f ? 1.0f / most : 1.0f; }
static float shortened(float most) { return most > SHORT ? SHORT / most : 1.0f; }

// ---- Stages

void canopy_tighten_go(struct canopy_tighten *t, enum canopy_tighten_stage stage) {
    const size_t bytes = 4 * canopy_tighten_coefficients(t);
    t->stage = (uint8_t)stage;
    t->at = 0;
    t->part = 0;
    t->least = 1e30f;
    memset(t->most, 0, sizeof t->most);
    memset(t->sums, 0, sizeof t->sums);
    switch (stage) {
    case CANOPY_TIGHTEN_MEASURE:
        t->comp = 0;
        // fall through
    case CANOPY_TIGHTEN_AFFINE:
    case CANOPY_TIGHTEN_CENTRE:
        memset(t->g[0], 0, bytes);
        memset(t->g[1], 0, bytes);
        break;
    case CANOPY_TIGHTEN_CHOOSE:
        t->offered = 0;
        // fall through
    case CANOPY_TIGHTEN_START: memset(t->flagged, CANOPY_TIGHTEN_FLAG_HERE, canopy_tighten_cells(t)); break;
    case CANOPY_TIGHTEN_LOOK: t->offered = 0; break;
    default: break;
    }
}

// The finest parts whose offers are sure to be taken.
static uint32_t grain_of(const struct canopy_tighten *t) {
    uint32_t cells = 0, grain = CANOPY_TIGHTEN_GRAIN;
    for (uint32_t k = 0; k < canopy_tighten_cells(t); k++) {
        cells += t->live[k];
    }
    while (grain > 1 && 5 * grain * grain * cells > 4 * t->size.rows) {
        grain--;
    }
    return grain;
}

void canopy_tighten_first_iterate(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        const float x = canopy_tighten_height(t, t->b[j]) + FRESH;
        t->x[j] = t->lid ? canopy_tighten_lid(t)
                         : smaller(larger(x, CANOPY_TIGHTEN_FLOOR + 0.1f), CANOPY_TIGHTEN_CEILING - 0.1f);
    }
    t->grain = grain_of(t);
    t->row_count = 0;
    t->comp = 0;
    canopy_tighten_go(t, CANOPY_TIGHTEN_CHOOSE);
}

void canopy_tighten_first_duals(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    if (t->most[0] > BURIED && !t->lid) {
        t->lid = true;
        canopy_tighten_first_iterate(t);
        return;
    }
    for (size_t j = 0; j < count; j++) {
        t->sums[0] += t->seen[j] ? 1.0f / slack_of(t, 0, j) + 1.0f / slack_of(t, 1, j) : 0.0f;
    }
    t->mu = 1.0f / t->sums[0];
    for (size_t j = 0; j < count; j++) {
        for (int k = 0; k < SIDES; k++) {
            t->dual[k][j] = t->seen[j] ? t->mu / slack_of(t, k, j) : 0.0f;
        }
    }
    t->alpha[0] = t->alpha[1] = 0;
    canopy_tighten_go(t, CANOPY_TIGHTEN_CLEAR);
}

// A little more is done where the bound is not as near yet as it could be.
static bool is_enough(const struct canopy_tighten *t) {
    const float gap = t->pending ? t->candidate_gap : t->mean_gap, left = t->comp * t->range;
    return t->iterations >= CANOPY_TIGHTEN_ITERATIONS || left < NOTHING * gap ||
           (left < ENOUGH * gap && t->bound > (1.0f - PROVED) * gap) ||
           (t->iterations > 0 && t->alpha[0] < STALLED && t->alpha[1] < STALLED);
}

void canopy_tighten_finish_measure(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t), stride = CANOPY_TIGHTEN_BAND(t->frame.size[1]);
    uint32_t constraints = t->row_count;
    float trace = 0;
    canopy_tighten_find_bound(t);
    for (size_t j = 0; j < count; j++) {
        float *diagonal = t->matrix + j * stride + (stride - 1);
        for (int k = 0; k < SIDES && t->seen[j]; k++) {
            const float slack = slack_of(t, k, j);
            t->comp += slack * t->dual[k][j];
            *diagonal += t->dual[k][j] / slack;
            constraints++;
        }
        trace += *diagonal;
    }
    for (size_t j = 0; j < count; j++) {
        float *diagonal = t->matrix + j * stride + (stride - 1);
        *diagonal = t->seen[j] ? *diagonal + RIDGE * trace / (float)count : 1.0f;
    }
    if (is_enough(t)) {
        canopy_tighten_end(t);
        return;
    }
    t->mean = t->mu = t->comp / (float)constraints;
    for (size_t j = 0; j < count; j++) {
        t->affine[j] = t->seen[j] ? -t->cost[j] : 0.0f;
    }
    canopy_tighten_go(t, CANOPY_TIGHTEN_FACTOR);
}

// ---- The predictor

void canopy_tighten_finish_predict(struct canopy_tighten *t) { canopy_tighten_go(t, CANOPY_TIGHTEN_AFFINE); }

void canopy_tighten_finish_affine(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        for (int k = 0; k < SIDES && t->seen[j]; k++) {
            const float s = slack_of(t, k, j), y = t->dual[k][j], by = sign_of(k) * t->affine[j], ratio = by / s;
            const float product = -by * y * (1.0f + ratio);
            t->sums[0] += y * by;
            t->sums[1] -= y * (s + by);
            t->sums[2] += product;
            t->most[0] = larger(t->most[0], -ratio);
            t->most[1] = larger(t->most[1], 1.0f + ratio);
            t->target[k][j] = -product;
        }
    }
    const float primal = longest(t->most[0]), dual = longest(t->most[1]);
    const float left = t->comp + primal * t->sums[0] + dual * t->sums[1] + primal * dual * t->sums[2];
    const float ratio = smaller(larger(left / t->comp, 0.0f), 1.0f);
    const float last = smaller(t->alpha[0], t->alpha[1]);
    t->mu *= larger(ratio * ratio * ratio, t->iterations > 0 && last < LAME ? RECOVER : 1e-4f);
    for (size_t j = 0; j < count; j++) {
        float rhs = -t->cost[j] + t->mu * t->g[0][j] + t->g[1][j];
        for (int k = 0; k < SIDES && t->seen[j]; k++) {
            rhs += sign_of(k) * (t->mu + t->target[k][j]) / slack_of(t, k, j);
        }
        t->step[j] = t->seen[j] ? rhs : 0.0f;
    }
    t->corrections = 0;
    canopy_tighten_go(t, CANOPY_TIGHTEN_COMBINE);
}

void canopy_tighten_finish_combine(struct canopy_tighten *t) { canopy_tighten_go(t, CANOPY_TIGHTEN_STEP); }

// ---- The step, and what centres it

static void step_reach(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        for (int k = 0; k < SIDES && t->seen[j]; k++) {
            const float s = slack_of(t, k, j), y = t->dual[k][j], by = sign_of(k) * t->step[j];
            const float dual_by = (t->mu + t->target[k][j]) / s - y - y * by / s;
            t->dual_by[k][j] = dual_by;
            t->most[0] = larger(t->most[0], -by / s);
            t->most[1] = larger(t->most[1], -dual_by / larger(y, 1e-30f));
        }
    }
}

// False where rounding has eaten the step: it leads out of the reach, or nowhere.
static bool is_sound(const struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        const float x = t->x[j] + t->alpha[0] * t->step[j];
        if (!(x >= CANOPY_TIGHTEN_FLOOR && x <= CANOPY_TIGHTEN_CEILING)) {
            return false;
        }
    }
    return true;
}

static void begin_look(struct canopy_tighten *t) {
    if (is_sound(t)) {
        canopy_tighten_go(t, CANOPY_TIGHTEN_DROP);
    } else {
        canopy_tighten_end(t);
    }
}

static void begin_centre(struct canopy_tighten *t) {
    for (int k = 0; k < 2; k++) {
        t->aim[k] = smaller(t->alpha[k] + AIM, 1.0f);
    }
    canopy_tighten_go(t, CANOPY_TIGHTEN_CENTRE);
}

void canopy_tighten_finish_step(struct canopy_tighten *t) {
    step_reach(t);
    for (int k = 0; k < 2; k++) {
        t->alpha[k] = shortened(t->most[k]);
    }
    if (t->alpha[0] > LONG && t->alpha[1] > LONG) {
        begin_look(t);
    } else {
        begin_centre(t);
    }
}

// What brings the product of slack and dual after a step into reach of the centre, limited (Gondzio).
static float reach_change(const struct canopy_tighten *t, int side, size_t j) {
    const float slack = slack_of(t, side, j) + t->aim[0] * sign_of(side) * t->step[j];
    const float product = slack * (t->dual[side][j] + t->aim[1] * t->dual_by[side][j]);
    const float least = 0.1f * t->mu, most = 10.0f * t->mu;
    const float change = product < least ? least - product : product > most ? most - product : 0.0f;
    return larger(change, -most);
}

void canopy_tighten_finish_centre(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        t->affine[j] = t->seen[j] ? t->g[0][j] : 0.0f;
        for (int k = 0; k < SIDES && t->seen[j]; k++) {
            t->target[k][j] = reach_change(t, k, j);
            t->affine[j] += sign_of(k) * t->target[k][j] / slack_of(t, k, j);
        }
    }
    canopy_tighten_go(t, CANOPY_TIGHTEN_RECENTRE);
}

void canopy_tighten_finish_recentre(struct canopy_tighten *t) { canopy_tighten_go(t, CANOPY_TIGHTEN_TRY); }

// A correction is taken if it lengthens the steps by a tenth of what it aimed at.
void canopy_tighten_finish_try(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        for (int k = 0; k < SIDES && t->seen[j]; k++) {
            const float s = slack_of(t, k, j), y = t->dual[k][j], by = sign_of(k) * t->affine[j];
            t->target[k][j] = t->dual_by[k][j] + (t->target[k][j] - y * by) / s;  // the dual's direction if it is taken
            t->most[0] = larger(t->most[0], -(sign_of(k) * t->step[j] + by) / s);
            t->most[1] = larger(t->most[1], -t->target[k][j] / larger(y, 1e-30f));
        }
    }
    const float primal = shortened(t->most[0]), dual = shortened(t->most[1]);
    if (!(primal + dual >= t->alpha[0] + t->alpha[1] + WORTH * (t->aim[0] + t->aim[1] - t->alpha[0] - t->alpha[1]) &&
          primal >= 0.9f * t->alpha[0] && dual >= 0.9f * t->alpha[1])) {
        begin_look(t);
        return;
    }
    t->alpha[0] = primal;
    t->alpha[1] = dual;
    canopy_tighten_go(t, CANOPY_TIGHTEN_ACCEPT);
}

void canopy_tighten_finish_accept(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        t->step[j] += t->affine[j];
        for (int k = 0; k < SIDES; k++) {
            t->dual_by[k][j] = t->seen[j] ? t->target[k][j] : 0.0f;
        }
    }
    t->corrections++;
    if (t->corrections < CORRECTORS) {
        begin_centre(t);
    } else {
        begin_look(t);
    }
}

// Flags are where the step leads; where it is shortened, every slack is between those at its two ends, and flags are of
// both.
static void move_flags(struct canopy_tighten *t, bool shortened) {
    for (uint32_t cell = 0; cell < canopy_tighten_cells(t); cell++) {
        const uint8_t flags = t->flagged[cell];
        const bool flagged = (flags & CANOPY_TIGHTEN_FLAG_THERE) != 0 || (shortened && flags != 0);
        t->flagged[cell] = flagged ? CANOPY_TIGHTEN_FLAG_HERE : 0;
    }
}

// A constraint not in use may have shortened the step.
void canopy_tighten_finish_look(struct canopy_tighten *t) {
    const bool held = t->most[0] > 1.0f;
    t->alpha[0] *= held ? HELD / t->most[0] : 1.0f;
    move_flags(t, held);
    canopy_tighten_sift_rows(t);
    canopy_tighten_go(t, CANOPY_TIGHTEN_ADD);
}

// The iterate after the step. The rows' duals follow when they are measured.
void canopy_tighten_take_step(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        t->x[j] += t->alpha[0] * t->step[j];
        for (int k = 0; k < SIDES; k++) {
            t->dual[k][j] += t->seen[j] ? t->alpha[1] * t->dual_by[k][j] : 0.0f;
        }
    }
    const float part = smaller(t->alpha[0], t->alpha[1]);
    t->mu = part * t->mu + (1.0f - part) * t->mean;
    t->iterations++;
    canopy_tighten_consider(t);
}
