// canopy diff: what changed between two surfaces of one frame.

#include <argp.h>
#include <stdio.h>

#include "tools/canopy/command.h"
#include "tools/canopy/queried.h"

static const char DOC[] =
    "What has changed from one surface to another of the same frame: the largest rise and fall, guaranteed, and what "
    "has been seen anew or no longer.\v" CANOPY_QUERIED_DOC "Prints three lines:\n\n"
    "  rise BOUND attained VALUE at U V\n"
    "  fall BOUND attained VALUE at U V\n"
    "  cells: K covered in both, G gained, L lost\n\n"
    "The second surface is nowhere further above the first than `rise`, and nowhere further below it than `fall` "
    "(which is negative where it fell). With --covered, both are about the knot cells that are covered in both. With "
    "--cells, a line for each knot cell follows, rows along U: `ROW COLUMN LOW HIGH COVERAGE`, between which the "
    "change "
    "lies all over that cell; coverage is kept, gained, lost or none. See `canopy window --help` for --budget and how "
    "windows are rounded.\n\n"
    "Exit status: 0, 2 for bad input, 64 for wrong usage.";

enum { CELLS = 256 };

static const struct argp_option OPTIONS[] = {
    {"cells", CELLS, NULL, 0, "bounds of the change over each knot cell of the frame as well", 0}, {0}};

struct arguments {
    struct canopy_queried_options options;
    const char *paths[2];
    bool cells;
};

static error_t parse(int key, char *text, struct argp_state *state) {
    struct arguments *a = state->input;
    switch (key) {
    case ARGP_KEY_INIT: state->child_inputs[0] = &a->options; return 0;
    case CELLS: a->cells = true; return 0;
    case ARGP_KEY_ARG:
        if (state->arg_num >= 2) {
            argp_error(state, "give two surrogates");
        }
        a->paths[state->arg_num] = text;
        return 0;
    case ARGP_KEY_END:
        if (state->arg_num < 2) {
            argp_error(state, "give two surrogates: BEFORE.json AFTER.json");
        }
        return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

static bool covers(const struct canopy_surrogate *s, size_t cell) { return !s->trim || s->trim[cell]; }

static const char *coverage_of(const struct canopy_surrogate *before, const struct canopy_surrogate *after,
                               size_t cell) {
    const bool was = covers(before, cell), is = covers(after, cell);
    return was ? is ? "kept" : "lost" : is ? "gained" : "none";
}

/// Bounds of the change over a knot cell, which is several of the envelopes' where there are refinement windows.
static void bound_cell(const struct canopy_queried *before, const struct canopy_queried *after, uint32_t row,
                       uint32_t column, int32_t bounds[2]) {
    const struct canopy_query_subject down = {.surface = &after->low, .minus = &before->high};
    const struct canopy_query_subject up = {.surface = &after->high, .minus = &before->low};
    const uint32_t parts = 1U << after->level;
    bounds[0] = INT32_MAX;
    bounds[1] = INT32_MIN;
    for (uint32_t i = 0; i < parts * parts; i++) {
        const uint32_t h = row * parts + i / parts, w = column * parts + i % parts;
        int32_t low = 0, high = 0, other = 0;  // cannot fail: the coefficients have been scaled into their limit
        (void)canopy_query_cell(&down, h, w, &low, &other);
        (void)canopy_query_cell(&up, h, w, &other, &high);
        bounds[0] = low < bounds[0] ? low : bounds[0];
        bounds[1] = high > bounds[1] ? high : bounds[1];
    }
}

static void print_cells(const struct canopy_queried *before, const struct canopy_queried *after, double step) {
    size_t cell = 0;
    for (uint32_t row = 0; row + 1 < before->surrogate.size[0]; row++) {
        for (uint32_t column = 0; column + 1 < before->surrogate.size[1]; column++, cell++) {
            int32_t bounds[2];
            bound_cell(before, after, row, column, bounds);
            printf("%u %u %.17g %.17g %s\n", row, column, canopy_queried_height(after, bounds[0], step, false, false),
                   canopy_queried_height(after, bounds[1], step, false, true),
                   coverage_of(&before->surrogate, &after->surrogate, cell));
        }
    }
}

static void print_coverage(const struct canopy_surrogate *before, const struct canopy_surrogate *after) {
    uint32_t kept = 0, gained = 0, lost = 0;
    for (size_t i = 0; i < (size_t)(before->size[0] - 1) * (before->size[1] - 1); i++) {
        const bool was = covers(before, i), is = covers(after, i);
        kept += was && is;
        gained += !was && is;
        lost += was && !is;
    }
    printf("cells: %u covered in both, %u gained, %u lost\n", kept, gained, lost);
}

static bool run(const struct arguments *a, struct canopy_queried *before, struct canopy_queried *after,
                struct canopy_fault *fault) {
    struct canopy_queried *const all[] = {before, after};
    if (!canopy_queried_read_refined(a->paths[0], before, fault) ||
        !canopy_queried_read_refined(a->paths[1], after, fault) || !canopy_queried_match(before, after, fault)) {
        return false;
    }
    const struct canopy_queried_question question = {
        .surface = after, .minus = before, .step = canopy_queried_scale(all, 2, 0.0)};
    if (!(question.step > 0.0 || canopy_queried_no_memory(before, fault)) ||
        !canopy_queried_print(&question, &a->options, CANOPY_HIGHEST, "rise", fault) ||
        !canopy_queried_print(&question, &a->options, CANOPY_LOWEST, "fall", fault)) {
        return false;
    }
    print_coverage(&before->surrogate, &after->surrogate);
    if (a->cells) {
        print_cells(before, after, question.step);
    }
    return true;
}

int canopy_command_diff(int argc, char **argv) {
    struct arguments arguments = {.cells = false};
    const struct argp_child children[] = {{&canopy_queried_argp, 0, NULL, 0}, {0}};
    const struct argp argp = {
        .options = OPTIONS, .parser = parse, .args_doc = "BEFORE.json AFTER.json", .doc = DOC, .children = children};
    argp_parse(&argp, argc, argv, 0, NULL, &arguments);
    struct canopy_fault fault;
    struct canopy_queried queried[2] = {{.path = NULL}};
    const bool ok = run(&arguments, &queried[0], &queried[1], &fault);
    canopy_queried_free(&queried[0]);
    canopy_queried_free(&queried[1]);
    return ok ? CANOPY_EXIT_OK : canopy_command_fail(&fault);
}
