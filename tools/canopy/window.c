// canopy window: the guaranteed highest and lowest of a surface over a window.

#include <argp.h>

#include "tools/canopy/command.h"
#include "tools/canopy/queried.h"

static const char DOC[] =
    "The highest and lowest that the surface can be over a window, guaranteed.\v" CANOPY_QUERIED_DOC
    "Prints two lines:\n\n"
    "  highest BOUND attained VALUE at U V\n"
    "  lowest BOUND attained VALUE at U V\n\n"
    "The surface is nowhere above (below) the bound on the window; it is at least as high (low) as the value at the "
    "place given. The truth is between the two: their difference is how loose the bound is, and --budget makes it "
    "looser, never wrong. The bounds come from the coefficients alone, in whole numbers rounded outward; the window is "
    "first widened to whole 2^-20 of a knot interval. Where the surrogate is on the safe side of the scene, highest is "
    "also a bound of everything that was scanned there (lowest for a surrogate below).\n\n"
    "Exit status: 0, 2 for bad input, 64 for wrong usage.";

struct arguments {
    struct canopy_queried_options options;
    const char *path;
};

static error_t parse(int key, char *text, struct argp_state *state) {
    struct arguments *a = state->input;
    switch (key) {
    case ARGP_KEY_INIT: state->child_inputs[0] = &a->options; return 0;
    case ARGP_KEY_ARG:
        if (a->path) {
            argp_error(state, "give one surrogate");
        }
        a->path = text;
        return 0;
    case ARGP_KEY_END:
        if (!a->path) {
            argp_error(state, "give a surrogate");
        }
        return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

int canopy_command_window(int argc, char **argv) {
    struct arguments arguments = {.path = NULL};
    const struct argp_child children[] = {{&canopy_queried_argp, 0, NULL, 0}, {0}};
    const struct argp argp = {.parser = parse, .args_doc = "SURROGATE.json", .doc = DOC, .children = children};
    argp_parse(&argp, argc, argv, 0, NULL, &arguments);
    struct canopy_fault fault;
    struct canopy_queried queried;
    struct canopy_queried *const all[] = {&queried};
    bool ok = canopy_queried_read_refined(arguments.path, &queried, &fault);
    if (ok) {
        const struct canopy_queried_question question = {.surface = &queried,
                                                         .step = canopy_queried_scale(all, 1, 0.0)};
        ok = (question.step > 0.0 || canopy_queried_no_memory(&queried, &fault)) &&
             canopy_queried_print(&question, &arguments.options, CANOPY_HIGHEST, "highest", &fault) &&
             canopy_queried_print(&question, &arguments.options, CANOPY_LOWEST, "lowest", &fault);
    }
    canopy_queried_free(&queried);
    return ok ? CANOPY_EXIT_OK : canopy_command_fail(&fault);
}
