#include "tools/common/tightening.h"

#include <stdio.h>
#include <stdlib.h>

#include "lib/cover/certify.h"
#include "lib/cover/envelope.h"
#include "lib/cover/sandwich.h"
#include "lib/cover/tighten.h"
#include "tools/common/fielding.h"
#include "tools/common/progress.h"

#define STEPS 256  // units of work between looks at the progress: some milliseconds

struct job {
    const struct canopy_turned *turned;
    const struct canopy_frame *frame;
    struct canopy_tighten tighten;
    struct canopy_fielding from;
    struct canopy_certify certify;
    void *arena, *certify_arena;
    int32_t *mirror;
};

// The union's two members share their representation with the arrays that the library takes.
static enum canopy_status take_points(struct job *job) {
    const struct canopy_turned *turned = job->turned;
    return turned->scalar == CANOPY_F32
               ? canopy_tighten_points_f32(&job->tighten, (const float(*)[3]) & turned->points[0].f32, turned->count)
               : canopy_tighten_points_fx(&job->tighten, (const int32_t(*)[3]) & turned->points[0].fx, turned->count);
}

static enum canopy_status take_field(struct job *job, uint16_t q) {
    const enum canopy_status status = canopy_certify_init(&job->certify, &job->from.field, job->certify_arena,
                                                          CANOPY_CERTIFY_ARENA(job->frame->size[1], q, q));
    return status == CANOPY_OK ? canopy_tighten_field(&job->tighten, &job->from.field, &job->certify) : status;
}

/// How far it is from the tightest possible is the progress that it makes.
static void show(const struct canopy_tighten *tighten) {
    char stage[80];
    const double excess = (double)canopy_tighten_excess(tighten);
    const int used = snprintf(stage, sizeof stage, "tightening, iteration %u", tighten->iterations);
    if (tighten->iterations > 0 && excess < 10.0) {
        snprintf(stage + used, sizeof stage - (size_t)used, ", at most %.2g%% from the tightest", 100.0 * excess);
    }
    canopy_progress(stage, -1.0, 0);
}

static enum canopy_status tighten(struct job *job, uint16_t q, const struct canopy_tighten_size *size, size_t bytes,
                                  int32_t *coefficients, int32_t *opposite) {
    enum canopy_status status = canopy_tighten_init(&job->tighten, job->frame, size, job->arena, bytes);
    if (status == CANOPY_OK) {
        status = q > 0 ? take_field(job, q) : take_points(job);
    }
    if (status == CANOPY_OK && opposite) {
        status = canopy_sandwich_over(&job->tighten, opposite, job->mirror);
    }
    if (status == CANOPY_OK) {
        status = canopy_tighten_begin(&job->tighten, coefficients, false);
    }
    while (status == CANOPY_OK && canopy_tighten_step(&job->tighten, STEPS) == CANOPY_MORE) {
        show(&job->tighten);
    }
    return status;
}

bool canopy_tightening_run(const struct canopy_turned *turned, const struct canopy_frame *frame, uint16_t field,
                           bool packed, int32_t *coefficients, int32_t *opposite,
                           struct canopy_tightening_report *report, struct canopy_fault *fault) {
    const uint16_t m = frame->size[0], n = frame->size[1];
    const struct canopy_tighten_size size = {
        .points = field > 0 ? 0 : turned->count, .cells = {field, field}, .rows = (uint32_t)CANOPY_TIGHTEN_ROWS(m, n)};
    const size_t bytes = CANOPY_TIGHTEN_ARENA(m, n, field, field, size.points, size.rows);
    struct job job = {.turned = turned, .frame = frame};
    if (field > 0 && !canopy_fielding_open(&job.from, turned, frame, size.cells, packed, fault)) {
        return false;
    }
    job.arena = malloc(bytes);
    job.certify_arena = malloc(CANOPY_CERTIFY_ARENA(n, field, field));
    job.mirror = malloc(CANOPY_COEFFICIENTS(m, n) * sizeof *job.mirror);
    bool ok = (job.arena && job.certify_arena && job.mirror) || canopy_fault_no_memory(fault);
    if (ok) {
        ok = tighten(&job, field, &size, bytes, coefficients, opposite) == CANOPY_OK ||
             canopy_fault_set(fault, "the points cannot be tightened in this frame: choose --method fast or another "
                                     "--frame");
        report->iterations = job.tighten.iterations;
        report->excess = (double)canopy_tighten_excess(&job.tighten);
    }
    free(job.arena);
    canopy_fielding_close(&job.from);
    free(job.certify_arena);
    free(job.mirror);
    return ok;
}
