#include "lib/spline/bezier.h"

// numerator / denominator in Q30, to nearest; neither is negative.
static int32_t to_q30(uint32_t numerator, uint32_t denominator) {
    return (int32_t)((((uint64_t)numerator << 30) + denominator / 2) / denominator);
}

void canopy_bezier_weights(int32_t *table, uint16_t q) {
    const uint32_t unit = q, denominator = 6 * unit * unit * unit;
    for (uint32_t p = 0; p <= 3 * unit; p++, table += 3) {
        const uint32_t k = p / 3, late = p % 3;  // `late` arguments are k + 1, the others k
        const uint32_t a = late > 0 ? k + 1 : k, b = late > 1 ? k + 1 : k, c = k;
        const uint32_t sum = a + b + c, pairs = a * b + b * c + c * a, all = a * b * c;
        table[0] = to_q30((unit - a) * (unit - b) * (unit - c), denominator);
        table[1] = to_q30(unit * unit * unit + unit * unit * sum + unit * pairs - 3 * all, denominator);
        table[2] = to_q30(all, denominator);
    }
}
