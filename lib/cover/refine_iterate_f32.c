// The interior-point iteration: passes over the constraints, what follows each, and the vectors between.

#include <string.h>

#include "lib/cover/refine_f32.h"

#define RIDGE 1e-6f    // added to the matrix, of its mean diagonal
#define SHORT 0.95f    // how much of the way to the boundary is gone
#define ENOUGH 5e-4f   // of the mean gap: complementarity at which it ends
#define STALLED 1e-3f  // as do steps that are both shorter
#define PUBLISH 4      // iterations between candidates

// ---- Passes over the constraints, a chunk at a time

static void ratio(float *most, float by, float of) { *most = fmaxf(*most, -by / of); }

void canopy_refine_start_row(struct canopy_refine *r, struct canopy_refine_row *row) {
    row->slack = fmaxf(-row->bound, CANOPY_REFINE_FRESH);
    row->dual = 1.0f / row->slack;
    r->sums[0] += row->dual;
}

void canopy_refine_measure_row(struct canopy_refine *r, struct canopy_refine_row *row) {
    const struct canopy_refine_weights w = canopy_refine_weights_of(r, row);
    row->slack += r->alpha[0] * row->slack_by;
    row->dual = row->dual * r->sums[2] + r->alpha[1] * row->dual_by;
    const float off = canopy_refine_times(r, &w, r->x) - row->slack - row->bound, ratio_here = row->dual / row->slack;
    r->comp += row->slack * row->dual;
    canopy_refine_add_square(r, &w, ratio_here);
    canopy_refine_add_weights(r, &w, -ratio_here * off, r->rhs);
}

void canopy_refine_affine_row(struct canopy_refine *r, struct canopy_refine_row *row) {
    const struct canopy_refine_weights w = canopy_refine_weights_of(r, row);
    const float off = canopy_refine_times(r, &w, r->x) - row->slack - row->bound;
    const float slack_by = canopy_refine_times(r, &w, r->affine) + off, inverse = 1.0f / row->slack;
    const float dual_by = -row->dual - row->dual * inverse * slack_by;
    row->slack_by = slack_by;
    row->dual_by = dual_by;
    ratio(&r->most[0], slack_by, row->slack);
    ratio(&r->most[1], dual_by, row->dual);
    r->sums[0] += row->slack * dual_by;
    r->sums[1] += row->dual * slack_by;
    r->sums[2] += slack_by * dual_by;
    canopy_refine_add_weights(r, &w, inverse, r->g[0]);
    canopy_refine_add_weights(r, &w, slack_by * dual_by * inverse, r->g[1]);
}

// r->comp: the complementarity to aim at.
void canopy_refine_step_row(struct canopy_refine *r, struct canopy_refine_row *row) {
    const struct canopy_refine_weights w = canopy_refine_weights_of(r, row);
    const float off = canopy_refine_times(r, &w, r->x) - row->slack - row->bound;
    const float slack_by = canopy_refine_times(r, &w, r->step) + off;
    const float product = r->comp - row->slack_by * row->dual_by;
    row->dual_by = (product - row->dual * slack_by) / row->slack - row->dual;
    row->slack_by = slack_by;
    ratio(&r->most[0], slack_by, row->slack);
    ratio(&r->most[1], row->dual_by, row->dual);
}

// ---- The reach: constraints on single coefficients

// Side 0: x - floor >= 0; side 1: ceiling - x >= 0.
struct side {
    float slack, dual, sign;
};

static struct side side_of(const struct canopy_refine *r, int side, size_t i) {
    const float sign = side == 0 ? 1.0f : -1.0f;
    return (struct side){sign * (r->x[i] - r->reach[side][i]), r->dual[side][i], sign};
}

static float affine_dual(const struct canopy_refine *r, const struct side *s, size_t i) {
    return -s->dual - s->dual / s->slack * s->sign * r->affine[i];
}

static float step_dual(const struct canopy_refine *r, const struct side *s, size_t i) {
    const float product = r->comp - s->sign * r->affine[i] * affine_dual(r, s, i);
    return (product - s->dual * s->sign * r->step[i]) / s->slack - s->dual;
}

// ---- Stages

void canopy_refine_go(struct canopy_refine *r, enum canopy_refine_stage stage) {
    r->stage = (uint8_t)stage;
    r->at = 0;
    r->most[0] = r->most[1] = 1e-6f;
    if (stage != CANOPY_REFINE_MEASURE) {
        r->sums[0] = r->sums[1] = r->sums[2] = 0;
    }
}

static void enter_measure(struct canopy_refine *r, float dual_scale) {
    const size_t count = canopy_refine_coefficients(r);
    memset(r->matrix, 0, 4 * count * CANOPY_REFINE_BAND(r->window.size[1]));
    for (size_t i = 0; i < count; i++) {
        r->rhs[i] = -r->cost[i];
    }
    canopy_refine_go(r, CANOPY_REFINE_MEASURE);
    r->comp = 0;
    r->sums[2] = dual_scale;
}

void canopy_refine_finish_start(struct canopy_refine *r) {
    float sum = r->sums[0];
    for (size_t i = 0; i < canopy_refine_coefficients(r); i++) {
        for (int side = 0; side < 2 && r->seen[i]; side++) {
            sum += 1.0f / side_of(r, side, i).slack;
        }
    }
    const float scale = 1.0f / sum;  // duals that sum to what the objective's weights do
    for (size_t i = 0; i < canopy_refine_coefficients(r); i++) {
        for (int side = 0; side < 2 && r->seen[i]; side++) {
            r->dual[side][i] = scale / side_of(r, side, i).slack;
        }
    }
    r->alpha[0] = r->alpha[1] = 0;
    enter_measure(r, scale);
}

void canopy_refine_next(struct canopy_refine *r) {
    canopy_refine_go(r, r->last ? CANOPY_REFINE_DONE : CANOPY_REFINE_FACTOR);
}

// The diagonal: reach, and what makes it regular. True: near enough to the end.
static bool end_measure(struct canopy_refine *r) {
    const size_t stride = CANOPY_REFINE_BAND(r->window.size[1]);
    float trace = 0, gap = r->gap;
    uint32_t seen = 0;
    for (size_t i = 0; i < canopy_refine_coefficients(r); i++) {
        float *diagonal = &r->matrix[i * stride + stride - 1];
        for (int side = 0; side < 2 && r->seen[i]; side++) {
            const struct side s = side_of(r, side, i);
            *diagonal += s.dual / s.slack;
            r->comp += s.dual * s.slack;
        }
        trace += *diagonal;
        seen += r->seen[i];
        gap += r->cost[i] * r->x[i];
    }
    const float ridge = RIDGE * trace / (float)seen;
    for (size_t i = 0; i < canopy_refine_coefficients(r); i++) {
        r->matrix[i * stride + stride - 1] += r->seen[i] ? ridge : 1.0f;
        r->rhs[i] = r->seen[i] ? r->rhs[i] : 0.0f;
    }
    const bool stalled = r->iterations > 0 && fmaxf(r->alpha[0], r->alpha[1]) < STALLED;
    return !(r->comp > ENOUGH * gap) || stalled || r->iterations == CANOPY_REFINE_ITERATIONS;
}

void canopy_refine_finish_measure(struct canopy_refine *r) {
    r->last = end_measure(r);
    if (r->last || (r->iterations > 0 && r->iterations % PUBLISH == 0)) {
        canopy_refine_begin_candidate(r);
    } else {
        canopy_refine_next(r);
    }
}

static float step_length(float most) { return fminf(1.0f, SHORT / most); }

void canopy_refine_finish_affine(struct canopy_refine *r) {
    const float count = (float)(2 * canopy_refine_coefficients(r) + r->rows);
    for (size_t i = 0; i < canopy_refine_coefficients(r); i++) {
        for (int side = 0; side < 2 && r->seen[i]; side++) {
            const struct side s = side_of(r, side, i);
            const float slack_by = s.sign * r->affine[i], dual_by = affine_dual(r, &s, i);
            ratio(&r->most[0], slack_by, s.slack);
            ratio(&r->most[1], dual_by, s.dual);
            r->sums[0] += s.slack * dual_by;
            r->sums[1] += s.dual * slack_by;
            r->sums[2] += slack_by * dual_by;
            r->g[0][i] += s.sign / s.slack;
            r->g[1][i] += s.sign * slack_by * dual_by / s.slack;
        }
    }
    const float primal = fminf(1.0f, 1.0f / r->most[0]), dual = fminf(1.0f, 1.0f / r->most[1]);
    const float after = r->comp + dual * r->sums[0] + primal * r->sums[1] + primal * dual * r->sums[2];
    const float part = fmaxf(after, 0.0f) / r->comp;
    r->comp *= part * part * part / count;
    for (size_t i = 0; i < canopy_refine_coefficients(r); i++) {
        r->step[i] = r->seen[i] ? r->rhs[i] + r->comp * r->g[0][i] - r->g[1][i] : 0.0f;
    }
    canopy_refine_go(r, CANOPY_REFINE_COMBINE);
}

void canopy_refine_finish_step(struct canopy_refine *r) {
    for (size_t i = 0; i < canopy_refine_coefficients(r); i++) {
        for (int side = 0; side < 2 && r->seen[i]; side++) {
            const struct side s = side_of(r, side, i);
            ratio(&r->most[0], s.sign * r->step[i], s.slack);
            ratio(&r->most[1], step_dual(r, &s, i), s.dual);
        }
    }
    for (int a = 0; a < 2; a++) {
        r->alpha[a] = step_length(r->most[a]);
    }
    for (size_t i = 0; i < canopy_refine_coefficients(r); i++) {
        for (int side = 0; side < 2 && r->seen[i]; side++) {
            const struct side s = side_of(r, side, i);
            r->dual[side][i] += r->alpha[1] * step_dual(r, &s, i);
        }
        r->x[i] += r->seen[i] ? r->alpha[0] * r->step[i] : 0.0f;
    }
    r->iterations++;
    enter_measure(r, 1.0f);
}
