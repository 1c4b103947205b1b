#include "tools/bench/floor.h"

#include <math.h>
#include <string.h>

/// Four floats, or whole numbers, that the compiler keeps in one register.
typedef float four __attribute__((vector_size(16)));
typedef int32_t four_whole __attribute__((vector_size(16)));

static size_t cell_count(const struct canopy_floor_grid *grid) { return (size_t)grid->cells[0] * grid->cells[1]; }

// Two tables, for the passes that use two.
size_t canopy_floor_room(const struct canopy_floor_grid *grid) { return 2 * cell_count(grid); }

struct canopy_floor_grid canopy_floor_around(const float (*points)[3], size_t count, uint32_t rows, uint32_t columns) {
    struct canopy_floor_grid grid = {.cells = {rows, columns}};
    for (int a = 0; a < 2; a++) {
        float low = points[0][a];
        float high = low;
        for (size_t i = 1; i < count; i++) {
            low = fminf(low, points[i][a]);
            high = fmaxf(high, points[i][a]);
        }
        grid.origin[a] = low;
        grid.scale[a] = high > low ? (float)grid.cells[a] / (high - low) : 0.0F;
        // The last point belongs to the last cell: a scale a trifle smaller spares the pass a comparison.
        while ((uint32_t)((high - low) * grid.scale[a]) >= grid.cells[a]) {
            grid.scale[a] = nextafterf(grid.scale[a], 0.0F);
        }
    }
    return grid;
}

static void clear(float *heights, size_t count) {
    for (size_t c = 0; c < count; c++) {
        heights[c] = -HUGE_VALF;
    }
}

static inline float higher(float a, float b) { return a > b ? a : b; }

static inline size_t cell_of(const struct canopy_floor_grid *g, const float p[3]) {
    const int32_t row = (int32_t)((p[0] - g->origin[0]) * g->scale[0]);
    const int32_t column = (int32_t)((p[1] - g->origin[1]) * g->scale[1]);
    const int32_t cell = row * (int32_t)g->cells[1] + column;
    return (size_t)cell;
}

/// The plain loop; the maximum is a store without a jump.
static void pass_plain(const struct canopy_floor_grid *grid, const float (*points)[3], size_t count, float *heights) {
    const struct canopy_floor_grid g = *grid;
    clear(heights, cell_count(&g));
    for (size_t i = 0; i < count; i++) {
        float *height = &heights[cell_of(&g, points[i])];
        *height = higher(points[i][2], *height);
    }
}

/// Stores only where the cell rises: a jump, guessed right where neighbours in memory are neighbours in space.
static void pass_jump(const struct canopy_floor_grid *grid, const float (*points)[3], size_t count, float *heights) {
    const struct canopy_floor_grid g = *grid;
    clear(heights, cell_count(&g));
    for (size_t i = 0; i < count; i++) {
        float *height = &heights[cell_of(&g, points[i])];
        if (__builtin_expect(points[i][2] > *height, 0)) {
            *height = points[i][2];
        }
    }
}

/// Points 4i .. 4i+3, coordinate by coordinate.
static inline void load(const float *from, four *x, four *y, four *z) {
    four a;
    four b;
    four c;
    memcpy(&a, from, sizeof a);
    memcpy(&b, from + 4, sizeof b);
    memcpy(&c, from + 8, sizeof c);
    // a = x0 y0 z0 x1, b = y1 z1 x2 y2, c = z2 x3 y3 z3
    const four ab = __builtin_shufflevector(a, b, 0, 3, 6, 1);  // x0 x1 x2 y0
    const four bc = __builtin_shufflevector(b, c, 0, 3, 6, 5);  // y1 y2 y3 x3
    *x = __builtin_shufflevector(ab, bc, 0, 1, 2, 7);
    *y = __builtin_shufflevector(ab, bc, 3, 4, 5, 6);
    const four ab_z = __builtin_shufflevector(a, b, 2, 5, 2, 5);  // z0 z1
    *z = __builtin_shufflevector(ab_z, c, 0, 1, 4, 7);
}

/// Cells of four points at a time. `second` is where the odd points go: the same table, or one of their own, so that a
/// point need not wait for the store of its neighbour.
static inline void four_at_a_time(const struct canopy_floor_grid *grid, const float (*points)[3], size_t count,
                                  float *heights, float *second) {
    const struct canopy_floor_grid g = *grid;
    const float columns = (float)g.cells[1];
    size_t i = 0;
    for (; i + 4 <= count; i += 4) {
        four x;
        four y;
        four z;
        load(points[i], &x, &y, &z);
        const four_whole row = __builtin_convertvector((x - g.origin[0]) * g.scale[0], four_whole);
        const four_whole column = __builtin_convertvector((y - g.origin[1]) * g.scale[1], four_whole);
        // Products of whole numbers below 2^24 are exact in float, and SSE2 multiplies no 32-bit integers.
        const four_whole cell =
            __builtin_convertvector(__builtin_convertvector(row, four) * columns, four_whole) + column;
        heights[cell[0]] = higher(z[0], heights[cell[0]]);
        second[cell[1]] = higher(z[1], second[cell[1]]);
        heights[cell[2]] = higher(z[2], heights[cell[2]]);
        second[cell[3]] = higher(z[3], second[cell[3]]);
    }
    for (; i < count; i++) {
        float *height = &heights[cell_of(&g, points[i])];
        *height = higher(points[i][2], *height);
    }
}

static void pass_four(const struct canopy_floor_grid *grid, const float (*points)[3], size_t count, float *heights) {
    clear(heights, cell_count(grid));
    four_at_a_time(grid, points, count, heights, heights);
}

static void merge(float *restrict heights, const float *restrict second, size_t cells) {
    for (size_t c = 0; c < cells; c++) {
        heights[c] = higher(heights[c], second[c]);
    }
}

static void pass_two_tables(const struct canopy_floor_grid *grid, const float (*points)[3], size_t count,
                            float *heights) {
    const size_t cells = cell_count(grid);
    clear(heights, 2 * cells);
    four_at_a_time(grid, points, count, heights, heights + cells);
    merge(heights, heights + cells, cells);
}

/// The plain loop with a table for every second point.
static void pass_plain_two(const struct canopy_floor_grid *grid, const float (*points)[3], size_t count,
                           float *heights) {
    const struct canopy_floor_grid g = *grid;
    const size_t cells = cell_count(&g);
    float *second = heights + cells;
    clear(heights, 2 * cells);
    for (size_t i = 0; i < count; i += 2) {
        float *height = &heights[cell_of(&g, points[i])];
        *height = higher(points[i][2], *height);
        const size_t next = i + 1 < count ? i + 1 : i;
        height = &second[cell_of(&g, points[next])];
        *height = higher(points[next][2], *height);
    }
    merge(heights, second, cells);
}

const struct canopy_floor canopy_floors[] = {
    {"plain", pass_plain},         {"plain, two tables", pass_plain_two}, {"with a jump", pass_jump},
    {"four at a time", pass_four}, {"four, two tables", pass_two_tables},
};
const size_t canopy_floor_count = sizeof canopy_floors / sizeof canopy_floors[0];
