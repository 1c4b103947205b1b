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

static const char *coverage_of(const struct canopy_query_subject *before, const struct canopy_query_subject *after,
                               uint32_t row, uint32_t column) {
    const bool was = canopy_query_counts(before, row, column), is = canopy_query_counts(after, row, column);
    return was ? is ? "kept" : "lost" : is ? "gained" : "none";
}

static void print_cells(const struct canopy_queried *before, const struct canopy_queried *after, double step) {
    const struct canopy_query_subject down = {.surface = &after->low, .minus = &before->high};
    const struct canopy_query_subject up = {.surface = &after->high, .minus = &before->low};
    const struct canopy_query_subject was = {.surface = &before->low, .covered = true};
    const struct canopy_query_subject is = {.surface = &after->low, .covered = true};
    for (uint32_t row = 0; row + 1 < before->surrogate.size[0]; row++) {
        for (uint32_t column = 0; column + 1 < before->surrogate.size[1]; column++) {
            int32_t low = 0, high = 0, other = 0;  // cannot fail: the coefficients have been scaled into their limit
            (void)canopy_query_cell(&down, row, column, &low, &other);
            (void)canopy_query_cell(&up, row, column, &other, &high);
            printf("%u %u %.17g %.17g %s\n", row, column, canopy_queried_height(after, low, step, false, false),
                   canopy_queried_height(after, high, step, false, true), coverage_of(&was, &is, row, column));
        }
    }
}

static bool run(const struct arguments *a, struct canopy_queried *before, struct canopy_queried *after,
                struct canopy_fault *fault) {
    struct canopy_queried *const all[] = {before, after};
    if (!canopy_queried_read(a->paths[0], before, fault) || !canopy_queried_read(a->paths[1], after, fault) ||
        !canopy_queried_match(before, after, fault)) {
        return false;
    }
    const struct canopy_queried_question question = {
        .surface = after, .minus = before, .step = canopy_queried_scale(all, 2, 0.0)};
    if (!canopy_queried_print(&question, &a->options, CANOPY_HIGHEST, "rise", fault) ||
        !canopy_queried_print(&question, &a->options, CANOPY_LOWEST, "fall", fault)) {
        return false;
    }
    struct canopy_query_coverage coverage = {0};
    // The sides may differ, the frames have been compared: it cannot fail.
    (void)canopy_query_coverage(&before->low, &after->low, &coverage);
    printf("cells: %u covered in both, %u gained, %u lost\n", coverage.kept, coverage.gained, coverage.lost);
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
