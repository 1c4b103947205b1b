#include "lib/cover/query_volume.h"

#include <stddef.h>

#include "lib/num/fixed.h"

#define UNITS (16 * CANOPY_PATCH_STEP)  // 576: sixteen coefficients of 1/36 step

// ---- 128 bits

// a * b, unsigned.
static struct canopy_volume_sum product(uint64_t a, uint64_t b) {
    const uint64_t a0 = (uint32_t)a, a1 = a >> 32, b0 = (uint32_t)b, b1 = b >> 32;
    const uint64_t low = a0 * b0, middle = a1 * b0 + (low >> 32), other = a0 * b1 + (uint32_t)middle;
    return (struct canopy_volume_sum){(other << 32) | (uint32_t)low,
                                      (int64_t)(a1 * b1 + (middle >> 32) + (other >> 32))};
}

static struct canopy_volume_sum negative(struct canopy_volume_sum x) {
    return (struct canopy_volume_sum){0U - x.low, (int64_t)(~(uint64_t)x.high + (x.low == 0))};
}

static void add_product(struct canopy_volume_sum *sum, int64_t a, uint64_t b) {
    struct canopy_volume_sum x = product(a < 0 ? 0U - (uint64_t)a : (uint64_t)a, b);
    if (a < 0) {
        x = negative(x);
    }
    const uint64_t low = sum->low + x.low;
    sum->high = (int64_t)((uint64_t)sum->high + (uint64_t)x.high + (low < x.low));
    sum->low = low;
}

// ---- One cell after the other

enum canopy_status canopy_volume_begin(struct canopy_volume *volume, const struct canopy_query_subject *subject,
                                       const struct canopy_query_rect *rect) {
    const enum canopy_status status = canopy_query_check(subject, rect);
    if (status != CANOPY_OK) {
        return status;
    }
    const struct canopy_frame *frame = &subject->surface->frame;
    *volume = (struct canopy_volume){.subject = *subject, .rect = *rect};
    for (int axis = 0; axis < 2; axis++) {
        volume->span[axis] =
            canopy_patch_span_of(rect->low[axis], rect->high[axis], frame->pitch[axis], frame->size[axis]);
        volume->next[axis] = volume->span[axis].first;
    }
    return CANOPY_OK;
}

// The width in quanta of what the window takes of cell `at` of an axis.
static uint32_t width_of(const struct canopy_volume *volume, int axis, uint32_t at) {
    const uint64_t pitch = volume->subject.surface->frame.pitch[axis], edge = at * pitch;
    const uint64_t low = volume->rect.low[axis], high = volume->rect.high[axis];
    const uint64_t from = low > edge ? low : edge, to = high < edge + pitch ? high : edge + pitch;
    return (uint32_t)(to - from);
}

// How much the mean over a part may change when its edges along an axis move by up to 2^-26: every place moves by no
// more, and the derivative is at most three times the largest difference of neighbouring coefficients.
static int64_t shift_of(const int64_t c[16], int axis) {
    const ptrdiff_t stride = axis == 0 ? 4 : 1, line = axis == 0 ? 1 : 4;
    int64_t largest = 0;
    for (int i = 0; i < 4; i++) {
        for (int k = 0; k < 3; k++) {
            const int64_t rise = c[i * line + (k + 1) * stride] - c[i * line + k * stride];
            const int64_t size = rise < 0 ? -rise : rise;
            largest = size > largest ? size : largest;
        }
    }
    return (3 * largest >> CANOPY_PATCH_BITS) + 1;
}

static enum canopy_status add_cell(struct canopy_volume *volume, uint32_t row, uint32_t column) {
    const uint32_t cell[2] = {row, column};
    int32_t d[16];
    int64_t c[16];
    const enum canopy_status status = canopy_patch_gather(&volume->subject, row, column, d);
    if (status != CANOPY_OK) {
        return status;
    }
    canopy_patch_cell(&volume->subject, 1, row, column, d, c);
    int64_t loss = volume->subject.plane != NULL, shift = 0;  // low by less than 16 * loss, and either way by shift
    for (int axis = 0; axis < 2; axis++) {
        uint32_t from, to;
        canopy_patch_part(&volume->span[axis], cell[axis], &from, &to);
        if (from != 0 || to != (uint32_t)1 << CANOPY_PATCH_BITS) {
            shift += shift_of(c, axis);
            loss += 3;
            canopy_patch_cut(c, axis, from, to, CANOPY_PATCH_BITS);
        }
    }
    int64_t sum = 0;
    for (int i = 0; i < 16; i++) {
        sum += c[i];
    }
    const uint64_t area = (uint64_t)width_of(volume, 0, row) * width_of(volume, 1, column);
    add_product(&volume->low, sum - 16 * shift, area);
    add_product(&volume->high, sum + 16 * (loss + shift), area);
    volume->area += area;
    volume->cells++;
    return CANOPY_OK;
}

enum canopy_status canopy_volume_step(struct canopy_volume *volume, uint32_t budget) {
    for (; budget > 0 && volume->next[0] <= volume->span[0].last; budget--) {
        const uint32_t row = volume->next[0], column = volume->next[1];
        const enum canopy_status status =
            canopy_query_counts(&volume->subject, row, column) ? add_cell(volume, row, column) : CANOPY_OK;
        if (status != CANOPY_OK) {
            return status;
        }
        if (column < volume->span[1].last) {
            volume->next[1]++;
        } else {
            volume->next[1] = volume->span[1].first;
            volume->next[0]++;
        }
    }
    return volume->next[0] <= volume->span[0].last ? CANOPY_MORE : CANOPY_OK;
}

// ---- The answer

// A magnitude of four words, the lowest first, and whether anything has been dropped below them.
struct words {
    uint32_t word[4];
    bool dropped;
};

static unsigned bits_of(const struct words *x) {
    for (unsigned i = 4; i-- > 0;) {
        for (unsigned bit = 32; bit-- > 0;) {
            if ((x->word[i] >> bit & 1U) != 0) {
                return 32 * i + bit + 1;
            }
        }
    }
    return 0;
}

static void shift_left(struct words *x, unsigned by) {
    for (; by > 0; by--) {
        for (unsigned i = 4; i-- > 0;) {
            x->word[i] = x->word[i] << 1 | (i > 0 ? x->word[i - 1] >> 31 : 0);
        }
    }
}

static void shift_right(struct words *x, unsigned by) {
    for (; by > 0; by--) {
        x->dropped = x->dropped || (x->word[0] & 1U) != 0;
        for (unsigned i = 0; i < 4; i++) {
            x->word[i] = x->word[i] >> 1 | (i < 3 ? x->word[i + 1] << 31 : 0);
        }
    }
}

static void divide(struct words *x, uint32_t by) {
    uint64_t rest = 0;
    for (unsigned i = 4; i-- > 0;) {
        rest = rest << 32 | x->word[i];
        x->word[i] = (uint32_t)(rest / by);
        rest %= by;
    }
    x->dropped = x->dropped || rest != 0;
}

static struct words magnitude_of(struct canopy_volume_sum sum) {
    const struct canopy_volume_sum x = sum.high < 0 ? negative(sum) : sum;
    const uint64_t high = (uint64_t)x.high;
    return (struct words){{(uint32_t)x.low, (uint32_t)(x.low >> 32), (uint32_t)high, (uint32_t)(high >> 32)}, false};
}

// sum * 2^up / 576 / 2^down, rounded down or up.
static int64_t rounded(struct canopy_volume_sum sum, unsigned up, unsigned down, bool upward) {
    struct words x = magnitude_of(sum);
    shift_left(&x, up);
    divide(&x, UNITS);
    shift_right(&x, down);
    const int64_t size = (int64_t)((uint64_t)x.word[1] << 32 | x.word[0]);
    const bool away = x.dropped && (sum.high < 0) != upward;
    return (sum.high < 0 ? -1 : 1) * (size + away);
}

struct canopy_volume_answer canopy_volume_answer(const struct canopy_volume *volume) {
    const struct canopy_frame *frame = &volume->subject.surface->frame;
    const struct words low = magnitude_of(volume->low), high = magnitude_of(volume->high);
    const unsigned low_bits = bits_of(&low), high_bits = bits_of(&high);
    const unsigned bits = low_bits > high_bits ? low_bits : high_bits;
    // To 126 bits, 117 after the division by 576, and 61 at the end: 2^61 and a rounding fit.
    const unsigned up = bits < 126 ? 126 - bits : 0;
    const unsigned down = bits == 0 ? 0 : 117 - 61;
    struct canopy_volume_answer answer;
    answer.low = rounded(volume->low, up, down, false);
    answer.high = rounded(volume->high, up, down, true);
    answer.exponent = (int16_t)(frame->lsb_log2 + 3 * frame->quantum_log2 + (int)down - (int)up);
    return answer;
}

// x * 2^exponent rounded; false where it does not fit.
static bool to_whole(int64_t x, int exponent, bool upward, int64_t *whole) {
    if (exponent <= 0) {
        const unsigned down = exponent < -62 ? 62 : (unsigned)-exponent;  // |x| is at most 2^61
        *whole = upward ? canopy_shift_ceil(x, down) : canopy_shift_floor(x, down);
        return true;
    }
    *whole = x;
    for (; exponent > 0 && *whole != 0; exponent--) {
        if (*whole > INT64_MAX / 2 || *whole < INT64_MIN / 2) {
            return false;
        }
        *whole *= 2;
    }
    return true;
}

enum canopy_status canopy_volume_whole(const struct canopy_volume_answer *answer, int64_t *low, int64_t *high) {
    int64_t from, to;
    if (!to_whole(answer->low, answer->exponent, false, &from) ||
        !to_whole(answer->high, answer->exponent, true, &to)) {
        return CANOPY_RANGE;
    }
    *low = from;
    *high = to;
    return CANOPY_OK;
}
