// The constraints in use: what a row is, adding, dropping.

#include <string.h>

#include "lib/cover/tighten_f32.h"

// ---- Places and weights

// The index of coefficient a = 0 … 3 of knot interval h: the ends are repeated.
static inline uint32_t clamped(uint32_t h, uint32_t a, uint32_t size) {
    const uint32_t i = h + a > 0 ? h + a - 1 : 0;
    return i < size ? i : size - 1;
}

void canopy_tighten_find_patch(const struct canopy_tighten *t, uint32_t cell, struct canopy_tighten_patch *patch) {
    const uint32_t n = t->frame.size[1], h = cell / (n - 1), w = cell - h * (n - 1);
    const uint32_t first = clamped(w, 0, n), last = clamped(w, 3, n);
    for (uint32_t a = 0; a < 4; a++) {
        const uint32_t i = clamped(h, a, t->frame.size[0]) * n;
        patch->index[4 * a] = i + first;
        patch->index[4 * a + 1] = i + w;
        patch->index[4 * a + 2] = i + w + 1;
        patch->index[4 * a + 3] = i + last;
    }
}

void canopy_tighten_read_patch(struct canopy_tighten_patch *patch, const float *x) {
    for (int a = 0; a < 16; a++) {
        patch->c[a / 4][a % 4] = x[patch->index[a]];
    }
}

// The weights of the 3q + 1 Bernstein coefficients of a knot interval's q cells: polar forms (lib/spline/bezier.h).
static void find_lattice(uint32_t q, float (*to)[4]) {
    for (uint32_t p = 0; p <= 3 * q; p++) {
        const uint32_t k = p / 3, late = p % 3;  // `late` arguments are k + 1, the others k
        const float scale = 1.0f / (float)q;
        const float a = (float)(late > 0 ? k + 1 : k) * scale, b = (float)(late > 1 ? k + 1 : k) * scale;
        const float c = (float)k * scale, ra = 1.0f - a, rb = 1.0f - b, rc = 1.0f - c;
        // blossoms of the Bernstein polynomials of the interval, and from those to its four coefficients
        const float c0 = ra * rb * rc, c1 = a * rb * rc + ra * b * rc + ra * rb * c;
        const float c2 = a * b * rc + a * rb * c + ra * b * c, c3 = a * b * c;
        to[p][0] = c0 * (1.0f / 6);
        to[p][1] = (4.0f * c0 + 4.0f * c1 + 2.0f * c2 + c3) * (1.0f / 6);
        to[p][2] = (c0 + 2.0f * c1 + 4.0f * c2 + 4.0f * c3) * (1.0f / 6);
        to[p][3] = c3 * (1.0f / 6);
    }
}

void canopy_tighten_tables(struct canopy_tighten *t) {
    for (int axis = 0; axis < 2; axis++) {
        find_lattice(2, t->lattice[axis]);
        if (t->size.cells[axis] > 0) {
            find_lattice(t->size.cells[axis], t->lattice[axis] + PITS);
        }
    }
}

void canopy_tighten_lane_weights(const struct canopy_tighten *t, int axis, const float place[LANES],
                                 float w[restrict 4][LANES]) {
    float s[LANES], least = 0.0f;
    memcpy(s, place, sizeof s);
    for (int l = 0; l < LANES; l++) {
        const float r = 1.0f - s[l], rr = r * r, ss = s[l] * s[l];
        const float c0 = rr * r, c1 = rr * s[l], c2 = r * ss, c3 = ss * s[l];
        w[0][l] = c0 * (1.0f / 6);
        w[1][l] = (4.0f * c0 + 12.0f * c1 + 6.0f * c2 + c3) * (1.0f / 6);
        w[2][l] = (c0 + 6.0f * c1 + 12.0f * c2 + 4.0f * c3) * (1.0f / 6);
        w[3][l] = c3 * (1.0f / 6);
    }
    for (int l = 0; l < LANES; l++) {
        least = smaller(s[l], least);
    }
    for (int l = 0; least < 0.0f && l < LANES; l++) {
        if (s[l] < 0.0f) {
            const float *from = t->lattice[axis][(uint32_t)(-1.0f - s[l])];
            for (int a = 0; a < 4; a++) {
                w[a][l] = from[a];
            }
        }
    }
}

#define DISTANCES 32  // that rows may be dropped at: nothing nearer than 1e-4 is

// ---- The rows in use: in order of cells

// A row's place in an array of blocks.
struct slot {
    struct canopy_tighten_rows *rows;
    uint32_t at;
};

static struct slot in_use(const struct canopy_tighten *t, uint32_t at) { return (struct slot){t->rows, at}; }

// What is offered stands in the matrix, which is not in use meanwhile.
static struct slot offered(const struct canopy_tighten *t, uint32_t at) {
    return (struct slot){(struct canopy_tighten_rows *)(void *)t->matrix, at};
}

static uint32_t offers_most(const struct canopy_tighten *t) {
    const size_t bytes = 4 * canopy_tighten_coefficients(t) * CANOPY_TIGHTEN_BAND(t->frame.size[1]);
    return (uint32_t)(bytes / sizeof(struct canopy_tighten_rows) * LANES);
}

static uint32_t cell_of(struct slot from) { return from.rows[from.at / LANES].cell[from.at % LANES]; }

static void copy_row(struct slot to, struct slot from) {
    struct canopy_tighten_rows *a = &to.rows[to.at / LANES];
    const struct canopy_tighten_rows *b = &from.rows[from.at / LANES];
    const uint32_t i = to.at % LANES, j = from.at % LANES;
    a->cell[i] = b->cell[j];
    a->s[i] = b->s[j];
    a->t[i] = b->t[j];
    a->z[i] = b->z[j];
    a->slack[i] = b->slack[j];
    a->dual[i] = b->dual[j];
    a->slack_by[i] = b->slack_by[j];
    a->dual_by[i] = b->dual_by[j];
}

// How many rows are no further than `most`.
static uint32_t count_near(const struct canopy_tighten *t, float most) {
    uint32_t near = 0, k = 0;
    for (const struct canopy_tighten_rows *rows = t->rows; k + LANES <= t->row_count; k += LANES, rows++) {
        for (int l = 0; l < LANES; l++) {
            near += rows->slack[l] <= most;
        }
    }
    for (; k < t->row_count; k++) {
        near += t->rows[k / LANES].slack[k % LANES] <= most;
    }
    return near;
}

// The first of the distances, each 0.7 of the one before, within which there are no more rows than that.
static float distance_of(const struct canopy_tighten *t, uint32_t room) {
    float distance[DISTANCES], most = 2.0f * (CANOPY_TIGHTEN_CEILING - CANOPY_TIGHTEN_FLOOR);
    for (uint32_t k = 0; k < DISTANCES; k++) {
        distance[k] = most;
        most *= 0.7f;
    }
    uint32_t first = 0, last = DISTANCES - 1;
    while (first < last) {
        const uint32_t middle = (first + last) / 2;
        if (count_near(t, distance[middle]) > room) {
            first = middle + 1;
        } else {
            last = middle;
        }
    }
    return distance[first];
}

void canopy_tighten_drop_rows(struct canopy_tighten *t) {
    const uint32_t room = t->size.rows / 16 * 15;
    if (t->row_count <= room) {
        return;
    }
    const float most = distance_of(t, room);
    uint32_t kept = 0;
    for (uint32_t k = 0; k < t->row_count; k++) {
        if (t->rows[k / LANES].slack[k % LANES] <= most) {
            if (kept < k) {
                copy_row(in_use(t, kept), in_use(t, k));
            }
            kept++;
        }
    }
    t->row_count = kept;
}

// Whether what is offered at `at` is one of the rows in use from `from` on, in the same cell.
static bool is_there(const struct canopy_tighten *t, uint32_t at, uint32_t from) {
    const struct slot mine = offered(t, at);
    const struct canopy_tighten_rows *row = &mine.rows[at / LANES];
    const uint32_t l = at % LANES;
    for (uint32_t k = from; k < t->row_count && cell_of(in_use(t, k)) == row->cell[l]; k++) {
        const struct canopy_tighten_rows *other = &t->rows[k / LANES];
        const uint32_t o = k % LANES;
        if (!(other->s[o] < row->s[l]) && !(other->s[o] > row->s[l]) && !(other->t[o] < row->t[l]) &&
            !(other->t[o] > row->t[l])) {
            return true;
        }
    }
    return false;
}

void canopy_tighten_sift_rows(struct canopy_tighten *t) {
    uint32_t kept = 0, from = 0;
    for (uint32_t i = 0; i < t->offered; i++) {
        while (from < t->row_count && cell_of(in_use(t, from)) < cell_of(offered(t, i))) {
            from++;
        }
        if (!is_there(t, i, from)) {
            if (kept < i) {
                copy_row(offered(t, kept), offered(t, i));
            }
            kept++;
        }
    }
    t->offered = kept;
}

// Merges from the back.
static void merge(struct canopy_tighten *t) {
    uint32_t old = t->row_count, added = t->offered;
    const uint32_t room = t->size.rows - old;
    added = added < room ? added : room;
    t->row_count = old + added;
    while (added > 0) {
        if (old > 0 && cell_of(in_use(t, old - 1)) > cell_of(offered(t, added - 1))) {
            copy_row(in_use(t, old + added - 1), in_use(t, old - 1));
            old--;
        } else {
            copy_row(in_use(t, old + added - 1), offered(t, added - 1));
            added--;
        }
    }
    t->offered = 0;
}

void canopy_tighten_offer(struct canopy_tighten *t, uint32_t cell, float s, float v, float z) {
    if (t->offered == offers_most(t)) {
        canopy_tighten_sift_rows(t);
        merge(t);
    }
    const struct slot to = offered(t, t->offered++);
    struct canopy_tighten_rows *row = &to.rows[to.at / LANES];
    const uint32_t l = to.at % LANES;
    row->cell[l] = cell;
    row->s[l] = s;
    row->t[l] = v;
    row->z[l] = z;
    row->slack[l] = 1.0f;
    row->dual[l] = row->slack_by[l] = row->dual_by[l] = 0.0f;
}

void canopy_tighten_take_rows(struct canopy_tighten *t) {
    merge(t);
    uint32_t in_cell = 0, cell = UINT32_MAX;
    t->crowded = 0;
    for (uint32_t k = 0; k < t->row_count; k++) {
        const uint32_t here = cell_of(in_use(t, k));
        in_cell = here == cell ? in_cell + 1 : 1;
        cell = here;
        t->crowded = in_cell > t->crowded ? in_cell : t->crowded;
    }
    for (uint32_t k = t->row_count; k % LANES != 0; k++) {  // what stands behind the last row counts for nothing
        copy_row(in_use(t, k), in_use(t, t->row_count - 1));
        struct canopy_tighten_rows *rows = &t->rows[k / LANES];
        rows->z[k % LANES] = CANOPY_TIGHTEN_NONE;
        rows->slack[k % LANES] = 1.0f;
        rows->dual[k % LANES] = rows->slack_by[k % LANES] = rows->dual_by[k % LANES] = 0.0f;
    }
}
