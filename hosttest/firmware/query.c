// What questions to a published surface cost on the chip, in instructions: run by hosttest/bench_firmware.py.
//
// The scenes of scene.h, 400 columns x 344 profiles, fitted to 20 x 20 coefficients from a field with Q = 4; a second
// surface of the same frame, 200 higher in the mean, stands for another time. Windows of whole, 6 x 6 and 1 x 1 knot
// intervals, off the knots:
//   NAME_bound       canopy_extreme_begin alone: the bound from the coefficients
//   NAME_look        begin and a look at every knot cell
//   NAME_end         the same until bound and attained value are 2 steps apart, CANOPY_EXTREME_NODES parts remembered
//   NAME_looseness   after those looks, in 1/1000 of the height range …  NAME_end_looseness after the end, NAME_cuts
//   point            height, gradient and normal at a place; eval: canopy_envelope_height alone
//   clearance_end    of the two over the whole frame; plane_end: of one to a plane; cell: the change of a knot cell
//   volume           over the whole frame, and volume_window over the window of 6 x 6
//   halve            both axes halved: 39 x 39; regrid: a field of 10 x 10 coefficients, Q = 4, filled
#include "lib/cover/query.h"
#include "hosttest/firmware/print.h"
#include "hosttest/firmware/scene.h"
#include "lib/cover/fast.h"
#include "lib/cover/query_extreme.h"
#include "lib/cover/query_regrid.h"
#include "lib/cover/query_volume.h"
#include "port/board.h"

enum { N = 20, CELLS = 4, COLUMNS = 400, PROFILES = 344, STEP = 30, RANGE = 8192, FINE = 2 * N - 1, COARSE = 10 };

static CANOPY_ARENA_DECLARE(field_arena, CANOPY_FIELD_ARENA(N, N, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(fast_arena, CANOPY_FAST_ARENA(N, N, CELLS, 1));
static int32_t coefficients[2][N * N], fine[FINE * FINE];
static uint8_t coverage[CANOPY_COVERAGE_BYTES(N, N)], fine_coverage[CANOPY_COVERAGE_BYTES(FINE, FINE)];
static struct canopy_envelope envelopes[2];
static struct canopy_field field;
static const char *scene;

static void result(const char *name, const char *more, int64_t value) {
    print_text(scene);
    print_text("_");
    print_text(name);
    print_result(more, value);
}

// ---- The surfaces

static void fit(int32_t (*height)(uint32_t x, uint32_t y), int which) {
    static struct canopy_fast fast;
    const struct canopy_grid grid = {.size = {N, N}, .cells = CELLS, .side = CANOPY_ABOVE};
    const int32_t low[3] = {0, 0, 0}, high[3] = {STEP * (COLUMNS - 1), STEP * (PROFILES - 1), RANGE};
    const uint16_t cells[2] = {CELLS, CELLS};
    struct canopy_frame frame;
    print_must(canopy_frame_around_fx(&frame, &grid, low, high) == CANOPY_OK &&
                   canopy_field_init(&field, &frame, cells, field_arena, sizeof field_arena) == CANOPY_OK &&
                   canopy_fast_init(&fast, &field, &canopy_line_fit_fx, 1, fast_arena, sizeof fast_arena) == CANOPY_OK,
               "no field");
    for (uint32_t y = 0; y < PROFILES; y++) {
        for (uint32_t x = 0; x < COLUMNS; x++) {
            struct canopy_field_hit hit;
            const int32_t more = which == 0 ? 0 : (int32_t)(hash(x / 40, y / 40) % 401);
            const int32_t point[3] = {(int32_t)x * STEP, (int32_t)y * STEP, height(x, y) + more};
            print_must(canopy_field_insert_fx(&field, point, &hit) == CANOPY_OK, "a point was refused");
        }
    }
    (void)canopy_field_coverage(&field, coverage);
    print_must(canopy_fast_begin(&fast, coefficients[which]) == CANOPY_OK, "no fit");
    enum canopy_status status;
    while ((status = canopy_fast_step(&fast, 1)) == CANOPY_MORE)
        ;
    print_must(status == CANOPY_OK, "no fit");
    envelopes[which] =
        (struct canopy_envelope){.frame = frame, .coefficients = coefficients[which], .coverage = coverage};
}

// ---- Questions

// Thousandths of the height range.
static int64_t looseness(const struct canopy_extreme *search) {
    const struct canopy_extreme_answer answer = canopy_extreme_answer(search);
    const int64_t apart = (int64_t)answer.bound - answer.attained;
    return 1000 * (apart < 0 ? -apart : apart) / ((int64_t)RANGE << -envelopes[0].frame.lsb_log2);
}

static void measure_extreme(const char *name, const struct canopy_query_subject *subject,
                            const struct canopy_query_rect *rect, enum canopy_extreme_kind kind) {
    static struct canopy_extreme_node nodes[CANOPY_EXTREME_NODES];
    static struct canopy_extreme search;
    uint64_t start = canopy_board_instructions();
    print_must(canopy_extreme_begin(&search, subject, rect, kind, 2, nodes, CANOPY_EXTREME_NODES) == CANOPY_OK,
               "no search");
    uint64_t sum = canopy_board_instructions() - start;
    result(name, "_bound", (int64_t)sum);
    const uint32_t looks =
        (search.span[0].last - search.span[0].first + 1) * (search.span[1].last - search.span[1].first + 1);
    start = canopy_board_instructions();
    enum canopy_status status = canopy_extreme_step(&search, looks);
    sum += canopy_board_instructions() - start;
    result(name, "_look", (int64_t)sum);
    result(name, "_looseness", looseness(&search));
    uint32_t cuts = 0;
    start = canopy_board_instructions();
    for (; status == CANOPY_MORE; cuts++)
        status = canopy_extreme_step(&search, 1);
    sum += canopy_board_instructions() - start;
    print_must(status == CANOPY_OK, "no answer");
    result(name, "_end", (int64_t)sum);
    result(name, "_end_looseness", looseness(&search));
    result(name, "_cuts", cuts);
}

static void measure_place(void) {
    struct canopy_query_point point;
    int32_t low, high;
    uint64_t start = canopy_board_instructions();
    print_must(canopy_envelope_height(&envelopes[0], 5000, 4321, &low, &high) == CANOPY_OK, "no height");
    result("eval", "", (int64_t)(canopy_board_instructions() - start));
    start = canopy_board_instructions();
    print_must(canopy_query_at(&envelopes[0], 5000, 4321, &point) == CANOPY_OK, "no point");
    result("point", "", (int64_t)(canopy_board_instructions() - start));
    const struct canopy_query_subject change = {.surface = &envelopes[1], .minus = &envelopes[0]};
    start = canopy_board_instructions();
    print_must(canopy_query_cell(&change, 7, 7, &low, &high) == CANOPY_OK, "no cell");
    result("cell", "", (int64_t)(canopy_board_instructions() - start));
}

static void measure_volume(const char *name, const struct canopy_query_rect *rect) {
    const struct canopy_query_subject subject = {.surface = &envelopes[0]};
    static struct canopy_volume volume;
    const uint64_t start = canopy_board_instructions();
    print_must(canopy_volume_begin(&volume, &subject, rect) == CANOPY_OK &&
                   canopy_volume_step(&volume, UINT32_MAX) == CANOPY_OK,
               "no volume");
    const struct canopy_volume_answer answer = canopy_volume_answer(&volume);
    result(name, "", (int64_t)(canopy_board_instructions() - start));
    print_must(answer.low <= answer.high, "no bounds");
}

static void measure_regrid(void) {
    static struct canopy_regrid regrid;
    static int32_t half[FINE * N];
    static uint8_t half_coverage[CANOPY_COVERAGE_BYTES(FINE, N)];
    struct canopy_envelope by_u = {.coefficients = half, .coverage = half_coverage};
    struct canopy_envelope by_v = {.coefficients = fine, .coverage = fine_coverage};
    uint64_t start = canopy_board_instructions();
    print_must(canopy_regrid_halve(&envelopes[0], 0, &by_u) == CANOPY_OK &&
                   canopy_regrid_halve(&by_u, 1, &by_v) == CANOPY_OK,
               "not halved");
    result("halve", "", (int64_t)(canopy_board_instructions() - start));
    const struct canopy_query_rect whole = canopy_query_whole(&envelopes[0].frame);
    const struct canopy_grid grid = {.size = {COARSE, COARSE}, .cells = CELLS};
    const uint16_t cells[2] = {CELLS, CELLS};
    struct canopy_frame frame;
    start = canopy_board_instructions();
    print_must(canopy_regrid_frame(&envelopes[0].frame, &whole, &grid, &frame) == CANOPY_OK &&
                   canopy_field_init(&field, &frame, cells, field_arena, sizeof field_arena) == CANOPY_OK,
               "no field");
    canopy_regrid_begin(&regrid, &envelopes[0], whole.low, 0, 2, &field);
    print_must(canopy_regrid_step(&regrid, UINT32_MAX) == CANOPY_OK, "not filled");
    result("regrid", "", (int64_t)(canopy_board_instructions() - start));
}

static void measure_scene(int32_t (*height)(uint32_t x, uint32_t y)) {
    fit(height, 1);
    fit(height, 0);
    const uint32_t u = envelopes[0].frame.pitch[0], v = envelopes[0].frame.pitch[1];
    const struct canopy_query_rect whole = canopy_query_whole(&envelopes[0].frame);
    const struct canopy_query_rect window = {{3 * u + 50, 5 * v + 70}, {9 * u + 33, 11 * v + 20}};
    const struct canopy_query_rect small = {{7 * u + 50, 7 * v + 70}, {8 * u + 20, 8 * v + 20}};
    const struct canopy_query_subject surface = {.surface = &envelopes[0]};
    const struct canopy_query_subject change = {.surface = &envelopes[1], .minus = &envelopes[0]};
    const struct canopy_query_plane plane = {-CANOPY_QUERY_PLANE_ONE, {1000 * CANOPY_QUERY_PLANE_ONE, 0}};
    const struct canopy_query_subject over_plane = {.surface = &envelopes[0], .plane = &plane};
    measure_place();
    measure_extreme("whole", &surface, &whole, CANOPY_HIGHEST);
    measure_extreme("whole_low", &surface, &whole, CANOPY_LOWEST);
    measure_extreme("window", &surface, &window, CANOPY_HIGHEST);
    measure_extreme("small", &surface, &small, CANOPY_HIGHEST);
    measure_extreme("clearance", &change, &whole, CANOPY_LOWEST);
    measure_extreme("plane", &over_plane, &whole, CANOPY_LOWEST);
    measure_volume("volume", &whole);
    measure_volume("volume_window", &window);
    measure_regrid();
}

int main(void) {
    (void)canopy_board_start((const uint32_t[]){115200, 115200});
    scene = "hills";
    measure_scene(hills);
    scene = "boxes";
    measure_scene(boxes);
    canopy_board_exit(true);
}
