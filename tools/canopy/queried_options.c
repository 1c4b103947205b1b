// What the commands have in common on their command line: --window, --covered, --budget.

#include <math.h>
#include <stdio.h>

#include "tools/canopy/queried_parts.h"

enum { WINDOW = 768, COVERED, BUDGET };

static const struct argp_option WINDOW_OPTIONS[] = {
    {"window", WINDOW, "U0,U1,V0,V1", 0, "ask about this rectangle only, edges included (default: the whole frame)", 0},
    {"covered", COVERED, NULL, 0, "ask about knot cells with data only, those that the surrogate's trim marks", 0},
    {0}};

static const struct argp_option BUDGET_OPTIONS[] = {
    {"budget", BUDGET, "N", 0, "spend at most N looks at knot cells and cuts of them (default 1000000)", 0}, {0}};

static error_t parse_window(int key, char *text, struct argp_state *state) {
    struct canopy_queried_options *options = state->input;
    switch (key) {
    case WINDOW: options->window = text; return 0;
    case COVERED: options->covered = true; return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

static error_t parse_budget(int key, char *text, struct argp_state *state) {
    struct canopy_queried_options *options = state->input;
    switch (key) {
    case ARGP_KEY_INIT: state->child_inputs[0] = options; return 0;
    case BUDGET: options->budget = text; return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

const struct argp canopy_queried_window_argp = {.options = WINDOW_OPTIONS, .parser = parse_window};
static const struct argp_child WITH_WINDOW[] = {{&canopy_queried_window_argp, 0, NULL, 0}, {0}};
const struct argp canopy_queried_argp = {.options = BUDGET_OPTIONS, .parser = parse_budget, .children = WITH_WINDOW};

static const char *option_name(const struct canopy_queried_options *options) {
    return options->name ? options->name : "window";
}

static bool read_window(const struct canopy_queried_options *options, double edges[4], struct canopy_fault *fault) {
    const char *text = options->window;
    int used = 0;
    bool ok =
        sscanf(text, "%lf,%lf,%lf,%lf%n", &edges[0], &edges[1], &edges[2], &edges[3], &used) == 4 && text[used] == '\0';
    for (int k = 0; ok && k < 4; k++) {
        ok = isfinite(edges[k]);
    }
    return (ok && edges[0] <= edges[1] && edges[2] <= edges[3]) ||
           canopy_fault_set(fault, "--%s %s: give U0,U1,V0,V1 with U0 <= U1 and V0 <= V1", option_name(options), text);
}

/// An edge in quanta of the question, rounded outward and clipped where rounding alone puts it outside the frame.
static bool edge_of(const struct canopy_surrogate *s, int axis, double edge, bool upward, uint32_t *to) {
    const double width = ((double)s->size[axis] - 1.0) * CANOPY_QUERIED_PITCH;
    mpq_t x, y;
    mpz_t whole;
    mpq_inits(x, y, NULL);
    mpz_init(whole);
    mpq_set_d(x, edge);
    mpq_set_d(y, s->unit);
    mpq_div(x, x, y);
    canopy_queried_origin(y, s, axis);
    mpq_sub(x, x, y);
    mpq_set_d(y, s->pitch[axis]);
    mpq_div(x, x, y);
    canopy_queried_multiply(x, CANOPY_QUERIED_PITCH);
    if (upward) {
        mpz_cdiv_q(whole, mpq_numref(x), mpq_denref(x));
    } else {
        mpz_fdiv_q(whole, mpq_numref(x), mpq_denref(x));
    }
    const double quanta = mpz_get_d(whole);
    mpz_clear(whole);
    mpq_clears(x, y, NULL);
    *to = (uint32_t)fmax(0.0, fmin(width, quanta));
    return quanta >= -1.0 && quanta <= width + 1.0;
}

bool canopy_queried_window(const struct canopy_queried *queried, const struct canopy_queried_options *options,
                           struct canopy_query_rect *rect, struct canopy_fault *fault) {
    double edges[4];
    *rect = canopy_query_whole(&queried->low.frame);
    if (!options->window) {
        return true;
    }
    const struct canopy_query_rect whole = *rect;
    if (!read_window(options, edges, fault)) {
        return false;
    }
    const struct canopy_surrogate *s = &queried->surrogate;
    bool inside = true;
    for (int axis = 0; axis < 2; axis++) {
        inside = edge_of(s, axis, edges[2 * axis], false, &rect->low[axis]) && inside;
        inside = edge_of(s, axis, edges[2 * axis + 1], true, &rect->high[axis]) && inside;
    }
    double low[2] = {0.0, 0.0}, high[2] = {0.0, 0.0};
    canopy_queried_place(queried, whole.low, low);
    canopy_queried_place(queried, whole.high, high);
    return inside ||
           canopy_fault_set(fault,
                            "--%s %s: it reaches beyond the frame of %s: give one within "
                            "%.10g,%.10g,%.10g,%.10g",
                            option_name(options), options->window, queried->path, low[0], high[0], low[1], high[1]);
}
