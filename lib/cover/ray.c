#include "lib/cover/ray.h"

#include "lib/cover/ray_parts.h"
#include "lib/inline.h"
#include "lib/num/bits.h"
#include "lib/num/fixed.h"
#include "lib/num/wide.h"

#define PLACE CANOPY_RAY_PLACE_BITS
#define HEIGHT CANOPY_RAY_HEIGHT_BITS
#define PART 20                                 // bits below a line's unit
#define FAR_HEIGHT ((1LL << 28) + (1LL << 20))  // steps: above this no coefficient is
#define HEIGHT_LIMIT (1LL << 50)                // Q20: heights far below are taken as this
#define ROUNDED_STEPS (1LL << 19)               // most that a line's heights may be rounded
#define SIGMA_LIMIT (1LL << (PLACE - 6))        // and its places

static int64_t size_of(int64_t a) { return a < 0 ? -a : a; }

// ---------------------------------------------------------------------------------------------------------------------
// From a line to what of it is in the frame

// A place on the line from `from` (0) to `to` (1).
struct ratio {
    uint64_t over, under;
};

static const struct ratio START = {0, 1}, END = {1, 1};

static bool is_before(struct ratio a, struct ratio b) { return canopy_ratio_less(a.over, a.under, b.over, b.under); }

struct stretch {
    struct ratio from, to;
    bool through_side;  // `from` is where it comes in from beside
};

enum meeting { BESIDE, ABOVE, MEETS };

static struct ratio at_plane(const struct canopy_ray_line *line, int a, int64_t plane) {
    return (struct ratio){(uint64_t)size_of(plane - line->from[a]), (uint64_t)size_of(line->to[a] - line->from[a])};
}

// Keeps what is between 0 and the frame's width. False: nothing.
static bool clip_side(const struct canopy_ray_line *line, int a, struct stretch *s) {
    const int64_t from = line->from[a], to = line->to[a], width = line->width[a];
    if ((from < 0 && to < 0) || (from > width && to > width)) {
        return false;
    }
    if (from < 0 || from > width) {
        const struct ratio in = at_plane(line, a, from < 0 ? 0 : width);
        s->from = is_before(s->from, in) ? in : s->from;
        s->through_side = true;
    }
    if (to < 0 || to > width) {
        const struct ratio out = at_plane(line, a, to < 0 ? 0 : width);
        s->to = is_before(out, s->to) ? out : s->to;
    }
    return !is_before(s->to, s->from);
}

// Keeps what is not so high that it is free, and not what follows after the ray has come below everything: it has hit
// before. False: all is free.
static bool clip_height(const struct canopy_ray_line *line, int64_t high, struct stretch *s) {
    const int64_t from = line->from[2], to = line->to[2];
    if (from > high && to > high) {
        return false;
    }
    if (from > high) {
        const struct ratio in = at_plane(line, 2, high);
        if (is_before(s->from, in)) {
            s->from = in;
            s->through_side = false;
        }
    } else if (to > high) {
        const struct ratio out = at_plane(line, 2, high);
        s->to = is_before(out, s->to) ? out : s->to;
    }
    if (to < -high && from > -high) {
        const struct ratio out = at_plane(line, 2, -high);
        s->to = is_before(out, s->to) ? out : s->to;
        return !is_before(s->to, s->from) || is_before(out, s->from);
    }
    return !is_before(s->to, s->from);
}

static enum meeting clip(const struct canopy_ray_line *line, int64_t high, struct stretch *s) {
    *s = (struct stretch){START, END, false};
    if (!clip_side(line, 0, s) || !clip_side(line, 1, s)) {
        return BESIDE;
    }
    if (!clip_height(line, high, s)) {
        return ABOVE;
    }
    if (is_before(s->to, s->from)) {  // below everything before it comes in
        s->to = s->from;
    }
    return MEETS;
}

// ---------------------------------------------------------------------------------------------------------------------
// The walk from cell to cell

// The next crossing of a knot line of one axis: where along the other axis, and how high; and what they change by from
// one crossing to the next.
struct crossing {
    uint32_t left;
    int64_t other, height, other_step, height_step;
};

struct walk {
    const struct canopy_envelope *envelope;
    const struct canopy_ray_line *line;
    uint32_t cells[2];
    int64_t at[3], end[3];  // places Q44, height Q20, mirrored for the side below
    int direction[2];
    struct crossing crossing[2];
    struct canopy_ray_piece piece;
};

// The line's coordinate at a place on it, with PART bits below the unit.
static int64_t coordinate(const struct canopy_ray_line *line, int a, struct ratio at) {
    const int64_t from = line->from[a], to = line->to[a];
    const int64_t way = (int64_t)canopy_mul_div((uint64_t)size_of(to - from) << PART, at.over, at.under);
    return from * (1 << PART) + (to < from ? -way : way);
}

static int64_t place_at(const struct walk *w, int a, struct ratio at) {
    const int64_t x = coordinate(w->line, a, at);
    const uint64_t knots = (uint64_t)w->cells[a] << (PLACE - PART);
    const uint64_t place = x <= 0 ? 0 : canopy_mul_div((uint64_t)x, knots, (uint64_t)w->line->width[a]);
    const uint64_t most = (uint64_t)w->cells[a] << PLACE;
    return (int64_t)(place < most ? place : most);
}

static int64_t height_at(const struct walk *w, struct ratio at) {
    const int64_t x = coordinate(w->line, 2, at);
    const int log2 = w->line->height_log2;
    if (log2 <= 0) {
        const int64_t height = canopy_shift_floor(x, (unsigned)-log2);
        return height < -HEIGHT_LIMIT ? -HEIGHT_LIMIT : height;
    }
    return x < -(HEIGHT_LIMIT >> log2) ? -HEIGHT_LIMIT : x * (1 << log2);
}

static int64_t lerp(int64_t from, int64_t to, uint64_t part, uint64_t whole) {
    const int64_t way = (int64_t)canopy_mul_div((uint64_t)size_of(to - from), part, whole);
    return to < from ? from - way : from + way;
}

// The cell at a place on axis a; on a knot line the one above it or the one below it.
static uint32_t cell_at(const struct walk *w, int a, int64_t place, bool above) {
    const int64_t one = (int64_t)1 << PLACE;
    const int64_t cell = above ? place >> PLACE : (place + one - 1) / one - 1;
    const int64_t last = (int64_t)w->cells[a] - 1;
    return (uint32_t)(cell < 0 ? 0 : cell > last ? last : cell);
}

static void start_axis(struct walk *w, int a) {
    const int64_t from = w->at[a], to = w->end[a];
    const int other = 1 - a;
    struct crossing *c = &w->crossing[a];
    const uint32_t first = cell_at(w, a, from, to >= from), last = cell_at(w, a, to, to < from || to == from);
    w->direction[a] = to > from ? 1 : -1;
    w->piece.cell[a] = first;
    *c = (struct crossing){.left = to > from ? last - first : first - last};
    if (c->left == 0) {
        return;
    }
    const uint64_t whole = (uint64_t)size_of(to - from), one = (uint64_t)1 << PLACE;
    const int64_t edge = (int64_t)(first + (to > from)) << PLACE;
    const uint64_t part = (uint64_t)size_of(edge - from);
    c->other = lerp(w->at[other], w->end[other], part, whole);
    c->height = lerp(w->at[2], w->end[2], part, whole);
    if (c->left > 1) {
        c->other_step = lerp(0, w->end[other] - w->at[other], one, whole);
        c->height_step = lerp(0, w->end[2] - w->at[2], one, whole);
    }
}

// What the line's own rounding, and that of the walk, may move places (knots, Q44, both axes together) and heights by.
static bool bound_errors(struct walk *w) {
    uint64_t sigma = 0;
    for (int a = 0; a < 2; a++) {
        const uint64_t off = ((uint64_t)w->line->rounded << PART) + 2;
        sigma += canopy_mul_div(off, (uint64_t)w->cells[a] << (PLACE - PART), (uint64_t)w->line->width[a]);
        sigma += w->cells[a] + 8U;
    }
    const int log2 = w->line->height_log2;
    const uint64_t rounded = (uint64_t)w->line->rounded << HEIGHT;
    const uint64_t high = log2 < 0 ? (rounded >> -log2) + 1 : rounded << log2;
    if (sigma > SIGMA_LIMIT || high > (uint64_t)ROUNDED_STEPS << HEIGHT) {
        return false;
    }
    const uint64_t knots = (sigma >> (PLACE - 24)) + 1;  // Q24
    // 13 * 2^-30 from ray.h; sigma; 2^29 sigma^2 in Q20 steps; a unit of height a crossing and at each end
    w->piece.kappa_q40 = (13U << 10) + (sigma >> (PLACE - 40)) + 1;
    w->piece.fixed_q20 = high + knots * knots * 2 + w->cells[0] + w->cells[1] + 8U;
    w->piece.most_q20 = (int64_t)((w->piece.kappa_q40 << 9) + w->piece.fixed_q20 + 1);  // M = 2^29
    return true;
}

static void start(struct walk *w, const struct stretch *s) {
    for (int a = 0; a < 2; a++) {
        w->at[a] = place_at(w, a, s->from);
        w->end[a] = place_at(w, a, s->to);
    }
    w->at[2] = height_at(w, s->from);
    w->end[2] = height_at(w, s->to);
    start_axis(w, 0);
    start_axis(w, 1);
}

// Which axis' knot line comes next; -1: the end.
static int next_axis(const struct walk *w) {
    if (w->crossing[0].left == 0 || w->crossing[1].left == 0) {
        return w->crossing[0].left > 0 ? 0 : w->crossing[1].left > 0 ? 1 : -1;
    }
    const int64_t edge = (int64_t)(w->piece.cell[1] + (w->direction[1] > 0)) << PLACE, there = w->crossing[0].other;
    return (w->direction[1] > 0 ? there <= edge : there >= edge) ? 0 : 1;
}

static int32_t local(const struct walk *w, int a, int64_t place) {
    const int64_t part = place - ((int64_t)w->piece.cell[a] << PLACE);
    const int64_t q30 = (part + (1 << (PLACE - 31))) >> (PLACE - 30);
    return (int32_t)(q30 < 0 ? 0 : q30 > CANOPY_UNIT_Q30 ? CANOPY_UNIT_Q30 : q30);
}

// Makes the piece to the next crossing, and says which that is.
static int make_piece(struct walk *w) {
    const int axis = next_axis(w);
    int64_t to[3] = {w->end[0], w->end[1], w->end[2]};
    if (axis >= 0) {
        const struct crossing *c = &w->crossing[axis];
        to[axis] = (int64_t)(w->piece.cell[axis] + (w->direction[axis] > 0)) << PLACE;
        to[1 - axis] = c->other;
        to[2] = c->height;
    }
    for (int a = 0; a < 2; a++) {
        w->piece.from[a] = local(w, a, w->at[a]);
        w->piece.to[a] = local(w, a, to[a]);
        w->at[a] = to[a];
    }
    w->piece.height[0] = w->at[2];
    w->piece.height[1] = w->at[2] = to[2];
    return axis;
}

static void cross(struct walk *w, int axis) {
    struct crossing *c = &w->crossing[axis];
    w->piece.cell[axis] = w->direction[axis] > 0 ? w->piece.cell[axis] + 1 : w->piece.cell[axis] - 1;
    c->left--;
    c->other += c->other_step;
    c->height += c->height_step;
}

// ---------------------------------------------------------------------------------------------------------------------
// The hit

// The share of the line, Q62, up to a place whose coordinate on one axis is known: `x` and what it may be off by, with
// MORE bits below the unit. Never too late.
#define MORE 20
static uint64_t share_along(const struct canopy_ray_line *line, int axis, int64_t x, int64_t off) {
    const int64_t all = line->to[axis] - line->from[axis], past = x - line->from[axis] * (1 << MORE);
    const int64_t way = (all < 0 ? -past : past) - off;
    return all == 0 || way <= 0 ? 0 : canopy_mul_div((uint64_t)way, (uint64_t)1 << 62, (uint64_t)size_of(all) << MORE);
}

// Of the three axes the one that knows best, which is the latest. Local parts are off by 2^-30 and heights by a unit of
// Q20 a crossing.
static uint64_t t_of(const struct walk *w, const struct canopy_ray_found *found) {
    uint64_t t = 0;
    for (int a = 0; a < 2; a++) {
        const uint64_t knots = ((uint64_t)w->piece.cell[a] << 30) + (uint32_t)found->place[a];
        const uint64_t width = (uint64_t)w->line->width[a] << MORE, cells = (uint64_t)w->cells[a] << 30;
        const uint64_t share = share_along(w->line, a, (int64_t)canopy_mul_div(knots, width, cells),
                                           (int64_t)canopy_mul_div(3, width, cells) + 2);
        t = share > t ? share : t;
    }
    if (found->height <= -HEIGHT_LIMIT) {  // lower: it is not known how low
        return t;
    }
    const int shift = MORE - HEIGHT - w->line->height_log2;
    const int64_t off = w->cells[0] + w->cells[1] + 8;
    const uint64_t share = shift < 0 ? share_along(w->line, 2, canopy_shift_floor(found->height, (unsigned)-shift),
                                                   canopy_shift_floor(off, (unsigned)-shift) + 2)
                                     : share_along(w->line, 2, found->height * (1 << shift), off * (1 << shift));
    return share > t ? share : t;
}

static void report(const struct walk *w, const struct canopy_ray_found *found, struct canopy_ray_hit *hit) {
    const struct canopy_envelope *envelope = w->envelope;
    const uint32_t bit = w->piece.cell[0] * w->cells[1] + w->piece.cell[1];
    hit->covered = envelope->coverage == NULL || canopy_bit_get(envelope->coverage, bit);
    hit->settled = found->settled;
    for (int a = 0; a < 2; a++) {
        hit->place[a] = (struct canopy_place){w->piece.cell[a], found->place[a]};
    }
    const int64_t height = envelope->frame.side == CANOPY_BELOW ? -found->height : found->height;
    const int64_t steps = canopy_shift_floor(height, HEIGHT);
    hit->height = (int32_t)(steps > INT32_MAX ? INT32_MAX : steps < INT32_MIN ? INT32_MIN : steps);
    (void)canopy_surface_fx(envelope->coefficients, envelope->frame.size, &hit->place[0], &hit->place[1],
                            hit->gradient);
    hit->t = hit->outcome == CANOPY_RAY_STARTS_UNDER ? 0 : t_of(w, found);
    hit->t_log2 = (int16_t)(w->line->t_log2 - 62);
}

static uint8_t outcome_of(const struct stretch *s, bool first) {
    if (!first || (s->from.over != 0 && !s->through_side)) {
        return CANOPY_RAY_HIT;
    }
    return s->through_side ? CANOPY_RAY_ENTERS_UNDER : CANOPY_RAY_STARTS_UNDER;
}

// Piece after piece, until one has a zero.
static enum canopy_status look(struct walk *w, const struct stretch *s, struct canopy_ray_hit *hit) {
    struct canopy_ray_found found = {0};
    enum canopy_ray_meeting met = CANOPY_RAY_NOT_MET;
    for (int axis = 0; met == CANOPY_RAY_NOT_MET && axis >= 0;) {
        axis = make_piece(w);
        met = canopy_ray_in_cell(w->envelope, &w->piece, &found);
        hit->cells++;
        if (met == CANOPY_RAY_NOT_MET && axis >= 0) {
            cross(w, axis);
        }
    }
    hit->steps = found.steps;
    hit->outcome = CANOPY_RAY_FREE;
    if (met == CANOPY_RAY_BAD_CELL) {
        hit->outcome = CANOPY_RAY_BAD_ENVELOPE;
        return CANOPY_ARGUMENT;
    }
    if (met == CANOPY_RAY_MET) {
        hit->outcome = outcome_of(s, hit->cells == 1 && found.at_start);
        report(w, &found, hit);
    }
    return CANOPY_OK;
}

static bool is_sound(const struct canopy_ray_line *line) {
    bool sound = line->height_log2 >= CANOPY_RAY_HEIGHT_LEAST && line->height_log2 <= CANOPY_RAY_HEIGHT_MOST;
    for (int a = 0; a < 3; a++) {
        sound = sound && size_of(line->from[a]) < 1LL << 42 && size_of(line->to[a]) < 1LL << 42 &&
                (a == 2 || (line->width[a] >= 1 && line->width[a] <= 1LL << 40));
    }
    return sound;
}

static bool has_sound_size(const struct canopy_frame *frame) {
    for (int a = 0; a < 2; a++) {
        if (frame->size[a] < CANOPY_SIZE_MIN || frame->size[a] > CANOPY_RAY_SIZE_MAX) {
            return false;
        }
    }
    return true;
}

enum canopy_status canopy_ray_cast(const struct canopy_envelope *envelope, const struct canopy_ray_line *line,
                                   struct canopy_ray_hit *hit) {
    *hit = (struct canopy_ray_hit){.outcome = CANOPY_RAY_TOO_FAR};
    if (!has_sound_size(&envelope->frame)) {
        hit->outcome = CANOPY_RAY_BAD_ENVELOPE;
        return CANOPY_ARGUMENT;
    }
    if (!is_sound(line)) {
        return CANOPY_ARGUMENT;
    }
    struct canopy_ray_line mirrored = *line;
    if (envelope->frame.side == CANOPY_BELOW) {
        mirrored.from[2] = -line->from[2];
        mirrored.to[2] = -line->to[2];
    }
    struct walk w = {
        .envelope = envelope, .line = &mirrored, .cells = {envelope->frame.size[0] - 1U, envelope->frame.size[1] - 1U}};
    if (!bound_errors(&w)) {
        return CANOPY_ARGUMENT;
    }
    const int log2 = line->height_log2;
    const int64_t high = log2 < 0 ? FAR_HEIGHT << -log2 : (FAR_HEIGHT >> log2) + 1;
    struct stretch s;
    switch (clip(&mirrored, high, &s)) {
    case BESIDE: hit->outcome = CANOPY_RAY_BESIDE; return CANOPY_OK;
    case ABOVE: hit->outcome = CANOPY_RAY_FREE; return CANOPY_OK;
    default: start(&w, &s); return look(&w, &s, hit);
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// For who makes lines

static int smaller(int a, int b) { return a < b ? a : b; }

// A line that starts in the frame's columns is decided when it has left them or is beyond all heights. One that starts
// beside must go on until it has left them, however low it is by then (but for CANOPY_RAY_HEIGHT_MOST).
void canopy_ray_reach(const struct canopy_ray_line *line, const int runs[3], int *log2, int *coarser) {
    const int sideways = smaller(runs[0], runs[1]);
    bool beside = false;
    for (int a = 0; a < 2; a++) {
        beside = beside || line->from[a] < 0 || line->from[a] > line->width[a];
    }
    *coarser = 0;
    *log2 = smaller(sideways, runs[2]);
    if (beside && sideways < CANOPY_RAY_NEVER && runs[2] < sideways) {
        *coarser = smaller(sideways - runs[2], CANOPY_RAY_HEIGHT_MOST - line->height_log2);
        *log2 = runs[2] + *coarser;
    }
}
