#include "lib/cover/query.h"

#include <stddef.h>

#include "lib/cover/query_patch.h"
#include "lib/num/bits.h"
#include "lib/num/fixed.h"
#include "lib/spline/surface.h"

// ---- At a place
//
// The gradient's error, in steps a knot interval, for coefficients within +- 2^28 (differences up to 2^29, second ones
// up to 2^30). canopy_basis_fx gives slopes that are off by less than 1, 2, 3 and 1 units of 2^-30. By u: the mixture
// has 5 such units times 2^29 (2.5), a floor (1), the four rows off by less than 5.5 each times slopes whose sizes sum
// to at most 1.5 (8.25), and s rounded down by 2^-30 times a second derivative (1): 12.75. By v: each of the four
// slopes is off by 2.5 + 1 + 1, mixing them has weights off by 7.9 units times differences of up to 2^30 (7.9), a floor
// (1) and s (1): 14.4.

static unsigned bit_count(uint64_t x) {
    unsigned bits = 0;
    for (; x != 0; x >>= 1) {
        bits++;
    }
    return bits;
}

// A number that is not negative: mantissa * 2^exponent, with 29 significant bits at least.
struct magnitude {
    uint64_t mantissa;
    int exponent;
};

// |gradient| steps over a pitch, both in quanta.
static struct magnitude slope_of(int32_t gradient, uint32_t pitch, int lsb_log2) {
    const uint64_t size = gradient < 0 ? 0U - (uint64_t)gradient : (uint64_t)gradient;
    const unsigned up = size == 0 ? 0 : 63 - bit_count(size);
    return (struct magnitude){(size << up) / pitch, lsb_log2 - (int)up};
}

// The magnitude in units of 2^unit, rounded down.
static uint32_t in_units(const struct magnitude *x, int unit) {
    const int right = unit - x->exponent;
    if (right >= 64 || x->mantissa == 0) {
        return 0;
    }
    return (uint32_t)(right >= 0 ? x->mantissa >> right : x->mantissa << -right);
}

static uint32_t root_floor(uint64_t x) {
    uint64_t root = 0;
    for (uint64_t bit = (uint64_t)1 << 31; bit > 0; bit >>= 1) {
        if ((root + bit) * (root + bit) <= x) {
            root += bit;
        }
    }
    return (uint32_t)root;
}

static void find_normal(const struct canopy_frame *frame, const int32_t gradient[2], int32_t normal[3]) {
    struct magnitude part[3] = {slope_of(gradient[0], frame->pitch[0], frame->lsb_log2),
                                slope_of(gradient[1], frame->pitch[1], frame->lsb_log2),
                                {(uint64_t)1 << 30, -30}};
    int top = 1;
    for (int k = 0; k < 2; k++) {
        const int reach = (int)bit_count(part[k].mantissa) + part[k].exponent;
        top = part[k].mantissa != 0 && reach > top ? reach : top;
    }
    uint32_t size[3];  // in units that make the largest one 2^29 to 2^30
    uint64_t squares = 0;
    for (int k = 0; k < 3; k++) {
        size[k] = in_units(&part[k], top - 30);
        squares += (uint64_t)size[k] * size[k];
    }
    const uint32_t length = root_floor(squares);
    for (int k = 0; k < 3; k++) {
        const uint64_t unit = ((uint64_t)size[k] << 30) / length;
        normal[k] = (int32_t)(unit < CANOPY_UNIT_Q30 ? unit : CANOPY_UNIT_Q30);
        normal[k] = k < 2 && gradient[k] > 0 ? -normal[k] : normal[k];
    }
}

enum canopy_status canopy_query_at(const struct canopy_envelope *envelope, uint32_t u, uint32_t v,
                                   struct canopy_query_point *answer) {
    const struct canopy_frame *frame = &envelope->frame;
    const enum canopy_status status = canopy_envelope_height(envelope, u, v, &answer->low, &answer->high);
    if (status != CANOPY_OK) {
        return status;
    }
    const struct canopy_place pu = canopy_place_of(u, frame->pitch[0], frame->size[0]);
    const struct canopy_place pv = canopy_place_of(v, frame->pitch[1], frame->size[1]);
    (void)canopy_surface_fx(envelope->coefficients, frame->size, &pu, &pv, answer->gradient);
    find_normal(frame, answer->gradient, answer->normal);
    answer->covered = canopy_envelope_covers(envelope, u, v);
    return CANOPY_OK;
}

// ---- What the other questions are about

static uint32_t clipped_width(const struct canopy_frame *frame, int axis) {
    const uint64_t width = canopy_frame_width(frame, axis);
    return width < UINT32_MAX ? (uint32_t)width : UINT32_MAX;
}

struct canopy_query_rect canopy_query_whole(const struct canopy_frame *frame) {
    return (struct canopy_query_rect){.high = {clipped_width(frame, 0), clipped_width(frame, 1)}};
}

enum canopy_difference canopy_query_difference(const struct canopy_envelope *a, const struct canopy_envelope *b) {
    struct canopy_frame other = b->frame;
    other.side = a->frame.side;
    other.cells = a->frame.cells;
    return canopy_frame_difference(&a->frame, &other);
}

static bool is_within(int64_t x, int64_t limit) { return x <= limit && x >= -limit; }

static bool plane_fits(const struct canopy_query_plane *plane, const struct canopy_frame *frame) {
    const int64_t limit = CANOPY_QUERY_PLANE_LIMIT * CANOPY_QUERY_PLANE_ONE;
    if (!is_within(plane->at_origin, limit) || !is_within(plane->rise[0], 2 * limit) ||
        !is_within(plane->rise[1], 2 * limit)) {
        return false;
    }
    const int64_t far_u = plane->at_origin + plane->rise[0] * (frame->size[0] - 1);
    const int64_t by_v = plane->rise[1] * (frame->size[1] - 1);
    return is_within(far_u, limit) && is_within(plane->at_origin + by_v, limit) && is_within(far_u + by_v, limit);
}

enum canopy_status canopy_query_check(const struct canopy_query_subject *subject,
                                      const struct canopy_query_rect *rect) {
    const struct canopy_frame *frame = &subject->surface->frame;
    if ((subject->minus != NULL && canopy_query_difference(subject->surface, subject->minus) != CANOPY_SAME) ||
        rect->low[0] > rect->high[0] || rect->low[1] > rect->high[1]) {
        return CANOPY_ARGUMENT;
    }
    if (rect->high[0] > canopy_frame_width(frame, 0) || rect->high[1] > canopy_frame_width(frame, 1)) {
        return CANOPY_OUT_OF_FRAME;
    }
    return subject->plane == NULL || plane_fits(subject->plane, frame) ? CANOPY_OK : CANOPY_RANGE;
}

bool canopy_query_counts(const struct canopy_query_subject *subject, uint32_t row, uint32_t column) {
    const uint32_t bit = row * (subject->surface->frame.size[1] - 1U) + column;
    return !subject->covered || (canopy_bit_get(subject->surface->coverage, bit) &&
                                 (subject->minus == NULL || canopy_bit_get(subject->minus->coverage, bit)));
}

// ---- Two times of one scene

enum canopy_status canopy_query_coverage(const struct canopy_envelope *before, const struct canopy_envelope *after,
                                         struct canopy_query_coverage *answer) {
    if (canopy_query_difference(before, after) != CANOPY_SAME) {
        return CANOPY_ARGUMENT;
    }
    const uint32_t cells = (before->frame.size[0] - 1U) * (before->frame.size[1] - 1U);
    *answer = (struct canopy_query_coverage){0};
    for (uint32_t i = 0; i < cells; i++) {
        const bool was = canopy_bit_get(before->coverage, i), is = canopy_bit_get(after->coverage, i);
        answer->gained += !was && is;
        answer->lost += was && !is;
        answer->kept += was && is;
    }
    return CANOPY_OK;
}

enum canopy_status canopy_query_cell(const struct canopy_query_subject *subject, uint32_t row, uint32_t column,
                                     int32_t *low, int32_t *high) {
    int32_t d[16];
    int64_t c[16];
    const enum canopy_status status = canopy_patch_gather(subject, row, column, d);
    if (status != CANOPY_OK) {
        return status;
    }
    canopy_patch_cell(subject, 1, row, column, d, c);
    int64_t least = c[0], largest = c[0];
    for (int i = 1; i < 16; i++) {
        least = c[i] < least ? c[i] : least;
        largest = c[i] > largest ? c[i] : largest;
    }
    largest += subject->plane != NULL;
    *low = (int32_t)-canopy_div_ceil(-least, CANOPY_PATCH_STEP);
    *high = (int32_t)canopy_div_ceil(largest, CANOPY_PATCH_STEP);
    return CANOPY_OK;
}
