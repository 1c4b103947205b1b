// canopy fit: one safe surrogate.

#include <argp.h>

#include "tools/canopy/command.h"
#include "tools/canopy/operands.h"
#include "tools/canopy/wish.h"
#include "tools/common/filling.h"

static const char DOC[] =
    "Fits a smooth surface that lies on one side of all points, proves it, and writes it as a surrogate "
    "file.\v" CANOPY_OPERANDS_POINTS
    "The surface is a uniform bicubic spline with MxN coefficients over the smallest frame that holds every point. "
    "Safe means: in exact arithmetic, at every point as the device receives it (f32: (float)(p / unit); fx: "
    "rint(p / unit)). What is written has been checked so, from the coefficients that are written. --refine adds "
    "windows with finer knots; the surface stays safe and twice continuously differentiable across their edges.\n\n"
    "Prints one line: points, grid (with the number of all coefficients where there are windows), method, unit and the "
    "most that rounding to the device's numbers moved a "
    "coordinate, mean and largest gap in per cent of the points' height range, certified margin in input units, "
    "iterations, milliseconds of the fit and of the certificate.\n\n"
    "Exit status: 0 done; 2 bad input, with one line that says where and what to do, and no output file; 64 wrong "
    "usage.";

enum { SIDE = 256, REFINE, FREE };

static const struct argp_option OPTIONS[] = {
    {"side", SIDE, "above|below", 0, "the surface is above all points (default), or below", 0},
    {"refine", REFINE, "WHERE[@LEVEL]", 0,
     "finer knots where they matter, at half the pitch (LEVEL 1, default) or a quarter (2). WHERE is N: up to that "
     "many "
     "windows, 8 at most, each a quarter of the grid wide (3 knot intervals at least), where finer knots have most to "
     "win; N:RxC: windows of RxC knot intervals; or X0,Y0,X1,Y1: the window between two corners, in input units along "
     "the frame's first and second axis (x and y unless --dir). May be given several times",
     0},
    {"free", FREE, "nearest|straight|bent", 0,
     "how the surface goes on where there are no points, over holes and beyond silhouettes, never higher or lower than "
     "it is elsewhere: as nearest by; so that second differences vanish (default of fast); or with the least bending "
     "energy (default of tight). It changes nothing over knot cells that hold points",
     0},
    {"output", 'o', "OUT.json", 0, "write the surrogate here; without it only the line is printed", 0},
    {0}};

struct arguments {
    struct canopy_wish wish;
    const char *output;
    enum canopy_side side;
    const char *refine[CANOPY_REFINEMENTS_MAX + 1];  ///< one too many is said to be so later
    uint32_t refine_count;
    enum canopy_filling filling;
};

static error_t parse(int key, char *text, struct argp_state *state) {
    struct arguments *a = state->input;
    switch (key) {
    case ARGP_KEY_INIT: state->child_inputs[0] = &a->wish; return 0;
    case 'o': a->output = text; return 0;
    case SIDE:
        a->side = canopy_wish_word(state, "side", text, "above", "below") ? CANOPY_BELOW : CANOPY_ABOVE;
        return 0;
    case REFINE:
        if (a->refine_count <= CANOPY_REFINEMENTS_MAX) {
            a->refine[a->refine_count++] = text;
        }
        return 0;
    case FREE:
        a->filling = canopy_filling_named(text);
        if (a->filling == CANOPY_FILLING_OWN) {
            argp_error(state, "--free is nearest, straight or bent, not '%s'", text);
        }
        return 0;
    case ARGP_KEY_END: canopy_wish_end(&a->wish, state); return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

static bool read_refining(const struct arguments *a, struct canopy_refining *refining, struct canopy_fault *fault) {
    bool ok = true;
    for (uint32_t k = 0; ok && k < a->refine_count; k++) {
        ok = canopy_refining_read(a->refine[k], refining, fault);
    }
    return ok;
}

/// Sets what no covered cell can see, and judges what is written now as what was there before.
static bool fill(enum canopy_filling rule, const struct canopy_supply *points, struct canopy_surrogate *surrogate,
                 struct canopy_surface_report *report, struct canopy_fault *fault) {
    if (rule == CANOPY_FILLING_OWN) {
        return true;
    }
    if (!canopy_filling_apply(surrogate, rule, fault) ||
        !canopy_supply_check(points, surrogate, NULL, &report->result, fault)) {
        return false;
    }
    surrogate->margin = report->result.margin;
    return canopy_exact_is_safe(&report->result) ||
           canopy_fault_set(fault, "no safe surface came out with --free; nothing was written: please report this with "
                                   "the points");
}

static bool run(const struct arguments *a, struct canopy_surrogate *frame, struct canopy_fault *fault) {
    struct canopy_surface_wish wish;
    struct canopy_loaded loaded;
    if (!canopy_wish_read(&a->wish, frame, &wish, fault) || !read_refining(a, &wish.refining, fault) ||
        !canopy_wish_load(&a->wish, &wish, &loaded, fault)) {
        return false;
    }
    wish.side = a->side;
    struct canopy_surrogate surrogate;
    struct canopy_surface_report report;
    bool ok = canopy_surface_fit_supply(&loaded.supply, &wish, &surrogate, &report, fault);
    if (!ok) {
        canopy_fault_prefix(fault, "%s", a->wish.points);
    } else {
        ok = fill(a->filling, &loaded.supply, &surrogate, &report, fault);
        ok = ok && (!a->output || canopy_surrogate_write(a->output, &surrogate, fault));
        if (ok) {
            canopy_wish_report(&wish, &loaded, &report, a->output);
        }
        canopy_surrogate_free(&surrogate);
    }
    canopy_supply_free(&loaded.supply);
    return ok;
}

int canopy_command_fit(int argc, char **argv) {
    struct arguments arguments = {.wish = {.scalar = -1}};
    const struct argp_child children[] = {{&canopy_wish_argp, 0, NULL, 0}, {0}};
    const struct argp argp = {
        .options = OPTIONS, .parser = parse, .args_doc = "POINTS", .doc = DOC, .children = children};
    argp_parse(&argp, argc, argv, 0, NULL, &arguments);
    struct canopy_fault fault;
    struct canopy_surrogate frame = {0};
    const bool ok = run(&arguments, &frame, &fault);
    canopy_surrogate_free(&frame);
    return ok ? CANOPY_EXIT_OK : canopy_command_fail(&fault);
}
