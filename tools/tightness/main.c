// canopy-tightness: how near the tight method comes to the tightest surface, how fast, and whether all it publishes on
// the way is safe.

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "lib/cover/certify.h"
#include "lib/cover/envelope.h"
#include "lib/cover/fast.h"
#include "lib/cover/field.h"
#include "lib/cover/tighten.h"
#include "tools/common/load.h"
#include "tools/common/surface.h"

static const char USAGE[] =
    "Usage: canopy-tightness [--field Q] [--rows R] ORACLE.json NAME=POINTS...\n\n"
    "For each point file, both sides, 10x10 and 20x20: the mean gap of fast, and of tight after 6, 10 and 16\n"
    "iterations and at its end, over the optimum in ORACLE.json (what lp_oracle.py prints, by \"NAME 10x10 above\");\n"
    "what tight itself proves; processor time of tight (fast not included) to 1.02 times the optimum and to its end,\n"
    "and the oracle's solver's over each; points on the wrong side in exact arithmetic, in all published surfaces\n"
    "together; bytes of arena.\n\n"
    "--field Q tightens from the field with Q x Q cells a knot interval; then the own mean gap, over the covered "
    "area,\n"
    "and the bound that is proved for it stand behind, in % of the height range, and a published surface that the\n"
    "field's certificate refuses counts as wrong. --rows R takes R constraints in use for each coefficient.\n";

#define NEAR 1.02  // of the optimum: the goal
enum { MARKS = 4 };
static const unsigned marks[MARKS] = {6, 10, 16, CANOPY_TIGHTEN_ITERATIONS};

struct options {
    uint16_t field;
    uint32_t rows;  // for each coefficient
};

struct run {
    struct options options;
    struct canopy_surrogate surrogate;  // its coefficients are those judged
    struct canopy_cloud cloud;
    struct canopy_frame frame;
    struct canopy_field field;
    struct canopy_certify mends, judges;  // two, so that judging does not disturb
    void *arenas[4];
    size_t bytes;
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
    if (run->options.field > 0) {
        canopy_certify_begin(&run->judges, run->b);
        run->wrong += canopy_certify_step(&run->judges, UINT32_MAX) != CANOPY_OK;
    }
    memcpy(run->judged, run->b, 4 * count);
    canopy_fast_orient(&run->frame, run->judged);
    for (size_t i = 0; i < count; i++) {
        run->surrogate.coefficients[i] = run->judged[i];
    }
    if (!canopy_exact_check(&run->surrogate, &run->cloud, &result)) {
        return (double)NAN;
    }
    run->wrong += result.wrong + result.outside;
    return canopy_exact_mean_gap(&result);
}

static bool is_publishing(const struct canopy_tighten *t) {
    return t->stage == CANOPY_TIGHTEN_PUBLISH || t->stage == CANOPY_TIGHTEN_MEND;
}

// Tightens; judging takes no part in the time.
static void tighten(struct run *run, struct canopy_tighten *t) {
    unsigned iterations = 0, mark = 0;
    uint32_t published = t->published;
    double took = 0, gap = run->first_gap;
    enum canopy_status status = CANOPY_MORE;
    while (mark < MARKS) {
        const double start = now_ms();
        while (status == CANOPY_MORE && (t->iterations == iterations || is_publishing(t))) {
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
            printf("  %2u gap %.4f %% (own %.4f) rows %u alpha %.3f %.3f mu %.2e bound %.4f\n", iterations, gap,
                   100 * (double)t->mean_gap / (double)t->range, t->row_count, (double)t->alpha[0], (double)t->alpha[1],
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

static bool fill_field(struct run *run, const float (*points)[3], size_t count) {
    const uint16_t q = run->options.field, cells[2] = {q, q}, m = run->frame.size[0], n = run->frame.size[1];
    const size_t field = CANOPY_FIELD_ARENA(m, n, q, q), certify = CANOPY_CERTIFY_ARENA(n, q, q);
    run->arenas[1] = malloc(field);
    run->arenas[2] = malloc(certify);
    run->arenas[3] = malloc(certify);
    return canopy_field_init(&run->field, &run->frame, cells, run->arenas[1], field) == CANOPY_OK &&
           canopy_field_feed_f32(&run->field, points, count) == 0 &&
           canopy_certify_init(&run->mends, &run->field, run->arenas[2], certify) == CANOPY_OK &&
           canopy_certify_init(&run->judges, &run->field, run->arenas[3], certify) == CANOPY_OK;
}

// Makes the tightening, and tells how long that took.
static bool prepare(struct run *run, struct canopy_tighten *t, const float (*points)[3], size_t count, double *took) {
    const uint16_t m = run->frame.size[0], n = run->frame.size[1], q = run->options.field;
    const struct canopy_tighten_size size = {.points = q > 0 ? 0 : count,
                                             .cells = {q, q},
                                             .rows = (uint32_t)(run->options.rows * CANOPY_COEFFICIENTS(m, n))};
    run->bytes = CANOPY_TIGHTEN_ARENA(m, n, q, q, size.points, size.rows);
    run->arenas[0] = malloc(run->bytes);
    if (!run->arenas[0] || (q > 0 && !fill_field(run, points, count))) {
        return false;
    }
    const double start = now_ms();
    const bool ok = canopy_tighten_init(t, &run->frame, &size, run->arenas[0], run->bytes) == CANOPY_OK &&
                    (q > 0 ? canopy_tighten_field(t, &run->field, &run->mends)
                           : canopy_tighten_points_f32(t, points, count)) == CANOPY_OK &&
                    canopy_tighten_begin(t, run->b, true) == CANOPY_OK;
    *took = now_ms() - start;
    return ok;
}

static bool fit(const struct canopy_loaded *points, uint16_t size, enum canopy_side side, struct run *run,
                struct canopy_tighten *t, struct canopy_fault *fault) {
    const struct canopy_surface_wish wish = {.size = {size, size},
                                             .side = side,
                                             .scalar = CANOPY_F32,
                                             .unit = points->unit,
                                             .direction = {0, 0, 1},
                                             .fitting = {.field = run->options.field}};
    const struct canopy_grid grid = {{size, size}, run->options.field > 0 ? run->options.field : 4, (uint8_t)side};
    struct canopy_surface_report report;
    float low[3], high[3];
    double took;
    if (!canopy_surface_fit(&points->list, &wish, &run->surrogate, &report, fault)) {
        return false;
    }
    if (!box(&points->list, low, high) || canopy_frame_around_f32(&run->frame, &grid, low, high) != CANOPY_OK ||
        run->surrogate.lsb != ldexp(1, run->frame.lsb_log2 + run->frame.quantum_log2)) {
        return canopy_fault_set(fault, "the frame is not that of canopy fit");
    }
    const size_t count = CANOPY_COEFFICIENTS(size, size);
    run->b = malloc(4 * count);
    run->judged = malloc(4 * count);
    if (!run->b || !run->judged) {
        return canopy_fault_set(fault, "out of memory");
    }
    for (size_t i = 0; i < count; i++) {
        run->b[i] = (int32_t)run->surrogate.coefficients[i];
    }
    run->cloud = canopy_device_list_cloud(&points->list);
    canopy_fast_orient(&run->frame, run->b);
    if (!prepare(run, t, (const float(*)[3]) & points->list.points[0].f32, points->list.count, &took)) {
        return canopy_fault_set(fault, "cannot tighten");
    }
    run->first_gap = judge(run);
    tighten(run, t);
    for (int k = 0; k < MARKS; k++) {
        run->ms[k] += took;
    }
    run->near_ms += run->near_ms > 0 ? took : (double)NAN;
    return true;
}

static void report(const struct run *run, const struct canopy_tighten *t, const char *key, double gap, double solver) {
    printf("%-24s %8.4f %7.3f %7.3f %7.3f %7.4f %7.4f %4d %8.2f%% %8.1f %7.0f %8.1f %7.0f %6llu %8zu", key, gap,
           run->first_gap / gap, run->gap[0] / gap, run->gap[1] / gap, run->gap[2] / gap, run->gap[3] / gap,
           t->iterations, 100 * (double)canopy_tighten_excess(t), run->near_ms, 1e3 * solver / run->near_ms, run->ms[3],
           1e3 * solver / run->ms[3], (unsigned long long)run->wrong, run->bytes);
    if (run->options.field > 0) {
        printf(" %9.4f %9.4f", 100 * (double)t->mean_gap / (double)t->range, 100 * (double)t->bound / (double)t->range);
    }
    puts("");
}

static bool one(const json_t *oracle, const char *name, const struct canopy_loaded *points, uint16_t size,
                enum canopy_side side, const struct options *options, struct canopy_fault *fault) {
    char key[100];
    snprintf(key, sizeof key, "%s %ux%u %s", name, size, size, side == CANOPY_ABOVE ? "above" : "below");
    const json_t *best = json_object_get(oracle, key);
    const double gap = 100 * json_number_value(json_object_get(best, "mean_gap"));
    struct run run = {.options = *options, .near_gap = NEAR * gap};
    struct canopy_tighten t = {0};
    const bool ok = fit(points, size, side, &run, &t, fault);
    if (ok) {
        report(&run, &t, key, gap, json_number_value(json_object_get(best, "solver_s")));
        canopy_surrogate_free(&run.surrogate);
    }
    free(run.b);
    free(run.judged);
    for (int k = 0; k < 4; k++) {
        free(run.arenas[k]);
    }
    return ok;
}

static bool scene(const json_t *oracle, char *operand, const struct options *options, struct canopy_fault *fault) {
    char *path = strchr(operand, '=');
    const struct canopy_load_wish wish = {.scalar = CANOPY_F32, .unit = 1};
    struct canopy_loaded points;
    *path++ = '\0';
    bool ok = canopy_load(path, &wish, &points, fault);
    for (unsigned k = 0; ok && k < 4; k++) {
        ok = one(oracle, operand, &points, k < 2 ? 10 : 20, k % 2 ? CANOPY_BELOW : CANOPY_ABOVE, options, fault);
        fflush(stdout);
        if (!ok || k == 3) {
            canopy_device_list_free(&points.list);
        }
    }
    return ok;
}

// The operands that are options; false where one is none.
static bool read_options(int argc, char **argv, int *first, struct options *options) {
    for (*first = 1; *first < argc && strncmp(argv[*first], "--", 2) == 0; *first += 2) {
        char *end = NULL;
        const long number = *first + 1 < argc ? strtol(argv[*first + 1], &end, 10) : 0;
        const bool field = strcmp(argv[*first], "--field") == 0, rows = strcmp(argv[*first], "--rows") == 0;
        if ((!field && !rows) || !end || *end != '\0' || number < 1 || number > (field ? CANOPY_CELLS_MAX : 1000)) {
            return false;
        }
        options->field = field ? (uint16_t)number : options->field;
        options->rows = rows ? (uint32_t)number : options->rows;
    }
    for (int i = *first + 1; i < argc; i++) {
        if (strchr(argv[i], '=') == NULL) {
            return false;
        }
    }
    return *first + 1 < argc;
}

int main(int argc, char **argv) {
    struct options options = {.rows = CANOPY_TIGHTEN_ROWS(1, 1)};
    int first;
    if (!read_options(argc, argv, &first, &options)) {
        fputs(USAGE, stderr);
        return 64;
    }
    json_error_t error;
    json_t *oracle = json_load_file(argv[first], 0, &error);
    struct canopy_fault fault = {0};
    bool ok = oracle != NULL;
    if (!ok) {
        fprintf(stderr, "%s: %s\n", argv[first], error.text);
    }
    printf("%-24s %8s %7s %7s %7s %7s %7s %4s %9s %8s %7s %8s %7s %6s %8s%s\n", "", "oracle %", "fast x", "6 it",
           "10 it", "16 it", "end", "its", "proved", "ms 1.02", "HiGHS/", "ms end", "HiGHS/", "wrong", "bytes",
           options.field > 0 ? "     own %   bound %" : "");
    for (int i = first + 1; ok && i < argc; i++) {
        ok = scene(oracle, argv[i], &options, &fault);
        if (!ok) {
            fprintf(stderr, "canopy-tightness: %s\n", fault.text);
        }
    }
    json_decref(oracle);
    return ok ? 0 : 2;
}
