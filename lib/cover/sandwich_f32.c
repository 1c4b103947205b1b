#include "lib/cover/sandwich.h"

size_t canopy_sandwich_feed_f32(struct canopy_field *above, struct canopy_field *below, const float (*points)[3],
                                size_t count) {
    size_t refused = 0;
    for (size_t i = 0; i < count; i++) {
        struct canopy_field_hit hit;
        const enum canopy_status high = canopy_field_insert_f32(above, points[i], &hit);
        const enum canopy_status low = canopy_field_insert_f32(below, points[i], &hit);
        refused += high != CANOPY_OK || low != CANOPY_OK;
    }
    return refused;
}

enum canopy_status canopy_sandwich_over(struct canopy_tighten *tighten, int32_t *opposite, int32_t *mirror) {
    const size_t count = (size_t)tighten->frame.size[0] * tighten->frame.size[1];
    if (tighten->points == 0) {
        return CANOPY_EMPTY;
    }
    const int32_t reach = (int32_t)(1.875f * tighten->range);  // what canopy_tighten_over takes, and something to spare
    const int32_t most = tighten->low + reach, least = tighten->low - reach;
    for (size_t j = 0; j < count; j++) {
        opposite[j] = opposite[j] < -most ? -most : opposite[j];
        mirror[j] = -opposite[j] < least ? least : -opposite[j];  // a bound that is higher still keeps clear
    }
    return canopy_tighten_over(tighten, mirror);
}
