#include "tools/common/fitting.h"

#include <stdlib.h>
#include <string.h>

#include "lib/cover/certify.h"
#include "lib/cover/envelope.h"
#include "lib/cover/fast.h"
#include "lib/cover/free.h"
#include "lib/cover/sandwich.h"
#include "tools/common/crew.h"
#include "tools/common/fielding.h"
#include "tools/common/progress.h"
#include "tools/common/stopwatch.h"
#include "tools/common/tightening.h"

#define STEPS 64  // of a line, or rows of cells, between looks at the progress: some milliseconds at most
#define FIELD_BYTES_MOST (64U << 20)  // of a field that a fit from points chooses itself

#define CREW_COEFFICIENTS 10000  // from which on threads are worth their start

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

/// As the device does it: the field's own certificate, coefficients raised where it finds something missing.
static bool certify_field(const struct canopy_field *field, int32_t *coefficients, struct canopy_fault *fault) {
    const size_t bytes = CANOPY_CERTIFY_ARENA(field->frame.size[1], field->axis[0].cells, field->axis[1].cells);
    void *arena = malloc(bytes);
    struct canopy_certify certify;
    enum canopy_status status = arena ? canopy_certify_init(&certify, field, arena, bytes) : CANOPY_ARENA_SHORT;
    if (status == CANOPY_OK) {
        canopy_certify_begin(&certify, coefficients);
        const double rows = (double)field->axis[0].count;
        while ((status = canopy_certify_step(&certify, STEPS)) == CANOPY_NOT_SAFE || status == CANOPY_MORE) {
            canopy_progress("proving cells", (double)certify.row / rows, 0);
            if (status == CANOPY_NOT_SAFE) {
                status = canopy_fast_raise(field, coefficients, certify.failed_cell, certify.missing);
                if (status != CANOPY_OK) {
                    break;
                }
            }
        }
    }
    free(arena);
    return status == CANOPY_OK ||
           canopy_fault_set(fault, "the field's certificate failed: choose another --grid or --field");
}

/// Solves and, from a field that was asked for, certifies.
static bool solve(const struct canopy_fitting *fitting, const struct canopy_field *field, struct canopy_fast *fast,
                  int32_t *coefficients, struct canopy_fitting_report *report, struct canopy_fault *fault) {
    if (canopy_fast_begin(fast, coefficients) != CANOPY_OK) {
        return canopy_fault_set(fault, "no point reaches the field: choose another --frame");
    }
    const uint16_t *size = field->frame.size;
    if (fitting->threads > 1 && (size_t)size[0] * size[1] >= CREW_COEFFICIENTS &&
        !canopy_crew_run(fast, fitting->threads, fault)) {
        return false;
    }
    while (canopy_fast_step(fast, STEPS) == CANOPY_MORE) {
        const bool lines = fast->stage == CANOPY_FAST_LINES;
        const double all = lines ? (double)CANOPY_LINE_NODES(size[0], fast->lines) : (double)size[1];
        canopy_progress(lines ? "fitting lines" : "fitting columns", (double)fast->index / all, 0);
    }
    report->iterations = fast->solves;
    report->unsettled = fast->unsettled;
    bool ok = true;
    if (fitting->field > 0 && field->exact) {
        const double start = canopy_stopwatch_ms();
        ok = certify_field(field, coefficients, fault);
        report->field_ms = canopy_stopwatch_ms() - start;
    }
    return ok;
}

static void transpose(const int32_t *from, const uint16_t size[2], int32_t *to) {
    for (size_t i = 0; i < size[0]; i++) {
        for (size_t j = 0; j < size[1]; j++) {
            to[j * size[0] + i] = from[i * size[1] + j];
        }
    }
}

/// The frame with its first two axes exchanged, which are x and y in turned coordinates.
static struct canopy_frame exchange(const struct canopy_frame *frame) {
    struct canopy_frame to = *frame;
    for (int a = 0; a < 2; a++) {
        to.origin[a] = frame->origin[1 - a];
        to.pitch[a] = frame->pitch[1 - a];
        to.size[a] = frame->size[1 - a];
    }
    return to;
}

static union canopy_device_point *exchange_points(const struct canopy_turned *turned) {
    union canopy_device_point *points = turned->points ? malloc(turned->count * sizeof *points) : NULL;
    for (size_t p = 0; points && p < turned->count; p++) {
        points[p] = turned->points[p];
        points[p].fx[0] = turned->points[p].fx[1];  // the bits of either scalar
        points[p].fx[1] = turned->points[p].fx[0];
    }
    return points;
}

/// The same with the axes exchanged, for a grid that is wider than it is long: the matrix is as wide as the second axis
/// has coefficients, and 4 x 1024 would take minutes where 1024 x 4 takes a fifth of a second.
static bool tighten_across(const struct canopy_turned *turned, const struct canopy_frame *frame,
                           const struct canopy_fitting *fitting, int32_t *coefficients, int32_t *opposite,
                           struct canopy_tightening_report *report, struct canopy_fault *fault) {
    const struct canopy_frame across = exchange(frame);
    const size_t count = (size_t)frame->size[0] * frame->size[1];
    struct canopy_turned exchanged = *turned;
    union canopy_device_point *points = exchange_points(turned);
    int32_t *sides[2] = {malloc(count * sizeof **sides), malloc(count * sizeof **sides)};
    bool ok = (points || !turned->points) && sides[0] && sides[1];
    exchanged.points = points;
    exchanged.exchanged = true;
    if (!ok) {
        canopy_fault_no_memory(fault);
    } else {
        transpose(coefficients, frame->size, sides[0]);
        if (opposite) {
            transpose(opposite, frame->size, sides[1]);
        }
        ok = canopy_tightening_run(&exchanged, &across, fitting->field, fitting->packed, sides[0],
                                   opposite ? sides[1] : NULL, report, fault);
        transpose(sides[0], across.size, coefficients);
        if (opposite) {
            transpose(sides[1], across.size, opposite);
        }
    }
    free(points);
    free(sides[0]);
    free(sides[1]);
    return ok;
}

/// Tightens what `fast` gave, clear of the other side's surface if there is one.
static bool tighten(const struct canopy_turned *turned, const struct canopy_frame *frame,
                    const struct canopy_fitting *fitting, int32_t *coefficients, int32_t *opposite,
                    struct canopy_fitting_report *report, struct canopy_fault *fault) {
    struct canopy_tightening_report tightened;
    const bool wide = frame->size[1] > frame->size[0];
    if (!(wide ? tighten_across(turned, frame, fitting, coefficients, opposite, &tightened, fault)
               : canopy_tightening_run(turned, frame, fitting->field, fitting->packed, coefficients, opposite,
                                       &tightened, fault))) {
        return false;
    }
    report->iterations = tightened.iterations;
    report->excess = tightened.excess;
    report->paired = opposite != NULL;
    return true;
}

/// The fast method, in the library's orientation. `coverage`, if not NULL, receives which knot cells have points.
static bool fit(const struct canopy_turned *turned, const struct canopy_frame *frame,
                const struct canopy_fitting *fitting, int32_t *coefficients, uint8_t *coverage,
                struct canopy_fitting_report *report, struct canopy_fault *fault) {
    const struct resolution r = choose(frame, fitting);
    const size_t fast_bytes = CANOPY_FAST_ARENA(frame->size[0], frame->size[1], r.cells[1], r.lines);
    struct canopy_fielding from;
    *report = (struct canopy_fitting_report){0};
    if (!canopy_fielding_open(&from, turned, frame, r.cells, fitting->packed, fault)) {
        return false;
    }
    void *fast_arena = malloc(fast_bytes);
    struct canopy_fast fast;
    bool ok = false;
    if (!fast_arena) {
        canopy_fault_no_memory(fault);
    } else if (canopy_fast_init(&fast, &from.field, canopy_line_fit_of(turned->scalar), r.lines, fast_arena,
                                fast_bytes) != CANOPY_OK) {
        canopy_fault_set(fault, "%u lines a knot interval: give a divisor of the field's %u cells", r.lines,
                         r.cells[0]);
    } else {
        ok = solve(fitting, &from.field, &fast, coefficients, report, fault);
        if (coverage) {
            canopy_field_coverage(&from.field, coverage);
        }
    }
    free(fast_arena);
    canopy_fielding_close(&from);
    return ok;
}

bool canopy_fitting_run(const struct canopy_turned *turned, const struct canopy_frame *frame,
                        const struct canopy_fitting *fitting, int32_t *coefficients,
                        struct canopy_fitting_report *report, struct canopy_fault *fault) {
    const bool ok = fit(turned, frame, fitting, coefficients, NULL, report, fault) &&
                    (!fitting->tight || tighten(turned, frame, fitting, coefficients, NULL, report, fault));
    canopy_fast_orient(frame, coefficients);
    return ok;
}

/// Fills what is free of both sides smoothly, as far as they stay apart; `wish` has room for both.
static void ease(const struct canopy_frame *frame, int32_t *const coefficients[2], const uint8_t *seen, int32_t *wish) {
    const size_t count = (size_t)frame->size[0] * frame->size[1];
    int32_t *const wishes[2] = {wish, wish + count};
    for (int k = 0; k < 2; k++) {
        struct canopy_free work;
        memcpy(wishes[k], coefficients[k], count * sizeof *wish);
        if (canopy_free_begin(&work, frame->size, seen, wishes[k]) == CANOPY_OK) {
            canopy_free_straighten(&work);
            while (canopy_free_step(&work, UINT32_MAX) == CANOPY_MORE) {}
        }
    }
    struct canopy_sandwich_ease easing;
    canopy_sandwich_ease_begin(&easing, frame->size, (const int32_t *const[2]){coefficients[0], coefficients[1]},
                               wishes);
    while (canopy_sandwich_ease_step(&easing, UINT32_MAX) == CANOPY_MORE) {}
    for (int k = 0; k < 2; k++) {
        memcpy(coefficients[k], wishes[k], count * sizeof *wish);
    }
}

/// Both sides tight, from both fast ones.
static bool tighten_both(const struct canopy_turned *turned, const struct canopy_frame frame[2],
                         const struct canopy_fitting *fitting, int32_t *const coefficients[2], const uint8_t *coverage,
                         struct canopy_fitting_report report[2], struct canopy_fault *fault) {
    const size_t count = (size_t)frame[0].size[0] * frame[0].size[1];
    int32_t *upper = coefficients[CANOPY_ABOVE];
    int32_t *lower = coefficients[CANOPY_BELOW];
    int32_t *wish = malloc(2 * count * sizeof *wish);
    uint8_t *seen = calloc(CANOPY_FREE_SEEN_BYTES(frame[0].size[0], frame[0].size[1]), 1);
    if (!wish || !seen) {
        free(wish);
        free(seen);
        return canopy_fault_no_memory(fault);
    }
    canopy_sandwich_raise(upper, lower, count);
    const bool ok = tighten(turned, &frame[CANOPY_BELOW], fitting, lower, upper, &report[CANOPY_BELOW], fault) &&
                    tighten(turned, &frame[CANOPY_ABOVE], fitting, upper, lower, &report[CANOPY_ABOVE], fault);
    if (ok) {
        canopy_free_see(frame[0].size, coverage, seen);
        ease(&frame[0], coefficients, seen, wish);
    }
    free(wish);
    free(seen);
    return ok;
}

bool canopy_fitting_run_both(const struct canopy_turned *turned, const struct canopy_frame frame[2],
                             const struct canopy_fitting *fitting, int32_t *const coefficients[2],
                             struct canopy_fitting_report report[2], struct canopy_fault *fault) {
    uint8_t *coverage = malloc(CANOPY_COVERAGE_BYTES(frame[0].size[0], frame[0].size[1]));
    if (!coverage) {
        return canopy_fault_no_memory(fault);
    }
    bool ok = true;
    for (int k = 0; k < 2; k++) {
        ok = ok && fit(turned, &frame[k], fitting, coefficients[k], coverage, &report[k], fault);
    }
    ok = ok && (!fitting->tight || tighten_both(turned, frame, fitting, coefficients, coverage, report, fault));
    free(coverage);
    for (int k = 0; k < 2; k++) {
        canopy_fast_orient(&frame[k], coefficients[k]);
    }
    return ok;
}
