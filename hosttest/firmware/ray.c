// What rays cost on the chip, in instructions: run by hosttest/bench_firmware.py.
//
// The scenes of scene.h, 400 columns x 344 profiles, fitted to 20 x 20 coefficients from a field with Q = 4, and 256
// rays from everywhere over three frame widths, high above, to everywhere in the frame: fixed point.
//   mean, most    a ray;  cells_x100, hits: how many cells it looks at, and how many of the 256 hit
//   plumb         a ray straight down;  free: a segment over everything, from edge to edge
//   steps         most root-finder steps in one cell
#include "lib/cover/ray.h"
#include "hosttest/firmware/print.h"
#include "hosttest/firmware/scene.h"
#include "lib/cover/fast.h"
#include "port/board.h"

enum { N = 20, CELLS = 4, COLUMNS = 400, PROFILES = 344, STEP = 30, RANGE = 8192, RAYS = 256 };

static CANOPY_ARENA_DECLARE(field_arena, CANOPY_FIELD_ARENA(N, N, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(fast_arena, CANOPY_FAST_ARENA(N, N, CELLS, 1));
static int32_t coefficients[N * N];
static struct canopy_envelope envelope;
static struct canopy_field field;
static const char *scene;
static uint32_t state = 1;

static void result(const char *name, uint64_t value) {
    print_text(scene);
    print_text("_");
    print_result(name, (int64_t)value);
}

static void fit(int32_t (*height)(uint32_t x, uint32_t y)) {
    static struct canopy_fast fast;
    const struct canopy_grid grid = {.size = {N, N}, .cells = CELLS, .side = CANOPY_ABOVE};
    const int32_t low[3] = {0, 0, 0}, high[3] = {STEP * (COLUMNS - 1), STEP * (PROFILES - 1), RANGE};
    struct canopy_frame frame;
    const uint16_t cells[2] = {CELLS, CELLS};
    print_must(canopy_frame_around_fx(&frame, &grid, low, high) == CANOPY_OK, "no frame");
    print_must(canopy_field_init(&field, &frame, cells, field_arena, sizeof field_arena) == CANOPY_OK, "no field");
    for (uint32_t y = 0; y < PROFILES; y++) {
        for (uint32_t x = 0; x < COLUMNS; x++) {
            const int32_t point[3] = {(int32_t)x * STEP, (int32_t)y * STEP, height(x, y)};
            struct canopy_field_hit hit;
            print_must(canopy_field_insert_fx(&field, point, &hit) == CANOPY_OK, "a point was refused");
        }
    }
    print_must(canopy_fast_init(&fast, &field, &canopy_line_fit_fx, 1, fast_arena, sizeof fast_arena) == CANOPY_OK &&
                   canopy_fast_begin(&fast, coefficients) == CANOPY_OK,
               "no fit");
    while (canopy_fast_step(&fast, 1) == CANOPY_MORE) {}
    envelope = (struct canopy_envelope){.frame = frame, .scalar = CANOPY_FX, .coefficients = coefficients};
}

// 0 to limit - 1
static int32_t draw(uint32_t limit) {
    state = state * 1664525U + 1013904223U;
    return (int32_t)(((uint64_t)(state >> 8) * limit) >> 24);
}

static uint64_t cast(const int64_t from[3], const int32_t along[3], struct canopy_ray_hit *hit) {
    const uint64_t start = canopy_board_instructions();
    const enum canopy_status status = canopy_ray_first_fx(&envelope, from, along, hit);
    const uint64_t taken = canopy_board_instructions() - start;
    print_must(status == CANOPY_OK, "a ray was refused");
    return taken;
}

static void measure_scene(int32_t (*height)(uint32_t x, uint32_t y)) {
    const int32_t wide = STEP * (COLUMNS - 1), deep = STEP * (PROFILES - 1);
    uint64_t sum = 0, most = 0;
    uint32_t cells = 0, hits = 0, steps = 0;
    struct canopy_ray_hit hit;
    fit(height);
    for (int i = 0; i < RAYS; i++) {
        const int32_t to[3] = {draw((uint32_t)wide), draw((uint32_t)deep), draw(RANGE)};
        const int64_t from[3] = {draw(3 * (uint32_t)wide) - wide, draw(3 * (uint32_t)deep) - deep,
                                 RANGE + wide + draw((uint32_t)wide)};
        const int32_t along[3] = {to[0] - (int32_t)from[0], to[1] - (int32_t)from[1], to[2] - (int32_t)from[2]};
        const uint64_t taken = cast(from, along, &hit);
        sum += taken;
        most = taken > most ? taken : most;
        cells += hit.cells;
        hits += canopy_ray_is_hit(&hit);
        steps = hit.steps > steps ? hit.steps : steps;
    }
    result("mean", sum / RAYS);
    result("most", most);
    result("cells_x100", 100U * cells / RAYS);
    result("hits", hits);
    result("steps", steps);
    const int64_t over[3] = {wide / 3, deep / 3, 3 * RANGE}, left[3] = {0, 100, 3 * RANGE},
                  right[3] = {wide, 9000, 3 * RANGE};
    const int32_t down[3] = {0, 0, -1};
    result("plumb", cast(over, down, &hit));
    print_must(hit.outcome == CANOPY_RAY_HIT, "a plumb line misses");
    const uint64_t start = canopy_board_instructions();
    const bool is_free = canopy_ray_is_free_fx(&envelope, left, right, &hit);
    result("free", canopy_board_instructions() - start);
    print_must(is_free, "a segment above everything is not free");
}

int main(void) {
    (void)canopy_board_start((const uint32_t[]){115200, 115200});
    scene = "hills";
    measure_scene(hills);
    scene = "boxes";
    measure_scene(boxes);
    canopy_board_exit(true);
}
