// Frames in any direction against rational arithmetic (GMP), which shares nothing with lib/cover: axes are nearly
// orthonormal and where they ought to be; a frame around a turned cloud holds every point; every cell in which a point,
// or any place of an uncertain reading's box, truly is has been raised at least to where it truly is; and what is
// fitted and certified from such a field is on the safe side of every point. Both scalars, both sides, directions and
// coordinates made to hurt. CANOPY_CLOUDS sets how many; a failure prints the seed, CANOPY_SEED=n runs that one alone.

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>
#include <gmp.h>

#include "hosttest/seeds.h"
#include "lib/cover/certify.h"
#include "lib/cover/envelope.h"
#include "lib/cover/fast.h"
#include "lib/cover/turn.h"
#include "tools/common/exact.h"
#include "tools/common/random.h"

enum { POINTS_MAX = 40, GRID_MAX = 8, CELLS_MAX = 6, CLOUDS = 20000 };

struct scene {
    uint64_t seed, random;
    enum canopy_scalar scalar;
    struct canopy_grid grid;
    int32_t axes[3][3];
    size_t count;
    float f32[POINTS_MAX][3];
    int32_t fx[POINTS_MAX][3];
};

static uint64_t running;  // the seed, for whoever fails

static void need(bool good, const char *what) {
    if (!good) {
        fail_msg("seed %llu: %s", (unsigned long long)running, what);
    }
}

static double uniform(struct scene *s) { return canopy_random_unit(&s->random); }
static uint32_t below(struct scene *s, uint32_t limit) { return canopy_random_below(&s->random, limit); }

// ---- Directions

static int32_t whole(struct scene *s) { return (int32_t)(uint32_t)canopy_random_next(&s->random); }

// Random, along an axis, nearly, in a diagonal, tiny, with a tiny component, huge.
static void draw_vector(struct scene *s, int32_t d[3]) {
    const uint32_t kind = below(s, 8), axis = below(s, 3);
    for (int k = 0; k < 3; k++) {
        d[k] = kind == 0 ? 0 : kind == 1 ? (int32_t)below(s, 3) - 1 : kind == 2 ? (int32_t)below(s, 9) - 4 : whole(s);
    }
    if (kind == 0 || kind == 3) {
        d[axis] = below(s, 2) ? INT32_MAX : INT32_MIN;
    }
    if (kind == 3) {  // nearly along it
        d[(axis + 1) % 3] >>= below(s, 32);
        d[(axis + 2) % 3] >>= below(s, 32);
    } else if (kind == 4) {
        d[axis] = (int32_t)below(s, 3) - 1;
    } else if (kind == 5) {
        d[1] = d[0] = d[2] = below(s, 2) ? 1 : INT32_MIN;
        d[axis] = below(s, 2) ? d[axis] : 0;
    }
}

static bool is_zero(const int32_t d[3]) { return d[0] == 0 && d[1] == 0 && d[2] == 0; }

// |row - v / |v|| <= tolerance, in units of 2^-30; long doubles are eleven bits better than that.
static void need_direction(const int32_t row[3], const long double v[3], long double tolerance, const char *what) {
    const long double length = sqrtl(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (int k = 0; k < 3; k++) {
        need(fabsl((long double)row[k] - v[k] / length * 0x1p30L) <= tolerance, what);
    }
}

static void need_orthonormal(const int32_t axes[3][3]) {
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            __int128 sum = i == j ? -((__int128)1 << 60) : 0;
            for (int k = 0; k < 3; k++) {
                sum += (__int128)axes[i][k] * axes[j][k];
            }
            sum = sum < 0 ? -sum : sum;
            need(sum <= (__int128)CANOPY_AXES_ERROR << 30, "axes are not orthonormal");
        }
    }
    __int128 volume = 0;
    for (int k = 0; k < 3; k++) {
        const int p = (k + 1) % 3, q = (k + 2) % 3;
        volume += ((__int128)axes[0][p] * axes[1][q] - (__int128)axes[0][q] * axes[1][p]) * axes[2][k];
    }
    need(volume > 0, "axes are left-handed");
    need(canopy_axes_are_sound(axes), "sound axes are refused");
}

static void axes_from_direction(struct scene *s) {
    int32_t d[3];
    do {
        draw_vector(s, d);
        need(!is_zero(d) || canopy_axes_from_direction_fx(d, s->axes) == CANOPY_ARGUMENT, "no direction is taken");
    } while (is_zero(d));
    need(canopy_axes_from_direction_fx(d, s->axes) == CANOPY_OK, "a direction is refused");
    const long double v[3] = {d[0], d[1], d[2]};
    need_direction(s->axes[2], v, 2, "the height axis is not the direction");
    const int start = abs(s->axes[2][0]) > 966367641 ? 1 : 0;
    long double u[3];
    for (int k = 0; k < 3; k++) {
        u[k] = (k == start ? 0x1p60L : 0) - (long double)s->axes[2][start] * s->axes[2][k];
    }
    need_direction(s->axes[0], u, 2, "the u axis is not x or y without its part along the direction");
}

static void axes_from_points(struct scene *s) {
    int32_t p[3][3], a[3], b[3];
    __int128 normal[3];
    bool flat = true;
    draw_vector(s, a);
    draw_vector(s, b);
    for (int k = 0; k < 3; k++) {  // anywhere, near each other, nearly on a line, on a line
        const uint32_t kind = below(s, 4);
        p[0][k] = below(s, 2) ? whole(s) : 0;
        p[1][k] = kind < 2 ? a[k] : (int32_t)((uint32_t)p[0][k] + (uint32_t)(a[k] >> 25));
        p[2][k] = kind == 0 ? b[k] : (int32_t)((int64_t)p[0][k] + ((int64_t)p[1][k] - p[0][k]) / 2 + (kind == 1));
    }
    for (int k = 0; k < 3; k++) {
        const int m = (k + 1) % 3, n = (k + 2) % 3;
        normal[k] = ((__int128)p[1][m] - p[0][m]) * ((__int128)p[2][n] - p[0][n]) -
                    ((__int128)p[1][n] - p[0][n]) * ((__int128)p[2][m] - p[0][m]);
        flat = flat && normal[k] == 0;
    }
    const enum canopy_status status = canopy_axes_from_points_fx((const int32_t(*)[3])p, s->axes);
    need(status == (flat ? CANOPY_ARGUMENT : CANOPY_OK), "three points on a line, or not");
    if (flat) {
        axes_from_direction(s);
        return;
    }
    const long double n[3] = {(long double)normal[0], (long double)normal[1], (long double)normal[2]};
    const long double u[3] = {(long double)p[1][0] - p[0][0], (long double)p[1][1] - p[0][1],
                              (long double)p[1][2] - p[0][2]};
    need_direction(s->axes[2], n, 2, "the height axis is not the normal");
    need_direction(s->axes[0], u, 2, "the u axis is not from the first to the second");
}

static void make_axes(struct scene *s) {
    if (below(s, 2)) {
        axes_from_direction(s);
    } else {
        axes_from_points(s);
    }
    need_orthonormal((const int32_t(*)[3])s->axes);
}

// ---- Clouds

static double law(struct scene *s, uint32_t kind) {
    switch (kind) {
    case 0: return 0.25;
    case 1: return below(s, 2);
    case 2: return (double)below(s, 5) / 4;
    case 3: return ldexp(uniform(s), -(int)below(s, 30));
    default: return uniform(s);
    }
}

static struct scene make_scene(uint64_t seed) {
    struct scene s = {.seed = seed, .random = seed};
    running = seed;
    s.scalar = below(&s, 2) ? CANOPY_FX : CANOPY_F32;
    s.grid =
        (struct canopy_grid){.size = {(uint16_t)(4 + below(&s, GRID_MAX - 3)), (uint16_t)(4 + below(&s, GRID_MAX - 3))},
                             .cells = (uint16_t)(1 + below(&s, CELLS_MAX)),
                             .side = (uint8_t)below(&s, 2)};
    make_axes(&s);
    s.count = 1 + below(&s, below(&s, 4) ? POINTS_MAX : 3);
    const double size = ldexp(1, (int)below(&s, 32)), reach = 2147483647.0 - size;
    const double scale = s.scalar == CANOPY_F32 ? ldexp(1, (int)below(&s, 100) - 60) : 1;
    for (int k = 0; k < 3; k++) {
        const uint32_t kind = below(&s, 8);
        const double from = (2 * uniform(&s) - 1) * reach, middle = below(&s, 3) ? from / (1 << below(&s, 30)) : from;
        const double extent = below(&s, 4) ? size : ldexp(1, (int)below(&s, 12));
        for (size_t i = 0; i < s.count; i++) {
            const double x = middle + (2 * law(&s, kind) - 1) * fmin(extent, size);
            s.fx[i][k] = (int32_t)fmax(-2147483648.0, fmin(2147483647.0, x));
            s.f32[i][k] = (float)(x * scale);
        }
    }
    return s;
}

// ---- The truth, in rationals

struct truth {
    mpq_t a, b, sum, q[3], origin[3], pitch;
};

static void truth_open(struct truth *t) {
    mpq_inits(t->a, t->b, t->sum, t->q[0], t->q[1], t->q[2], t->origin[0], t->origin[1], t->origin[2], t->pitch, NULL);
}

static void truth_close(struct truth *t) {
    mpq_clears(t->a, t->b, t->sum, t->q[0], t->q[1], t->q[2], t->origin[0], t->origin[1], t->origin[2], t->pitch, NULL);
}

static void scale2(mpq_t x, int log2) {
    if (log2 >= 0) {
        mpq_mul_2exp(x, x, (mp_bitcnt_t)log2);
    } else {
        mpq_div_2exp(x, x, (mp_bitcnt_t)-log2);
    }
}

// q = axes (p - origin) in quanta, of a place given in device units.
static void truth_turn(struct truth *t, const struct canopy_frame *f, const double p[3]) {
    for (int i = 0; i < 3; i++) {
        mpq_set_ui(t->q[i], 0, 1);
        for (int k = 0; k < 3; k++) {
            mpq_set_d(t->a, p[k]);
            scale2(t->a, -f->quantum_log2);
            mpq_set_si(t->b, f->origin[k], 1);
            mpq_sub(t->a, t->a, t->b);
            mpq_set_si(t->b, f->axis[i][k], 1);
            mpq_mul(t->a, t->a, t->b);
            mpq_add(t->q[i], t->q[i], t->a);
        }
        scale2(t->q[i], -30);
    }
}

static bool truth_inside(struct truth *t, const struct canopy_frame *f) {
    for (int a = 0; a < 2; a++) {
        mpq_set_ui(t->b, canopy_frame_width(f, a), 1);
        if (mpq_sgn(t->q[a]) < 0 || mpq_cmp(t->q[a], t->b) > 0) {
            return false;
        }
    }
    return true;
}

// Whether a place, which is inside, is not above the height of its cell. On an edge it is the cell's behind the edge.
static bool truth_under(struct truth *t, const struct canopy_field *field) {
    const struct canopy_frame *f = &field->frame;
    uint32_t cell[2];
    mpz_t whole_number;
    mpz_init(whole_number);
    for (int a = 0; a < 2; a++) {
        mpq_set_ui(t->b, field->axis[a].pitch, field->axis[a].cells);
        mpq_canonicalize(t->b);
        mpq_div(t->a, t->q[a], t->b);
        mpz_fdiv_q(whole_number, mpq_numref(t->a), mpq_denref(t->a));
        cell[a] = (uint32_t)mpz_get_ui(whole_number);
        cell[a] = cell[a] < field->axis[a].count ? cell[a] : field->axis[a].count - 1;  // the far edge is the last's
    }
    mpz_clear(whole_number);
    const int32_t height = field->heights[cell[0] * field->axis[1].count + cell[1]];
    mpq_set_si(t->b, height, 1);
    scale2(t->b, f->lsb_log2);
    mpq_set(t->a, t->q[2]);
    if (f->side == CANOPY_BELOW) {
        mpq_neg(t->a, t->a);
    }
    return height != CANOPY_NO_HEIGHT && mpq_cmp(t->a, t->b) <= 0;
}

static void point_of(const struct scene *s, size_t i, double p[3]) {
    for (int k = 0; k < 3; k++) {
        p[k] = s->scalar == CANOPY_F32 ? (double)s->f32[i][k] : s->fx[i][k];
    }
}

// ---- Frames

static CANOPY_ARENA_DECLARE(field_arena, CANOPY_FIELD_ARENA(GRID_MAX, GRID_MAX, 32, 32));
static CANOPY_ARENA_DECLARE(fast_arena, CANOPY_FAST_ARENA(GRID_MAX, GRID_MAX, CELLS_MAX, 1));
static CANOPY_ARENA_DECLARE(certify_arena, CANOPY_CERTIFY_ARENA(GRID_MAX, CELLS_MAX, CELLS_MAX));

// A frame may be refused only where a corner of the box leaves 32 bits, or nearly, or the box is 2^32 wide or high.
static void need_refusal(const struct canopy_turned_box_fx *box, const int32_t axes[3][3]) {
    double most = 0, wide = 0;
    for (int k = 0; k < 3; k++) {
        double corner = 0;
        for (int i = 0; i < 3; i++) {
            corner += ldexp((double)axes[i][k], -30) * ldexp((double)box->low[i], -30);
        }
        most = fmax(most, fabs(corner));
        wide = fmax(wide, ldexp((double)box->high[k] - (double)box->low[k], -30));
    }
    need(most > 0x1p31 - 40 || wide > 0x1p32 * (1 - 1.0 / 4096), "a frame is refused");
}

static bool make_frame(struct scene *s, struct canopy_frame *frame) {
    const int32_t(*axes)[3] = (const int32_t(*)[3])s->axes;
    if (s->scalar == CANOPY_F32) {
        struct canopy_turned_box_f32 box;
        canopy_turned_box_begin_f32(&box);
        for (size_t i = 0; i < s->count; i++) {
            canopy_turned_box_add_f32(&box, axes, s->f32[i]);
        }
        need(canopy_frame_around_turned_f32(frame, &s->grid, axes, &box) == CANOPY_OK, "a float frame is refused");
        return true;
    }
    struct canopy_turned_box_fx box;
    canopy_turned_box_begin_fx(&box);
    need(canopy_frame_around_turned_fx(frame, &s->grid, axes, &box) == CANOPY_ARGUMENT, "an empty box is taken");
    for (size_t i = 0; i < s->count; i++) {
        canopy_turned_box_add_fx(&box, axes, s->fx[i]);
    }
    const enum canopy_status status = canopy_frame_around_turned_fx(frame, &s->grid, axes, &box);
    if (status != CANOPY_OK) {
        need(status == CANOPY_RANGE, "a frame is refused for a wrong reason");
        need_refusal(&box, axes);
        return false;
    }
    // No side is more than what the origin's rounding and the pitch's ask for.
    for (int a = 0; a < 2; a++) {
        const double side = ldexp((double)(box.high[a] - box.low[a]), -30),
                     parts = (frame->size[a] - 1.0) * frame->cells;
        need((double)canopy_frame_width(frame, a) < side + 2 + 2 * parts, "the frame is too wide");
    }
    return true;
}

// ---- Points and boxes in their cells

static void open_field(const struct scene *s, const struct canopy_frame *frame, bool exact,
                       struct canopy_field *field) {
    uint16_t cells[2] = {frame->cells, frame->cells};
    for (int a = 0; a < 2 && !exact; a++) {  // any number of cells: edges between quanta
        cells[a] = (uint16_t)(1 + (s->seed >> (8 * a)) % 31);
        cells[a] = cells[a] <= frame->pitch[a] ? cells[a] : frame->cells;
    }
    need(canopy_field_init(field, frame, cells, field_arena, sizeof field_arena) == CANOPY_OK, "no field");
}

static void feed(const struct scene *s, const struct canopy_frame *frame, struct canopy_field *field) {
    if (s->scalar == CANOPY_F32) {
        struct canopy_turn_f32 turn;
        need(canopy_turn_init_f32(&turn, frame) == CANOPY_OK, "no float turn");
        need(canopy_turn_feed_f32(field, &turn, (const float(*)[3])s->f32, s->count) == 0, "a float point is refused");
    } else {
        struct canopy_turn_fx turn;
        need(canopy_turn_init_fx(&turn, frame) == CANOPY_OK, "no turn");
        need(canopy_turn_feed_fx(field, &turn, (const int32_t(*)[3])s->fx, s->count) == 0, "a point is refused");
    }
}

// The turned points are what they should be, inside, and in cells at least as high.
static void check_points(const struct scene *s, const struct canopy_frame *frame, const struct canopy_field *field,
                         struct truth *t) {
    struct canopy_turn_fx turn;
    const bool fx = s->scalar == CANOPY_FX;
    need(!fx || canopy_turn_init_fx(&turn, frame) == CANOPY_OK, "no turn");
    for (size_t i = 0; i < s->count; i++) {
        double p[3];
        point_of(s, i, p);
        truth_turn(t, frame, p);
        need(truth_inside(t, frame), "a point is outside the frame around it");
        if (fx) {
            int64_t q[3];
            canopy_turn_point_fx(&turn, s->fx[i], q);
            for (int a = 0; a < 3; a++) {
                mpq_set_si(t->a, a == 2 && frame->side == CANOPY_BELOW ? -q[a] : q[a], 1);
                scale2(t->a, -30);
                need(mpq_equal(t->a, t->q[a]) != 0, "a turned point is not exact");
            }
        }
        need(truth_under(t, field), "a point is not under its cell");
    }
}

// A place within the reading's uncertainty: a corner, or anywhere; exact in double.
static void place_within(struct scene *s, const double p[3], const double half[3], double to[3]) {
    const bool corner = below(s, 2) == 0;
    for (int k = 0; k < 3; k++) {
        const double part = corner ? (below(s, 2) ? 1 : -1) : (double)below(s, 2049) / 1024 - 1;
        to[k] = p[k] + part * half[k];
    }
}

static enum canopy_status insert_box(const struct scene *s, const struct canopy_frame *frame, size_t i,
                                     const double half[3], struct canopy_field *field,
                                     struct canopy_field_patch *patch) {
    if (s->scalar == CANOPY_F32) {
        struct canopy_turn_f32 turn;
        struct canopy_field_box_f32 box;
        const float uncertainty[3] = {(float)half[0], (float)half[1], (float)half[2]};
        need(canopy_turn_init_f32(&turn, frame) == CANOPY_OK, "no float turn");
        canopy_turn_box_f32(&turn, s->f32[i], uncertainty, &box);
        return canopy_field_insert_box_f32(field, &box, patch);
    }
    struct canopy_turn_fx turn;
    struct canopy_field_box_fx box;
    int64_t q[3];
    const uint32_t uncertainty[3] = {(uint32_t)half[0], (uint32_t)half[1], (uint32_t)half[2]};
    need(canopy_turn_init_fx(&turn, frame) == CANOPY_OK, "no turn");
    canopy_turn_point_fx(&turn, s->fx[i], q);
    need(canopy_turn_box_fx(&turn, q, uncertainty, &box) == CANOPY_OK, "no box");
    return canopy_field_insert_box_fx(field, &box, patch);
}

// One uncertain reading alone in a field: every place it may be, inside the frame, is under its cell; if one is
// outside, that is told.
static void check_box(struct scene *s, const struct canopy_frame *frame, bool exact, struct truth *t) {
    struct canopy_field field;
    struct canopy_field_patch patch;
    const size_t i = below(s, (uint32_t)s->count);
    double p[3], half[3], place[3];
    point_of(s, i, p);
    open_field(s, frame, exact, &field);
    const double size = ldexp((double)frame->pitch[0], frame->quantum_log2);
    for (int k = 0; k < 3; k++) {
        half[k] = s->scalar == CANOPY_F32 ? (double)(float)(size * uniform(s) * below(s, 3) / 4)
                                          : fmin(0x1p28, floor(size * uniform(s) * below(s, 3) / 4));
    }
    const enum canopy_status status = insert_box(s, frame, i, half, &field, &patch);
    if (status == CANOPY_ARGUMENT || status == CANOPY_RANGE) {
        return;  // too many cells, or too high: told, and nothing done
    }
    need(status == CANOPY_OK, "an uncertain reading in the frame is refused");
    need((patch.last[0] - patch.first[0] + 1) * (patch.last[1] - patch.first[1] + 1) == patch.raised,
         "an empty field has been raised elsewhere");
    for (int n = 0; n < 12; n++) {
        place_within(s, p, half, place);
        truth_turn(t, frame, place);
        if (truth_inside(t, frame)) {
            need(truth_under(t, &field), "a place of an uncertain reading is not under its cell");
        } else {
            need(patch.partly, "an uncertain reading leaves the frame and nobody is told");
        }
    }
}

// ---- The certificate

static void fit(const struct scene *s, const struct canopy_frame *frame, const struct canopy_field *field, int32_t *b) {
    struct canopy_fast fast;
    struct canopy_certify certify;
    enum canopy_status status;
    need(canopy_fast_init(&fast, field, canopy_line_fit_of(s->scalar), 1, fast_arena, sizeof fast_arena) == CANOPY_OK &&
             canopy_fast_begin(&fast, b) == CANOPY_OK,
         "no fit");
    while (canopy_fast_step(&fast, UINT32_MAX) == CANOPY_MORE) {}
    need(canopy_certify_init(&certify, field, certify_arena, sizeof certify_arena) == CANOPY_OK, "no certificate");
    canopy_certify_begin(&certify, b);
    while ((status = canopy_certify_step(&certify, UINT32_MAX)) == CANOPY_NOT_SAFE) {
        need(canopy_fast_raise(field, b, certify.failed_cell, certify.missing) == CANOPY_OK, "it cannot be raised");
    }
    need(status == CANOPY_OK, "no certificate");
    canopy_fast_orient(frame, b);
}

static void check_surface(const struct scene *s, const struct canopy_frame *f, const struct canopy_field *field) {
    int32_t b[GRID_MAX * GRID_MAX];
    double coefficients[GRID_MAX * GRID_MAX];
    struct canopy_surrogate surrogate = {.side = f->side,
                                         .scalar = s->scalar,
                                         .unit = 1,
                                         .size = {f->size[0], f->size[1]},
                                         .lsb = ldexp(1, f->lsb_log2 + f->quantum_log2),
                                         .coefficients = coefficients};
    fit(s, f, field, b);
    for (int i = 0; i < 3; i++) {
        surrogate.origin[i] = ldexp(f->origin[i], f->quantum_log2);
        for (int k = 0; k < 3; k++) {
            surrogate.axes[i][k] = ldexp(f->axis[i][k], -30);
        }
    }
    for (int a = 0; a < 2; a++) {
        surrogate.pitch[a] = ldexp(f->pitch[a], f->quantum_log2);
    }
    for (size_t i = 0; i < CANOPY_COEFFICIENTS(f->size[0], f->size[1]); i++) {
        coefficients[i] = b[i];
    }
    const char *bytes = s->scalar == CANOPY_F32 ? (const void *)s->f32 : (const void *)s->fx;
    const struct canopy_cloud cloud = {s->scalar, s->count, 3, {bytes, bytes + 4, bytes + 8}};
    struct canopy_exact_result result;
    need(canopy_exact_check(&surrogate, &cloud, &result), "no memory");
    need(result.outside == 0, "a point is outside the published frame");
    need(result.wrong == 0, "a point is on the wrong side");
}

static void check_scene(uint64_t seed) {
    struct scene s = make_scene(seed);
    struct canopy_frame frame;
    struct canopy_field field;
    struct truth t;
    if (!make_frame(&s, &frame)) {
        return;
    }
    truth_open(&t);
    if (s.scalar == CANOPY_FX) {  // float cells between quanta are approximate, as field.h says
        open_field(&s, &frame, false, &field);
        feed(&s, &frame, &field);
        check_points(&s, &frame, &field, &t);
        check_box(&s, &frame, false, &t);
    }
    check_box(&s, &frame, true, &t);
    open_field(&s, &frame, true, &field);
    feed(&s, &frame, &field);
    check_points(&s, &frame, &field, &t);
    check_surface(&s, &frame, &field);
    truth_close(&t);
}

static void every_point_is_under_its_cell(void **state) {
    (void)state;
    seeds_run(CLOUDS, check_scene);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(every_point_is_under_its_cell)};
    return cmocka_run_group_tests_name("turn properties", tests, NULL, NULL);
}
