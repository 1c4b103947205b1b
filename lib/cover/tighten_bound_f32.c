// What the duals prove (tighten.h), all rounding taken off.

#include "lib/cover/tighten_f32.h"

void canopy_tighten_find_bound(struct canopy_tighten *t) {
    const size_t count = canopy_tighten_coefficients(t);
    // Every sum here is of terms of one sign. The objective is added up in pieces of 16 blocks, a dual's share in the
    // rows of a cell and then up to 16 cells, each in up to three pieces; a term is off by less than 40 roundings.
    const uint32_t depth = 100 + t->deepest / 16 + t->crowded;
    const float rounding = 0x1p-24f * (float)depth;
    struct canopy_tighten_sum lost = {0, 0}, gap = {-t->height_mean, 0}, duals = {0, 0};
    for (size_t j = 0; j < count; j++) {
        const float c = t->cost[j], y = t->g[0][j], r = c - y;
        const float down = t->x[j] - CANOPY_TIGHTEN_FLOOR, up = CANOPY_TIGHTEN_CEILING - t->x[j];
        canopy_tighten_add(&lost, larger(r * down, -r * up) + rounding * (c + y) * larger(down, up));
        canopy_tighten_add(&gap, c * t->x[j]);
        canopy_tighten_add(&duals, y);
    }
    // The complementarity is added up lane by lane and unit by unit.
    const uint32_t length = 160 + t->row_count;
    const float slack = t->comp + 0x1p-24f * (float)length * t->comp + rounding + CANOPY_TIGHTEN_ERROR * duals.high;
    const float bound = ((gap.high - lost.high) - slack) + (gap.low - lost.low);
    t->bound = bound * t->range > t->bound ? bound * t->range : t->bound;  // also where it is no number
}

float canopy_tighten_excess(const struct canopy_tighten *tighten) {
    if (!(tighten->bound > 0)) {
        return 1e30f;
    }
    // the published mean gap is a sum of 16 roundings a coefficient of weights that are off as those of the bound are
    const uint32_t depth = 160 + tighten->deepest / 8;
    const float off = 0x1p-24f * (float)depth * tighten->range;
    return larger((tighten->mean_gap + off - tighten->bound) / tighten->bound, 0.0f);
}
