// Every double is a whole number times a power of two. Bringing each kind of quantity to one common exponent leaves
//
//     u = Q0 / Pu,  v = Q1 / Pv     with whole Q, P > 0
//     s = R / P,  R = Q - cell P    and the B-spline weights whole numbers over 6 P^3
//
// so that   margin * 36 Pu^3 Pv^3   is a sum of products of whole numbers, whose sign GMP gives without a division.
// A window of level k has 2^k u - i0 = (2^k Q0 - i0 Pu) / Pu: the same denominators.

#include "tools/common/rational.h"

#include <float.h>
#include <gmp.h>
#include <limits.h>
#include <math.h>
#include <stdlib.h>

#include "tools/common/dyadic.h"

struct canopy_rational {
    const struct canopy_surrogate *surrogate;
    int pitch_exponent;
    int axis_exponent;
    int coefficient_exponent;
    mpz_t axes[3][3];
    mpz_t pitch[2];
    mpz_t lsb;
    int lsb_exponent;
    // of the present point
    int height_exponent;
    mpz_t numerator[3];    ///< Q0, Q1 over denominator; Q2 times 2^height_exponent
    mpz_t denominator[2];  ///< Pu, Pv
    mpz_t weights[2][4];
    mpz_t total;
    mpz_t a, b, c, d;
};

#define EACH_NUMBER(r, f)                                                                                              \
    do {                                                                                                               \
        for (int each_i = 0; each_i < 3; each_i++) {                                                                   \
            f((r)->axes[each_i][0]);                                                                                   \
            f((r)->axes[each_i][1]);                                                                                   \
            f((r)->axes[each_i][2]);                                                                                   \
            f((r)->numerator[each_i]);                                                                                 \
        }                                                                                                              \
        for (int each_i = 0; each_i < 2; each_i++) {                                                                   \
            f((r)->pitch[each_i]);                                                                                     \
            f((r)->denominator[each_i]);                                                                               \
            for (int each_j = 0; each_j < 4; each_j++) {                                                               \
                f((r)->weights[each_i][each_j]);                                                                       \
            }                                                                                                          \
        }                                                                                                              \
        f((r)->lsb);                                                                                                   \
        f((r)->total);                                                                                                 \
        f((r)->a);                                                                                                     \
        f((r)->b);                                                                                                     \
        f((r)->c);                                                                                                     \
        f((r)->d);                                                                                                     \
    } while (0)

/// Multiplies one of two numbers with exponents so that both have the lower one, which is returned.
static int align(mpz_t x, int x_exponent, mpz_t y, int y_exponent) {
    if (x_exponent >= y_exponent) {
        mpz_mul_2exp(x, x, (mp_bitcnt_t)(x_exponent - y_exponent));
        return y_exponent;
    }
    mpz_mul_2exp(y, y, (mp_bitcnt_t)(y_exponent - x_exponent));
    return x_exponent;
}

struct canopy_rational *canopy_rational_open(const struct canopy_surrogate *surrogate) {
    struct canopy_rational *r = calloc(1, sizeof *r);
    if (!r) {
        return NULL;
    }
    EACH_NUMBER(r, mpz_init);
    r->surrogate = surrogate;
    r->axis_exponent = canopy_dyadic_exponent_of(&surrogate->axes[0][0], 9);
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            canopy_dyadic_set(r->axes[i][j], surrogate->axes[i][j], r->axis_exponent);
        }
    }
    r->pitch_exponent = canopy_dyadic_exponent_of(surrogate->pitch, 2);
    canopy_dyadic_set(r->pitch[0], surrogate->pitch[0], r->pitch_exponent);
    canopy_dyadic_set(r->pitch[1], surrogate->pitch[1], r->pitch_exponent);
    r->lsb_exponent = canopy_dyadic_exponent(surrogate->lsb);
    canopy_dyadic_set(r->lsb, surrogate->lsb, r->lsb_exponent);
    int least = canopy_dyadic_exponent_of(surrogate->coefficients, (size_t)surrogate->size[0] * surrogate->size[1]);
    for (size_t i = 0; i < surrogate->window_count; i++) {
        const struct canopy_window *w = &surrogate->windows[i];
        const int now = canopy_dyadic_exponent_of(w->coefficients, (size_t)w->size[0] * w->size[1]);
        least = now < least ? now : least;
    }
    r->coefficient_exponent = least == INT_MAX ? 0 : least;
    return r;
}

void canopy_rational_close(struct canopy_rational *rational) {
    if (rational) {
        EACH_NUMBER(rational, mpz_clear);
        free(rational);
    }
}

/// Q0/Pu, Q1/Pv and Q2 of a point.
static void locate(struct canopy_rational *r, const double point[3]) {
    const int of_point = canopy_dyadic_exponent_of(point, 3);
    const int of_origin = canopy_dyadic_exponent_of(r->surrogate->origin, 3);
    const int common = of_point < of_origin ? of_point : of_origin;
    const int exponent = common == INT_MAX ? 0 : common;
    for (int i = 0; i < 3; i++) {
        mpz_set_ui(r->numerator[i], 0);
    }
    for (int k = 0; k < 3; k++) {
        canopy_dyadic_set(r->a, point[k], exponent);
        canopy_dyadic_set(r->b, r->surrogate->origin[k], exponent);
        mpz_sub(r->a, r->a, r->b);
        for (int i = 0; i < 3; i++) {
            mpz_addmul(r->numerator[i], r->axes[i][k], r->a);
        }
    }
    r->height_exponent = exponent + r->axis_exponent;
    for (int i = 0; i < 2; i++) {
        mpz_set(r->denominator[i], r->pitch[i]);
        align(r->numerator[i], r->height_exponent, r->denominator[i], r->pitch_exponent);
    }
}

static bool is_inside(struct canopy_rational *r) {
    for (int i = 0; i < 2; i++) {
        mpz_mul_ui(r->a, r->denominator[i], r->surrogate->size[i] - 1);
        if (mpz_sgn(r->numerator[i]) < 0 || mpz_cmp(r->numerator[i], r->a) > 0) {
            return false;
        }
    }
    return true;
}

/// The knot cell of a located point inside the frame; the last one holds its far edge.
static long cell_of(struct canopy_rational *r, int i) {
    mpz_fdiv_q(r->a, r->numerator[i], r->denominator[i]);
    const long cell = mpz_get_si(r->a);
    const long last = (long)r->surrogate->size[i] - 2;
    return cell < last ? cell : last;
}

bool canopy_rational_inside(struct canopy_rational *rational, const double point[3], int cell[2]) {
    locate(rational, point);
    const bool inside = is_inside(rational);
    for (int i = 0; inside && cell && i < 2; i++) {
        cell[i] = (int)cell_of(rational, i);
    }
    return inside;
}

/// 6 P^3 N(s+1), N(s), N(s-1), N(s-2) for s = R/P, R in r->a, P in r->denominator[i].
static void weigh(struct canopy_rational *r, int i) {
    mpz_t *w = r->weights[i];
    const mpz_t *p = (const mpz_t *)&r->denominator[i];
    mpz_sub(r->b, *p, r->a);  // P - R
    mpz_pow_ui(w[0], r->b, 3);
    mpz_pow_ui(w[3], r->a, 3);
    mpz_pow_ui(r->d, *p, 3);
    mpz_mul(r->c, r->a, r->a);  // 3 R^3 - 6 R^2 P + 4 P^3
    mpz_mul(r->c, r->c, *p);
    mpz_mul_ui(w[1], r->d, 4);
    mpz_addmul_ui(w[1], w[3], 3);
    mpz_submul_ui(w[1], r->c, 6);
    mpz_mul_ui(w[2], r->d, 6);  // the four sum to 6 P^3
    mpz_sub(w[2], w[2], w[0]);
    mpz_sub(w[2], w[2], w[1]);
    mpz_sub(w[2], w[2], w[3]);
}

/// total += weights[0][a] * weights[1][b] * coefficient
static void accumulate(struct canopy_rational *r, int a, int b, double coefficient) {
    if (coefficient != 0.0) {
        canopy_dyadic_set(r->a, coefficient, r->coefficient_exponent);
        mpz_mul(r->a, r->a, r->weights[0][a]);
        mpz_addmul(r->total, r->a, r->weights[1][b]);
    }
}

static void add_base(struct canopy_rational *r) {
    const struct canopy_surrogate *s = r->surrogate;
    long cell[2];
    for (int i = 0; i < 2; i++) {
        cell[i] = cell_of(r, i);
        mpz_mul_ui(r->b, r->denominator[i], (unsigned long)cell[i]);
        mpz_sub(r->a, r->numerator[i], r->b);
        weigh(r, i);
    }
    const long m = (long)s->size[0];
    const long n = (long)s->size[1];
    for (int a = 0; a < 4; a++) {
        const long row = cell[0] + a - 1;
        const long i = row < 0 ? 0 : row < m ? row : m - 1;
        for (int b = 0; b < 4; b++) {
            const long column = cell[1] + b - 1;
            const long j = column < 0 ? 0 : column < n ? column : n - 1;
            accumulate(r, a, b, s->coefficients[i * n + j]);
        }
    }
}

static void add_window(struct canopy_rational *r, const struct canopy_window *w) {
    long knot[2];
    for (int i = 0; i < 2; i++) {
        mpz_mul_2exp(r->a, r->numerator[i], (mp_bitcnt_t)w->level);
        mpz_set_si(r->b, w->first[i]);
        mpz_submul(r->a, r->b, r->denominator[i]);
        mpz_fdiv_qr(r->b, r->a, r->a, r->denominator[i]);
        knot[i] = mpz_get_si(r->b);
        weigh(r, i);
    }
    for (int a = 0; a < 4; a++) {
        for (int b = 0; b < 4; b++) {
            const long i = knot[0] + a - 1;
            const long j = knot[1] + b - 1;
            if (i >= 0 && i < (long)w->size[0] && j >= 0 && j < (long)w->size[1]) {
                accumulate(r, a, b, w->coefficients[i * (long)w->size[1] + j]);
            }
        }
    }
}

/// The largest double not above r->total * 2^exponent / r->d (r->d > 0), but never a positive subnormal.
static double floor_of(struct canopy_rational *r, int exponent) {
    const bool negative = mpz_sgn(r->total) < 0;
    const long bits = (long)mpz_sizeinbase(r->total, 2) - (long)mpz_sizeinbase(r->d, 2);
    const long shift = 64 - bits;  // the quotient then has 64 bits or so
    if (shift >= 0) {
        mpz_mul_2exp(r->total, r->total, (mp_bitcnt_t)shift);
    } else {
        mpz_mul_2exp(r->d, r->d, (mp_bitcnt_t)-shift);
    }
    mpz_fdiv_q(r->a, r->total, r->d);
    double value = mpz_get_d(r->a);
    if (mpz_cmp_d(r->a, value) < 0) {
        value = nextafter(value, -HUGE_VAL);
    }
    value = ldexp(value, exponent - (int)shift);
    if (fabs(value) < DBL_MIN) {
        return negative ? -DBL_MIN : 0.0;
    }
    return value < DBL_MAX ? value : DBL_MAX;
}

int canopy_rational_margin(struct canopy_rational *rational, const double point[3], double *floor) {
    struct canopy_rational *r = rational;
    locate(r, point);
    mpz_set_ui(r->total, 0);
    add_base(r);
    for (size_t i = 0; i < r->surrogate->window_count; i++) {
        add_window(r, &r->surrogate->windows[i]);
    }
    // surface - height, over D = 36 Pu^3 Pv^3
    mpz_mul(r->d, r->denominator[0], r->denominator[1]);
    mpz_pow_ui(r->d, r->d, 3);
    mpz_mul_ui(r->d, r->d, 36);
    mpz_mul(r->total, r->total, r->lsb);
    mpz_mul(r->c, r->numerator[2], r->d);
    const int exponent = align(r->total, r->coefficient_exponent + r->lsb_exponent, r->c, r->height_exponent);
    mpz_sub(r->total, r->total, r->c);
    if (r->surrogate->side == CANOPY_BELOW) {
        mpz_neg(r->total, r->total);
    }
    const int sign = mpz_sgn(r->total);
    *floor = sign == 0 ? 0.0 : floor_of(r, exponent);
    return sign;
}
