#include "lib/cover/sandwich.h"

#include <stdbool.h>
#include <string.h>

// ---- What any two surfaces are asked

enum { HALVES = 7, HALVES_UNIT = 48 };  // Bernstein coefficients of two halves, which share one, and their unit
_Static_assert(HALVES_UNIT *HALVES_UNIT == CANOPY_SANDWICH_UNITS, "once along u, once along v");

// From b[h-1] … b[h+2] to the Bernstein coefficients of the halves of knot interval h, times 48: those of the
// interval times 6, then de Casteljau at one half times 8. Once and again: below 2304 * 2^29 < 2^41.
static void to_halves(const int64_t b[4], int64_t to[HALVES]) {
    const int64_t p0 = b[0] + 4 * b[1] + b[2], p1 = 4 * b[1] + 2 * b[2];
    const int64_t p2 = 2 * b[1] + 4 * b[2], p3 = b[1] + 4 * b[2] + b[3], middle = p1 + p2;
    to[0] = 8 * p0;
    to[1] = 4 * (p0 + p1);
    to[2] = 2 * (p0 + p1 + middle);
    to[3] = p0 + 3 * middle + p3;
    to[4] = 2 * (middle + p2 + p3);
    to[5] = 4 * (p2 + p3);
    to[6] = 8 * p3;
}

static uint32_t clamped(uint32_t h, uint32_t a, uint32_t size) {  // h + a - 1, ends repeated
    const uint32_t i = h + a > 0 ? h + a - 1 : 0;
    return i < size ? i : size - 1;
}

// What two surfaces differ by over a row of knot cells: columns of coefficients, the ends repeated, along u in
// Bernstein form.
struct difference {
    const int32_t *upper, *lower;
    const uint16_t *size;
    uint32_t row;
    int64_t column[4][HALVES];  // column j at (j + 1) % 4
};

static void take_column(struct difference *d, uint32_t w, uint32_t b) {
    int64_t from[4];
    for (uint32_t a = 0; a < 4; a++) {
        const size_t at = (size_t)clamped(d->row, a, d->size[0]) * d->size[1] + clamped(w, b, d->size[1]);
        from[a] = (int64_t)d->upper[at] + d->lower[at];  // the lower one is mirrored
    }
    to_halves(from, d->column[(w + b) % 4]);
}

// The least over knot cell w, whose four columns have been taken.
static int64_t least_of_cell(const struct difference *d, uint32_t w) {
    int64_t least = INT64_MAX;
    for (int p = 0; p < HALVES; p++) {
        const int64_t from[4] = {d->column[w % 4][p], d->column[(w + 1) % 4][p], d->column[(w + 2) % 4][p],
                                 d->column[(w + 3) % 4][p]};
        int64_t value[HALVES];
        to_halves(from, value);
        for (int q = 0; q < HALVES; q++) {
            least = value[q] < least ? value[q] : least;
        }
    }
    return least;
}

static struct difference begin_row(const int32_t *upper, const int32_t *lower, const uint16_t size[2], uint32_t row) {
    struct difference d = {.upper = upper, .lower = lower, .size = size, .row = row};
    for (uint32_t b = 0; b < 3; b++) {
        take_column(&d, 0, b);
    }
    return d;
}

int64_t canopy_sandwich_least(const int32_t *upper, const int32_t *lower, const uint16_t size[2], uint32_t row) {
    struct difference d = begin_row(upper, lower, size, row);
    int64_t least = INT64_MAX;
    for (uint32_t w = 0; w + 1 < size[1]; w++) {
        take_column(&d, w, 3);
        const int64_t here = least_of_cell(&d, w);
        least = here < least ? here : least;
    }
    return least;
}

uint32_t canopy_sandwich_raise(int32_t *upper, const int32_t *lower, size_t count) {
    uint32_t raised = 0;
    for (size_t j = 0; j < count; j++) {
        if (upper[j] < -lower[j]) {
            upper[j] = -lower[j];
            raised++;
        }
    }
    return raised;
}

// ---- Both sides, fast, from two fields

// Whether two fields are of one frame, the second one's side apart, and cut it alike.
static bool are_opposite(const struct canopy_field *above, const struct canopy_field *below) {
    struct canopy_frame turned = below->frame;
    turned.side = CANOPY_ABOVE;
    return below->frame.side == CANOPY_BELOW && canopy_frame_difference(&above->frame, &turned) == CANOPY_SAME &&
           below->axis[0].cells == above->axis[0].cells && below->axis[1].cells == above->axis[1].cells;
}

enum canopy_status canopy_sandwich_init(struct canopy_sandwich *sandwich, const struct canopy_field *above,
                                        const struct canopy_field *below, const struct canopy_line_fit *fit,
                                        uint16_t lines, void *arena, size_t bytes) {
    const uint16_t cu = above->axis[0].cells, cv = above->axis[1].cells;
    if (!are_opposite(above, below) || !above->exact || !below->exact || lines == 0 || cu % lines != 0 || fit == NULL) {
        return CANOPY_ARGUMENT;
    }
    struct canopy_arena cut;
    const enum canopy_status status = canopy_arena_open(
        &cut, arena, bytes, CANOPY_SANDWICH_ARENA(above->frame.size[0], above->frame.size[1], cu, cv, lines));
    if (status == CANOPY_OK) {
        *sandwich = (struct canopy_sandwich){
            .field = {above, below}, .arena = arena, .bytes = bytes, .fit = fit, .lines = lines};
    }
    return status;
}

size_t canopy_sandwich_feed_fx(struct canopy_field *above, struct canopy_field *below, const int32_t (*points)[3],
                               size_t count) {
    size_t refused = 0;
    for (size_t i = 0; i < count; i++) {
        struct canopy_field_hit hit;
        const enum canopy_status high = canopy_field_insert_fx(above, points[i], &hit);
        const enum canopy_status low = canopy_field_insert_fx(below, points[i], &hit);
        refused += high != CANOPY_OK || low != CANOPY_OK;
    }
    return refused;
}

// From one stage to the next; each begins what its steps go on with.

static enum canopy_status begin_fit(struct canopy_sandwich *s, enum canopy_side side) {
    s->stage = CANOPY_SANDWICH_FIT;
    s->side = (uint8_t)side;
    const enum canopy_status status = canopy_fast_init(&s->fast, s->field[side], s->fit, s->lines, s->arena, s->bytes);
    return status == CANOPY_OK ? canopy_fast_begin(&s->fast, s->b[side]) : status;
}

static enum canopy_status begin_certify(struct canopy_sandwich *s, enum canopy_side side) {
    s->stage = CANOPY_SANDWICH_CERTIFY;
    s->side = (uint8_t)side;
    const enum canopy_status status = canopy_certify_init(&s->certify, s->field[side], s->arena, s->bytes);
    if (status == CANOPY_OK) {
        canopy_certify_begin(&s->certify, s->b[side]);
    }
    return status;
}

static size_t count_of(const struct canopy_sandwich *s) {
    return (size_t)s->field[0]->frame.size[0] * s->field[0]->frame.size[1];
}

static enum canopy_status finish_fit(struct canopy_sandwich *s) {
    s->solves += s->fast.solves;
    s->unsettled += s->fast.unsettled;
    return s->side == CANOPY_ABOVE ? begin_fit(s, CANOPY_BELOW) : begin_certify(s, CANOPY_BELOW);
}

// What is lacking is raised before the upper surface is raised to the lower one, and in the upper one after it.
static enum canopy_status finish_certify(struct canopy_sandwich *s) {
    s->margin[s->side] = s->certify.margin;
    if (s->side == CANOPY_BELOW) {
        s->raised = canopy_sandwich_raise(s->b[CANOPY_ABOVE], s->b[CANOPY_BELOW], count_of(s));
        return begin_certify(s, CANOPY_ABOVE);
    }
    s->stage = CANOPY_SANDWICH_CHECK;
    s->row = 0;
    s->least = INT64_MAX;
    return CANOPY_OK;
}

enum canopy_status canopy_sandwich_begin(struct canopy_sandwich *sandwich, int32_t *upper, int32_t *lower) {
    struct canopy_sandwich *s = sandwich;
    s->b[CANOPY_ABOVE] = upper;
    s->b[CANOPY_BELOW] = lower;
    s->solves = s->unsettled = s->raised = 0;
    const enum canopy_status status = begin_fit(s, CANOPY_ABOVE);
    s->stage = status == CANOPY_OK ? s->stage : CANOPY_SANDWICH_IDLE;
    return status;
}

static enum canopy_status step_certify(struct canopy_sandwich *s, uint32_t budget) {
    const enum canopy_status status = canopy_certify_step(&s->certify, budget);
    if (status != CANOPY_NOT_SAFE) {
        return status;
    }
    const enum canopy_status raised =
        canopy_fast_raise(s->field[s->side], s->b[s->side], s->certify.failed_cell, s->certify.missing);
    return raised == CANOPY_OK ? CANOPY_MORE : raised;
}

static enum canopy_status step_check(struct canopy_sandwich *s, uint32_t budget) {
    const uint16_t *size = s->field[0]->frame.size;
    for (; budget > 0 && s->row + 1U < size[0]; budget--) {
        const int64_t least = canopy_sandwich_least(s->b[CANOPY_ABOVE], s->b[CANOPY_BELOW], size, s->row++);
        s->least = least < s->least ? least : s->least;
    }
    return s->least < 0 ? CANOPY_NOT_SAFE : s->row + 1U < size[0] ? CANOPY_MORE : CANOPY_OK;
}

// One stage's steps, and the beginning of the next one.
static enum canopy_status step_stage(struct canopy_sandwich *s, uint32_t budget) {
    enum canopy_status status = CANOPY_OK;
    switch (s->stage) {
    case CANOPY_SANDWICH_FIT:
        status = canopy_fast_step(&s->fast, budget);
        return status == CANOPY_OK ? finish_fit(s) : status;
    case CANOPY_SANDWICH_CERTIFY:
        status = step_certify(s, budget);
        return status == CANOPY_OK ? finish_certify(s) : status;
    default:
        status = step_check(s, budget);
        s->stage = status == CANOPY_OK ? CANOPY_SANDWICH_DONE : s->stage;
        return status;
    }
}

enum canopy_status canopy_sandwich_step(struct canopy_sandwich *sandwich, uint32_t budget) {
    struct canopy_sandwich *s = sandwich;
    if (s->stage == CANOPY_SANDWICH_IDLE) {
        return CANOPY_EMPTY;
    }
    if (s->stage == CANOPY_SANDWICH_FAILED) {
        return (enum canopy_status)s->failure;
    }
    if (budget > 0 && s->stage != CANOPY_SANDWICH_DONE) {
        const enum canopy_status status = step_stage(s, budget);
        if (status != CANOPY_OK && status != CANOPY_MORE) {
            s->stage = CANOPY_SANDWICH_FAILED;
            s->failure = (uint8_t)status;
            return status;
        }
    }
    return s->stage == CANOPY_SANDWICH_DONE ? CANOPY_OK : CANOPY_MORE;
}

// ---- What is free

#define HALF_WAYS 8  // sweeps that go half of the way; those that follow go all of it
#define SWEEPS 64

void canopy_sandwich_ease_begin(struct canopy_sandwich_ease *ease, const uint16_t size[2], const int32_t *const pair[2],
                                int32_t *const wish[2]) {
    *ease = (struct canopy_sandwich_ease){
        .pair = {pair[0], pair[1]}, .wish = {wish[0], wish[1]}, .size = {size[0], size[1]}};
}

// Moves the wish for a knot cell's coefficients towards what keeps the surfaces apart.
static void yield(const struct canopy_sandwich_ease *ease, uint32_t w) {
    for (uint32_t k = 0; k < 32; k++) {
        const size_t at =
            (size_t)clamped(ease->row, k / 4 % 4, ease->size[0]) * ease->size[1] + clamped(w, k % 4, ease->size[1]);
        int32_t *wish = &ease->wish[k / 16][at];
        const int32_t there = ease->pair[k / 16][at], way = there - *wish;
        *wish = ease->sweeps < HALF_WAYS ? *wish + way / 2 : there;
    }
}

static void ease_row(struct canopy_sandwich_ease *ease) {
    struct difference d = begin_row(ease->wish[0], ease->wish[1], ease->size, ease->row);
    for (uint32_t w = 0; w + 1 < ease->size[1]; w++) {
        take_column(&d, w, 3);
        if (least_of_cell(&d, w) < 0) {
            yield(ease, w);
            for (uint32_t b = 0; b < 4; b++) {
                take_column(&d, w, b);
            }
            ease->moved = true;
        }
    }
}

enum canopy_status canopy_sandwich_ease_step(struct canopy_sandwich_ease *ease, uint32_t rows) {
    for (; rows > 0 && !ease->done; rows--) {
        ease_row(ease);
        if (++ease->row + 1U < ease->size[0]) {
            continue;
        }
        ease->done = !ease->moved;
        ease->moved = false;
        ease->row = 0;
        if (++ease->sweeps == SWEEPS && !ease->done) {
            const size_t bytes = 4 * (size_t)ease->size[0] * ease->size[1];
            memcpy(ease->wish[0], ease->pair[0], bytes);
            memcpy(ease->wish[1], ease->pair[1], bytes);
            ease->done = true;
        }
    }
    return ease->done ? CANOPY_OK : CANOPY_MORE;
}
