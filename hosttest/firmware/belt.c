// What a new row of a belt costs on the chip, in instructions: run by hosttest/bench_firmware.py.
//
// A belt of the scenes of scene.h passes a ring of 20 coefficients across and 64 along, Q = 4, lines at the integers,
// until its window is full. Then, as a mean over NEW more rows:
//   row       canopy_ring_reach to the certified end of the refit, one unit of work a step; most_row the dearest one
//   move      the part of it that moves what is in memory
//   publish   canopy_ring_publish: coefficients and coverage into an envelope
// and of the window as it is then, once:
//   full      canopy_fast from begin to done, and the certificate of all rows, a knot row a step as the refit does it
#include "hosttest/firmware/print.h"
#include "hosttest/firmware/scene.h"
#include "lib/cover/ring.h"
#include "port/board.h"

#define M 64
#define N 20
#define CELLS 4
#define LINES 1
#define COLUMNS 100
#define PROFILES 8  // a knot row
#define STEP 30
#define NEW 16

static CANOPY_ARENA_DECLARE(arena, CANOPY_RING_ARENA(M, N, CELLS, LINES, 1));
static CANOPY_ARENA_DECLARE(fast_arena, CANOPY_FAST_ARENA(M, N, CELLS, LINES));
static CANOPY_ARENA_DECLARE(certify_arena, CANOPY_CERTIFY_ARENA(N, CELLS, CELLS));
static int32_t coefficients[CANOPY_COEFFICIENTS(M, N)];
static uint8_t coverage[CANOPY_COVERAGE_BYTES(M, N)];
static struct canopy_ring ring;

static void result(const char *scene, const char *name, uint64_t value) {
    print_text(scene);
    print_text("_");
    print_result(name, (int64_t)value);
}

static void must(enum canopy_status status, const char *what) { print_must(status == CANOPY_OK, what); }

static void feed_row(int32_t (*height)(uint32_t x, uint32_t y), uint32_t row) {
    for (uint32_t p = row * PROFILES; p < (row + 1) * PROFILES; p++) {
        for (uint32_t x = 0; x < COLUMNS; x++) {
            const struct canopy_ring_place place = {(int64_t)p * STEP, (int64_t)x * STEP};
            struct canopy_ring_hit hit;
            must(canopy_ring_insert(&ring, &place, height(x, p), p, &hit), "a reading was refused");
        }
    }
}

struct cost {
    uint64_t move, row, longest;
};

static struct cost take_row(uint32_t row) {
    struct cost cost = {0};
    const uint64_t start = canopy_board_instructions();
    (void)canopy_ring_reach(&ring, (int64_t)row * PROFILES * STEP);
    cost.move = canopy_board_instructions() - start;
    canopy_refit_begin(&ring.refit);
    enum canopy_status status;
    do {
        const uint64_t before = canopy_board_instructions();
        status = canopy_refit_step(&ring.refit, 1);
        const uint64_t one = canopy_board_instructions() - before;
        cost.longest = one > cost.longest ? one : cost.longest;
    } while (status == CANOPY_MORE);
    cost.row = canopy_board_instructions() - start;
    must(status, "no refit");
    return cost;
}

static void measure_full(const char *scene) {
    static struct canopy_fast fast;
    static struct canopy_certify certify;
    must(canopy_fast_init(&fast, &ring.field, &canopy_line_fit_fx, LINES, fast_arena, sizeof fast_arena), "no fit");
    must(canopy_certify_init(&certify, &ring.field, certify_arena, sizeof certify_arena), "no certificate");
    const uint64_t start = canopy_board_instructions();
    must(canopy_fast_begin(&fast, coefficients), "no fit");
    enum canopy_status status;
    while ((status = canopy_fast_step(&fast, 1)) == CANOPY_MORE)
        ;
    must(status, "no fit");
    canopy_certify_begin(&certify, coefficients);
    while ((status = canopy_certify_step(&certify, CELLS)) == CANOPY_MORE)
        ;
    must(status, "the fit of a field at rest must be certified at once");
    result(scene, "full", canopy_board_instructions() - start);
    result(scene, "full_solves", fast.solves);
}

static void measure_publish(const char *scene) {
    struct canopy_envelope envelope = {.coefficients = coefficients, .coverage = coverage};
    const uint64_t start = canopy_board_instructions();
    must(canopy_ring_publish(&ring, &envelope), "no envelope");
    result(scene, "publish", canopy_board_instructions() - start);
}

static void measure_belt(const char *scene, int32_t (*height)(uint32_t x, uint32_t y)) {
    const struct canopy_ring_config config = {
        .grid = {.size = {M, N}, .cells = CELLS, .side = CANOPY_ABOVE},
        .low = {0, 0, 0},
        .high = {(M - 1) * PROFILES * STEP, STEP * (COLUMNS - 1), 8192},
        .fit = &canopy_line_fit_fx,
        .lines = LINES,
        .open = 1,
    };
    must(canopy_ring_init(&ring, &config, arena, sizeof arena), "no ring");
    struct cost sum = {0};
    uint64_t most = 0, solves = 0;
    for (uint32_t row = 0; row < M + NEW; row++) {
        feed_row(height, row);
        const struct cost cost = take_row(row + 1);
        if (row >= M) {
            sum.move += cost.move;
            sum.row += cost.row;
            solves += ring.refit.solves;
            most = cost.row > most ? cost.row : most;
            sum.longest = cost.longest > sum.longest ? cost.longest : sum.longest;
        }
    }
    result(scene, "row", sum.row / NEW);
    result(scene, "most_row", most);
    result(scene, "move", sum.move / NEW);
    result(scene, "row_solves", solves / NEW);
    result(scene, "longest_step", sum.longest);
    measure_publish(scene);
    measure_full(scene);
}

int main(void) {
    (void)canopy_board_start((const uint32_t[]){115200, 115200});
    measure_belt("hills", hills);
    measure_belt("boxes", boxes);
    canopy_board_exit(true);
}
