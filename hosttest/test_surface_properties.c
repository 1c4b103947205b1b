// Random and adversarial small clouds through what `canopy fit` does (tools/common/surface.h): turned to any direction,
// from the points and from the field, into frames of their own and of another file. Each surface is judged as it came
// out, and again as it comes back from its file: no point on the wrong side, none outside, the margin as certified.
// CANOPY_CLOUDS sets how many; a failure prints the seed, CANOPY_SEED=n runs that one alone.

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "hosttest/seeds.h"
#include "tools/common/random.h"
#include "tools/common/surface.h"

enum { POINTS_MAX = 60, GRID_MAX = 10, CLOUDS = 20000 };

static char file[64];  // where surrogates go and come from

struct scene {
    uint64_t seed, random;
    double points[POINTS_MAX][3];
    struct canopy_device_list list;
    struct canopy_surface_wish wish;
};

static double uniform(struct scene *s) { return canopy_random_unit(&s->random); }
static uint32_t below(struct scene *s, uint32_t limit) { return canopy_random_below(&s->random, limit); }

// ---- Clouds in the unit cube: each coordinate has a law of its own, so planes, lines, columns, lattices, cliffs,
// spikes and duplicates all come about, and their mixtures

static double draw(struct scene *s, uint32_t law, double fixed, const double *before) {
    switch (law) {
    case 0: return fixed;                                                                // a plane
    case 1: return uniform(s) < fixed ? 0 : 1;                                           // a cliff
    case 2: return canopy_random_chance(&s->random, 0.1) ? 1 : 0;                        // spikes
    case 3: return (double)below(s, 10) / 9;                                             // on knots, of a grid of 10
    case 4: return ((double)below(s, 9) + 0.5) / 9 + (uniform(s) < 0.5 ? 1e-6 : -1e-6);  // beside their middles
    case 5: return before != NULL ? fixed * *before : uniform(s);                        // a line through the origin
    case 6: return ldexp(uniform(s), -(int)below(s, 30));                                // crowded towards 0
    case 7: return uniform(s) < 0.5 ? 0.2 * uniform(s) : 1 - 0.1 * uniform(s);           // a gap
    default: return uniform(s);
    }
}

static void make_points(struct scene *s, size_t count) {
    uint32_t law[3];
    double fixed[3];
    for (int k = 0; k < 3; k++) {
        law[k] = below(s, 14);
        fixed[k] = uniform(s);
    }
    for (size_t i = 0; i < count; i++) {
        if (i > 0 && canopy_random_chance(&s->random, 0.05)) {
            memcpy(s->points[i], s->points[i - 1], sizeof s->points[i]);
            continue;
        }
        for (int k = 0; k < 3; k++) {
            s->points[i][k] = draw(s, law[k], fixed[k], k > 0 ? &s->points[i][k - 1] : NULL);
        }
    }
}

// To device units: plain, extreme aspect, offsets that eat the mantissa, full scale, a few units. `room` is the largest
// coordinate.
static void stretch(struct scene *s, size_t count, double room) {
    double scale[3] = {1000, 1000, 300}, offset[3] = {-300, 20, 7};
    const uint32_t odd = below(s, 3);
    switch (below(s, 8)) {
    case 0: scale[odd] = 1e6; break;
    case 1: scale[odd] = 3; break;
    case 2:
        for (int k = 0; k < 3; k++) {
            offset[k] = (uniform(s) - 0.5) * 0x1p26;
        }
        break;
    case 3: offset[odd] = (uniform(s) < 0.5 ? -1 : 1) * (room - 2000); break;
    case 4:
        for (int k = 0; k < 3; k++) {
            scale[k] = 2 * room;
            offset[k] = -room;
        }
        break;
    case 5: scale[0] = scale[1] = scale[2] = 7; break;
    default: break;
    }
    const double size = s->wish.scalar == CANOPY_F32 && below(s, 3) == 0 ? ldexp(1, (int)below(s, 160) - 100) : 1;
    for (size_t i = 0; i < count; i++) {
        for (int k = 0; k < 3; k++) {
            s->points[i][k] = size * fmax(-room, fmin(room, offset[k] + scale[k] * s->points[i][k]));
        }
    }
}

static void make_list(struct scene *s, size_t count) {
    s->list.scalar = s->wish.scalar;
    for (size_t i = 0; i < count; i++) {
        union canopy_device_point point;
        struct canopy_fault fault;
        assert_true(canopy_device_point(s->wish.scalar, 1.0, s->points[i], &point, &fault));
        assert_true(canopy_device_list_add(&s->list, &point));
    }
}

// ---- Directions

// True: plus or minus a coordinate axis.
static bool make_direction(struct scene *s, double direction[3]) {
    const uint32_t kind = below(s, 6), axis = below(s, 3);
    const double sign = below(s, 2) == 0 ? 1 : -1;
    for (uint32_t k = 0; k < 3; k++) {
        direction[k] = kind <= 1 ? 0 : kind == 2 ? (double)below(s, 7) - 3 : 2 * uniform(s) - 1;
    }
    if (kind == 0) {
        direction[2] = 1;
    } else if (kind == 1) {
        direction[axis] = sign;
    } else if (kind == 3) {  // steep: an axis but for very little
        const double little = ldexp(1, -(int)below(s, 40));
        for (int k = 0; k < 3; k++) {
            direction[k] *= little;
        }
        direction[axis] = sign;
    }
    direction[axis] += direction[0] == 0 && direction[1] == 0 && direction[2] == 0;
    const double length = below(s, 8) == 0 ? ldexp(1, (int)below(s, 1800) - 900) : 1;
    for (int k = 0; k < 3; k++) {
        direction[k] *= length;
    }
    return (direction[0] != 0) + (direction[1] != 0) + (direction[2] != 0) == 1;
}

static void make_fitting(struct scene *s) {
    static const uint16_t cells[] = {0, 0, 0, 1, 2, 3, 4, 5, 8};
    s->wish.side = (enum canopy_side)below(s, 2);
    s->wish.fitting.field = cells[below(s, 9)];
    s->wish.fitting.lines = below(s, 2) == 0 ? 0 : s->wish.fitting.field;
    s->wish.fitting.tight = s->wish.fitting.field == 0 && below(s, 4) == 0;
}

static struct scene make_scene(uint64_t seed) {
    struct scene s = {.seed = seed, .random = seed, .wish = {.unit = 1}};
    const size_t count = below(&s, 6) == 0 ? 1 + below(&s, 3) : 1 + below(&s, POINTS_MAX);
    s.wish.scalar = below(&s, 2) == 0 ? CANOPY_F32 : CANOPY_FX;
    s.wish.size[0] = (uint16_t)(4 + below(&s, GRID_MAX - 3));
    s.wish.size[1] = (uint16_t)(4 + below(&s, GRID_MAX - 3));
    make_fitting(&s);
    const bool along = make_direction(&s, s.wish.direction);
    make_points(&s, count);
    stretch(&s, count, along ? 2147483647.0 : 1073741824.0);  // turned, a corner is up to 1.74 times as far out
    make_list(&s, count);
    return s;
}

// ---- The verdict

static void complain(const struct scene *s, const char *what, const char *why) {
    const struct canopy_surface_wish *w = &s->wish;
    fail_msg("seed %llu, %s, side %d, %ux%u, field %u, lines %u, direction %g,%g,%g, %zu points%s: %s: %s",
             (unsigned long long)s->seed, w->scalar == CANOPY_F32 ? "f32" : "fx", (int)w->side, w->size[0], w->size[1],
             w->fitting.field, w->fitting.lines, w->direction[0], w->direction[1], w->direction[2], s->list.count,
             w->frame ? ", a file's frame" : "", what, why);
}

// How far above touching a fit from points may stand: a step, and what the margin, a lower bound, has lost to rounding.
// exact_parts.h derives that; with turned axes it grows with the frame's diagonal over the shorter pitch.
static double looseness(const struct canopy_surrogate *s, const struct canopy_exact_result *result) {
    double far = fabs(result->height_max) + fabs(result->height_min);
    const double wide = s->pitch[0] * s->size[0] + s->pitch[1] * s->size[1] + far;
    for (size_t i = 0; i < (size_t)s->size[0] * s->size[1]; i++) {
        far = fmax(far, fabs(s->coefficients[i]) * s->lsb);
    }
    return 2 * s->lsb + 1e-11 * far + 1e-14 * wide * (1 + far / s->pitch[0] + far / s->pitch[1]);
}

// Safe, and with the margin that was certified; a fit from points stands within a step of touching.
static void judge(const struct scene *s, const struct canopy_surrogate *surrogate, const char *what) {
    const struct canopy_cloud cloud = canopy_device_list_cloud(&s->list);
    struct canopy_exact_result result;
    assert_true(canopy_exact_check(surrogate, &cloud, &result));
    char text[160];
    snprintf(text, sizeof text, "%llu wrong, %llu outside, margin %g, certified %g, step %g",
             (unsigned long long)result.wrong, (unsigned long long)result.outside, result.margin, surrogate->margin,
             surrogate->lsb);
    if (!canopy_exact_is_safe(&result) || result.points != s->list.count || !(result.margin >= 0) ||
        !(result.margin >= surrogate->margin) || !surrogate->certified || surrogate->points != (double)s->list.count ||
        (s->wish.fitting.field == 0 && result.margin > looseness(surrogate, &result))) {
        complain(s, what, text);
    }
}

// Every point is in a knot cell that the trim says is covered.
static void judge_coverage(const struct scene *s, const struct canopy_surrogate *surrogate) {
    const struct canopy_cloud cloud = canopy_device_list_cloud(&s->list);
    struct canopy_exact *exact = canopy_exact_open(surrogate);
    double heights[POINTS_MAX];
    assert_non_null(exact);
    canopy_exact_heights(exact, &cloud, heights);
    canopy_exact_close(exact);
    for (size_t i = 0; i < cloud.count; i++) {
        if (!isfinite(heights[i])) {
            complain(s, "coverage", "a point lies in a cell without data");
        }
    }
}

// What was fitted, in a struct that nothing of the fit points to.
static void judge_copy(const struct scene *s, const struct canopy_surrogate *surrogate) {
    double coefficients[GRID_MAX * GRID_MAX];
    struct canopy_surrogate copy = *surrogate;
    memcpy(coefficients, surrogate->coefficients, sizeof *coefficients * copy.size[0] * copy.size[1]);
    copy.coefficients = coefficients;
    copy.trim = NULL;
    judge(s, &copy, "as fitted");
}

static void fit_and_judge(const struct scene *s, struct canopy_surrogate *back) {
    struct canopy_surrogate surrogate;
    struct canopy_surface_report report;
    struct canopy_fault fault;
    if (!canopy_surface_fit(&s->list, &s->wish, &surrogate, &report, &fault)) {
        complain(s, "no fit", fault.text);
    }
    judge_copy(s, &surrogate);
    judge_coverage(s, &surrogate);
    const bool written = canopy_surrogate_write(file, &surrogate, &fault);
    canopy_surrogate_free(&surrogate);
    if (!written || !canopy_surrogate_read(file, back, &fault)) {
        complain(s, "file", fault.text);
    }
    judge(s, back, "from the file");
}

// Some of the points again, in the frame that held them all.
static void use_frame(struct scene *s, const struct canopy_surrogate *frame) {
    const size_t count = s->list.count;
    s->list.count = 0;
    for (size_t i = 0; i < count; i++) {
        if (s->list.count == 0 || below(s, 2) == 0) {
            s->list.points[s->list.count++] = s->list.points[i];
        }
    }
    s->wish.frame = frame;
    make_fitting(s);
    struct canopy_surrogate back;
    fit_and_judge(s, &back);
    assert_memory_equal(back.axes, frame->axes, sizeof back.axes);
    assert_memory_equal(back.origin, frame->origin, sizeof back.origin);
    assert_memory_equal(back.pitch, frame->pitch, sizeof back.pitch);
    canopy_surrogate_free(&back);
}

static void check_scene(uint64_t seed) {
    struct scene s = make_scene(seed);
    struct canopy_surrogate back;
    fit_and_judge(&s, &back);
    if (below(&s, 3) == 0) {
        use_frame(&s, &back);
    }
    canopy_surrogate_free(&back);
    canopy_device_list_free(&s.list);
}

// ---- The tests

static void no_surface_is_wrong(void **state) {
    (void)state;
    seeds_run(CLOUDS, check_scene);
}

// The judge of this file must notice a surface that is a step too low.
static void the_judge_notices_one_step(void **state) {
    (void)state;
    for (uint64_t seed = 1; seed <= 200; seed++) {
        struct scene s = make_scene(seed);
        struct canopy_surrogate surrogate;
        struct canopy_surface_report report;
        struct canopy_fault fault;
        assert_true(canopy_surface_fit(&s.list, &s.wish, &surrogate, &report, &fault));
        const double far = fabs(report.result.height_max) + fabs(report.result.height_min);
        const double down =
            floor((surrogate.margin + 1e-9 * far) / surrogate.lsb) + 2;  // exact.h: what a margin is good for
        for (size_t i = 0; i < (size_t)surrogate.size[0] * surrogate.size[1]; i++) {
            surrogate.coefficients[i] += surrogate.side == CANOPY_ABOVE ? -down : down;
        }
        const struct canopy_cloud cloud = canopy_device_list_cloud(&s.list);
        struct canopy_exact_result result;
        assert_true(canopy_exact_check(&surrogate, &cloud, &result));
        if (result.wrong == 0 || !(result.margin < 0)) {
            char text[160];
            snprintf(text, sizeof text, "margin %g after %g steps of %g", result.margin, down, surrogate.lsb);
            complain(&s, "not noticed", text);
        }
        canopy_surrogate_free(&surrogate);
        canopy_device_list_free(&s.list);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_judge_notices_one_step),
        cmocka_unit_test(no_surface_is_wrong),
    };
    snprintf(file, sizeof file, "%s/canopy-surface-%ld.json", access("/dev/shm", W_OK) == 0 ? "/dev/shm" : "/tmp",
             (long)getpid());
    const int failed = cmocka_run_group_tests_name("surface properties", tests, NULL, NULL);
    unlink(file);
    return failed;
}
