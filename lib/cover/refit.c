#include "lib/cover/refit.h"

#include <string.h>

#include "lib/cover/fast_parts.h"

// A part of a column: rows of coefficients that are solved for, and on either side of them as many as their bends and
// the lift reach. The bound over the interval h is made of b[h-1] … b[h+2], so coefficients first … last concern the
// nodes from first - 2 to last + 2, and mending those may raise what is one row further.
#define PINS 3

enum line_state {
    LINE_SETTLED,
    LINE_CHANGED,  // its cells have changed since it was fitted
    LINE_FITTED    // the columns do not know yet
};

static uint32_t row_count(const struct canopy_refit *refit) { return refit->fast.field->frame.size[0] - 1U; }

enum canopy_status canopy_refit_init(struct canopy_refit *refit, const struct canopy_field *field,
                                     const struct canopy_line_fit *fit, uint16_t lines, void *arena, size_t bytes) {
    const uint16_t m = field->frame.size[0], n = field->frame.size[1];
    const uint16_t cu = field->axis[0].cells, cv = field->axis[1].cells;
    struct canopy_arena cut;
    enum canopy_status status = canopy_arena_open(&cut, arena, bytes, CANOPY_REFIT_ARENA(m, n, cu, cv, lines));
    if (status != CANOPY_OK) {
        return status;
    }
    *refit = (struct canopy_refit){0};
    const size_t fast = CANOPY_FAST_ARENA(m, n, cv, lines), certify = CANOPY_CERTIFY_ARENA(n, cu, cv);
    void *for_fast = canopy_arena_take(&cut, fast), *for_certify = canopy_arena_take(&cut, certify);
    status = canopy_fast_init(&refit->fast, field, fit, lines, for_fast, fast);
    if (status == CANOPY_OK) {
        status = canopy_certify_init(&refit->certify, field, for_certify, certify);
    }
    if (status != CANOPY_OK) {
        return status;
    }
    refit->coefficients = canopy_arena_take(&cut, 4U * (size_t)m * n);
    refit->lines = canopy_arena_take(&cut, canopy_fast_line_count(&refit->fast));
    refit->margins = canopy_arena_take(&cut, 4U * m);
    refit->low = canopy_arena_take(&cut, 4U * m);
    refit->high = canopy_arena_take(&cut, 4U * m);
    refit->pins = canopy_arena_take(&cut, 4U * m);
    refit->uncertified = canopy_arena_take(&cut, m);
    refit->blank = canopy_arena_take(&cut, n);
    memset(refit->coefficients, 0, 4U * (size_t)m * n);
    canopy_refit_changed(refit, 0, row_count(refit));
    return CANOPY_OK;
}

// ---- What has changed

void canopy_refit_rose(struct canopy_refit *refit, uint32_t cell) {
    const struct canopy_field *field = refit->fast.field;
    const uint32_t row = cell / field->axis[1].count, h = row / field->axis[0].cells;
    const uint32_t line = row / ((uint32_t)field->axis[0].cells / refit->fast.lines);  // and the next see the cell
    if (field->heights == NULL) {  // packed: all cells of the knot cell may have risen, to what its new code can tell
        canopy_refit_changed(refit, h, 1);
        return;
    }
    const int32_t height = field->heights[cell];
    refit->low[h] = height < refit->low[h] ? height : refit->low[h];
    refit->high[h] = height > refit->high[h] ? height : refit->high[h];
    refit->lines[line] = LINE_CHANGED;
    refit->lines[line + 1] = LINE_CHANGED;
    refit->uncertified[h] = true;
}

static void scan(struct canopy_refit *refit, uint32_t h) {
    const struct canopy_field *field = refit->fast.field;
    const uint32_t cells = field->axis[0].cells * field->axis[1].count;
    int32_t low = INT32_MAX, high = INT32_MIN;
    for (uint32_t c = h * cells; c < (h + 1) * cells; c++) {
        const int32_t height = canopy_field_height(field, c);
        if (height != CANOPY_NO_HEIGHT) {
            low = height < low ? height : low;
            high = height > high ? height : high;
        }
    }
    refit->low[h] = low;
    refit->high[h] = high;
}

void canopy_refit_changed(struct canopy_refit *refit, uint32_t row, uint32_t count) {
    for (uint32_t h = row; h < row + count; h++) {
        scan(refit, h);
        refit->uncertified[h] = refit->high[h] != INT32_MIN;  // without data there is nothing to prove
        refit->margins[h] = INT32_MAX;
        memset(refit->lines + h * refit->fast.lines, LINE_CHANGED, refit->fast.lines + 1U);
    }
}

// Ends the refit in work. A line that had begun is still to be fitted, and so are the columns of the run in work.
static void put_down(struct canopy_refit *refit) {
    if (refit->begun && refit->stage == CANOPY_REFIT_LINES) {
        refit->lines[refit->index] = LINE_CHANGED;
    }
    if (refit->stage == CANOPY_REFIT_COLUMNS) {
        for (uint32_t line = refit->run_line; line < refit->next_line; line++) {
            refit->lines[line] = refit->lines[line] == LINE_SETTLED ? LINE_FITTED : refit->lines[line];
        }
    }
    if (refit->begun && refit->stage == CANOPY_REFIT_CERTIFY) {
        refit->uncertified[refit->index] = true;
    }
    refit->begun = false;
    if (refit->stage != CANOPY_REFIT_FAILED) {
        refit->stage = CANOPY_REFIT_IDLE;
    }
}

// Moves `count` things of `size` bytes to the front by `by` of them.
static void slide(void *things, size_t size, size_t count, size_t by) {
    memmove(things, (unsigned char *)things + by * size, (count - by) * size);
}

static void slide_coefficients(struct canopy_refit *refit, uint32_t rows) {
    const uint32_t m = refit->fast.field->frame.size[0], n = refit->fast.field->frame.size[1];
    slide(refit->coefficients, 4U * (size_t)n, m, rows);
    for (uint32_t i = m - rows; i < m; i++) {  // as the surface was beyond its end, until it is fitted
        memcpy(refit->coefficients + (size_t)i * n, refit->coefficients + (size_t)(i - 1) * n, 4U * (size_t)n);
    }
}

static void slide_lines(struct canopy_refit *refit, uint32_t rows) {
    struct canopy_fast *fast = &refit->fast;
    const uint32_t n = fast->field->frame.size[1], by = rows * fast->lines, count = canopy_fast_line_count(fast);
    slide(fast->g, 4U * (size_t)n, count, by);
    slide(fast->held, CANOPY_FAST_HELD_BYTES(n), count, by);
    slide(refit->lines, 1, count, by);
}

void canopy_refit_shift(struct canopy_refit *refit, uint32_t rows) {
    const uint32_t all = row_count(refit);
    put_down(refit);
    if (rows < all) {
        slide_coefficients(refit, rows);
        slide_lines(refit, rows);
        slide(refit->uncertified, 1, all, rows);
        slide(refit->margins, 4, all, rows);
        slide(refit->low, 4, all, rows);
        slide(refit->high, 4, all, rows);
        canopy_refit_changed(refit, all - rows, rows);
    } else {
        canopy_refit_changed(refit, 0, all);
    }
    refit->low[0] = INT32_MAX;
    refit->high[0] = INT32_MIN;
    refit->margins[0] = INT32_MAX;
    refit->uncertified[0] = false;
}

// ---- Beginning

// Coefficients beyond one range of the data below or above it have exploded (fast.h).
static void limit(struct canopy_refit *refit) {
    int32_t low = INT32_MAX, high = INT32_MIN;
    for (uint32_t h = 0; h < row_count(refit); h++) {
        low = refit->low[h] < low ? refit->low[h] : low;
        high = refit->high[h] > high ? refit->high[h] : high;
    }
    const int32_t reach = low <= high ? high - low + 64 : 0;  // the 64: a flat field's solve may round
    refit->fast.floor = low <= high ? low - reach : 0;
    refit->fast.ceiling = low <= high ? high + reach : 0;
}

void canopy_refit_begin(struct canopy_refit *refit) {
    struct canopy_fast *fast = &refit->fast;
    const struct canopy_frame *frame = &fast->field->frame;
    put_down(refit);
    if (refit->stage == CANOPY_REFIT_FAILED) {
        memset(refit->coefficients, 0, 4U * (size_t)frame->size[0] * frame->size[1]);
        canopy_refit_changed(refit, 0, row_count(refit));
    }
    limit(refit);
    refit->stage = CANOPY_REFIT_LINES;
    refit->index = 0;
    refit->solves = 0;
    refit->fitted = 0;
    refit->certified = 0;
    refit->changed_first = frame->size[0];
    refit->changed_end = 0;
    fast->line.pins = NULL;
    fast->fit->shape(&fast->line, frame->size[1], fast->field->axis[1].cells);
}

// ---- Lines

static void next_stage(struct canopy_refit *refit);

static void fit_line(struct canopy_refit *refit) {
    struct canopy_fast *fast = &refit->fast;
    const uint32_t count = canopy_fast_line_count(fast);
    if (!refit->begun) {
        while (refit->index < count && refit->lines[refit->index] != LINE_CHANGED) {
            refit->index++;
        }
        if (refit->index == count) {
            next_stage(refit);
            return;
        }
        refit->lines[refit->index] = LINE_FITTED;  // a cell that rises from now on makes it changed again
        refit->fitted++;
        refit->begun = canopy_fast_begin_line(fast, refit->index);
    } else if (!fast->fit->iterate(&fast->line)) {
        canopy_fast_finish_line(fast, refit->index);
        refit->solves += fast->line.solves;
        refit->begun = false;
    }
}

// ---- Columns

static uint32_t part_from(const struct canopy_refit *refit) { return refit->first > PINS ? refit->first - PINS : 0; }

static uint32_t part_to(const struct canopy_refit *refit) {
    const uint32_t m = refit->fast.field->frame.size[0];
    return refit->last + PINS < m ? refit->last + PINS : m - 1;
}

// The next run of rows to be solved for: those around lines that were fitted and are not far from each other.
static bool find_run(struct canopy_refit *refit) {
    const uint32_t count = canopy_fast_line_count(&refit->fast), each = refit->fast.lines;
    uint32_t line = refit->next_line;
    while (line < count && refit->lines[line] != LINE_FITTED) {
        line++;
    }
    if (line == count) {
        return false;
    }
    const uint32_t row = line / each;
    refit->run_line = line;
    refit->first = row > CANOPY_REFIT_REACH ? row - CANOPY_REFIT_REACH : 0;
    uint32_t last = line;
    for (; line < count && line / each <= last / each + 2 * CANOPY_REFIT_REACH + 1; line++) {
        if (refit->lines[line] == LINE_FITTED) {
            last = line;
            refit->lines[line] = LINE_SETTLED;
        }
    }
    refit->next_line = last + 1;
    refit->last = (last + each - 1) / each + CANOPY_REFIT_REACH;
    refit->last = refit->last < row_count(refit) ? refit->last : row_count(refit);
    refit->index = 0;
    return true;
}

// The nodes that the part concerns. Where the line goes on, those next to its ends do not see all they depend on: they
// are left out, and are not concerned.
static void gather_nodes(struct canopy_refit *refit) {
    struct canopy_fast *fast = &refit->fast;
    const uint32_t n = fast->field->frame.size[1], each = fast->lines, j = refit->index;
    const uint32_t from = part_from(refit), to = part_to(refit);
    const uint32_t low = from == 0 ? 0 : (from + 1) * each;
    const uint32_t high = to == row_count(refit) ? to * each : (to - 1) * each;
    int32_t *node = fast->line.nodes;
    for (uint32_t r = from * each; r <= to * each; r++) {
        const bool counts = r >= low && r <= high && canopy_fast_is_held(fast, r, j);
        *node++ = counts ? fast->g[(size_t)r * n + j] : CANOPY_NO_HEIGHT;
    }
}

// Rows around the run are pinned, but for those that nothing covered can see: these hold any value.
static void gather_pins(struct canopy_refit *refit) {
    const uint32_t n = refit->fast.field->frame.size[1], from = part_from(refit), to = part_to(refit);
    for (uint32_t i = from; i <= to; i++) {
        const bool pinned = (i < refit->first || i > refit->last) && canopy_fast_is_seen(&refit->fast, i, refit->index);
        refit->pins[i - from] = pinned ? refit->coefficients[(size_t)i * n + refit->index] : CANOPY_NO_HEIGHT;
    }
}

// What a coefficient in row i shapes is not proved any more.
static void unprove(struct canopy_refit *refit, uint32_t i) {
    for (uint32_t h = i > 2 ? i - 2 : 0; h <= i + 1 && h < row_count(refit); h++) {
        refit->uncertified[h] = true;
    }
    refit->changed_first = i < refit->changed_first ? i : refit->changed_first;
    refit->changed_end = i + 1 > refit->changed_end ? i + 1 : refit->changed_end;
}

static void set(struct canopy_refit *refit, uint32_t i, uint32_t j, int32_t value) {
    int32_t *b = &refit->coefficients[(size_t)i * refit->fast.field->frame.size[1] + j];
    if (*b != value) {
        *b = value;
        unprove(refit, i);
    }
}

static bool counts(const struct canopy_refit *refit, uint32_t i) {
    if (i < refit->first || i > refit->last) {
        return refit->pins[i - part_from(refit)] != CANOPY_NO_HEIGHT;
    }
    return canopy_fast_is_seen(&refit->fast, i, refit->index);
}

// From the part's solution to the coefficients. What nothing covered can see takes the value before it, or else the
// first there is. False if there is none.
static bool store_part(struct canopy_refit *refit) {
    const uint32_t from = part_from(refit), to = part_to(refit);
    uint32_t known = from;
    while (known <= to && !counts(refit, known)) {
        known++;
    }
    if (known > to) {
        return false;
    }
    int32_t value = refit->fast.result[known - from];
    for (uint32_t i = from; i <= to; i++) {
        const bool counted = i == known || (i > known && counts(refit, i));
        value = counted ? refit->fast.result[i - from] : value;
        if (counted || (i >= refit->first && i <= refit->last)) {
            set(refit, i, refit->index, value);
        }
    }
    return true;
}

// Gives columns without anything to be seen in this run the values of the nearest one before them, or after.
static void fill_blanks(struct canopy_refit *refit) {
    const uint32_t n = refit->fast.field->frame.size[1];
    uint32_t known = 0;
    while (known < n && refit->blank[known]) {
        known++;
    }
    for (uint32_t j = 0; known < n && j < n; j++) {
        known = refit->blank[j] ? known : j;
        for (uint32_t i = refit->first; known != j && i <= refit->last; i++) {
            set(refit, i, j, refit->coefficients[(size_t)i * n + known]);
        }
    }
}

static void begin_column(struct canopy_refit *refit) {
    struct canopy_line *line = &refit->fast.line;
    gather_nodes(refit);
    gather_pins(refit);
    line->pins = refit->pins;
    line->count = (uint16_t)(part_to(refit) - part_from(refit) + 1);
    refit->begun = refit->fast.fit->begin(line, refit->fast.floor, refit->fast.ceiling);
}

static void next_column(struct canopy_refit *refit) {
    if (++refit->index == refit->fast.field->frame.size[1]) {
        fill_blanks(refit);
        if (!find_run(refit)) {
            next_stage(refit);
        }
    }
}

static void fit_column(struct canopy_refit *refit) {
    struct canopy_fast *fast = &refit->fast;
    if (!refit->begun) {
        begin_column(refit);
        if (!refit->begun) {
            refit->blank[refit->index] = true;
            next_column(refit);
        }
    } else if (!fast->fit->iterate(&fast->line)) {
        fast->fit->finish(&fast->line, fast->result);
        refit->solves += fast->line.solves;
        refit->blank[refit->index] = !store_part(refit);
        refit->begun = false;
        next_column(refit);
    }
}

// ---- The certificate

static void fail(struct canopy_refit *refit) {
    refit->stage = CANOPY_REFIT_FAILED;
    refit->begun = false;
}

// Finds the next knot row to certify. Where there is no data there is nothing to prove.
static void find_uncertified(struct canopy_refit *refit) {
    const uint32_t q = refit->fast.field->axis[0].cells;
    for (uint32_t h = 0; h < row_count(refit); h++) {
        if (!refit->uncertified[h]) {
            continue;
        }
        refit->uncertified[h] = false;  // a cell that rises from now on raises the flag again
        if (refit->high[h] != INT32_MIN) {
            refit->index = h;
            refit->begun = true;
            canopy_certify_seek(&refit->certify, h * q);
            return;
        }
        refit->margins[h] = INT32_MAX;
    }
    next_stage(refit);
}

// Raises what shapes the cell that failed. No bound falls by that: what is proved elsewhere stays proved.
static void mend(struct canopy_refit *refit) {
    const struct canopy_certify *certify = &refit->certify;
    if (canopy_fast_raise(refit->fast.field, refit->coefficients, certify->failed_cell, certify->missing) !=
        CANOPY_OK) {
        fail(refit);
        return;
    }
    const uint32_t from = refit->index > 0 ? refit->index - 1 : 0;
    const uint32_t to = refit->index + 3 < row_count(refit) + 1 ? refit->index + 3 : row_count(refit) + 1;
    refit->changed_first = from < refit->changed_first ? from : refit->changed_first;
    refit->changed_end = to > refit->changed_end ? to : refit->changed_end;
}

static void certify_row(struct canopy_refit *refit) {
    if (!refit->begun) {
        find_uncertified(refit);
        return;
    }
    const uint32_t end = (refit->index + 1) * refit->fast.field->axis[0].cells;
    switch (canopy_certify_step(&refit->certify, end - refit->certify.row)) {
    case CANOPY_NOT_SAFE: mend(refit); break;
    case CANOPY_RANGE: fail(refit); break;
    default:
        refit->margins[refit->index] = refit->certify.margin;
        refit->certified++;
        refit->begun = false;
        break;
    }
}

// ---- The steps

static void next_stage(struct canopy_refit *refit) {
    struct canopy_fast *fast = &refit->fast;
    refit->begun = false;
    if (refit->stage == CANOPY_REFIT_LINES) {
        fast->fit->shape(&fast->line, fast->field->frame.size[0], fast->lines);
        refit->stage = CANOPY_REFIT_COLUMNS;
        refit->next_line = 0;
        if (find_run(refit)) {
            return;
        }
    }
    if (refit->stage == CANOPY_REFIT_COLUMNS) {
        canopy_certify_begin(&refit->certify, refit->coefficients);
        refit->stage = CANOPY_REFIT_CERTIFY;
    } else {
        refit->stage = CANOPY_REFIT_IDLE;
    }
}

enum canopy_status canopy_refit_step(struct canopy_refit *refit, uint32_t budget) {
    for (; budget > 0; budget--) {
        switch (refit->stage) {
        case CANOPY_REFIT_LINES: fit_line(refit); break;
        case CANOPY_REFIT_COLUMNS: fit_column(refit); break;
        case CANOPY_REFIT_CERTIFY: certify_row(refit); break;
        default: budget = 1; break;
        }
    }
    switch (refit->stage) {
    case CANOPY_REFIT_IDLE: return CANOPY_OK;
    case CANOPY_REFIT_FAILED: return CANOPY_RANGE;
    default: return CANOPY_MORE;
    }
}

bool canopy_refit_is_certified(const struct canopy_refit *refit) {
    for (uint32_t h = 0; h < row_count(refit); h++) {
        if (refit->uncertified[h]) {
            return false;
        }
    }
    return refit->stage == CANOPY_REFIT_IDLE;
}

bool canopy_refit_is_due(const struct canopy_refit *refit) {
    for (uint32_t r = 0; r < canopy_fast_line_count(&refit->fast); r++) {
        if (refit->lines[r] != LINE_SETTLED) {
            return true;
        }
    }
    return !canopy_refit_is_certified(refit);
}

int32_t canopy_refit_margin(const struct canopy_refit *refit) {
    int32_t margin = INT32_MAX;
    for (uint32_t h = 0; h < row_count(refit); h++) {
        margin = refit->margins[h] < margin ? refit->margins[h] : margin;
    }
    return margin;
}
