/// The floor: the least a fit from points can cost, one pass that puts every point's height into its cell's maximum.
///
/// Points are float triples in memory, the cells those of a field with Q = 4. There is no frame, no check of the input
/// and no proof in it: a fit and its certificate are quoted as multiples of this pass, measured in the same run.
/// Several ways of writing it are timed and the fastest counts, for which one wins depends on how the points are
/// ordered.
#ifndef CANOPY_TOOLS_BENCH_FLOOR_H
#define CANOPY_TOOLS_BENCH_FLOOR_H

#include <stddef.h>
#include <stdint.h>

/// Where the cells are: index (x - origin) * scale, below `cells` for every point.
struct canopy_floor_grid {
    float origin[2];
    float scale[2];
    uint32_t cells[2];
};

/// The smallest grid of cells[0] x cells[1] cells around the points. Not part of the pass.
struct canopy_floor_grid canopy_floor_around(const float (*points)[3], size_t count, uint32_t rows, uint32_t columns);

/// One way of writing the pass. heights: canopy_floor_room(grid) floats, of which the first cells[0] * cells[1] are the
/// result, row order, -infinity where there is no point; what they held before does not matter.
struct canopy_floor {
    const char *name;
    void (*pass)(const struct canopy_floor_grid *grid, const float (*points)[3], size_t count, float *heights);
};

extern const struct canopy_floor canopy_floors[];
extern const size_t canopy_floor_count;

/// Floats of memory that a pass needs.
size_t canopy_floor_room(const struct canopy_floor_grid *grid);

#endif
