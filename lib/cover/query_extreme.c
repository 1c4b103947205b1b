#include "lib/cover/query_extreme.h"

#include <stddef.h>
#include <string.h>

#include "lib/cover/line.h"
#include "lib/num/fixed.h"

// Patches are cut at the window in units of 1/36 step and then counted in units 2^8 times finer, so that the cuts of
// the search cost next to nothing: less than 3 fine units along each axis, and 3 more for the halving.
#define FINE_BITS 8
#define FINE_STEP ((int64_t)CANOPY_PATCH_STEP << FINE_BITS)
#define LOSS (((int64_t)CANOPY_PATCH_LOSS << FINE_BITS) + 9)

// Far below what 3 * 2^28 steps come to, and far from the end of the format.
#define NOTHING (-((int64_t)1 << 60))

// ---- The nodes: a heap, the largest bound first

static void sift_down(struct canopy_extreme *search, uint32_t at) {
    struct canopy_extreme_node *nodes = search->nodes;
    const struct canopy_extreme_node moving = nodes[at];
    for (;;) {
        uint32_t child = 2 * at + 1;
        if (child + 1 < search->count && nodes[child + 1].bound > nodes[child].bound) {
            child++;
        }
        if (child >= search->count || nodes[child].bound <= moving.bound) {
            break;
        }
        nodes[at] = nodes[child];
        at = child;
    }
    nodes[at] = moving;
}

static void sift_up(struct canopy_extreme *search, uint32_t at) {
    struct canopy_extreme_node *nodes = search->nodes;
    const struct canopy_extreme_node moving = nodes[at];
    for (; at > 0 && nodes[(at - 1) / 2].bound < moving.bound; at = (at - 1) / 2) {
        nodes[at] = nodes[(at - 1) / 2];
    }
    nodes[at] = moving;
}

static struct canopy_extreme_node pop(struct canopy_extreme *search) {
    const struct canopy_extreme_node top = search->nodes[0];
    search->count--;
    if (search->count > 0) {
        search->nodes[0] = search->nodes[search->count];
        sift_down(search, 0);
    }
    return top;
}

static void leave(struct canopy_extreme *search, int64_t bound) {
    search->rest = bound > search->rest ? bound : search->rest;
}

// Where there is no room, the part with the smallest bound is left as it is. It is one of the heap's leaves, its second
// half.
static void push(struct canopy_extreme *search, const struct canopy_extreme_node *node) {
    if (search->count < search->room) {
        search->nodes[search->count] = *node;
        search->count++;
        sift_up(search, search->count - 1);
        return;
    }
    uint32_t least = search->count / 2;
    for (uint32_t i = least + 1; i < search->count; i++) {
        least = search->nodes[i].bound < search->nodes[least].bound ? i : least;
    }
    if (search->nodes[least].bound >= node->bound) {
        leave(search, node->bound);
    } else {
        leave(search, search->nodes[least].bound);
        search->nodes[least] = *node;
        sift_up(search, least);
    }
}

// ---- Patches

static int64_t largest_of(const int64_t c[16]) {
    int64_t largest = c[0];
    for (int i = 1; i < 16; i++) {
        largest = c[i] > largest ? c[i] : largest;
    }
    return largest;
}

// The corner (p, q), each 0 or 1, of a part, in quanta. A part's edges are whole 2^-(26 + 16) of a knot interval.
static uint32_t place_of(const struct canopy_extreme *search, const struct canopy_extreme_node *node, int axis,
                         uint32_t end) {
    const uint32_t pitch = search->subject.surface->frame.pitch[axis];
    uint32_t from, to;
    canopy_patch_part(&search->span[axis], node->cell[axis], &from, &to);
    const uint64_t inside = ((uint64_t)from << node->depth[axis]) + (uint64_t)(to - from) * (node->index[axis] + end);
    const uint64_t s = inside >> node->depth[axis];  // 2^-26
    const uint64_t at = (uint64_t)node->cell[axis] * pitch +
                        ((s * pitch + ((uint64_t)1 << (CANOPY_PATCH_BITS - 1))) >> CANOPY_PATCH_BITS);
    const uint32_t low = search->rect.low[axis], high = search->rect.high[axis];
    return at < low ? low : at > high ? high : (uint32_t)at;
}

// The corners are values of the subject, up to what was lost downward.
static void take_corners(struct canopy_extreme *search, const struct canopy_extreme_node *node, const int64_t c[16]) {
    for (uint32_t corner = 0; corner < 4; corner++) {
        const uint32_t p = corner / 2, q = corner % 2;
        if (c[12 * p + 3 * q] > search->best) {
            search->best = c[12 * p + 3 * q];
            search->at[0] = place_of(search, node, 0, p);
            search->at[1] = place_of(search, node, 1, q);
        }
    }
}

// Remembers a part if it can beat what is attained by more than the tolerance.
static void settle(struct canopy_extreme *search, struct canopy_extreme_node *node, const int64_t c[16]) {
    const int64_t bound = largest_of(c) + LOSS;
    node->bound = bound < node->bound ? bound : node->bound;
    take_corners(search, node, c);
    if (node->bound <= search->best + search->tolerance) {
        leave(search, node->bound);
    } else {
        push(search, node);
    }
}

// What the window takes of a cell, in fine units.
static void make_part(const struct canopy_extreme *search, const uint16_t cell[2], const int32_t d[16], int64_t c[16]) {
    canopy_patch_cell(&search->subject, search->sign, cell[0], cell[1], d, c);
    for (int axis = 0; axis < 2; axis++) {
        uint32_t from, to;
        canopy_patch_part(&search->span[axis], cell[axis], &from, &to);
        if (from != 0 || to != (uint32_t)1 << CANOPY_PATCH_BITS) {
            canopy_patch_cut(c, axis, from, to, CANOPY_PATCH_BITS);
        }
    }
    for (int i = 0; i < 16; i++) {
        c[i] *= (int64_t)1 << FINE_BITS;
    }
}

// ---- Looks: every cell once

// No Bernstein coefficient is above the largest of the coefficients that shape the cell.
static bool is_ruled_out(const struct canopy_extreme *search, const int32_t d[16]) {
    int32_t largest = search->sign * d[0];
    for (int i = 1; i < 16; i++) {
        const int32_t here = search->sign * d[i];
        largest = here > largest ? here : largest;
    }
    return search->subject.plane == NULL && largest * FINE_STEP <= search->best;
}

static void look(struct canopy_extreme *search) {
    struct canopy_extreme_node node = {.bound = search->hull,
                                       .cell = {(uint16_t)search->next[0], (uint16_t)search->next[1]}};
    if (search->next[1] < search->span[1].last) {
        search->next[1]++;
    } else {
        search->next[1] = search->span[1].first;
        search->next[0]++;
    }
    if (!canopy_query_counts(&search->subject, node.cell[0], node.cell[1])) {
        return;
    }
    search->any = true;
    int32_t d[16];
    int64_t c[16];
    // Cannot fail: canopy_extreme_begin has seen every coefficient.
    (void)canopy_patch_gather(&search->subject, node.cell[0], node.cell[1], d);
    if (is_ruled_out(search, d)) {
        return;
    }
    make_part(search, node.cell, d, c);
    settle(search, &node, c);
}

// ---- Cuts: the part with the worst bound in two

// The largest second difference along an axis.
static int64_t bend_of(const int64_t c[16], int axis) {
    const ptrdiff_t stride = axis == 0 ? 4 : 1, line = axis == 0 ? 1 : 4;
    int64_t largest = 0;
    for (int i = 0; i < 4; i++) {
        for (int k = 0; k < 2; k++) {
            const int64_t *at = c + i * line + k * stride;
            const int64_t second = at[0] - 2 * at[stride] + at[2 * stride];
            const int64_t size = second < 0 ? -second : second;
            largest = size > largest ? size : largest;
        }
    }
    return largest;
}

static void cut(struct canopy_extreme *search) {
    struct canopy_extreme_node node = pop(search);
    int32_t d[16];
    int64_t c[16], half[16];
    (void)canopy_patch_gather(&search->subject, node.cell[0], node.cell[1], d);
    make_part(search, node.cell, d, c);
    for (int axis = 0; axis < 2; axis++) {
        if (node.depth[axis] > 0) {
            canopy_patch_cut(c, axis, node.index[axis], node.index[axis] + 1U, node.depth[axis]);
        }
    }
    const int64_t bend[2] = {bend_of(c, 0), bend_of(c, 1)};
    int axis = bend[1] > bend[0] ? 1 : 0;
    if (node.depth[axis] == CANOPY_EXTREME_DEPTH) {
        axis = 1 - axis;
    }
    if (node.depth[axis] == CANOPY_EXTREME_DEPTH || bend[axis] == 0) {
        leave(search, node.bound);  // a flat or a tiny part: its bound is what it is
        return;
    }
    node.depth[axis]++;
    node.index[axis] = (uint16_t)(2U * node.index[axis]);
    for (uint32_t part = 0; part < 2; part++) {
        struct canopy_extreme_node child = node;
        child.index[axis] = (uint16_t)(node.index[axis] + part);
        memcpy(half, c, sizeof half);
        canopy_patch_cut(half, axis, part, part + 1U, 1);
        settle(search, &child, half);
    }
}

// ---- The steps

// The coefficients that shape the span: one before its first cell to two behind the knot where its last one begins.
static void reach_of(const struct canopy_patch_span *span, uint32_t size, uint32_t *from, uint32_t *to) {
    *from = span->first > 0 ? span->first - 1 : 0;
    *to = span->last + 2 < size ? span->last + 2 : size - 1;
}

// The plane's least value over the span of cells, times sign, in fine units, rounded down. It is at a corner.
static int64_t least_plane(const struct canopy_extreme *search) {
    const struct canopy_query_plane *plane = search->subject.plane;
    int64_t least = 0;
    for (uint32_t corner = 0; plane != NULL && corner < 4; corner++) {
        const struct canopy_patch_span *u = &search->span[0], *v = &search->span[1];
        const int64_t row = corner / 2 == 0 ? u->first : u->last + 1, column = corner % 2 == 0 ? v->first : v->last + 1;
        const int64_t value = plane->at_origin + row * plane->rise[0] + column * plane->rise[1];
        const int64_t here = canopy_shift_floor(search->sign * value * CANOPY_PATCH_STEP, 16 - FINE_BITS);
        least = corner == 0 || here < least ? here : least;
    }
    return least;
}

static enum canopy_status find_hull(struct canopy_extreme *search) {
    const struct canopy_envelope *surface = search->subject.surface, *minus = search->subject.minus;
    const uint32_t n = surface->frame.size[1];
    uint32_t from[2], to[2];
    int64_t largest = NOTHING;
    for (int axis = 0; axis < 2; axis++) {
        reach_of(&search->span[axis], surface->frame.size[axis], &from[axis], &to[axis]);
    }
    for (uint32_t i = from[0]; i <= to[0]; i++) {
        for (uint32_t j = from[1]; j <= to[1]; j++) {
            const size_t at = (size_t)i * n + j;
            const int32_t b = surface->coefficients[at], other = minus != NULL ? minus->coefficients[at] : 0;
            if (b > CANOPY_COEFFICIENT_LIMIT || b < -CANOPY_COEFFICIENT_LIMIT || other > CANOPY_COEFFICIENT_LIMIT ||
                other < -CANOPY_COEFFICIENT_LIMIT) {
                return CANOPY_RANGE;
            }
            const int32_t here = search->sign * (b - other);
            largest = here > largest ? here : largest;
        }
    }
    search->hull = largest * FINE_STEP - least_plane(search);
    return CANOPY_OK;
}

enum canopy_status canopy_extreme_begin(struct canopy_extreme *search, const struct canopy_query_subject *subject,
                                        const struct canopy_query_rect *rect, enum canopy_extreme_kind kind,
                                        uint32_t tolerance, struct canopy_extreme_node *nodes, uint32_t room) {
    const enum canopy_status status = canopy_query_check(subject, rect);
    if (status != CANOPY_OK || room == 0) {
        return status != CANOPY_OK ? status : CANOPY_ARGUMENT;
    }
    const struct canopy_frame *frame = &subject->surface->frame;
    *search = (struct canopy_extreme){.subject = *subject, .rect = *rect, .nodes = nodes, .room = room};
    search->sign = kind == CANOPY_LOWEST ? -1 : 1;
    search->rest = search->best = NOTHING;
    search->tolerance = tolerance * FINE_STEP;
    for (int axis = 0; axis < 2; axis++) {
        search->span[axis] =
            canopy_patch_span_of(rect->low[axis], rect->high[axis], frame->pitch[axis], frame->size[axis]);
        search->next[axis] = search->span[axis].first;
    }
    return find_hull(search);
}

static bool is_looked_at(const struct canopy_extreme *search) { return search->next[0] > search->span[0].last; }

// True while the worst of the parts is worse than all that is settled. Parts that were remembered before a better
// value was attained are let go here.
static bool can_gain(const struct canopy_extreme *search) {
    const int64_t settled = search->best + search->tolerance;
    return search->count > 0 && search->nodes[0].bound > settled && search->nodes[0].bound > search->rest;
}

enum canopy_status canopy_extreme_step(struct canopy_extreme *search, uint32_t budget) {
    for (; budget > 0 && !is_looked_at(search); budget--) {
        look(search);
    }
    if (!is_looked_at(search)) {
        return CANOPY_MORE;
    }
    if (!search->any) {
        return CANOPY_EMPTY;
    }
    for (; budget > 0 && can_gain(search); budget--) {
        cut(search);
    }
    return can_gain(search) ? CANOPY_MORE : CANOPY_OK;
}

struct canopy_extreme_answer canopy_extreme_answer(const struct canopy_extreme *search) {
    int64_t bound = search->hull;
    if (is_looked_at(search) && search->any) {
        int64_t known = search->best > search->rest ? search->best : search->rest;
        if (search->count > 0 && search->nodes[0].bound > known) {
            known = search->nodes[0].bound;
        }
        bound = known < bound ? known : bound;
    }
    struct canopy_extreme_answer answer = {.found = search->best > NOTHING, .at = {search->at[0], search->at[1]}};
    answer.bound = search->sign * (int32_t)canopy_div_ceil(bound, FINE_STEP);
    if (answer.found) {
        answer.attained = search->sign * (int32_t)-canopy_div_ceil(-search->best, FINE_STEP);
    }
    return answer;
}

enum canopy_status canopy_extreme_find(const struct canopy_query_subject *subject, const struct canopy_query_rect *rect,
                                       enum canopy_extreme_kind kind, uint32_t tolerance, uint32_t budget,
                                       struct canopy_extreme_answer *answer) {
    struct canopy_extreme_node nodes[CANOPY_EXTREME_NODES];
    struct canopy_extreme search;
    enum canopy_status status =
        canopy_extreme_begin(&search, subject, rect, kind, tolerance, nodes, CANOPY_EXTREME_NODES);
    if (status != CANOPY_OK) {
        return status;
    }
    status = canopy_extreme_step(&search, budget);
    if (status != CANOPY_OK && status != CANOPY_MORE) {
        return status;
    }
    *answer = canopy_extreme_answer(&search);
    return CANOPY_OK;
}
