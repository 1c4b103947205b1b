// canopy clearance: the guaranteed distance between two surfaces, or to a plane.

#include <argp.h>
#include <math.h>
#include <stdio.h>

#include "tools/canopy/command.h"
#include "tools/canopy/queried.h"

static const char DOC[] =
    "How far the first surface stands above the second, or above a plane, at least and at most, guaranteed.\v"
    "Distances are along the surrogates' third axis, first minus second: negative where the first is below. The two "
    "must have one frame (fit one with --frame of the other, or both at once with canopy "
    "sandwich).\n\n" CANOPY_QUERIED_DOC "Prints two lines:\n\n"
    "  least BOUND attained VALUE at U V\n"
    "  most BOUND attained VALUE at U V\n\n"
    "Nowhere on the window is the distance less than the first bound or more than the second; at the places given it "
    "is as small and as large as the values. A least bound above 0 is a proof that the two do not touch. See `canopy "
    "window --help` for --budget and how windows are rounded.\n\n"
    "Exit status: 0, 2 for bad input, 64 for wrong usage.";

enum { PLANE = 256 };

static const struct argp_option OPTIONS[] = {
    {"plane", PLANE, "A,B,C", 0, "the plane of height A * U + B * V + C in place of the second surface", 0}, {0}};

struct arguments {
    struct canopy_queried_options options;
    const char *paths[2];
    const char *plane;
};

static error_t parse(int key, char *text, struct argp_state *state) {
    struct arguments *a = state->input;
    switch (key) {
    case ARGP_KEY_INIT: state->child_inputs[0] = &a->options; return 0;
    case PLANE: a->plane = text; return 0;
    case ARGP_KEY_ARG:
        if (state->arg_num >= (a->plane ? 1U : 2U)) {
            argp_error(state, "give two surrogates, or one and --plane");
        }
        a->paths[state->arg_num] = text;
        return 0;
    case ARGP_KEY_END:
        if (!a->paths[0] || (!a->paths[1]) != (a->plane != NULL)) {
            argp_error(state, "give two surrogates, or one and --plane");
        }
        return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

static bool read_plane(const char *text, double plane[3], struct canopy_fault *fault) {
    int used = 0;
    bool ok = sscanf(text, "%lf,%lf,%lf%n", &plane[0], &plane[1], &plane[2], &used) == 3 && text[used] == '\0';
    for (int k = 0; ok && k < 3; k++) {
        ok = isfinite(plane[k]);
    }
    return ok || canopy_fault_set(fault, "--plane %s: give A,B,C", text);
}

static bool ask(const struct canopy_queried_question *question, const struct canopy_queried_options *options,
                struct canopy_fault *fault) {
    return canopy_queried_print(question, options, CANOPY_LOWEST, "least", fault) &&
           canopy_queried_print(question, options, CANOPY_HIGHEST, "most", fault);
}

static bool to_plane(const struct arguments *a, struct canopy_queried *surface, struct canopy_fault *fault) {
    struct canopy_queried_question question = {.surface = surface};
    struct canopy_query_plane plane;
    double abc[3];
    if (!read_plane(a->plane, abc, fault)) {
        return false;
    }
    if (!canopy_queried_scale_plane(surface, abc, &question, &plane)) {
        return canopy_fault_set(fault, "--plane %s: it is too far from the surface", a->plane);
    }
    return (question.step > 0.0 || canopy_queried_no_memory(surface, fault)) && ask(&question, &a->options, fault);
}

static bool to_surface(const struct arguments *a, struct canopy_queried *first, struct canopy_queried *second,
                       struct canopy_fault *fault) {
    struct canopy_queried *const all[] = {first, second};
    if (!canopy_queried_read_refined(a->paths[1], second, fault) || !canopy_queried_match(first, second, fault)) {
        return false;
    }
    const struct canopy_queried_question question = {
        .surface = first, .minus = second, .step = canopy_queried_scale(all, 2, 0.0)};
    return (question.step > 0.0 || canopy_queried_no_memory(first, fault)) && ask(&question, &a->options, fault);
}

int canopy_command_clearance(int argc, char **argv) {
    struct arguments arguments = {.plane = NULL};
    const struct argp_child children[] = {{&canopy_queried_argp, 0, NULL, 0}, {0}};
    const struct argp argp = {.options = OPTIONS,
                              .parser = parse,
                              .args_doc = "FIRST.json SECOND.json\nSURROGATE.json --plane A,B,C",
                              .doc = DOC,
                              .children = children};
    argp_parse(&argp, argc, argv, 0, NULL, &arguments);
    struct canopy_fault fault;
    struct canopy_queried queried[2] = {{.path = NULL}};
    const bool ok = canopy_queried_read_refined(arguments.paths[0], &queried[0], &fault) &&
                    (arguments.plane ? to_plane(&arguments, &queried[0], &fault)
                                     : to_surface(&arguments, &queried[0], &queried[1], &fault));
    canopy_queried_free(&queried[0]);
    canopy_queried_free(&queried[1]);
    return ok ? CANOPY_EXIT_OK : canopy_command_fail(&fault);
}
