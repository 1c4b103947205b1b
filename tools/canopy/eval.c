// canopy eval: the surface over each point.

#include <argp.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tools/canopy/command.h"
#include "tools/canopy/operands.h"
#include "tools/canopy/slope.h"
#include "tools/canopy/stream.h"
#include "tools/common/outline.h"

static const char DOC[] =
    "The height of the surface over (or under) each point, in input units, one a line.\v"
    "The height is the surface's coordinate along the surrogate's third axis, measured from the zero of the input: "
    "with axes along x, y, z it is the surface's z at the point's x and y. `nan` outside the frame and, where the "
    "surrogate "
    "has a trim, in knot cells without data; with --trim outline, outside the outline that `canopy trim` draws, which "
    "takes in half of each cell at a staircase of covered ones. 17 significant digits; the error of double arithmetic "
    "is below 1e-12 "
    "of the largest coefficient. Points are rounded as the device receives them first (see `canopy check --help`, also "
    "for the formats of POINTS: they have three columns, also where the height of a point, as with axes along x, y, z, "
    "does not matter; give 0).\n\n"
    "With --normals a line is `HEIGHT GU GV NX NY NZ`: the gradient, height per length along the surrogate's first and "
    "second axis, and the unit normal in the coordinates of the input, on the side of the third axis.\n\n"
    "Exit status: 0, or 2 for bad input (nothing is printed after a fault, what was printed before it stands).";

/// Where the surface counts as known.
enum known { CELLS, OUTLINE, FRAME };

enum { TRIM = 256, NORMALS };

static const struct argp_option OPTIONS[] = {
    {"trim", TRIM, "cells|outline|frame", 0,
     "where the surface has a height: in covered cells (default), inside the outline around them, or everywhere in the "
     "frame",
     0},
    {"normals", NORMALS, NULL, 0, "the gradient and the unit normal of the surface as well", 0},
    {0}};

struct arguments {
    struct canopy_operands operands;
    enum known known;
    bool normals;
};

static enum known known_named(const char *text, struct argp_state *state) {
    static const char *const names[] = {"cells", "outline", "frame"};
    for (int k = CELLS; k <= FRAME; k++) {
        if (strcmp(text, names[k]) == 0) {
            return (enum known)k;
        }
    }
    argp_error(state, "--trim is cells, outline or frame, not '%s'", text);
    return CELLS;  // not reached
}

static error_t parse(int key, char *text, struct argp_state *state) {
    struct arguments *a = state->input;
    switch (key) {
    case TRIM: a->known = known_named(text, state); return 0;
    case NORMALS: a->normals = true; return 0;
    case ARGP_KEY_ARG:
        canopy_operands_take(&a->operands, text, state, "give one surrogate and one point file");
        return 0;
    case ARGP_KEY_END:
        if (state->arg_num < 2) {
            argp_error(state, "give a surrogate and a point file");
        }
        return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

struct work {
    const struct canopy_surrogate *surrogate;
    struct canopy_exact *exact;
    const struct canopy_outline *outline;  ///< what else must hold the point, or NULL
    bool normals;
    double *heights;
    size_t room;
    bool failed;
};

/// A coordinate of a point of the cloud.
static double coordinate(const struct canopy_cloud *cloud, size_t point, int axis) {
    const size_t at = point * cloud->stride;
    return cloud->scalar == CANOPY_F32 ? (double)((const float *)cloud->axis[axis])[at]
                                       : (double)((const int32_t *)cloud->axis[axis])[at];
}

/// Where the point is in the frame, in knot intervals.
static void place_of(const struct work *work, const struct canopy_cloud *cloud, size_t point, double place[2]) {
    const struct canopy_surrogate *s = work->surrogate;
    for (int a = 0; a < 2; a++) {
        place[a] = 0.0;
        for (int k = 0; k < 3; k++) {
            place[a] += s->axes[a][k] * (coordinate(cloud, point, k) - s->origin[k]);
        }
        place[a] /= s->pitch[a];
    }
}

static bool is_in_outline(const struct work *work, const struct canopy_cloud *cloud, size_t point) {
    double place[2];
    place_of(work, cloud, point, place);
    return canopy_outline_holds(work->outline, place[0], place[1]);
}

static void print_slope(const struct work *work, const struct canopy_cloud *cloud, size_t point) {
    const struct canopy_surrogate *s = work->surrogate;
    double place[2];
    place_of(work, cloud, point, place);
    for (int a = 0; a < 2; a++) {
        place[a] = fmin(fmax(place[a], 0.0), (double)s->size[a] - 1.0);
    }
    const struct canopy_slope slope = canopy_slope_at(s, place[0], place[1]);
    printf(" %.17g %.17g %.17g %.17g %.17g", slope.gradient[0], slope.gradient[1], slope.normal[0], slope.normal[1],
           slope.normal[2]);
}

static void take(void *context, const struct canopy_cloud *cloud) {
    struct work *work = context;
    if (cloud->count > work->room) {
        free(work->heights);
        work->heights = malloc(cloud->count * sizeof *work->heights);
        work->room = work->heights ? cloud->count : 0;
    }
    work->failed = work->failed || !work->heights;
    if (work->failed) {
        return;
    }
    const struct canopy_surrogate *s = work->surrogate;
    const double base = s->axes[2][0] * s->origin[0] + s->axes[2][1] * s->origin[1] + s->axes[2][2] * s->origin[2];
    canopy_exact_heights(work->exact, cloud, work->heights);
    for (size_t i = 0; i < cloud->count; i++) {
        const double height = work->heights[i];
        if (isnan(height) || (work->outline && !is_in_outline(work, cloud, i))) {
            puts(work->normals ? "nan nan nan nan nan nan" : "nan");
            continue;
        }
        printf("%.17g", (base + height) * s->unit);
        if (work->normals) {
            print_slope(work, cloud, i);
        }
        putchar('\n');
    }
}

/// Evaluates with an outline, or NULL, where the surrogate's own trim says no more than it does.
static bool evaluate(const struct arguments *arguments, const struct canopy_surrogate *surrogate,
                     const struct canopy_outline *outline, struct canopy_fault *fault) {
    struct work work = {.surrogate = surrogate,
                        .exact = canopy_exact_open(surrogate),
                        .outline = outline,
                        .normals = arguments->normals};
    struct canopy_points_info info = {.skipped = 0};
    bool ok = work.exact != NULL;
    ok = ok && canopy_stream_points(arguments->operands.points, surrogate, (struct canopy_stream_sink){&work, take},
                                    &info, fault);
    if (!work.exact || work.failed) {
        ok = canopy_fault_set(fault, "out of memory: close other programs");
    }
    canopy_exact_close(work.exact);
    free(work.heights);
    if (ok && info.skipped > 0) {
        fprintf(stderr, "canopy: %s: heights of %" PRIu64 " points%s\n", arguments->operands.points, info.count,
                canopy_points_skipped(&info).text);
    }
    return ok;
}

int canopy_command_eval(int argc, char **argv) {
    struct arguments arguments = {.known = CELLS};
    const struct argp argp = {.options = OPTIONS, .parser = parse, .args_doc = "SURROGATE.json POINTS", .doc = DOC};
    argp_parse(&argp, argc, argv, 0, NULL, &arguments);
    struct canopy_fault fault;
    struct canopy_surrogate surrogate;
    struct canopy_outline outline;
    if (!canopy_surrogate_read(arguments.operands.surrogate, &surrogate, &fault)) {
        return canopy_command_fail(&fault);
    }
    const bool outlined = arguments.known == OUTLINE && surrogate.trim;
    bool ok = !outlined || canopy_outline_make(&surrogate, false, false, &outline, &fault);
    if (ok) {
        if (arguments.known != CELLS) {
            free(surrogate.trim);
            surrogate.trim = NULL;
        }
        ok = evaluate(&arguments, &surrogate, outlined ? &outline : NULL, &fault);
        if (outlined) {
            canopy_outline_free(&outline);
        }
    }
    canopy_surrogate_free(&surrogate);
    return ok ? CANOPY_EXIT_OK : canopy_command_fail(&fault);
}
