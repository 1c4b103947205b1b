#include "lib/cover/free.h"

#include "lib/num/bits.h"
#include "lib/num/fixed.h"

// ---- What is seen

// Whether one of the knot cells that (i, j) shapes is covered: cells i - 2 … i + 1, j - 2 … j + 1. It ends at the
// first.
static bool is_seen(const uint16_t size[2], const uint8_t *coverage, uint32_t i, uint32_t j) {
    const uint32_t down = size[0] - 1U, across = size[1] - 1U;
    const uint32_t h1 = i + 2 < down ? i + 2 : down, w0 = j > 2 ? j - 2 : 0, w1 = j + 2 < across ? j + 2 : across;
    for (uint32_t h = i > 2 ? i - 2 : 0; h < h1; h++) {
        for (uint32_t w = w0; w < w1; w++) {
            if (canopy_bit_get(coverage, h * across + w)) {
                return true;
            }
        }
    }
    return false;
}

void canopy_free_see(const uint16_t size[2], const uint8_t *coverage, uint8_t *seen) {
    uint32_t bit = 0;
    for (uint32_t i = 0; i < size[0]; i++) {
        for (uint32_t j = 0; j < size[1]; j++, bit++) {
            if (is_seen(size, coverage, i, j)) {
                (void)canopy_bit_set(seen, bit);
            } else {
                canopy_bit_clear(seen, bit);
            }
        }
    }
}

// ---- Nearest

// Of a gap first … end - 1 in `count` things: which of the two beside it is nearer to k, the first where both are.
static uint32_t nearer(uint32_t first, uint32_t end, uint32_t count, uint32_t k) {
    const bool next = first == 0 || (end < count && end - k < k - (first - 1));
    return next ? end : first - 1;
}

// Fills rows first … end - 1 of column j, of which none is marked.
static void fill_rows(const struct canopy_free *work, uint32_t j, uint32_t first, uint32_t end) {
    const uint32_t m = work->size[0], n = work->size[1];
    for (uint32_t i = first; i < end; i++) {
        work->b[i * n + j] = work->b[nearer(first, end, m, i) * n + j];
    }
}

// Fills the unmarked coefficients of column j; false if it has no other.
static bool fill_column(const struct canopy_free *work, uint32_t j) {
    const uint32_t m = work->size[0], n = work->size[1];
    uint32_t end = 0;  // of the rows that are filled
    for (uint32_t i = 0; i < m; i++) {
        if (canopy_bit_get(work->seen, i * n + j)) {
            fill_rows(work, j, end, i);
            end = i + 1;
        }
    }
    if (end > 0) {
        fill_rows(work, j, end, m);
    }
    return end > 0;
}

static void copy_column(const struct canopy_free *work, uint32_t from, uint32_t to) {
    const uint32_t m = work->size[0], n = work->size[1];
    for (uint32_t i = 0; i < m; i++) {
        work->b[i * n + to] = work->b[i * n + from];
    }
}

// Fills columns first … end - 1, in which nothing is marked.
static void fill_columns(const struct canopy_free *work, uint32_t first, uint32_t end) {
    const uint32_t n = work->size[1];
    for (uint32_t j = first; j < end; j++) {
        copy_column(work, nearer(first, end, n, j), j);
    }
}

static void fill_nearest(const struct canopy_free *work) {
    const uint32_t n = work->size[1];
    uint32_t end = 0;  // of the columns that are filled
    for (uint32_t j = 0; j < n; j++) {
        if (fill_column(work, j)) {
            fill_columns(work, end, j);
            end = j + 1;
        }
    }
    fill_columns(work, end, n);
}

// ---- Relaxation

#define OVER_RELAXATION ((int32_t)(1.625 * (1 << 16)))  // of 1 to 2, for gaps of some ten coefficients

// Towards the mean of the neighbours there are: an end repeated outside pulls at itself, which is nothing.
static int64_t pull_straight(const struct canopy_free *work, uint32_t i, uint32_t j, int32_t *step) {
    static const int32_t steps[5] = {0, OVER_RELAXATION, OVER_RELAXATION / 2, OVER_RELAXATION / 3, OVER_RELAXATION / 4};
    const uint32_t m = work->size[0], n = work->size[1];
    const int32_t *b = work->b + (size_t)i * n + j;
    const int32_t here = *b;
    int64_t pull = 0;
    uint32_t count = 0;
    if (i > 0) {
        pull += b[-(ptrdiff_t)n] - here;
        count++;
    }
    if (i + 1 < m) {
        pull += b[n] - here;
        count++;
    }
    if (j > 0) {
        pull += b[-1] - here;
        count++;
    }
    if (j + 1 < n) {
        pull += b[1] - here;
        count++;
    }
    *step = steps[count];
    return pull;
}

// The second difference at k of `count` coefficients that stand `stride` apart; b is the one at k.
static int64_t second(const int32_t *b, uint32_t count, size_t stride, uint32_t k) {
    const int32_t here = *b, before = k > 0 ? *(b - stride) : here, after = k + 1 < count ? b[stride] : here;
    return (int64_t)before - 2 * (int64_t)here + after;
}

// What coefficient k has to do with the energy of the second differences at k - 1, k and k + 1: minus half its slope.
static int64_t pull_along(const int32_t *b, uint32_t count, size_t stride, uint32_t k, int32_t *stiffness) {
    const int32_t own = -2 + (k == 0) + (k + 1 == count);
    int64_t slope = own * second(b, count, stride, k);
    *stiffness += own * own;
    if (k > 0) {
        slope += second(b - stride, count, stride, k - 1);
        (*stiffness)++;
    }
    if (k + 1 < count) {
        slope += second(b + stride, count, stride, k + 1);
        (*stiffness)++;
    }
    return -slope;
}

// The mixed second differences of the four squares of coefficients around (i, j).
static int64_t pull_across(const struct canopy_free *work, uint32_t i, uint32_t j, int32_t *stiffness) {
    const uint32_t m = work->size[0], n = work->size[1];
    int64_t slope = 0;
    for (uint32_t p = i > 0 ? i - 1 : 0; p <= i && p + 1 < m; p++) {
        for (uint32_t q = j > 0 ? j - 1 : 0; q <= j && q + 1 < n; q++) {
            const int32_t *b = work->b + (size_t)p * n + q;
            const int64_t twist = (int64_t)b[0] - b[1] - b[n] + b[n + 1];
            slope += (p == i) == (q == j) ? twist : -twist;
            *stiffness += 2;
        }
    }
    return -2 * slope;
}

static int64_t pull_bent(const struct canopy_free *work, uint32_t i, uint32_t j, int32_t *step) {
    const int32_t *b = work->b + (size_t)i * work->size[1] + j;
    int32_t stiffness = 0;
    const int64_t pull = pull_along(b, work->size[0], work->size[1], i, &stiffness) +
                         pull_along(b, work->size[1], 1, j, &stiffness) + pull_across(work, i, j, &stiffness);
    *step = OVER_RELAXATION / stiffness;
    return pull;
}

// Moves one coefficient. Coefficients within 2^28 pull by less than 2^34, so the product has at most 52 bits.
static void relax(struct canopy_free *work, uint32_t i, uint32_t j) {
    int32_t step = 0;
    const int64_t pull = work->pull(work, i, j, &step);
    const int64_t by = canopy_shift_floor(pull * step + (1 << 15), 16);
    int32_t *b = work->b + (size_t)i * work->size[1] + j;
    const int64_t to = *b + by;
    const int32_t now = to < work->low ? work->low : to > work->high ? work->high : (int32_t)to;
    const int32_t moved = now > *b ? now - *b : *b - now;
    work->moved = moved > work->moved ? moved : work->moved;
    *b = now;
}

// Most coefficients are marked: eight marks are passed at a time.
static void relax_row(struct canopy_free *work, uint32_t i) {
    const uint32_t n = work->size[1], first = i * n;
    for (uint32_t j = 0; j < n; j++) {
        const uint32_t marks = (uint32_t)work->seen[(first + j) / 8] >> ((first + j) % 8);
        if ((marks & 1U) == 0) {
            relax(work, i, j);
        } else if (marks == UINT8_MAX) {
            j += 7;
        }
    }
}

static void set_rule(struct canopy_free *work, canopy_free_pull pull, uint16_t sweeps, unsigned precision) {
    work->pull = pull;
    work->most = sweeps;
    work->enough = (int32_t)(((int64_t)work->high - work->low) >> precision);
    work->sweeps = 0;
    work->row = 0;
    work->moved = INT32_MAX;
}

void canopy_free_straighten(struct canopy_free *work) { set_rule(work, pull_straight, CANOPY_FREE_SWEEPS, 10); }

void canopy_free_bend(struct canopy_free *work) { set_rule(work, pull_bent, CANOPY_FREE_BENT_SWEEPS, 16); }

enum canopy_status canopy_free_begin(struct canopy_free *work, const uint16_t size[2], const uint8_t *seen,
                                     int32_t *b) {
    const uint32_t count = (uint32_t)size[0] * size[1];
    int32_t low = INT32_MAX, high = INT32_MIN;
    for (uint32_t k = 0; k < count; k++) {
        if (canopy_bit_get(seen, k)) {
            low = b[k] < low ? b[k] : low;
            high = b[k] > high ? b[k] : high;
        }
    }
    if (low > high) {
        return CANOPY_EMPTY;
    }
    *work = (struct canopy_free){.b = b, .seen = seen, .size = {size[0], size[1]}, .low = low, .high = high};
    fill_nearest(work);
    return CANOPY_OK;
}

enum canopy_status canopy_free_step(struct canopy_free *work, uint32_t budget) {
    const uint32_t m = work->size[0], n = work->size[1], rows = n < CANOPY_FREE_UNIT ? CANOPY_FREE_UNIT / n : 1;
    for (uint64_t left = (uint64_t)budget * rows; left > 0; left--) {
        if (work->row == 0) {
            if (work->moved <= work->enough || work->sweeps == work->most) {
                return CANOPY_OK;
            }
            work->sweeps++;
            work->moved = 0;
        }
        relax_row(work, work->row);
        work->row = (uint16_t)(work->row + 1U < m ? work->row + 1U : 0);
    }
    return CANOPY_MORE;
}
