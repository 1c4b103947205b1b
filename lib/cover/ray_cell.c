#include "lib/cover/ray_parts.h"
#include "lib/inline.h"
#include "lib/num/fixed.h"
#include "lib/num/wide.h"

#define ONE CANOPY_UNIT_Q30
#define FLOORS 8       // units that the floors of a composition may lose, and one that E's own may
#define TOLERANCE 16   // units: more than a root search's floors usually lose
#define SCALE_BITS 29  // what a cell's coefficients are scaled to
#define SCALE_MOST 12  // bits below a step

struct scaled {
    int32_t base;
    unsigned scale;
    int32_t error;  // units
};

CANOPY_INLINE uint32_t clamp(uint32_t one_too_far, uint32_t size) {
    const uint32_t i = one_too_far > 0 ? one_too_far - 1 : 0;
    return i < size ? i : size - 1;
}

CANOPY_INLINE int32_t least(int32_t a, int32_t b) { return a < b ? a : b; }
CANOPY_INLINE int32_t largest(int32_t a, int32_t b) { return a > b ? a : b; }

// The first of four along one axis that hold those around an interval: at the grid's edge one more than is needed.
CANOPY_INLINE uint32_t first_of_four(uint32_t interval, uint32_t size) {
    const uint32_t first = interval > 0 ? interval - 1 : 0;
    return first + 4 <= size ? first : size - 4;
}

// The largest or the smallest of the four by four that hold the 16. Written so that compilers make vectors of it.
CANOPY_INLINE int32_t extreme(const struct canopy_envelope *envelope, const uint32_t cell[2], bool smallest) {
    const uint32_t n = envelope->frame.size[1];
    const int32_t *row = envelope->coefficients + (size_t)first_of_four(cell[0], envelope->frame.size[0]) * n +
                         first_of_four(cell[1], n);
    int32_t found[4];
    for (uint32_t e = 0; e < 4; e++) {
        const int32_t a = row[e], b = row[n + e], c = row[2 * n + e], d = row[3 * n + e];
        const int32_t ab = smallest ? least(a, b) : largest(a, b), cd = smallest ? least(c, d) : largest(c, d);
        found[e] = smallest ? least(ab, cd) : largest(ab, cd);
    }
    return smallest ? least(least(found[0], found[1]), least(found[2], found[3]))
                    : largest(largest(found[0], found[1]), largest(found[2], found[3]));
}

// The coefficients themselves, the surface being below the ray, and their range.
struct patch {
    int32_t c[4][4];
    int32_t low, high;
};

static void gather(const struct canopy_envelope *envelope, const uint32_t cell[2], struct patch *patch) {
    const uint32_t m = envelope->frame.size[0], n = envelope->frame.size[1];
    const int32_t one = envelope->frame.side == CANOPY_BELOW ? -1 : 1;
    const uint32_t left = clamp(cell[1], n), middle = cell[1], right = cell[1] + 1, far = clamp(cell[1] + 3, n);
    patch->low = INT32_MAX;
    patch->high = INT32_MIN;
    for (uint32_t k = 0; k < 4; k++) {
        int32_t *c = patch->c[k];
        const int32_t *row = envelope->coefficients + (size_t)clamp(cell[0] + k, m) * n;
        c[0] = row[left] * one;
        c[1] = row[middle] * one;
        c[2] = row[right] * one;
        c[3] = row[far] * one;
        patch->low = least(patch->low, least(least(c[0], c[1]), least(c[2], c[3])));
        patch->high = largest(patch->high, largest(largest(c[0], c[1]), largest(c[2], c[3])));
    }
}

// In units above the base.
static void scale_up(struct patch *patch, const struct scaled *to) {
    const int32_t one = 1 << to->scale, base = to->base;
    for (uint32_t k = 0; k < 4; k++) {
        int32_t *c = patch->c[k];
        c[0] = (c[0] - base) * one;
        c[1] = (c[1] - base) * one;
        c[2] = (c[2] - base) * one;
        c[3] = (c[3] - base) * one;
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// Composition

CANOPY_INLINE int32_t mul(int32_t a, int32_t b) { return (int32_t)canopy_shift_floor(canopy_wide(a, b), 30); }

// Weights of one value of the blossom of the uniform cubic B-splines over [0, 1]: with e2 = xy + yz + zx, e3 = xyz and
// f3 = (1-x)(1-y)(1-z) they are f3/6, (4 - 2 e2 + 3 e3)/6, the rest to one, e3/6.
CANOPY_INLINE void weigh(int32_t e2_third, int32_t e3, int32_t f3, int32_t w[4]) {
    const int32_t two_thirds = 715827882;  // floor(2^30 * 2/3)
    w[0] = f3 / 6;
    w[1] = two_thirds - e2_third + e3 / 2;
    w[3] = e3 / 6;
    w[2] = ONE - w[0] - w[1] - w[3];
}

// Row k: the weights that give the Bezier point k of the stretch from a to b, blossom values (a,a,a) to (b,b,b).
static void stretch(int32_t a, int32_t b, int32_t w[4][4]) {
    const int32_t aa = mul(a, a), ab = mul(a, b), bb = mul(b, b);
    const int32_t p = ONE - a, q = ONE - b, pp = mul(p, p), qq = mul(q, q);
    weigh(aa, mul(aa, a), mul(pp, p), w[0]);
    weigh((int32_t)(((int64_t)aa + 2 * (int64_t)ab) / 3), mul(aa, b), mul(pp, q), w[1]);
    weigh((int32_t)(((int64_t)bb + 2 * (int64_t)ab) / 3), mul(bb, a), mul(qq, p), w[2]);
    weigh(bb, mul(bb, b), mul(qq, q), w[3]);
}

// sum w[i] c[i], taken from c1 because the weights sum to one; the differences fit: |c| <= 2^29.
CANOPY_INLINE int32_t mix(int32_t c0, int32_t c1, int32_t c2, int32_t c3, const int32_t w[4]) {
    const int64_t rise = canopy_wide(c0 - c1, w[0]) + canopy_wide(c2 - c1, w[2]) + canopy_wide(c3 - c1, w[3]);
    return c1 + (int32_t)canopy_shift_floor(rise, 30);
}

// Bernstein coefficients, degree 6, of the surface along the diagonal of the piece's box.
static void compose(int32_t c[4][4], const struct canopy_ray_piece *piece, int32_t s[7]) {
    int32_t wu[4][4], wv[4][4], y[4][4];
    stretch(piece->from[0], piece->to[0], wu);
    stretch(piece->from[1], piece->to[1], wv);
    for (uint32_t k = 0; k < 4; k++) {
        const int32_t x0 = mix(c[0][0], c[1][0], c[2][0], c[3][0], wu[k]);
        const int32_t x1 = mix(c[0][1], c[1][1], c[2][1], c[3][1], wu[k]);
        const int32_t x2 = mix(c[0][2], c[1][2], c[2][2], c[3][2], wu[k]);
        const int32_t x3 = mix(c[0][3], c[1][3], c[2][3], c[3][3], wu[k]);
        y[k][0] = mix(x0, x1, x2, x3, wv[0]);
        y[k][1] = mix(x0, x1, x2, x3, wv[1]);
        y[k][2] = mix(x0, x1, x2, x3, wv[2]);
        y[k][3] = mix(x0, x1, x2, x3, wv[3]);
    }
    const int32_t fifth = 214748365, twentieth = 53687091;  // of 2^30, to nearest
    const int32_t three_fifths = ONE - 2 * fifth, nine_twentieths = ONE / 2 - twentieth;
    s[0] = y[0][0];
    s[1] = (y[0][1] + y[1][0]) >> 1;
    s[2] = (int32_t)((((int64_t)y[0][2] + y[2][0]) * fifth + canopy_wide(y[1][1], three_fifths)) >> 30);
    s[3] = (int32_t)((((int64_t)y[0][3] + y[3][0]) * twentieth + ((int64_t)y[1][2] + y[2][1]) * nine_twentieths) >> 30);
    s[4] = (int32_t)((((int64_t)y[1][3] + y[3][1]) * fifth + canopy_wide(y[2][2], three_fifths)) >> 30);
    s[5] = (y[2][3] + y[3][2]) >> 1;
    s[6] = y[3][3];
}

// ---------------------------------------------------------------------------------------------------------------------
// A piece

static int64_t lerp(int64_t from, int64_t to, int32_t s) {
    const uint64_t size = (uint64_t)(to > from ? to - from : from - to);
    const int64_t part = (int64_t)canopy_mul_div(size, (uint64_t)s, ONE);
    return to > from ? from + part : from - part;
}

static int32_t between(int32_t from, int32_t to, int32_t s) {
    return from + (int32_t)canopy_shift_floor(canopy_wide(to - from, s), 30);
}

// The part of the piece from `a` to `b`, Q30.
static void cut(struct canopy_ray_piece *piece, int32_t a, int32_t b) {
    const struct canopy_ray_piece whole = *piece;
    for (int i = 0; i < 2; i++) {
        piece->from[i] = between(whole.from[i], whole.to[i], a);
        piece->to[i] = between(whole.from[i], whole.to[i], b);
    }
    piece->height[0] = lerp(whole.height[0], whole.height[1], a);
    piece->height[1] = lerp(whole.height[0], whole.height[1], b);
}

// The share of a piece after which a ray that falls (or rises) by `all` has done `part` of it: rounded down, Q30.
CANOPY_INLINE int32_t share(int64_t part, uint64_t all) { return (int32_t)canopy_mul_div((uint64_t)part, ONE, all); }

// Leaves away what is surely above the cell's coefficients, and what follows after the ray has come below all of them.
// It starts above bottom, and one of its ends is not above top.
static void shorten(struct canopy_ray_piece *piece, int64_t top, int64_t bottom) {
    const int64_t from = piece->height[0], to = piece->height[1];
    const uint64_t all = (uint64_t)(from > to ? from - to : to - from);
    int32_t a = 0, b = ONE;
    if (from > top) {
        a = share(from - top, all);
    }
    if (to < bottom) {
        b = share(from - bottom, all);
    } else if (to > top) {
        b = share(top - from, all);
    }
    if (a > 0 || b < ONE) {
        cut(piece, a, b < ONE ? b + 1 : b);
    }
}

CANOPY_INLINE int64_t in_q20(int32_t steps) { return (int64_t)steps * (1 << CANOPY_RAY_HEIGHT_BITS); }

static int32_t to_units(int64_t height_q20, const struct scaled *to) {
    const int64_t above = height_q20 - in_q20(to->base);
    return (int32_t)canopy_shift_floor(above, CANOPY_RAY_HEIGHT_BITS - to->scale);
}

// p = the ray less the surface less the error bound: Bernstein coefficients. Returns the largest in size.
static int32_t distance(int32_t c[4][4], const struct canopy_ray_piece *piece, const struct scaled *to, int32_t p[7]) {
    static const int32_t sixth[7] = {0, 178956970, 357913941, 536870912, 715827882, 894784853, ONE};
    int32_t s[7], most = 0;
    compose(c, piece, s);
    const int32_t start = to_units(piece->height[0], to);
    const int64_t rise = (int64_t)to_units(piece->height[1], to) - start;
    for (uint32_t k = 0; k < 7; k++) {
        p[k] = start + (int32_t)canopy_shift_floor(rise * sixth[k], 30) - s[k] - to->error;
        most = largest(most, p[k] < 0 ? -p[k] : p[k]);
    }
    return most;
}

static enum canopy_ray_meeting meet(const struct canopy_ray_piece *piece, int32_t s, struct canopy_ray_found *found) {
    found->at_start = s == 0;
    found->settled = true;
    found->place[0] = between(piece->from[0], piece->to[0], s);
    found->place[1] = between(piece->from[1], piece->to[1], s);
    found->height = lerp(piece->height[0], piece->height[1], s);
    return CANOPY_RAY_MET;
}

// Bits by which a patch is scaled up so that what is in its reach takes SCALE_BITS.
static unsigned scale_of(uint32_t reach) {
    unsigned scale = 0;
    while (scale < SCALE_MOST && reach >> (SCALE_BITS - 1 - scale) == 0) {
        scale++;
    }
    return scale;
}

// The first zero in what is left of a piece between top and bottom.
static enum canopy_ray_meeting search(struct patch *patch, const struct scaled *to,
                                      const struct canopy_ray_piece *piece, struct canopy_ray_found *found) {
    int32_t p[7];
    scale_up(patch, to);
    const int32_t most = distance(patch->c, piece, to, p);
    const struct canopy_root root = canopy_root_first(p, 6, (most >> 23) + TOLERANCE);
    found->steps = root.steps > found->steps ? root.steps : found->steps;
    if (!root.found) {
        return CANOPY_RAY_NOT_MET;
    }
    (void)meet(piece, root.at, found);
    found->settled = root.settled;
    return CANOPY_RAY_MET;
}

// Whether the piece is surely above the cell's coefficients: the quick answer of most cells.
CANOPY_INLINE bool is_above(const struct canopy_envelope *envelope, const struct canopy_ray_piece *piece,
                            int64_t lower) {
    const int64_t high = envelope->frame.side == CANOPY_BELOW ? -(int64_t)extreme(envelope, piece->cell, true)
                                                              : extreme(envelope, piece->cell, false);
    return high <= CANOPY_COEFFICIENT_LIMIT && lower - piece->most_q20 > high * (1 << CANOPY_RAY_HEIGHT_BITS);
}

enum canopy_ray_meeting canopy_ray_in_cell(const struct canopy_envelope *envelope, const struct canopy_ray_piece *piece,
                                           struct canopy_ray_found *found) {
    const int64_t lower = piece->height[0] < piece->height[1] ? piece->height[0] : piece->height[1];
    if (is_above(envelope, piece, lower)) {
        return CANOPY_RAY_NOT_MET;
    }
    if (extreme(envelope, piece->cell, true) < -CANOPY_COEFFICIENT_LIMIT ||
        extreme(envelope, piece->cell, false) > CANOPY_COEFFICIENT_LIMIT) {
        return CANOPY_RAY_BAD_CELL;
    }
    struct patch patch;
    gather(envelope, piece->cell, &patch);
    const uint32_t range = (uint32_t)(patch.high - patch.low);
    const int64_t error = (int64_t)((range * piece->kappa_q40 >> 20) + piece->fixed_q20 + 1);
    const int64_t top = in_q20(patch.high) + error, bottom = in_q20(patch.low - 1);
    if (lower > top) {
        return CANOPY_RAY_NOT_MET;
    }
    if (piece->height[0] <= bottom) {
        return meet(piece, 0, found);
    }
    struct scaled to = {.base = patch.low + (int32_t)(range / 2),
                        .scale = scale_of(range + 4 + (uint32_t)(error >> (CANOPY_RAY_HEIGHT_BITS - 1)))};
    to.error = (int32_t)(error >> (CANOPY_RAY_HEIGHT_BITS - to.scale)) + 1 + FLOORS;
    if (piece->height[0] <= top && piece->height[1] <= top && piece->height[1] >= bottom) {
        return search(&patch, &to, piece, found);
    }
    struct canopy_ray_piece shorter = *piece;
    shorten(&shorter, top + 1, bottom);
    const enum canopy_ray_meeting met = search(&patch, &to, &shorter, found);
    found->at_start = found->at_start && piece->height[0] <= top;
    return met;
}
