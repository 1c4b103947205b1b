// Windows from the points: on top of a surface that is safe, and judged exactly afterwards.

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tools/common/refining_parts.h"

struct points {
    const struct canopy_cloud *cloud;
    struct canopy_surrogate *surrogate;
    struct canopy_refining_ground ground;
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

static bool gaps_of_points(void *context, const struct canopy_refining_windows *windows, uint32_t *gaps,
                           struct canopy_fault *fault) {
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

static bool fit_to_points(void *context, struct canopy_refining_windows *windows,
                          const struct canopy_refining_request *request, struct canopy_fault *fault) {
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
        status = canopy_refining_run(&refine);
    }
    free(arena);
    return canopy_refining_conclude(status, request, fault) &&
           (canopy_refining_store(windows, points->surrogate) || canopy_fault_no_memory(fault));
}

static bool survey(struct points *points, struct canopy_fault *fault) {
    points->ground = canopy_refining_survey(points->surrogate);
    points->b = canopy_refining_coefficients(points->surrogate, fault);
    points->heights = points->b ? malloc(points->cloud->count * sizeof *points->heights) : NULL;
    return points->heights != NULL || (points->b && canopy_fault_no_memory(fault));
}

bool canopy_refining_points(const struct canopy_refining *refining, const struct canopy_cloud *cloud,
                            struct canopy_surrogate *surrogate, struct canopy_fault *fault) {
    struct canopy_surrogate bare = *surrogate;
    bare.trim = NULL;
    struct points points = {.cloud = cloud, .surrogate = &bare};
    struct canopy_refining_windows windows = {0};
    const struct canopy_refining_supply supply = {&points, gaps_of_points, fit_to_points};
    const bool ok = survey(&points, fault) && canopy_refining_add(refining, &points.ground, &supply, &windows, fault);
    surrogate->windows = bare.windows;
    surrogate->window_count = bare.window_count;
    canopy_refining_free(&windows);
    free(points.b);
    free(points.heights);
    return ok;
}
