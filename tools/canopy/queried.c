#include "tools/canopy/queried.h"

#include <gmp.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lib/num/bits.h"
#include "tools/canopy/flat.h"
#include "tools/common/option.h"

// ---------------------------------------------------------------------------------------------------------------------
// Reading

static bool no_memory(const char *path, struct canopy_fault *fault) {
    return canopy_fault_set(fault, "%s: out of memory: close other programs", path);
}

bool canopy_queried_no_memory(const struct canopy_queried *queried, struct canopy_fault *fault) {
    return no_memory(queried->path, fault);
}

/// Memory and frame for the grid of a level. False: no memory.
static bool set_level(struct canopy_queried *queried, unsigned level) {
    const struct canopy_surrogate *s = &queried->surrogate;
    struct canopy_envelope *low = &queried->low, *high = &queried->high;
    const uint32_t m = canopy_flat_size(s, 0, level), n = canopy_flat_size(s, 1, level);
    free(low->coefficients);
    free(high->coefficients);
    free(low->coverage);
    low->coefficients = malloc(CANOPY_COEFFICIENTS(m, n) * sizeof *low->coefficients);
    high->coefficients = malloc(CANOPY_COEFFICIENTS(m, n) * sizeof *high->coefficients);
    low->coverage = high->coverage = calloc(CANOPY_COVERAGE_BYTES(m, n), 1);
    if (!low->coefficients || !high->coefficients || !low->coverage) {
        return false;
    }
    low->frame = (struct canopy_frame){.size = {(uint16_t)m, (uint16_t)n},
                                       .pitch = {CANOPY_QUERIED_PITCH >> level, CANOPY_QUERIED_PITCH >> level},
                                       .cells = 1,
                                       .side = (uint8_t)s->side};
    for (int k = 0; k < 3; k++) {
        low->frame.axis[k][k] = CANOPY_AXIS_ONE;
    }
    high->frame = low->frame;
    for (uint32_t h = 0; h < m - 1; h++) {
        for (uint32_t w = 0; w < n - 1; w++) {
            if (!s->trim || s->trim[(size_t)(h >> level) * (s->size[1] - 1) + (w >> level)]) {
                canopy_bit_set(low->coverage, h * (n - 1) + w);
            }
        }
    }
    queried->level = level;
    return true;
}

bool canopy_queried_read_refined(const char *path, struct canopy_queried *queried, struct canopy_fault *fault) {
    *queried = (struct canopy_queried){.path = path};
    struct canopy_surrogate *s = &queried->surrogate;
    if (!canopy_surrogate_read(path, s, fault)) {
        memset(s, 0, sizeof *s);
        return false;
    }
    queried->low.scalar = queried->high.scalar = (uint8_t)s->scalar;
    return set_level(queried, 0) || no_memory(path, fault);
}

bool canopy_queried_read(const char *path, struct canopy_queried *queried, struct canopy_fault *fault) {
    return canopy_queried_read_refined(path, queried, fault) &&
           (queried->surrogate.window_count == 0 ||
            canopy_fault_set(fault,
                             "%s: \"windows\": this question is about one grid: give a surrogate without refinement "
                             "windows, or make it one with canopy regrid",
                             path));
}

void canopy_queried_free(struct canopy_queried *queried) {
    canopy_surrogate_free(&queried->surrogate);
    free(queried->low.coefficients);
    free(queried->high.coefficients);
    free(queried->low.coverage);
    *queried = (struct canopy_queried){.path = queried->path};
}

bool canopy_queried_match(const struct canopy_queried *a, const struct canopy_queried *b, struct canopy_fault *fault) {
    const struct canopy_surrogate *s = &a->surrogate, *t = &b->surrogate;
    const char *what = s->unit != t->unit                                    ? "units"
                       : memcmp(s->size, t->size, sizeof s->size) != 0       ? "sizes"
                       : memcmp(s->pitch, t->pitch, sizeof s->pitch) != 0    ? "pitches"
                       : memcmp(s->axes, t->axes, sizeof s->axes) != 0       ? "axes"
                       : memcmp(s->origin, t->origin, sizeof s->origin) != 0 ? "origins"
                                                                             : NULL;
    return !what ||
           canopy_fault_set(fault, "%s and %s: their frames have different %s: fit one with --frame of the other",
                            a->path, b->path, what);
}

// ---------------------------------------------------------------------------------------------------------------------
// Steps

static double largest_of(const double *values, size_t count) {
    double largest = 0.0;
    for (size_t i = 0; i < count; i++) {
        largest = fmax(largest, fabs(values[i]));
    }
    return largest;
}

/// No coefficient on any grid, windows added up, is larger.
static double largest_height(const struct canopy_surrogate *s) {
    double sum = largest_of(s->coefficients, (size_t)s->size[0] * s->size[1]);
    for (size_t k = 0; k < s->window_count; k++) {
        sum += largest_of(s->windows[k].coefficients, (size_t)s->windows[k].size[0] * s->windows[k].size[1]);
    }
    return sum * s->lsb;
}

/// Coefficients in steps, rounded down and up.
static bool set_coefficients(struct canopy_queried *q, double step) {
    const struct canopy_surrogate *s = &q->surrogate;
    const size_t count = CANOPY_COEFFICIENTS(q->low.frame.size[0], q->low.frame.size[1]);
    const double ratio = s->lsb / step;
    int exponent = 0;
    const double doubt = frexp(ratio, &exponent) == 0.5 ? 0.0 : 0x1p-50;  // a power of two: products are exact
    for (size_t i = 0; q->level == 0 && i < count; i++) {
        const double x = s->coefficients[i] * ratio;
        q->low.coefficients[i] = (int32_t)floor(x - fabs(x) * doubt);
        q->high.coefficients[i] = (int32_t)ceil(x + fabs(x) * doubt);
    }
    if (q->level > 0 && (!canopy_flat_write(s, q->level, ratio, doubt, false, q->low.coefficients) ||
                         !canopy_flat_write(s, q->level, ratio, doubt, true, q->high.coefficients))) {
        return false;
    }
    q->apart = 0;
    for (size_t i = 0; i < count; i++) {
        const int32_t apart = q->high.coefficients[i] - q->low.coefficients[i];
        q->apart = apart > q->apart ? apart : q->apart;
    }
    return true;
}

double canopy_queried_scale(struct canopy_queried *const queried[], size_t count, double reach) {
    double step = queried[0]->surrogate.lsb;
    unsigned level = 0;
    for (size_t k = 0; k < count; k++) {
        const struct canopy_surrogate *s = &queried[k]->surrogate;
        const unsigned own = canopy_flat_level(s);
        level = own > level ? own : level;
        step = fmin(step, s->lsb);
        reach = fmax(reach, largest_height(s));
    }
    while (reach / step < 0x1p26 && reach > 0.0) {
        step /= 2.0;
    }
    while (reach / step >= 0x1p27) {
        step *= 2.0;
    }
    for (size_t k = 0; k < count; k++) {
        if ((queried[k]->level != level && !set_level(queried[k], level)) || !set_coefficients(queried[k], step)) {
            return 0.0;
        }
    }
    return step;
}

// ---------------------------------------------------------------------------------------------------------------------
// Rational numbers

/// The double next to x, below or above it.
static double rounded(const mpq_t x, bool upward) {
    const double truncated = mpq_get_d(x);
    mpq_t back;
    mpq_init(back);
    mpq_set_d(back, truncated);
    const int sign = mpq_cmp(x, back);
    mpq_clear(back);
    if (upward) {
        return sign > 0 ? nextafter(truncated, HUGE_VAL) : truncated;
    }
    return sign < 0 ? nextafter(truncated, -HUGE_VAL) : truncated;
}

/// sum += a * b
static void add_product(mpq_t sum, double a, double b) {
    mpq_t x, y;
    mpq_inits(x, y, NULL);
    mpq_set_d(x, a);
    mpq_set_d(y, b);
    mpq_mul(x, x, y);
    mpq_add(sum, sum, x);
    mpq_clears(x, y, NULL);
}

static void multiply(mpq_t x, double by) {
    mpq_t y;
    mpq_init(y);
    mpq_set_d(y, by);
    mpq_mul(x, x, y);
    mpq_clear(y);
}

/// The origin along an axis, in device units.
static void origin_along(mpq_t sum, const struct canopy_surrogate *s, int axis) {
    mpq_set_ui(sum, 0, 1);
    for (int k = 0; k < 3; k++) {
        add_product(sum, s->axes[axis][k], s->origin[k]);
    }
}

double canopy_queried_height(const struct canopy_queried *queried, int64_t steps, double step, bool from_zero,
                             bool upward) {
    const struct canopy_surrogate *s = &queried->surrogate;
    mpq_t sum;
    mpq_init(sum);
    if (from_zero) {
        origin_along(sum, s, 2);
    }
    add_product(sum, (double)steps, step);  // |steps| < 2^53
    multiply(sum, s->unit);
    const double height = rounded(sum, upward);
    mpq_clear(sum);
    return height;
}

void canopy_queried_place(const struct canopy_queried *queried, const uint32_t at[2], double place[2]) {
    const struct canopy_surrogate *s = &queried->surrogate;
    mpq_t sum;
    mpq_init(sum);
    for (int axis = 0; axis < 2; axis++) {
        origin_along(sum, s, axis);
        add_product(sum, (double)at[axis] / CANOPY_QUERIED_PITCH, s->pitch[axis]);
        multiply(sum, s->unit);
        place[axis] = mpq_get_d(sum);
    }
    mpq_clear(sum);
}

// ---------------------------------------------------------------------------------------------------------------------
// The command line

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

static bool read_window(const char *text, double edges[4], struct canopy_fault *fault) {
    int used = 0;
    bool ok =
        sscanf(text, "%lf,%lf,%lf,%lf%n", &edges[0], &edges[1], &edges[2], &edges[3], &used) == 4 && text[used] == '\0';
    for (int k = 0; ok && k < 4; k++) {
        ok = isfinite(edges[k]);
    }
    return (ok && edges[0] <= edges[1] && edges[2] <= edges[3]) ||
           canopy_fault_set(fault, "--window %s: give U0,U1,V0,V1 with U0 <= U1 and V0 <= V1", text);
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
    origin_along(y, s, axis);
    mpq_sub(x, x, y);
    mpq_set_d(y, s->pitch[axis]);
    mpq_div(x, x, y);
    multiply(x, CANOPY_QUERIED_PITCH);
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
    if (!read_window(options->window, edges, fault)) {
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
    return inside || canopy_fault_set(fault,
                                      "--window %s: it reaches beyond the frame of %s: give one within "
                                      "%.10g,%.10g,%.10g,%.10g",
                                      options->window, queried->path, low[0], high[0], low[1], high[1]);
}

// ---------------------------------------------------------------------------------------------------------------------
// Extremes

enum { NODES = 65536 };

static bool find(const struct canopy_query_subject *subject, const struct canopy_query_rect *rect,
                 enum canopy_extreme_kind kind, uint32_t budget, struct canopy_extreme_answer *answer, const char *path,
                 struct canopy_fault *fault) {
    struct canopy_extreme_node *nodes = malloc(NODES * sizeof *nodes);
    struct canopy_extreme search;
    enum canopy_status status =
        nodes ? canopy_extreme_begin(&search, subject, rect, kind, 2, nodes, NODES) : CANOPY_ARENA_SHORT;
    if (status == CANOPY_OK) {
        status = canopy_extreme_step(&search, budget);
        *answer = canopy_extreme_answer(&search);
    }
    free(nodes);
    if (status == CANOPY_EMPTY) {
        return canopy_fault_set(fault,
                                "%s: no knot cell in question is covered by data: leave out --covered, or ask "
                                "about a larger --window",
                                path);
    }
    return status == CANOPY_OK || status == CANOPY_MORE || no_memory(path, fault);
}

/// What the subject is at least (the highest asked for) or at most at the place of an answer, from the envelopes on the
/// other side. `attained` is of those that were asked, which may be `apart` off everywhere: this is another way, good
/// where the envelopes differ in few places. Returns the better of the two.
static int32_t attained_at(const struct canopy_queried_question *q, const struct canopy_extreme_answer *answer,
                           bool up) {
    const int32_t sign = up ? 1 : -1;
    const int32_t apart = q->surface->apart + (q->minus ? q->minus->apart : 0) + q->slack;
    const int32_t general = answer->attained - sign * apart;
    if (apart == q->slack) {
        return general;
    }
    int32_t surface[2] = {0, 0}, minus[2] = {0, 0};
    (void)canopy_envelope_height(up ? &q->surface->low : &q->surface->high, answer->at[0], answer->at[1], &surface[0],
                                 &surface[1]);  // cannot fail: the place is in the frame
    if (q->minus) {
        (void)canopy_envelope_height(up ? &q->minus->high : &q->minus->low, answer->at[0], answer->at[1], &minus[0],
                                     &minus[1]);
    }
    double plane = 0.0;
    if (q->plane) {
        const double pitch = q->surface->low.frame.pitch[0];
        plane = ((double)q->plane->at_origin + (double)q->plane->rise[0] * answer->at[0] / pitch +
                 (double)q->plane->rise[1] * answer->at[1] / pitch) /
                (double)CANOPY_QUERY_PLANE_ONE;
    }
    const int32_t there = up ? surface[0] - minus[1] : surface[1] - minus[0];
    const int32_t here = there - (int32_t)lrint(plane) - sign * (1 + q->slack);
    return (here - general) * sign > 0 ? here : general;
}

bool canopy_queried_print(const struct canopy_queried_question *question, const struct canopy_queried_options *options,
                          enum canopy_extreme_kind kind, const char *name, struct canopy_fault *fault) {
    const struct canopy_queried *surface = question->surface, *minus = question->minus;
    const bool up = kind == CANOPY_HIGHEST, from_zero = !minus && !question->plane;
    struct canopy_query_rect rect;
    uint32_t budget = 1000000;
    if (!canopy_queried_window(surface, options, &rect, fault) ||
        (options->budget && !canopy_option_whole32("budget", options->budget, 0, UINT32_MAX, &budget, fault))) {
        return false;
    }
    const struct canopy_query_subject subject = {.surface = up ? &surface->high : &surface->low,
                                                 .minus = !minus ? NULL
                                                          : up   ? &minus->low
                                                                 : &minus->high,
                                                 .plane = question->plane,
                                                 .covered = options->covered};
    struct canopy_extreme_answer answer = {.found = false};
    if (!find(&subject, &rect, kind, budget, &answer, surface->path, fault)) {
        return false;
    }
    const int32_t sign = up ? 1 : -1;
    printf("%s %.17g", name,
           canopy_queried_height(surface, answer.bound + sign * question->slack, question->step, from_zero, up));
    if (answer.found) {
        double place[2];
        canopy_queried_place(surface, answer.at, place);
        printf(" attained %.17g at %.10g %.10g",
               canopy_queried_height(surface, attained_at(question, &answer, up), question->step, from_zero, !up),
               place[0], place[1]);
    }
    putchar('\n');
    return true;
}

// ---------------------------------------------------------------------------------------------------------------------
// Planes

/// x / step in 2^-16 steps, rounded down.
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

/// The plane in device units above the frame's origin: its height at the corner u = v = 0, and its rise a knot
/// interval. With o the origin along the axes: A (o0 + u p0) + B (o1 + v p1) + C / unit - o2.
static void place_plane(const struct canopy_surrogate *s, const double abc[3], mpq_t plane[3]) {
    mpq_t x;
    mpq_init(x);
    mpq_set_d(plane[0], abc[2]);
    mpq_set_d(x, s->unit);
    mpq_div(plane[0], plane[0], x);
    for (int axis = 0; axis < 3; axis++) {
        origin_along(x, s, axis);
        multiply(x, axis < 2 ? abc[axis] : -1.0);
        mpq_add(plane[0], plane[0], x);
    }
    for (int axis = 0; axis < 2; axis++) {
        mpq_set_ui(plane[1 + axis], 0, 1);
        add_product(plane[1 + axis], abc[axis], s->pitch[axis]);
    }
    mpq_clear(x);
}

bool canopy_queried_scale_plane(struct canopy_queried *surface, const double abc[3],
                                struct canopy_queried_question *question, struct canopy_query_plane *plane) {
    struct canopy_queried *const all[] = {surface};
    const struct canopy_surrogate *s = &surface->surrogate;
    mpq_t parts[3];
    mpq_inits(parts[0], parts[1], parts[2], NULL);
    place_plane(s, abc, parts);
    const double far = fabs(mpq_get_d(parts[0])) + fabs(mpq_get_d(parts[1])) * ((double)s->size[0] - 1.0) +
                       fabs(mpq_get_d(parts[2])) * ((double)s->size[1] - 1.0);
    const bool ok = far < 1e300;
    if (ok) {
        question->step = canopy_queried_scale(all, 1, far * 1.0001);
    }
    if (ok && question->step > 0.0) {
        // The envelope's knot intervals may be parts of the surrogate's.
        mpq_div_2exp(parts[1], parts[1], surface->level);
        mpq_div_2exp(parts[2], parts[2], surface->level);
        plane->at_origin = in_steps(parts[0], question->step);
        plane->rise[0] = in_steps(parts[1], question->step);
        plane->rise[1] = in_steps(parts[2], question->step);
        question->plane = plane;
        // Each of the three is rounded by 2^-16 step, two of them times knot intervals.
        question->slack = 1 + (int32_t)(((s->size[0] + s->size[1]) << surface->level) >> 16);
    }
    mpq_clears(parts[0], parts[1], parts[2], NULL);
    return ok;
}

// ---------------------------------------------------------------------------------------------------------------------
// Volumes

/// Adds up a subject; false if a coefficient is beyond its limit, which scaling prevents.
static bool add_up(const struct canopy_envelope *surface, const struct canopy_envelope *minus,
                   const struct canopy_query_rect *rect, bool covered, struct canopy_volume *volume) {
    const struct canopy_query_subject subject = {.surface = surface, .minus = minus, .covered = covered};
    return canopy_volume_begin(volume, &subject, rect) == CANOPY_OK &&
           canopy_volume_step(volume, UINT32_MAX) == CANOPY_OK;
}

/// quanta^2 to input units^2.
static void scale_area(mpq_t x, const struct canopy_surrogate *s) {
    for (int axis = 0; axis < 2; axis++) {
        multiply(x, s->pitch[axis] / CANOPY_QUERIED_PITCH);
        multiply(x, s->unit);
    }
}

/// mantissa * 2^exponent quanta^2 steps, less `height` above the frame's origin times the area, in input units^3.
static double volume_of(const struct canopy_surrogate *s, int64_t mantissa, int exponent, double step, mpq_t height,
                        const mpq_t area, bool upward) {
    mpq_t x, y;
    mpq_inits(x, y, NULL);
    mpq_set_si(x, mantissa, 1);
    if (exponent >= 0) {
        mpq_mul_2exp(x, x, (mp_bitcnt_t)exponent);
    } else {
        mpq_div_2exp(x, x, (mp_bitcnt_t)-exponent);
    }
    multiply(x, step);
    multiply(x, s->unit);
    scale_area(x, s);
    mpq_mul(y, height, area);
    mpq_sub(x, x, y);
    const double volume = rounded(x, upward);
    mpq_clears(x, y, NULL);
    return volume;
}

bool canopy_queried_find_volume(const struct canopy_queried *surface, const struct canopy_queried *minus, double step,
                                double height, const struct canopy_query_rect *rect, bool covered,
                                struct canopy_queried_volume *volume, struct canopy_fault *fault) {
    const struct canopy_surrogate *s = &surface->surrogate;
    struct canopy_volume low, high;
    if (!add_up(&surface->low, minus ? &minus->high : NULL, rect, covered, &low) ||
        !add_up(&surface->high, minus ? &minus->low : NULL, rect, covered, &high)) {
        return canopy_fault_set(fault,
                                "%s: its coefficients are beyond what can be added up: write the file anew with "
                                "canopy fit",
                                surface->path);
    }
    mpq_t area, above, base;
    mpq_inits(area, above, base, NULL);
    mpz_set_ui(mpq_numref(area), (unsigned long)low.area);
    scale_area(area, s);
    if (!minus) {
        origin_along(base, s, 2);
        multiply(base, s->unit);
        mpq_set_d(above, height);
        mpq_sub(above, above, base);
    }
    const struct canopy_volume_answer from = canopy_volume_answer(&low), to = canopy_volume_answer(&high);
    *volume = (struct canopy_queried_volume){
        .low = volume_of(s, from.low, from.exponent, step, above, area, false),
        .high = volume_of(s, to.high, to.exponent, step, above, area, true),
        .area = mpq_get_d(area),
        .cells = low.cells,
    };
    mpq_clears(area, above, base, NULL);
    return true;
}
