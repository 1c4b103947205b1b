// What the tight method costs on the chip, in instructions: run by hosttest/bench_firmware.py.
//
// The hills of scene.h, 400 columns x 344 profiles, Q = 4, for 10 x 10 and 20 x 20 coefficients, as a station has them:
// the fast method's surface from the field, certified, is tightened in the background (lib/station/tightening.h) with
// CANOPY_TIGHTEN_ROWS_FEW.
//   GRID_begin           the first piece of work: every cell's height is looked at
//   GRID_longest_step    the longest of the others
//   GRID_iteration       the mean of an iteration, its candidate's certificate included; GRID_longest_iteration
//   GRID_iterations      how many there were; GRID_pieces of work, GRID_all of it together
//   GRID_fast_gap, GRID_gap, GRID_bound   mean gap over the covered area before and after, and what no surface goes
//                        below, in steps
#include "hosttest/firmware/print.h"
#include "hosttest/firmware/scene.h"
#include "lib/cover/certify.h"
#include "lib/cover/fast.h"
#include "lib/station/tightening.h"
#include "port/board.h"

enum { MOST = 20, CELLS = 4, COLUMNS = 400, PROFILES = 344, STEP = 30, RANGE = 8192 };

#define ROWS(n) CANOPY_TIGHTEN_ROWS_FEW(n, n)

static CANOPY_ARENA_DECLARE(field_arena, CANOPY_FIELD_ARENA(MOST, MOST, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(fast_arena, CANOPY_FAST_ARENA(MOST, MOST, CELLS, 1));
static CANOPY_ARENA_DECLARE(certify_arena, CANOPY_CERTIFY_ARENA(MOST, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(arena, CANOPY_STATION_TIGHTENING_ARENA(MOST, MOST, CELLS, ROWS(MOST)));
static struct canopy_field field;
static struct canopy_fast fast;
static struct canopy_certify certify;
static struct canopy_station_tightening tightening;
static int32_t coefficients[MOST * MOST];
static const char *name;

static void result(const char *what, int64_t value) {
    print_text(name);
    print_text("_");
    print_result(what, value);
}

static uint64_t larger(uint64_t a, uint64_t b) { return a > b ? a : b; }

static void fill(uint16_t n) {
    const struct canopy_grid grid = {.size = {n, n}, .cells = CELLS, .side = CANOPY_ABOVE};
    const int32_t low[3] = {0, 0, 0}, high[3] = {STEP * (COLUMNS - 1), STEP * (PROFILES - 1), RANGE};
    const uint16_t cells[2] = {CELLS, CELLS};
    struct canopy_frame frame;
    print_must(canopy_frame_around_fx(&frame, &grid, low, high) == CANOPY_OK &&
                   canopy_field_init(&field, &frame, cells, field_arena, sizeof field_arena) == CANOPY_OK,
               "no field");
    for (uint32_t y = 0; y < PROFILES; y++)
        for (uint32_t x = 0; x < COLUMNS; x++) {
            const int32_t point[1][3] = {{(int32_t)x * STEP, (int32_t)y * STEP, hills(x, y)}};
            print_must(canopy_field_feed_fx(&field, point, 1) == 0, "a point was refused");
        }
}

static enum canopy_status certify_all(void) {
    enum canopy_status status;
    canopy_certify_begin(&certify, coefficients);
    while ((status = canopy_certify_step(&certify, 1)) == CANOPY_MORE)
        ;
    return status;
}

static void fit(void) {
    print_must(canopy_fast_init(&fast, &field, &canopy_line_fit_f32, 1, fast_arena, sizeof fast_arena) == CANOPY_OK &&
                   canopy_fast_begin(&fast, coefficients) == CANOPY_OK,
               "no fit");
    while (canopy_fast_step(&fast, 1) == CANOPY_MORE)
        ;
    print_must(canopy_certify_init(&certify, &field, certify_arena, sizeof certify_arena) == CANOPY_OK &&
                   certify_all() == CANOPY_OK,
               "not certified");
}

// Every piece of work until it ends.
static void tighten(void) {
    struct canopy_station_spare *spare = &tightening.spare;
    struct canopy_tighten *t = &tightening.tighten;
    uint64_t before = canopy_board_instructions(), all = 0, longest = 0, one = 0, longest_one = 0, sum = 0;
    uint32_t pieces = 1;
    print_must(spare->spare_begin(spare, &field, &certify, coefficients), "not begun");
    const uint64_t begin = canopy_board_instructions() - before;
    int64_t fast_gap = 0;
    enum canopy_status status;
    do {
        const uint8_t stage = t->stage;
        before = canopy_board_instructions();
        status = spare->spare_step(spare);
        const uint64_t work = canopy_board_instructions() - before;
        pieces++;
        all += work;
        fast_gap = t->published == 1 ? (int64_t)t->mean_gap : fast_gap;
        longest = larger(longest, work);
        one += work;
        if (t->stage == CANOPY_TIGHTEN_CLEAR && stage != CANOPY_TIGHTEN_CLEAR) {  // one ends, or the first begins
            sum += t->iterations > 0 ? one : 0;
            longest_one = t->iterations > 0 ? larger(longest_one, one) : 0;
            one = 0;
        }
    } while (status == CANOPY_MORE);
    print_must(status == CANOPY_OK && spare->spare_take(spare, coefficients) && certify_all() == CANOPY_OK,
               "nothing came of it");
    result("begin", (int64_t)begin);
    result("longest_step", (int64_t)longest);
    result("iteration", (int64_t)(sum / t->iterations));
    result("longest_iteration", (int64_t)longest_one);
    result("iterations", t->iterations);
    result("pieces", pieces);
    result("all", (int64_t)(begin + all));
    result("fast_gap", fast_gap);
    result("gap", (int64_t)t->mean_gap);
    result("bound", (int64_t)t->bound);
}

static void measure(const char *grid_name, uint16_t n) {
    const struct canopy_grid grid = {.size = {n, n}, .cells = CELLS, .side = CANOPY_ABOVE};
    name = grid_name;
    fill(n);
    fit();
    print_must(canopy_station_tightening_init(&tightening, &grid, ROWS(n), arena, sizeof arena) == CANOPY_OK,
               "no tightening");
    tighten();
}

int main(void) {
    (void)canopy_board_start((const uint32_t[]){115200, 115200});
    measure("10x10", 10);
    measure("20x20", 20);
    canopy_board_exit(true);
}
