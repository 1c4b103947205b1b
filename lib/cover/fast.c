#include "lib/cover/fast.h"

#include <string.h>

#include "lib/cover/envelope.h"
#include "lib/cover/fast_parts.h"

enum canopy_status canopy_fast_init(struct canopy_fast *fast, const struct canopy_field *field,
                                    const struct canopy_line_fit *fit, uint16_t lines, void *arena, size_t bytes) {
    if (lines == 0 || field->axis[0].cells % lines != 0 || fit == NULL) {
        return CANOPY_ARGUMENT;
    }
    const uint16_t m = field->frame.size[0], n = field->frame.size[1], cv = field->axis[1].cells;
    struct canopy_arena cut;
    const enum canopy_status status = canopy_arena_open(&cut, arena, bytes, CANOPY_FAST_ARENA(m, n, cv, lines));
    if (status != CANOPY_OK) {
        return status;
    }
    *fast = (struct canopy_fast){.field = field, .fit = fit, .lines = lines};
    canopy_line_init(&fast->line, CANOPY_MAX(m, n), CANOPY_MAX(cv, lines), &cut);
    const size_t count = canopy_fast_line_count(fast);
    fast->g = canopy_arena_take(&cut, 4 * count * n);
    fast->held = canopy_arena_take(&cut, count * CANOPY_FAST_HELD_BYTES(n));
    fast->result = canopy_arena_take(&cut, 4U * (size_t)CANOPY_MAX(m, n));
    return CANOPY_OK;
}

enum canopy_status canopy_fast_begin(struct canopy_fast *fast, int32_t *coefficients) {
    const struct canopy_field *field = fast->field;
    int32_t low = INT32_MAX, high = INT32_MIN;
    const uint32_t cells = field->axis[0].count * field->axis[1].count;
    for (uint32_t c = 0; c < cells; c++) {
        const int32_t height = canopy_field_height(field, c);
        if (height != CANOPY_NO_HEIGHT) {
            low = height < low ? height : low;
            high = height > high ? height : high;
        }
    }
    if (high == INT32_MIN) {
        return CANOPY_EMPTY;
    }
    const int32_t reach = high - low + 64;  // the 64: a flat field's solve may round
    fast->floor = low - reach;
    fast->ceiling = high + reach;
    fast->b = coefficients;
    fast->stage = CANOPY_FAST_LINES;
    fast->index = 0;
    fast->begun = false;
    fast->solves = 0;
    fast->unsettled = 0;
    fast->fit->shape(&fast->line, field->frame.size[1], field->axis[1].cells);
    return CANOPY_OK;
}

// ---- Lines: along v, from the field

// Raises nodes to a row of cells. A plain field is read straight: this is where a fit sees every cell.
static void gather_row(const struct canopy_field *field, uint32_t row, int32_t *nodes) {
    const uint32_t columns = field->axis[1].count, first = row * columns;
    if (field->heights != NULL) {
        const int32_t *heights = field->heights + first;
        for (uint32_t c = 0; c < columns; c++) {
            nodes[c] = heights[c] > nodes[c] ? heights[c] : nodes[c];
        }
        return;
    }
    for (uint32_t c = 0; c < columns; c++) {
        const int32_t height = field->packing->packed_height(field, first + c);
        nodes[c] = height > nodes[c] ? height : nodes[c];
    }
}

// The line's nodes: the highest of the cells around each, within one line distance.
static void gather_line(struct canopy_fast *fast, uint32_t index) {
    const struct canopy_field *field = fast->field;
    const uint32_t columns = field->axis[1].count, step = (uint32_t)field->axis[0].cells / fast->lines;
    const uint32_t middle = index * step, from = middle > step ? middle - step : 0;
    const uint32_t to = middle + step < field->axis[0].count ? middle + step : field->axis[0].count;
    int32_t *nodes = fast->line.nodes;
    for (uint32_t c = 0; c < columns; c++) {
        nodes[c] = CANOPY_NO_HEIGHT;
    }
    for (uint32_t r = from; r < to; r++) {
        gather_row(field, r, nodes);
    }
}

// From cells to nodes, in place: a node is the higher of the cells on its two sides. Holds the coefficients that a
// covered cell can see: those of the knot interval it is in.
static void cells_to_nodes(struct canopy_fast *fast, uint32_t index) {
    const uint32_t n = fast->field->frame.size[1], q = fast->field->axis[1].cells;
    uint8_t *held = fast->held + index * CANOPY_FAST_HELD_BYTES(n);
    memset(held, 0, CANOPY_FAST_HELD_BYTES(n));
    int32_t *node = fast->line.nodes, before = CANOPY_NO_HEIGHT;
    for (uint32_t h = 0; h + 1 < n; h++) {
        int32_t highest = CANOPY_NO_HEIGHT;
        for (uint32_t k = 0; k < q; k++, node++) {
            const int32_t here = *node;
            highest = here > highest ? here : highest;
            *node = here > before ? here : before;
            before = here;
        }
        if (highest != CANOPY_NO_HEIGHT) {
            for (uint32_t j = h > 0 ? h - 1 : 0; j <= h + 2 && j < n; j++) {
                (void)canopy_bit_set(held, j);
            }
        }
    }
    *node = before;
}

bool canopy_fast_begin_line(struct canopy_fast *fast, uint32_t index) {
    gather_line(fast, index);
    cells_to_nodes(fast, index);
    return fast->fit->begin(&fast->line, fast->floor, fast->ceiling);
}

// What the certificate may lose by rounding bounds down, once in each direction, and one step to spare.
#define CERTIFY_LOSS 3

void canopy_fast_finish_line(struct canopy_fast *fast, uint32_t index) {
    const uint32_t n = fast->field->frame.size[1];
    int32_t *g = fast->g + (size_t)index * n;
    fast->fit->finish(&fast->line, g);
    for (uint32_t j = 0; j < n; j++) {
        g[j] += CERTIFY_LOSS;  // B-splines sum to one: the bound rises by as much
    }
}

// ---- Columns: along u, from the lines' coefficients

static void gather_column(struct canopy_fast *fast) {
    const uint32_t n = fast->field->frame.size[1], lines = canopy_fast_line_count(fast), j = fast->index;
    for (uint32_t r = 0; r < lines; r++) {
        fast->line.nodes[r] = canopy_fast_is_held(fast, r, j) ? fast->g[(size_t)r * n + j] : CANOPY_NO_HEIGHT;
    }
}

static void store_column(struct canopy_fast *fast) {
    const uint32_t m = fast->field->frame.size[0], n = fast->field->frame.size[1];
    for (uint32_t i = 0; i < m; i++) {
        fast->b[(size_t)i * n + fast->index] = fast->result[i];
    }
}

// ---- Coefficients that nothing covered can see

bool canopy_fast_is_seen(const struct canopy_fast *fast, uint32_t i, uint32_t j) {
    const uint32_t reach = 2U * fast->lines, at = i * fast->lines, end = canopy_fast_line_count(fast) - 1;
    const uint32_t from = at > reach ? at - reach : 0, to = at + reach < end ? at + reach : end;
    for (uint32_t r = from; r <= to; r++) {
        if (canopy_fast_is_held(fast, r, j)) {
            return true;
        }
    }
    return false;
}

static bool column_is_held(const struct canopy_fast *fast, uint32_t j) {
    const uint32_t lines = canopy_fast_line_count(fast);
    for (uint32_t r = 0; r < lines; r++) {
        if (canopy_fast_is_held(fast, r, j)) {
            return true;
        }
    }
    return false;
}

static void forget_column(const struct canopy_fast *fast, uint8_t *seen, uint32_t j) {
    const uint32_t m = fast->field->frame.size[0], n = fast->field->frame.size[1];
    for (uint32_t i = 0; i < m; i++) {
        canopy_bit_clear(seen, i * n + j);
    }
}

// Finds what is free. Coverage and marks, a bit a coefficient each, stand where the lines' coefficients were, which
// took at least four bytes for each. A column that has no coefficients, its cells having been cleared since the fit
// began or filled since the lines were, is as one that nothing sees.
static bool begin_free(struct canopy_fast *fast) {
    const uint16_t *size = fast->field->frame.size;
    uint8_t *coverage = (uint8_t *)fast->g, *seen = coverage + CANOPY_COVERAGE_BYTES(size[0], size[1]);
    (void)canopy_field_coverage(fast->field, coverage);
    canopy_free_see(size, coverage, seen);
    for (uint32_t j = 0; j < size[1]; j++) {
        if (!column_is_held(fast, j)) {
            forget_column(fast, seen, j);
        }
    }
    if (canopy_free_begin(&fast->free, size, seen, fast->b) != CANOPY_OK) {
        memset(fast->b, 0, 4U * (size_t)size[0] * size[1]);  // the field was cleared since the fit began
        return false;
    }
    canopy_free_straighten(&fast->free);
    return true;
}

// What the certificate's 32-bit differences rely on. Data within the frame's own range never come near it.
static bool fits_format(const struct canopy_fast *fast) {
    const uint32_t count = (uint32_t)fast->field->frame.size[0] * fast->field->frame.size[1];
    for (uint32_t i = 0; i < count; i++) {
        if (fast->b[i] > CANOPY_COEFFICIENT_LIMIT || fast->b[i] < -CANOPY_COEFFICIENT_LIMIT) {
            return false;
        }
    }
    return true;
}

// ---- The steps

static bool begin_one(struct canopy_fast *fast) {
    if (fast->stage == CANOPY_FAST_LINES) {
        return canopy_fast_begin_line(fast, fast->index);
    }
    gather_column(fast);
    return fast->fit->begin(&fast->line, fast->floor, fast->ceiling);
}

static void finish_one(struct canopy_fast *fast) {
    if (fast->stage == CANOPY_FAST_LINES) {
        canopy_fast_finish_line(fast, fast->index);
    } else {
        fast->fit->finish(&fast->line, fast->result);
        store_column(fast);
    }
    fast->solves += fast->line.solves;
    fast->unsettled += !fast->line.settled;
}

static void next_one(struct canopy_fast *fast) {
    fast->begun = false;
    fast->index++;
    if (fast->stage == CANOPY_FAST_LINES && fast->index == canopy_fast_line_count(fast)) {
        fast->stage = CANOPY_FAST_COLUMNS;
        fast->index = 0;
        fast->fit->shape(&fast->line, fast->field->frame.size[0], fast->lines);
    } else if (fast->stage == CANOPY_FAST_COLUMNS && fast->index == fast->field->frame.size[1]) {
        const bool is_any_seen = begin_free(fast);
        fast->stage = !fits_format(fast) ? CANOPY_FAST_FAILED : is_any_seen ? CANOPY_FAST_FREE : CANOPY_FAST_DONE;
    }
}

enum canopy_status canopy_fast_step(struct canopy_fast *fast, uint32_t budget) {
    for (; budget > 0 && (fast->stage == CANOPY_FAST_LINES || fast->stage == CANOPY_FAST_COLUMNS); budget--) {
        if (!fast->begun) {
            fast->begun = begin_one(fast);
            if (!fast->begun) {
                next_one(fast);  // a line with nothing on it
                continue;
            }
        }
        if (!fast->fit->iterate(&fast->line)) {
            finish_one(fast);
            next_one(fast);
        }
    }
    if (fast->stage == CANOPY_FAST_FREE && canopy_free_step(&fast->free, budget) == CANOPY_OK) {
        fast->stage = CANOPY_FAST_DONE;
    }
    switch (fast->stage) {
    case CANOPY_FAST_DONE: return CANOPY_OK;
    case CANOPY_FAST_FAILED: return CANOPY_RANGE;
    default: return CANOPY_MORE;
    }
}

// ---- Several cores

uint32_t canopy_fast_count(const struct canopy_fast *fast) {
    return fast->stage == CANOPY_FAST_LINES     ? canopy_fast_line_count(fast)
           : fast->stage == CANOPY_FAST_COLUMNS ? fast->field->frame.size[1]
                                                : 0;
}

enum canopy_status canopy_fast_share(struct canopy_fast *worker, const struct canopy_fast *fast, void *arena,
                                     size_t bytes) {
    const uint16_t m = fast->field->frame.size[0], n = fast->field->frame.size[1];
    const uint16_t longest = CANOPY_MAX(m, n), cv = fast->field->axis[1].cells, finest = CANOPY_MAX(cv, fast->lines);
    if (canopy_fast_count(fast) == 0) {
        return CANOPY_ARGUMENT;
    }
    struct canopy_arena cut;
    const enum canopy_status status =
        canopy_arena_open(&cut, arena, bytes, CANOPY_FAST_SHARE_ARENA(m, n, cv, fast->lines));
    if (status != CANOPY_OK) {
        return status;
    }
    *worker = *fast;
    worker->solves = 0;
    worker->unsettled = 0;
    canopy_line_init(&worker->line, longest, finest, &cut);
    worker->result = canopy_arena_take(&cut, 4U * (size_t)longest);
    const bool lines = fast->stage == CANOPY_FAST_LINES;
    fast->fit->shape(&worker->line, lines ? n : m, lines ? cv : fast->lines);
    return CANOPY_OK;
}

void canopy_fast_fit(struct canopy_fast *worker, uint32_t index) {
    worker->index = index;
    if (begin_one(worker)) {
        while (worker->fit->iterate(&worker->line)) {}
        finish_one(worker);
    }
}

void canopy_fast_join(struct canopy_fast *fast, const struct canopy_fast *worker) {
    fast->solves += worker->solves;
    fast->unsettled += worker->unsettled;
}

void canopy_fast_end_stage(struct canopy_fast *fast) {
    if (canopy_fast_count(fast) > 0) {
        fast->index = canopy_fast_count(fast) - 1;
        next_one(fast);
    }
}

// ---- Mending and turning round

enum canopy_status canopy_fast_raise(const struct canopy_field *field, int32_t *coefficients, uint32_t cell,
                                     int32_t by) {
    const uint32_t columns = field->axis[1].count, m = field->frame.size[0], n = field->frame.size[1];
    const uint32_t h = cell / columns / field->axis[0].cells, w = cell % columns / field->axis[1].cells;
    const uint32_t u0 = h > 0 ? h - 1 : 0, u1 = h + 2 < m ? h + 2 : m - 1;
    const uint32_t v0 = w > 0 ? w - 1 : 0, v1 = w + 2 < n ? w + 2 : n - 1;
    for (uint32_t i = u0; i <= u1; i++) {
        for (uint32_t j = v0; j <= v1; j++) {
            if (coefficients[i * n + j] > CANOPY_COEFFICIENT_LIMIT - by) {
                return CANOPY_RANGE;
            }
        }
    }
    for (uint32_t i = u0; i <= u1; i++) {
        for (uint32_t j = v0; j <= v1; j++) {
            coefficients[i * n + j] += by;
        }
    }
    return CANOPY_OK;
}

void canopy_fast_orient(const struct canopy_frame *frame, int32_t *coefficients) {
    if (frame->side == CANOPY_BELOW) {
        const uint32_t count = (uint32_t)frame->size[0] * frame->size[1];
        for (uint32_t i = 0; i < count; i++) {
            coefficients[i] = -coefficients[i];
        }
    }
}
