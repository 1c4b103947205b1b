// canopy clearance: the guaranteed distance between two surfaces, or to a plane.

#include <argp.h>
#include <gmp.h>
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

/// a * b, in rational numbers.
static void product(mpq_t to, double a, double b) {
    mpq_t y;
    mpq_init(y);
    mpq_set_d(to, a);
    mpq_set_d(y, b);
    mpq_mul(to, to, y);
    mpq_clear(y);
}

/// The plane in device units above the frame's origin: height at the corner u = v = 0, and rise a knot interval. With o
/// the origin along the axes: A (o0 + u p0) + B (o1 + v p1) + C / unit - o2.
static void place_plane(const struct canopy_surrogate *s, const double plane[3], mpq_t to[3]) {
    mpq_t x, slope;
    mpq_inits(x, slope, NULL);
    product(to[0], plane[2], 1.0);
    mpq_set_d(x, s->unit);
    mpq_div(to[0], to[0], x);
    for (int axis = 0; axis < 3; axis++) {
        mpq_set_d(slope, axis < 2 ? plane[axis] : -1.0);
        for (int k = 0; k < 3; k++) {
            product(x, s->axes[axis][k], s->origin[k]);
            mpq_mul(x, x, slope);
            mpq_add(to[0], to[0], x);
        }
        if (axis < 2) {
            product(to[1 + axis], plane[axis], s->pitch[axis]);
        }
    }
    mpq_clears(x, slope, NULL);
}

/// The largest height of the plane over the frame, and a bit more.
static double reach_of(const struct canopy_surrogate *s, mpq_t plane[3]) {
    const double far = fabs(mpq_get_d(plane[0])) + fabs(mpq_get_d(plane[1])) * ((double)s->size[0] - 1.0) +
                       fabs(mpq_get_d(plane[2])) * ((double)s->size[1] - 1.0);
    return far * 1.0001;
}

static int64_t in_steps(mpq_t x, double step) {
    mpq_t y;
    mpz_t whole;
    mpq_init(y);
    mpz_init(whole);
    mpq_set_d(y, step);
    mpq_div(x, x, y);
    mpq_mul_2exp(x, x, 16);
    mpz_fdiv_q(whole, mpq_numref(x), mpq_denref(x));
    const int64_t steps = mpz_get_si(whole);
    mpz_clear(whole);
    mpq_clear(y);
    return steps;
}

static bool ask(const struct canopy_queried_question *question, const struct canopy_queried_options *options,
                struct canopy_fault *fault) {
    return canopy_queried_print(question, options, CANOPY_LOWEST, "least", fault) &&
           canopy_queried_print(question, options, CANOPY_HIGHEST, "most", fault);
}

static bool to_plane(const struct arguments *a, struct canopy_queried *surface, struct canopy_fault *fault) {
    struct canopy_queried *const all[] = {surface};
    const struct canopy_surrogate *s = &surface->surrogate;
    double abc[3];
    if (!read_plane(a->plane, abc, fault)) {
        return false;
    }
    mpq_t parts[3];
    mpq_inits(parts[0], parts[1], parts[2], NULL);
    place_plane(s, abc, parts);
    const double reach = reach_of(s, parts);
    struct canopy_queried_question question = {.surface = surface};
    bool ok = isfinite(reach * 4.0) || canopy_fault_set(fault, "--plane %s: it is too far from the surface", a->plane);
    if (ok) {
        question.step = canopy_queried_scale(all, 1, reach);
        const struct canopy_query_plane plane = {
            .at_origin = in_steps(parts[0], question.step),
            .rise = {in_steps(parts[1], question.step), in_steps(parts[2], question.step)}};
        question.plane = &plane;
        // Each of the three is rounded by 2^-16 step, two of them times knot intervals.
        question.slack = 1 + (int32_t)((s->size[0] + s->size[1]) >> 16);
        ok = ask(&question, &a->options, fault);
    }
    mpq_clears(parts[0], parts[1], parts[2], NULL);
    return ok;
}

static bool to_surface(const struct arguments *a, struct canopy_queried *first, struct canopy_queried *second,
                       struct canopy_fault *fault) {
    struct canopy_queried *const all[] = {first, second};
    if (!canopy_queried_read(a->paths[1], second, fault) || !canopy_queried_match(first, second, fault)) {
        return false;
    }
    const struct canopy_queried_question question = {
        .surface = first, .minus = second, .step = canopy_queried_scale(all, 2, 0.0)};
    return ask(&question, &a->options, fault);
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
    const bool ok = canopy_queried_read(arguments.paths[0], &queried[0], &fault) &&
                    (arguments.plane ? to_plane(&arguments, &queried[0], &fault)
                                     : to_surface(&arguments, &queried[0], &queried[1], &fault));
    canopy_queried_free(&queried[0]);
    canopy_queried_free(&queried[1]);
    return ok ? CANOPY_EXIT_OK : canopy_command_fail(&fault);
}
