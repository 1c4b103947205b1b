#include "lib/cover/line.h"

#include "lib/num/fixed.h"
#include "lib/spline/bound.h"

void canopy_line_init(struct canopy_line *line, size_t n, size_t q, struct canopy_arena *cut) {
    *line = (struct canopy_line){0};
    line->rows = canopy_arena_take(cut, n * sizeof(struct canopy_band_row_fx));
    line->best = canopy_arena_take(cut, 4 * n);
    line->chosen = canopy_arena_take(cut, 2 * n);
    line->concave = canopy_arena_take(cut, n);
    line->nodes = canopy_arena_take(cut, 4 * CANOPY_LINE_NODES(n, q));
    line->scaled = canopy_arena_take(cut, 4 * CANOPY_LINE_NODES(n, q));
    line->weights = canopy_arena_take(cut, 12 * (q + 1));
}

// Raises b[from] … b[to], as far as they exist.
static void raise(int32_t *b, uint16_t n, int from, int to, int32_t by) {
    for (int i = from < 0 ? 0 : from; i <= to && i < n; i++) {
        b[i] += by;
    }
}

int32_t canopy_line_lift(int32_t *b, uint16_t n, uint16_t q, const int32_t *nodes) {
    const int64_t one = 6 * (int64_t)q * q * q;  // everything below is exact, in units of 1/(6 q^3)
    int32_t most = 0;
    for (uint16_t h = 0; h + 1 < n; h++) {
        int64_t left = canopy_bend(b, n, h), right = canopy_bend(b, n, h + 1U);
        const int last = h + 2 == n ? q : q - 1;  // a knot's node belongs to the interval on its right
        for (int k = 0; k <= last; k++) {
            const int32_t height = nodes[(size_t)h * q + (size_t)k];
            if (height == CANOPY_NO_HEIGHT) {
                continue;
            }
            const int64_t missing = one * height - canopy_bound_exact(b, h, left, right, (uint32_t)k, q);
            if (missing > 0) {
                const int32_t by = (int32_t)canopy_div_ceil(missing, one);
                raise(b, n, h - (k < q), h + 1 + (k > 0), by);
                most = by > most ? by : most;
                left = canopy_bend(b, n, h);
                right = canopy_bend(b, n, h + 1U);
            }
        }
    }
    return most;
}
