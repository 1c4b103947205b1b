#include "lib/num/product.h"

int64_t canopy_product_by_digits(int32_t a, int32_t b) {
    const uint32_t ua = (uint32_t)a, ub = (uint32_t)b;
    const uint32_t high = canopy_product_high_by_digits(ua, ub) - (a < 0 ? ub : 0) - (b < 0 ? ua : 0);
    return (int64_t)((uint64_t)high << 32 | ua * ub);
}
