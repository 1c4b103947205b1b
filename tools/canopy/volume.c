// canopy volume: between a surface and a height, or another surface.

#include <argp.h>
#include <stdio.h>

#include "tools/canopy/command.h"
#include "tools/canopy/queried.h"
#include "tools/common/option.h"

static const char DOC[] =
    "The volume between a surface and a height, or between two surfaces of one frame, over a "
    "window.\v" CANOPY_QUERIED_DOC
    "Prints one line: volume LOW HIGH area AREA cells N. The volume is signed: what lies below the height (where the "
    "first surface is below the second) counts as negative; for what was added from one time to another less what was "
    "taken away, give the later file first. The integrals are exact; LOW and HIGH differ by rounding, and where an "
    "edge of --window crosses a knot cell by what rounding makes of a cell cut there. AREA is that of the window "
    "widened to whole 2^-20 of a knot interval, with --covered that of the knot cells with data in it, N of them (in "
    "part or whole).\n\n"
    "Exit status: 0, 2 for bad input, 64 for wrong usage.";

enum { HEIGHT = 256 };

static const struct argp_option OPTIONS[] = {
    {"height", HEIGHT, "Z", 0, "the height in place of the second surface, from the zero of the input", 0}, {0}};

struct arguments {
    struct canopy_queried_options options;
    const char *paths[2];
    const char *height;
};

static error_t parse(int key, char *text, struct argp_state *state) {
    struct arguments *a = state->input;
    switch (key) {
    case ARGP_KEY_INIT: state->child_inputs[0] = &a->options; return 0;
    case HEIGHT: a->height = text; return 0;
    case ARGP_KEY_ARG:
        if (state->arg_num >= 2) {
            argp_error(state, "give one surrogate and --height, or two surrogates");
        }
        a->paths[state->arg_num] = text;
        return 0;
    case ARGP_KEY_END:
        if (!a->paths[0] || (!a->paths[1]) != (a->height != NULL)) {
            argp_error(state, "give one surrogate and --height, or two surrogates");
        }
        return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

static bool run(const struct arguments *a, struct canopy_queried *first, struct canopy_queried *second,
                struct canopy_fault *fault) {
    struct canopy_queried *const all[] = {first, second};
    const bool two = !a->height;
    double height = 0.0;
    struct canopy_query_rect rect;
    if ((!two && !canopy_option_real("height", a->height, -1e300, 1e300, &height, fault)) ||
        !canopy_queried_read_refined(a->paths[0], first, fault) ||
        (two &&
         !(canopy_queried_read_refined(a->paths[1], second, fault) && canopy_queried_match(first, second, fault))) ||
        !canopy_queried_window(first, &a->options, &rect, fault)) {
        return false;
    }
    const double step = canopy_queried_scale(all, two ? 2 : 1, 0.0);
    struct canopy_queried_volume volume;
    if (!(step > 0.0 || canopy_queried_no_memory(first, fault)) ||
        !canopy_queried_find_volume(first, two ? second : NULL, step, height, &rect, a->options.covered, &volume,
                                    fault)) {
        return false;
    }
    printf("volume %.17g %.17g area %.10g cells %u\n", volume.low, volume.high, volume.area, volume.cells);
    return true;
}

int canopy_command_volume(int argc, char **argv) {
    struct arguments arguments = {.height = NULL};
    const struct argp_child children[] = {{&canopy_queried_window_argp, 0, NULL, 0}, {0}};
    const struct argp argp = {.options = OPTIONS,
                              .parser = parse,
                              .args_doc = "SURROGATE.json --height Z\nFIRST.json SECOND.json",
                              .doc = DOC,
                              .children = children};
    argp_parse(&argp, argc, argv, 0, NULL, &arguments);
    struct canopy_fault fault;
    struct canopy_queried queried[2] = {{.path = NULL}};
    const bool ok = run(&arguments, &queried[0], &queried[1], &fault);
    canopy_queried_free(&queried[0]);
    canopy_queried_free(&queried[1]);
    return ok ? CANOPY_EXIT_OK : canopy_command_fail(&fault);
}
