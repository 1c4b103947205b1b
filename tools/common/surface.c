// The fit knows turned points, which are rounded. The frame that is published is the turned one, and what the turning's
// rounding moved is made good at the end, where exact.c measures the true margin of every true point and the surface is
// shifted by it.

#include "tools/common/surface.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tools/common/framing.h"
#include "tools/common/stopwatch.h"
#include "tools/common/turn.h"

#define FROM_POINTS_CELLS 4  // the frame's Q when fitting from points

struct job {
    const struct canopy_device_list *points;
    const struct canopy_surface_wish *wish;
    struct canopy_fault *fault;
    struct canopy_turned turned;
    struct canopy_frame frame;  ///< in turned coordinates, axes x, y, z
    int32_t *coefficients;
};

static bool turn(struct job *job) {
    const struct canopy_surface_wish *wish = job->wish;
    int32_t axes[3][3];
    if (!canopy_turn_axes(wish->direction, axes)) {
        return canopy_fault_set(job->fault, "--dir without length: give the direction from the scene to the viewer");
    }
    for (int i = 0; wish->frame && i < 9; i++) {
        axes[i / 3][i % 3] = (int32_t)lrint(wish->frame->axes[i / 3][i % 3] * CANOPY_AXIS_ONE);
    }
    return canopy_turn(job->points, axes, &job->turned, job->fault);
}

/// The frame, grown by `quanta` if it is our own.
static bool frame(struct job *job, int quanta) {
    const struct canopy_surface_wish *wish = job->wish;
    const struct canopy_grid grid = {.size = {wish->size[0], wish->size[1]},
                                     .cells = wish->fitting.field ? wish->fitting.field : FROM_POINTS_CELLS,
                                     .side = (uint8_t)wish->side};
    return wish->frame ? canopy_framing_like(wish->frame, &job->turned, &grid, &job->frame, job->fault)
                       : canopy_framing_own(&job->turned, &grid, quanta, &job->frame, job->fault);
}

// ---------------------------------------------------------------------------------------------------------------------
// From coefficients to a surrogate

static void publish_frame(const struct job *job, struct canopy_surrogate *s) {
    const struct canopy_surrogate *like = job->wish->frame;
    if (like) {
        memcpy(s->origin, like->origin, sizeof s->origin);
        memcpy(s->axes, like->axes, sizeof s->axes);
        memcpy(s->pitch, like->pitch, sizeof s->pitch);
    } else {
        canopy_framing_publish(&job->frame, &job->turned, s);
    }
}

static bool store(const struct job *job, struct canopy_surrogate *s) {
    const size_t count = (size_t)job->frame.size[0] * job->frame.size[1];
    s->side = job->wish->side;
    s->scalar = job->wish->scalar;
    s->unit = job->wish->unit;
    s->size[0] = job->frame.size[0];
    s->size[1] = job->frame.size[1];
    s->lsb = ldexp(1.0, job->frame.lsb_log2 + job->frame.quantum_log2);
    publish_frame(job, s);
    s->coefficients = malloc(count * sizeof *s->coefficients);
    s->trim = calloc((size_t)(s->size[0] - 1) * (s->size[1] - 1), 1);
    if (!s->coefficients || !s->trim) {
        return canopy_fault_no_memory(job->fault);
    }
    for (size_t i = 0; i < count; i++) {
        s->coefficients[i] = (double)job->coefficients[i];
    }
    return true;
}

// ---------------------------------------------------------------------------------------------------------------------
// From a surrogate to a certified one

static bool certify(const struct job *job, struct canopy_surrogate *s, struct canopy_surface_report *report) {
    const struct canopy_cloud cloud = canopy_device_list_cloud(job->points);
    const double start = canopy_stopwatch_ms();
    const bool ok = canopy_exact_check(s, &cloud, &report->result);
    report->certificate_ms = canopy_stopwatch_ms() - start;
    return ok || canopy_fault_no_memory(job->fault);
}

/// Shifts all coefficients by whole steps so that the smallest margin is as small as can be without being negative: the
/// B-splines sum to one, so the surface moves by exactly that. A fit from a field is lifted but never lowered: its
/// cells are promises about points to come.
static bool shift(const struct job *job, struct canopy_surrogate *s, const struct canopy_exact_result *result) {
    double steps = -floor(result->margin / s->lsb);
    if (job->wish->fitting.field && steps < 0.0) {
        steps = 0.0;
    }
    if (s->side == CANOPY_BELOW) {
        steps = -steps;
    }
    for (size_t i = 0; i < (size_t)s->size[0] * s->size[1]; i++) {
        s->coefficients[i] += steps;
    }
    return steps != 0.0;
}

/// One attempt with the frame grown by `quanta`. `*outside`: points were outside the frame, try a larger one.
static bool attempt(struct job *job, int quanta, struct canopy_surrogate *s, struct canopy_surface_report *report,
                    bool *outside) {
    const double start = canopy_stopwatch_ms();
    *outside = false;
    if (!frame(job, quanta) ||
        !canopy_fitting_run(&job->turned, &job->frame, &job->wish->fitting, job->coefficients, &report->fitting,
                            job->fault) ||
        !store(job, s)) {
        return false;
    }
    report->fit_ms = canopy_stopwatch_ms() - start;
    if (!certify(job, s, report)) {
        return false;
    }
    *outside = report->result.outside > 0;
    if (!*outside && shift(job, s, &report->result)) {
        return certify(job, s, report);
    }
    return true;
}

/// What holds now is written into the surrogate: its coverage and its certificate.
static bool finish(const struct job *job, struct canopy_surrogate *s, const struct canopy_surface_report *report) {
    if (!canopy_exact_is_safe(&report->result) || !(report->result.margin >= 0.0)) {
        return canopy_fault_set(job->fault,
                                "no safe surface came out; nothing was written: please report this with the points");
    }
    struct canopy_exact *exact = canopy_exact_open(s);
    if (!exact) {
        return canopy_fault_no_memory(job->fault);
    }
    const struct canopy_cloud cloud = canopy_device_list_cloud(job->points);
    canopy_exact_coverage(exact, &cloud, s->trim);
    canopy_exact_close(exact);
    s->certified = true;
    s->margin = report->result.margin;
    s->points = (double)report->result.points;
    return true;
}

bool canopy_surface_fit(const struct canopy_device_list *points, const struct canopy_surface_wish *wish,
                        struct canopy_surrogate *surrogate, struct canopy_surface_report *report,
                        struct canopy_fault *fault) {
    struct job job = {.points = points, .wish = wish, .fault = fault};
    memset(surrogate, 0, sizeof *surrogate);
    job.coefficients = malloc((size_t)wish->size[0] * wish->size[1] * sizeof *job.coefficients);
    bool ok = (job.coefficients || canopy_fault_no_memory(fault)) && turn(&job);
    bool outside = ok;
    // Turned points are rounded, so the frame needs a quantum or two more than their box.
    for (int quanta = job.turned.along ? 0 : 2; ok && outside && quanta <= 1 << 20; quanta = quanta ? quanta * 4 : 1) {
        canopy_surrogate_free(surrogate);
        ok = attempt(&job, quanta, surrogate, report, &outside);
    }
    ok = ok && finish(&job, surrogate, report);
    free(job.coefficients);
    canopy_turned_free(&job.turned);
    if (!ok) {
        canopy_surrogate_free(surrogate);
    }
    return ok;
}
