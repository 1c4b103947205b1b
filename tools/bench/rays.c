#include "tools/bench/rays.h"

#include <math.h>
#include <stdlib.h>

#include "lib/cover/ray.h"
#include "tools/common/random.h"

struct set {
    struct canopy_envelope envelope;
    float from_f32[CANOPY_BENCH_RAYS][3], along_f32[CANOPY_BENCH_RAYS][3];
    int64_t from_fx[CANOPY_BENCH_RAYS][3];
    int32_t along_fx[CANOPY_BENCH_RAYS][3];
};

/// Pitches as whole quanta, the largest quantum that does it (in fixed point one unit).
static bool place_frame(const struct canopy_surrogate *s, struct canopy_frame *frame) {
    int quantum = 0;
    if (s->scalar == CANOPY_F32) {
        quantum = ilogb(fmax(s->pitch[0], s->pitch[1]));
        while (quantum > -150 &&
               (fmod(s->pitch[0], ldexp(1, quantum)) != 0 || fmod(s->pitch[1], ldexp(1, quantum)) != 0)) {
            quantum--;
        }
    }
    *frame = (struct canopy_frame){.size = {(uint16_t)s->size[0], (uint16_t)s->size[1]},
                                   .cells = 1,
                                   .side = (uint8_t)s->side,
                                   .quantum_log2 = (int16_t)quantum,
                                   .lsb_log2 = (int16_t)(ilogb(s->lsb) - quantum)};
    for (int a = 0; a < 2; a++) {
        const double pitch = ldexp(s->pitch[a], -quantum);
        if (!(pitch < 0x1p32)) {
            return false;
        }
        frame->pitch[a] = (uint32_t)pitch;
    }
    return true;
}

/// In device units from the frame's origin, along its axes.
static void draw_ray(const struct canopy_surrogate *s, const double range[2], uint64_t *random, double from[3],
                     double to[3]) {
    const double up = s->side == CANOPY_ABOVE ? 1.0 : -1.0, wide = s->pitch[0] * (s->size[0] - 1);
    for (int a = 0; a < 2; a++) {
        const double width = s->pitch[a] * (s->size[a] - 1);
        from[a] = width * (3.0 * canopy_random_unit(random) - 1.0);
        to[a] = width * canopy_random_unit(random);
    }
    from[2] = (up > 0 ? range[1] : range[0]) + up * wide * (1.0 + canopy_random_unit(random));
    to[2] = range[0] + (range[1] - range[0]) * canopy_random_unit(random);
}

static bool make_set(const struct canopy_surrogate *s, struct set *set) {
    const size_t count = (size_t)s->size[0] * s->size[1];
    double range[2] = {HUGE_VAL, -HUGE_VAL};
    uint64_t random = 1;
    set->envelope = (struct canopy_envelope){.scalar = (uint8_t)s->scalar};
    set->envelope.coefficients = malloc(count * sizeof *set->envelope.coefficients);
    if (!set->envelope.coefficients || !place_frame(s, &set->envelope.frame)) {
        return false;
    }
    for (size_t i = 0; i < count; i++) {
        set->envelope.coefficients[i] = (int32_t)s->coefficients[i];
        range[0] = fmin(range[0], s->coefficients[i] * s->lsb);
        range[1] = fmax(range[1], s->coefficients[i] * s->lsb);
    }
    for (size_t i = 0; i < CANOPY_BENCH_RAYS; i++) {
        double from[3], to[3];
        draw_ray(s, range, &random, from, to);
        for (int a = 0; a < 3; a++) {
            set->from_f32[i][a] = (float)from[a];
            set->along_f32[i][a] = (float)(to[a] - from[a]);
            if (s->scalar == CANOPY_FX) {
                set->from_fx[i][a] = llrint(from[a]);
                set->along_fx[i][a] = (int32_t)lrint(to[a] - from[a]);
            }
        }
    }
    return true;
}

static void cast(const struct set *set, struct canopy_bench_rays *rays) {
    rays->hits = rays->cells = 0;
    const double start = canopy_series_now();
    for (size_t i = 0; i < CANOPY_BENCH_RAYS; i++) {
        struct canopy_ray_hit hit;
        if (set->envelope.scalar == CANOPY_F32) {
            (void)canopy_ray_first_f32(&set->envelope, set->from_f32[i], set->along_f32[i], &hit);
        } else {
            (void)canopy_ray_first_fx(&set->envelope, set->from_fx[i], set->along_fx[i], &hit);
        }
        rays->hits += canopy_ray_is_hit(&hit);
        rays->cells += hit.cells;
        rays->steps = hit.steps > rays->steps ? hit.steps : rays->steps;
    }
    canopy_series_add(&rays->time, canopy_series_now() - start);
}

bool canopy_bench_rays(const struct canopy_surrogate *surrogate, struct canopy_bench_rays *rays) {
    struct set *set = malloc(sizeof *set);
    const bool ok = set && make_set(surrogate, set);
    if (ok) {
        cast(set, rays);
    }
    if (set) {
        free(set->envelope.coefficients);
    }
    free(set);
    return ok;
}

json_t *canopy_bench_rays_report(const struct canopy_bench_rays *rays) {
    const double ns = 1e3 * canopy_series_median(&rays->time) / CANOPY_BENCH_RAYS;
    return json_pack("{s:f, s:f, s:f, s:f, s:i}", "ns_per_ray", ns, "per_second", 1e9 / ns, "hits_pct",
                     100.0 * rays->hits / CANOPY_BENCH_RAYS, "cells_per_ray", (double)rays->cells / CANOPY_BENCH_RAYS,
                     "most_steps", (int)rays->steps);
}
