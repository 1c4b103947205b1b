// What tightening says of itself, judged in rational arithmetic: whenever the bound rises, the dual numbers it stands
// on are read and the bound of the same program is computed from them without any rounding. Points and fields, both
// scalars, both sides, with and without another surface to stay above.
//
// CANOPY_CLOUDS sets how many clouds; a failure prints the seed, CANOPY_SEED=n runs that one alone.

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>
#include <gmp.h>

#include "lib/cover/certify.h"
#include "lib/cover/field.h"
#include "lib/cover/tighten.h"
#include "tools/common/random.h"

enum { GRID_MAX = 6, CELLS_MAX = 4, POINTS_MAX = 90, COUNT_MAX = GRID_MAX * GRID_MAX };

struct scene {
    uint64_t seed, random;
    bool from_field, f32, over;
    struct canopy_grid grid;
    size_t count;
    int32_t fx[POINTS_MAX][3];
    float points_f32[POINTS_MAX][3];
    struct canopy_frame frame;
    struct canopy_field field;
    struct canopy_certify certify;
    struct canopy_tighten tighten;
    int32_t b[COUNT_MAX], other[COUNT_MAX];
};

static CANOPY_ARENA_DECLARE(field_arena, CANOPY_FIELD_ARENA(GRID_MAX, GRID_MAX, CELLS_MAX, CELLS_MAX));
static CANOPY_ARENA_DECLARE(certify_arena, CANOPY_CERTIFY_ARENA(GRID_MAX, CELLS_MAX, CELLS_MAX));
#define ROWS_MAX CANOPY_TIGHTEN_ROWS(GRID_MAX, GRID_MAX)
static CANOPY_ARENA_DECLARE(arena,
                            CANOPY_TIGHTEN_ARENA(GRID_MAX, GRID_MAX, CELLS_MAX, CELLS_MAX, POINTS_MAX, ROWS_MAX));

// ---- Scenes

static double uniform(struct scene *s) { return canopy_random_unit(&s->random); }

// Whole coordinates, so that both scalars hold them exactly; none on the edge between two half-knot cells, to whose
// points it might count on either side.
static void make_points(struct scene *s) {
    const int32_t extent[2] = {1000 * (s->grid.size[0] - 1), 1000 * (s->grid.size[1] - 1)};
    const double cliff = uniform(s) < 0.5 ? 0.5 : 0, part = uniform(s) < 0.3 ? 0.4 : 1;
    for (size_t i = 0; i < s->count; i++) {
        for (int a = 0; a < 2; a++) {
            s->fx[i][a] = (int32_t)(part * uniform(s) * extent[a]);
            s->fx[i][a] += s->fx[i][a] % 500 == 0;
        }
        s->fx[i][2] = (int32_t)(4000 * (0.3 * uniform(s) + (s->fx[i][0] > s->fx[i][1] ? cliff : 0)));
        for (int a = 0; a < 3; a++) {
            s->points_f32[i][a] = (float)s->fx[i][a];
        }
    }
}

static void make_frame(struct scene *s) {
    const int32_t low[3] = {0, 0, 0}, high[3] = {1000 * (s->grid.size[0] - 1), 1000 * (s->grid.size[1] - 1), 4000};
    const float low_f32[3] = {0, 0, 0}, high_f32[3] = {(float)high[0], (float)high[1], 4000};
    assert_int_equal(s->f32 ? canopy_frame_around_f32(&s->frame, &s->grid, low_f32, high_f32)
                            : canopy_frame_around_fx(&s->frame, &s->grid, low, high),
                     CANOPY_OK);
}

static void take(struct scene *s) {
    const uint16_t cells[2] = {s->grid.cells, s->grid.cells}, m = s->grid.size[0], n = s->grid.size[1];
    const struct canopy_tighten_size size = {POINTS_MAX, {cells[0], cells[1]}, CANOPY_TIGHTEN_ROWS(m, n)};
    struct canopy_tighten *t = &s->tighten;
    assert_int_equal(canopy_field_init(&s->field, &s->frame, cells, field_arena, sizeof field_arena), CANOPY_OK);
    assert_int_equal(s->f32 ? canopy_field_feed_f32(&s->field, (const float(*)[3])s->points_f32, s->count)
                            : canopy_field_feed_fx(&s->field, (const int32_t(*)[3])s->fx, s->count),
                     0);
    assert_int_equal(canopy_certify_init(&s->certify, &s->field, certify_arena, sizeof certify_arena), CANOPY_OK);
    assert_int_equal(canopy_tighten_init(t, &s->frame, &size, arena, sizeof arena), CANOPY_OK);
    assert_int_equal(s->from_field ? canopy_tighten_field(t, &s->field, &s->certify)
                     : s->f32      ? canopy_tighten_points_f32(t, (const float(*)[3])s->points_f32, s->count)
                                   : canopy_tighten_points_fx(t, (const int32_t(*)[3])s->fx, s->count),
                     CANOPY_OK);
    for (size_t j = 0; j < (size_t)m * n; j++) {
        s->b[j] = t->low;
        s->other[j] = t->low + (int32_t)((uniform(s) - 0.5) * (double)t->range);
    }
    if (s->over) {
        assert_int_equal(canopy_tighten_over(t, s->other), CANOPY_OK);
    }
    assert_int_equal(canopy_tighten_begin(t, s->b, false), CANOPY_OK);
}

static void make_scene(struct scene *s, uint64_t seed) {
    *s = (struct scene){.seed = seed, .random = seed};
    s->from_field = canopy_random_chance(&s->random, 0.5);
    s->f32 = canopy_random_chance(&s->random, 0.5);
    s->over = canopy_random_chance(&s->random, 0.25);
    s->grid = (struct canopy_grid){{(uint16_t)(4 + canopy_random_below(&s->random, GRID_MAX - 3)),
                                    (uint16_t)(4 + canopy_random_below(&s->random, GRID_MAX - 3))},
                                   (uint16_t)(1 + canopy_random_below(&s->random, CELLS_MAX)),
                                   (uint8_t)canopy_random_below(&s->random, 2)};
    s->count = 10 + canopy_random_below(&s->random, POINTS_MAX - 9);
    make_points(s);
    make_frame(s);
    take(s);
}

// ---- The program, in rational numbers. Everything is initialised once and kept.

static mpq_t one, cost[COUNT_MAX], share[COUNT_MAX], heights, value, term[4], weight_u[4], weight_v[4];

static void set_up(void) {
    mpq_init(one);
    mpq_set_ui(one, 1, 1);
    mpq_inits(heights, value, NULL);
    for (int k = 0; k < 4; k++) {
        mpq_inits(term[k], weight_u[k], weight_v[k], NULL);
    }
    for (int j = 0; j < COUNT_MAX; j++) {
        mpq_inits(cost[j], share[j], NULL);
    }
}

static void set_ratio(mpq_t to, long p, unsigned long q) {
    mpq_set_si(to, p, q);
    mpq_canonicalize(to);
}

// The weights of b[h-1] … b[h+2] in the polar form of a uniform cubic B-spline at a, b, c: products of differences by
// the recursion of de Boor, which the library does not use. Knots: h-2 … h+3, here -2 … 3.
static void polar(const mpq_t at[3], mpq_t w[4]) {
    mpq_t d[4][4], left, right;  // d[i]: coefficient i as a combination of the four
    mpq_inits(left, right, NULL);
    for (int i = 0; i < 4; i++) {
        for (int k = 0; k < 4; k++) {
            mpq_init(d[i][k]);
            mpq_set_ui(d[i][k], i == k, 1);
        }
    }
    for (int level = 0; level < 3; level++) {
        for (int i = 3; i > level; i--) {
            const int from = i - 3, to = i - level;  // the knots that its support in this level begins and ends with
            set_ratio(left, from, 1);
            mpq_sub(left, at[level], left);
            set_ratio(right, 1, (unsigned long)(to - from));
            mpq_mul(left, left, right);  // the part of the upper one
            mpq_sub(right, one, left);
            for (int k = 0; k < 4; k++) {
                mpq_mul(term[0], left, d[i][k]);
                mpq_mul(term[1], right, d[i - 1][k]);
                mpq_add(d[i][k], term[0], term[1]);
            }
        }
    }
    for (int k = 0; k < 4; k++) {
        mpq_set(w[k], d[3][k]);
        for (int i = 0; i < 4; i++) {
            mpq_clear(d[i][k]);
        }
    }
    mpq_clears(left, right, NULL);
}

// The same at one place, or at the p-th Bernstein coefficient of q parts of the interval.
static void weights_at(const mpq_t s, mpq_t w[4]) {
    mpq_t at[3];
    for (int k = 0; k < 3; k++) {
        mpq_init(at[k]);
        mpq_set(at[k], s);
    }
    polar((const mpq_t *)at, w);
    mpq_clears(at[0], at[1], at[2], NULL);
}

static void weights_of(unsigned p, unsigned q, mpq_t w[4]) {
    mpq_t at[3];
    for (unsigned k = 0; k < 3; k++) {
        mpq_init(at[k]);
        set_ratio(at[k], (long)(p / 3 + (p % 3 > k)), q);
    }
    polar((const mpq_t *)at, w);
    mpq_clears(at[0], at[1], at[2], NULL);
}

// Adds factor * weights of a cell to a vector over the coefficients.
static void add_weights(const struct scene *s, uint32_t cell, const mpq_t factor, mpq_t *to) {
    const int m = s->grid.size[0], n = s->grid.size[1], h = (int)cell / (n - 1), w = (int)cell % (n - 1);
    for (int a = 0; a < 16; a++) {
        const int i = h + a / 4 - 1, j = w + a % 4 - 1;
        mpq_mul(term[0], weight_u[a / 4], weight_v[a % 4]);
        mpq_mul(term[0], term[0], factor);
        const int index = (i < 0 ? 0 : i < m ? i : m - 1) * n + (j < 0 ? 0 : j < n ? j : n - 1);
        mpq_add(to[index], to[index], term[0]);
    }
}

// A point's knot interval and place in it along an axis.
static uint32_t place_of(const struct scene *s, size_t i, int axis, mpq_t place) {
    const uint32_t pitch = s->frame.pitch[axis], last = s->grid.size[axis] - 2U;
    const double offset = ldexp((double)s->fx[i][axis], -s->frame.quantum_log2) - s->frame.origin[axis];  // whole
    const uint32_t whole = (uint32_t)(offset / pitch), h = whole < last ? whole : last;
    mpq_set_d(place, offset - (double)h * pitch);
    set_ratio(term[3], 1, pitch);
    mpq_mul(place, place, term[3]);
    return h;
}

// Steps in the library's orientation; not whole where a step is coarser than a quantum.
static double height_of(const struct scene *s, size_t i) {
    const double quanta = ldexp((double)s->fx[i][2], -s->frame.quantum_log2) - s->frame.origin[2];
    return ldexp(s->frame.side == CANOPY_BELOW ? -quanta : quanta, -s->frame.lsb_log2);
}

static uint32_t cell_of(const struct scene *s, size_t i, mpq_t u, mpq_t v) {
    const uint32_t h = place_of(s, i, 0, u);
    return h * (s->grid.size[1] - 1U) + place_of(s, i, 1, v);
}

static void cost_of_points(const struct scene *s) {
    mpq_t u, v;
    mpq_inits(u, v, NULL);
    for (size_t i = 0; i < s->count; i++) {
        const uint32_t cell = cell_of(s, i, u, v);
        weights_at(u, weight_u);
        weights_at(v, weight_v);
        add_weights(s, cell, one, cost);
        mpq_set_d(value, height_of(s, i));
        mpq_add(heights, heights, value);
    }
    mpq_clears(u, v, NULL);
}

// The mean weights over the k-th of q parts: a cubic's mean is the mean of its Bernstein coefficients.
static void mean_weights(unsigned k, unsigned q, mpq_t w[4]) {
    mpq_t quarter, sum[4];
    mpq_init(quarter);
    set_ratio(quarter, 1, 4);
    for (int a = 0; a < 4; a++) {
        mpq_init(sum[a]);
    }
    for (unsigned p = 3 * k; p <= 3 * k + 3; p++) {
        weights_of(p, q, w);
        for (int a = 0; a < 4; a++) {
            mpq_add(sum[a], sum[a], w[a]);
        }
    }
    for (int a = 0; a < 4; a++) {
        mpq_mul(w[a], sum[a], quarter);
        mpq_clear(sum[a]);
    }
    mpq_clear(quarter);
}

static size_t cost_of_field(const struct scene *s) {
    const uint32_t q = s->grid.cells, columns = s->field.axis[1].count, across = s->grid.size[1] - 1U;
    size_t covered = 0;
    for (uint32_t k = 0; k < s->field.axis[0].count; k++) {
        for (uint32_t l = 0; l < columns; l++) {
            const int32_t height = s->field.heights[k * columns + l];
            if (height != CANOPY_NO_HEIGHT) {
                covered++;
                mean_weights(k % q, q, weight_u);
                mean_weights(l % q, q, weight_v);
                add_weights(s, k / q * across + l / q, one, cost);
                mpq_set_si(value, height, 1);
                mpq_add(heights, heights, value);
            }
        }
    }
    return covered;
}

static void find_cost(const struct scene *s) {
    for (int j = 0; j < COUNT_MAX; j++) {
        mpq_set_ui(cost[j], 0, 1);
    }
    mpq_set_ui(heights, 0, 1);
    if (!s->from_field) {
        cost_of_points(s);
    }
    const size_t count = s->from_field ? cost_of_field(s) : s->count;
    set_ratio(term[2], 1, count);
    for (int j = 0; j < COUNT_MAX; j++) {
        mpq_mul(cost[j], cost[j], term[2]);
    }
    mpq_mul(heights, heights, term[2]);
}

// ---- Rows in use

// The highest point of the cell at that place.
static double point_at(const struct scene *s, uint32_t cell, float at_u, float at_v) {
    double highest = -HUGE_VAL;
    mpq_t u, v;
    mpq_inits(u, v, NULL);
    for (size_t i = 0; i < s->count; i++) {
        const uint32_t mine = cell_of(s, i, u, v);
        if (mine == cell && fabs(mpq_get_d(u) - (double)at_u) < 1e-6 && fabs(mpq_get_d(v) - (double)at_v) < 1e-6 &&
            height_of(s, i) > highest) {
            highest = height_of(s, i);
            weights_at(u, weight_u);
            weights_at(v, weight_v);
        }
    }
    mpq_clears(u, v, NULL);
    return highest;
}

// The lowest point, or the lowest field cell that reaches into, a half-knot cell: hu and hv count along the axes.
static double low_of_half(const struct scene *s, uint32_t hu, uint32_t hv) {
    double lowest = HUGE_VAL;
    const uint32_t q = s->grid.cells, columns = s->field.axis[1].count;
    mpq_t u, v;
    mpq_inits(u, v, NULL);
    for (size_t i = 0; !s->from_field && i < s->count; i++) {
        const uint32_t h = place_of(s, i, 0, u), w = place_of(s, i, 1, v);
        if (2 * h + (mpq_get_d(u) >= 0.5) == hu && 2 * w + (mpq_get_d(v) >= 0.5) == hv) {
            lowest = fmin(lowest, height_of(s, i));
        }
    }
    for (uint32_t c = 0; s->from_field && c < s->field.axis[0].count * columns; c++) {
        const uint32_t k = c / columns, l = c % columns;
        if (s->field.heights[c] != CANOPY_NO_HEIGHT && 2 * k < (hu + 1) * q && 2 * (k + 1) > hu * q &&
            2 * l < (hv + 1) * q && 2 * (l + 1) > hv * q) {
            lowest = fmin(lowest, s->field.heights[c]);
        }
    }
    mpq_clears(u, v, NULL);
    return lowest;
}

// The highest of the bounds of a Bernstein coefficient (p, q) of half-knot cells.
static double pit_at(const struct scene *s, uint32_t cell, unsigned p, unsigned q) {
    const uint32_t across = s->grid.size[1] - 1U;
    double bound = -HUGE_VAL;
    for (uint32_t i = p > 3; i <= (p >= 3); i++) {
        for (uint32_t j = q > 3; j <= (q >= 3); j++) {
            const double low = low_of_half(s, 2 * (cell / across) + i, 2 * (cell % across) + j);
            bound = low < HUGE_VAL ? fmax(bound, low) : bound;
        }
    }
    return bound;
}

// The highest of the field cells around a Bernstein coefficient, within its knot cell.
static double node_at(const struct scene *s, uint32_t cell, unsigned p, unsigned q) {
    const uint32_t cells = s->grid.cells, columns = s->field.axis[1].count, across = s->grid.size[1] - 1U;
    double bound = -HUGE_VAL;
    for (uint32_t i = 0; i < cells; i++) {
        for (uint32_t j = 0; j < cells; j++) {
            const int32_t height = s->field.heights[(cell / across * cells + i) * columns + cell % across * cells + j];
            if (height != CANOPY_NO_HEIGHT && p >= 3 * i && p <= 3 * i + 3 && q >= 3 * j && q <= 3 * j + 3) {
                bound = fmax(bound, height);
            }
        }
    }
    return bound;
}

// The other surface's coefficient at the weights that are set.
static double other_at(const struct scene *s, uint32_t cell) {
    static mpq_t at[COUNT_MAX];
    static bool made;
    double sum = 0;
    for (int j = 0; j < COUNT_MAX; j++) {
        if (!made) {
            mpq_init(at[j]);
        }
        mpq_set_ui(at[j], 0, 1);
    }
    made = true;
    add_weights(s, cell, one, at);
    for (int j = 0; j < s->grid.size[0] * s->grid.size[1]; j++) {
        sum += mpq_get_d(at[j]) * s->other[j];
    }
    return sum;
}

// Sets the row's weights and returns its bound in steps. Bounds here are true to a step or less.
static double row_at(const struct scene *s, const struct canopy_tighten_rows *rows, uint32_t l) {
    if (rows->s[l] >= 0) {
        return point_at(s, rows->cell[l], rows->s[l], rows->t[l]);
    }
    const unsigned p = (unsigned)(-1.0f - rows->s[l]), q = (unsigned)(-1.0f - rows->t[l]);
    if (p < 7) {
        weights_of(p, 2, weight_u);
        weights_of(q, 2, weight_v);
        return fmax(pit_at(s, rows->cell[l], p, q), s->over ? other_at(s, rows->cell[l]) : -HUGE_VAL);
    }
    weights_of(p - 7, s->grid.cells, weight_u);
    weights_of(q - 7, s->grid.cells, weight_v);
    return node_at(s, rows->cell[l], p - 7, q - 7);
}

// The bound that the duals prove, in steps: sum of y b + sum over j of min(-r_j, 2 r_j) in the unit of the program, r
// the costs less A'y, less the mean height.
static double prove(const struct scene *s) {
    const struct canopy_tighten *t = &s->tighten;
    mpq_t sum, unit;
    mpq_inits(sum, unit, NULL);
    for (int j = 0; j < COUNT_MAX; j++) {
        mpq_set(share[j], cost[j]);
    }
    for (uint32_t k = 0; k < t->row_count; k++) {
        const struct canopy_tighten_rows *rows = &t->rows[k / CANOPY_TIGHTEN_LANES];
        const uint32_t l = k % CANOPY_TIGHTEN_LANES;
        const double bound = row_at(s, rows, l), dual = (double)rows->dual[l];
        if (!(bound > -HUGE_VAL && dual >= 0)) {
            fail_msg("seed %llu: row %u of no constraint, or of dual %g", (unsigned long long)s->seed, k, dual);
        }
        mpq_set_d(value, dual);
        mpq_set_d(term[1], bound - t->low);
        mpq_mul(term[1], term[1], value);
        mpq_add(sum, sum, term[1]);
        mpq_neg(value, value);
        add_weights(s, rows->cell[l], value, share);
    }
    mpq_set_d(unit, (double)t->range);
    for (int j = 0; j < COUNT_MAX; j++) {
        mpq_set_si(value, mpq_sgn(share[j]) >= 0 ? -1 : 2, 1);
        mpq_mul(value, value, unit);
        mpq_mul(value, value, share[j]);
        mpq_add(sum, sum, value);
    }
    mpq_sub(sum, sum, heights);
    mpq_set_si(value, t->low, 1);
    mpq_add(sum, sum, value);
    const double proved = mpq_get_d(sum);
    mpq_clears(sum, unit, NULL);
    return proved;
}

// ---- The test

static uint32_t judged;
static double worst_lost;

// Heights are rounded up by at most 3 steps on the way in.
static void check_scene(uint64_t seed) {
    static struct scene s;
    make_scene(&s, seed);
    find_cost(&s);
    struct canopy_tighten *t = &s.tighten;
    float bound = t->bound;
    enum canopy_status status = CANOPY_MORE;
    while (status == CANOPY_MORE) {
        status = canopy_tighten_step(t, 1);
        if (t->bound > bound) {
            const double proved = prove(&s);
            bound = t->bound;
            judged++;
            worst_lost = fmax(worst_lost, (proved - (double)bound) / (double)t->range);
            if ((double)bound > proved + 4) {
                fail_msg("seed %llu, %s, %s, side %d, %ux%u, Q %u%s: a bound of %g, proved %g, range %g",
                         (unsigned long long)seed, s.from_field ? "field" : "points", s.f32 ? "f32" : "fx", s.grid.side,
                         s.grid.size[0], s.grid.size[1], s.grid.cells, s.over ? ", over" : "", (double)bound, proved,
                         (double)t->range);
            }
        }
    }
    assert_int_equal(status, CANOPY_OK);
}

static uint64_t number_from(const char *name, uint64_t otherwise) {
    const char *text = getenv(name);
    return text != NULL ? strtoull(text, NULL, 10) : otherwise;
}

static void the_bound_is_what_its_duals_prove(void **state) {
    (void)state;
    const uint64_t only = number_from("CANOPY_SEED", 0), clouds = number_from("CANOPY_CLOUDS", 40);
    set_up();
    if (only != 0) {
        check_scene(only);
        return;
    }
    for (uint64_t seed = 1; seed <= clouds; seed++) {
#ifdef __clang__
        check_scene(seed + 1000000000);  // the two compilers' programs try different clouds
#else
        check_scene(seed);
#endif
    }
    assert_true(judged > 2 * clouds);
    assert_true(worst_lost < 2e-3);  // of the height range: what is taken off for rounding is no excuse
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(the_bound_is_what_its_duals_prove)};
    return cmocka_run_group_tests_name("tighten bound", tests, NULL, NULL);
}
