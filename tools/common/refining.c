#include "tools/common/refining.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lib/cover/certify.h"
#include "tools/common/fielding.h"
#include "tools/common/number.h"

#define SHARE 4       // a window of its own choice is this part of the grid wide …
#define SPAN_LEAST 3  // … and this many knot intervals at least

/// Windows in the library's own form, with memory of their own.
struct windows {
    uint32_t count;
    struct canopy_refinement list[CANOPY_REFINEMENTS_MAX];
};

// ---------------------------------------------------------------------------------------------------------------------
// What was asked for

static bool read_rectangle(const char *text, const char *end, struct canopy_refining_request *request) {
    double *const to[] = {&request->corner[0], &request->corner[1], &request->opposite[0], &request->opposite[1]};
    const char *p = text;
    for (int k = 0; k < 4; k++) {
        const char *next = p;
        if (canopy_number_read(p, &next, to[k]) != CANOPY_NUMBER_OK || (k < 3 && *next != ',')) {
            return false;
        }
        p = k < 3 ? next + 1 : next;
    }
    return p == end;
}

static bool read_count(const char *text, const char *end, struct canopy_refining_request *request) {
    uint64_t value[3] = {0, 0, 0};
    const char *p = text;
    if (!canopy_number_digits(p, &p, &value[0]) || value[0] < 1 || value[0] > CANOPY_REFINEMENTS_MAX) {
        return false;
    }
    const bool sized = p != end;
    for (int a = 0; sized && a < 2; a++) {
        if (*p != (a == 0 ? ':' : 'x') || !canopy_number_digits(p + 1, &p, &value[a + 1]) || value[a + 1] < 1 ||
            value[a + 1] > CANOPY_SIZE_MAX) {
            return false;
        }
    }
    if (p != end) {
        return false;
    }
    request->everywhere = true;
    request->windows = (uint32_t)value[0];
    request->span[0] = (uint32_t)value[1];
    request->span[1] = (uint32_t)value[2];
    return true;
}

bool canopy_refining_read(const char *text, struct canopy_refining *refining, struct canopy_fault *fault) {
    const char *at = strrchr(text, '@');
    const char *end = at ? at : text + strlen(text);
    struct canopy_refining_request request = {.text = text, .level = 1};
    uint32_t level = 1;
    if (refining->count == CANOPY_REFINEMENTS_MAX) {
        return canopy_fault_set(fault, "--refine %.60s: give it at most %d times", text, CANOPY_REFINEMENTS_MAX);
    }
    if ((at && !canopy_number_whole32(at + 1, 1, CANOPY_REFINEMENT_LEVELS, &level)) ||
        (!read_count(text, end, &request) && !read_rectangle(text, end, &request))) {
        return canopy_fault_set(fault,
                                "--refine %.60s: give N, N:RxC or X0,Y0,X1,Y1, and behind it @1 for half or @2 for "
                                "quarter pitch; N from 1 to %d windows",
                                text, CANOPY_REFINEMENTS_MAX);
    }
    request.level = level;
    refining->requests[refining->count++] = request;
    return true;
}

static bool blame(const struct canopy_refining_request *request, struct canopy_fault *fault, const char *what) {
    return canopy_fault_set(fault, "--refine %.60s: %s", request->text, what);
}

// ---------------------------------------------------------------------------------------------------------------------
// Where that is

/// The grid a request is placed on: where its knots are, in input units.
struct ground {
    struct canopy_frame frame;
    double origin[2];
    double pitch[2];
};

static enum canopy_status place_rectangle(const struct canopy_refining_request *request, const struct ground *ground,
                                          struct canopy_refinement *window) {
    int32_t low[2];
    int32_t high[2];
    for (int a = 0; a < 2; a++) {
        const double from = fmin(request->corner[a], request->opposite[a]);
        const double to = fmax(request->corner[a], request->opposite[a]);
        const double scale = (double)(1U << request->level) / ground->pitch[a];
        const double end = (double)((ground->frame.size[a] - 1U) << request->level);
        const double l = rint((from - ground->origin[a]) * scale);
        const double h = rint((to - ground->origin[a]) * scale);
        low[a] = l < 0.0 || l > end ? -1 : (int32_t)l;
        high[a] = h < 0.0 || h > end ? (int32_t)end + 1 : (int32_t)h;
    }
    return canopy_refine_place(&ground->frame, request->level, low, high, window);
}

static enum canopy_status place_choice(const struct canopy_refining_request *request, const struct ground *ground,
                                       const uint32_t *gaps, const struct windows *taken,
                                       struct canopy_refinement *window) {
    uint16_t span[2];
    for (int a = 0; a < 2; a++) {
        const uint32_t all = ground->frame.size[a] - 1U, part = (all + SHARE / 2) / SHARE;
        const uint32_t own = part > SPAN_LEAST ? part : all < SPAN_LEAST ? all : SPAN_LEAST;
        span[a] = (uint16_t)(request->span[a] ? request->span[a] : own);
    }
    return canopy_refine_choose(&ground->frame, gaps, request->level, span, taken->list, taken->count, window);
}

static bool blame_place(const struct canopy_refining_request *request, const struct ground *ground,
                        enum canopy_status status, struct canopy_fault *fault) {
    if (status == CANOPY_OUT_OF_FRAME && !request->everywhere) {
        return canopy_fault_set(
            fault, "--refine %.60s: the window is not inside the grid: it reaches from %.9g,%.9g to %.9g,%.9g",
            request->text, ground->origin[0], ground->origin[1],
            ground->origin[0] + (ground->frame.size[0] - 1) * ground->pitch[0],
            ground->origin[1] + (ground->frame.size[1] - 1) * ground->pitch[1]);
    }
    if (status == CANOPY_OUT_OF_FRAME) {
        return canopy_fault_set(fault, "--refine %.60s: the grid has %dx%d knot intervals: give a smaller window",
                                request->text, ground->frame.size[0] - 1, ground->frame.size[1] - 1);
    }
    if (status == CANOPY_EMPTY) {
        return blame(request, fault,
                     "there is no place left for another window, or none of that size has room for a B-spline: give "
                     "fewer, or others");
    }
    return canopy_fault_set(fault,
                            "--refine %.60s: the window is too small: give one of at least 4 intervals of the refined "
                            "pitch, %.6g x %.6g",
                            request->text, ldexp(ground->pitch[0], -(int)request->level) * 4,
                            ldexp(ground->pitch[1], -(int)request->level) * 4);
}

static void free_windows(struct windows *windows) {
    for (uint32_t k = 0; k < windows->count; k++) {
        free(windows->list[k].d);
    }
    windows->count = 0;
}

// ---------------------------------------------------------------------------------------------------------------------
// All requests, coarse levels first

/// Where gaps and constraints come from: the points or the field.
struct supply {
    void *context;
    bool (*gaps)(void *context, const struct windows *windows, uint32_t *gaps, struct canopy_fault *fault);
    /// Fits the last of the windows.
    bool (*fit)(void *context, struct windows *windows, const struct canopy_refining_request *request,
                struct canopy_fault *fault);
};

/// Room for one more window, of coefficients that are zero.
static bool append(struct windows *windows, const struct canopy_refinement *window) {
    int32_t *d = calloc((size_t)window->size[0] * window->size[1], sizeof *d);
    if (d) {
        windows->list[windows->count] = *window;
        windows->list[windows->count++].d = d;
    }
    return d != NULL;
}

static bool add_one(const struct canopy_refining_request *request, const struct ground *ground,
                    const struct supply *supply, uint32_t *gaps, struct windows *windows, struct canopy_fault *fault) {
    struct canopy_refinement window = {0};
    if (windows->count == CANOPY_REFINEMENTS_MAX) {
        return canopy_fault_set(fault, "--refine %.60s: more than %d windows: give fewer", request->text,
                                CANOPY_REFINEMENTS_MAX);
    }
    if (request->everywhere && !supply->gaps(supply->context, windows, gaps, fault)) {
        return false;
    }
    const enum canopy_status status = request->everywhere ? place_choice(request, ground, gaps, windows, &window)
                                                          : place_rectangle(request, ground, &window);
    if (status != CANOPY_OK) {
        return blame_place(request, ground, status, fault);
    }
    if (!append(windows, &window)) {
        return canopy_fault_no_memory(fault);
    }
    return supply->fit(supply->context, windows, request, fault);
}

static bool add_all(const struct canopy_refining *refining, const struct ground *ground, const struct supply *supply,
                    struct windows *windows, struct canopy_fault *fault) {
    uint32_t *gaps = malloc((size_t)(ground->frame.size[0] - 1) * (ground->frame.size[1] - 1U) * sizeof *gaps);
    bool ok = gaps != NULL || canopy_fault_no_memory(fault);
    for (unsigned level = 1; level <= CANOPY_REFINEMENT_LEVELS; level++) {
        for (uint32_t k = 0; ok && k < refining->count; k++) {
            const struct canopy_refining_request *request = &refining->requests[k];
            const uint32_t count = request->level != level ? 0 : request->everywhere ? request->windows : 1;
            for (uint32_t w = 0; ok && w < count; w++) {
                ok = add_one(request, ground, supply, gaps, windows, fault);
            }
        }
    }
    free(gaps);
    return ok;
}

/// Begins and goes as far as it goes.
static enum canopy_status run(struct canopy_refine *refine) {
    enum canopy_status status = canopy_refine_begin(refine);
    if (status == CANOPY_OK) {
        while ((status = canopy_refine_step(refine, UINT32_MAX)) == CANOPY_MORE) {}
    }
    return status == CANOPY_EMPTY ? CANOPY_OK : status;  // nothing under the window: it stays zero
}

static bool conclude(enum canopy_status status, const struct canopy_refining_request *request,
                     struct canopy_fault *fault) {
    return status == CANOPY_OK ||
           (status == CANOPY_ARENA_SHORT || status == CANOPY_ARENA_ALIGN
                ? canopy_fault_no_memory(fault)
                : blame(request, fault, "the surface is too far from the points there: choose another --grid"));
}

// ---------------------------------------------------------------------------------------------------------------------
// From the points

struct points {
    const struct canopy_cloud *cloud;
    struct canopy_surrogate *surrogate;
    struct ground ground;
    int32_t *b;       ///< in the library's orientation
    double *heights;  ///< of the surface so far over each point
};

/// A point on the knots: interval and place in it along both axes, height in steps, rounded up.
static int32_t locate(const struct points *points, size_t index, uint32_t interval[2], float s[2]) {
    const struct canopy_surrogate *from = points->surrogate;
    const struct canopy_cloud *cloud = points->cloud;
    double d[3];
    double q[3];
    for (int k = 0; k < 3; k++) {
        const size_t at = index * cloud->stride;
        d[k] = (cloud->scalar == CANOPY_F32 ? (double)((const float *)cloud->axis[k])[at]
                                            : (double)((const int32_t *)cloud->axis[k])[at]) -
               from->origin[k];
    }
    for (int i = 0; i < 3; i++) {
        q[i] = from->axes[i][0] * d[0] + from->axes[i][1] * d[1] + from->axes[i][2] * d[2];
    }
    for (int a = 0; a < 2; a++) {
        const double end = (double)from->size[a] - 1.0;
        const double u = fmin(fmax(q[a] / from->pitch[a], 0.0), end);
        const double h = fmin(floor(u), end - 1.0);
        interval[a] = (uint32_t)h;
        s[a] = (float)(u - h);
    }
    const double steps = ceil((from->side == CANOPY_ABOVE ? q[2] : -q[2]) / from->lsb);
    return (int32_t)fmax(fmin(steps, 1 << 30), -CANOPY_HEIGHT_LIMIT);
}

/// What a quarter of a knot cell along each axis has of points: how many, and their least gap, in steps.
struct quarter {
    double least;
    uint32_t count;
};

/// Gathers the points' gaps. Those of the surface so far are in points->heights.
static void gather(const struct points *points, struct quarter *quarters) {
    const struct canopy_surrogate *s = points->surrogate;
    const double sign = s->side == CANOPY_ABOVE ? 1.0 : -1.0;
    for (size_t p = 0; p < points->cloud->count; p++) {
        uint32_t interval[2];
        float at[2];
        size_t part[2];
        const int32_t height = locate(points, p, interval, at);
        const double gap = fmax(sign * points->heights[p] / s->lsb - (double)height, 0.0);
        for (int a = 0; a < 2; a++) {
            part[a] = (size_t)interval[a] * 4 + (size_t)fminf(at[a] * 4.0F, 3.0F);
        }
        struct quarter *quarter = &quarters[part[0] * 4 * (s->size[1] - 1) + part[1]];
        quarter->least = quarter->count > 0 ? fmin(quarter->least, gap) : gap;
        quarter->count++;
    }
}

/// What finer knots may win: the gap that all points of a quarter cell have in common. (The mean gap alone is large at
/// silhouettes, too, where no smooth surface can come nearer.)
static void sum_up(const struct canopy_surrogate *s, const struct quarter *quarters, uint32_t *gaps) {
    const size_t columns = s->size[1] - 1, cells = (s->size[0] - 1) * columns;
    double all = 0.0;
    for (size_t q = 0; q < 16 * cells; q++) {
        all += quarters[q].least * quarters[q].count;
    }
    memset(gaps, 0, cells * sizeof *gaps);
    for (size_t q = 0; all > 0.0 && q < 16 * cells; q++) {
        const size_t row = q / (4 * columns) / 4, column = q % (4 * columns) / 4;
        gaps[row * columns + column] += (uint32_t)(quarters[q].least * quarters[q].count / all * 4e9);
    }
}

static bool gaps_of_points(void *context, const struct windows *windows, uint32_t *gaps, struct canopy_fault *fault) {
    struct points *points = context;
    (void)windows;  // they are in the surrogate
    const struct canopy_surrogate *s = points->surrogate;
    struct canopy_exact *exact = canopy_exact_open(s);
    struct quarter *quarters = calloc((size_t)16 * (s->size[0] - 1) * (s->size[1] - 1), sizeof *quarters);
    const bool ok = exact && quarters;
    if (ok) {
        canopy_exact_heights(exact, points->cloud, points->heights);
        gather(points, quarters);
        sum_up(s, quarters, gaps);
    }
    canopy_exact_close(exact);
    free(quarters);
    return ok || canopy_fault_no_memory(fault);
}

static enum canopy_status add_points(const struct points *points, struct canopy_refine *refine) {
    enum canopy_status status = CANOPY_OK;
    for (size_t p = 0; status == CANOPY_OK && p < points->cloud->count; p++) {
        uint32_t interval[2];
        float s[2];
        const int32_t height = locate(points, p, interval, s);
        status = canopy_refine_add(refine, interval, s, height);
    }
    return status;
}

/// Points that the window may reach.
static size_t count_points(const struct points *points, const struct canopy_refinement *window) {
    size_t count = 0;
    for (size_t p = 0; p < points->cloud->count; p++) {
        uint32_t interval[2];
        float s[2];
        bool inside = true;
        locate(points, p, interval, s);
        for (int a = 0; a < 2; a++) {
            const float x = ldexpf((float)interval[a] + s[a], window->level);
            inside = inside && x >= (float)window->first[a] - 2.1F &&
                     x <= (float)(window->first[a] + window->size[a]) + 1.1F;
        }
        count += inside;
    }
    return count;
}

/// The last of the windows into the surrogate, where the next look at gaps finds it.
static bool store_last(const struct windows *windows, struct canopy_surrogate *surrogate) {
    const struct canopy_refinement *from = &windows->list[windows->count - 1];
    const size_t count = (size_t)from->size[0] * from->size[1];
    const double sign = surrogate->side == CANOPY_ABOVE ? 1.0 : -1.0;
    struct canopy_window *all = realloc(surrogate->windows, windows->count * sizeof *all);
    if (!all) {
        return false;
    }
    surrogate->windows = all;
    struct canopy_window *to = &all[surrogate->window_count];
    *to = (struct canopy_window){.level = from->level,
                                 .first = {from->first[0], from->first[1]},
                                 .size = {from->size[0], from->size[1]},
                                 .coefficients = malloc(count * sizeof *to->coefficients)};
    if (!to->coefficients) {
        return false;
    }
    surrogate->window_count++;
    for (size_t i = 0; i < count; i++) {
        to->coefficients[i] = from->d[i] == 0 ? 0.0 : sign * (double)from->d[i];
    }
    return true;
}

static bool fit_to_points(void *context, struct windows *windows, const struct canopy_refining_request *request,
                          struct canopy_fault *fault) {
    struct points *points = context;
    const struct canopy_refinement *window = &windows->list[windows->count - 1];
    const size_t rows = CANOPY_REFINE_ROWS(window->size[0], window->size[1], count_points(points, window));
    const size_t bytes = CANOPY_REFINE_ARENA(window->size[0], window->size[1], rows);
    void *arena = malloc(bytes);
    if (!arena) {
        return canopy_fault_no_memory(fault);
    }
    struct canopy_refine refine;
    enum canopy_status status = canopy_refine_init(&refine, &points->ground.frame, points->b, windows->list,
                                                   windows->count, rows, arena, bytes);
    if (status == CANOPY_OK) {
        status = add_points(points, &refine);
    }
    if (status == CANOPY_OK) {
        status = run(&refine);
    }
    free(arena);
    return conclude(status, request, fault) &&
           (store_last(windows, points->surrogate) || canopy_fault_no_memory(fault));
}

/// The coefficients as the library has them; NULL after a fault.
static int32_t *take_coefficients(const struct canopy_surrogate *s, struct canopy_fault *fault) {
    const size_t count = (size_t)s->size[0] * s->size[1];
    int32_t *b = malloc(count * sizeof *b);
    if (!b) {
        canopy_fault_no_memory(fault);
        return NULL;
    }
    for (size_t i = 0; i < count; i++) {
        if (!(fabs(s->coefficients[i]) <= CANOPY_REFINED_LIMIT)) {
            canopy_fault_set(fault, "coefficients beyond 2^28 steps cannot be refined: choose another --frame");
            free(b);
            return NULL;
        }
        b[i] = (int32_t)(s->side == CANOPY_ABOVE ? s->coefficients[i] : -s->coefficients[i]);
    }
    return b;
}

/// Where a surrogate's knots are.
static struct ground ground_of(const struct canopy_surrogate *s) {
    struct ground ground = {.frame = {.size = {(uint16_t)s->size[0], (uint16_t)s->size[1]}}};
    for (int a = 0; a < 2; a++) {
        double origin = 0.0;
        for (int k = 0; k < 3; k++) {
            origin += s->axes[a][k] * s->origin[k];
        }
        ground.origin[a] = origin * s->unit;
        ground.pitch[a] = s->pitch[a] * s->unit;
    }
    return ground;
}

static bool survey(struct points *points, struct canopy_fault *fault) {
    points->ground = ground_of(points->surrogate);
    points->b = take_coefficients(points->surrogate, fault);
    points->heights = points->b ? malloc(points->cloud->count * sizeof *points->heights) : NULL;
    return points->heights != NULL || (points->b && canopy_fault_no_memory(fault));
}

bool canopy_refining_points(const struct canopy_refining *refining, const struct canopy_cloud *cloud,
                            struct canopy_surrogate *surrogate, struct canopy_fault *fault) {
    struct canopy_surrogate bare = *surrogate;
    bare.trim = NULL;
    struct points points = {.cloud = cloud, .surrogate = &bare};
    struct windows windows = {0};
    const struct supply supply = {&points, gaps_of_points, fit_to_points};
    const bool ok = survey(&points, fault) && add_all(refining, &points.ground, &supply, &windows, fault);
    surrogate->windows = bare.windows;
    surrogate->window_count = bare.window_count;
    free_windows(&windows);
    free(points.b);
    free(points.heights);
    return ok;
}

// ---------------------------------------------------------------------------------------------------------------------
// From a field

struct from_field {
    struct canopy_surrogate *surrogate;
    struct canopy_fielding cells;
    const int32_t *b;  ///< in the library's orientation
    struct canopy_certify base;
    struct canopy_refine_certify certify;
    void *arena[2];
};

static bool gaps_of_field(void *context, const struct windows *windows, uint32_t *gaps, struct canopy_fault *fault) {
    struct from_field *from = context;
    (void)fault;
    canopy_refine_gaps(&from->cells.field, from->b, windows->list, windows->count, gaps);
    return true;
}

static bool fit_to_field(void *context, struct windows *windows, const struct canopy_refining_request *request,
                         struct canopy_fault *fault) {
    struct from_field *from = context;
    const struct canopy_refinement *window = &windows->list[windows->count - 1];
    const size_t rows = CANOPY_REFINE_NODES(window->size[0], window->size[1], from->cells.field.axis[0].cells,
                                            from->cells.field.axis[1].cells, window->level);
    const size_t bytes = CANOPY_REFINE_ARENA(window->size[0], window->size[1], rows);
    void *arena = malloc(bytes);
    if (!arena) {
        return canopy_fault_no_memory(fault);
    }
    struct canopy_refine refine;
    enum canopy_status status = canopy_refine_init(&refine, &from->cells.field.frame, from->b, windows->list,
                                                   windows->count, rows, arena, bytes);
    if (status == CANOPY_OK) {
        status = canopy_refine_field(&refine, &from->certify);
    }
    if (status == CANOPY_OK) {
        status = run(&refine);
    }
    free(arena);
    return conclude(status, request, fault) && (store_last(windows, from->surrogate) || canopy_fault_no_memory(fault));
}

/// The base's own certificate, which is known to hold, and the windows'.
static bool certify_base(struct from_field *from, uint16_t cells, struct canopy_fault *fault) {
    const size_t base = CANOPY_CERTIFY_ARENA(from->cells.field.frame.size[1], cells, cells);
    const size_t windows = CANOPY_REFINE_CERTIFY_ARENA(cells, cells);
    from->arena[0] = malloc(base);
    from->arena[1] = malloc(windows);
    if (!from->arena[0] || !from->arena[1]) {
        return canopy_fault_no_memory(fault);
    }
    if (canopy_certify_init(&from->base, &from->cells.field, from->arena[0], base) != CANOPY_OK ||
        canopy_refine_certify_init(&from->certify, &from->cells.field, &from->base, from->arena[1], windows) !=
            CANOPY_OK) {
        return canopy_fault_set(fault, "--refine needs a field whose cells are whole quanta: leave --frame or --field "
                                       "out");
    }
    canopy_certify_begin(&from->base, from->b);
    return canopy_certify_step(&from->base, UINT32_MAX) == CANOPY_OK ||
           canopy_fault_set(fault, "the field's certificate failed: choose another --grid or --field");
}

/// The whole list once more, as it is published.
static bool certify_all(struct from_field *from, const struct windows *windows, struct canopy_fault *fault) {
    return (canopy_refine_certify_begin(&from->certify, from->b, windows->list, windows->count) == CANOPY_OK &&
            canopy_refine_certify_step(&from->certify, UINT32_MAX) == CANOPY_OK) ||
           canopy_fault_set(fault, "the windows' certificate failed: choose another --refine");
}

bool canopy_refining_field(const struct canopy_refining *refining, const struct canopy_turned *turned,
                           const struct canopy_frame *frame, uint16_t cells, bool packed,
                           struct canopy_surrogate *surrogate, struct canopy_fault *fault) {
    struct from_field from = {.surrogate = surrogate};
    struct ground ground = ground_of(surrogate);
    struct windows windows = {0};
    const struct supply supply = {&from, gaps_of_field, fit_to_field};
    bool ok = true;
    for (uint32_t k = 0; ok && k < refining->count; k++) {
        const uint32_t step = 1U << refining->requests[k].level;
        ok = cells % step == 0 || canopy_fault_set(fault, "--refine %.60s: give a --field that is a multiple of %u",
                                                   refining->requests[k].text, step);
    }
    int32_t *b = ok ? take_coefficients(surrogate, fault) : NULL;
    from.b = b;
    ok = b && canopy_fielding_open(&from.cells, turned, frame, (const uint16_t[2]){cells, cells}, packed, fault) &&
         certify_base(&from, cells, fault) && add_all(refining, &ground, &supply, &windows, fault) &&
         certify_all(&from, &windows, fault);
    free_windows(&windows);
    free(b);
    for (int k = 0; k < 2; k++) {
        free(from.arena[k]);
    }
    canopy_fielding_close(&from.cells);
    return ok;
}
