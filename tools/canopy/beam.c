#include "tools/canopy/beam.h"

#include <math.h>

// ---------------------------------------------------------------------------------------------------------------------
// The frame in rational numbers

static void set_product(mpq_t to, double a, double b) {
    mpq_t y;
    mpq_init(y);
    mpq_set_d(to, a);
    mpq_set_d(y, b);
    mpq_mul(to, to, y);
    mpq_clear(y);
}

static void divide(mpq_t x, double by) {
    mpq_t y;
    mpq_init(y);
    mpq_set_d(y, by);
    mpq_div(x, x, y);
    mpq_clear(y);
}

bool canopy_beam_open(struct canopy_beam_target *target, struct canopy_queried *queried) {
    const struct canopy_surrogate *s = &queried->surrogate;
    struct canopy_queried *const all[] = {queried};
    target->queried = queried;
    target->step = canopy_queried_scale(all, 1, 0.0);
    if (!(target->step > 0.0)) {
        return false;
    }
    target->envelope = s->side == CANOPY_ABOVE ? &queried->high : &queried->low;
    mpq_t product;
    mpq_init(product);
    for (int a = 0; a < 3; a++) {
        for (int k = 0; k < 4; k++) {
            mpq_init(target->row[a][k]);
        }
        for (int k = 0; k < 3; k++) {
            mpq_set_d(target->row[a][k], s->axes[a][k]);
            divide(target->row[a][k], s->unit);
            set_product(product, s->axes[a][k], s->origin[k]);
            mpq_sub(target->row[a][3], target->row[a][3], product);
        }
        for (int k = 0; k < 4; k++) {
            divide(target->row[a][k], a < 2 ? s->pitch[a] : target->step);
            if (a < 2) {
                divide(target->row[a][k], (double)s->size[a] - 1.0);
            }
        }
    }
    mpq_clear(product);
    return true;
}

void canopy_beam_close(struct canopy_beam_target *target) {
    for (int i = 0; i < 12; i++) {
        mpq_clear(target->row[i / 4][i % 4]);
    }
}

/// row * (v, w).
static void apply(struct canopy_beam_target *target, int a, const double v[3], bool is_point, mpq_t to) {
    mpq_t x;
    mpq_init(x);
    mpq_set_ui(to, 0, 1);
    for (int k = 0; k < 3; k++) {
        mpq_set_d(x, v[k]);
        mpq_mul(x, x, target->row[a][k]);
        mpq_add(to, to, x);
    }
    if (is_point) {
        mpq_add(to, to, target->row[a][3]);
    }
    mpq_clear(x);
}

// ---------------------------------------------------------------------------------------------------------------------
// Lines

/// The e with 2^(e-1) <= |x| < 2^e; of 0 a very small one.
static int exponent(const mpq_t x) {
    if (mpq_sgn(x) == 0) {
        return -CANOPY_RAY_NEVER;
    }
    const int e = (int)mpz_sizeinbase(mpq_numref(x), 2) - (int)mpz_sizeinbase(mpq_denref(x), 2);  // or one more
    mpz_t over, under;
    mpz_inits(over, under, NULL);
    mpz_mul_2exp(over, mpq_numref(x), e < 0 ? (mp_bitcnt_t)-e : 0);
    mpz_mul_2exp(under, mpq_denref(x), e > 0 ? (mp_bitcnt_t)e : 0);
    const bool beyond = mpz_cmpabs(over, under) >= 0;
    mpz_clears(over, under, NULL);
    return e + beyond;
}

/// x * 2^log2, rounded down.
static int64_t scaled(const mpq_t x, int log2) {
    mpq_t y;
    mpz_t whole;
    mpq_init(y);
    mpz_init(whole);
    if (log2 >= 0) {
        mpq_mul_2exp(y, x, (mp_bitcnt_t)log2);
    } else {
        mpq_div_2exp(y, x, (mp_bitcnt_t)-log2);
    }
    mpz_fdiv_q(whole, mpq_numref(y), mpq_denref(y));
    const int64_t units = (int64_t)mpz_get_d(whole);  // below 2^42: exact
    mpz_clear(whole);
    mpq_clear(y);
    return units;
}

static int larger(int a, int b) { return a > b ? a : b; }
static int smaller(int a, int b) { return a < b ? a : b; }

/// Units for coordinates of up to 2^most: frame widths and steps become 2^scale units.
static enum canopy_ray_outcome choose_units(const int most[3], struct canopy_ray_line *line, int scale[3]) {
    *line = (struct canopy_ray_line){.rounded = 2};
    for (int a = 0; a < 2; a++) {
        scale[a] = smaller(CANOPY_RAY_ROOM, CANOPY_RAY_ROOM - most[a]);
        if (scale[a] < 0) {
            return CANOPY_RAY_TOO_FAR;
        }
        line->width[a] = (int64_t)1 << scale[a];
    }
    const int log2 = larger(CANOPY_RAY_HEIGHT_LEAST, most[2] - CANOPY_RAY_ROOM);
    scale[2] = -log2;
    line->height_log2 = (int16_t)smaller(log2, CANOPY_RAY_HEIGHT_MOST);
    return log2 > CANOPY_RAY_HEIGHT_MOST ? CANOPY_RAY_TOO_FAR : CANOPY_RAY_FREE;
}

static enum canopy_ray_outcome make_segment(mpq_t from[3], mpq_t to[3], struct canopy_ray_line *line) {
    int most[3], scale[3];
    for (int a = 0; a < 3; a++) {
        most[a] = larger(exponent(from[a]), exponent(to[a]));
    }
    if (choose_units(most, line, scale) != CANOPY_RAY_FREE) {
        return CANOPY_RAY_TOO_FAR;
    }
    for (int a = 0; a < 3; a++) {
        line->from[a] = scaled(from[a], scale[a]);
        line->to[a] = scaled(to[a], scale[a]);
    }
    return CANOPY_RAY_FREE;
}

static enum canopy_ray_outcome make_ray(mpq_t from[3], mpq_t along[3], struct canopy_ray_line *line) {
    const int most[3] = {exponent(from[0]), exponent(from[1]), exponent(from[2])};
    int scale[3], runs[3], log2 = 0, coarser = 0;
    if (choose_units(most, line, scale) != CANOPY_RAY_FREE) {
        return CANOPY_RAY_TOO_FAR;
    }
    for (int a = 0; a < 3; a++) {
        line->from[a] = scaled(from[a], scale[a]);
        runs[a] = mpq_sgn(along[a]) == 0 ? CANOPY_RAY_NEVER : CANOPY_RAY_FAST - scale[a] - exponent(along[a]);
    }
    canopy_ray_reach(line, runs, &log2, &coarser);
    scale[2] -= coarser;
    line->height_log2 = (int16_t)(line->height_log2 + coarser);
    line->from[2] = scaled(from[2], scale[2]);
    line->t_log2 = (int16_t)log2;
    for (int a = 0; a < 3; a++) {
        line->to[a] = line->from[a] + scaled(along[a], scale[a] + log2);
    }
    return CANOPY_RAY_FREE;
}

// ---------------------------------------------------------------------------------------------------------------------
// Hits

/// Not after the hit: the bits that a double has no room for are dropped.
static double t_of(const struct canopy_ray_hit *hit) { return ldexp((double)(hit->t & ~(uint64_t)0x3FF), hit->t_log2); }

/// In the surrogate's own knot cells.
static void set_place(const struct canopy_beam_target *target, struct canopy_beam *beam) {
    const unsigned level = target->queried->level;
    for (int a = 0; a < 2; a++) {
        const struct canopy_place *place = &beam->hit.place[a];
        beam->cell[a] = place->interval >> level;
        beam->local[a] =
            ldexp(place->interval - (beam->cell[a] << level) + (double)place->s / CANOPY_UNIT_Q30, -(int)level);
    }
}

static void set_normal(const struct canopy_beam_target *target, struct canopy_beam *beam) {
    const struct canopy_surrogate *s = &target->queried->surrogate;
    const double up = s->side == CANOPY_ABOVE ? 1.0 : -1.0;
    double rise[2], size = 0.0;
    for (int a = 0; a < 2; a++) {
        rise[a] = ldexp(beam->hit.gradient[a] * target->step / s->pitch[a], (int)target->queried->level);
    }
    for (int k = 0; k < 3; k++) {
        beam->normal[k] = up * (s->axes[2][k] - rise[0] * s->axes[0][k] - rise[1] * s->axes[1][k]);
        size = hypot(size, beam->normal[k]);
    }
    for (int k = 0; k < 3; k++) {
        beam->normal[k] /= size;
    }
}

void canopy_beam_cast(struct canopy_beam_target *target, const double from[3], const double second[3], bool segment,
                      struct canopy_beam *beam) {
    struct canopy_ray_line line;
    mpq_t start[3], way[3];
    for (int a = 0; a < 3; a++) {
        mpq_inits(start[a], way[a], NULL);
        apply(target, a, from, true, start[a]);
        apply(target, a, second, segment, way[a]);
    }
    *beam = (struct canopy_beam){.t = NAN};
    beam->hit.outcome = (uint8_t)(segment ? make_segment(start, way, &line) : make_ray(start, way, &line));
    for (int a = 0; a < 3; a++) {
        mpq_clears(start[a], way[a], NULL);
    }
    if (beam->hit.outcome != CANOPY_RAY_FREE || canopy_ray_cast(target->envelope, &line, &beam->hit) != CANOPY_OK ||
        !canopy_ray_is_hit(&beam->hit)) {
        return;
    }
    beam->t = t_of(&beam->hit);
    for (int k = 0; k < 3; k++) {
        beam->point[k] = from[k] + beam->t * (segment ? second[k] - from[k] : second[k]);
    }
    set_place(target, beam);
    set_normal(target, beam);
}
