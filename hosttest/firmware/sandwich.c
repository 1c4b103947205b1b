// What a sandwich costs on the chip, in instructions: run by hosttest/bench_firmware.py.
//
// The scenes of scene.h, 400 columns x 344 profiles, 20 x 20 coefficients, Q = 4, fixed point:
//   NAME_feed    both fields, a point
//   NAME_one     one side alone: fit and certificate
//   NAME_both    the sandwich, from canopy_sandwich_begin to CANOPY_OK; NAME_steps units of work, NAME_longest the
//                longest of them
//   NAME_check   of that, a row of knot cells of canopy_sandwich_least
//   NAME_raised  upper coefficients that were raised
#include "lib/cover/sandwich.h"
#include "hosttest/firmware/print.h"
#include "hosttest/firmware/scene.h"
#include "port/board.h"

enum { N = 20, CELLS = 4, COLUMNS = 400, PROFILES = 344, STEP = 30, RANGE = 8192 };

static CANOPY_ARENA_DECLARE(above_arena, CANOPY_FIELD_ARENA(N, N, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(below_arena, CANOPY_FIELD_ARENA(N, N, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(arena, CANOPY_SANDWICH_ARENA(N, N, CELLS, CELLS, 1));
static struct canopy_field fields[2];
static struct canopy_sandwich sandwich;
static int32_t upper[N * N], lower[N * N];
static const char *scene;

static void result(const char *name, int64_t value) {
    print_text(scene);
    print_text("_");
    print_result(name, value);
}

static void fill(int32_t (*height)(uint32_t x, uint32_t y)) {
    uint64_t *const arenas[2] = {above_arena, below_arena};
    const int32_t low[3] = {0, 0, 0}, high[3] = {STEP * (COLUMNS - 1), STEP * (PROFILES - 1), RANGE};
    const uint16_t cells[2] = {CELLS, CELLS};
    for (uint8_t side = 0; side < 2; side++) {
        const struct canopy_grid grid = {.size = {N, N}, .cells = CELLS, .side = side};
        struct canopy_frame frame;
        print_must(canopy_frame_around_fx(&frame, &grid, low, high) == CANOPY_OK &&
                       canopy_field_init(&fields[side], &frame, cells, arenas[side], sizeof above_arena) == CANOPY_OK,
                   "no field");
    }
    uint64_t sum = 0;
    for (uint32_t y = 0; y < PROFILES; y++) {
        for (uint32_t x = 0; x < COLUMNS; x++) {
            const int32_t point[1][3] = {{(int32_t)x * STEP, (int32_t)y * STEP, height(x, y)}};
            const uint64_t start = canopy_board_instructions();
            print_must(canopy_sandwich_feed_fx(&fields[0], &fields[1], point, 1) == 0, "a point was refused");
            sum += canopy_board_instructions() - start;
        }
    }
    result("feed", (int64_t)(sum / (PROFILES * COLUMNS)));
}

static void measure_one(void) {
    struct canopy_fast *fast = &sandwich.fast;
    struct canopy_certify *certify = &sandwich.certify;
    const uint64_t start = canopy_board_instructions();
    print_must(canopy_fast_init(fast, &fields[0], &canopy_line_fit_fx, 1, arena, sizeof arena) == CANOPY_OK &&
                   canopy_fast_begin(fast, upper) == CANOPY_OK,
               "no fit");
    while (canopy_fast_step(fast, 1) == CANOPY_MORE)
        ;
    print_must(canopy_certify_init(certify, &fields[0], arena, sizeof arena) == CANOPY_OK, "no certificate");
    canopy_certify_begin(certify, upper);
    print_must(canopy_certify_step(certify, UINT32_MAX) == CANOPY_OK, "not safe");
    result("one", (int64_t)(canopy_board_instructions() - start));
}

static void measure_both(void) {
    uint64_t sum = 0, longest = 0, check = 0;
    int64_t steps = 0;
    print_must(canopy_sandwich_init(&sandwich, &fields[0], &fields[1], &canopy_line_fit_fx, 1, arena, sizeof arena) ==
                       CANOPY_OK &&
                   canopy_sandwich_begin(&sandwich, upper, lower) == CANOPY_OK,
               "no sandwich");
    for (enum canopy_status status = CANOPY_MORE; status != CANOPY_OK; steps++) {
        const uint64_t start = canopy_board_instructions();
        const bool checks = sandwich.stage == CANOPY_SANDWICH_CHECK;
        status = canopy_sandwich_step(&sandwich, 1);
        const uint64_t took = canopy_board_instructions() - start;
        print_must(status == CANOPY_OK || status == CANOPY_MORE, "no sandwich");
        sum += took;
        longest = took > longest ? took : longest;
        check = checks && took > check ? took : check;
    }
    result("both", (int64_t)sum);
    result("steps", steps);
    result("longest", (int64_t)longest);
    result("check", (int64_t)check);
    result("raised", sandwich.raised);
}

int main(void) {
    int32_t (*const heights[2])(uint32_t x, uint32_t y) = {hills, boxes};
    static const char *const names[2] = {"hills", "boxes"};
    (void)canopy_board_start((const uint32_t[]){115200, 115200});
    for (int k = 0; k < 2; k++) {
        scene = names[k];
        fill(heights[k]);
        measure_one();
        measure_both();
    }
    canopy_board_exit(true);
}
