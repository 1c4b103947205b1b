// Windows of a second level: where they are, what they add, how they are fitted, and the certificate over them.

#include "hosttest/unit/unit.h"
#include "lib/cover/certify.h"
#include "lib/cover/refine.h"
#include "lib/spline/refined.h"

enum { M = 6, N = 7, CELLS = 4, SPAN = 5 };

static CANOPY_ARENA_DECLARE(field_arena, CANOPY_FIELD_ARENA(M, N, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(certify_arena, CANOPY_CERTIFY_ARENA(N, CELLS, CELLS));
static CANOPY_ARENA_DECLARE(windows_arena, CANOPY_REFINE_CERTIFY_ARENA(CELLS, CELLS));
#define ROWS 130  // nodes that the windows of these tests reach, at most
static CANOPY_ARENA_DECLARE(refine_arena, CANOPY_REFINE_ARENA(3, 3, ROWS));

static uint32_t next_random(uint32_t *state) {
    *state = *state * 1664525U + 1013904223U;
    return *state >> 8;
}

static void random_numbers(uint32_t seed, int32_t *to, size_t count, uint32_t size) {
    for (size_t i = 0; i < count; i++) {
        to[i] = (int32_t)(next_random(&seed) % (2 * size)) - (int32_t)size;
    }
}

static struct canopy_frame make_frame(void) {
    static const int32_t low[3] = {0, 0, 0}, high[3] = {1000, 1200, 100};
    const struct canopy_grid grid = {.size = {M, N}, .cells = CELLS};
    struct canopy_frame frame;
    CHECK_EQ(canopy_frame_around_fx(&frame, &grid, low, high), CANOPY_OK);
    return frame;
}

// ---- Where

static enum canopy_status place(unsigned level, int32_t u0, int32_t v0, int32_t u1, int32_t v1,
                                struct canopy_refinement *window) {
    const struct canopy_frame frame = make_frame();
    const int32_t low[2] = {u0, v0}, high[2] = {u1, v1};
    return canopy_refine_place(&frame, level, low, high, window);
}

UNIT(window_changes_what_it_is_placed_on_and_no_more) {
    struct canopy_refinement w = {0};
    CHECK_EQ(place(1, 2, 3, 6, 8, &w), CANOPY_OK);
    CHECK(w.level == 1 && w.first[0] == 4 && w.size[0] == 1 && w.first[1] == 5 && w.size[1] == 2);
    CHECK_EQ(place(2, 0, 0, 20, 24, &w), CANOPY_OK);  // from edge to edge
    CHECK(w.level == 2 && w.first[0] == -1 && w.size[0] == 23 && w.first[1] == -1 && w.size[1] == 27);
    CHECK_EQ(place(1, 0, 9, 3, 12, &w), CANOPY_OK);
    CHECK(w.first[0] == -1 && w.size[0] == 3 && w.first[1] == 11 && w.size[1] == 3);
}

UNIT(window_beside_the_grid_is_refused_and_nothing_changed) {
    struct canopy_refinement w = {.level = 9};
    CHECK_EQ(place(1, -1, 0, 6, 8, &w), CANOPY_OUT_OF_FRAME);
    CHECK_EQ(place(1, 0, 0, 11, 8, &w), CANOPY_OUT_OF_FRAME);
    CHECK_EQ(place(1, 0, 5, 6, 13, &w), CANOPY_OUT_OF_FRAME);
    CHECK_EQ(place(0, 0, 0, 5, 5, &w), CANOPY_ARGUMENT);
    CHECK_EQ(place(3, 0, 0, 5, 5, &w), CANOPY_ARGUMENT);
    CHECK_EQ(place(1, 2, 2, 5, 8, &w), CANOPY_ARGUMENT);  // three intervals have no B-spline of their own
    CHECK_EQ(place(1, 6, 2, 2, 8, &w), CANOPY_ARGUMENT);
    CHECK(w.level == 9 && w.size[0] == 0);
}

UNIT(list_says_which_window_is_wrong) {
    const struct canopy_frame frame = make_frame();
    int32_t d[4] = {0};
    struct canopy_refinement list[CANOPY_REFINEMENTS_MAX + 1];
    uint32_t which = 99;
    for (int k = 0; k <= CANOPY_REFINEMENTS_MAX; k++) {
        list[k] = (struct canopy_refinement){.level = 1, .first = {-1, 10}, .size = {2, 2}, .d = d};
    }
    CHECK_EQ(canopy_refine_check(&frame, list, 3, &which), CANOPY_OK);
    CHECK_EQ(canopy_refine_check(&frame, list, CANOPY_REFINEMENTS_MAX + 1, &which), CANOPY_ARGUMENT);
    CHECK_EQ(which, CANOPY_REFINEMENTS_MAX + 1);
    list[1].first[0] = -2;
    CHECK_EQ(canopy_refine_check(&frame, list, 3, &which), CANOPY_OUT_OF_FRAME);
    CHECK_EQ(which, 1);
    list[1].first[0] = 0;
    list[2].first[1] = 13;  // one beyond the knot after the last
    CHECK_EQ(canopy_refine_check(&frame, list, 3, &which), CANOPY_OUT_OF_FRAME);
    CHECK_EQ(which, 2);
    list[2].first[1] = 12;
    CHECK_EQ(canopy_refine_check(&frame, list, 3, &which), CANOPY_OK);
    list[0].level = 3;
    CHECK_EQ(canopy_refine_check(&frame, list, 3, &which), CANOPY_ARGUMENT);
    list[0].level = 1;
    d[3] = CANOPY_REFINED_LIMIT + 1;
    CHECK_EQ(canopy_refine_check(&frame, list, 3, &which), CANOPY_RANGE);
    CHECK_EQ(which, 0);
}

UNIT(choice_is_where_the_gap_is_largest_and_never_twice) {
    const struct canopy_frame frame = make_frame();
    uint32_t gaps[(M - 1) * (N - 1)] = {0};
    const uint16_t span[2] = {2, 3}, wide[2] = {M, 2};
    struct canopy_refinement first = {0}, second = {0};
    CHECK_EQ(canopy_refine_choose(&frame, gaps, 1, span, NULL, 0, &first), CANOPY_EMPTY);
    CHECK_EQ(canopy_refine_choose(&frame, gaps, 1, wide, NULL, 0, &first), CANOPY_OUT_OF_FRAME);
    gaps[3 * (N - 1) + 1] = 100;
    gaps[4 * (N - 1) + 3] = 60;
    gaps[0] = 110;
    CHECK_EQ(canopy_refine_choose(&frame, gaps, 1, span, NULL, 0, &first), CANOPY_OK);
    CHECK(first.first[0] == 8 && first.first[1] == 4);  // rows 3 and 4, columns 1 to 3: 160
    CHECK_EQ(canopy_refine_choose(&frame, gaps, 1, span, &first, 1, &second), CANOPY_OK);
    CHECK(second.first[0] == -1 && second.first[1] == -1);
    // a finer one may nest in a coarser one
    CHECK_EQ(canopy_refine_choose(&frame, gaps, 2, span, &first, 1, &second), CANOPY_OK);
    CHECK(second.first[0] == 14 && second.first[1] == 6);
}

// ---- What a window adds

// Neighbouring fine cells have three rows of coefficients in common, exactly: the surface is twice continuously
// differentiable over the edge between them, wherever the windows begin and end.
UNIT(surface_is_smooth_across_every_edge_of_a_window) {
    static const uint16_t size[2] = {M, N};
    int32_t b[M * N], d[2][9], here[4][4], next[4][4];
    random_numbers(1, b, M * N, 1 << 26);
    random_numbers(2, d[0], 18, 1 << 25);
    const struct canopy_refinement windows[2] = {{.level = 1, .first = {3, 4}, .size = {3, 3}, .d = d[0]},
                                                 {.level = 2, .first = {-1, 9}, .size = {3, 3}, .d = d[1]}};
    for (uint32_t u = 0; u + 1 < 4 * (M - 1); u++) {
        for (uint32_t v = 0; v + 1 < 4 * (N - 1); v++) {
            for (uint32_t axis = 0; axis < 2; axis++) {
                const uint32_t g[2] = {u, v}, beside[2] = {u + (axis == 0), v + (axis == 1)};
                CHECK(canopy_refined_cell(b, size, windows, 2, 2, g, here));
                CHECK(canopy_refined_cell(b, size, windows, 2, 2, beside, next));
                for (int a = 0; a < 4 - (axis == 0); a++) {
                    for (int e = 0; e < 4 - (axis == 1); e++) {
                        CHECK_EQ(here[a + (axis == 0)][e + (axis == 1)], next[a][e]);
                    }
                }
            }
        }
    }
}

static double spline_at(int32_t c[4][4], double s, double t) {
    float u[4], v[4];
    double sum = 0;
    canopy_basis_f32((float)s, u, NULL);
    canopy_basis_f32((float)t, v, NULL);
    for (int a = 0; a < 4; a++) {
        for (int e = 0; e < 4; e++) {
            sum += (double)u[a] * (double)v[e] * c[a][e];
        }
    }
    return sum;
}

UNIT(inserted_knots_and_evaluation_agree) {
    static const uint16_t size[2] = {M, N};
    int32_t b[M * N], d[2][9], c[4][4];
    random_numbers(3, b, M * N, 1 << 16);
    random_numbers(4, d[0], 18, 1 << 16);
    const struct canopy_refinement windows[2] = {{.level = 2, .first = {3, 5}, .size = {3, 3}, .d = d[0]},
                                                 {.level = 1, .first = {9, -1}, .size = {3, 3}, .d = d[1]}};
    for (uint32_t u = 0; u < 4 * (M - 1); u++) {
        for (uint32_t v = 0; v < 4 * (N - 1); v++) {
            const uint32_t g[2] = {u, v};
            const struct canopy_place at = {u / 4, (int32_t)((u % 4 * 4 + 3) << 26)};
            const struct canopy_place of = {v / 4, (int32_t)((v % 4 * 4 + 1) << 26)};
            CHECK(canopy_refined_cell(b, size, windows, 2, 2, g, c));
            CHECK_NEAR(canopy_refined_fx(b, size, windows, 2, &at, &of, NULL), spline_at(c, 0.75, 0.25), 6);
        }
    }
}

UNIT(gradient_is_that_of_the_sum) {
    static const uint16_t size[2] = {M, N};
    int32_t b[M * N], d[9], by[2], unused[2];
    random_numbers(5, b, M * N, 1 << 20);
    random_numbers(6, d, 9, 1 << 20);
    const struct canopy_refinement window = {.level = 2, .first = {6, 6}, .size = {3, 3}, .d = d};
    const int32_t step = 1 << 16, half = 1 << 28;
    const struct canopy_place u[3] = {{1, half - step}, {1, half}, {1, half + step}};
    const struct canopy_place v[3] = {{1, half * 3 - step}, {1, half * 3}, {1, half * 3 + step}};
    canopy_refined_fx(b, size, &window, 1, &u[1], &v[1], by);
    const double per = 1073741824.0 / (2 * step);
    const double du = canopy_refined_fx(b, size, &window, 1, &u[2], &v[1], unused) -
                      canopy_refined_fx(b, size, &window, 1, &u[0], &v[1], unused);
    const double dv = canopy_refined_fx(b, size, &window, 1, &u[1], &v[2], unused) -
                      canopy_refined_fx(b, size, &window, 1, &u[1], &v[0], unused);
    CHECK_NEAR(by[0], du * per, 4 * per);
    CHECK_NEAR(by[1], dv * per, 4 * per);
    const struct canopy_place far = {M - 2, CANOPY_UNIT_Q30};
    CHECK_EQ(canopy_refinement_fx(&window, &far, &far, by), 0);
    CHECK(by[0] == 0 && by[1] == 0);
}

UNIT(coefficients_beyond_their_limit_are_noticed) {
    static const uint16_t size[2] = {M, N};
    int32_t b[M * N], d[9], c[4][4];
    for (int i = 0; i < M * N; i++) {
        b[i] = CANOPY_REFINED_LIMIT;
    }
    memset(d, 0, sizeof d);
    const struct canopy_refinement window = {.level = 1, .first = {3, 3}, .size = {3, 3}, .d = d};
    const uint32_t g[2] = {4, 4};
    CHECK(canopy_refined_cell(b, size, &window, 1, 1, g, c));
    CHECK_EQ(c[1][1], CANOPY_REFINED_LIMIT);
    d[4] = 1;
    CHECK(!canopy_refined_cell(b, size, &window, 1, 1, g, c));
}

// ---- Fitted and certified

// A field with a bump in the corner of a flat scene, and a lid at the bump's height, which is certified.
struct scene {
    struct canopy_field field;
    struct canopy_certify base;
    struct canopy_refine_certify certify;
    int32_t b[M * N], d[9];
    struct canopy_refinement window;
};

static void make_scene(struct scene *s, uint32_t seed, unsigned level) {
    static const uint16_t cells[2] = {CELLS, CELLS};
    const struct canopy_frame frame = make_frame();
    CHECK_EQ(canopy_field_init(&s->field, &frame, cells, field_arena, sizeof field_arena), CANOPY_OK);
    for (int i = 0; i < 400; i++) {
        const int32_t x = (int32_t)(next_random(&seed) % 1001), y = (int32_t)(next_random(&seed) % 1201);
        const int32_t point[1][3] = {{x, y, x > 600 && y > 600 ? 90 : (int32_t)(next_random(&seed) % 20)}};
        CHECK_EQ(canopy_field_feed_fx(&s->field, point, 1), 0);
    }
    int32_t highest = INT32_MIN;
    for (uint32_t c = 0; c < s->field.axis[0].count * s->field.axis[1].count; c++) {
        highest = s->field.heights[c] > highest ? s->field.heights[c] : highest;
    }
    for (int i = 0; i < M * N; i++) {
        s->b[i] = highest + 8;
    }
    CHECK_EQ(canopy_certify_init(&s->base, &s->field, certify_arena, sizeof certify_arena), CANOPY_OK);
    canopy_certify_begin(&s->base, s->b);
    CHECK_EQ(canopy_certify_step(&s->base, UINT32_MAX), CANOPY_OK);
    CHECK_EQ(canopy_refine_certify_init(&s->certify, &s->field, &s->base, windows_arena, sizeof windows_arena),
             CANOPY_OK);
    const int32_t low[2] = {2, 2}, high[2] = {2 + SPAN + 1, 2 + SPAN + 1};
    CHECK_EQ(canopy_refine_place(&frame, level, low, high, &s->window), CANOPY_OK);
    s->window.d = s->d;
}

static enum canopy_status verdict(struct scene *s) {
    CHECK_EQ(canopy_refine_certify_begin(&s->certify, s->b, &s->window, 1), CANOPY_OK);
    enum canopy_status status;
    while ((status = canopy_refine_certify_step(&s->certify, 7)) == CANOPY_MORE) {}
    return status;
}

static void begin(struct scene *s, struct canopy_refine *refine) {
    CHECK_EQ(canopy_refine_init(refine, &s->field.frame, s->b, &s->window, 1, ROWS, refine_arena, sizeof refine_arena),
             CANOPY_OK);
    CHECK_EQ(canopy_refine_field(refine, &s->certify), CANOPY_OK);
    CHECK_EQ(canopy_refine_begin(refine), CANOPY_OK);
}

UNIT(window_is_certified_and_nearer) {
    for (uint32_t seed = 1; seed <= 6; seed++) {
        struct scene s;
        struct canopy_refine refine;
        make_scene(&s, seed, 1 + seed % 2);
        begin(&s, &refine);
        while (canopy_refine_step(&refine, 50) == CANOPY_MORE) {}
        CHECK(refine.published > 0);
        CHECK(refine.after < 0.85f * refine.before);
        CHECK_EQ(verdict(&s), CANOPY_OK);
        CHECK(s.certify.margin >= 0);
    }
}

UNIT(window_is_safe_wherever_it_is_stopped) {
    struct scene s;
    struct canopy_refine refine;
    make_scene(&s, 77, 1);
    begin(&s, &refine);
    uint32_t published = 0, seen = 0;
    CHECK_EQ(verdict(&s), CANOPY_OK);
    while (canopy_refine_step(&refine, 1) == CANOPY_MORE) {
        if (refine.published != published) {
            struct canopy_refine_certify own = s.certify;  // the fit's is in use
            CHECK_EQ(canopy_refine_certify_begin(&own, s.b, &s.window, 1), CANOPY_OK);
            CHECK_EQ(canopy_refine_certify_step(&own, UINT32_MAX), CANOPY_OK);
            published = refine.published;
            seen++;
        }
    }
    CHECK(seen >= 2);
    CHECK(refine.iterations < CANOPY_REFINE_ITERATIONS);
}

UNIT(certificate_notices_a_window_that_is_too_low) {
    struct scene s;
    struct canopy_refine refine;
    make_scene(&s, 5, 1);
    begin(&s, &refine);
    while (canopy_refine_step(&refine, UINT32_MAX) == CANOPY_MORE) {}
    CHECK_EQ(verdict(&s), CANOPY_OK);
    const int32_t margin = s.certify.margin;
    for (int i = 0; i < M * N; i++) {
        s.b[i] -= margin + 1;  // one step below what was certified, everywhere
    }
    CHECK_EQ(verdict(&s), CANOPY_NOT_SAFE);
    CHECK_EQ(s.certify.missing, 1);
    const uint32_t failed = s.certify.failed_cell;
    for (int i = 0; i < M * N; i++) {
        s.b[i] += 1;
    }
    CHECK_EQ(verdict(&s), CANOPY_OK);
    CHECK_EQ(s.certify.margin, 0);
    s.field.heights[failed] += 1;
    CHECK_EQ(verdict(&s), CANOPY_NOT_SAFE);
    CHECK_EQ(s.certify.failed_cell, failed);
}

// A window that only raises leaves safe what was safe; if nothing was, it is no excuse.
UNIT(window_that_only_raises_rests_on_the_base) {
    struct scene s;
    make_scene(&s, 9, 1);
    for (int i = 0; i < 9; i++) {
        s.d[i] = i % 2 == 0 ? 1 << 24 : 0;
    }
    CHECK_EQ(verdict(&s), CANOPY_OK);
    for (int i = 0; i < M * N; i++) {
        s.b[i] = -(1 << 25);
    }
    canopy_certify_begin(&s.base, s.b);
    CHECK_EQ(verdict(&s), CANOPY_NOT_SAFE);
}

UNIT(what_is_wrong_is_said) {
    struct scene s;
    struct canopy_refine refine;
    uint32_t interval[2] = {1, 1};
    float at[2] = {0.5f, 0.5f};
    char *arena = (char *)refine_arena;
    make_scene(&s, 3, 1);
    const struct canopy_frame *frame = &s.field.frame;
    CHECK_EQ(canopy_refine_init(&refine, frame, s.b, &s.window, 0, ROWS, arena, sizeof refine_arena), CANOPY_ARGUMENT);
    CHECK_EQ(canopy_refine_init(&refine, frame, s.b, &s.window, 1, ROWS, arena, sizeof refine_arena - 8),
             CANOPY_ARENA_SHORT);
    CHECK_EQ(canopy_refine_init(&refine, frame, s.b, &s.window, 1, ROWS, arena + 1, sizeof refine_arena),
             CANOPY_ARENA_ALIGN);
    struct canopy_refinement both[2] = {s.window, s.window};
    both[0].level = 2;  // coarse ones come first
    CHECK_EQ(canopy_refine_init(&refine, frame, s.b, both, 2, ROWS, arena, sizeof refine_arena), CANOPY_ARGUMENT);
    both[1].first[0] = 9;
    both[0].level = 1;
    CHECK_EQ(canopy_refine_init(&refine, frame, s.b, both, 2, ROWS, arena, sizeof refine_arena), CANOPY_OK);
    both[1].first[0] = 10;
    CHECK_EQ(canopy_refine_init(&refine, frame, s.b, both, 2, ROWS, arena, sizeof refine_arena), CANOPY_OUT_OF_FRAME);
    CHECK_EQ(canopy_refine_init(&refine, frame, s.b, &s.window, 1, 1, arena, sizeof refine_arena), CANOPY_OK);
    CHECK_EQ(canopy_refine_step(&refine, 1), CANOPY_EMPTY);
    CHECK_EQ(canopy_refine_begin(&refine), CANOPY_EMPTY);
    CHECK_EQ(canopy_refine_add(&refine, interval, at, CANOPY_HEIGHT_LIMIT + 1), CANOPY_RANGE);
    at[1] = 1.5f;
    CHECK_EQ(canopy_refine_add(&refine, interval, at, 0), CANOPY_ARGUMENT);
    interval[0] = M - 1;
    at[1] = 0.5f;
    CHECK_EQ(canopy_refine_add(&refine, interval, at, 0), CANOPY_ARGUMENT);
    interval[0] = 4;  // where the window does not reach
    interval[1] = 5;
    CHECK_EQ(canopy_refine_add(&refine, interval, at, 0), CANOPY_OK);
    CHECK_EQ(refine.rows, 0);
    interval[0] = interval[1] = 2;
    CHECK_EQ(canopy_refine_add(&refine, interval, at, 0), CANOPY_OK);
    CHECK_EQ(canopy_refine_add(&refine, interval, at, 0), CANOPY_ARENA_SHORT);
    CHECK_EQ(canopy_refine_begin(&refine), CANOPY_ARENA_SHORT);  // no room for what keeps pits out
    s.window.level = 3;
    CHECK_EQ(canopy_refine_certify_begin(&s.certify, s.b, &s.window, 1), CANOPY_ARGUMENT);
}

UNIT_LIST(refine, window_changes_what_it_is_placed_on_and_no_more,
          window_beside_the_grid_is_refused_and_nothing_changed, list_says_which_window_is_wrong,
          choice_is_where_the_gap_is_largest_and_never_twice, surface_is_smooth_across_every_edge_of_a_window,
          inserted_knots_and_evaluation_agree, gradient_is_that_of_the_sum, coefficients_beyond_their_limit_are_noticed,
          window_is_certified_and_nearer, window_is_safe_wherever_it_is_stopped,
          certificate_notices_a_window_that_is_too_low, window_that_only_raises_rests_on_the_base,
          what_is_wrong_is_said)
