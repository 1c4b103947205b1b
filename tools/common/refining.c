// What was asked for, where that is, and one window after the other.

#include "tools/common/refining.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tools/common/number.h"
#include "tools/common/refining_parts.h"

#define SHARE 4       // a window of its own choice is this part of the grid wide …
#define SPAN_LEAST 3  // … and this many knot intervals at least

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

static enum canopy_status place_rectangle(const struct canopy_refining_request *request,
                                          const struct canopy_refining_ground *ground,
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

static enum canopy_status place_choice(const struct canopy_refining_request *request,
                                       const struct canopy_refining_ground *ground, const uint32_t *gaps,
                                       const struct canopy_refining_windows *taken, struct canopy_refinement *window) {
    uint16_t span[2];
    for (int a = 0; a < 2; a++) {
        const uint32_t all = ground->frame.size[a] - 1U, part = (all + SHARE / 2) / SHARE;
        const uint32_t own = part > SPAN_LEAST ? part : all < SPAN_LEAST ? all : SPAN_LEAST;
        span[a] = (uint16_t)(request->span[a] ? request->span[a] : own);
    }
    const int32_t low[2] = {0, 0};
    const int32_t high[2] = {(int32_t)((uint32_t)span[0] << request->level),
                             (int32_t)((uint32_t)span[1] << request->level)};
    const enum canopy_status status = canopy_refine_place(&ground->frame, request->level, low, high, window);
    return status != CANOPY_OK
               ? status
               : canopy_refine_choose(&ground->frame, gaps, request->level, span, taken->list, taken->count, window);
}

static bool blame_place(const struct canopy_refining_request *request, const struct canopy_refining_ground *ground,
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
    return canopy_fault_set(fault,
                            "--refine %.60s: the window is too small: give one of at least 4 intervals of the refined "
                            "pitch, %.6g x %.6g",
                            request->text, ldexp(ground->pitch[0], -(int)request->level) * 4,
                            ldexp(ground->pitch[1], -(int)request->level) * 4);
}

void canopy_refining_free(struct canopy_refining_windows *windows) {
    for (uint32_t k = 0; k < windows->count; k++) {
        free(windows->list[k].d);
    }
    windows->count = 0;
}

// ---------------------------------------------------------------------------------------------------------------------
// All requests, coarse levels first

/// Room for one more window, of coefficients that are zero.
static bool append(struct canopy_refining_windows *windows, const struct canopy_refinement *window) {
    int32_t *d = calloc((size_t)window->size[0] * window->size[1], sizeof *d);
    if (d) {
        windows->list[windows->count] = *window;
        windows->list[windows->count++].d = d;
    }
    return d != NULL;
}

static bool add_one(const struct canopy_refining_request *request, const struct canopy_refining_ground *ground,
                    const struct canopy_refining_supply *supply, uint32_t *gaps,
                    struct canopy_refining_windows *windows, struct canopy_fault *fault) {
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
    if (status == CANOPY_EMPTY) {
        return true;  // nowhere is a gap, or all such places are taken
    }
    if (status != CANOPY_OK) {
        return blame_place(request, ground, status, fault);
    }
    if (!append(windows, &window)) {
        return canopy_fault_no_memory(fault);
    }
    return supply->fit(supply->context, windows, request, fault);
}

bool canopy_refining_add(const struct canopy_refining *refining, const struct canopy_refining_ground *ground,
                         const struct canopy_refining_supply *supply, struct canopy_refining_windows *windows,
                         struct canopy_fault *fault) {
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

enum canopy_status canopy_refining_run(struct canopy_refine *refine) {
    enum canopy_status status = canopy_refine_begin(refine);
    if (status == CANOPY_OK) {
        while ((status = canopy_refine_step(refine, UINT32_MAX)) == CANOPY_MORE) {}
    }
    return status == CANOPY_EMPTY ? CANOPY_OK : status;  // nothing under the window: it stays zero
}

bool canopy_refining_conclude(enum canopy_status status, const struct canopy_refining_request *request,
                              struct canopy_fault *fault) {
    return status == CANOPY_OK ||
           (status == CANOPY_ARENA_SHORT || status == CANOPY_ARENA_ALIGN
                ? canopy_fault_no_memory(fault)
                : blame(request, fault, "the surface is too far from the points there: choose another --grid"));
}

// ---------------------------------------------------------------------------------------------------------------------
// Surrogates

bool canopy_refining_store(const struct canopy_refining_windows *windows, struct canopy_surrogate *surrogate) {
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

int32_t *canopy_refining_coefficients(const struct canopy_surrogate *s, struct canopy_fault *fault) {
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

struct canopy_refining_ground canopy_refining_survey(const struct canopy_surrogate *s) {
    struct canopy_refining_ground ground = {.frame = {.size = {(uint16_t)s->size[0], (uint16_t)s->size[1]}}};
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
