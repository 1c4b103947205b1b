// The questions: extremes, planes, volumes.

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "tools/canopy/queried_parts.h"
#include "tools/common/option.h"

// ---------------------------------------------------------------------------------------------------------------------
// Extremes

enum { NODES = 65536 };

static bool find(const struct canopy_query_subject *subject, const struct canopy_query_rect *rect,
                 enum canopy_extreme_kind kind, uint32_t budget, struct canopy_extreme_answer *answer,
                 const struct canopy_queried *surface, struct canopy_fault *fault) {
    struct canopy_extreme_node *nodes = malloc(NODES * sizeof *nodes);
    struct canopy_extreme search;
    enum canopy_status status =
        nodes ? canopy_extreme_begin(&search, subject, rect, kind, 2, nodes, NODES) : CANOPY_ARENA_SHORT;
    if (status == CANOPY_OK) {
        status = canopy_extreme_step(&search, budget);
        *answer = canopy_extreme_answer(&search);
    }
    free(nodes);
    if (status == CANOPY_EMPTY) {
        return canopy_fault_set(fault,
                                "%s: no knot cell in question is covered by data: leave out --covered, or ask "
                                "about a larger --window",
                                surface->path);
    }
    return status == CANOPY_OK || status == CANOPY_MORE || canopy_queried_no_memory(surface, fault);
}

/// What the subject is at least (the highest asked for) or at most at the place of an answer, from the envelopes on the
/// other side. `attained` is of those that were asked, which may be `apart` off everywhere: this is another way, good
/// where the envelopes differ in few places. Returns the better of the two.
static int32_t attained_at(const struct canopy_queried_question *q, const struct canopy_extreme_answer *answer,
                           bool up) {
    const int32_t sign = up ? 1 : -1;
    const int32_t apart = q->surface->apart + (q->minus ? q->minus->apart : 0) + q->slack;
    const int32_t general = answer->attained - sign * apart;
    if (apart == q->slack) {
        return general;
    }
    int32_t surface[2] = {0, 0}, minus[2] = {0, 0};
    (void)canopy_envelope_height(up ? &q->surface->low : &q->surface->high, answer->at[0], answer->at[1], &surface[0],
                                 &surface[1]);  // cannot fail: the place is in the frame
    if (q->minus) {
        (void)canopy_envelope_height(up ? &q->minus->high : &q->minus->low, answer->at[0], answer->at[1], &minus[0],
                                     &minus[1]);
    }
    double plane = 0.0;
    if (q->plane) {
        const double pitch = q->surface->low.frame.pitch[0];
        plane = ((double)q->plane->at_origin + (double)q->plane->rise[0] * answer->at[0] / pitch +
                 (double)q->plane->rise[1] * answer->at[1] / pitch) /
                (double)CANOPY_QUERY_PLANE_ONE;
    }
    const int32_t there = up ? surface[0] - minus[1] : surface[1] - minus[0];
    const int32_t here = there - (int32_t)lrint(plane) - sign * (1 + q->slack);
    return (here - general) * sign > 0 ? here : general;
}

bool canopy_queried_print(const struct canopy_queried_question *question, const struct canopy_queried_options *options,
                          enum canopy_extreme_kind kind, const char *name, struct canopy_fault *fault) {
    const struct canopy_queried *surface = question->surface, *minus = question->minus;
    const bool up = kind == CANOPY_HIGHEST, from_zero = !minus && !question->plane;
    struct canopy_query_rect rect;
    uint32_t budget = 1000000;
    if (!canopy_queried_window(surface, options, &rect, fault) ||
        (options->budget && !canopy_option_whole32("budget", options->budget, 0, UINT32_MAX, &budget, fault))) {
        return false;
    }
    const struct canopy_query_subject subject = {.surface = up ? &surface->high : &surface->low,
                                                 .minus = !minus ? NULL
                                                          : up   ? &minus->low
                                                                 : &minus->high,
                                                 .plane = question->plane,
                                                 .covered = options->covered};
    struct canopy_extreme_answer answer = {.found = false};
    if (!find(&subject, &rect, kind, budget, &answer, surface, fault)) {
        return false;
    }
    const int32_t sign = up ? 1 : -1;
    printf("%s %.17g", name,
           canopy_queried_height(surface, answer.bound + sign * question->slack, question->step, from_zero, up));
    if (answer.found) {
        double place[2];
        canopy_queried_place(surface, answer.at, place);
        printf(" attained %.17g at %.10g %.10g",
               canopy_queried_height(surface, attained_at(question, &answer, up), question->step, from_zero, !up),
               place[0], place[1]);
    }
    putchar('\n');
    return true;
}

// ---------------------------------------------------------------------------------------------------------------------
// Planes

/// x / step in 2^-16 steps, rounded down.
static int64_t in_steps(mpq_t x, double step) {
    mpq_t y;
    mpz_t whole;
    mpq_init(y);
    mpz_init(whole);
    mpq_set_d(y, step);
    mpq_div(x, x, y);
    mpq_mul_2exp(x, x, 16);
    mpz_fdiv_q(whole, mpq_numref(x), mpq_denref(x));
    const int64_t steps = mpz_get_si(whole);
    mpz_clear(whole);
    mpq_clear(y);
    return steps;
}

/// The plane in device units above the frame's origin: its height at the corner u = v = 0, and its rise a knot
/// interval. With o the origin along the axes: A (o0 + u p0) + B (o1 + v p1) + C / unit - o2.
static void place_plane(const struct canopy_surrogate *s, const double abc[3], mpq_t plane[3]) {
    mpq_t x;
    mpq_init(x);
    mpq_set_d(plane[0], abc[2]);
    mpq_set_d(x, s->unit);
    mpq_div(plane[0], plane[0], x);
    for (int axis = 0; axis < 3; axis++) {
        canopy_queried_origin(x, s, axis);
        canopy_queried_multiply(x, axis < 2 ? abc[axis] : -1.0);
        mpq_add(plane[0], plane[0], x);
    }
    for (int axis = 0; axis < 2; axis++) {
        mpq_set_ui(plane[1 + axis], 0, 1);
        canopy_queried_add_product(plane[1 + axis], abc[axis], s->pitch[axis]);
    }
    mpq_clear(x);
}

bool canopy_queried_scale_plane(struct canopy_queried *surface, const double abc[3],
                                struct canopy_queried_question *question, struct canopy_query_plane *plane) {
    struct canopy_queried *const all[] = {surface};
    const struct canopy_surrogate *s = &surface->surrogate;
    mpq_t parts[3];
    mpq_inits(parts[0], parts[1], parts[2], NULL);
    place_plane(s, abc, parts);
    const double far = fabs(mpq_get_d(parts[0])) + fabs(mpq_get_d(parts[1])) * ((double)s->size[0] - 1.0) +
                       fabs(mpq_get_d(parts[2])) * ((double)s->size[1] - 1.0);
    const bool ok = far < 1e300;
    if (ok) {
        question->step = canopy_queried_scale(all, 1, far * 1.0001);
    }
    if (ok && question->step > 0.0) {
        // The envelope's knot intervals may be parts of the surrogate's.
        mpq_div_2exp(parts[1], parts[1], surface->level);
        mpq_div_2exp(parts[2], parts[2], surface->level);
        plane->at_origin = in_steps(parts[0], question->step);
        plane->rise[0] = in_steps(parts[1], question->step);
        plane->rise[1] = in_steps(parts[2], question->step);
        question->plane = plane;
        // Each of the three is rounded by 2^-16 step, two of them times knot intervals.
        question->slack = 1 + (int32_t)(((s->size[0] + s->size[1]) << surface->level) >> 16);
    }
    mpq_clears(parts[0], parts[1], parts[2], NULL);
    return ok;
}

// ---------------------------------------------------------------------------------------------------------------------
// Volumes

/// Adds up a subject; false if a coefficient is beyond its limit, which scaling prevents.
static bool add_up(const struct canopy_envelope *surface, const struct canopy_envelope *minus,
                   const struct canopy_query_rect *rect, bool covered, struct canopy_volume *volume) {
    const struct canopy_query_subject subject = {.surface = surface, .minus = minus, .covered = covered};
    return canopy_volume_begin(volume, &subject, rect) == CANOPY_OK &&
           canopy_volume_step(volume, UINT32_MAX) == CANOPY_OK;
}

/// quanta^2 to input units^2.
static void scale_area(mpq_t x, const struct canopy_surrogate *s) {
    for (int axis = 0; axis < 2; axis++) {
        canopy_queried_multiply(x, s->pitch[axis] / CANOPY_QUERIED_PITCH);
        canopy_queried_multiply(x, s->unit);
    }
}

/// mantissa * 2^exponent quanta^2 steps, less `height` above the frame's origin times the area, in input units^3.
static double volume_of(const struct canopy_surrogate *s, int64_t mantissa, int exponent, double step, mpq_t height,
                        const mpq_t area, bool upward) {
    mpq_t x, y;
    mpq_inits(x, y, NULL);
    mpq_set_si(x, mantissa, 1);
    if (exponent >= 0) {
        mpq_mul_2exp(x, x, (mp_bitcnt_t)exponent);
    } else {
        mpq_div_2exp(x, x, (mp_bitcnt_t)-exponent);
    }
    canopy_queried_multiply(x, step);
    canopy_queried_multiply(x, s->unit);
    scale_area(x, s);
    mpq_mul(y, height, area);
    mpq_sub(x, x, y);
    const double volume = canopy_queried_round(x, upward);
    mpq_clears(x, y, NULL);
    return volume;
}

bool canopy_queried_find_volume(const struct canopy_queried *surface, const struct canopy_queried *minus, double step,
                                double height, const struct canopy_query_rect *rect, bool covered,
                                struct canopy_queried_volume *volume, struct canopy_fault *fault) {
    const struct canopy_surrogate *s = &surface->surrogate;
    struct canopy_volume low, high;
    if (!add_up(&surface->low, minus ? &minus->high : NULL, rect, covered, &low) ||
        !add_up(&surface->high, minus ? &minus->low : NULL, rect, covered, &high)) {
        return canopy_fault_set(fault,
                                "%s: its coefficients are beyond what can be added up: write the file anew with "
                                "canopy fit",
                                surface->path);
    }
    mpq_t area, above, base;
    mpq_inits(area, above, base, NULL);
    mpz_set_ui(mpq_numref(area), (unsigned long)low.area);
    scale_area(area, s);
    if (!minus) {
        canopy_queried_origin(base, s, 2);
        canopy_queried_multiply(base, s->unit);
        mpq_set_d(above, height);
        mpq_sub(above, above, base);
    }
    const struct canopy_volume_answer from = canopy_volume_answer(&low), to = canopy_volume_answer(&high);
    *volume = (struct canopy_queried_volume){
        .low = volume_of(s, from.low, from.exponent, step, above, area, false),
        .high = volume_of(s, to.high, to.exponent, step, above, area, true),
        .area = mpq_get_d(area),
        .cells = low.cells,
    };
    mpq_clears(area, above, base, NULL);
    return true;
}
