#include "tools/bench/moving.h"

#include <math.h>
#include <stdlib.h>

#include "tools/common/random.h"

#define PI 3.14159265358979323846
#define NOISE 0.01
#define SPEED 0.05

/// Evenly on the unit sphere.
static void draw_direction(uint64_t *random, double to[3]) {
    const double z = 2.0 * canopy_random_unit(random) - 1.0, turn = 2.0 * PI * canopy_random_unit(random);
    const double r = sqrt(1.0 - z * z);
    to[0] = r * cos(turn);
    to[1] = r * sin(turn);
    to[2] = z;
}

/// With mean 0 and variance 1, near enough to normal: the sum of twelve.
static double draw_noise(uint64_t *random) {
    double sum = -6.0;
    for (int i = 0; i < 12; i++) {
        sum += canopy_random_unit(random);
    }
    return sum;
}

bool canopy_moving_open(struct canopy_moving *moving, size_t count, uint64_t number) {
    uint64_t random = canopy_random_mix(number + 1);
    *moving = (struct canopy_moving){.count = count, .shape = malloc(count * sizeof *moving->shape)};
    if (!moving->shape) {
        return false;
    }
    moving->first = (size_t)((double)count * (0.3 + 0.4 * canopy_random_unit(&random)));
    double radius[2], direction[3];
    for (int cloud = 0; cloud < 2; cloud++) {
        radius[cloud] = 0.6 + 0.8 * canopy_random_unit(&random);
        draw_direction(&random, direction);
        for (int a = 0; a < 3; a++) {
            moving->centre[cloud][a] = (float)(cloud * (4.0 * canopy_random_unit(&random) - 2.0));
            moving->velocity[cloud][a] = (float)(SPEED * direction[a]);
        }
    }
    for (size_t i = 0; i < count; i++) {
        const double r = radius[i >= moving->first] * (1.0 + NOISE * draw_noise(&random));
        draw_direction(&random, direction);
        for (int a = 0; a < 3; a++) {
            moving->shape[i][a] = (float)(r * direction[a]);
        }
    }
    return true;
}

void canopy_moving_close(struct canopy_moving *moving) { free(moving->shape); }

bool canopy_moving_at(const struct canopy_moving *moving, unsigned step, struct canopy_device_list lists[2]) {
    for (int scalar = CANOPY_F32; scalar <= CANOPY_FX; scalar++) {
        lists[scalar].scalar = (enum canopy_scalar)scalar;
        lists[scalar].count = 0;
    }
    for (size_t i = 0; i < moving->count; i++) {
        const int cloud = i >= moving->first;
        union canopy_device_point f32, fx;
        for (int a = 0; a < 3; a++) {
            f32.f32[a] = moving->shape[i][a] + moving->centre[cloud][a] + (float)step * moving->velocity[cloud][a];
            fx.fx[a] = (int32_t)lrint((double)f32.f32[a] / CANOPY_MOVING_UNIT_FX);
        }
        if (!canopy_device_list_add(&lists[CANOPY_F32], &f32) || !canopy_device_list_add(&lists[CANOPY_FX], &fx)) {
            return false;
        }
    }
    return true;
}
