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
    line->heights = canopy_arena_take(cut, 4 * CANOPY_LINE_NODES(n, q));
    line->vertices = canopy_arena_take(cut, 2 * CANOPY_LINE_NODES(n, q));
    line->weights = canopy_arena_take(cut, 12 * (q + 1));
}

// Raises b[from] … b[to], as far as they exist.
static void raise(int32_t *b, uint16_t n, int from, int to, int32_t by) {
    for (int i = from < 0 ? 0 : from; i <= to && i < n; i++) {
        b[i] += by;
    }
}

// Whether the node b lies on or under the straight line from a to c, a < b < c.
static inline bool is_under(const int32_t *nodes, uint16_t a, uint16_t b, uint16_t c) {
    const int64_t rise = (int64_t)nodes[c] - nodes[a], part = (int64_t)nodes[b] - nodes[a];
    return part * (c - a) <= rise * (b - a);
}

// The first node of a half interval; 2 (n-1) of them, the last of which has the line's last node as well.
static uint16_t half_start(uint16_t half, uint16_t q) {
    return (uint16_t)(half / 2 * q + (half % 2 == 0 ? 0 : (q + 1) / 2));
}

uint16_t canopy_line_hull(const int32_t *nodes, uint16_t n, uint16_t q, uint16_t *vertices) {
    const uint16_t halves = (uint16_t)(2 * (n - 1));
    uint16_t count = 0, node = 0;
    for (uint16_t half = 1; half <= halves; half++) {
        const uint16_t end = (uint16_t)(half_start(half, q) + (half == halves)), first = count;
        for (; node < end; node++) {
            if (nodes[node] == CANOPY_NO_HEIGHT) {
                continue;
            }
            while (count - first >= 2 && is_under(nodes, vertices[count - 2], vertices[count - 1], node)) {
                count--;
            }
            vertices[count++] = node;
        }
    }
    return count;
}

int32_t canopy_line_lift(int32_t *b, uint16_t n, uint16_t q, const int32_t *nodes, const uint16_t *vertices,
                         uint16_t count) {
    const int32_t one = 6 * q * q * q;  // everything below is exact, in units of 1/(6 q^3)
    int32_t most = 0;
    uint16_t at = 0;
    for (uint16_t h = 0; h + 1 < n; h++) {
        const uint16_t end =
            (uint16_t)((h + 1) * q + (h + 2 == n));  // a knot's node belongs to the interval on its right
        int32_t left = canopy_bend(b, n, h), right = canopy_bend(b, n, h + 1U);
        for (; at < count && vertices[at] < end; at++) {
            const int k = vertices[at] - h * q;
            const int64_t bound = canopy_bound_exact(b, h, left, right, k, q);
            const int64_t missing = canopy_wide(one, nodes[vertices[at]]) - bound;
            if (missing > 0) {
                const int32_t by = (int32_t)canopy_div_up((uint64_t)missing, (uint64_t)one);
                raise(b, n, h - (k < q), h + 1 + (k > 0), by);
                most = by > most ? by : most;
                left = canopy_bend(b, n, h);
                right = canopy_bend(b, n, h + 1U);
            }
        }
    }
    return most;
}
