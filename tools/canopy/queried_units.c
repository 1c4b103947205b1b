// Answers in input units: computed in rational numbers, rounded outward once.

#include <math.h>

#include "tools/canopy/queried_parts.h"

double canopy_queried_round(const mpq_t x, bool upward) {
    const double truncated = mpq_get_d(x);
    mpq_t back;
    mpq_init(back);
    mpq_set_d(back, truncated);
    const int sign = mpq_cmp(x, back);
    mpq_clear(back);
    if (upward) {
        return sign > 0 ? nextafter(truncated, HUGE_VAL) : truncated;
    }
    return sign < 0 ? nextafter(truncated, -HUGE_VAL) : truncated;
}

void canopy_queried_add_product(mpq_t sum, double a, double b) {
    mpq_t x, y;
    mpq_inits(x, y, NULL);
    mpq_set_d(x, a);
    mpq_set_d(y, b);
    mpq_mul(x, x, y);
    mpq_add(sum, sum, x);
    mpq_clears(x, y, NULL);
}

void canopy_queried_multiply(mpq_t x, double by) {
    mpq_t y;
    mpq_init(y);
    mpq_set_d(y, by);
    mpq_mul(x, x, y);
    mpq_clear(y);
}

void canopy_queried_origin(mpq_t sum, const struct canopy_surrogate *s, int axis) {
    mpq_set_ui(sum, 0, 1);
    for (int k = 0; k < 3; k++) {
        canopy_queried_add_product(sum, s->axes[axis][k], s->origin[k]);
    }
}

double canopy_queried_height(const struct canopy_queried *queried, int64_t steps, double step, bool from_zero,
                             bool upward) {
    const struct canopy_surrogate *s = &queried->surrogate;
    mpq_t sum;
    mpq_init(sum);
    if (from_zero) {
        canopy_queried_origin(sum, s, 2);
    }
    canopy_queried_add_product(sum, (double)steps, step);  // |steps| < 2^53
    canopy_queried_multiply(sum, s->unit);
    const double height = canopy_queried_round(sum, upward);
    mpq_clear(sum);
    return height;
}

void canopy_queried_place(const struct canopy_queried *queried, const uint32_t at[2], double place[2]) {
    const struct canopy_surrogate *s = &queried->surrogate;
    mpq_t sum;
    mpq_init(sum);
    for (int axis = 0; axis < 2; axis++) {
        canopy_queried_origin(sum, s, axis);
        canopy_queried_add_product(sum, (double)at[axis] / CANOPY_QUERIED_PITCH, s->pitch[axis]);
        canopy_queried_multiply(sum, s->unit);
        place[axis] = mpq_get_d(sum);
    }
    mpq_clear(sum);
}
