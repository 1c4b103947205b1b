// canopy-bench: the floor and canopy's own fits on the same points, in turns, in one process.

#include <argp.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "tools/bench/floor.h"
#include "tools/bench/moving.h"
#include "tools/bench/pair.h"
#include "tools/bench/rays.h"
#include "tools/bench/series.h"
#include "tools/bench/solves.h"
#include "tools/common/load.h"
#include "tools/common/surface.h"

static const char DOC[] =
    "Times `canopy fit` against the floor, one pass over the points that keeps each cell's highest.\v"
    "Every round runs each once, so that all meet the same machine; of all rounds the median and the best are told. "
    "What takes long (tight, both sides) is run three times.\n\n"
    "With --moving there is no file: the points are two spherical clouds that move, as in the paper's Tables 1 and 2, "
    "ten configurations of them fitted --fits times each, from the points alone; gaps are then means over all fits, "
    "and "
    "the solves of every line are counted, as in its Fig. 9.\n\n"
    "Prints JSON on standard output.\n\nExit status: 0, or 2 for bad input.";

#define ROUNDS_LEAST 8
#define FLOORS_MOST 8
#define FIELD_CELLS 4  // Q of the field, and of the floor
#define LONG_ROUNDS 3  // of what takes long
#define CONFIGURATIONS 10

/// One way to fit.
struct way {
    const char *name;
    enum canopy_scalar scalar;
    uint16_t field;
    uint16_t lines;
    bool packed;
    bool tight;
};

static const struct way WAYS[] = {
    {"fast f32 from points", CANOPY_F32, 0, 0, false, false},
    {"fast fx from points", CANOPY_FX, 0, 0, false, false},
    {"fast f32 from field 4, lines 1", CANOPY_F32, FIELD_CELLS, 1, false, false},
    {"fast fx from field 4, lines 1", CANOPY_FX, FIELD_CELLS, 1, false, false},
    {"fast f32 from field 4, lines 4", CANOPY_F32, FIELD_CELLS, 4, false, false},
    {"fast fx from field 4, lines 4", CANOPY_FX, FIELD_CELLS, 4, false, false},
    {"tight f32 from points", CANOPY_F32, 0, 0, false, true},
    {"tight fx from points", CANOPY_FX, 0, 0, false, true},
    {"tight f32 from field 4", CANOPY_F32, FIELD_CELLS, 1, false, true},
    {"tight f32 from field 8, packed", CANOPY_F32, 8, 1, true, true},
    {"tight f32 from field 8", CANOPY_F32, 8, 1, false, true},
    {"tight f32 from field 16, packed", CANOPY_F32, 16, 1, true, true},
    {"tight f32 from field 16", CANOPY_F32, 16, 1, false, true},
};
#define WAY_COUNT (sizeof WAYS / sizeof WAYS[0])

/// What is known of one way after some rounds.
struct result {
    struct canopy_surface_report report;  ///< of the last round; all rounds of one file give the same surface
    uint64_t wrong, outside;              ///< of all rounds
    double gap_sum, gap_max;              ///< mean gap summed, largest gap, of all rounds
    uint64_t solves, unsettled;           ///< of all rounds
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
    size_t moving;   ///< points of the moving clouds; 0: they come from `path`
    unsigned steps;  ///< fits of each configuration of them
    struct canopy_bench_solves solves;
    json_t *pairs;
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
    {"moving", 'm', "COUNT", 0, "so many points on two spherical clouds that move", 0},
    {"fits", 'f', "N", 0, "fits of each of their configurations (default 20)", 0},
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
    case 'm':
        bench->moving = (size_t)positive(state, text, 1e8);
        bench->points_only = true;
        return 0;
    case 'f': bench->steps = (unsigned)positive(state, text, (double)CANOPY_SERIES_MOST / CONFIGURATIONS); return 0;
    case 'o': bench->save = text; return 0;
    case ARGP_KEY_ARG:
        if (state->arg_num > 0) {
            argp_error(state, "give one point file");
        }
        bench->path = text;
        return 0;
    case ARGP_KEY_END:
        if (!bench->path == !bench->moving) {
            argp_error(state, "give a point file, or --moving");
        }
        return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

static bool is_wanted(const struct bench *bench, size_t way) {
    return !bench->points_only || (WAYS[way].field == 0 && !WAYS[way].tight);
}

static bool has_rays(const struct bench *bench, size_t way) {
    return WAYS[way].field == 0 && !WAYS[way].tight && !bench->moving;
}

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

/// The floor's cells around the points that are there now.
static bool prepare_floor(struct bench *bench, struct canopy_fault *fault) {
    bench->grid = canopy_floor_around(triples(bench), bench->points[CANOPY_F32].list.count,
                                      FIELD_CELLS * (bench->size[0] - 1U), FIELD_CELLS * (bench->size[1] - 1U));
    if (!bench->heights) {
        bench->heights = malloc(canopy_floor_room(&bench->grid) * sizeof *bench->heights);
    }
    if (!bench->heights) {
        return canopy_fault_set(fault, "out of memory: choose a smaller --grid");
    }
    return floors_agree(bench, fault);
}

static bool load(struct bench *bench, struct canopy_fault *fault) {
    for (int scalar = CANOPY_F32; scalar <= CANOPY_FX; scalar++) {
        const struct canopy_load_wish wish = {.scalar = (enum canopy_scalar)scalar};
        if (!canopy_load(bench->path, &wish, &bench->points[scalar], fault)) {
            return false;
        }
    }
    return prepare_floor(bench, fault);
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

static struct canopy_surface_wish wish_of(const struct bench *bench, const struct way *way) {
    return (struct canopy_surface_wish){
        .size = {bench->size[0], bench->size[1]},
        .side = bench->side,
        .scalar = way->scalar,
        .unit = bench->points[way->scalar].unit,
        .direction = {0.0, 0.0, 1.0},
        .fitting = {.field = way->field, .packed = way->packed, .lines = way->lines, .tight = way->tight}};
}

static void add_report(struct result *result) {
    const struct canopy_exact_result *exact = &result->report.result;
    const double gap = canopy_exact_max_gap(exact);
    result->wrong += exact->wrong;
    result->outside += exact->outside;
    result->gap_sum += canopy_exact_mean_gap(exact);
    result->gap_max = gap > result->gap_max ? gap : result->gap_max;
    result->solves += result->report.fitting.iterations;
    result->unsettled += result->report.fitting.unsettled;
}

static bool run_way(struct bench *bench, size_t way, struct canopy_surrogate *surrogate, struct canopy_fault *fault) {
    const struct canopy_loaded *points = &bench->points[WAYS[way].scalar];
    const struct canopy_surface_wish wish = wish_of(bench, &WAYS[way]);
    struct result *result = &bench->results[way];
    const double start = canopy_series_now();
    if (!canopy_surface_fit(&points->list, &wish, surrogate, &result->report, fault)) {
        return false;
    }
    canopy_series_add(&result->whole, canopy_series_now() - start);
    canopy_series_add(&result->fit, 1e3 * (result->report.fit_ms - result->report.fitting.field_ms));
    canopy_series_add(&result->field, 1e3 * result->report.fitting.field_ms);
    canopy_series_add(&result->certificate, 1e3 * result->report.certificate_ms);
    add_report(result);
    return true;
}

/// Numbered as the output is.
static bool save(const struct bench *bench, size_t way, const struct canopy_surrogate *surrogate,
                 struct canopy_fault *fault) {
    char path[4096];
    size_t number = 0;
    for (size_t before = 0; before < way; before++) {
        number += is_wanted(bench, before);
    }
    if ((size_t)snprintf(path, sizeof path, "%s-%zu.json", bench->save, number) >= sizeof path) {
        return canopy_fault_set(fault, "--save: the name is too long");
    }
    return canopy_surrogate_write(path, surrogate, fault);
}

/// Not in every round: they take longer than all else together, which would run colder after them.
static bool are_rays_due(const struct bench *bench, size_t way) {
    return has_rays(bench, way) && bench->results[way].rays.time.count < ROUNDS_LEAST;
}

/// Fits one way, saves what came out if it is the first time, and casts rays.
static bool run_once(struct bench *bench, size_t way, struct canopy_fault *fault) {
    struct canopy_surrogate surrogate;
    if (!run_way(bench, way, &surrogate, fault)) {
        return false;
    }
    bool ok = bench->results[way].fit.count > 1 || !bench->save || save(bench, way, &surrogate, fault);
    ok = ok && (!are_rays_due(bench, way) || canopy_bench_rays(&surrogate, &bench->results[way].rays) ||
                canopy_fault_set(fault, "out of memory for rays: close other programs"));
    canopy_surrogate_free(&surrogate);
    return ok;
}

/// The floors, and every way that is wanted and as long as `tight` says.
static bool run_round(struct bench *bench, bool tight, struct canopy_fault *fault) {
    run_floors(bench);
    for (size_t way = 0; way < WAY_COUNT; way++) {
        if (is_wanted(bench, way) && WAYS[way].tight == tight && !run_once(bench, way, fault)) {
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

/// Which way of writing the floor was the fastest.
static size_t fastest(const struct bench *bench) {
    size_t found = 0;
    for (size_t i = 1; i < canopy_floor_count; i++) {
        found = canopy_series_median(&bench->floors[i]) < canopy_series_median(&bench->floors[found]) ? i : found;
    }
    return found;
}

static bool run_pairs(struct bench *bench, struct canopy_fault *fault) {
    static const struct way pairs[] = {{"sandwich fast f32", CANOPY_F32, 0, 0, false, false},
                                       {"sandwich tight f32", CANOPY_F32, 0, 0, false, true}};
    for (size_t i = 0; i < sizeof pairs / sizeof pairs[0]; i++) {
        const struct canopy_surface_wish wish = wish_of(bench, &pairs[i]);
        if (!canopy_bench_pair(pairs[i].name, &bench->points[CANOPY_F32].list, &wish, &bench->floors[fastest(bench)],
                               bench->pairs, fault)) {
            return false;
        }
    }
    return true;
}

/// One file, again and again.
static bool run_file(struct bench *bench, struct canopy_fault *fault) {
    const time_t end = time(NULL) + (time_t)bench->seconds;
    bool ok = load(bench, fault);
    while (ok && !is_enough(bench, end)) {
        ok = run_round(bench, false, fault);
    }
    for (int round = 0; ok && round < LONG_ROUNDS && !bench->points_only; round++) {
        ok = run_round(bench, true, fault);
    }
    return ok && (bench->points_only || run_pairs(bench, fault));
}

/// The clouds where they are now: one round, and the solves of its lines, which must be as many as the fit tells.
static bool run_step(struct bench *bench, const struct canopy_moving *moving, unsigned step,
                     struct canopy_fault *fault) {
    struct canopy_device_list lists[2] = {bench->points[0].list, bench->points[1].list};
    const bool ok = canopy_moving_at(moving, step, lists);
    bench->points[0].list = lists[0];
    bench->points[1].list = lists[1];
    if (!ok) {
        return canopy_fault_no_memory(fault);
    }
    if (!prepare_floor(bench, fault) || !run_round(bench, false, fault)) {
        return false;
    }
    const uint32_t solves = canopy_bench_solves_add(&bench->solves, &bench->points[CANOPY_F32].list, bench->size);
    return solves == bench->results[CANOPY_F32].report.fitting.iterations ||
           canopy_fault_set(fault, "%u solves were counted, the fit tells %u: this is a defect of solves.c",
                            (unsigned)solves, (unsigned)bench->results[CANOPY_F32].report.fitting.iterations);
}

/// Every configuration of the clouds, `steps` fits each.
static bool run_moving(struct bench *bench, struct canopy_fault *fault) {
    bool ok = true;
    bench->points[CANOPY_F32].unit = 1.0;
    bench->points[CANOPY_FX].unit = CANOPY_MOVING_UNIT_FX;
    for (unsigned number = 0; ok && number < CONFIGURATIONS; number++) {
        struct canopy_moving moving;
        ok = canopy_moving_open(&moving, bench->moving, number) || canopy_fault_no_memory(fault);
        for (unsigned step = 0; ok && step < bench->steps; step++) {
            ok = run_step(bench, &moving, step, fault);
        }
        canopy_moving_close(&moving);
    }
    return ok;
}

// ---------------------------------------------------------------------------------------------------------------------
// Report

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

/// What only some ways have.
static void report_more(const struct bench *bench, size_t way, json_t *report) {
    const struct result *r = &bench->results[way];
    const struct way *w = &WAYS[way];
    const struct canopy_series *floor = &bench->floors[fastest(bench)];
    const size_t m = bench->size[0], n = bench->size[1], q = w->field;
    if (has_rays(bench, way)) {
        json_object_set_new(report, "rays", canopy_bench_rays_report(&r->rays));
    }
    if (w->field && !w->tight) {
        json_object_set_new(report, "field_certificate",
                            canopy_series_report(&r->field, floor, bench->points[w->scalar].list.count));
    }
    if (w->field) {
        json_object_set_new(report, "field_bytes",
                            json_integer((json_int_t)(w->packed ? CANOPY_FIELD_PACKED_ARENA(m, n, q, q)
                                                                : CANOPY_FIELD_ARENA(m, n, q, q))));
    }
    if (w->tight) {
        json_object_set_new(report, "proved_excess_pct", json_real(100.0 * r->report.fitting.excess));
    }
}

static json_t *report_way(const struct bench *bench, size_t way) {
    const struct result *r = &bench->results[way];
    const struct canopy_series *floor = &bench->floors[fastest(bench)];
    const size_t count = bench->points[WAYS[way].scalar].list.count;
    const double rounds = (double)r->fit.count;
    json_t *report = json_pack(
        "{s:s, s:s, s:f, s:i, s:i, s:b, s:o, s:o, s:o, s:f, s:f, s:f, s:I, s:I, s:I, s:f, s:f}", "name", WAYS[way].name,
        "scalar", WAYS[way].scalar == CANOPY_F32 ? "f32" : "fx", "unit", bench->points[WAYS[way].scalar].unit, "field",
        WAYS[way].field, "lines", WAYS[way].field ? WAYS[way].lines : 1, "tight", WAYS[way].tight, "fit",
        canopy_series_report(&r->fit, floor, count), "certificate", canopy_series_report(&r->certificate, floor, count),
        "whole", canopy_series_report(&r->whole, floor, count), "mean_gap_pct", r->gap_sum / rounds, "max_gap_pct",
        r->gap_max, "margin", r->report.result.margin, "wrong", (json_int_t)r->wrong, "outside", (json_int_t)r->outside,
        "decided_by_gmp", (json_int_t)r->report.result.decided_by_gmp, "solves", (double)r->solves / rounds,
        "unsettled", (double)r->unsettled / rounds);
    report_more(bench, way, report);
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
    if (bench->moving) {
        json_object_set_new(report, "solves", canopy_bench_solves_report(&bench->solves));
    } else {
        json_object_set(report, "pairs", bench->pairs);
    }
    const bool ok = report && json_dumpf(report, stdout, JSON_INDENT(1) | JSON_REAL_PRECISION(9)) == 0 &&
                    putchar('\n') != EOF && fflush(stdout) == 0;
    json_decref(report);
    return ok;
}

int main(int argc, char **argv) {
    argp_err_exit_status = 64;
    static struct bench bench = {
        .size = {20, 20}, .seconds = 2.0, .steps = 20};  // the series are too large for a stack
    const struct argp argp = {.options = OPTIONS, .parser = parse, .args_doc = "POINTS", .doc = DOC};
    argp_parse(&argp, argc, argv, 0, NULL, &bench);
    struct canopy_fault fault;
    bench.pairs = json_array();
    const bool ok = bench.moving ? run_moving(&bench, &fault) : run_file(&bench, &fault);
    if (!ok) {
        fprintf(stderr, "canopy-bench: %s\n", fault.text);
    }
    const bool printed = ok && print(&bench);
    canopy_device_list_free(&bench.points[CANOPY_F32].list);
    canopy_device_list_free(&bench.points[CANOPY_FX].list);
    json_decref(bench.pairs);
    free(bench.heights);
    return printed ? 0 : 2;
}
