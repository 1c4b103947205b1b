// What is published: candidates are rounded to whole steps, raised where they must be, mended by a field's certificate,
// and compared with what was published before.

#include <string.h>

#include "lib/cover/fast.h"
#include "lib/cover/tighten_f32.h"

#define LID 1.1f          // a start of no use is replaced by this flat one …
#define LID_OVER 1.95f    // … above another surface
#define SPARE 0.5f        // how far a candidate may be raised
#define START_SPARE 4.0f  // and a start
#define WORTH 0.03f       // of the mean gap: what a candidate must gain to be looked at, unless it is the last
#define CERTIFY_LOSS 16   // steps: what a field's certificate loses by rounding down, and the iterate by being float

// Mean gap of whole coefficients, in the program's unit.
static float gap_of(const struct canopy_tighten *t, const int32_t *b) {
    const size_t count = canopy_tighten_coefficients(t);
    struct canopy_tighten_sum gap = {-t->height_mean, 0};
    for (size_t j = 0; j < count; j++) {
        canopy_tighten_add(&gap, t->cost[j] * canopy_tighten_height(t, b[j]));
    }
    return gap.high + gap.low;
}

// The largest coefficient that a cell with constraints can see, and something to rise by.
static float reach_of(const struct canopy_tighten *t, const int32_t *b, float spare) {
    const size_t count = canopy_tighten_coefficients(t);
    float most = 0;
    for (size_t j = 0; j < count; j++) {
        most = t->seen[j] ? larger(most, fabsf(canopy_tighten_height(t, b[j]))) : most;
    }
    return most + spare;
}

static void publish(struct canopy_tighten *t, float gap) {
    t->mean_gap = larger(gap, 0.0f) * t->range;
    t->published++;
}

float canopy_tighten_lid(const struct canopy_tighten *t) { return t->other != NULL ? LID_OVER : LID; }

static void fill_lid(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    for (size_t j = 0; j < count; j++) {
        t->b[j] = t->low + (int32_t)(canopy_tighten_lid(t) * t->range);
    }
}

// One row of cells of the certificate; CANOPY_MORE, CANOPY_OK, or what made it end.
static enum canopy_status mend(struct canopy_tighten *t, int32_t *b) {
    const enum canopy_status status = canopy_certify_step(t->certify, 1);
    if (status != CANOPY_NOT_SAFE) {
        return status;
    }
    return canopy_fast_raise(t->field, b, t->certify->failed_cell, t->certify->missing) == CANOPY_OK ? CANOPY_MORE
                                                                                                     : CANOPY_RANGE;
}

// ---- The start

void canopy_tighten_begin_start(struct canopy_tighten *t) {
    t->reach = reach_of(t, t->b, START_SPARE);
    canopy_tighten_go(t, CANOPY_TIGHTEN_START);
}

void canopy_tighten_publish_start(struct canopy_tighten *t) {
    publish(t, gap_of(t, t->b));
    canopy_tighten_first_iterate(t);
}

static void finish_raise(struct canopy_tighten *t) {
    if (t->field == NULL) {
        canopy_tighten_publish_start(t);
        return;
    }
    canopy_certify_begin(t->certify, t->b);
    canopy_tighten_go(t, CANOPY_TIGHTEN_START_MEND);
}

void canopy_tighten_raise_start(struct canopy_tighten *t) {
    const enum canopy_status status = canopy_tighten_look(t, CANOPY_TIGHTEN_LOOK_RAISE, t->b, t->reach);
    if (status == CANOPY_RANGE) {
        fill_lid(t);
    }
    if (status != CANOPY_MORE) {
        finish_raise(t);
    }
}

void canopy_tighten_mend_start(struct canopy_tighten *t) {
    const enum canopy_status status = mend(t, t->b);
    if (status == CANOPY_MORE) {
        return;
    }
    if (status != CANOPY_OK) {
        fill_lid(t);  // above every cell
    }
    canopy_tighten_publish_start(t);
}

// ---- Candidates

static void round_iterate(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    const int32_t low = t->low + (t->field != NULL ? CERTIFY_LOSS : 0);
    for (size_t j = 0; j < count; j++) {
        t->candidate[j] = t->seen[j] ? low + (int32_t)floorf(t->x[j] * t->range) : t->b[j];
    }
    t->reach = reach_of(t, t->candidate, SPARE);
}

// The iterate becomes a candidate.
void canopy_tighten_consider(struct canopy_tighten *t) {
    round_iterate(t);
    t->candidate_gap = larger(gap_of(t, t->candidate), 0.0f) * t->range;
    t->pending = !(t->candidate_gap < (1.0f - WORTH) * t->mean_gap);
    canopy_tighten_go(t, t->pending ? CANOPY_TIGHTEN_CLEAR : CANOPY_TIGHTEN_PUBLISH);
}

// No iterate comes any more.
void canopy_tighten_end(struct canopy_tighten *t) {
    if (t->pending) {
        t->ending = true;
        canopy_tighten_go(t, CANOPY_TIGHTEN_PUBLISH);
    } else {
        canopy_tighten_begin_bend(t);
    }
}

static void finish_candidate(struct canopy_tighten *t, float gap) {
    if (gap * t->range < t->mean_gap) {
        memcpy(t->b, t->candidate, 4 * canopy_tighten_coefficients(t));
        publish(t, gap);
    }
    t->pending = false;
    if (t->ending) {
        canopy_tighten_begin_bend(t);
    } else {
        canopy_tighten_go(t, CANOPY_TIGHTEN_CLEAR);
    }
}

void canopy_tighten_raise_candidate(struct canopy_tighten *t) {
    const enum canopy_status status = canopy_tighten_look(t, CANOPY_TIGHTEN_LOOK_RAISE, t->candidate, t->reach);
    if (status == CANOPY_MORE) {
        return;
    }
    const float gap = status == CANOPY_OK ? gap_of(t, t->candidate) : 1e30f;  // not this one
    if (t->field == NULL || !(gap * t->range < t->mean_gap)) {
        finish_candidate(t, gap);
        return;
    }
    canopy_certify_begin(t->certify, t->candidate);
    canopy_tighten_go(t, CANOPY_TIGHTEN_MEND);
}

void canopy_tighten_mend_candidate(struct canopy_tighten *t) {
    const enum canopy_status status = mend(t, t->candidate);
    if (status != CANOPY_MORE) {
        finish_candidate(t, status == CANOPY_OK ? gap_of(t, t->candidate) : 1e30f);
    }
}
