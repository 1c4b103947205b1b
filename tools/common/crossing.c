#include "tools/common/crossing.h"

#include <float.h>
#include <gmp.h>
#include <limits.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tools/common/dyadic.h"

#define SIXTEEN 16
#define SPARE 64  // the distance is found to a 64th of it

// A number z stands for z * 2^exponent / weight: weight is that of the Bernstein form, and of every halving the three
// bits that it needs in each direction are there from the beginning, so that everything below is whole.

/// One surface, and what its coefficients are multiplied with to be whole.
struct whole {
    const struct canopy_surrogate *surrogate;
    int sign;
    mpz_t lsb;
    int coefficient_exponent;
    int exponent;  ///< of coefficient times lsb
};

struct search {
    struct whole side[2];
    int exponent;
    int level;                              ///< cells are 2^-level knot intervals
    mpz_t c[SIXTEEN], mixed[SIXTEEN], one;  ///< coefficients of a patch, mixed along u
    mpz_t value[CANOPY_CROSSING_HALVINGS + 1][SIXTEEN];
    mpz_t half[SIXTEEN];
    double corner[CANOPY_CROSSING_HALVINGS + 1][2];  ///< of the cell in knot intervals
    int child[CANOPY_CROSSING_HALVINGS + 1];
    mpz_t seen, enough, lowest;  ///< least value and least bound; cells with bounds from `enough` on are done
    bool any;
    double at[2];
};

// ---------------------------------------------------------------------------------------------------------------------
// Coefficients

static void open_whole(struct whole *w, const struct canopy_surrogate *s, int sign) {
    w->surrogate = s;
    w->sign = sign;
    int least = canopy_dyadic_exponent_of(s->coefficients, (size_t)s->size[0] * s->size[1]);
    for (size_t i = 0; i < s->window_count; i++) {
        const struct canopy_window *window = &s->windows[i];
        const int here = canopy_dyadic_exponent_of(window->coefficients, (size_t)window->size[0] * window->size[1]);
        least = here < least ? here : least;
    }
    w->coefficient_exponent = least < INT_MAX ? least : 0;
    const int exponent = canopy_dyadic_exponent(s->lsb);
    mpz_init(w->lsb);
    canopy_dyadic_set(w->lsb, s->lsb, exponent);
    w->exponent = w->coefficient_exponent + exponent;
}

// ---------------------------------------------------------------------------------------------------------------------
// The Bernstein form of a cell

/// Coefficients of one level: those of the surrogate, whose ends are repeated, or a window's, which end.
struct patch {
    const double *coefficients;
    int level;
    int32_t first[2];
    uint32_t size[2];
    bool ends;
};

/// Weight of b[h-1+i] in Bernstein coefficient p over the cell from k/q to (k+1)/q of knot interval h, times 6 q^3: the
/// blossom of the cubic at p arguments (k+1)/q and 3 - p arguments k/q.
static unsigned long weight_of(int k, int q, int p, int i) {
    const long a = k + (p > 0), b = k + (p > 1), c = k + (p > 2);
    const long sum = a + b + c, pairs = a * b + b * c + c * a, all = a * b * c;
    const long weights[4] = {(q - a) * (q - b) * (q - c), 4L * q * q * q - 2L * q * pairs + 3 * all,
                             q * ((long)q * q + q * sum + pairs) - 3 * all, all};
    return (unsigned long)weights[i];
}

/// The coefficient at an index that may be beyond the patch, times lsb.
static void take_coefficient(struct search *s, const struct whole *w, const struct patch *patch, int32_t i, int32_t j,
                             mpz_t to) {
    const int32_t m = (int32_t)patch->size[0], n = (int32_t)patch->size[1];
    if (patch->ends && (i < 0 || j < 0 || i >= m || j >= n)) {
        mpz_set_ui(to, 0);
        return;
    }
    i = i < 0 ? 0 : i < m ? i : m - 1;
    j = j < 0 ? 0 : j < n ? j : n - 1;
    canopy_dyadic_set(to, patch->coefficients[(size_t)i * patch->size[1] + (size_t)j], w->coefficient_exponent);
    mpz_mul(to, to, w->lsb);
    mpz_mul_2exp(to, to, (mp_bitcnt_t)(w->exponent - s->exponent));
    if (w->sign < 0) {
        mpz_neg(to, to);
    }
}

static int32_t divide_down(int32_t a, int32_t b) { return a >= 0 ? a / b : -((b - 1 - a) / b); }

/// Adds the patch's Bernstein coefficients over cell (u, v) of 2^-level to value[0]; 6^2 q^6 times, q = 2^level.
static void add_patch(struct search *s, const struct whole *w, const struct patch *patch, const int32_t cell[2]) {
    const int q = 1 << (s->level - patch->level);
    int32_t h[2];
    int k[2];
    for (int a = 0; a < 2; a++) {
        h[a] = divide_down(cell[a], q) - patch->first[a];
        k[a] = (int)(cell[a] - divide_down(cell[a], q) * q);
    }
    if (patch->ends && (h[0] < -2 || h[1] < -2 || h[0] > (int32_t)patch->size[0] || h[1] > (int32_t)patch->size[1])) {
        return;
    }
    for (int i = 0; i < SIXTEEN; i++) {
        take_coefficient(s, w, patch, h[0] + i / 4 - 1, h[1] + i % 4 - 1, s->c[i]);
    }
    for (int i = 0; i < SIXTEEN; i++) {  // Bernstein along u, coefficients along v
        mpz_set_ui(s->mixed[i], 0);
        for (int a = 0; a < 4; a++) {
            mpz_addmul_ui(s->mixed[i], s->c[4 * a + i % 4], weight_of(k[0], q, i / 4, a));
        }
    }
    for (int i = 0; i < SIXTEEN; i++) {
        mpz_set_ui(s->one, 0);
        for (int b = 0; b < 4; b++) {
            mpz_addmul_ui(s->one, s->mixed[i / 4 * 4 + b], weight_of(k[1], q, i % 4, b));
        }
        mpz_mul_2exp(s->one, s->one, 6 * (mp_bitcnt_t)patch->level);  // a coarser level's q is larger by 2^level
        mpz_add(s->value[0][i], s->value[0][i], s->one);
    }
}

static void make_cell(struct search *s, int32_t u, int32_t v) {
    const int32_t cell[2] = {u, v};
    for (int i = 0; i < SIXTEEN; i++) {
        mpz_set_ui(s->value[0][i], 0);
    }
    for (int side = 0; side < 2; side++) {
        const struct canopy_surrogate *of = s->side[side].surrogate;
        const struct patch base = {of->coefficients, 0, {0, 0}, {of->size[0], of->size[1]}, false};
        add_patch(s, &s->side[side], &base, cell);
        for (size_t i = 0; i < of->window_count; i++) {
            const struct canopy_window *w = &of->windows[i];
            const struct patch patch = {
                w->coefficients, w->level, {w->first[0], w->first[1]}, {w->size[0], w->size[1]}, true};
            add_patch(s, &s->side[side], &patch, cell);
        }
    }
    for (int i = 0; i < SIXTEEN; i++) {
        mpz_mul_2exp(s->value[0][i], s->value[0][i], 6 * CANOPY_CROSSING_HALVINGS);
    }
    s->corner[0][0] = ldexp(u, -s->level);
    s->corner[0][1] = ldexp(v, -s->level);
}

// ---------------------------------------------------------------------------------------------------------------------
// The search

static double width_at(const struct search *s, int depth) { return ldexp(1.0, -s->level - depth); }

/// Takes the values at the corners into account.
static void see_corners(struct search *s, int depth) {
    static const int CORNERS[4] = {0, 3, 12, 15};
    for (int k = 0; k < 4; k++) {
        const mpz_t *value = (const mpz_t *)&s->value[depth][CORNERS[k]];
        if (!s->any || mpz_cmp(*value, s->seen) < 0) {
            s->any = true;
            mpz_set(s->seen, *value);
            mpz_abs(s->enough, s->seen);
            mpz_fdiv_q_ui(s->enough, s->enough, SPARE);
            mpz_sub(s->enough, s->seen, s->enough);
            s->at[0] = s->corner[depth][0] + (k > 1 ? width_at(s, depth) : 0.0);
            s->at[1] = s->corner[depth][1] + (k % 2 == 1 ? width_at(s, depth) : 0.0);
        }
    }
}

/// Looks at a cell; true if it must be halved.
static bool look(struct search *s, int depth) {
    see_corners(s, depth);
    int least = 0;
    for (int i = 1; i < SIXTEEN; i++) {
        least = mpz_cmp(s->value[depth][i], s->value[depth][least]) < 0 ? i : least;
    }
    const mpz_t *bound = (const mpz_t *)&s->value[depth][least];
    if (depth < CANOPY_CROSSING_HALVINGS && mpz_cmp(*bound, s->enough) < 0) {
        return true;
    }
    if (mpz_cmp(*bound, s->lowest) < 0) {
        mpz_set(s->lowest, *bound);
    }
    return false;
}

/// Bernstein coefficients of one half of a cubic, de Casteljau; `step` from one to the next. Every division is exact.
static void halve(mpz_t *from, mpz_t *to, int step, bool right) {
    mpz_t *p[4], *q[4];
    for (int i = 0; i < 4; i++) {
        p[i] = from + step * (right ? 3 - i : i);
        q[i] = to + step * (right ? 3 - i : i);
    }
    mpz_set(*q[0], *p[0]);
    mpz_add(*q[1], *p[0], *p[1]);
    mpz_add(*q[2], *q[1], *p[1]);
    mpz_add(*q[2], *q[2], *p[2]);
    mpz_add(*q[3], *p[1], *p[2]);
    mpz_mul_ui(*q[3], *q[3], 3);
    mpz_add(*q[3], *q[3], *p[0]);
    mpz_add(*q[3], *q[3], *p[3]);
    for (int i = 1; i < 4; i++) {
        mpz_tdiv_q_2exp(*q[i], *q[i], (mp_bitcnt_t)i);
    }
}

static void make_child(struct search *s, int depth, int child) {
    for (int i = 0; i < 4; i++) {
        halve(&s->value[depth][i], &s->half[i], 4, child / 2 == 1);
    }
    for (int i = 0; i < 4; i++) {
        halve(&s->half[4 * i], &s->value[depth + 1][4 * i], 1, child % 2 == 1);
    }
    s->corner[depth + 1][0] = s->corner[depth][0] + (child > 1 ? width_at(s, depth + 1) : 0.0);
    s->corner[depth + 1][1] = s->corner[depth][1] + (child % 2 == 1 ? width_at(s, depth + 1) : 0.0);
}

static void search_cell(struct search *s, int32_t u, int32_t v) {
    make_cell(s, u, v);
    int depth = look(s, 0) ? 0 : -1;
    s->child[0] = 0;
    while (depth >= 0) {
        if (s->child[depth] == 4) {
            depth--;
            continue;
        }
        make_child(s, depth, s->child[depth]++);
        if (look(s, depth + 1)) {
            s->child[++depth] = 0;
        }
    }
}

/// The cell at whose first corner the surfaces are closest, about: a good one to begin with.
static void guess(const struct search *s, int32_t cell[2]) {
    const struct canopy_surrogate *a = s->side[0].surrogate, *b = s->side[1].surrogate;
    double closest = HUGE_VAL;
    for (uint32_t i = 0; i + 1 < a->size[0]; i++) {
        for (uint32_t j = 0; j + 1 < a->size[1]; j++) {
            const size_t at = (size_t)i * a->size[1] + j;
            const double distance = a->coefficients[at] * a->lsb - b->coefficients[at] * b->lsb;
            if (distance < closest) {
                closest = distance;
                cell[0] = (int32_t)(i << s->level);
                cell[1] = (int32_t)(j << s->level);
            }
        }
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// From surrogates to a verdict

static void open_search(struct search *s, const struct canopy_surrogate *above, const struct canopy_surrogate *below) {
    memset(s, 0, sizeof *s);
    open_whole(&s->side[0], above, 1);
    open_whole(&s->side[1], below, -1);
    s->exponent = s->side[0].exponent < s->side[1].exponent ? s->side[0].exponent : s->side[1].exponent;
    for (int side = 0; side < 2; side++) {
        for (size_t i = 0; i < s->side[side].surrogate->window_count; i++) {
            const int level = s->side[side].surrogate->windows[i].level;
            s->level = level > s->level ? level : s->level;
        }
    }
    for (int i = 0; i < SIXTEEN; i++) {
        mpz_inits(s->c[i], s->mixed[i], s->half[i], NULL);
        for (int depth = 0; depth <= CANOPY_CROSSING_HALVINGS; depth++) {
            mpz_init(s->value[depth][i]);
        }
    }
    mpz_inits(s->one, s->seen, s->enough, s->lowest, NULL);
}

static void close_search(struct search *s) {
    for (int i = 0; i < SIXTEEN; i++) {
        mpz_clears(s->c[i], s->mixed[i], s->half[i], NULL);
        for (int depth = 0; depth <= CANOPY_CROSSING_HALVINGS; depth++) {
            mpz_clear(s->value[depth][i]);
        }
    }
    mpz_clears(s->one, s->seen, s->enough, s->lowest, s->side[0].lsb, s->side[1].lsb, NULL);
}

/// What a number stands for, rounded down.
static double height_of(const struct search *s, const mpz_t z) {
    long exponent = 0;
    const double mantissa = mpz_get_d_2exp(&exponent, z);
    const double unit = 36.0 * ldexp(1.0, 6 * s->level);
    exponent += s->exponent - 6L * CANOPY_CROSSING_HALVINGS;
    exponent = exponent > 4000 ? 4000 : exponent < -4000 ? -4000 : exponent;
    const double height = ldexp(mantissa / unit, (int)exponent);
    return height - fabs(height) * 0x1p-50 - (height == 0.0 && mpz_sgn(z) < 0 ? DBL_TRUE_MIN : 0.0);
}

static bool are_comparable(const struct canopy_surrogate *above, const struct canopy_surrogate *below,
                           struct canopy_fault *fault) {
    if (above->side != CANOPY_ABOVE || below->side != CANOPY_BELOW) {
        return canopy_fault_set(fault, "both are surfaces %s the points: give one above and one below",
                                above->side == CANOPY_ABOVE ? "above" : "below");
    }
    bool same = above->unit == below->unit;
    for (int a = 0; a < 3; a++) {
        same = same && above->origin[a] == below->origin[a];
        same = same && (a == 2 || (above->pitch[a] == below->pitch[a] && above->size[a] == below->size[a]));
        for (int k = 0; k < 3; k++) {
            same = same && above->axes[a][k] == below->axes[a][k];
        }
    }
    return same || canopy_fault_set(fault, "the two differ in unit, frame or size: give two surrogates of one frame "
                                           "(canopy sandwich, or canopy fit --frame)");
}

bool canopy_crossing_find(const struct canopy_surrogate *above, const struct canopy_surrogate *below,
                          struct canopy_crossing *crossing, struct canopy_fault *fault) {
    if (!are_comparable(above, below, fault)) {
        return false;
    }
    struct search *s = malloc(sizeof *s);
    if (!s) {
        return canopy_fault_no_memory(fault);
    }
    open_search(s, above, below);
    int32_t first[2] = {0, 0};
    guess(s, first);
    make_cell(s, first[0], first[1]);
    see_corners(s, 0);
    mpz_set(s->lowest, s->seen);
    const int32_t rows = (int32_t)((above->size[0] - 1) << s->level),
                  columns = (int32_t)((above->size[1] - 1) << s->level);
    for (int32_t u = 0; u < rows; u++) {
        for (int32_t v = 0; v < columns; v++) {
            search_cell(s, u, v);
        }
    }
    crossing->verdict = mpz_sgn(s->seen) < 0     ? CANOPY_CROSSING_FOUND
                        : mpz_sgn(s->lowest) < 0 ? CANOPY_CROSSING_UNDECIDED
                                                 : CANOPY_CROSSING_NONE;
    crossing->distance = height_of(s, s->lowest);
    memcpy(crossing->at, s->at, sizeof crossing->at);
    close_search(s);
    free(s);
    return true;
}
