// The fit knows turned points, which are rounded. The frame that is published is the turned one, and what the turning's
// rounding moved is made good at the end, where exact.c measures the true margin of every true point and the surface is
// shifted by it.

#include "tools/common/surface.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lib/cover/sandwich.h"
#include "tools/common/framing.h"
#include "tools/common/refining.h"
#include "tools/common/stopwatch.h"
#include "tools/common/turn.h"

#define FROM_POINTS_CELLS 4  // the frame's Q when fitting from points

struct job {
    struct canopy_supply *points;
    const struct canopy_surface_wish *wish;
    struct canopy_fault *fault;
    struct canopy_turned turned;
    // By side; those of a side that is not wanted have no surrogate:
    struct canopy_frame frame[2];  ///< in turned coordinates, axes x, y, z
    int32_t *coefficients[2];
    struct canopy_surrogate *surrogate[2];
    struct canopy_surface_report *report[2];
};

static size_t coefficient_count(const struct job *job) { return (size_t)job->wish->size[0] * job->wish->size[1]; }

static bool turn(struct job *job) {
    const struct canopy_surface_wish *wish = job->wish;
    int32_t axes[3][3];
    if (wish->has_plane && !canopy_turn_axes_plane(wish->plane, axes)) {
        return canopy_fault_set(job->fault, "--plane on a line: give three points that are not");
    }
    if (!wish->has_plane && !canopy_turn_axes(wish->direction, axes)) {
        return canopy_fault_set(job->fault, "--dir without length: give the direction from the scene to the viewer");
    }
    for (int i = 0; wish->frame && i < 9; i++) {
        axes[i / 3][i % 3] = (int32_t)lrint(wish->frame->axes[i / 3][i % 3] * CANOPY_AXIS_ONE);
    }
    return canopy_turn_supply(job->points, axes, &job->turned, job->fault);
}

/// Elapsed time where several threads work, else processor time of this one.
static double clock_ms(const struct job *job) {
    return job->points->threads > 1 ? canopy_stopwatch_wall_ms() : canopy_stopwatch_ms();
}

/// One side's frame, grown by `quanta` if it is our own.
static bool frame(struct job *job, int side, int quanta) {
    const struct canopy_surface_wish *wish = job->wish;
    const struct canopy_grid grid = {.size = {wish->size[0], wish->size[1]},
                                     .cells = wish->fitting.field ? wish->fitting.field : FROM_POINTS_CELLS,
                                     .side = (uint8_t)side};
    struct canopy_frame *to = &job->frame[side];
    if (!wish->frame) {
        return canopy_framing_own(&job->turned, &grid, quanta, to, job->fault);
    }
    if (!job->turned.points && !canopy_framing_is_exact(wish->frame, &job->turned, &grid)) {
        // Points that are measured anew have to be held.
        canopy_turned_free(&job->turned);
        if (!canopy_supply_hold(job->points, job->fault) || !turn(job)) {
            return false;
        }
    }
    return canopy_framing_like(wish->frame, &job->points->list, &grid, &job->turned, to, job->fault);
}

// ---------------------------------------------------------------------------------------------------------------------
// From coefficients to a surrogate

static void publish_frame(const struct job *job, int side, struct canopy_surrogate *s) {
    const struct canopy_surrogate *like = job->wish->frame;
    if (like) {
        memcpy(s->origin, like->origin, sizeof s->origin);
        memcpy(s->axes, like->axes, sizeof s->axes);
        memcpy(s->pitch, like->pitch, sizeof s->pitch);
    } else {
        canopy_framing_publish(&job->frame[side], &job->turned, s);
    }
}

static bool store(const struct job *job, int side) {
    const struct canopy_frame *frame = &job->frame[side];
    struct canopy_surrogate *s = job->surrogate[side];
    s->side = (enum canopy_side)side;
    s->scalar = job->wish->scalar;
    s->unit = job->wish->unit;
    s->size[0] = frame->size[0];
    s->size[1] = frame->size[1];
    s->lsb = ldexp(1.0, frame->lsb_log2 + frame->quantum_log2);
    publish_frame(job, side, s);
    s->coefficients = malloc(coefficient_count(job) * sizeof *s->coefficients);
    s->trim = calloc((size_t)(s->size[0] - 1) * (s->size[1] - 1), 1);
    if (!s->coefficients || !s->trim) {
        return canopy_fault_no_memory(job->fault);
    }
    for (size_t i = 0; i < coefficient_count(job); i++) {
        s->coefficients[i] = (double)job->coefficients[side][i];
    }
    return true;
}

// ---------------------------------------------------------------------------------------------------------------------
// From a surrogate to a certified one

/// The exact pass; the first one also sees which knot cells are covered, which does not change with the coefficients.
static bool certify(const struct job *job, int side, bool first) {
    struct canopy_surrogate *s = job->surrogate[side];
    const double start = clock_ms(job);
    const bool ok = canopy_supply_check(job->points, s, first ? s->trim : NULL, &job->report[side]->result, job->fault);
    job->report[side]->certificate_ms = clock_ms(job) - start;
    return ok;
}

/// Shifts all coefficients by whole steps so that the smallest margin is as small as can be without being negative: the
/// B-splines sum to one, so the surface moves by exactly that. A fit from a field is lifted but never lowered: its
/// cells are promises about points to come.
static bool shift(const struct job *job, int side) {
    struct canopy_surrogate *s = job->surrogate[side];
    double steps = -floor(job->report[side]->result.margin / s->lsb);
    if (job->wish->fitting.field && steps < 0.0) {
        steps = 0.0;
    }
    if (side == CANOPY_BELOW) {
        steps = -steps;
    }
    for (size_t i = 0; i < coefficient_count(job); i++) {
        s->coefficients[i] += steps;
    }
    return steps != 0.0;
}

/// Fits the one side that is wanted, or both.
static bool fit(struct job *job) {
    const struct canopy_surface_wish *wish = job->wish;
    struct canopy_fitting_report reports[2];
    bool ok = false;
    if (job->surrogate[0] && job->surrogate[1]) {
        ok = canopy_fitting_run_both(&job->turned, job->frame, &wish->fitting, job->coefficients, reports, job->fault);
    } else {
        const int side = job->surrogate[0] ? 0 : 1;
        ok = canopy_fitting_run(&job->turned, &job->frame[side], &wish->fitting, job->coefficients[side],
                                &reports[side], job->fault);
    }
    for (int side = 0; side < 2; side++) {
        if (job->surrogate[side]) {
            job->report[side]->fitting = reports[side];
        }
    }
    return ok;
}

/// The exact pass over a side, and once more where it moves the surface. `*outside`: points are outside the frame.
static bool settle(const struct job *job, int side, bool *outside) {
    if (!certify(job, side, true)) {
        return false;
    }
    *outside = job->report[side]->result.outside > 0;
    return *outside || !shift(job, side) || certify(job, side, false);
}

/// One attempt with the frame grown by `quanta`. `*outside`: points were outside the frame, try a larger one.
static bool attempt(struct job *job, int quanta, bool *outside) {
    const double start = clock_ms(job);
    bool ok = true;
    *outside = false;
    for (int side = 0; side < 2; side++) {
        ok = ok && (!job->surrogate[side] || frame(job, side, quanta));
    }
    ok = ok && fit(job);
    for (int side = 0; side < 2; side++) {
        ok = ok && (!job->surrogate[side] || store(job, side));
    }
    const double fit_ms = clock_ms(job) - start;
    for (int side = 0; ok && !*outside && side < 2; side++) {
        if (job->surrogate[side]) {
            job->report[side]->fit_ms = fit_ms;
            ok = settle(job, side, outside);
        }
    }
    return ok;
}

/// Adds the windows to a side that is safe, and settles it again.
static bool refine(const struct job *job, int side) {
    const struct canopy_surface_wish *wish = job->wish;
    if (!wish->fitting.field && !canopy_supply_hold(job->points, job->fault)) {
        return false;
    }
    const struct canopy_cloud cloud = canopy_device_list_cloud(&job->points->list);
    const double start = clock_ms(job);
    const bool ok = wish->fitting.field
                        ? canopy_refining_field(&wish->refining, &job->turned, &job->frame[side], wish->fitting.field,
                                                wish->fitting.packed, job->surrogate[side], job->fault)
                        : canopy_refining_points(&wish->refining, &cloud, job->surrogate[side], job->fault);
    job->report[side]->fit_ms += clock_ms(job) - start;
    bool outside;
    return ok && settle(job, side, &outside);
}

/// What holds now is written into the surrogate: its coverage and its certificate.
static bool finish(const struct job *job, int side) {
    struct canopy_surrogate *s = job->surrogate[side];
    const struct canopy_exact_result *result = &job->report[side]->result;
    if (!canopy_exact_is_safe(result) || !(result->margin >= 0.0)) {
        return canopy_fault_set(job->fault,
                                "no safe surface came out; nothing was written: please report this with the points");
    }
    job->report[side]->windows = s->window_count;
    job->report[side]->coefficients = coefficient_count(job);
    for (size_t w = 0; w < s->window_count; w++) {
        job->report[side]->coefficients += (size_t)s->windows[w].size[0] * s->windows[w].size[1];
    }
    s->certified = true;
    s->margin = result->margin;
    s->points = (double)result->points;
    return true;
}

// ---------------------------------------------------------------------------------------------------------------------
// Both sides, apart

/// Whole coefficients as they are published, in the library's orientation: the lower side's are mirrored.
static void take_published(const struct job *job, int side) {
    for (size_t i = 0; i < coefficient_count(job); i++) {
        job->coefficients[side][i] = (int32_t)job->surrogate[side]->coefficients[i];
    }
    canopy_fast_orient(&job->frame[side], job->coefficients[side]);
}

/// Raises the upper surface off the lower one where shifting has made them cross: each coefficient to the lower one's
/// after a fast fit; after a tight one, which had them apart to a step, all alike. It moves away from the points, so
/// that it stays safe.
static bool part(const struct job *job) {
    int32_t *upper = job->coefficients[CANOPY_ABOVE];
    const int32_t *lower = job->coefficients[CANOPY_BELOW];
    const uint16_t *size = job->wish->size;
    int64_t least = INT64_MAX;
    take_published(job, CANOPY_ABOVE);
    take_published(job, CANOPY_BELOW);
    for (uint32_t row = 0; row + 1U < size[0]; row++) {
        const int64_t here = canopy_sandwich_least(upper, lower, size, row);
        least = here < least ? here : least;
    }
    if (least >= 0) {
        return true;
    }
    if (!job->wish->fitting.tight) {
        canopy_sandwich_raise(upper, lower, coefficient_count(job));
    }
    const double lift = job->wish->fitting.tight ? ceil((double)-least / CANOPY_SANDWICH_UNITS) : 0.0;
    for (size_t i = 0; i < coefficient_count(job); i++) {
        job->surrogate[CANOPY_ABOVE]->coefficients[i] = (double)upper[i] + lift;
    }
    return certify(job, CANOPY_ABOVE, false);
}

/// From what is going to be published, by code that shares nothing with the fit.
static bool prove_apart(const struct job *job, struct canopy_crossing *crossing) {
    if (!canopy_crossing_find(job->surrogate[CANOPY_ABOVE], job->surrogate[CANOPY_BELOW], crossing, job->fault)) {
        return false;
    }
    return crossing->verdict == CANOPY_CROSSING_NONE ||
           canopy_fault_set(
               job->fault, "the two surfaces could not be kept apart; nothing was written: please report this with the "
                           "points");
}

// ---------------------------------------------------------------------------------------------------------------------
// From points to surrogates

static void free_surrogates(const struct job *job) {
    for (int side = 0; side < 2; side++) {
        if (job->surrogate[side]) {
            canopy_surrogate_free(job->surrogate[side]);
        }
    }
}

/// Everything but proving both sides apart.
static bool run(struct job *job) {
    bool ok = true;
    for (int side = 0; side < 2; side++) {
        if (job->surrogate[side]) {
            memset(job->surrogate[side], 0, sizeof *job->surrogate[side]);
            job->coefficients[side] = malloc(coefficient_count(job) * sizeof **job->coefficients);
            ok = ok && (job->coefficients[side] || canopy_fault_no_memory(job->fault));
        }
    }
    ok = ok && turn(job);
    bool outside = ok;
    // Turned points are rounded, so the frame needs a quantum or two more than their box.
    for (int quanta = job->turned.along ? 0 : 2; ok && outside && quanta <= 1 << 20; quanta = quanta ? quanta * 4 : 1) {
        free_surrogates(job);
        ok = attempt(job, quanta, &outside);
    }
    if (ok && job->surrogate[0] && job->surrogate[1]) {
        ok = part(job);
    } else if (ok && job->wish->refining.count > 0) {
        ok = refine(job, (int)job->wish->side);
    }
    for (int side = 0; side < 2; side++) {
        ok = ok && (!job->surrogate[side] || finish(job, side));
    }
    return ok;
}

static bool end(struct job *job, bool ok) {
    free(job->coefficients[0]);
    free(job->coefficients[1]);
    canopy_turned_free(&job->turned);
    if (!ok) {
        free_surrogates(job);
    }
    return ok;
}

/// The methods that look at points one by one have them in memory.
static bool hold_for(const struct canopy_surface_wish *wish, struct canopy_supply *points, struct canopy_fault *fault) {
    return !wish->fitting.tight || wish->fitting.field > 0 || canopy_supply_hold(points, fault);
}

bool canopy_surface_fit_supply(struct canopy_supply *points, const struct canopy_surface_wish *wish,
                               struct canopy_surrogate *surrogate, struct canopy_surface_report *report,
                               struct canopy_fault *fault) {
    struct job job = {.points = points, .wish = wish, .fault = fault};
    job.surrogate[wish->side] = surrogate;
    job.report[wish->side] = report;
    return end(&job, hold_for(wish, points, fault) && run(&job));
}

bool canopy_surface_fit_both_supply(struct canopy_supply *points, const struct canopy_surface_wish *wish,
                                    struct canopy_surrogate surrogate[2], struct canopy_surface_report report[2],
                                    struct canopy_crossing *crossing, struct canopy_fault *fault) {
    struct job job = {.points = points,
                      .wish = wish,
                      .fault = fault,
                      .surrogate = {&surrogate[0], &surrogate[1]},
                      .report = {&report[0], &report[1]}};
    return end(&job, hold_for(wish, points, fault) && run(&job) && prove_apart(&job, crossing));
}

bool canopy_surface_fit(const struct canopy_device_list *points, const struct canopy_surface_wish *wish,
                        struct canopy_surrogate *surrogate, struct canopy_surface_report *report,
                        struct canopy_fault *fault) {
    struct canopy_supply supply = canopy_supply_of(points);
    return canopy_surface_fit_supply(&supply, wish, surrogate, report, fault);
}

bool canopy_surface_fit_both(const struct canopy_device_list *points, const struct canopy_surface_wish *wish,
                             struct canopy_surrogate surrogate[2], struct canopy_surface_report report[2],
                             struct canopy_crossing *crossing, struct canopy_fault *fault) {
    struct canopy_supply supply = canopy_supply_of(points);
    return canopy_surface_fit_both_supply(&supply, wish, surrogate, report, crossing, fault);
}
