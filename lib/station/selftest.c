#include "lib/station/selftest.h"

#include <string.h>

#include "lib/num/crc32.h"
#include "lib/station/march.h"

void canopy_selftest_init(struct canopy_selftest *test, const struct canopy_memory *memory) {
    *test = (struct canopy_selftest){.memory = memory};
}

// ---- RAM

#define WORDS 4U  // of a run
#define RUN_BYTES (WORDS * 4U)
#define LINES 16U   // address lines beyond those of a run, at most
#define BELOW 256U  // bytes of stack that a step may use below its own variables

// One run of words, or two.
struct window {
    volatile uint32_t *words[2 * WORDS];
};

static uint32_t get(void *context, unsigned i) { return *((const struct window *)context)->words[i]; }

static void put(void *context, unsigned i, uint32_t value) { *((const struct window *)context)->words[i] = value; }

// Nothing but the stack is touched beside the window while it is not what the program has put there.
static bool march(struct window *window, unsigned count, uint32_t background, const struct canopy_memory *memory) {
    uint32_t saved[2 * WORDS];
    // read before the call, after which it may be anything: it may stand in the window
    void (*const restore)(uint32_t was) = memory->restore;
    const uint32_t was = memory->mask();
    for (unsigned i = 0; i < count; i++) {
        saved[i] = get(window, i);
    }
    const bool good = canopy_march(window, get, put, count, background);
    for (unsigned i = 0; i < count; i++) {
        put(window, i, saved[i]);
    }
    restore(was);
    return good;
}

// Whether a run lies in the RAM, and not in the stack from `live` on.
static bool is_free(const struct canopy_memory *memory, uintptr_t run, uintptr_t live) {
    return run >= (uintptr_t)memory->ram && run + RUN_BYTES <= (uintptr_t)memory->ram_end &&
           (run + RUN_BYTES <= live || run >= (uintptr_t)memory->stack_end);
}

void canopy_selftest_ram(struct canopy_selftest *test) {
    const struct canopy_memory *memory = test->memory;
    const uintptr_t run = (uintptr_t)memory->ram + test->ram_at;
    const uintptr_t other = run ^ (uintptr_t)RUN_BYTES << test->ram_passes % LINES;
    struct window window;
    const uintptr_t live = (uintptr_t)&window - BELOW;
    for (unsigned i = 0; i < WORDS; i++) {
        window.words[i] = memory->ram + test->ram_at / 4U + i;
        window.words[WORDS + i] = window.words[i] + (ptrdiff_t)(other - run) / 4;
    }
    if (is_free(memory, run, live) &&
        !march(&window, is_free(memory, other, live) ? 2 * WORDS : WORDS,
               canopy_march_background(test->ram_passes % CANOPY_MARCH_BACKGROUNDS), memory)) {
        test->ram_failed = true;
    }
    test->ram_at += RUN_BYTES;
    if (run + 2U * RUN_BYTES > (uintptr_t)memory->ram_end) {
        test->ram_at = 0;
        test->ram_passes++;
    }
}

// ---- Flash

void canopy_selftest_flash(struct canopy_selftest *test) {
    const struct canopy_memory *memory = test->memory;
    const uint32_t left = (uint32_t)((uintptr_t)memory->flash_end - (uintptr_t)memory->flash) - test->flash_at;
    const uint32_t count = left < CANOPY_SELFTEST_FLASH_BYTES ? left : CANOPY_SELFTEST_FLASH_BYTES;
    test->crc = canopy_crc32(test->crc, memory->flash + test->flash_at, count);
    test->flash_at += count;
    if (count < left) {
        return;
    }
    if (test->crc == *memory->flash_end) {
        test->flash_passes++;
    } else {
        test->flash_failed = true;
    }
    test->flash_crc = test->crc;
    test->flash_at = 0;
    test->crc = 0;
}

// ---- Certificate

#define SIZE CANOPY_SELFTEST_SIZE
#define CELLS CANOPY_SELFTEST_CELLS
#define ROWS (CELLS * (SIZE - 1))
#define CELL_UNITS 4

const struct canopy_selftest_known canopy_selftest_fx = {&canopy_line_fit_fx, 0xDCADC789U, 3, 4};
const struct canopy_selftest_known canopy_selftest_f32 = {&canopy_line_fit_f32, 0xCC28A52BU, 3, 4};

static bool feed(struct canopy_field *field) {
    struct canopy_field_hit hit;
    for (uint32_t k = 0; k < ROWS * ROWS; k++) {
        const int32_t point[3] = {(int32_t)(k / ROWS * CELL_UNITS + 1), (int32_t)(k % ROWS * CELL_UNITS + 2),
                                  (int32_t)(k * k * 29 % 67)};
        if (canopy_field_insert_fx(field, point, &hit) != CANOPY_OK) {
            return false;
        }
    }
    return true;
}

static bool prepare(struct canopy_selftest_scene *scene, const struct canopy_line_fit *fit, struct canopy_arena *cut) {
    static const struct canopy_frame frame = {
        .pitch = {CELLS * CELL_UNITS, CELLS * CELL_UNITS},
        .size = {SIZE, SIZE},
        .cells = CELLS,
        .side = CANOPY_ABOVE,
        .axis = {{CANOPY_AXIS_ONE, 0, 0}, {0, CANOPY_AXIS_ONE, 0}, {0, 0, CANOPY_AXIS_ONE}},
    };
    static const uint16_t cells[2] = {CELLS, CELLS};
    const size_t field_bytes = CANOPY_FIELD_ARENA(SIZE, SIZE, CELLS, CELLS);
    const size_t fast_bytes = CANOPY_FAST_ARENA(SIZE, SIZE, CELLS, 1);
    return canopy_field_init(&scene->field, &frame, cells, canopy_arena_take(cut, field_bytes), field_bytes) ==
               CANOPY_OK &&
           canopy_fast_init(&scene->fast, &scene->field, fit, 1, canopy_arena_take(cut, fast_bytes), fast_bytes) ==
               CANOPY_OK &&
           canopy_certify_init(&scene->certify, &scene->field, cut->next, cut->left) == CANOPY_OK;
}

static bool fits(struct canopy_selftest_scene *scene) {
    enum canopy_status status = canopy_fast_begin(&scene->fast, scene->coefficients);
    while (status == CANOPY_OK && (status = canopy_fast_step(&scene->fast, 1000)) == CANOPY_MORE) {
        status = CANOPY_OK;
    }
    return status == CANOPY_OK;
}

// Certifies the coefficients lowered by so much.
static enum canopy_status certify_lower(struct canopy_selftest_scene *scene, int32_t by) {
    for (int32_t i = 0; i < SIZE * SIZE; i++) {
        scene->coefficients[i] -= by;
    }
    canopy_certify_begin(&scene->certify, scene->coefficients);
    return canopy_certify_step(&scene->certify, ROWS);
}

bool canopy_selftest_certificate(const struct canopy_selftest_known *known, void *arena, size_t bytes) {
    struct canopy_arena cut;
    if (canopy_arena_open(&cut, arena, bytes, CANOPY_SELFTEST_ARENA) != CANOPY_OK) {
        return false;
    }
    struct canopy_selftest_scene *scene = canopy_arena_take(&cut, sizeof *scene);
    if (!prepare(scene, known->fit, &cut) || !feed(&scene->field) || !fits(scene)) {
        return false;
    }
    const uint32_t crc = canopy_crc32(0, scene->coefficients, sizeof scene->coefficients);
    return crc == known->crc && certify_lower(scene, 0) == CANOPY_OK && scene->certify.margin == known->margin &&
           certify_lower(scene, known->fall - 1) == CANOPY_OK && certify_lower(scene, 1) == CANOPY_NOT_SAFE;
}
