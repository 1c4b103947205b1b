// The questions of lib/cover/query* against references that share nothing with them: the surface as the sum of
// piecewise cubics of |x| over all coefficients, in rational numbers of GMP, and dense sampling of the same in double,
// whose largest finds are then judged in rational numbers.

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>
#include <gmp.h>

#include "hosttest/seeds.h"
#include "lib/cover/certify.h"
#include "lib/cover/fast.h"
#include "lib/cover/query.h"
#include "lib/cover/query_extreme.h"
#include "lib/cover/query_regrid.h"
#include "lib/cover/query_volume.h"
#include "tools/common/random.h"

enum { SIZE_MAX_HERE = 9, GRID = SIZE_MAX_HERE * SIZE_MAX_HERE, LIMIT = 1 << 28 };

static uint64_t seed_now;

static void require(bool condition, int line, const char *what) {
    if (!condition) {
        fail_msg("line %d: seed %llu: %s", line, (unsigned long long)seed_now, what);
    }
}

#define REQUIRE(condition) require((condition), __LINE__, #condition)

// ---- Scenes

struct scene {
    uint64_t random;
    struct canopy_envelope envelope[2];
    int32_t coefficients[2][GRID];
    uint8_t coverage[2][GRID / 8 + 1];
    struct canopy_query_plane plane;
    struct canopy_query_subject subject;
    struct canopy_query_rect rect;
};

static uint32_t below(struct scene *s, uint32_t limit) { return canopy_random_below(&s->random, limit); }

static int32_t wide(struct scene *s, int32_t size) {
    return (int32_t)(canopy_random_unit(&s->random) * (2.0 * size + 1.0)) - size;
}

// Plateaus, spikes, ramps, checkerboards, noise of all sizes up to the limit of coefficients, smooth hills.
static int32_t height(struct scene *s, uint32_t kind, int32_t size, uint32_t i, uint32_t j) {
    switch (kind) {
    case 0: return size;
    case 1: return below(s, 12) == 0 ? size : 0;
    case 2: return (int32_t)((i * 3 + j) * 1000);
    case 3: return (i + j) % 2 == 0 ? size : -size;
    case 4: return (int32_t)(size * sin(0.9 * i) * cos(0.7 * j + 1));
    case 5: return i < 4 ? size : -size;
    default: return wide(s, size);
    }
}

static void make_surface(struct scene *s, int which) {
    static const int32_t sizes[] = {LIMIT, 1 << 24, 1 << 24, 1000, 3};
    struct canopy_envelope *envelope = &s->envelope[which];
    envelope->frame = s->envelope[0].frame;
    envelope->coefficients = s->coefficients[which];
    envelope->coverage = s->coverage[which];
    const uint32_t kind = below(s, 9), m = envelope->frame.size[0], n = envelope->frame.size[1];
    const int32_t size = sizes[below(s, 5)];
    for (uint32_t i = 0; i < m * n; i++) {
        envelope->coefficients[i] = height(s, kind, size, i / n, i % n);
    }
    const uint32_t rare = below(s, 3);
    for (size_t i = 0; i < sizeof s->coverage[which]; i++) {
        s->coverage[which][i] = (uint8_t)(rare == 0 ? 255 : below(s, 256) & (rare == 1 ? 255 : below(s, 256)));
    }
}

static uint32_t edge(struct scene *s, uint32_t pitch, uint32_t intervals) {
    switch (below(s, 4)) {
    case 0: return below(s, intervals + 1) * pitch;  // on a knot line
    case 1: return intervals * pitch - (below(s, 2) == 0 ? 0 : 1);
    default: return (uint32_t)(canopy_random_unit(&s->random) * intervals * pitch);
    }
}

static struct canopy_query_rect make_rect(struct scene *s) {
    const struct canopy_frame *frame = &s->envelope[0].frame;
    struct canopy_query_rect rect = canopy_query_whole(frame);
    const uint32_t kind = below(s, 4);
    for (int axis = 0; axis < 2 && kind != 0; axis++) {
        const uint32_t intervals = frame->size[axis] - 1U, pitch = frame->pitch[axis];
        const uint32_t a = edge(s, pitch, intervals), b = edge(s, pitch, intervals);
        rect.low[axis] = a < b ? a : b;
        rect.high[axis] = a < b ? b : a;
        if (kind == 1 && rect.low[axis] < intervals * pitch) {
            rect.high[axis] = rect.low[axis] + below(s, 2);  // a quantum or nothing
        }
    }
    return rect;
}

static void make_plane(struct scene *s) {
    const struct canopy_frame *frame = &s->envelope[0].frame;
    const double one = (double)CANOPY_QUERY_PLANE_ONE;
    s->plane.at_origin = (int64_t)(wide(s, LIMIT / 4) * one + below(s, 65536));
    for (int axis = 0; axis < 2; axis++) {
        s->plane.rise[axis] = (int64_t)(wide(s, LIMIT / 4) * one / frame->size[axis]);
    }
}

// `finest`: the largest pitch, as a power of two.
static void make_scene(struct scene *s, uint64_t seed, unsigned finest) {
    seed_now = seed;
    *s = (struct scene){.random = seed};
    struct canopy_frame *frame = &s->envelope[0].frame;
    for (int axis = 0; axis < 2; axis++) {
        frame->size[axis] = (uint16_t)(4 + below(s, SIZE_MAX_HERE - 3));
        frame->pitch[axis] = 1 + below(s, (1U << (1 + below(s, finest))) - 1U);
        frame->axis[axis][axis] = CANOPY_AXIS_ONE;
    }
    frame->axis[2][2] = CANOPY_AXIS_ONE;
    frame->cells = 1;
    frame->side = (uint8_t)below(s, 2);
    make_surface(s, 0);
    make_surface(s, 1);
    make_plane(s);
    s->rect = make_rect(s);
    const uint32_t kind = below(s, 4);
    s->subject = (struct canopy_query_subject){.surface = &s->envelope[0],
                                               .minus = kind == 1 || kind == 3 ? &s->envelope[1] : NULL,
                                               .plane = kind >= 2 ? &s->plane : NULL,
                                               .covered = below(s, 3) == 0};
}

// ---- The reference in double, for finding

static double spline(double x) {
    x = fabs(x);
    return x >= 2 ? 0 : x >= 1 ? (2 - x) * (2 - x) * (2 - x) / 6 : (4 - 6 * x * x + 3 * x * x * x) / 6;
}

static double sampled(const struct canopy_query_subject *subject, double u, double v) {
    const struct canopy_envelope *e = subject->surface;
    const int m = e->frame.size[0], n = e->frame.size[1];
    double sum = 0;
    for (int i = -1; i <= m; i++) {
        const double w = spline(u - i);
        for (int j = -1; w != 0 && j <= n; j++) {
            const int at = (i < 0 ? 0 : i < m ? i : m - 1) * n + (j < 0 ? 0 : j < n ? j : n - 1);
            const int32_t other = subject->minus != NULL ? subject->minus->coefficients[at] : 0;
            sum += w * spline(v - j) * ((double)e->coefficients[at] - other);
        }
    }
    if (subject->plane != NULL) {
        sum -= ((double)subject->plane->at_origin + u * (double)subject->plane->rise[0] +
                v * (double)subject->plane->rise[1]) /
               (double)CANOPY_QUERY_PLANE_ONE;
    }
    return sum;
}

// ---- The reference in rational numbers

static void rational_spline(mpq_t to, const mpq_t x) {
    mpq_t a, t, c;
    mpq_inits(a, t, c, NULL);
    mpq_abs(a, x);
    mpq_set_ui(to, 0, 1);
    if (mpq_cmp_ui(a, 1, 1) < 0) {
        mpq_mul(t, a, a);
        mpq_set_ui(c, 6, 1);
        mpq_mul(c, c, t);
        mpq_mul(t, t, a);
        mpq_set_ui(to, 3, 1);
        mpq_mul(to, to, t);
        mpq_sub(to, to, c);
        mpq_set_ui(t, 4, 1);
        mpq_add(to, to, t);
    } else if (mpq_cmp_ui(a, 2, 1) < 0) {
        mpq_set_ui(t, 2, 1);
        mpq_sub(t, t, a);
        mpq_mul(to, t, t);
        mpq_mul(to, to, t);
    }
    mpq_set_ui(c, 6, 1);
    mpq_div(to, to, c);
    mpq_clears(a, t, c, NULL);
}

// The plane at a place, in steps.
static void rational_plane(mpq_t to, const struct canopy_query_plane *plane, const mpq_t u, const mpq_t v) {
    mpq_t x;
    mpq_init(x);
    mpq_set_si(to, plane->at_origin, 1);
    mpq_set_si(x, plane->rise[0], 1);
    mpq_mul(x, x, u);
    mpq_add(to, to, x);
    mpq_set_si(x, plane->rise[1], 1);
    mpq_mul(x, x, v);
    mpq_add(to, to, x);
    mpq_set_si(x, CANOPY_QUERY_PLANE_ONE, 1);
    mpq_div(to, to, x);
    mpq_clear(x);
}

// sum over i, j of wu[i] wv[j] b[i][j], indices from -1, the edges repeated.
static void rational_sum(mpq_t to, const struct canopy_query_subject *subject, mpq_t *wu, mpq_t *wv) {
    const struct canopy_envelope *e = subject->surface;
    const int m = e->frame.size[0], n = e->frame.size[1];
    mpq_t row, x;
    mpq_inits(row, x, NULL);
    mpq_set_ui(to, 0, 1);
    for (int i = -1; i <= m; i++) {
        mpq_set_ui(row, 0, 1);
        for (int j = -1; mpq_sgn(wu[i + 1]) != 0 && j <= n; j++) {
            const int at = (i < 0 ? 0 : i < m ? i : m - 1) * n + (j < 0 ? 0 : j < n ? j : n - 1);
            const int32_t other = subject->minus != NULL ? subject->minus->coefficients[at] : 0;
            mpq_set_si(x, (long)e->coefficients[at] - other, 1);
            mpq_mul(x, x, wv[j + 1]);
            mpq_add(row, row, x);
        }
        mpq_mul(row, row, wu[i + 1]);
        mpq_add(to, to, row);
    }
    mpq_clears(row, x, NULL);
}

static mpq_t weights[2][SIZE_MAX_HERE * 4 + 4];

static void rational_at(mpq_t to, const struct canopy_query_subject *subject, const mpq_t u, const mpq_t v) {
    mpq_t x;
    mpq_init(x);
    for (int axis = 0; axis < 2; axis++) {
        for (int i = -1; i <= subject->surface->frame.size[axis]; i++) {
            mpq_set_si(x, i, 1);
            mpq_sub(x, axis == 0 ? u : v, x);
            rational_spline(weights[axis][i + 1], x);
        }
    }
    rational_sum(to, subject, weights[0], weights[1]);
    if (subject->plane != NULL) {
        rational_plane(x, subject->plane, u, v);
        mpq_sub(to, to, x);
    }
    mpq_clear(x);
}

// The sign of subject(u, v) - steps, u and v as numerator over pitch * parts.
static int compare_at(const struct canopy_query_subject *subject, const uint64_t at[2], uint32_t parts, int32_t steps) {
    mpq_t u, v, s;
    mpq_inits(u, v, s, NULL);
    mpq_set_ui(u, at[0], (unsigned long)subject->surface->frame.pitch[0] * parts);
    mpq_set_ui(v, at[1], (unsigned long)subject->surface->frame.pitch[1] * parts);
    mpq_canonicalize(u);
    mpq_canonicalize(v);
    rational_at(s, subject, u, v);
    const int sign = mpq_cmp_si(s, steps, 1);
    mpq_clears(u, v, s, NULL);
    return sign;
}

// ---- The extremes

enum { PARTS = 24 };

// The best of a lattice over the window, and where, in quanta / PARTS. False: nothing of it counts.
static bool sample(const struct canopy_query_subject *subject, const struct canopy_query_rect *rect, int sign,
                   double *best, uint64_t at[2]) {
    const struct canopy_frame *frame = &subject->surface->frame;
    bool any = false;
    for (uint64_t p = 0; p <= PARTS; p++) {
        for (uint64_t q = 0; q <= PARTS; q++) {
            const uint64_t x = rect->low[0] * (uint64_t)PARTS + (rect->high[0] - rect->low[0]) * p;
            const uint64_t y = rect->low[1] * (uint64_t)PARTS + (rect->high[1] - rect->low[1]) * q;
            uint64_t row = x / PARTS / frame->pitch[0], column = y / PARTS / frame->pitch[1];
            row = row < frame->size[0] - 1U ? row : frame->size[0] - 2U;
            column = column < frame->size[1] - 1U ? column : frame->size[1] - 2U;
            if (!canopy_query_counts(subject, (uint32_t)row, (uint32_t)column)) {
                continue;
            }
            // A lattice point on a knot belongs to the cell before it as well; only the cell behind it is asked here.
            // Where that is not in the window, the point is one of the window's far edge.
            if ((x == row * PARTS * frame->pitch[0] && p == PARTS && p > 0 && rect->low[0] < rect->high[0]) ||
                (y == column * PARTS * frame->pitch[1] && q == PARTS && rect->low[1] < rect->high[1])) {
                continue;
            }
            const double here =
                sign * sampled(subject, (double)x / PARTS / frame->pitch[0], (double)y / PARTS / frame->pitch[1]);
            if (!any || here > *best) {
                *best = here;
                at[0] = x;
                at[1] = y;
                any = true;
            }
        }
    }
    return any;
}

// The steepest that the subject can be, in steps a quantum, for what a rounded place is worth.
static double steepest(const struct canopy_query_subject *subject) {
    const struct canopy_envelope *e = subject->surface;
    const uint32_t m = e->frame.size[0], n = e->frame.size[1];
    double most[2] = {0, 0};
    for (uint32_t i = 0; i < m * n; i++) {
        for (int axis = 0; axis < 2; axis++) {
            const uint32_t next = i + (axis == 0 ? n : 1);
            if (axis == 0 ? next >= m * n : next % n == 0) {
                continue;
            }
            double rise = (double)e->coefficients[next] - e->coefficients[i];
            if (subject->minus != NULL) {
                rise -= (double)subject->minus->coefficients[next] - subject->minus->coefficients[i];
            }
            most[axis] = fmax(most[axis], fabs(rise));
        }
    }
    for (int axis = 0; axis < 2; axis++) {
        most[axis] +=
            subject->plane != NULL ? fabs((double)subject->plane->rise[axis]) / (double)CANOPY_QUERY_PLANE_ONE : 0;
    }
    return most[0] / e->frame.pitch[0] + most[1] / e->frame.pitch[1];
}

static void judge_bound(const struct canopy_extreme *search, int sign, bool any, const uint64_t at[2], int32_t *last) {
    const struct canopy_extreme_answer answer = canopy_extreme_answer(search);
    if (any) {  // no sample beats the bound: the best one exactly, so the others up to double's 1e-5 steps
        REQUIRE(sign * compare_at(&search->subject, at, PARTS, answer.bound) <= 0);
    }
    REQUIRE(sign * answer.bound <= *last);  // it only gets tighter
    *last = sign * answer.bound;
    if (answer.found) {
        REQUIRE(sign * answer.attained <= sign * answer.bound);
        const double there = sampled(&search->subject, (double)answer.at[0] / search->subject.surface->frame.pitch[0],
                                     (double)answer.at[1] / search->subject.surface->frame.pitch[1]);
        // Half a quantum in each direction, a bit of 2^-26 of an interval, a step
        const double off =
            (0.5 + 0x1p-25 * (search->subject.surface->frame.pitch[0] + search->subject.surface->frame.pitch[1])) *
                steepest(&search->subject) +
            1.3;
        REQUIRE(fabs(there - answer.attained) <= off);
    }
}

static void check_extreme(uint64_t seed) {
    static struct canopy_extreme_node nodes[4096];
    struct scene s;
    make_scene(&s, seed, 28);
    const int sign = below(&s, 2) == 0 ? 1 : -1;
    const enum canopy_extreme_kind kind = sign == 1 ? CANOPY_HIGHEST : CANOPY_LOWEST;
    const uint32_t room = below(&s, 2) == 0 ? 4096 : 1 + below(&s, 20), tolerance = 2 + below(&s, 3) * 1000;
    double best = 0;
    uint64_t at[2] = {0, 0};
    const bool any = sample(&s.subject, &s.rect, sign, &best, at);
    struct canopy_extreme search;
    REQUIRE(canopy_extreme_begin(&search, &s.subject, &s.rect, kind, tolerance, nodes, room) == CANOPY_OK);
    int32_t last = INT32_MAX;
    judge_bound(&search, sign, any, at, &last);
    enum canopy_status status;
    uint32_t steps = 0;
    do {
        status = canopy_extreme_step(&search, 1 + below(&s, 30));
        if (status == CANOPY_EMPTY) {
            break;
        }
        judge_bound(&search, sign, any, at, &last);
    } while (status == CANOPY_MORE && steps++ < 40);
    if (any) {
        REQUIRE(status == CANOPY_OK || status == CANOPY_MORE);
    }
    const struct canopy_extreme_answer answer = canopy_extreme_answer(&search);
    if (status == CANOPY_OK && room == 4096 && answer.found) {
        // All was remembered, so the search ended because it was tight; or parts were too small to be cut further,
        // where only a slope of 2^-38 of an interval's rise is left.
        REQUIRE(fabs((double)answer.bound - answer.attained) <= tolerance + 2);
    }
}

// With few parts remembered the bound is loose, but it still holds: against what a search with many attains.
static void check_few_nodes(uint64_t seed) {
    static struct canopy_extreme_node nodes[4096];
    struct scene s;
    make_scene(&s, seed, 28);
    const int sign = below(&s, 2) == 0 ? 1 : -1;
    const enum canopy_extreme_kind kind = sign == 1 ? CANOPY_HIGHEST : CANOPY_LOWEST;
    struct canopy_extreme search;
    REQUIRE(canopy_extreme_begin(&search, &s.subject, &s.rect, kind, 2, nodes, 4096) == CANOPY_OK);
    if (canopy_extreme_step(&search, 4000) == CANOPY_EMPTY) {
        return;
    }
    const int32_t attained = canopy_extreme_answer(&search).attained;
    for (uint32_t room = 1; room <= 8; room++) {
        REQUIRE(canopy_extreme_begin(&search, &s.subject, &s.rect, kind, 2, nodes, room) == CANOPY_OK);
        (void)canopy_extreme_step(&search, 4000);
        REQUIRE(sign * canopy_extreme_answer(&search).bound >= sign * attained);
    }
}

static void what_is_not_remembered_still_counts(void **state) {
    (void)state;
    seeds_run(1000, check_few_nodes);
}

static void no_extreme_is_passed(void **state) {
    (void)state;
    seeds_run(1500, check_extreme);
}

// ---- One cell, and one place

static void check_cell(uint64_t seed) {
    struct scene s;
    make_scene(&s, seed, 20);
    const uint32_t row = below(&s, s.envelope[0].frame.size[0] - 1U), pu = s.envelope[0].frame.pitch[0];
    const uint32_t column = below(&s, s.envelope[0].frame.size[1] - 1U), pv = s.envelope[0].frame.pitch[1];
    const struct canopy_query_rect cell = {{row * pu, column * pv}, {(row + 1) * pu, (column + 1) * pv}};
    int32_t bound[2];
    REQUIRE(canopy_query_cell(&s.subject, row, column, &bound[0], &bound[1]) == CANOPY_OK);
    s.subject.covered = false;
    double best[2] = {0, 0};
    for (int k = 0; k < 2; k++) {
        uint64_t at[2] = {0, 0};
        const int sign = k == 0 ? -1 : 1;
        REQUIRE(sample(&s.subject, &cell, sign, &best[k], at));
        REQUIRE(sign * compare_at(&s.subject, at, PARTS, bound[k]) <= 0);
    }
    // A cubic's Bernstein coefficients spread over at most 9 times its range along each axis.
    REQUIRE((double)bound[1] - bound[0] <= 81 * (best[0] + best[1]) + 1e-3 * fabs(best[0]) + 4);
}

static void no_cell_is_passed(void **state) {
    (void)state;
    seeds_run(1500, check_cell);
}

// Derivative by u, in double: central differences are exact enough only for what is smooth, so the basis again.
static double slope(double x) {
    const double a = fabs(x), d = a >= 2 ? 0 : a >= 1 ? -(2 - a) * (2 - a) / 2 : -2 * a + 1.5 * a * a;
    return x < 0 ? -d : d;
}

static void true_gradient(const struct canopy_envelope *e, double u, double v, double gradient[2]) {
    const int m = e->frame.size[0], n = e->frame.size[1];
    gradient[0] = gradient[1] = 0;
    for (int i = -1; i <= m; i++) {
        for (int j = -1; j <= n; j++) {
            const int at = (i < 0 ? 0 : i < m ? i : m - 1) * n + (j < 0 ? 0 : j < n ? j : n - 1);
            gradient[0] += slope(u - i) * spline(v - j) * e->coefficients[at];
            gradient[1] += spline(u - i) * slope(v - j) * e->coefficients[at];
        }
    }
}

static void judge_normal(const struct canopy_frame *frame, const double gradient[2], const int32_t normal[3]) {
    const double lsb = ldexp(1, frame->lsb_log2);
    double n[3] = {-gradient[0] * lsb / frame->pitch[0], -gradient[1] * lsb / frame->pitch[1], 1};
    const double length = sqrt(n[0] * n[0] + n[1] * n[1] + 1);
    const double turn = CANOPY_QUERY_GRADIENT_ERROR * lsb * (1.0 / frame->pitch[0] + 1.0 / frame->pitch[1]);
    for (int k = 0; k < 3; k++) {
        REQUIRE(fabs(normal[k] * 0x1p-30 - n[k] / length) <= 0x1p-27 + turn);
    }
}

static void check_point(uint64_t seed) {
    struct scene s;
    make_scene(&s, seed, 28);
    struct canopy_frame *frame = &s.envelope[0].frame;
    frame->lsb_log2 = (int16_t)((int)below(&s, 40) - 24);
    const uint32_t u = edge(&s, frame->pitch[0], frame->size[0] - 1U),
                   v = edge(&s, frame->pitch[1], frame->size[1] - 1U);
    struct canopy_query_point answer;
    REQUIRE(canopy_query_at(&s.envelope[0], u, v, &answer) == CANOPY_OK);
    const struct canopy_query_subject surface = {.surface = &s.envelope[0]};
    const uint64_t at[2] = {u, v};
    REQUIRE(compare_at(&surface, at, 1, answer.low) >= 0);
    REQUIRE(compare_at(&surface, at, 1, answer.high) <= 0);
    double gradient[2];
    true_gradient(&s.envelope[0], (double)u / frame->pitch[0], (double)v / frame->pitch[1], gradient);
    for (int axis = 0; axis < 2; axis++) {
        REQUIRE(fabs(answer.gradient[axis] - gradient[axis]) <= CANOPY_QUERY_GRADIENT_ERROR);
    }
    judge_normal(frame, gradient, answer.normal);
    REQUIRE(answer.covered == canopy_envelope_covers(&s.envelope[0], u, v));
    const struct canopy_query_point before = answer;
    REQUIRE(canopy_query_at(&s.envelope[0], (uint32_t)canopy_frame_width(frame, 0) + 1, v, &answer) ==
            CANOPY_OUT_OF_FRAME);
    assert_memory_equal(&before.gradient, &answer.gradient, sizeof before.gradient);
}

static void places_are_within_their_error(void **state) {
    (void)state;
    seeds_run(3000, check_point);
}

// ---- Volumes

// The integral of N from -2 to x.
static void rational_integral(mpq_t to, const mpq_t x) {
    mpq_t a, p, t;
    mpq_inits(a, p, t, NULL);
    mpq_abs(a, x);
    if (mpq_cmp_ui(a, 2, 1) >= 0) {
        mpq_set_ui(to, 0, 1);  // of the tail beyond |x|
    } else if (mpq_cmp_ui(a, 1, 1) >= 0) {
        mpq_set_ui(t, 2, 1);  // (2 - a)^4 / 24
        mpq_sub(t, t, a);
        mpq_mul(p, t, t);
        mpq_mul(to, p, p);
        mpq_set_ui(t, 24, 1);
        mpq_div(to, to, t);
    } else {  // 1/2 - (4 a - 2 a^3 + 3/4 a^4) / 6
        mpq_mul(p, a, a);
        mpq_mul(p, p, a);
        mpq_set_si(t, -2, 1);
        mpq_mul(t, t, p);
        mpq_mul(p, p, a);
        mpq_set_ui(to, 3, 4);
        mpq_mul(p, p, to);
        mpq_add(t, t, p);
        mpq_set_ui(to, 4, 1);
        mpq_mul(p, a, to);
        mpq_add(t, t, p);
        mpq_set_ui(p, 6, 1);
        mpq_div(t, t, p);
        mpq_set_ui(to, 1, 2);
        mpq_sub(to, to, t);
    }
    if (mpq_sgn(x) > 0) {
        mpq_set_ui(t, 1, 1);
        mpq_sub(to, t, to);
    }
    mpq_clears(a, p, t, NULL);
}

// The integrals of N(x - i) over from … to (quanta over the pitch), for i from -1.
static void integrate_axis(mpq_t *to, uint32_t size, uint32_t pitch, uint64_t from, uint64_t until) {
    mpq_t x, knot, low;
    mpq_inits(x, knot, low, NULL);
    for (int i = -1; i <= (int)size; i++) {
        mpq_set_si(knot, i, 1);
        mpq_set_ui(x, from, pitch);
        mpq_canonicalize(x);
        mpq_sub(x, x, knot);
        rational_integral(low, x);
        mpq_set_ui(x, until, pitch);
        mpq_canonicalize(x);
        mpq_sub(x, x, knot);
        rational_integral(to[i + 1], x);
        mpq_sub(to[i + 1], to[i + 1], low);
    }
    mpq_clears(x, knot, low, NULL);
}

// Adds the volume over a rectangle, in knot intervals^2 times steps.
static void add_rational_volume(mpq_t sum, const struct canopy_query_subject *subject, const uint64_t low[2],
                                const uint64_t high[2]) {
    const struct canopy_frame *frame = &subject->surface->frame;
    mpq_t x, middle[2], area;
    mpq_inits(x, middle[0], middle[1], area, NULL);
    mpq_set_ui(area, 1, 1);
    for (int axis = 0; axis < 2; axis++) {
        integrate_axis(weights[axis], frame->size[axis], frame->pitch[axis], low[axis], high[axis]);
        mpq_set_ui(middle[axis], low[axis] + high[axis], 2UL * frame->pitch[axis]);
        mpq_canonicalize(middle[axis]);
        mpq_set_ui(x, high[axis] - low[axis], frame->pitch[axis]);
        mpq_canonicalize(x);
        mpq_mul(area, area, x);
    }
    rational_sum(x, subject, weights[0], weights[1]);
    mpq_add(sum, sum, x);
    if (subject->plane != NULL) {  // the mean of a plane is its middle
        rational_plane(x, subject->plane, middle[0], middle[1]);
        mpq_mul(x, x, area);
        mpq_sub(sum, sum, x);
    }
    mpq_clears(x, middle[0], middle[1], area, NULL);
}

// And the area in quanta^2.
static void rational_volume(mpq_t sum, double *area, const struct canopy_query_subject *subject,
                            const struct canopy_query_rect *rect) {
    const struct canopy_frame *frame = &subject->surface->frame;
    const uint64_t low[2] = {rect->low[0], rect->low[1]}, high[2] = {rect->high[0], rect->high[1]};
    mpq_set_ui(sum, 0, 1);
    *area = 0;
    if (!subject->covered) {
        *area = (double)(high[0] - low[0]) * (double)(high[1] - low[1]);
        add_rational_volume(sum, subject, low, high);
        return;
    }
    for (uint32_t h = 0; h + 1 < frame->size[0]; h++) {
        for (uint32_t w = 0; w + 1 < frame->size[1]; w++) {
            const uint64_t edges[2] = {(uint64_t)h * frame->pitch[0], (uint64_t)w * frame->pitch[1]};
            uint64_t from[2], to[2];
            for (int axis = 0; axis < 2; axis++) {
                from[axis] = low[axis] > edges[axis] ? low[axis] : edges[axis];
                to[axis] =
                    high[axis] < edges[axis] + frame->pitch[axis] ? high[axis] : edges[axis] + frame->pitch[axis];
            }
            if (canopy_query_counts(subject, h, w) && from[0] < to[0] && from[1] < to[1]) {
                *area += (double)(to[0] - from[0]) * (double)(to[1] - from[1]);
                add_rational_volume(sum, subject, from, to);
            }
        }
    }
}

// mantissa * 2^exponent / (pu pv) in knot intervals^2 times steps: what the volume is without the frame's units.
static void set_bound(mpq_t to, int64_t mantissa, int exponent, const struct canopy_frame *frame) {
    mpq_set_si(to, mantissa, 1);
    const int log2 = exponent - frame->lsb_log2 - 3 * frame->quantum_log2;
    if (log2 >= 0) {
        mpq_mul_2exp(to, to, (mp_bitcnt_t)log2);
    } else {
        mpq_div_2exp(to, to, (mp_bitcnt_t)-log2);
    }
    mpq_t pitch;
    mpq_init(pitch);
    for (int axis = 0; axis < 2; axis++) {
        mpq_set_ui(pitch, frame->pitch[axis], 1);
        mpq_div(to, to, pitch);
    }
    mpq_clear(pitch);
}

static void judge_volume(const struct canopy_volume *volume, const mpq_t truth, bool whole_cells) {
    const struct canopy_frame *frame = &volume->subject.surface->frame;
    const struct canopy_volume_answer answer = canopy_volume_answer(volume);
    mpq_t low, high;
    mpq_inits(low, high, NULL);
    set_bound(low, answer.low, answer.exponent, frame);
    set_bound(high, answer.high, answer.exponent, frame);
    REQUIRE(mpq_cmp(low, truth) <= 0);
    REQUIRE(mpq_cmp(high, truth) >= 0);
    // How far apart: nothing but the last rounding over whole cells; else what the header says.
    mpq_sub(high, high, low);
    const double between = mpq_get_d(high), size = fabs(mpq_get_d(truth));
    const double area = (double)(volume->rect.high[0] - volume->rect.low[0]) / frame->pitch[0] *
                        (double)(volume->rect.high[1] - volume->rect.low[1]) / frame->pitch[1];
    if (whole_cells) {
        REQUIRE(between <= size * 0x1p-58 + (volume->subject.plane != NULL ? area / 36 * 1.001 : 0));
    } else {
        const double per_interval = steepest(&volume->subject) * (frame->pitch[0] + frame->pitch[1]) * 9 * 0x1p-25;
        REQUIRE(between <= size * 0x1p-58 + area * (12.0 / 36 + per_interval));
    }
    int64_t whole[2];
    if (canopy_volume_whole(&answer, &whole[0], &whole[1]) == CANOPY_OK) {
        REQUIRE((double)whole[0] <=
                ldexp((double)answer.low, answer.exponent) * (answer.low < 0 ? 0.999999 : 1.000001));
        REQUIRE((double)whole[1] >=
                ldexp((double)answer.high, answer.exponent) * (answer.high < 0 ? 1.000001 : 0.999999));
        REQUIRE(fabs((double)whole[1] - ldexp((double)answer.high, answer.exponent)) <=
                1 + 0x1p-50 * fabs((double)whole[1]));
    }
    mpq_clears(low, high, NULL);
}

static void check_volume(uint64_t seed) {
    struct scene s;
    make_scene(&s, seed, 28);
    const bool whole_cells = below(&s, 3) == 0;
    struct canopy_frame *frame = &s.envelope[0].frame;
    frame->lsb_log2 = (int16_t)((int)below(&s, 40) - 24);
    frame->quantum_log2 = (int16_t)((int)below(&s, 21) - 10);
    s.envelope[1].frame = *frame;
    for (int axis = 0; whole_cells && axis < 2; axis++) {
        s.rect.low[axis] -= s.rect.low[axis] % frame->pitch[axis];
        s.rect.high[axis] -= s.rect.high[axis] % frame->pitch[axis];
    }
    struct canopy_volume volume;
    REQUIRE(canopy_volume_begin(&volume, &s.subject, &s.rect) == CANOPY_OK);
    enum canopy_status status;
    do {
        status = canopy_volume_step(&volume, 1 + below(&s, 10));
    } while (status == CANOPY_MORE);
    REQUIRE(status == CANOPY_OK);
    mpq_t truth;
    mpq_init(truth);
    double area = 0;
    rational_volume(truth, &area, &s.subject, &s.rect);
    REQUIRE(fabs((double)volume.area - area) <= 0x1p-40 * area);
    judge_volume(&volume, truth, whole_cells);
    mpq_clear(truth);
}

static void volumes_are_between_their_bounds(void **state) {
    (void)state;
    seeds_run(800, check_volume);
}

// ---- Other grids

enum { FINE_MAX = 2 * SIZE_MAX_HERE - 1 };

// On the safe side of the old surface, at the places of a lattice of `parts` a new knot interval, where the old one is
// covered (or everywhere); `far` receives the largest distance. All in rational numbers: the places are quanta / parts.
static void judge_regrid(const struct canopy_envelope *old, const struct canopy_envelope *now, const uint32_t corner[2],
                         uint32_t parts, bool everywhere) {
    const struct canopy_query_subject a = {.surface = old}, b = {.surface = now};
    const int sign = old->frame.side == CANOPY_BELOW ? -1 : 1;
    mpq_t u[2], v[2], before, after;
    mpq_inits(u[0], u[1], v[0], v[1], before, after, NULL);
    for (uint64_t p = 0; p <= (uint64_t)parts * (now->frame.size[0] - 1U); p++) {
        for (uint64_t q = 0; q <= (uint64_t)parts * (now->frame.size[1] - 1U); q++) {
            const uint64_t x = p * now->frame.pitch[0] + (uint64_t)corner[0] * parts,
                           y = q * now->frame.pitch[1] + (uint64_t)corner[1] * parts;
            if (x > canopy_frame_width(&old->frame, 0) * parts || y > canopy_frame_width(&old->frame, 1) * parts ||
                (!everywhere && !canopy_envelope_covers(old, (uint32_t)(x / parts), (uint32_t)(y / parts)))) {
                continue;
            }
            mpq_set_ui(u[0], x, (unsigned long)old->frame.pitch[0] * parts);
            mpq_set_ui(v[0], y, (unsigned long)old->frame.pitch[1] * parts);
            mpq_set_ui(u[1], p, parts);
            mpq_set_ui(v[1], q, parts);
            for (int k = 0; k < 2; k++) {
                mpq_canonicalize(u[k]);
                mpq_canonicalize(v[k]);
            }
            rational_at(before, &a, u[0], v[0]);
            rational_at(after, &b, u[1], v[1]);
            mpq_sub(after, after, before);
            REQUIRE(sign * mpq_sgn(after) >= 0);
            const bool inside = p >= 2 * parts && q >= 2 * parts && p <= parts * (now->frame.size[0] - 3U) &&
                                q <= parts * (now->frame.size[1] - 3U);
            REQUIRE(!everywhere || !inside || sign * mpq_get_d(after) < 2);
        }
    }
    mpq_clears(u[0], u[1], v[0], v[1], before, after, NULL);
}

static void check_halve(uint64_t seed) {
    struct scene s;
    make_scene(&s, seed, 8);
    struct canopy_envelope *old = &s.envelope[0];
    int32_t coefficients[FINE_MAX * SIZE_MAX_HERE];
    uint8_t coverage[FINE_MAX * SIZE_MAX_HERE / 8 + 1];
    struct canopy_envelope fine = {.coefficients = coefficients, .coverage = coverage};
    const int axis = (int)below(&s, 2);
    old->frame.pitch[axis] *= 2;
    old->frame.cells = (uint16_t)(1 + below(&s, 4));
    old->margin = 17;
    REQUIRE(canopy_regrid_halve(old, axis, &fine) == CANOPY_OK);
    REQUIRE(fine.margin == 17 && fine.frame.pitch[axis] == old->frame.pitch[axis] / 2);
    REQUIRE(canopy_frame_width(&fine.frame, axis) == canopy_frame_width(&old->frame, axis));
    REQUIRE(fine.frame.pitch[0] % fine.frame.cells == 0 && fine.frame.pitch[1] % fine.frame.cells == 0);
    const uint32_t corner[2] = {0, 0};
    judge_regrid(old, &fine, corner, 3, true);
    for (uint32_t h = 0; h + 1 < fine.frame.size[0]; h++) {
        for (uint32_t w = 0; w + 1 < fine.frame.size[1]; w++) {
            REQUIRE(canopy_envelope_covers(&fine, h * fine.frame.pitch[0], w * fine.frame.pitch[1]) ==
                    canopy_envelope_covers(old, h * fine.frame.pitch[0], w * fine.frame.pitch[1]));
        }
    }
}

static void a_finer_grid_is_on_the_safe_side_everywhere(void **state) {
    (void)state;
    seeds_run(150, check_halve);
}

// Fills, fits and certifies. False: the old surface is too high for a field, or nothing of it is covered.
static bool regrid(const struct canopy_envelope *old, const struct canopy_query_rect *box,
                   const struct canopy_grid *grid, uint32_t cuts, struct canopy_envelope *now) {
    REQUIRE(canopy_regrid_frame(&old->frame, box, grid, &now->frame) == CANOPY_OK);
    const uint16_t cells[2] = {grid->cells, grid->cells};
    const uint32_t m = grid->size[0], n = grid->size[1];
    const size_t bytes[3] = {CANOPY_FIELD_ARENA(m, n, grid->cells, grid->cells),
                             CANOPY_FAST_ARENA(m, n, grid->cells, 1),
                             CANOPY_CERTIFY_ARENA(n, grid->cells, grid->cells)};
    void *arena[3] = {malloc(bytes[0]), malloc(bytes[1]), malloc(bytes[2])};
    struct canopy_field field;
    struct canopy_fast fast;
    struct canopy_certify certify;
    REQUIRE(canopy_field_init(&field, &now->frame, cells, arena[0], bytes[0]) == CANOPY_OK);
    REQUIRE(canopy_fast_init(&fast, &field, &canopy_line_fit_fx, 1, arena[1], bytes[1]) == CANOPY_OK);
    REQUIRE(canopy_certify_init(&certify, &field, arena[2], bytes[2]) == CANOPY_OK);
    static struct canopy_regrid work;
    canopy_regrid_begin(&work, old, box->low, 0, cuts, &field);
    enum canopy_status status;
    do {
        status = canopy_regrid_step(&work, 7);
    } while (status == CANOPY_MORE);
    const bool filled = status == CANOPY_OK;
    if (filled) {
        REQUIRE(canopy_fast_begin(&fast, now->coefficients) == CANOPY_OK);
        while (canopy_fast_step(&fast, UINT32_MAX) == CANOPY_MORE) {}
        canopy_certify_begin(&certify, now->coefficients);
        while ((status = canopy_certify_step(&certify, UINT32_MAX)) == CANOPY_NOT_SAFE) {
            REQUIRE(canopy_fast_raise(&field, now->coefficients, certify.failed_cell, certify.missing) == CANOPY_OK);
        }
        REQUIRE(status == CANOPY_OK);
        canopy_fast_orient(&now->frame, now->coefficients);
    } else {
        REQUIRE(status == CANOPY_EMPTY || status == CANOPY_RANGE);
    }
    for (int k = 0; k < 3; k++) {
        free(arena[k]);
    }
    return filled;
}

static void check_regrid(uint64_t seed) {
    struct scene s;
    make_scene(&s, seed, 12);
    int32_t coefficients[GRID];
    struct canopy_envelope now = {.coefficients = coefficients};
    const struct canopy_grid grid = {
        .size = {(uint16_t)(4 + below(&s, SIZE_MAX_HERE - 3)), (uint16_t)(4 + below(&s, SIZE_MAX_HERE - 3))},
        .cells = (uint16_t)(1 + below(&s, 5))};
    if (regrid(&s.envelope[0], &s.rect, &grid, below(&s, 6), &now)) {
        judge_regrid(&s.envelope[0], &now, s.rect.low, 3, false);
    }
}

static void another_grid_is_on_the_safe_side_where_covered(void **state) {
    (void)state;
    seeds_run(150, check_regrid);
}

int main(void) {
    for (int axis = 0; axis < 2; axis++) {
        for (size_t i = 0; i < sizeof weights[0] / sizeof weights[0][0]; i++) {
            mpq_init(weights[axis][i]);
        }
    }
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(no_extreme_is_passed),
        cmocka_unit_test(what_is_not_remembered_still_counts),
        cmocka_unit_test(no_cell_is_passed),
        cmocka_unit_test(places_are_within_their_error),
        cmocka_unit_test(volumes_are_between_their_bounds),
        cmocka_unit_test(a_finer_grid_is_on_the_safe_side_everywhere),
        cmocka_unit_test(another_grid_is_on_the_safe_side_where_covered),
    };
    return cmocka_run_group_tests_name("query properties", tests, NULL, NULL);
}
