#include "lib/spline/roots.h"

#include "lib/inline.h"
#include "lib/num/fixed.h"

// de Casteljau, one level after the other; what leaves at the left end is the left half.
CANOPY_INLINE void split(int32_t *c, int32_t *left, uint32_t degree, int32_t x) {
    left[0] = c[0];
    for (uint32_t level = 1; level <= degree; level++) {
        for (uint32_t k = 0; k + level <= degree; k++) {
            c[k] += (int32_t)canopy_shift_floor(((int64_t)c[k + 1] - c[k]) * x, 30);
        }
        left[level] = c[0];
    }
}

void canopy_root_split(int32_t *c, int32_t *left, uint32_t degree, int32_t x) { split(c, left, degree, x); }

CANOPY_INLINE bool is_positive(const int32_t *c, uint32_t degree) {
    int32_t least = c[0];
    for (uint32_t k = 1; k <= degree; k++) {
        least = c[k] < least ? c[k] : least;
    }
    return least > 0;
}

// Where the control polygon first comes down to `level`, Q30; c[0] is above it, some other is not.
CANOPY_INLINE int32_t polygon_zero(const int32_t *c, uint32_t degree, int32_t level) {
    uint32_t k = 1;
    while (k < degree && c[k] > level) {
        k++;
    }
    const int64_t drop = (int64_t)c[k - 1] - c[k], above = (int64_t)c[k - 1] - level;
    return (int32_t)((((int64_t)(k - 1) << 30) + (above << 30) / drop) / degree);
}

struct search {
    const int32_t *whole;
    uint32_t degree;
    int32_t a, b;  // Q30, off by a unit a step at most
    bool slow;     // the last step came nearer to a zero, but not as it would to a simple one
    int32_t c[CANOPY_ROOT_DEGREE_MAX + 1], left[CANOPY_ROOT_DEGREE_MAX + 1];
};

CANOPY_INLINE void take(struct search *s, const int32_t *from) {
    for (uint32_t k = 0; k <= s->degree; k++) {
        s->c[k] = from[k];
    }
}

// p > 0 up to b: goes on from there, or from as much before as b may be off. False: b was the end.
CANOPY_INLINE bool pass(struct search *s) {
    if (s->b == CANOPY_ROOT_ONE) {
        return false;
    }
    s->a = s->b > CANOPY_ROOT_STEPS ? s->b - CANOPY_ROOT_STEPS : 0;
    s->b = CANOPY_ROOT_ONE;
    take(s, s->whole);
    split(s->c, s->left, s->degree, s->a);
    return true;
}

// Splits at the polygon's zero; after a slow step, twice as far: to a double zero that is where it is, and a double
// that is none is passed sooner.
CANOPY_INLINE void narrow(struct search *s, int32_t level) {
    const int32_t near = polygon_zero(s->c, s->degree, level), before = s->c[0];
    const int32_t x = !s->slow ? near : near < CANOPY_ROOT_ONE / 3 ? 2 * near : near / 2 + CANOPY_ROOT_ONE / 2;
    const int32_t middle = s->a + (int32_t)canopy_shift_floor(canopy_wide(s->b - s->a, x), 30);
    split(s->c, s->left, s->degree, x);
    if (is_positive(s->left, s->degree)) {
        s->slow = !s->slow && s->c[0] > before / 6;
        s->a = middle;
    } else {
        s->slow = false;
        s->b = middle;
        take(s, s->left);
    }
}

CANOPY_INLINE struct canopy_root first(const int32_t *c, uint32_t degree, int32_t tolerance) {
    struct search s = {.whole = c, .degree = degree, .b = CANOPY_ROOT_ONE};
    struct canopy_root root = {0};
    take(&s, c);
    while (s.c[0] > tolerance || is_positive(s.c, degree)) {
        if (is_positive(s.c, degree)) {
            if (!pass(&s)) {
                return root;
            }
            root.steps++;  // the split of the whole
            if (s.c[0] <= 0) {
                break;
            }
        } else {
            narrow(&s, tolerance / 2);
            root.steps++;
        }
        if (root.steps >= CANOPY_ROOT_STEPS) {
            break;
        }
    }
    root.found = true;
    root.settled = s.c[0] <= tolerance;
    root.value = s.c[0];
    root.at = s.a > root.steps ? s.a - root.steps : 0;
    return root;
}

struct canopy_root canopy_root_first(const int32_t *c, uint32_t degree, int32_t tolerance) {
#ifndef __OPTIMIZE_SIZE__
    if (degree == 6) {  // what rays ask for: loops of known length
        return first(c, 6, tolerance);
    }
#endif
    return first(c, degree, tolerance);
}
