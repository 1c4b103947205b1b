#include "lib/cover/refine.h"

#include <string.h>

// ---- Where

static int32_t fine_knots(const struct canopy_frame *frame, unsigned level, int axis) {
    return (int32_t)((frame->size[axis] - 1U) << level);
}

static bool is_level(unsigned level) { return level >= 1 && level <= CANOPY_REFINEMENT_LEVELS; }

enum canopy_status canopy_refine_place(const struct canopy_frame *frame, unsigned level, const int32_t low[2],
                                       const int32_t high[2], struct canopy_refinement *window) {
    int32_t first[2], size[2];
    if (!is_level(level)) {
        return CANOPY_ARGUMENT;
    }
    for (int a = 0; a < 2; a++) {
        const int32_t end = fine_knots(frame, level, a);
        if (low[a] < 0 || high[a] > end) {
            return CANOPY_OUT_OF_FRAME;
        }
        if (low[a] >= high[a]) {
            return CANOPY_ARGUMENT;
        }
        first[a] = low[a] == 0 ? -1 : low[a] + 2;
        size[a] = (high[a] == end ? end + 1 : high[a] - 2) - first[a] + 1;
        if (size[a] < 1) {
            return CANOPY_ARGUMENT;
        }
    }
    window->level = (uint8_t)level;
    for (int a = 0; a < 2; a++) {
        window->first[a] = (int16_t)first[a];
        window->size[a] = (uint16_t)size[a];
    }
    return CANOPY_OK;
}

static enum canopy_status check_one(const struct canopy_frame *frame, const struct canopy_refinement *window) {
    if (!is_level(window->level) || window->d == NULL) {
        return CANOPY_ARGUMENT;
    }
    for (int a = 0; a < 2; a++) {
        if (window->size[a] == 0) {
            return CANOPY_ARGUMENT;
        }
        if (window->first[a] < -1 || window->first[a] + window->size[a] > fine_knots(frame, window->level, a) + 2) {
            return CANOPY_OUT_OF_FRAME;
        }
    }
    const size_t count = (size_t)window->size[0] * window->size[1];
    for (size_t i = 0; i < count; i++) {
        if (window->d[i] > CANOPY_REFINED_LIMIT || window->d[i] < -CANOPY_REFINED_LIMIT) {
            return CANOPY_RANGE;
        }
    }
    return CANOPY_OK;
}

enum canopy_status canopy_refine_check(const struct canopy_frame *frame, const struct canopy_refinement *windows,
                                       uint32_t count, uint32_t *which) {
    *which = count;
    if (count > CANOPY_REFINEMENTS_MAX) {
        return CANOPY_ARGUMENT;
    }
    for (uint32_t k = 0; k < count; k++) {
        const enum canopy_status status = check_one(frame, &windows[k]);
        if (status != CANOPY_OK) {
            *which = k;
            return status;
        }
    }
    return CANOPY_OK;
}

// Whether two windows shape a common piece of the surface: supports in quarters of knot intervals.
static bool meet(const struct canopy_refinement *one, const struct canopy_refinement *other) {
    const struct canopy_refinement *const both[2] = {one, other};
    for (int a = 0; a < 2; a++) {
        int32_t low[2], high[2];
        for (int w = 0; w < 2; w++) {
            const int32_t step = 1 << (CANOPY_REFINEMENT_LEVELS - both[w]->level);
            low[w] = (both[w]->first[a] - 2) * step;
            high[w] = (both[w]->first[a] + both[w]->size[a] + 1) * step;
        }
        if (low[0] >= high[1] || low[1] >= high[0]) {
            return false;
        }
    }
    return true;
}

static bool is_free(const struct canopy_refinement *window, const struct canopy_refinement *taken, uint32_t count) {
    for (uint32_t k = 0; k < count; k++) {
        if (taken[k].level >= window->level && meet(window, &taken[k])) {
            return false;
        }
    }
    return true;
}

static uint64_t column_sum(const uint32_t *gaps, uint32_t across, uint32_t rows) {
    uint64_t sum = 0;
    for (uint32_t r = 0; r < rows; r++) {
        sum += gaps[(size_t)r * across];
    }
    return sum;
}

enum canopy_status canopy_refine_choose(const struct canopy_frame *frame, const uint32_t *gaps, unsigned level,
                                        const uint16_t span[2], const struct canopy_refinement *taken, uint32_t count,
                                        struct canopy_refinement *window) {
    const uint32_t rows = frame->size[0] - 1U, across = frame->size[1] - 1U;
    uint64_t most = 0;
    struct canopy_refinement best = *window;
    if (!is_level(level) || span[0] == 0 || span[1] == 0) {
        return CANOPY_ARGUMENT;
    }
    if (span[0] > rows || span[1] > across) {
        return CANOPY_OUT_OF_FRAME;
    }
    for (uint32_t r = 0; r + span[0] <= rows; r++) {
        uint64_t sum = 0;
        for (uint32_t c = 0; c < across; c++) {
            sum += column_sum(gaps + (size_t)r * across + c, across, span[0]);
            if (c + 1 < span[1]) {
                continue;
            }
            const uint32_t from = c + 1 - span[1];
            const int32_t low[2] = {(int32_t)(r << level), (int32_t)(from << level)};
            const int32_t high[2] = {(int32_t)((r + span[0]) << level), (int32_t)((c + 1) << level)};
            struct canopy_refinement here = *window;
            if (sum > most && canopy_refine_place(frame, level, low, high, &here) == CANOPY_OK &&
                is_free(&here, taken, count)) {
                most = sum;
                best = here;
            }
            sum -= column_sum(gaps + (size_t)r * across + from, across, span[0]);
        }
    }
    *window = best;
    return most > 0 ? CANOPY_OK : CANOPY_EMPTY;
}

// The middle of a cell of the field, as a place on the knots.
static struct canopy_place middle_of(const struct canopy_field_axis *axis, uint32_t cell) {
    const int64_t half = ((int64_t)(cell % axis->cells) * 2 + 1) << 29;
    return (struct canopy_place){cell / axis->cells, (int32_t)(half / axis->cells)};
}

void canopy_refine_gaps(const struct canopy_field *field, const int32_t *b, const struct canopy_refinement *windows,
                        uint32_t count, uint32_t *gaps) {
    const uint32_t across = field->frame.size[1] - 1U, columns = field->axis[1].count;
    memset(gaps, 0, sizeof *gaps * across * (field->frame.size[0] - 1U));
    for (uint32_t r = 0; r < field->axis[0].count; r++) {
        const struct canopy_place u = middle_of(&field->axis[0], r);
        for (uint32_t c = 0; c < columns; c++) {
            const int32_t height = canopy_field_height(field, r * columns + c);
            const struct canopy_place v = middle_of(&field->axis[1], c);
            if (height != CANOPY_NO_HEIGHT) {
                const int64_t gap =
                    (int64_t)canopy_refined_fx(b, field->frame.size, windows, count, &u, &v, NULL) - height;
                // 1024 cells of less than 2^30 steps (2^28 and, below, 2^25): in units of 2^8 steps their sum fits
                gaps[(size_t)u.interval * across + v.interval] += gap > 0 ? (uint32_t)(gap >> 8) : 0;
            }
        }
    }
}
