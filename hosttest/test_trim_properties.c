// Free coefficients and the trim over many random masks, against readings of their rules that share nothing with lib.
//
// Everything is exact: S over a cell is evaluated in whole numbers, places are multiples of an eighth of a knot
// interval, areas and sides of lines are integers. CANOPY_CLOUDS sets how many masks, CANOPY_SEED=n runs that one.

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "hosttest/seeds.h"
#include "lib/cover/certify.h"
#include "lib/cover/fast.h"
#include "lib/cover/free.h"
#include "lib/cover/trim.h"
#include "lib/num/bits.h"
#include "tools/common/random.h"

enum { SIZE = 14, CELLS_MOST = 4 };  // most coefficients in each direction, and field cells a knot interval

struct mask {
    uint16_t size[2];
    bool cell[SIZE - 1][SIZE - 1];
    uint8_t coverage[CANOPY_COVERAGE_BYTES(SIZE, SIZE)];
};

#define MUST(condition)                                                                                                \
    do {                                                                                                               \
        if (!(condition)) {                                                                                            \
            printf("CANOPY_SEED=%llu\n", (unsigned long long)seed);                                                    \
            assert_true(condition);                                                                                    \
        }                                                                                                              \
    } while (0)

static bool covered(const struct mask *mask, int h, int w) {
    return h >= 0 && w >= 0 && h < mask->size[0] - 1 && w < mask->size[1] - 1 && mask->cell[h][w];
}

// Blobs, noise of any density, checkerboards and what lies between.
static struct mask make_mask(uint64_t *random) {
    struct mask mask = {.size = {(uint16_t)(4 + canopy_random_below(random, SIZE - 3)),
                                 (uint16_t)(4 + canopy_random_below(random, SIZE - 3))}};
    const uint32_t kind = canopy_random_below(random, 4);
    const double density = canopy_random_unit(random), u = canopy_random_unit(random) * mask.size[0],
                 v = canopy_random_unit(random) * mask.size[1], r = canopy_random_unit(random) * mask.size[0];
    for (int h = 0; h < mask.size[0] - 1; h++) {
        for (int w = 0; w < mask.size[1] - 1; w++) {
            bool here = canopy_random_chance(random, density);
            if (kind == 1) {
                here = (h + w) % 2 == 0 ? here : !canopy_random_chance(random, density);
            } else if (kind == 2) {
                const double d = (h - u) * (h - u) + (w - v) * (w - v);
                here = d < r * r && d > r * r * density / 2;
            }
            mask.cell[h][w] = here;
            if (here) {
                (void)canopy_bit_set(mask.coverage, (uint32_t)(h * (mask.size[1] - 1) + w));
            }
        }
    }
    return mask;
}

// ---- Free coefficients

// 6 * 8^3 times the weights of the four B-splines at k/8.
static void weigh(int k, int64_t weight[4]) {
    const int64_t r = 8 - k, s = k;
    weight[0] = r * r * r;
    weight[1] = 3 * s * s * s - 6 * 8 * s * s + 4 * 512;
    weight[2] = 3 * r * r * r - 6 * 8 * r * r + 4 * 512;
    weight[3] = s * s * s;
}

static int clamp(int i, int end) { return i < 0 ? 0 : i < end ? i : end - 1; }

// 3072^2 S at (h + p/8, w + q/8): |b| <= 2^28, so below 2^52.
static int64_t evaluate(const uint16_t size[2], const int32_t *b, int h, int w, int p, int q) {
    int64_t wu[4], wv[4], sum = 0;
    weigh(p, wu);
    weigh(q, wv);
    for (int a = 0; a < 4; a++) {
        for (int c = 0; c < 4; c++) {
            sum += wu[a] * wv[c] * b[clamp(h + a - 1, size[0]) * size[1] + clamp(w + c - 1, size[1])];
        }
    }
    return sum;
}

static int32_t any_coefficient(uint64_t *random) { return (int32_t)canopy_random_below(random, 1U << 29) - (1 << 28); }

// Exactly those coefficients are marked that change S somewhere in a covered cell, edges included.
static void check_marks(uint64_t seed, uint64_t *random, const struct mask *mask, const uint8_t *seen) {
    const int m = mask->size[0], n = mask->size[1];
    int32_t before[SIZE * SIZE], after[SIZE * SIZE];
    for (int k = 0; k < m * n; k++) {
        before[k] = any_coefficient(random);
        after[k] = canopy_bit_get(seen, (uint32_t)k) ? before[k] : any_coefficient(random);
    }
    for (int h = 0; h < m - 1; h++) {
        for (int w = 0; w < n - 1; w++) {
            for (int p = 0; p <= 8 && mask->cell[h][w]; p++) {
                for (int q = 0; q <= 8; q++) {
                    MUST(evaluate(mask->size, before, h, w, p, q) == evaluate(mask->size, after, h, w, p, q));
                }
            }
        }
    }
    const int one = (int)canopy_random_below(random, (uint32_t)(m * n));
    memset(before, 0, sizeof before);
    before[one] = 1;
    bool shapes = false;
    for (int h = 0; h < m - 1; h++) {
        for (int w = 0; w < n - 1; w++) {
            shapes = shapes || (mask->cell[h][w] && evaluate(mask->size, before, h, w, 4, 4) != 0);
        }
    }
    MUST(canopy_bit_get(seen, (uint32_t)one) == shapes);
}

static void check_free(uint64_t seed) {
    uint64_t random = seed;
    const struct mask mask = make_mask(&random);
    const uint32_t count = (uint32_t)mask.size[0] * mask.size[1];
    uint8_t seen[CANOPY_FREE_SEEN_BYTES(SIZE, SIZE)];
    canopy_free_see(mask.size, mask.coverage, seen);
    check_marks(seed, &random, &mask, seen);
    int32_t b[SIZE * SIZE], before[SIZE * SIZE], low = INT32_MAX, high = INT32_MIN;
    for (uint32_t k = 0; k < count; k++) {
        before[k] = b[k] = any_coefficient(&random);
        if (canopy_bit_get(seen, k)) {
            low = b[k] < low ? b[k] : low;
            high = b[k] > high ? b[k] : high;
        }
    }
    struct canopy_free work;
    const enum canopy_status status = canopy_free_begin(&work, mask.size, seen, b);
    MUST(status == (low <= high ? CANOPY_OK : CANOPY_EMPTY));
    for (int rule = 0; status == CANOPY_OK && rule < 3; rule++) {
        if (rule > 0) {
            (rule == 1 ? canopy_free_straighten : canopy_free_bend)(&work);
        }
        while (canopy_free_step(&work, 1 + canopy_random_below(&random, 9)) == CANOPY_MORE) {}
        for (uint32_t k = 0; k < count; k++) {
            MUST(canopy_bit_get(seen, k) ? b[k] == before[k] : b[k] >= low && b[k] <= high);
        }
    }
}

static void free_coefficients_are_those_no_covered_cell_depends_on(void **state) {
    (void)state;
    seeds_run(3000, check_free);
}

// ---- Free coefficients under a certificate

static struct canopy_field make_field(uint64_t seed, uint64_t *random, const struct mask *mask, void *arena,
                                      size_t bytes) {
    const uint16_t q = (uint16_t)(1 + canopy_random_below(random, CELLS_MOST));
    const struct canopy_grid grid = {{mask->size[0], mask->size[1]}, q, (uint8_t)canopy_random_below(random, 2)};
    const int32_t low[3] = {0, 0, 0}, high[3] = {12 * (mask->size[0] - 1), 12 * (mask->size[1] - 1), 100000};
    const uint16_t cells[2] = {q, q};
    struct canopy_frame frame;
    struct canopy_field field;
    MUST(canopy_frame_around_fx(&frame, &grid, low, high) == CANOPY_OK);
    MUST(canopy_field_init(&field, &frame, cells, arena, bytes) == CANOPY_OK);
    for (int h = 0; h < mask->size[0] - 1; h++) {
        for (int w = 0; w < mask->size[1] - 1; w++) {
            for (uint32_t k = canopy_random_below(random, 5); mask->cell[h][w] && k < 5; k++) {
                const int32_t point[1][3] = {{12 * h + 1 + (int32_t)canopy_random_below(random, 11),
                                              12 * w + 1 + (int32_t)canopy_random_below(random, 11),
                                              (int32_t)canopy_random_below(random, 100001)}};
                MUST(canopy_field_feed_fx(&field, point, 1) == 0);
            }
        }
    }
    return field;
}

static enum canopy_status certify(const struct canopy_field *field, int32_t *b, int32_t *margin) {
    uint64_t arena[(CANOPY_CERTIFY_ARENA(SIZE, CELLS_MOST, CELLS_MOST) + 7) / 8];
    struct canopy_certify certificate;
    enum canopy_status status = canopy_certify_init(&certificate, field, arena, sizeof arena);
    canopy_certify_begin(&certificate, b);
    while (status == CANOPY_OK && (status = canopy_certify_step(&certificate, UINT32_MAX)) == CANOPY_NOT_SAFE) {
        status = canopy_fast_raise(field, b, certificate.failed_cell, certificate.missing);
    }
    *margin = certificate.margin;
    return status;
}

static void check_certificate(uint64_t seed) {
    static uint64_t field_arena[(CANOPY_FIELD_ARENA(SIZE, SIZE, CELLS_MOST, CELLS_MOST) + 7) / 8];
    static uint64_t fast_arena[(CANOPY_FAST_ARENA(SIZE, SIZE, CELLS_MOST, CELLS_MOST) + 7) / 8];
    uint64_t random = seed;
    const struct mask mask = make_mask(&random);
    const struct canopy_field field = make_field(seed, &random, &mask, field_arena, sizeof field_arena);
    const uint16_t lines = canopy_random_chance(&random, 0.5) ? 1 : field.axis[0].cells;
    struct canopy_fast fast;
    int32_t b[SIZE * SIZE], changed[SIZE * SIZE], margin, margin_changed;
    MUST(canopy_fast_init(&fast, &field,
                          canopy_line_fit_of(canopy_random_chance(&random, 0.5) ? CANOPY_FX : CANOPY_F32), lines,
                          fast_arena, sizeof fast_arena) == CANOPY_OK);
    const enum canopy_status status = canopy_fast_begin(&fast, b);
    uint8_t coverage[CANOPY_COVERAGE_BYTES(SIZE, SIZE)], seen[CANOPY_FREE_SEEN_BYTES(SIZE, SIZE)];
    if (canopy_field_coverage(&field, coverage) == 0) {
        MUST(status == CANOPY_EMPTY);
        return;
    }
    while (canopy_fast_step(&fast, 1 + canopy_random_below(&random, 99)) == CANOPY_MORE) {}
    MUST(canopy_fast_step(&fast, 0) == CANOPY_OK);
    canopy_free_see(mask.size, coverage, seen);
    for (uint32_t k = 0; k < (uint32_t)mask.size[0] * mask.size[1]; k++) {
        changed[k] = canopy_bit_get(seen, k) ? b[k] : any_coefficient(&random);
    }
    MUST(certify(&field, b, &margin) == CANOPY_OK);
    MUST(certify(&field, changed, &margin_changed) == CANOPY_OK);
    MUST(margin == margin_changed);
    for (uint32_t k = 0; k < (uint32_t)mask.size[0] * mask.size[1]; k++) {
        MUST(!canopy_bit_get(seen, k) || b[k] == changed[k]);  // and what was mended, alike
    }
}

static void no_certificate_depends_on_a_free_coefficient(void **state) {
    (void)state;
    seeds_run(1500, check_certificate);
}

// ---- The trim

// Quarters of a cell, cut by both diagonals: 0 beside the low u edge, 1 high u, 2 low v, 3 high v.
static bool is_quarter_inside(const struct mask *mask, int h, int w, int quarter) {
    const bool low_u = covered(mask, h - 1, w), high_u = covered(mask, h + 1, w);
    const bool low_v = covered(mask, h, w - 1), high_v = covered(mask, h, w + 1);
    const bool is_cell = h >= 0 && w >= 0 && h < mask->size[0] - 1 && w < mask->size[1] - 1;
    if (covered(mask, h, w)) {
        return true;
    }
    if (!is_cell || low_u == high_u || low_v == high_v) {
        return false;
    }
    const bool sides[4] = {low_u, high_u, low_v, high_v};
    return sides[quarter];
}

// A polygon's steps from knot to knot: every one to a neighbour, no knot twice, no diagonal crossed by another, the
// direction changing at corners only. Marks the diagonals it takes.
static void check_polygon(uint64_t seed, const struct canopy_trim_outline *outline, uint32_t polygon,
                          bool diagonal[SIZE][SIZE]) {
    const struct canopy_trim_polygon *p = &outline->polygons[polygon];
    const struct canopy_trim_corner *corner = outline->corners + p->first;
    bool visited[SIZE][SIZE] = {{false}};
    int64_t area = 0;
    int last_du = 0, last_dv = 0;
    MUST(p->count >= 4);
    for (uint32_t k = 0; k < p->count + 1; k++) {
        const struct canopy_trim_corner from = corner[k % p->count], to = corner[(k + 1) % p->count];
        const int du = (to.u > from.u) - (to.u < from.u), dv = (to.v > from.v) - (to.v < from.v);
        MUST(du != 0 || dv != 0);
        MUST(k == 0 || du != last_du || dv != last_dv);
        last_du = du;
        last_dv = dv;
        if (k == p->count) {
            break;
        }
        area += (int64_t)from.u * to.v - (int64_t)to.u * from.v;
        for (int u = from.u, v = from.v; u != to.u || v != to.v; u += du, v += dv) {
            MUST(u >= 0 && v >= 0 && u < SIZE && v < SIZE && !visited[u][v]);
            visited[u][v] = true;
            if (du != 0 && dv != 0) {
                bool *crossed = &diagonal[du > 0 ? u : u - 1][dv > 0 ? v : v - 1];
                MUST(!*crossed);
                *crossed = true;
            }
        }
    }
    MUST(area == p->twice_area && area != 0);
}

// How often the polygons wind around a place in eighths of a knot interval that is on no edge: a ray towards high u.
static int winding(const struct canopy_trim_outline *outline, int u, int v) {
    int around = 0;
    for (uint32_t p = 0; p < outline->polygon_count; p++) {
        const struct canopy_trim_polygon *polygon = &outline->polygons[p];
        for (uint32_t k = 0; k < polygon->count; k++) {
            const struct canopy_trim_corner a = outline->corners[polygon->first + k];
            const struct canopy_trim_corner b = outline->corners[polygon->first + (k + 1) % polygon->count];
            const int au = 8 * a.u, av = 8 * a.v, bu = 8 * b.u, bv = 8 * b.v;
            const int side = (bu - au) * (v - av) - (bv - av) * (u - au);
            if (av <= v && bv > v && side > 0) {
                around++;
            } else if (bv <= v && av > v && side < 0) {
                around--;
            }
        }
    }
    return around;
}

enum { WIDE = SIZE + 1 };  // cells with a ring of outside around them

// Quarters by number, those of the ring included.
struct quarters {
    int rows, columns, count;
    int piece[WIDE * WIDE * 4];  // which piece of the inside it is of, from 1; 0: outside
    int pieces;
};

// Floods from one quarter along edges, as far as `from` is what it is there: `to` becomes `with`.
static void flood(const struct quarters *q, int start, const int *from, int *to, int with) {
    static int stack[WIDE * WIDE * 4 * 3 + 1];
    static const int across[4][2] = {{-1, 0}, {1, 0}, {0, -1}, {0, 1}};
    const int what = from[start];
    int top = 0;
    stack[top++] = start;
    while (top > 0) {
        const int at = stack[--top], quarter = at % 4, h = at / 4 / q->columns, w = at / 4 % q->columns;
        if (from[at] != what || to[at] == with) {
            continue;
        }
        to[at] = with;
        const int other = at - quarter + (quarter < 2 ? 2 : 0);
        stack[top++] = other;
        stack[top++] = other + 1;
        const int h2 = h + across[quarter][0], w2 = w + across[quarter][1];
        if (h2 >= 0 && w2 >= 0 && h2 < q->rows && w2 < q->columns) {
            stack[top++] = (h2 * q->columns + w2) * 4 + (quarter ^ 1);
        }
    }
}

// Pieces of the inside that hang together along edges.
static struct quarters find_pieces(const struct mask *mask) {
    struct quarters q = {.rows = mask->size[0] + 1, .columns = mask->size[1] + 1};
    int inside[WIDE * WIDE * 4];
    q.count = q.rows * q.columns * 4;
    for (int k = 0; k < q.count; k++) {
        inside[k] = is_quarter_inside(mask, k / 4 / q.columns - 1, k / 4 % q.columns - 1, k % 4);
    }
    for (int k = 0; k < q.count; k++) {
        if (inside[k] && q.piece[k] == 0) {
            flood(&q, k, inside, q.piece, ++q.pieces);
        }
    }
    return q;
}

// Gaps in one piece: what hangs together along edges without it, but for what reaches around it.
static int count_gaps(const struct quarters *q, int piece) {
    int is_piece[WIDE * WIDE * 4], done[WIDE * WIDE * 4] = {0}, parts = 0;
    for (int k = 0; k < q->count; k++) {
        is_piece[k] = q->piece[k] == piece;
    }
    for (int k = 0; k < q->count; k++) {
        if (!is_piece[k] && !done[k]) {
            flood(q, k, is_piece, done, 1);
            parts++;
        }
    }
    return parts - 1;
}

// At every eighth of a knot interval: inside or on an edge, as the quarters say.
static bool is_in_closed_quarters(const struct mask *mask, int u, int v) {
    for (int h = u / 8 - 1; h <= u / 8; h++) {
        for (int w = v / 8 - 1; w <= v / 8; w++) {
            const int p = u - 8 * h, q = v - 8 * w;
            if (h < 0 || w < 0 || p > 8 || q > 8) {
                continue;
            }
            const bool in[4] = {p <= q && p <= 8 - q, p >= q && p >= 8 - q, q <= p && q <= 8 - p, q >= p && q >= 8 - p};
            for (int quarter = 0; quarter < 4; quarter++) {
                if (in[quarter] && is_quarter_inside(mask, h, w, quarter)) {
                    return true;
                }
            }
        }
    }
    return false;
}

static void check_places(uint64_t seed, uint64_t *random, struct mask *mask,
                         const struct canopy_trim_outline *outline) {
    const uint32_t pu = 8 * (1 + canopy_random_below(random, 1 << 20)), pv = 8 * (1 + canopy_random_below(random, 9));
    const struct canopy_envelope envelope = {.frame = {.pitch = {pu, pv}, .size = {mask->size[0], mask->size[1]}},
                                             .coverage = mask->coverage};
    for (int u = 0; u <= 8 * (mask->size[0] - 1); u++) {
        for (int v = 0; v <= 8 * (mask->size[1] - 1); v++) {
            const bool holds = canopy_trim_holds(&envelope, (uint32_t)u * (pu / 8), (uint32_t)v * (pv / 8));
            MUST(holds == is_in_closed_quarters(mask, u, v));
            const int p = u % 8, q = v % 8;
            if (p != 0 && q != 0 && p != q && p + q != 8) {
                const int quarter = p < q ? (p + q < 8 ? 0 : 3) : (p + q < 8 ? 2 : 1);
                const bool in = is_quarter_inside(mask, u / 8, v / 8, quarter);
                MUST(in == holds);
                MUST(winding(outline, u, v) == (in ? 1 : 0));
            }
        }
    }
}

static void check_outline(uint64_t seed) {
    static uint64_t arena[(CANOPY_TRIM_ARENA(SIZE, SIZE, CANOPY_TRIM_CORNERS_MOST(SIZE, SIZE)) + 7) / 8];
    uint64_t random = seed;
    struct mask mask = make_mask(&random);
    struct canopy_trim_outline outline;
    int cells = 0, quarters = 0;
    for (int h = 0; h < mask.size[0] - 1; h++) {
        for (int w = 0; w < mask.size[1] - 1; w++) {
            cells += mask.cell[h][w];
            int here = 0;
            for (int quarter = 0; quarter < 4; quarter++) {
                here += is_quarter_inside(&mask, h, w, quarter);
            }
            const enum canopy_trim_shape shape = canopy_trim_shape(mask.size, mask.coverage, (uint32_t)h, (uint32_t)w);
            MUST(here == (shape == CANOPY_TRIM_NOTHING ? 0 : shape == CANOPY_TRIM_ALL ? 4 : 2));
            quarters += here;
        }
    }
    const uint32_t most = (uint32_t)CANOPY_TRIM_CORNERS_MOST(mask.size[0], mask.size[1]);
    const enum canopy_status status = canopy_trim_trace(&outline, mask.size, mask.coverage, most, arena, sizeof arena);
    MUST(status == (cells > 0 ? CANOPY_OK : CANOPY_EMPTY));
    if (cells == 0) {
        return;
    }
    bool diagonal[SIZE][SIZE] = {{false}};
    int64_t area = 0;
    int outer = 0, holes = 0;
    uint32_t corners = 0;
    for (uint32_t p = 0; p < outline.polygon_count; p++) {
        MUST(outline.polygons[p].first == corners);
        check_polygon(seed, &outline, p, diagonal);
        corners += outline.polygons[p].count;
        area += outline.polygons[p].twice_area;
        outer += outline.polygons[p].twice_area > 0;
        holes += outline.polygons[p].twice_area < 0;
    }
    MUST(corners == outline.corner_count);
    MUST(2 * area == quarters);
    const struct quarters q = find_pieces(&mask);
    int gaps = 0;
    for (int piece = 1; piece <= q.pieces; piece++) {
        gaps += count_gaps(&q, piece);
    }
    MUST(outer == q.pieces);
    MUST(holes == gaps);
    check_places(seed, &random, &mask, &outline);
    MUST(canopy_trim_trace(&outline, mask.size, mask.coverage, corners, arena,
                           CANOPY_TRIM_ARENA(mask.size[0], mask.size[1], corners)) == CANOPY_OK);
    MUST(canopy_trim_trace(&outline, mask.size, mask.coverage, corners - 1, arena, sizeof arena) == CANOPY_RANGE);
}

static void outlines_are_what_the_rule_says(void **state) {
    (void)state;
    seeds_run(1500, check_outline);
}

// The time a trace takes does not grow faster than the grid, whatever the mask: a checkerboard touches at every knot.
static void the_largest_grid_is_traced(void **state) {
    (void)state;
    const uint16_t size[2] = {CANOPY_SIZE_MAX, CANOPY_SIZE_MAX};
    const uint32_t corners = (uint32_t)CANOPY_TRIM_CORNERS_MOST(size[0], size[1]);
    const size_t bytes = CANOPY_TRIM_ARENA(size[0], size[1], corners);
    void *arena = malloc(bytes);
    uint8_t *coverage = calloc(CANOPY_COVERAGE_BYTES(size[0], size[1]), 1);
    assert_true(arena != NULL && coverage != NULL);
    for (int kind = 0; kind < 2; kind++) {
        uint64_t random = 5;
        uint32_t cells = 0;
        memset(coverage, 0, CANOPY_COVERAGE_BYTES(size[0], size[1]));
        for (uint32_t h = 0; h + 1 < size[0]; h++) {
            for (uint32_t w = 0; w + 1 < size[1]; w++) {
                if (kind == 0 ? (h + w) % 2 == 0 : canopy_random_chance(&random, 0.6)) {
                    cells += canopy_bit_set(coverage, h * (size[1] - 1U) + w);
                }
            }
        }
        struct canopy_trim_outline outline;
        assert_int_equal(canopy_trim_trace(&outline, size, coverage, corners, arena, bytes), CANOPY_OK);
        int64_t area = 0;
        for (uint32_t p = 0; p < outline.polygon_count; p++) {
            area += outline.polygons[p].twice_area;
        }
        for (uint32_t h = 0; h + 1 < size[0]; h++) {
            for (uint32_t w = 0; w + 1 < size[1]; w++) {
                area -= canopy_trim_shape(size, coverage, h, w) > CANOPY_TRIM_ALL;
            }
        }
        assert_int_equal(area, 2 * (int64_t)cells);
    }
    free(arena);
    free(coverage);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(free_coefficients_are_those_no_covered_cell_depends_on),
        cmocka_unit_test(no_certificate_depends_on_a_free_coefficient),
        cmocka_unit_test(outlines_are_what_the_rule_says),
        cmocka_unit_test(the_largest_grid_is_traced),
    };
    return cmocka_run_group_tests_name("trim properties", tests, NULL, NULL);
}
