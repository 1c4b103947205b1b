// canopy-bench: the floor and canopy's own fits on the same points, in turns, in one process.

#include <argp.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "tools/bench/floor.h"
#include "tools/bench/rays.h"
#include "tools/bench/series.h"
#include "tools/common/load.h"
#include "tools/common/surface.h"

static const char DOC[] =
    "Times `canopy fit` against the floor, one pass over the points that keeps each cell's highest.\v"
    "Every round runs each once, so that all meet the same machine; of all rounds the median and the best are told. "
    "Prints JSON on standard output.\n\nExit status: 0, or 2 for bad input.";

#define ROUNDS_LEAST 8
#define FLOORS_MOST 8
#define FIELD_CELLS 4  // Q of the field, and of the floor

/// One way to fit.
struct way {
    const char *name;
    enum canopy_scalar scalar;
    uint16_t field;
    uint16_t lines;
};

static const struct way WAYS[] = {
    {"fast f32 from points", CANOPY_F32, 0, 0},
    {"fast fx from points", CANOPY_FX, 0, 0},
    {"fast f32 from field 4, lines 1", CANOPY_F32, FIELD_CELLS, 1},
    {"fast fx from field 4, lines 1", CANOPY_FX, FIELD_CELLS, 1},
    {"fast f32 from field 4, lines 4", CANOPY_F32, FIELD_CELLS, 4},
    {"fast fx from field 4, lines 4", CANOPY_FX, FIELD_CELLS, 4},
};
#define WAY_COUNT (sizeof WAYS / sizeof WAYS[0])

/// What is known of one way after some rounds.
struct result {
    struct canopy_surface_report report;  ///< of the last round; all rounds give the same surface
    struct canopy_series fit;             ///< points in memory to coefficients: box, frame, feed, solves
    struct canopy_series field;           ///< the field's certificate
    struct canopy_series certificate;     ///< one exact pass over the points
    struct canopy_series whole;           ///< all of it, to the certified surrogate in memory
    struct canopy_bench_rays rays;        ///< on the surface, where it comes from the points
};

struct bench {
    const char *path;
    const char *save;  ///< where the surrogates go, without ending; NULL: nowhere
    uint16_t size[2];
    enum canopy_side side;
    double seconds;
    size_t rounds;  ///< 0: as `seconds` allows
    bool points_only;
    struct canopy_loaded points[2];  ///< by scalar
    struct canopy_floor_grid grid;
    float *heights;
    struct canopy_series floors[FLOORS_MOST];  ///< each way of writing the floor
    struct result results[WAY_COUNT];
};

static const struct argp_option OPTIONS[] = {
    {"grid", 'g', "N", 0, "N x N coefficients (default 20)", 0},
    {"below", 'b', NULL, 0, "the side below (default: above)", 0},
    {"seconds", 's', "S", 0, "measure for about S seconds (default 2), at least eight rounds", 0},
    {"rounds", 'r', "N", 0, "or so many rounds", 0},
    {"points-only", 'p', NULL, 0, "fit from the points alone, not from the field", 0},
    {"save", 'o', "PREFIX", 0, "write the surrogates to PREFIX-0.json and so on, in the order of the output", 0},
    {0}};

static double positive(struct argp_state *state, const char *text, double most) {
    char *end = NULL;
    const double value = strtod(text, &end);
    if (end == text || *end || !(value > 0.0 && value <= most)) {
        argp_error(state, "'%s' is not a number up to %g", text, most);
    }
    return value;
}

static error_t parse(int key, char *text, struct argp_state *state) {
    struct bench *bench = state->input;
    switch (key) {
    case 'g': bench->size[0] = bench->size[1] = (uint16_t)positive(state, text, CANOPY_SIZE_MAX); return 0;
    case 'b': bench->side = CANOPY_BELOW; return 0;
    case 's': bench->seconds = positive(state, text, 3600.0); return 0;
    case 'r': bench->rounds = (size_t)positive(state, text, CANOPY_SERIES_MOST); return 0;
    case 'p': bench->points_only = true; return 0;
    case 'o': bench->save = text; return 0;
    case ARGP_KEY_ARG:
        if (state->arg_num > 0) {
            argp_error(state, "give one point file");
        }
        bench->path = text;
        return 0;
    case ARGP_KEY_END:
        if (!bench->path) {
            argp_error(state, "give a point file");
        }
        return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

static bool is_wanted(const struct bench *bench, size_t way) { return WAYS[way].field == 0 || !bench->points_only; }

// ---------------------------------------------------------------------------------------------------------------------
// Preparation

/// The points as float triples. The union's two members share their representation with the array that the floor takes.
static const float (*triples(const struct bench *bench))[3] {
    return (const float(*)[3]) & bench->points[CANOPY_F32].list.points[0].f32;
}

/// A pass that finds other maxima is no floor.
static bool floors_agree(struct bench *bench, struct canopy_fault *fault) {
    const size_t count = bench->points[CANOPY_F32].list.count;
    const size_t bytes = (size_t)bench->grid.cells[0] * bench->grid.cells[1] * sizeof *bench->heights;
    float *expected = malloc(bytes);
    if (!expected) {
        return canopy_fault_set(fault, "out of memory: choose a smaller --grid");
    }
    bool ok = true;
    for (size_t i = 0; ok && i < canopy_floor_count; i++) {
        canopy_floors[i].pass(&bench->grid, triples(bench), count, bench->heights);
        if (i == 0) {
            memcpy(expected, bench->heights, bytes);
        }
        ok = memcmp(expected, bench->heights, bytes) == 0 ||
             canopy_fault_set(fault, "the floor '%s' differs from '%s': this is a defect of floor.c",
                              canopy_floors[i].name, canopy_floors[0].name);
    }
    free(expected);
    return ok;
}

static bool prepare(struct bench *bench, struct canopy_fault *fault) {
    for (int scalar = CANOPY_F32; scalar <= CANOPY_FX; scalar++) {
        const struct canopy_load_wish wish = {.scalar = (enum canopy_scalar)scalar};
        if (!canopy_load(bench->path, &wish, &bench->points[scalar], fault)) {
            return false;
        }
    }
    bench->grid = canopy_floor_around(triples(bench), bench->points[CANOPY_F32].list.count,
                                      FIELD_CELLS * (bench->size[0] - 1U), FIELD_CELLS * (bench->size[1] - 1U));
    bench->heights = malloc(canopy_floor_room(&bench->grid) * sizeof *bench->heights);
    if (!bench->heights) {
        return canopy_fault_set(fault, "out of memory: choose a smaller --grid");
    }
    return floors_agree(bench, fault);
}

// ---------------------------------------------------------------------------------------------------------------------
// Rounds

static void run_floors(struct bench *bench) {
    for (size_t i = 0; i < canopy_floor_count; i++) {
        const double start = canopy_series_now();
        canopy_floors[i].pass(&bench->grid, triples(bench), bench->points[CANOPY_F32].list.count, bench->heights);
        canopy_series_add(&bench->floors[i], canopy_series_now() - start);
    }
}

static bool run_way(struct bench *bench, size_t way, struct canopy_surrogate *surrogate, struct canopy_fault *fault) {
    const struct canopy_loaded *points = &bench->points[WAYS[way].scalar];
    const struct canopy_surface_wish wish = {.size = {bench->size[0], bench->size[1]},
                                             .side = bench->side,
                                             .scalar = WAYS[way].scalar,
                                             .unit = points->unit,
                                             .direction = {0.0, 0.0, 1.0},
                                             .fitting = {.field = WAYS[way].field, .lines = WAYS[way].lines}};
    struct result *result = &bench->results[way];
    const double start = canopy_series_now();
    if (!canopy_surface_fit(&points->list, &wish, surrogate, &result->report, fault)) {
        return false;
    }
    canopy_series_add(&result->whole, canopy_series_now() - start);
    canopy_series_add(&result->fit, 1e3 * (result->report.fit_ms - result->report.fitting.field_ms));
    canopy_series_add(&result->field, 1e3 * result->report.fitting.field_ms);
    canopy_series_add(&result->certificate, 1e3 * result->report.certificate_ms);
    return true;
}

static bool save(const struct bench *bench, size_t number, const struct canopy_surrogate *surrogate,
                 struct canopy_fault *fault) {
    char path[4096];
    if ((size_t)snprintf(path, sizeof path, "%s-%zu.json", bench->save, number) >= sizeof path) {
        return canopy_fault_set(fault, "--save: the name is too long");
    }
    return canopy_surrogate_write(path, surrogate, fault);
}

static bool run_round(struct bench *bench, struct canopy_fault *fault) {
    const bool first = bench->floors[0].count == 0;
    run_floors(bench);
    for (size_t way = 0, number = 0; way < WAY_COUNT; way++) {
        if (!is_wanted(bench, way)) {
            continue;
        }
        struct canopy_surrogate surrogate;
        if (!run_way(bench, way, &surrogate, fault)) {
            return false;
        }
        bool ok = !first || !bench->save || save(bench, number++, &surrogate, fault);
        ok = ok && (WAYS[way].field > 0 || canopy_bench_rays(&surrogate, &bench->results[way].rays) ||
                    canopy_fault_set(fault, "out of memory for rays: close other programs"));
        canopy_surrogate_free(&surrogate);
        if (!ok) {
            return false;
        }
    }
    return true;
}

static bool is_enough(const struct bench *bench, time_t end) {
    const size_t rounds = bench->floors[0].count;
    if (bench->rounds > 0) {
        return rounds >= bench->rounds;
    }
    return rounds >= CANOPY_SERIES_MOST || (rounds >= ROUNDS_LEAST && time(NULL) >= end);
}

static bool run(struct bench *bench, struct canopy_fault *fault) {
    const time_t end = time(NULL) + (time_t)bench->seconds;
    while (!is_enough(bench, end)) {
        if (!run_round(bench, fault)) {
            return false;
        }
    }
    return true;
}

// ---------------------------------------------------------------------------------------------------------------------
// Report

/// Which way of writing the floor was the fastest.
static size_t fastest(const struct bench *bench) {
    size_t found = 0;
    for (size_t i = 1; i < canopy_floor_count; i++) {
        found = canopy_series_median(&bench->floors[i]) < canopy_series_median(&bench->floors[found]) ? i : found;
    }
    return found;
}

static json_t *report_floor(const struct bench *bench) {
    const struct canopy_series *floor = &bench->floors[fastest(bench)];
    json_t *ways = json_object();
    for (size_t i = 0; i < canopy_floor_count; i++) {
        json_object_set_new(ways, canopy_floors[i].name, json_real(canopy_series_median(&bench->floors[i])));
    }
    json_t *report = canopy_series_report(floor, floor, bench->points[CANOPY_F32].list.count);
    json_object_set_new(report, "way", json_string(canopy_floors[fastest(bench)].name));
    json_object_set_new(report, "ways_median_us", ways);
    return report;
}

static json_t *report_way(const struct bench *bench, size_t way) {
    const struct result *r = &bench->results[way];
    const struct canopy_exact_result *exact = &r->report.result;
    const struct canopy_series *floor = &bench->floors[fastest(bench)];
    const size_t count = bench->points[WAYS[way].scalar].list.count;
    json_t *report = json_pack(
        "{s:s, s:s, s:f, s:i, s:i, s:o, s:o, s:o, s:f, s:f, s:f, s:I, s:I, s:I, s:i, s:i}", "name", WAYS[way].name,
        "scalar", WAYS[way].scalar == CANOPY_F32 ? "f32" : "fx", "unit", bench->points[WAYS[way].scalar].unit, "field",
        WAYS[way].field, "lines", WAYS[way].field ? WAYS[way].lines : 1, "fit",
        canopy_series_report(&r->fit, floor, count), "certificate", canopy_series_report(&r->certificate, floor, count),
        "whole", canopy_series_report(&r->whole, floor, count), "mean_gap_pct", canopy_exact_mean_gap(exact),
        "max_gap_pct", canopy_exact_max_gap(exact), "margin", exact->margin, "wrong", (json_int_t)exact->wrong,
        "outside", (json_int_t)exact->outside, "decided_by_gmp", (json_int_t)exact->decided_by_gmp, "solves",
        (int)r->report.fitting.iterations, "unsettled", (int)r->report.fitting.unsettled);
    if (!WAYS[way].field) {
        json_object_set_new(report, "rays", canopy_bench_rays_report(&r->rays));
    } else {
        json_object_set_new(report, "field_certificate", canopy_series_report(&r->field, floor, count));
    }
    return report;
}

static bool print(const struct bench *bench) {
    json_t *ways = json_array();
    for (size_t way = 0; way < WAY_COUNT; way++) {
        if (is_wanted(bench, way)) {
            json_array_append_new(ways, report_way(bench, way));
        }
    }
    json_t *report =
        json_pack("{s:I, s:[i,i], s:s, s:i, s:o, s:o}", "points", (json_int_t)bench->points[CANOPY_F32].list.count,
                  "grid", bench->size[0], bench->size[1], "side", bench->side == CANOPY_ABOVE ? "above" : "below",
                  "rounds", (int)bench->floors[0].count, "floor", report_floor(bench), "ways", ways);
    const bool ok = report && json_dumpf(report, stdout, JSON_INDENT(1) | JSON_REAL_PRECISION(9)) == 0 &&
                    putchar('\n') != EOF && fflush(stdout) == 0;
    json_decref(report);
    return ok;
}

int main(int argc, char **argv) {
    argp_err_exit_status = 64;
    static struct bench bench = {.size = {20, 20}, .seconds = 2.0};  // the series are too large for a stack
    const struct argp argp = {.options = OPTIONS, .parser = parse, .args_doc = "POINTS", .doc = DOC};
    argp_parse(&argp, argc, argv, 0, NULL, &bench);
    struct canopy_fault fault;
    const bool ok = prepare(&bench, &fault) && run(&bench, &fault);
    if (!ok) {
        fprintf(stderr, "canopy-bench: %s\n", fault.text);
    }
    const bool printed = ok && print(&bench);
    canopy_device_list_free(&bench.points[CANOPY_F32].list);
    canopy_device_list_free(&bench.points[CANOPY_FX].list);
    free(bench.heights);
    return printed ? 0 : 2;
}
