// canopy-tightness: how near the tight method comes to the tightest surface, how fast, and whether all it publishes on
// the way is safe.

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "lib/cover/envelope.h"
#include "lib/cover/fast.h"
#include "lib/cover/tighten.h"
#include "tools/common/load.h"
#include "tools/common/surface.h"

static const char USAGE[] =
    "Usage: canopy-tightness ORACLE.json NAME=POINTS...\n\n"
    "For each point file, both sides, 10x10 and 20x20: the mean gap of fast, and of tight after 6, 10 and 16\n"
    "iterations and at its end, over the optimum in ORACLE.json (what lp_oracle.py prints, by \"NAME 10x10 above\");\n"
    "what tight itself proves of that; processor time of tight (fast not included) to 1.02 times the optimum and to "
    "its\n"
    "end, and the oracle's solver's over each;\npoints on the wrong side in exact arithmetic, in all published "
    "surfaces together.\n";

#define NEAR 1.02  // of the optimum: the goal
enum { MARKS = 4 };
static const unsigned marks[MARKS] = {6, 10, 16, CANOPY_TIGHTEN_ITERATIONS};

struct run {
    struct canopy_surrogate surrogate;  // its coefficients are those judged
    struct canopy_cloud cloud;
    struct canopy_frame frame;
    int32_t *b, *judged;
    uint64_t wrong;
    double gap[MARKS], first_gap, ms[MARKS];
    double near_gap, near_ms;  // the gap that is near enough, and when it was reached; 0: not yet
};

static double now_ms(void) {
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e3 * (double)t.tv_sec + 1e-6 * (double)t.tv_nsec;
}

// The mean gap in per cent of what is published, and whether it is safe.
static double judge(struct run *run) {
    const size_t count = CANOPY_COEFFICIENTS(run->frame.size[0], run->frame.size[1]);
    struct canopy_exact_result result;
    memcpy(run->judged, run->b, 4 * count);
    canopy_fast_orient(&run->frame, run->judged);
    for (size_t i = 0; i < count; i++) {
        run->surrogate.coefficients[i] = run->judged[i];
    }
    if (!canopy_exact_check(&run->surrogate, &run->cloud, &result)) {
        return NAN;
    }
    run->wrong += result.wrong + result.outside;
    return canopy_exact_mean_gap(&result);
}

// Tightens; judging takes no part in the time.
static void tighten(struct run *run, struct canopy_tighten *t) {
    unsigned iterations = 0, mark = 0;
    uint32_t published = t->published;
    double took = 0, gap = run->first_gap;
    enum canopy_status status = CANOPY_MORE;
    while (mark < MARKS) {
        const double start = now_ms();
        while (status == CANOPY_MORE && (t->iterations == iterations || t->stage == CANOPY_TIGHTEN_PUBLISH ||
                                         t->stage == CANOPY_TIGHTEN_COMPARE)) {
            status = canopy_tighten_step(t, 1);
        }
        took += now_ms() - start;
        iterations = t->iterations;
        if (t->published != published || status == CANOPY_OK) {  // the end bends what is free
            gap = judge(run);
            published = t->published;
        }
        run->near_ms = run->near_ms == 0 && gap <= run->near_gap ? took : run->near_ms;
        if (getenv("TIGHTNESS_TRACE") != NULL) {
            printf("  %2u gap %.4f %% (own %.4f) alpha %.3f %.3f mu %.2e bound %.4f\n", iterations, gap,
                   100 * (double)t->mean_gap / (double)t->range, (double)t->alpha[0], (double)t->alpha[1],
                   (double)t->mu, 100 * (double)t->bound / (double)t->range);
        }
        for (; mark < MARKS && (iterations >= marks[mark] || status == CANOPY_OK); mark++) {
            run->gap[mark] = gap;
            run->ms[mark] = took;
        }
    }
}

static bool box(const struct canopy_device_list *list, float low[3], float high[3]) {
    for (int a = 0; a < 3; a++) {
        low[a] = high[a] = list->points[0].f32[a];
        for (size_t i = 1; i < list->count; i++) {
            low[a] = fminf(low[a], list->points[i].f32[a]);
            high[a] = fmaxf(high[a], list->points[i].f32[a]);
        }
    }
    return list->count > 0;
}

static bool fit(const struct canopy_loaded *points, uint16_t size, enum canopy_side side, struct run *run,
                struct canopy_tighten *t, void **arena, struct canopy_fault *fault) {
    const struct canopy_surface_wish wish = {
        .size = {size, size}, .side = side, .scalar = CANOPY_F32, .unit = points->unit, .direction = {0, 0, 1}};
    const struct canopy_grid grid = {{size, size}, 4, (uint8_t)side};
    struct canopy_surface_report report;
    float low[3], high[3];
    if (!canopy_surface_fit(&points->list, &wish, &run->surrogate, &report, fault)) {
        return false;
    }
    if (!box(&points->list, low, high) || canopy_frame_around_f32(&run->frame, &grid, low, high) != CANOPY_OK ||
        run->surrogate.lsb != ldexp(1, run->frame.lsb_log2 + run->frame.quantum_log2)) {
        return canopy_fault_set(fault, "the frame is not that of canopy fit");
    }
    const size_t count = CANOPY_COEFFICIENTS(size, size), bytes = CANOPY_TIGHTEN_ARENA(size, size, points->list.count);
    run->b = malloc(4 * count);
    run->judged = malloc(4 * count);
    *arena = malloc(bytes);
    if (!run->b || !run->judged || !*arena) {
        return canopy_fault_set(fault, "out of memory");
    }
    for (size_t i = 0; i < count; i++) {
        run->b[i] = (int32_t)run->surrogate.coefficients[i];
    }
    run->cloud = canopy_device_list_cloud(&points->list);
    canopy_fast_orient(&run->frame, run->b);
    const double start = now_ms();
    const bool ok = canopy_tighten_init(t, &run->frame, points->list.count, *arena, bytes) == CANOPY_OK &&
                    canopy_tighten_points_f32(t, (const float(*)[3]) & points->list.points[0].f32,
                                              points->list.count) == CANOPY_OK &&
                    canopy_tighten_begin(t, run->b, true) == CANOPY_OK;
    const double took = now_ms() - start;
    if (!ok) {
        return canopy_fault_set(fault, "cannot tighten");
    }
    run->first_gap = judge(run);
    tighten(run, t);
    for (int k = 0; k < MARKS; k++) {
        run->ms[k] += took;
    }
    run->near_ms += took;
    return true;
}

static bool one(const json_t *oracle, const char *name, const struct canopy_loaded *points, uint16_t size,
                enum canopy_side side, struct canopy_fault *fault) {
    char key[100];
    snprintf(key, sizeof key, "%s %ux%u %s", name, size, size, side == CANOPY_ABOVE ? "above" : "below");
    const json_t *best = json_object_get(oracle, key);
    const double gap = 100 * json_number_value(json_object_get(best, "mean_gap"));
    const double solver = json_number_value(json_object_get(best, "solver_s"));
    struct run run = {.near_gap = NEAR * gap};
    struct canopy_tighten t = {0};
    void *arena = NULL;
    const bool ok = fit(points, size, side, &run, &t, &arena, fault);
    if (ok) {
        printf("%-24s %8.4f %7.3f %7.3f %7.3f %7.4f %7.4f %4d %8.2f%% %8.1f %7.0f %8.1f %7.0f %6llu\n", key, gap,
               run.first_gap / gap, run.gap[0] / gap, run.gap[1] / gap, run.gap[2] / gap, run.gap[3] / gap,
               t.iterations, 100 * (double)canopy_tighten_excess(&t), run.near_ms, 1e3 * solver / run.near_ms,
               run.ms[3], 1e3 * solver / run.ms[3], (unsigned long long)run.wrong);
        canopy_surrogate_free(&run.surrogate);
    }
    free(run.b);
    free(run.judged);
    free(arena);
    return ok;
}

int main(int argc, char **argv) {
    if (argc < 3) {
        fputs(USAGE, stderr);
        return 64;
    }
    json_error_t error;
    json_t *oracle = json_load_file(argv[1], 0, &error);
    struct canopy_fault fault = {0};
    bool ok = oracle != NULL;
    if (!ok) {
        fprintf(stderr, "%s: %s\n", argv[1], error.text);
    }
    printf("%-24s %8s %7s %7s %7s %7s %7s %4s %9s %8s %7s %8s %7s %6s\n", "", "oracle %", "fast x", "6 it", "10 it",
           "16 it", "end", "its", "proved", "ms 1.02", "HiGHS/", "ms end", "HiGHS/", "wrong");
    for (int i = 2; ok && i < argc; i++) {
        char name[60];
        const char *path = strchr(argv[i], '=');
        const size_t length = path ? (size_t)(path - argv[i]) : 0;
        const struct canopy_load_wish wish = {.scalar = CANOPY_F32, .unit = 1};
        struct canopy_loaded points;
        if (length == 0 || length >= sizeof name) {
            fputs(USAGE, stderr);
            json_decref(oracle);
            return 64;
        }
        memcpy(name, argv[i], length);
        name[length] = '\0';
        ok = canopy_load(path + 1, &wish, &points, &fault);
        for (unsigned k = 0; ok && k < 4; k++) {
            ok = one(oracle, name, &points, k < 2 ? 10 : 20, k % 2 ? CANOPY_BELOW : CANOPY_ABOVE, &fault);
            fflush(stdout);
        }
        if (ok) {
            canopy_device_list_free(&points.list);
        } else {
            fprintf(stderr, "canopy-tightness: %s\n", fault.text);
        }
    }
    json_decref(oracle);
    return ok ? 0 : 2;
}
