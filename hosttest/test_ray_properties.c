// Random and adversarial rays against a reference in double that shares nothing with the library: it knows no cells and
// no Bernstein coefficients. S has two continuous derivatives, so the distance F(t) of a ray to the surface stays above
// the straight line between two of its values less K h^2 / 8; halving intervals from the left then finds the first t
// at which F > 0 cannot be told, or none. It evaluates S from the B-splines' textbook form.
//
// Judged: a ray is never hit behind the first true hit, nor free where there is one; and what is left between the ray
// and the surface at the hit is within the stated error. CANOPY_CLOUDS sets the number of scenes of 50 rays each, which
// is 20,000 otherwise: a million rays. CANOPY_SEED=n runs one alone.

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "hosttest/seeds.h"
#include "lib/cover/ray.h"
#include "tools/common/random.h"

enum { GRID_MAX = 20, RAYS = 50, SCENES = 20000 };

struct scene {
    uint64_t seed, random;
    struct canopy_envelope envelope;
    int32_t b[GRID_MAX * GRID_MAX];
    uint8_t coverage[(GRID_MAX * GRID_MAX + 7) / 8];
    double quantum, step;  // device units a quantum, quanta a step
    double bend[3];        // bounds of |S_uu|, |S_uv|, |S_vv|, steps
    double range;
};

// A line in knots and steps, mirrored for the side below: free is above.
struct line {
    double from[3], along[3], most;  // t from 0 to most
};

static double uniform(struct scene *s) { return canopy_random_unit(&s->random); }
static uint32_t below(struct scene *s, uint32_t limit) { return canopy_random_below(&s->random, limit); }
static double within(struct scene *s, double low, double high) { return low + (high - low) * uniform(s); }
static int size_of(const struct scene *s, int a) { return s->envelope.frame.size[a]; }

// ---- The surface, in double

static double coefficient(const struct scene *s, int i, int j) {
    const int m = size_of(s, 0), n = size_of(s, 1);
    i = i < 0 ? 0 : i < m ? i : m - 1;
    j = j < 0 ? 0 : j < n ? j : n - 1;
    const double b = s->b[i * n + j];
    return s->envelope.frame.side == CANOPY_BELOW ? -b : b;
}

static void basis(double x, double w[4]) {
    const double r = 1 - x;
    w[0] = r * r * r / 6;
    w[1] = (3 * x * x * x - 6 * x * x + 4) / 6;
    w[2] = (3 * r * r * r - 6 * r * r + 4) / 6;
    w[3] = x * x * x / 6;
}

static double surface(const struct scene *s, double u, double v) {
    const double top[2] = {size_of(s, 0) - 1, size_of(s, 1) - 1};
    u = fmin(fmax(u, 0), top[0]);
    v = fmin(fmax(v, 0), top[1]);
    const int h = (int)fmin(floor(u), top[0] - 1), l = (int)fmin(floor(v), top[1] - 1);
    double wu[4], wv[4], sum = 0;
    basis(u - h, wu);
    basis(v - l, wv);
    for (int a = 0; a < 4; a++) {
        for (int e = 0; e < 4; e++) {
            sum += wu[a] * wv[e] * coefficient(s, h + a - 1, l + e - 1);
        }
    }
    return sum;
}

static double slope(const struct scene *s, double u, double v, int axis) {
    const double h = 1e-4;
    return axis == 0 ? (surface(s, u + h, v) - surface(s, u - h, v)) / (2 * h)
                     : (surface(s, u, v + h) - surface(s, u, v - h)) / (2 * h);
}

// The second derivatives are convex combinations of second differences.
static void measure(struct scene *s) {
    double low = HUGE_VAL, high = -HUGE_VAL;
    memset(s->bend, 0, sizeof s->bend);
    for (int i = 0; i < size_of(s, 0); i++) {
        for (int j = 0; j < size_of(s, 1); j++) {
            const double b = coefficient(s, i, j), up = coefficient(s, i + 1, j), right = coefficient(s, i, j + 1);
            s->bend[0] = fmax(s->bend[0], fabs(up - 2 * b + coefficient(s, i - 1, j)));
            s->bend[1] = fmax(s->bend[1], fabs(coefficient(s, i + 1, j + 1) - up - right + b));
            s->bend[2] = fmax(s->bend[2], fabs(right - 2 * b + coefficient(s, i, j - 1)));
            low = fmin(low, b);
            high = fmax(high, b);
        }
    }
    s->range = high - low;
}

// ---- The reference

struct reference {
    const struct scene *scene;
    struct line line;
    double bend, noise, least;  // of F by t; what double may be wrong by; the shortest interval
    uint64_t evaluations;
};

static double distance(struct reference *r, double t) {
    const struct line *l = &r->line;
    r->evaluations++;
    return l->from[2] + l->along[2] * t - surface(r->scene, l->from[0] + l->along[0] * t, l->from[1] + l->along[1] * t);
}

// The first t in [a, b] where F > -noise is not sure, or infinity.
static double first_doubt(struct reference *r, double a, double fa, double b, double fb) {
    const double h = b - a;
    if (fa <= -r->noise) {
        return a;
    }
    if (fmin(fa, fb) - r->bend * h * h / 8 > -r->noise) {
        return HUGE_VAL;
    }
    if (h < r->least) {
        return fb <= -r->noise ? b : HUGE_VAL;
    }
    const double middle = a + h / 2, fm = distance(r, middle), left = first_doubt(r, a, fa, middle, fm);
    return isinf(left) ? first_doubt(r, middle, fm, b, fb) : left;
}

// The part of the line in the frame. False: none.
static bool clip(const struct scene *s, const struct line *l, double *from, double *to) {
    *from = 0;
    *to = l->most;
    for (int a = 0; a < 2; a++) {
        const double top = size_of(s, a) - 1;
        if (l->along[a] == 0) {
            if (l->from[a] < 0 || l->from[a] > top) {
                return false;
            }
            continue;
        }
        const double t0 = -l->from[a] / l->along[a], t1 = (top - l->from[a]) / l->along[a];
        *from = fmax(*from, fmin(t0, t1));
        *to = fmin(*to, fmax(t0, t1));
    }
    return *from <= *to;
}

static struct reference reference_of(const struct scene *s, const struct line *l) {
    const double du = fabs(l->along[0]), dv = fabs(l->along[1]);
    double far = 0;
    for (int a = 0; a < 3; a++) {
        far = fmax(far, fabs(l->from[a]));
    }
    const double lateral = fmax(fabs(l->from[0]), fabs(l->from[1])) + GRID_MAX;
    struct reference r = {.scene = s, .line = *l};
    r.bend = du * du * s->bend[0] + 2 * du * dv * s->bend[1] + dv * dv * s->bend[2];
    r.noise = 1e-14 * (far + s->range + 1e3) + 1e-14 * lateral * s->range;
    return r;
}

// ---- Scenes

static void make_heights(struct scene *s) {
    const int m = size_of(s, 0), n = size_of(s, 1);
    const uint32_t law = below(s, 8);
    const double size = law == 7 ? 0x1p28 : ldexp(1, (int)below(s, 26)),
                 base = law == 7 ? 0 : within(s, -0x1p24, 0x1p24);
    const double a = within(s, 0.2, 2), c = within(s, 0.2, 2), phase = within(s, 0, 6);
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < n; j++) {
            double z = 0;
            switch (law) {
            case 0: z = uniform(s); break;                       // rough
            case 1: z = sin(a * i + phase) * cos(c * j); break;  // waves
            case 2: z = below(s, 8) == 0 ? 1 : 0; break;         // spikes on a plateau
            case 3: z = (i + j) % 7 < 3 ? 1 : 0; break;          // terraces: flat pieces, double roots
            case 4: z = 0; break;                                // flat
            case 5: z = a * i - c * j; break;                    // a plane
            case 6: z = -(i - m / 2) * (i - m / 2) * a - (j - n / 2) * (j - n / 2) * c; break;  // a dome
            default: z = below(s, 3) - 1.0; break;                                              // the limits
            }
            const double b = rint(base + size * z);
            s->b[i * n + j] = (int32_t)fmax(-0x1p28, fmin(0x1p28, b));
        }
    }
}

static void make_scene(struct scene *s, uint64_t seed) {
    *s = (struct scene){.seed = seed, .random = seed};
    struct canopy_frame *frame = &s->envelope.frame;
    s->envelope.scalar = below(s, 2) == 0 ? CANOPY_F32 : CANOPY_FX;
    const bool f32 = s->envelope.scalar == CANOPY_F32;
    for (int a = 0; a < 2; a++) {
        frame->size[a] = (uint16_t)(4 + below(s, GRID_MAX - 3));
        frame->pitch[a] = (uint32_t)ldexp(1 + uniform(s), (int)below(s, f32 ? 19 : 26)) + 3;
    }
    frame->cells = 1;
    frame->side = (uint8_t)below(s, 2);
    frame->quantum_log2 = (int16_t)(f32 ? (int)below(s, 40) - 30 : 0);
    frame->lsb_log2 = (int16_t)((int)below(s, 20) - 14);
    make_heights(s);
    for (size_t i = 0; i < sizeof s->coverage; i++) {
        s->coverage[i] = (uint8_t)below(s, 256);
    }
    s->quantum = ldexp(1, frame->quantum_log2);
    s->step = ldexp(1, frame->lsb_log2);
    measure(s);
}

// ---- Rays, in knots and steps first, then in what the library takes

static void tangent(struct scene *s, struct line *l, bool level) {
    const double u = within(s, 0, size_of(s, 0) - 1), v = within(s, 0, size_of(s, 1) - 1);
    const double su = slope(s, u, v, 0), sv = slope(s, u, v, 1), turn = within(s, 0, 6.3);
    const double du = level ? -sv : cos(turn), dv = level ? su : sin(turn);
    const double length = fmax(hypot(du, dv), 1e-30), back = within(s, 0, 8);
    l->along[0] = du / length;
    l->along[1] = dv / length;
    l->along[2] = su * l->along[0] + sv * l->along[1];
    static const double off[] = {0, 0, 1e-7, -1e-7, 1e-5, -1e-4, 1e-3, 0.5, -0.5, 3};
    const double high = off[below(s, 10)] * (below(s, 2) == 0 ? 1 : s->range);
    l->from[0] = u - back * l->along[0];
    l->from[1] = v - back * l->along[1];
    l->from[2] = surface(s, u, v) + high - back * l->along[2];
}

static void make_ray(struct scene *s, struct line *l) {
    const double top[2] = {size_of(s, 0) - 1, size_of(s, 1) - 1};
    const uint32_t kind = below(s, 12);
    double target[3];  // most rays are aimed at the surface or close to it
    for (int a = 0; a < 2; a++) {
        l->from[a] = within(s, -0.3, 1.3) * top[a];
        target[a] = within(s, -0.02, 1.02) * top[a];
    }
    l->from[2] = surface(s, l->from[0], l->from[1]) + s->range * within(s, -0.02, 1) + 1;
    target[2] = surface(s, target[0], target[1]) + s->range * within(s, -1, 1) * within(s, 0, 0.5);
    for (int a = 0; a < 3; a++) {
        l->along[a] = target[a] - l->from[a];
    }
    switch (kind) {
    case 0: tangent(s, l, false); break;
    case 1: tangent(s, l, true); break;
    case 2:  // along a knot line
        l->from[kind % 2] = below(s, 20);
        l->along[kind % 2] = 0;
        break;
    case 3:  // through corners
        l->from[0] = below(s, 20);
        l->from[1] = below(s, 20);
        l->along[0] = (double)below(s, 5) - 2;
        l->along[1] = (double)below(s, 5) - 2;
        break;
    case 4: l->along[0] = l->along[1] = 0; break;  // along the height axis
    case 5: l->along[2] = 0; break;                // level
    case 6:                                        // level, at the height of a plateau
        l->along[2] = 0;
        l->from[2] = coefficient(s, (int)below(s, GRID_MAX), (int)below(s, GRID_MAX));
        break;
    case 7: l->along[2] *= ldexp(1, (int)below(s, 40) - 20); break;  // from level to steep
    case 8: l->along[below(s, 2)] *= ldexp(1, -(int)below(s, 40)); break;
    case 9:  // from far
        for (int a = 0; a < 3; a++) {
            l->from[a] -= 300 * l->along[a];
        }
        break;
    default: break;
    }
    l->most = HUGE_VAL;
}

struct cast {
    bool segment;
    enum canopy_status status;
    struct canopy_ray_hit hit;
    struct line line;  // what the library was given, exactly
};

static double scale_of(const struct scene *s, int a) {  // quanta a knot or a step
    return a < 2 ? s->envelope.frame.pitch[a] : s->envelope.frame.side == CANOPY_BELOW ? -s->step : s->step;
}

static void cast_fx(struct scene *s, const struct line *l, struct cast *c) {
    int64_t from[3], to[3];
    int32_t along[3];
    const double longest = fmax(fmax(fabs(l->along[0] * scale_of(s, 0)), fabs(l->along[1] * scale_of(s, 1))),
                                fmax(fabs(l->along[2] * scale_of(s, 2)), 1e-9));
    const double length = ldexp(1 + uniform(s), 1 + (int)below(s, 29)) / longest;
    for (int a = 0; a < 3; a++) {
        from[a] = (int64_t)fmax(-0x1p35, fmin(0x1p35, rint(l->from[a] * scale_of(s, a))));
        along[a] = (int32_t)rint(l->along[a] * scale_of(s, a) * length);
        to[a] = from[a] + along[a];
        c->line.from[a] = (double)from[a] / scale_of(s, a);
        c->line.along[a] = along[a] / scale_of(s, a);
    }
    c->status = CANOPY_OK;
    if (c->segment) {
        const bool is_free = canopy_ray_is_free_fx(&s->envelope, from, to, &c->hit);
        assert_int_equal(is_free, c->hit.outcome <= CANOPY_RAY_BESIDE);
    } else {
        c->status = canopy_ray_first_fx(&s->envelope, from, along, &c->hit);
    }
}

static void cast_f32(struct scene *s, const struct line *l, struct cast *c) {
    float from[3], along[3], to[3];
    const double length = ldexp(1 + uniform(s), (int)below(s, 40) - 20);
    for (int a = 0; a < 3; a++) {
        const double scale = scale_of(s, a) * s->quantum;
        from[a] = (float)(l->from[a] * scale);
        along[a] = (float)(l->along[a] * scale * (c->segment ? 7 : length));
        to[a] = from[a] + along[a];
        c->line.from[a] = (double)from[a] / scale;
        c->line.along[a] = (c->segment ? (double)to[a] - (double)from[a] : (double)along[a]) / scale;
    }
    c->status = CANOPY_OK;
    if (c->segment) {
        const bool is_free = canopy_ray_is_free_f32(&s->envelope, from, to, &c->hit);
        assert_int_equal(is_free, c->hit.outcome <= CANOPY_RAY_BESIDE);
    } else {
        c->status = canopy_ray_first_f32(&s->envelope, from, along, &c->hit);
    }
}

// ---- The verdict

static struct {
    uint64_t rays, outcomes[CANOPY_RAY_BAD_ENVELOPE + 1], unsettled, cells, evaluations;
    uint64_t steps[CANOPY_ROOT_STEPS + 1];
    double worst;  // of what is left at settled hits, in 2^-23 (M + D): see ray.h
} tally;

static void complain(const struct scene *s, int ray, const struct cast *c, const char *what, double a, double b) {
    const struct canopy_frame *f = &s->envelope.frame;
    fail_msg(
        "seed %llu, ray %d, %s, side %d, %ux%u, range %g: from %.17g,%.17g,%.17g along %.17g,%.17g,%.17g, outcome %d, "
        "cell %u,%u: %s: %.17g, %.17g",
        (unsigned long long)s->seed, ray, s->envelope.scalar == CANOPY_F32 ? "f32" : "fx", f->side, f->size[0],
        f->size[1], s->range, c->line.from[0], c->line.from[1], c->line.from[2], c->line.along[0], c->line.along[1],
        c->line.along[2], c->hit.outcome, c->hit.place[0].interval, c->hit.place[1].interval, what, a, b);
}

static double cell_range(const struct scene *s, const struct canopy_ray_hit *hit) {
    double low = HUGE_VAL, high = -HUGE_VAL;
    for (int i = -1; i <= 2; i++) {
        for (int j = -1; j <= 2; j++) {
            const double b = coefficient(s, (int)hit->place[0].interval + i, (int)hit->place[1].interval + j);
            low = fmin(low, b);
            high = fmax(high, b);
        }
    }
    return high - low;
}

static double hit_t(const struct canopy_ray_hit *hit) { return ldexp((double)hit->t, hit->t_log2); }

// Where the library says the hit is, is where its t is.
static void judge_place(struct scene *s, int ray, const struct cast *c, double t) {
    for (int a = 0; a < 2; a++) {
        const double place = c->hit.place[a].interval + c->hit.place[a].s / 0x1p30;
        const double there = c->line.from[a] + c->line.along[a] * t;
        const double digits = 1e-8 + 1e-11 * (fabs(c->line.from[a]) + fabs(c->line.along[a] * t));
        if (fabs(place - there) > digits) {
            complain(s, ray, c, "place is not on the ray", place, there);
        }
    }
    const uint32_t bit = c->hit.place[0].interval * (uint32_t)(size_of(s, 1) - 1) + c->hit.place[1].interval;
    assert_int_equal(c->hit.covered, s->coverage[bit / 8] >> bit % 8 & 1);
}

// What is left between the ray and the surface at a hit.
static void judge_hit(struct scene *s, int ray, const struct cast *c, struct reference *r) {
    const struct canopy_ray_hit *hit = &c->hit;
    const double t = hit_t(hit), run = fmax(fabs(c->line.along[0]), fabs(c->line.along[1]));
    const double fall = run > 0 ? fabs(c->line.along[2]) / run : 0;  // D
    const double ulp = 0x1p-23 * (cell_range(s, hit) + fall), left = distance(r, t);
    judge_place(s, ray, c, t);
    tally.unsettled += !hit->settled;
    if (!hit->settled) {
        return;
    }
    if (left > 4 * ulp + 0.03125 + 2 * r->noise) {
        complain(s, ray, c, "a hit before the surface, ulp", left, left / ulp);
    }
    if (ulp > 1) {
        tally.worst = fmax(tally.worst, left / ulp);
    }
}

// A line that the reference sees pass beside the frame, or touch its edge within rounding.
static void judge_beside(struct scene *s, int ray, const struct cast *c, double from, double to) {
    if (canopy_ray_is_hit(&c->hit) && from > to * (1 + 1e-9) + 1e-9) {
        complain(s, ray, c, "a hit beside the frame", from, to);
    }
}

static void judge(struct scene *s, int ray, const struct cast *c) {
    const struct canopy_ray_hit *hit = &c->hit;
    struct reference r = reference_of(s, &c->line);
    double from, to;
    tally.rays++;
    tally.outcomes[hit->outcome]++;
    tally.cells += hit->cells;
    tally.steps[hit->steps]++;
    if (c->status != CANOPY_OK) {
        assert_true(hit->outcome == CANOPY_RAY_TOO_FAR || hit->outcome == CANOPY_RAY_NO_DIRECTION);
        return;
    }
    if (!clip(s, &c->line, &from, &to)) {
        judge_beside(s, ray, c, from, to);
        return;
    }
    if (isinf(to)) {  // along the height axis: as far as there may be anything
        to = (fabs(c->line.from[2]) + 0x1p29) / fmax(fabs(c->line.along[2]), 1e-300);
    }
    if (hit->outcome == CANOPY_RAY_BESIDE) {
        complain(s, ray, c, "said to be beside", from, to);
    }
    r.least = 1e-10 * (to - from);
    r.noise += fabs(c->line.along[2]) * to * 1e-14;
    const double begin = from + 1e-12 * (to - from), end = canopy_ray_is_hit(hit) ? fmin(hit_t(hit), to) : to;
    if (begin < end) {
        const double miss = first_doubt(&r, begin, distance(&r, begin), end, distance(&r, end));
        if (miss < end) {
            complain(s, ray, c, "missed", miss, distance(&r, miss));
        }
    }
    if (canopy_ray_is_hit(hit)) {
        judge_hit(s, ray, c, &r);
    }
    tally.evaluations += r.evaluations;
}

static void check_scene(uint64_t seed) {
    static struct scene s;
    make_scene(&s, seed);
    s.envelope.coefficients = s.b;
    s.envelope.coverage = s.coverage;
    for (int ray = 0; ray < RAYS; ray++) {
        struct line l;
        struct cast c = {.segment = below(&s, 4) == 0};
        make_ray(&s, &l);
        (s.envelope.scalar == CANOPY_F32 ? cast_f32 : cast_fx)(&s, &l, &c);
        c.line.most = c.segment ? 1 : HUGE_VAL;
        judge(&s, ray, &c);
    }
}

static void no_hit_is_missed(void **state) {
    (void)state;
    memset(&tally, 0, sizeof tally);
    seeds_run(SCENES, check_scene);
    const uint64_t *of = tally.outcomes, hits = of[CANOPY_RAY_HIT];
    printf("# %llu rays: free %llu, beside %llu, hit %llu, start under %llu, enter under %llu, too far %llu; unsettled "
           "%llu; worst %.3g ulp; %.3g cells and %.3g evaluations a ray\n# steps:",
           (unsigned long long)tally.rays, (unsigned long long)of[CANOPY_RAY_FREE],
           (unsigned long long)of[CANOPY_RAY_BESIDE], (unsigned long long)hits,
           (unsigned long long)of[CANOPY_RAY_STARTS_UNDER], (unsigned long long)of[CANOPY_RAY_ENTERS_UNDER],
           (unsigned long long)of[CANOPY_RAY_TOO_FAR], (unsigned long long)tally.unsettled, tally.worst,
           (double)tally.cells / (double)tally.rays, (double)tally.evaluations / (double)tally.rays);
    for (int i = 0; i <= CANOPY_ROOT_STEPS; i++) {
        printf(" %llu", (unsigned long long)tally.steps[i]);
    }
    printf("\n");
    if (tally.rays >= 10000) {  // the rays are worth something, and touches settle
        assert_true(hits > tally.rays / 5 && of[CANOPY_RAY_FREE] > tally.rays / 5);
        assert_true(tally.unsettled * 2000 < hits);
    }
}

// Lines of any numbers within the stated limits, on an envelope of any coefficients: an outcome, and no overflow (the
// sanitizers of this build see to that).
static void any_line_has_an_outcome(void **state) {
    (void)state;
    static struct scene s;
    for (uint64_t seed = 1; seed <= 20000; seed++) {
        if (seed % 20 == 1) {
            make_scene(&s, seed);
            s.envelope.coefficients = s.b;
            s.envelope.coverage = NULL;
        }
        struct canopy_ray_line line = {.height_log2 = (int16_t)((int)below(&s, 31) - 11),
                                       .rounded = (uint8_t)(below(&s, 2) * below(&s, 256)),
                                       .t_log2 = (int16_t)((int)below(&s, 200) - 100)};
        for (int a = 0; a < 3; a++) {
            line.from[a] = (int64_t)canopy_random_next(&s.random) >> (20 + below(&s, 44));
            line.to[a] =
                below(&s, 5) == 0 ? line.from[a] : (int64_t)canopy_random_next(&s.random) >> (20 + below(&s, 44));
            if (a < 2) {
                line.width[a] = (int64_t)(canopy_random_next(&s.random) >> (23 + below(&s, 41)));
            }
        }
        struct canopy_ray_hit hit;
        const enum canopy_status status = canopy_ray_cast(&s.envelope, &line, &hit);
        assert_int_equal(status == CANOPY_OK, hit.outcome <= CANOPY_RAY_ENTERS_UNDER);
        assert_true(hit.outcome <= CANOPY_RAY_BAD_ENVELOPE && hit.steps <= CANOPY_ROOT_STEPS);
        if (canopy_ray_is_hit(&hit)) {
            assert_true(hit.place[0].interval + 1 < s.envelope.frame.size[0] && hit.place[0].s >= 0 &&
                        hit.place[0].s <= CANOPY_UNIT_Q30);
            assert_true(hit.place[1].interval + 1 < s.envelope.frame.size[1] && hit.covered);
        }
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(no_hit_is_missed), cmocka_unit_test(any_line_has_an_outcome)};
    return cmocka_run_group_tests_name("ray properties", tests, NULL, NULL);
}
