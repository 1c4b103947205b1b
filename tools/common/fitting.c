#include "tools/common/fitting.h"

#include <stdlib.h>

#include "lib/cover/certify.h"
#include "lib/cover/fast.h"
#include "lib/cover/field.h"
#include "lib/cover/sandwich.h"
#include "lib/cover/tighten.h"
#include "tools/common/stopwatch.h"

#define FIELD_BYTES_MOST (64U << 20)  // of a field that a fit from points chooses itself

/// How finely a fit looks: field cells a knot interval and lines a knot interval of u.
struct resolution {
    uint16_t cells[2];
    uint16_t lines;
};

/// From the points: the paper's construction, one line a knot interval of u that takes every point of the two intervals
/// beside it, with v told apart to 1/32 of an interval, or to what the pitch and memory leave.
static struct resolution choose(const struct canopy_frame *f, const struct canopy_fitting *fitting) {
    if (fitting->field) {
        return (struct resolution){.cells = {fitting->field, fitting->field},
                                   .lines = fitting->lines ? fitting->lines : 1};
    }
    uint16_t cells = CANOPY_CELLS_MAX;
    while (cells > 1 &&
           (cells > f->pitch[1] || CANOPY_FIELD_ARENA(f->size[0], f->size[1], 1, cells) > FIELD_BYTES_MOST)) {
        cells /= 2;
    }
    return (struct resolution){.cells = {1, cells}, .lines = 1};
}

static void feed(const struct canopy_turned *turned, struct canopy_field *field) {
    // The union's two members share their representation with the arrays that the library takes. A point that the field
    // refuses, the exact certificate still sees.
    if (turned->scalar == CANOPY_F32) {
        canopy_field_feed_f32(field, (const float(*)[3]) & turned->points[0].f32, turned->count);
    } else {
        canopy_field_feed_fx(field, (const int32_t(*)[3]) & turned->points[0].fx, turned->count);
    }
}

/// As the device does it: the field's own certificate, coefficients raised where it finds something missing.
static bool certify_field(const struct canopy_field *field, int32_t *coefficients, struct canopy_fault *fault) {
    const size_t bytes = CANOPY_CERTIFY_ARENA(field->frame.size[1], field->axis[0].cells, field->axis[1].cells);
    void *arena = malloc(bytes);
    struct canopy_certify certify;
    enum canopy_status status = arena ? canopy_certify_init(&certify, field, arena, bytes) : CANOPY_ARENA_SHORT;
    if (status == CANOPY_OK) {
        canopy_certify_begin(&certify, coefficients);
        while ((status = canopy_certify_step(&certify, UINT32_MAX)) == CANOPY_NOT_SAFE) {
            status = canopy_fast_raise(field, coefficients, certify.failed_cell, certify.missing);
            if (status != CANOPY_OK) {
                break;
            }
        }
    }
    free(arena);
    return status == CANOPY_OK ||
           canopy_fault_set(fault, "the field's certificate failed: choose another --grid or --field");
}

/// Feeds, solves and, from a field, certifies, in arenas that have been made.
static bool solve(const struct canopy_turned *turned, bool from_field, struct canopy_field *field,
                  struct canopy_fast *fast, int32_t *coefficients, struct canopy_fitting_report *report,
                  struct canopy_fault *fault) {
    feed(turned, field);
    if (canopy_fast_begin(fast, coefficients) != CANOPY_OK) {
        return canopy_fault_set(fault, "no point reaches the field: choose another --frame");
    }
    while (canopy_fast_step(fast, UINT32_MAX) == CANOPY_MORE) {}
    report->iterations = fast->solves;
    report->unsettled = fast->unsettled;
    bool ok = true;
    if (from_field && field->exact) {
        const double start = canopy_stopwatch_ms();
        ok = certify_field(field, coefficients, fault);
        report->field_ms = canopy_stopwatch_ms() - start;
    }
    return ok;
}

/// Takes the points into the tightening.
static enum canopy_status load(const struct canopy_turned *turned, struct canopy_tighten *tighten) {
    return turned->scalar == CANOPY_F32
               ? canopy_tighten_points_f32(tighten, (const float(*)[3]) & turned->points[0].f32, turned->count)
               : canopy_tighten_points_fx(tighten, (const int32_t(*)[3]) & turned->points[0].fx, turned->count);
}

/// Has the points looked at and the other side kept clear of, and goes as far as it goes.
static enum canopy_status run_tightening(const struct canopy_turned *turned, struct canopy_tighten *tightening,
                                         int32_t *coefficients, int32_t *opposite, int32_t *mirror) {
    enum canopy_status status = load(turned, tightening);
    if (status == CANOPY_OK && opposite) {
        status = canopy_sandwich_over(tightening, opposite, mirror);
    }
    if (status == CANOPY_OK) {
        status = canopy_tighten_begin(tightening, coefficients, false);
    }
    while (status == CANOPY_OK && canopy_tighten_step(tightening, UINT32_MAX) == CANOPY_MORE) {}
    return status;
}

/// Tightens what `fast` gave, clear of the other side's surface if there is one. The coefficients are not proved yet,
/// so they are raised where they must be first.
static bool tighten(const struct canopy_turned *turned, const struct canopy_frame *frame, int32_t *coefficients,
                    int32_t *opposite, struct canopy_fitting_report *report, struct canopy_fault *fault) {
    const size_t bytes = CANOPY_TIGHTEN_ARENA(frame->size[0], frame->size[1], turned->count);
    void *arena = malloc(bytes);
    int32_t *mirror = malloc((size_t)frame->size[0] * frame->size[1] * sizeof *mirror);
    if (!arena || !mirror) {
        free(arena);
        free(mirror);
        return canopy_fault_no_memory(fault);
    }
    struct canopy_tighten tightening;
    enum canopy_status status = canopy_tighten_init(&tightening, frame, turned->count, arena, bytes);
    if (status == CANOPY_OK) {
        status = run_tightening(turned, &tightening, coefficients, opposite, mirror);
    }
    if (status == CANOPY_OK) {
        report->iterations = tightening.iterations;
        report->excess = (double)canopy_tighten_excess(&tightening);
        report->paired = opposite != NULL;
    }
    free(arena);
    free(mirror);
    return status == CANOPY_OK ||
           canopy_fault_set(fault, "the points cannot be tightened in this frame: choose --method fast or another "
                                   "--frame");
}

/// The fast method, in the library's orientation.
static bool fit(const struct canopy_turned *turned, const struct canopy_frame *frame,
                const struct canopy_fitting *fitting, int32_t *coefficients, struct canopy_fitting_report *report,
                struct canopy_fault *fault) {
    const struct resolution r = choose(frame, fitting);
    const size_t field_bytes = CANOPY_FIELD_ARENA(frame->size[0], frame->size[1], r.cells[0], r.cells[1]);
    const size_t fast_bytes = CANOPY_FAST_ARENA(frame->size[0], frame->size[1], r.cells[1], r.lines);
    void *field_arena = malloc(field_bytes);
    void *fast_arena = malloc(fast_bytes);
    struct canopy_field field;
    struct canopy_fast fast;
    bool ok = false;
    *report = (struct canopy_fitting_report){0};
    if (!field_arena || !fast_arena) {
        canopy_fault_no_memory(fault);
    } else if (canopy_field_init(&field, frame, r.cells, field_arena, field_bytes) != CANOPY_OK ||
               canopy_fast_init(&fast, &field, turned->scalar, r.lines, fast_arena, fast_bytes) != CANOPY_OK) {
        canopy_fault_set(fault, "the frame has no room for this many cells: choose a smaller --unit or --field");
    } else {
        ok = solve(turned, fitting->field > 0, &field, &fast, coefficients, report, fault);
    }
    free(field_arena);
    free(fast_arena);
    return ok;
}

bool canopy_fitting_run(const struct canopy_turned *turned, const struct canopy_frame *frame,
                        const struct canopy_fitting *fitting, int32_t *coefficients,
                        struct canopy_fitting_report *report, struct canopy_fault *fault) {
    const bool ok = fit(turned, frame, fitting, coefficients, report, fault) &&
                    (!fitting->tight || tighten(turned, frame, coefficients, NULL, report, fault));
    canopy_fast_orient(frame, coefficients);
    return ok;
}

bool canopy_fitting_run_both(const struct canopy_turned *turned, const struct canopy_frame frame[2],
                             const struct canopy_fitting *fitting, int32_t *const coefficients[2],
                             struct canopy_fitting_report report[2], struct canopy_fault *fault) {
    int32_t *upper = coefficients[CANOPY_ABOVE];
    int32_t *lower = coefficients[CANOPY_BELOW];
    bool ok = true;
    for (int k = 0; ok && k < 2; k++) {
        ok = fit(turned, &frame[k], fitting, coefficients[k], &report[k], fault);
    }
    if (ok && fitting->tight) {
        canopy_sandwich_raise(upper, lower, (size_t)frame[0].size[0] * frame[0].size[1]);
        ok = tighten(turned, &frame[CANOPY_BELOW], lower, upper, &report[CANOPY_BELOW], fault) &&
             tighten(turned, &frame[CANOPY_ABOVE], upper, lower, &report[CANOPY_ABOVE], fault);
    }
    for (int k = 0; k < 2; k++) {
        canopy_fast_orient(&frame[k], coefficients[k]);
    }
    return ok;
}
