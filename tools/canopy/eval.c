// canopy eval: the surface over each point.

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "tools/canopy/command.h"
#include "tools/canopy/operands.h"
#include "tools/canopy/stream.h"

static const char DOC[] =
    "The height of the surface over (or under) each point, in input units, one a line.\v"
    "The height is the surface's coordinate along the surrogate's third axis, measured from the zero of the input: "
    "with axes along x, y, z it is the surface's z at the point's x and y. `nan` outside the frame, and in knot cells "
    "without data where the surrogate has a trim. 17 significant digits; the error of double arithmetic is below 1e-12 "
    "of the largest coefficient. Points are rounded as the device receives them first (see `canopy check --help`, also "
    "for the formats of POINTS).\n\n"
    "Exit status: 0, or 2 for bad input (nothing is printed after a fault, what was printed before it stands).";

struct work {
    const struct canopy_surrogate *surrogate;
    struct canopy_exact *exact;
    double *heights;
    size_t room;
    bool failed;
};

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
        if (isnan(height)) {
            puts("nan");
        } else {
            printf("%.17g\n", (base + height) * s->unit);
        }
    }
}

int canopy_command_eval(int argc, char **argv) {
    const struct canopy_operands operands = canopy_operands_both(argc, argv, DOC);
    struct canopy_fault fault;
    struct canopy_surrogate surrogate;
    if (!canopy_surrogate_read(operands.surrogate, &surrogate, &fault)) {
        return canopy_command_fail(&fault);
    }
    struct work work = {.surrogate = &surrogate, .exact = canopy_exact_open(&surrogate)};
    bool ok = work.exact != NULL;
    ok = ok && canopy_stream_points(operands.points, &surrogate, (struct canopy_stream_sink){&work, take}, &fault);
    if (!work.exact || work.failed) {
        ok = canopy_fault_set(&fault, "%s: out of memory: close other programs", operands.surrogate);
    }
    canopy_exact_close(work.exact);
    free(work.heights);
    canopy_surrogate_free(&surrogate);
    return ok ? CANOPY_EXIT_OK : canopy_command_fail(&fault);
}
