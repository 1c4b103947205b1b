// What the station promises (lib/station/station.h) in every interleaving of readings, steps, commands and reads.
//
// A model that shares nothing with lib/cover stands beside each station: it keeps every accepted reading and judges
// what is published in whole numbers of 128 bits, with weights of the uniform cubic B-spline written down here. After
// every call:
//   - a new publication covers exactly the readings accepted so far: its `points` is their number, each of them is on
//     the safe side by `margin` at least, its coverage is their cells;
//   - the intrusion bit stands, and bit 0 is clear, if any reading since lies beyond what is published; it goes only
//     with a publication (or the scene), never while a reading out of all range is remembered, and it comes only
//     with a reading that is at least nearly beyond;
//   - stale, age, counters and coverage are what the model counts.
// Half of the stations are in float: then the model asks the host's own floats which points they hold, and readings are
// judged as the float nearest to them, too.
// CANOPY_STATIONS sets how many random lives are lived (default 1500); a failure prints the seed, and CANOPY_SEED=n
// lives that one alone.
#include <float.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "canopy_registers.h"
#include "lib/cover/line.h"
#include "lib/spline/surface.h"
#include "lib/station/station.h"
#include "lib/station/tightening.h"
#include "tools/common/random.h"

__extension__ typedef __int128 wide;

enum { WILD_MOST = 2147480000, GRID_MAX = 8, CELLS_MAX = 4, READINGS_MAX = 4000, KEPT_MAX = 4096, CLIENTS = 3 };

// ---------------------------------------------------------------------------------------------------------------------
// The model

struct reading {
    int32_t point[3];  // z at the unsafe end of its uncertainty
};

struct copy {
    struct canopy_envelope envelope;
    int32_t coefficients[GRID_MAX * GRID_MAX];
    uint8_t coverage[(GRID_MAX * GRID_MAX + 7) / 8];
};

struct world {
    struct canopy_station station;
    struct canopy_station_config config;
    struct canopy_modbus_bank bank;
    uint64_t *arena;
    struct canopy_station_tightening tightening;
    bool tight;  // spends its spare time on that
    uint64_t seed, random, now_us;

    struct canopy_frame frame;
    bool scene;
    struct reading readings[READINGS_MAX];
    uint32_t count;  // accepted since the scene began
    uint32_t accepted, rejected;
    uint64_t last_us;
    bool have_last;
    uint32_t sequence;   // published, 0: none
    uint32_t published;  // publications so far
    bool beyond;         // a reading lies beyond what is published
    bool latched;        // a reading out of all range was seen
    bool intrusion;      // as the station said last
    struct copy *kept;   // every publication, by sequence
};

// What the random lives have met, so that a promise is not kept only because nothing happened.
static struct {
    uint64_t raised[CANOPY_STATION_SETTLING + 1];  // readings that raised a cell, by stage
    uint64_t intrusions, lower, late, ranges, refreshes, withdrawals, restarts, publications, fails, held, broken;
    uint64_t tightened, kept, given_up;
    uint64_t refused, lifted;  // scenes that are not for floats, readings further down than floats go
} met;

#define ROWS_MAX CANOPY_TIGHTEN_ROWS_FEW(GRID_MAX, GRID_MAX)
static CANOPY_ARENA_DECLARE(tightening_arena, CANOPY_STATION_TIGHTENING_ARENA(GRID_MAX, GRID_MAX, CELLS_MAX, ROWS_MAX));

static struct world world;

static uint32_t below(struct world *w, uint32_t n) { return canopy_random_below(&w->random, n); }
static bool chance(struct world *w, double p) { return canopy_random_chance(&w->random, p); }

static void wrong(const struct world *w, const char *what) {
    fail_msg("CANOPY_SEED=%llu: %s (reading %u, sequence %u, stage %d)", (unsigned long long)w->seed, what, w->count,
             w->sequence, w->station.stage);
}

#define MUST(condition)                                                                                                \
    do {                                                                                                               \
        if (!(condition)) {                                                                                            \
            wrong(w, #condition);                                                                                      \
        }                                                                                                              \
    } while (0)

// Six times the four weights at t = part / pitch, times pitch^3.
static void weights(int64_t part, int64_t pitch, int64_t to[4]) {
    const int64_t rest = pitch - part;
    to[0] = rest * rest * rest;
    to[1] = 3 * part * part * part - 6 * part * part * pitch + 4 * pitch * pitch * pitch;
    to[2] = 3 * rest * rest * rest - 6 * rest * rest * pitch + 4 * pitch * pitch * pitch;
    to[3] = part * part * part;
}

// The distance of a point to the safe side of an envelope's surface, times 36 pu^3 pv^3, in steps: negative beyond it.
static wide distance(const struct copy *copy, const struct reading *reading, wide *scale) {
    const struct canopy_frame *frame = &copy->envelope.frame;
    int64_t w[2][4], first[2];
    for (int a = 0; a < 2; a++) {
        const int64_t offset = (int64_t)reading->point[a] - frame->origin[a], pitch = frame->pitch[a];
        int64_t interval = offset / pitch;
        interval = interval > frame->size[a] - 2 ? frame->size[a] - 2 : interval;
        weights(offset - interval * pitch, pitch, w[a]);
        first[a] = interval - 1;
    }
    wide surface = 0;
    for (int i = 0; i < 4; i++) {
        for (int j = 0; j < 4; j++) {
            int64_t row = first[0] + i, column = first[1] + j;
            row = row < 0 ? 0 : row >= frame->size[0] ? frame->size[0] - 1 : row;
            column = column < 0 ? 0 : column >= frame->size[1] ? frame->size[1] - 1 : column;
            surface += (wide)(w[0][i] * w[1][j]) * copy->coefficients[row * frame->size[1] + column];
        }
    }
    const wide pu = frame->pitch[0], pv = frame->pitch[1];
    *scale = 36 * pu * pu * pu * pv * pv * pv;
    const int64_t height = (int64_t)reading->point[2] - frame->origin[2];
    const int up = frame->lsb_log2 < 0 ? -frame->lsb_log2 : 0, down = frame->lsb_log2 > 0 ? frame->lsb_log2 : 0;
    // Both sides in units of 2^-up quanta times the scale: the point exactly, the surface exactly.
    const wide gap = surface * ((wide)1 << down) - (wide)height * ((wide)1 << up) * *scale;
    *scale *= (wide)1 << down;
    return frame->side == CANOPY_ABOVE ? gap : -gap;
}

static bool inside(const struct canopy_frame *frame, const int32_t point[3]) {
    for (int a = 0; a < 2; a++) {
        const int64_t offset = (int64_t)point[a] - frame->origin[a];
        if (offset < 0 || offset > (int64_t)frame->pitch[a] * (frame->size[a] - 1)) {
            return false;
        }
    }
    return true;
}

static bool is_in_float(const struct world *w) { return w->config.fit == &canopy_line_fit_f32; }

// Whether a whole number is a float, as all between it and 0 are.
static bool is_counted(int64_t x) {
    const int64_t size = x < 0 ? -x : x;
    return size <= INT64_C(1) << FLT_MANT_DIG && (int64_t)(float)size == size;
}

static bool is_scene_counted(const struct canopy_frame *frame, const int32_t low[3], const int32_t high[3]) {
    bool counted = true;
    for (int a = 0; a < 3; a++) {
        const int64_t end = a < 2 ? frame->origin[a] + (int64_t)frame->pitch[a] * (frame->size[a] - 1) : low[2];
        counted = counted && is_counted(low[a]) && is_counted(high[a]) && is_counted(end);
    }
    return counted;
}

// Over +-2^25 steps from the origin: on the side that matters (1) out of range, on the other (-1) as good as the limit.
static int over_limit(const struct canopy_frame *frame, int32_t z) {
    int64_t height = (int64_t)z - frame->origin[2];
    height = frame->side == CANOPY_BELOW ? -height : height;
    const int64_t limit = frame->lsb_log2 <= 0 ? (int64_t)CANOPY_HEIGHT_LIMIT >> -frame->lsb_log2
                                               : (int64_t)CANOPY_HEIGHT_LIMIT << frame->lsb_log2;
    return height > limit ? 1 : height < -limit ? -1 : 0;
}

// ---------------------------------------------------------------------------------------------------------------------
// What must hold after every call

static void check_coverage(struct world *w, const struct copy *copy) {
    const struct canopy_frame *frame = &copy->envelope.frame;
    uint8_t expected[sizeof copy->coverage] = {0};
    const uint32_t across = frame->size[1] - 1U, cells = (frame->size[0] - 1U) * across;
    for (uint32_t i = 0; i < w->count; i++) {
        uint32_t at[2];
        for (int a = 0; a < 2; a++) {
            at[a] = (uint32_t)(w->readings[i].point[a] - frame->origin[a]) / frame->pitch[a];
            at[a] = at[a] > frame->size[a] - 2U ? frame->size[a] - 2U : at[a];
        }
        const uint32_t bit = at[0] * across + at[1];
        expected[bit / 8] |= (uint8_t)(1U << bit % 8);
    }
    MUST(memcmp(expected, copy->coverage, (cells + 7) / 8) == 0);
    uint32_t covered = 0;
    for (uint32_t bit = 0; bit < cells; bit++) {
        covered += expected[bit / 8] >> bit % 8 & 1U;
    }
    struct canopy_plc_live live = {0};
    w->station.plc.config.source.live(&w->station, &live);
    MUST(live.coverage_pct * cells <= 100U * covered && 100U * covered < (live.coverage_pct + 1U) * cells);
}

static void check_publication(struct world *w) {
    const struct canopy_envelope *envelope = canopy_plc_published(&w->station.plc);
    MUST(w->sequence == w->published + 1 && w->sequence < KEPT_MAX);
    w->published = w->sequence;
    met.publications++;
    struct copy *copy = &w->kept[w->sequence];
    copy->envelope = *envelope;
    memcpy(copy->coefficients, envelope->coefficients, 4U * envelope->frame.size[0] * envelope->frame.size[1]);
    memcpy(copy->coverage, envelope->coverage, CANOPY_COVERAGE_BYTES(envelope->frame.size[0], envelope->frame.size[1]));
    MUST(memcmp(&envelope->frame, &w->frame, sizeof w->frame) == 0);
    MUST(envelope->scalar == (is_in_float(w) ? CANOPY_F32 : CANOPY_FX));
    MUST(envelope->points == w->count && w->count > 0 && envelope->margin >= 0);
    for (uint32_t i = 0; i < w->count; i++) {
        wide scale;
        const wide gap = distance(copy, &w->readings[i], &scale);
        MUST(gap >= envelope->margin * scale);
    }
    check_coverage(w, copy);
    w->beyond = w->latched;
}

static void check(struct world *w) {
    const uint32_t sequence = canopy_plc_sequence(&w->station.plc);
    const bool news = sequence != w->sequence && sequence != 0;
    w->sequence = sequence;
    MUST((canopy_plc_published(&w->station.plc) != NULL) == (sequence != 0));
    if (news) {
        check_publication(w);
    }
    uint8_t bytes[2 * 8];
    MUST(w->bank.read(w->bank.context, 0, CANOPY_REGISTER_HEARTBEAT, 8, bytes) == 0);
    const uint16_t status = (uint16_t)(bytes[2] << 8 | bytes[3]);
    const uint32_t age = (uint32_t)bytes[4] << 24 | (uint32_t)bytes[5] << 16 | (uint32_t)bytes[6] << 8 | bytes[7];
    const bool stale = !w->have_last || w->now_us - w->last_us > w->config.stale_after_us;
    const bool intrusion = (status & CANOPY_PLC_INTRUSION) != 0;
    MUST(((status & CANOPY_PLC_STALE) != 0) == stale);
    MUST(age == (w->have_last ? (w->now_us - w->last_us) / 1000 : UINT32_MAX));
    MUST(((status & CANOPY_PLC_VALID) != 0) == (sequence != 0 && !stale && !intrusion));
    MUST(intrusion || !(w->beyond || w->latched));
    MUST(intrusion || !w->intrusion || news || !w->have_last);
    w->intrusion = intrusion;
    MUST(w->station.accepted == w->accepted && w->station.rejected == w->rejected && w->station.points == w->count);
}

// ---------------------------------------------------------------------------------------------------------------------
// What happens to a station

static void forget_scene(struct world *w) {
    w->count = 0;
    w->have_last = w->beyond = w->latched = w->intrusion = false;
}

static void start(struct world *w, const struct canopy_station_config *config) {
    const size_t bytes = CANOPY_STATION_ARENA(config->grid.size[0], config->grid.size[1], config->grid.cells,
                                              config->lines, config->clients);
    struct copy *kept = w->kept;
    const uint64_t seed = w->seed, random = w->random;
    free(w->arena);
    memset(w, 0, sizeof *w);
    w->kept = kept;
    w->seed = seed;
    w->random = random;
    w->config = *config;
    w->now_us = 1000000;
    w->arena = malloc(bytes);  // just as much as asked for: the sanitizer watches the end
    assert_non_null(w->arena);
    assert_int_equal(canopy_station_init(&w->station, config, w->arena, bytes, w->now_us), CANOPY_OK);
    w->bank = canopy_station_bank(&w->station);
}

// Has the station spend its spare time on tightening.
static void tighten(struct world *w) {
    const struct canopy_grid *grid = &w->config.grid;
    const uint32_t rows = CANOPY_TIGHTEN_ROWS_FEW(grid->size[0], grid->size[1]);
    assert_int_equal(canopy_station_tightening_init(
                         &w->tightening, grid, rows, tightening_arena,
                         CANOPY_STATION_TIGHTENING_ARENA(grid->size[0], grid->size[1], grid->cells, rows)),
                     CANOPY_OK);
    w->station.spare = &w->tightening.spare;
    w->tight = true;
}

static void do_scene(struct world *w, const int32_t low[3], const int32_t high[3]) {
    struct canopy_frame frame;
    MUST(canopy_frame_around_fx(&frame, &w->config.grid, low, high) == CANOPY_OK);
    const bool refused = is_in_float(w) && !is_scene_counted(&frame, low, high);
    const bool same = refused || (w->scene && memcmp(&frame, &w->frame, sizeof frame) == 0);
    MUST(canopy_station_begin_box(&w->station, low, high) == (refused ? CANOPY_RANGE : CANOPY_OK));
    met.refused += refused;
    if (!same) {
        w->frame = frame;
        w->scene = true;
        forget_scene(w);
        MUST(canopy_plc_sequence(&w->station.plc) == 0);
        w->sequence = 0;
    }
    check(w);
}

static int64_t sum_of_cells(const struct world *w) {
    int64_t sum = 0;
    for (uint32_t c = 0; w->scene && c < w->station.field.axis[0].count * w->station.field.axis[1].count; c++) {
        sum += w->station.field.heights[c];
    }
    return sum;
}

static void note_stage(const struct world *w, int64_t sum_before) {
    met.raised[w->station.stage] += sum_of_cells(w) != sum_before;
    met.late += w->station.late_count > 0;
}

// Whether the reading is beyond what is published, or so near that the station may take it for that.
static void judge(const struct world *w, const struct reading *reading, bool *beyond, bool *near) {
    wide scale = 1;
    const wide gap = w->sequence == 0 ? 0 : distance(&w->kept[w->sequence], reading, &scale);
    *beyond = w->sequence != 0 && gap < 0;
    // The height itself is rounded up, too; and what is far on the safe side is taken for the limit.
    const bool close = gap < (2 * CANOPY_SURFACE_FX_ERROR + 1) * scale || over_limit(&w->frame, reading->point[2]) < 0;
    *near = w->sequence != 0 && close;
}

static void do_reading(struct world *w, const int32_t point[3], uint32_t uncertainty) {
    const bool above = w->config.grid.side == CANOPY_ABOVE;
    const bool far = is_in_float(w) && !is_counted(point[2]), high = far && (point[2] > 0) == above;
    const int32_t most = 1 << FLT_MANT_DIG, z = !far ? point[2] : above ? -most : most;
    const struct reading worst = {{point[0], point[1], above ? z + (int32_t)uncertainty : z - (int32_t)uncertainty}};
    const bool in = w->scene && inside(&w->frame, point);
    const bool range = in && (high || over_limit(&w->frame, worst.point[2]) > 0);
    bool beyond = false, near = false;
    if (in && !range) {
        judge(w, &worst, &beyond, &near);
    }
    const uint32_t intrusions = w->station.intrusions;
    const int64_t sum = sum_of_cells(w);
    const enum canopy_status status = canopy_station_reading(&w->station, point, uncertainty, w->now_us);
    MUST(status == (!w->scene ? CANOPY_EMPTY : !in ? CANOPY_OUT_OF_FRAME : range ? CANOPY_RANGE : CANOPY_OK));
    if (status == CANOPY_OK) {
        MUST(w->count < READINGS_MAX);
        if (is_in_float(w)) {  // as a PLC's file reads it
            const double read = (double)(float)point[2];
            MUST(above ? read <= (double)worst.point[2] : read >= (double)worst.point[2]);
            MUST((int32_t)(float)point[0] == point[0] && (int32_t)(float)point[1] == point[1]);
            met.lifted += far;
        }
        w->readings[w->count++] = worst;
        w->accepted++;
        w->last_us = w->now_us;
        w->have_last = true;
        w->beyond = w->beyond || beyond;
        MUST(w->station.intrusions == intrusions || near);
        met.intrusions += beyond;
        note_stage(w, sum);
    } else {
        w->rejected++;
        w->latched = w->latched || range;
        met.ranges += range;
    }
    check(w);
}

static void do_step(struct world *w, uint32_t budget) {
    const uint32_t failed = w->station.fits_failed, points = w->station.published_points, sequence = w->sequence;
    const bool resting = w->station.stage == CANOPY_STATION_RESTING, kept = w->station.kept;
    canopy_station_step(&w->station, budget, w->now_us);
    met.fails += w->station.fits_failed - failed;
    check(w);
    met.tightened += w->sequence > sequence && w->station.tightened && !kept;
    met.kept += w->sequence > sequence && w->station.tightened && kept;
    met.given_up += kept && !w->station.kept && !w->station.tightened;
    met.refreshes += resting && w->station.stage == CANOPY_STATION_RESTING && w->sequence != sequence &&
                     w->station.published_points != points && budget == 0;
}

static void do_command(struct world *w, enum canopy_plc_command_code code) {
    const uint8_t bytes[2] = {(uint8_t)(below(w, 255) + 1), (uint8_t)code};
    const uint8_t client = (uint8_t)below(w, CLIENTS);
    uint8_t before[2], answer[6];
    MUST(w->bank.read(w->bank.context, client, CANOPY_REGISTER_COMMAND, 1, before) == 0);
    if (memcmp(before, bytes, 2) == 0) {
        return;  // the same command again means nothing
    }
    MUST(w->bank.write(w->bank.context, client, CANOPY_REGISTER_COMMAND, 1, bytes, 6) == 0);
    MUST(w->bank.read(w->bank.context, client, CANOPY_REGISTER_COMMAND, 3, answer) == 0);
    const bool refused = !w->scene || (code == CANOPY_PLC_COMMAND_REFIT && w->count == 0);
    MUST(answer[5] == (refused ? CANOPY_PLC_RESULT_REFUSED : CANOPY_PLC_RESULT_DONE));
    if (!refused && code == CANOPY_PLC_COMMAND_RESTART) {
        forget_scene(w);
        met.restarts++;
    }
    if (!refused && code != CANOPY_PLC_COMMAND_REFIT) {
        MUST(canopy_plc_sequence(&w->station.plc) == 0);
        met.withdrawals++;
    }
    check(w);
}

// A client reads an envelope block by block while life goes on: one sequence, or the hold is broken and it reads 0.
static void read_block(struct world *w, uint8_t client, uint32_t sequence, uint16_t block) {
    uint8_t bytes[2 * 124];
    const uint32_t count = (uint32_t)w->config.grid.size[0] * w->config.grid.size[1], first = 61U * block;
    const uint32_t here = count - first < 61 ? count - first : 61;
    MUST(w->bank.read(w->bank.context, client, (uint16_t)(CANOPY_REGISTER_BLOCK_0 + 125U * block),
                      (uint16_t)(2 + 2 * here), bytes) == 0);
    const uint32_t read = (uint32_t)bytes[0] << 24 | (uint32_t)bytes[1] << 16 | (uint32_t)bytes[2] << 8 | bytes[3];
    MUST(read == sequence || read == 0);
    met.held += read != 0;
    met.broken += read == 0;
    for (uint32_t i = 0; read != 0 && i < here; i++) {
        const uint8_t *at = bytes + 4 + 4 * i;
        const uint32_t bits = (uint32_t)at[0] << 24 | (uint32_t)at[1] << 16 | (uint32_t)at[2] << 8 | at[3];
        MUST((int32_t)bits == w->kept[read].coefficients[first + i]);
    }
}

static uint32_t read_sequence(struct world *w, uint8_t client) {
    uint8_t bytes[4];
    MUST(w->bank.read(w->bank.context, client, CANOPY_REGISTER_SEQUENCE, 2, bytes) == 0);
    return (uint32_t)bytes[0] << 24 | (uint32_t)bytes[1] << 16 | (uint32_t)bytes[2] << 8 | bytes[3];
}

// ---------------------------------------------------------------------------------------------------------------------
// Random lives

struct life {
    int32_t low[3], high[3];
    int32_t last[3];
    uint32_t relief;  // how rough: heights come from one of so many levels
    double stray, wild, again, quiet;
};

static int32_t between(struct world *w, int32_t low, int32_t high) {
    return low + (int32_t)below(w, (uint32_t)(high - low) + 1U);
}

static void make_box(struct world *w, struct life *life) {
    static const int32_t extents[] = {0, 7, 60, 300, 900};
    static const int32_t heights[] = {0, 1, 100, 70000, 40000000};
    for (int a = 0; a < 2; a++) {
        life->low[a] = between(w, -5000, 5000);
        life->high[a] = life->low[a] + extents[below(w, 5)];
    }
    life->low[2] = between(w, -20000000, 20000000);
    life->high[2] = life->low[2] + heights[below(w, 5)];
    if (is_in_float(w) && chance(w, 0.9)) {  // a scene for it, often at its limits
        const int32_t most = 1 << FLT_MANT_DIG;
        life->low[2] = life->low[2] < -most ? -most : life->low[2] > most ? most : life->low[2];
        life->high[2] = life->high[2] > most ? most : life->high[2] < life->low[2] ? life->low[2] : life->high[2];
        const int32_t shift = between(w, 0, 9) - 4;
        for (int a = 0; a < 2 && shift != 0; a++) {
            const int32_t to = shift > 2 ? most - life->high[a] : shift < -2 ? -most - life->low[a] : 0;
            life->low[a] += to;
            life->high[a] += to;
        }
    }
}

// Somewhere in the box, on knots and edges more often than not; or near where the last one was.
static void make_point(struct world *w, const struct life *life, int32_t point[3]) {
    if (chance(w, life->again)) {  // in the same cell, mostly lower
        memcpy(point, life->last, 3 * sizeof point[0]);
        const int32_t fall = between(w, 0, 50);
        point[2] += w->config.grid.side == CANOPY_ABOVE ? -fall : fall;
        met.lower++;
        return;
    }
    for (int a = 0; a < 2; a++) {
        const uint32_t pitch = w->frame.pitch[a], knots = below(w, w->frame.size[a]);
        const int64_t knot = (int64_t)w->frame.origin[a] + (int64_t)knots * pitch;
        point[a] = chance(w, 0.3) ? (int32_t)knot : between(w, life->low[a], life->high[a]);
    }
    const int64_t height = (int64_t)life->high[2] - life->low[2], level = below(w, life->relief);
    point[2] = life->low[2] + (int32_t)(height * level / (life->relief > 1 ? life->relief - 1 : 1));
}

static void feed(struct world *w, struct life *life) {
    int32_t point[3];
    make_point(w, life, point);
    uint32_t uncertainty = chance(w, 0.2) ? below(w, 30) : 0;
    if (point[2] < -WILD_MOST) {
        point[2] = -WILD_MOST;  // it fell from the bottom
    }
    if (chance(w, life->stray)) {
        point[below(w, 2)] += chance(w, 0.5) ? 2000000 : -2000000;
    }
    if (chance(w, life->wild)) {  // far beyond the box, on either side: most of it still fits, some does not
        const int64_t z =
            (int64_t)point[2] + (chance(w, 0.5) ? 1 : -1) * between(w, 1, chance(w, 0.5) ? 2000 : 1900000000);
        point[2] = z > WILD_MOST ? WILD_MOST : z < -WILD_MOST ? -WILD_MOST : (int32_t)z;
        uncertainty = 0;
    }
    memcpy(life->last, point, sizeof life->last);
    do_reading(w, point, uncertainty);
}

static void act(struct world *w, struct life *life, bool feeding) {
    const uint32_t dice = below(w, 1000);
    if (dice < 550 && feeding) {
        for (uint32_t i = 1 + below(w, 4); i > 0; i--) {
            feed(w, life);
        }
    } else if (dice < 985) {
        w->now_us += below(w, 2000);
        do_step(w, below(w, 6) * (w->tight ? 60 : 1));
    } else if (dice < 988) {
        w->now_us += below(w, 3000000);
        do_step(w, 0);
    } else if (dice < 996) {
        do_command(w, CANOPY_PLC_COMMAND_REFIT);
    } else if (dice < 997) {
        do_command(w, CANOPY_PLC_COMMAND_RESTART);
    } else if (dice < 998) {
        do_command(w, CANOPY_PLC_COMMAND_WITHDRAW);
    } else {
        if (chance(w, 0.5)) {
            make_box(w, life);
        }
        do_scene(w, life->low, life->high);
    }
}

// A client that reads in the middle of everything, in a hold of its own.
struct reader {
    uint32_t sequence;
    uint16_t block, blocks;
};

static void read_on(struct world *w, struct reader *reader, uint8_t client) {
    if (reader->sequence == 0 || reader->block >= reader->blocks) {
        reader->sequence = read_sequence(w, client);
        MUST(reader->sequence == w->sequence);
        reader->block = 0;
        reader->blocks = (uint16_t)(((uint32_t)w->config.grid.size[0] * w->config.grid.size[1] + 60) / 61);
        return;
    }
    read_block(w, client, reader->sequence, reader->block++);
}

// Left alone it comes to rest with everything covered, unless something is out of all range.
static void settle(struct world *w) {
    for (int i = 0; i < 4000; i++) {
        w->now_us += 5000;
        do_step(w, 50);
    }
    MUST(w->count == 0 || w->sequence == 0 || w->kept[w->sequence].envelope.points == w->count);
    MUST(w->intrusion == w->latched);
    MUST(!canopy_station_is_working(&w->station));
}

static void choose(struct world *w, struct canopy_station_config *config, struct life *life) {
    static const uint16_t cells[] = {1, 2, 3, 4};
    const uint16_t q = cells[below(w, 4)];
    *config = (struct canopy_station_config){
        .grid = {.size = {(uint16_t)between(w, 4, GRID_MAX), (uint16_t)between(w, 4, GRID_MAX)},
                 .cells = q,
                 .side = (uint8_t)below(w, 2)},
        .fit = chance(w, 0.5) ? &canopy_line_fit_fx : &canopy_line_fit_f32,
        .lines = chance(w, 0.5) ? 1 : q,
        .clients = CLIENTS,
        .unit = 0.5F,
        .stale_after_us = 1 + below(w, 2000000),
        .interval_us = chance(w, 0.5) ? 0 : below(w, 100000),
        .refresh_us = below(w, 100000)};
    *life = (struct life){.relief = 1 + below(w, 40),
                          .stray = chance(w, 0.5) ? 0.02 : 0,
                          .wild = chance(w, 0.6) ? 0.01 : 0,
                          .again = 0.2,
                          .quiet = chance(w, 0.5) ? 0.4 : 0};
}

static void live(struct world *w, uint64_t seed) {
    w->seed = seed;
    w->random = canopy_random_mix(seed);
    struct canopy_station_config config;
    struct life life;
    choose(w, &config, &life);
    start(w, &config);
    if (canopy_random_mix(seed + 1) % 12 == 0) {
        tighten(w);
    }
    make_box(w, &life);
    if (chance(w, 0.1)) {
        do_step(w, 3);  // nothing to do yet
        do_reading(w, life.low, 0);
    }
    do_scene(w, life.low, life.high);
    while (!w->scene) {
        make_box(w, &life);
        do_scene(w, life.low, life.high);
    }
    struct reader readers[CLIENTS] = {{0}};
    const uint32_t acts = 50 + below(w, 500);
    for (uint32_t i = 0; i < acts && w->count + 8 < READINGS_MAX; i++) {
        act(w, &life, i % 100 >= 100 * life.quiet);
        const uint8_t client = (uint8_t)below(w, 4 * CLIENTS);
        if (client < CLIENTS) {
            read_on(w, &readers[client], client);
        }
    }
    settle(w);
}

static uint64_t from_environment(const char *name, uint64_t otherwise) {
    const char *text = getenv(name);
    return text != NULL ? strtoull(text, NULL, 10) : otherwise;
}

static void test_random_lives(void **state) {
    (void)state;
    const uint64_t count = from_environment("CANOPY_STATIONS", 1500), alone = from_environment("CANOPY_SEED", 0);
    memset(&met, 0, sizeof met);
    for (uint64_t seed = 1; alone == 0 && seed <= count; seed++) {
        live(&world, seed);
    }
    if (alone != 0) {
        live(&world, alone);
        return;
    }
    printf("# %llu publications, %llu intrusions, raised while resting %llu, fitting %llu, certifying %llu, settling "
           "%llu, "
           "late %llu, out of range %llu, refreshes %llu, failed fits %llu, blocks held %llu, broken %llu\n",
           (unsigned long long)met.publications, (unsigned long long)met.intrusions,
           (unsigned long long)met.raised[CANOPY_STATION_RESTING],
           (unsigned long long)met.raised[CANOPY_STATION_FITTING],
           (unsigned long long)met.raised[CANOPY_STATION_CERTIFYING],
           (unsigned long long)met.raised[CANOPY_STATION_SETTLING], (unsigned long long)met.late,
           (unsigned long long)met.ranges, (unsigned long long)met.refreshes, (unsigned long long)met.fails,
           (unsigned long long)met.held, (unsigned long long)met.broken);
    for (int stage = CANOPY_STATION_RESTING; stage <= CANOPY_STATION_SETTLING; stage++) {
        assert_true(met.raised[stage] > 0);
    }
    assert_true(met.intrusions > 0 && met.lower > 0 && met.late > 0 && met.ranges > 0 && met.restarts > 0);
    assert_true(met.refreshes > 0 && met.withdrawals > 0 && met.held > 0 && met.broken > 0);
    assert_true(met.tightened > 0 && met.kept > 0 && met.given_up > 0);
    assert_true(met.refused > 0 && met.lifted > 0);
}

// ---------------------------------------------------------------------------------------------------------------------
// Every interleaving of a few readings with the steps of a whole fit

enum { FEW = 4, STEPS_MAX = 64 };

static const struct canopy_station_config SMALL = {.grid = {.size = {4, 4}, .cells = 1, .side = CANOPY_ABOVE},
                                                   .fit = &canopy_line_fit_fx,
                                                   .lines = 1,
                                                   .clients = CLIENTS,
                                                   .unit = 1,
                                                   .stale_after_us = 1000000,
                                                   .interval_us = 0,
                                                   .refresh_us = 0};

static void start_small(struct world *w, enum canopy_side side) {
    static const int32_t low[3] = {0, 0, 0}, high[3] = {30, 30, 1000};
    struct canopy_station_config config = SMALL;
    config.grid.side = (uint8_t)side;
    start(w, &config);
    do_scene(w, low, high);
    do_reading(w, (const int32_t[3]){15, 15, 500}, 0);
}

// Steps of one unit from the first reading to the publication.
static uint32_t count_steps(struct world *w, enum canopy_side side) {
    start_small(w, side);
    uint32_t steps = 0;
    for (; w->sequence == 0; steps++) {
        do_step(w, 1);
    }
    return steps;
}

static void run_schedule(struct world *w, enum canopy_side side, const int32_t readings[FEW][3],
                         const uint32_t when[FEW], uint32_t steps) {
    start_small(w, side);
    uint32_t next = 0;
    for (uint32_t step = 0; step <= steps + 1; step++) {
        while (next < FEW && when[next] == step) {
            do_reading(w, readings[next++], 0);
        }
        w->now_us += 10;
        do_step(w, 1);
    }
    for (uint32_t i = 0; i < 400 && !(w->sequence != 0 && w->kept[w->sequence].envelope.points == 1 + FEW); i++) {
        w->now_us += 10;
        do_step(w, 1);
    }
    MUST(w->sequence != 0 && w->kept[w->sequence].envelope.points == 1 + FEW && !w->intrusion);
}

// The next of all rising sequences up to `last`; false behind the last one.
static bool next_schedule(uint32_t when[FEW], uint32_t last) {
    int i = FEW - 1;
    while (i >= 0 && when[i] == last) {
        i--;
    }
    if (i < 0) {
        return false;
    }
    const uint32_t value = when[i] + 1;
    for (; i < FEW; i++) {
        when[i] = value;
    }
    return true;
}

static void test_every_interleaving(void **state) {
    (void)state;
    static const int32_t stories[][FEW][3] = {
        {{15, 15, 900},
         {15, 15, 700},
         {16, 14, 800}},  // a cell rises, then lower ones beyond the old surface elsewhere in it
        {{0, 0, 1000}, {30, 30, 1000}, {0, 30, 0}, {30, 0, 500}},        // corners
        {{15, 15, 400}, {15, 15, 500}, {15, 15, 501}, {15, 15, 502}},    // nothing new, nothing new, a hair
        {{10, 20, 1000}, {20, 10, -1000}, {10, 10, 1800}, {20, 20, 0}},  // on the knots, and outside the box's heights
    };
    struct world *w = &world;
    w->seed = 0;
    uint64_t count = 0;
    for (int side = CANOPY_ABOVE; side <= CANOPY_BELOW; side++) {
        const uint32_t steps = count_steps(w, (enum canopy_side)side);
        assert_in_range(steps, 10, STEPS_MAX);
        for (size_t story = 0; story < sizeof stories / sizeof stories[0]; story++) {
            uint32_t when[FEW] = {0};
            do {
                run_schedule(w, (enum canopy_side)side, stories[story], when, steps);
                count++;
            } while (next_schedule(when, steps + 1));
        }
    }
    printf("# %llu interleavings\n", (unsigned long long)count);
    assert_true(count > 10000);
}

// ---------------------------------------------------------------------------------------------------------------------
// Single promises, as plain as can be

static void publish_small(struct world *w, enum canopy_side side) {
    start_small(w, side);
    while (w->sequence == 0) {
        do_step(w, 1);
    }
}

static uint16_t status_of(struct world *w) {
    uint8_t bytes[2];
    MUST(w->bank.read(w->bank.context, 0, CANOPY_REGISTER_STATUS, 1, bytes) == 0);
    return (uint16_t)(bytes[0] << 8 | bytes[1]);
}

static void test_intrusion_in_the_same_call(void **state) {
    (void)state;
    struct world *w = &world;
    for (int side = CANOPY_ABOVE; side <= CANOPY_BELOW; side++) {
        const int32_t up = side == CANOPY_ABOVE ? 1 : -1;
        publish_small(w, (enum canopy_side)side);
        assert_int_equal(status_of(w), CANOPY_PLC_VALID);
        do_reading(w, (const int32_t[3]){15, 15, 500 + up * 400}, 0);
        assert_int_equal(status_of(w), CANOPY_PLC_INTRUSION);
        // A cell that has risen may be entered lower and still beyond what is published.
        do_reading(w, (const int32_t[3]){17, 17, 500 + up * 390}, 0);
        const uint32_t before = w->sequence;
        for (int i = 0; i < 200 && w->sequence == before; i++) {
            assert_int_equal(status_of(w), CANOPY_PLC_INTRUSION);
            do_step(w, 1);
        }
        assert_int_equal(w->sequence, before + 1);
        assert_int_equal(status_of(w), CANOPY_PLC_VALID);
    }
}

static void test_uncertainty_counts(void **state) {
    (void)state;
    struct world *w = &world;
    publish_small(w, CANOPY_ABOVE);
    do_reading(w, (const int32_t[3]){15, 15, 400}, 0);
    assert_int_equal(status_of(w), CANOPY_PLC_VALID);
    do_reading(w, (const int32_t[3]){15, 15, 400}, 500);
    assert_int_equal(status_of(w), CANOPY_PLC_INTRUSION);
    // The unsafe end beyond 32 bits is beyond every frame, not wrapped around.
    assert_int_equal(canopy_station_reading(&w->station, (const int32_t[3]){15, 15, 400}, UINT32_MAX, w->now_us),
                     CANOPY_RANGE);
}

// Where a frame reaches to the end of 32 bits, what the uncertainty adds may not end there.
static void test_uncertainty_beyond_32_bits(void **state) {
    (void)state;
    struct world *w = &world;
    for (int side = CANOPY_ABOVE; side <= CANOPY_BELOW; side++) {
        const bool above = side == CANOPY_ABOVE;
        const int32_t end = above ? INT32_MAX : INT32_MIN, inwards = above ? -1 : 1;
        const int32_t low[3] = {0, 0, above ? end - 1000 : end}, high[3] = {30, 30, above ? end : end + 1000};
        struct canopy_station_config config = SMALL;
        config.grid.side = (uint8_t)side;
        start(w, &config);
        do_scene(w, low, high);
        do_reading(w, (const int32_t[3]){15, 15, end + 5 * inwards}, 5);
        while (w->sequence == 0) {
            do_step(w, 1);
        }
        assert_int_equal(status_of(w), CANOPY_PLC_VALID);
        static const uint32_t more[] = {6, 1000, UINT32_MAX};
        for (size_t i = 0; i < sizeof more / sizeof more[0]; i++) {
            const int32_t inside[3] = {15, 15, end + 5 * inwards}, beside[3] = {-1, 15, end + 5 * inwards};
            assert_int_equal(canopy_station_reading(&w->station, beside, more[i], w->now_us), CANOPY_OUT_OF_FRAME);
            assert_int_equal(status_of(w), i == 0 ? CANOPY_PLC_VALID : CANOPY_PLC_INTRUSION);
            assert_int_equal(canopy_station_reading(&w->station, inside, more[i], w->now_us), CANOPY_RANGE);
            assert_int_equal(status_of(w), CANOPY_PLC_INTRUSION);
        }
    }
}

static void test_out_of_range_latches(void **state) {
    (void)state;
    struct world *w = &world;
    publish_small(w, CANOPY_ABOVE);
    do_reading(w, (const int32_t[3]){15, 15, 2000000000}, 0);
    assert_int_equal(status_of(w), CANOPY_PLC_INTRUSION);
    do_reading(w, (const int32_t[3]){15, 15, 600}, 0);
    const uint32_t before = w->sequence;
    for (int i = 0; i < 500; i++) {
        w->now_us += 100;
        do_step(w, 4);
        assert_int_equal(status_of(w), CANOPY_PLC_INTRUSION);
    }
    assert_true(w->sequence > before);
    do_command(w, CANOPY_PLC_COMMAND_RESTART);
    assert_int_equal(status_of(w), CANOPY_PLC_STALE);
    do_reading(w, (const int32_t[3]){15, 15, 600}, 0);
    for (int i = 0; i < 200 && w->sequence == 0; i++) {
        do_step(w, 1);
    }
    assert_int_equal(status_of(w), CANOPY_PLC_VALID);
}

static void test_refresh_counts_more_points(void **state) {
    (void)state;
    struct world *w = &world;
    publish_small(w, CANOPY_ABOVE);
    struct copy first = w->kept[w->sequence];
    for (int i = 0; i < 10; i++) {
        do_reading(w, (const int32_t[3]){14 + i % 3, 15, 500 - i}, 0);
    }
    w->now_us += 10;
    do_step(w, 1);
    assert_int_equal(w->sequence, 2);
    assert_int_equal(w->kept[2].envelope.points, 11);
    assert_memory_equal(w->kept[2].coefficients, first.coefficients, sizeof first.coefficients);
}

static void test_stale_and_fresh_again(void **state) {
    (void)state;
    struct world *w = &world;
    publish_small(w, CANOPY_ABOVE);
    w->now_us += SMALL.stale_after_us;
    do_step(w, 1);
    assert_int_equal(status_of(w), CANOPY_PLC_VALID);
    w->now_us++;
    do_step(w, 1);
    assert_int_equal(status_of(w), CANOPY_PLC_STALE);
    assert_int_equal(read_sequence(w, 1), w->sequence);  // still there
    do_reading(w, (const int32_t[3]){15, 15, 450}, 0);
    assert_int_equal(status_of(w), CANOPY_PLC_VALID);
}

// The sum of the distances of all readings to the surface that is published.
static double gap_of(const struct world *w) {
    double sum = 0;
    for (uint32_t i = 0; i < w->count; i++) {
        wide scale;
        const wide gap = distance(&w->kept[w->sequence], &w->readings[i], &scale);
        sum += (double)gap / (double)scale;
    }
    return sum;
}

static void rest_of_work(struct world *w) {
    for (int i = 0; i < 200000 && (i < 3 || canopy_station_is_working(&w->station)); i++) {
        w->now_us += 1000;
        do_step(w, 1);
    }
    MUST(!canopy_station_is_working(&w->station));
}

// Left alone it becomes tighter; what still holds is kept when the field rises under it; an intrusion is fitted anew.
static void test_spare_time_makes_it_tighter(void **state) {
    (void)state;
    struct world *w = &world;
    struct canopy_station_config config = {.grid = {{8, 7}, 4, CANOPY_BELOW},
                                           .fit = &canopy_line_fit_fx,
                                           .lines = 1,
                                           .clients = 1,
                                           .unit = 1.0F,
                                           .stale_after_us = 1000000000,
                                           .refresh_us = 100};
    w->random = 5;
    start(w, &config);
    tighten(w);
    do_scene(w, (const int32_t[3]){0, 0, -2000}, (const int32_t[3]){700, 600, 2000});
    for (int i = 0; i < 900; i++) {
        const int32_t x = (int32_t)below(w, 701), y = (int32_t)below(w, 601);
        const int32_t hill = 1500 - (((x - 300) * (x - 300) + (y - 300) * (y - 300)) / 80);
        do_reading(w, (const int32_t[3]){x, y, (hill > -1000 ? hill : -1000) + (int32_t)below(w, 200)}, 0);
    }
    while (w->sequence == 0) {
        do_step(w, 1);
    }
    MUST(!w->station.tightened);
    const double fast = gap_of(w);
    rest_of_work(w);
    const struct copy tight = w->kept[w->sequence];
    MUST(w->station.tightened && w->sequence == 2 && gap_of(w) < 0.6 * fast);
    MUST((double)canopy_tighten_excess(&w->tightening.tighten) < 0.05);

    // a reading that raises its cell, under the surface
    int32_t between_them[3];
    memcpy(between_them, w->readings[0].point, sizeof between_them);
    for (uint32_t sequence = w->sequence; w->sequence == sequence; between_them[2]--) {
        MUST(status_of(w) == CANOPY_PLC_VALID);
        do_reading(w, between_them, 0);
        for (int i = 0; i < 200 && w->sequence == sequence && w->station.risen; i++) {
            w->now_us += 1000;
            do_step(w, 1000);
        }
        w->now_us += 1000;
        do_step(w, 1000);
    }
    MUST(w->station.tightened && status_of(w) == CANOPY_PLC_VALID);
    assert_memory_equal(w->kept[w->sequence].coefficients, tight.coefficients, 4 * 8 * 7);
    rest_of_work(w);
    MUST(gap_of(w) < 0.6 * fast);

    // one beyond it
    do_reading(w, (const int32_t[3]){300, 300, -1900}, 0);
    MUST((status_of(w) & CANOPY_PLC_INTRUSION) != 0);
    const uint32_t before = w->sequence;
    while (w->sequence == before) {
        do_step(w, 1);
    }
    MUST(!w->station.tightened && status_of(w) == CANOPY_PLC_VALID);
    rest_of_work(w);
    MUST(w->station.tightened);
}

// A frame that is refused leaves the scene as it was, also when something is published or being fitted.
static void test_refused_frames_change_nothing(void **state) {
    (void)state;
    struct world *w = &world;
    static const int32_t low[3] = {0, 0, 0}, high[3] = {60, 60, 1000};
    struct canopy_station_config config = SMALL;
    config.grid.cells = 4;
    start(w, &config);
    do_scene(w, low, high);
    for (int i = 0; i < 3; i++) {
        do_reading(w, (const int32_t[3]){5 + 20 * i, 15, 500}, 0);
    }
    do_step(w, 3);
    for (int published = 0; published < 2; published++) {
        const int64_t sum = sum_of_cells(w);
        const uint8_t stage = w->station.stage;
        for (int bad = 0; bad < 10; bad++) {
            struct canopy_frame frame = w->frame;
            switch (bad) {
            case 0: frame.pitch[0]++; break;
            case 1: frame.pitch[1] += 2; break;
            case 2: frame.pitch[0] = 0; break;
            case 3: frame.size[0]++; break;
            case 4: frame.size[1]++; break;
            case 5: frame.cells = 2; break;
            case 6: frame.side = CANOPY_BELOW; break;
            case 7: frame.quantum_log2 = 1; break;
            case 8: frame.axis[0][1] = 1 << 20; break;
            default: frame.axis[2][2] = -frame.axis[2][2]; break;
            }
            assert_int_equal(canopy_station_begin(&w->station, &frame), bad < 8 ? CANOPY_ARGUMENT : CANOPY_UNSUPPORTED);
            assert_int_equal(w->station.stage, stage);
            assert_memory_equal(&w->station.field.frame, &w->frame, sizeof frame);
            assert_true(sum_of_cells(w) == sum);
            check(w);
        }
        for (int i = 0; i < 200; i++) {
            do_step(w, 1);
        }
        assert_int_equal(w->sequence, 1);
    }
}

static void test_arguments(void **state) {
    (void)state;
    struct canopy_station_config config = SMALL;
    const size_t bytes = CANOPY_STATION_ARENA(4, 4, 1, 1, CLIENTS);
    uint64_t *arena = malloc(bytes + 8);
    struct canopy_station *station = &world.station;
    assert_non_null(arena);
    assert_int_equal(canopy_station_init(station, &config, arena, bytes - 8, 0), CANOPY_ARENA_SHORT);
    assert_int_equal(canopy_station_init(station, &config, (char *)arena + 4, bytes, 0), CANOPY_ARENA_ALIGN);
    static const struct canopy_grid bad[] = {
        {{3, 4}, 1, 0}, {{4, 3}, 1, 0}, {{4, 1025}, 1, 0}, {{4, 4}, 0, 0}, {{4, 4}, 33, 0}};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        config.grid = bad[i];
        assert_int_equal(canopy_station_init(station, &config, arena, bytes, 0), CANOPY_ARGUMENT);
    }
    config = SMALL;
    config.fit = NULL;
    assert_int_equal(canopy_station_init(station, &config, arena, bytes, 0), CANOPY_ARGUMENT);
    config = SMALL;
    config.lines = 2;  // does not divide one cell
    assert_int_equal(canopy_station_init(station, &config, arena, bytes, 0), CANOPY_ARGUMENT);
    config.lines = 0;
    assert_int_equal(canopy_station_init(station, &config, arena, bytes, 0), CANOPY_ARGUMENT);
    free(arena);
}

// What stands there between a fit and the next, or when a certificate begins, may be anything: two stations get the
// same readings, one of them finds its shared memory overwritten whenever it has come to either, and both publish the
// same.
static void test_work_memory_keeps_nothing(void **state) {
    (void)state;
    enum { M = 9, N = 6, Q = 3, STEPS = 6000 };
    static CANOPY_ARENA_DECLARE(arenas[2], CANOPY_STATION_ARENA(M, N, Q, Q, 1));
    static struct canopy_station stations[2];
    const struct canopy_station_config config = {.grid = {{M, N}, Q, CANOPY_ABOVE},
                                                 .fit = &canopy_line_fit_fx,
                                                 .lines = Q,
                                                 .clients = 1,
                                                 .unit = 1.0F,
                                                 .stale_after_us = UINT32_MAX};
    uint64_t random = 11;
    uint8_t before = CANOPY_STATION_RESTING;
    for (int k = 0; k < 2; k++) {
        assert_int_equal(canopy_station_init(&stations[k], &config, arenas[k], sizeof arenas[k], 0), CANOPY_OK);
        assert_int_equal(
            canopy_station_begin_box(&stations[k], (const int32_t[3]){0, 0, 0}, (const int32_t[3]){900, 600, 1000}),
            CANOPY_OK);
    }
    uint32_t overwritten = 0;
    for (uint64_t t = 0; t < STEPS; t++) {
        const int32_t point[3] = {(int32_t)canopy_random_below(&random, 900),
                                  (int32_t)canopy_random_below(&random, 600),
                                  (int32_t)canopy_random_below(&random, 1000)};
        struct canopy_station *s = &stations[1];
        if (s->stage == CANOPY_STATION_RESTING) {
            memset(s->work_arena, 0xA5, s->work_bytes);
            overwritten++;
        } else if (s->stage == CANOPY_STATION_CERTIFYING && before == CANOPY_STATION_FITTING) {
            memset(s->work_arena, 0xA5, CANOPY_CERTIFY_WORK(N, Q));  // the marks behind it have been cleared
            overwritten++;
        }
        before = s->stage;
        for (int k = 0; k < 2; k++) {
            if (t % 8 == 0) {
                (void)canopy_station_reading(&stations[k], point, 0, t);
            }
            canopy_station_step(&stations[k], 1, t);
        }
        assert_int_equal(stations[0].stage, stations[1].stage);
        const struct canopy_envelope *a = canopy_plc_published(&stations[0].plc);
        const struct canopy_envelope *b = canopy_plc_published(&stations[1].plc);
        assert_true((a == NULL) == (b == NULL));
        if (a != NULL) {
            assert_memory_equal(a->coefficients, b->coefficients, sizeof(int32_t) * M * N);
            assert_int_equal(a->points, b->points);
            assert_int_equal(a->margin, b->margin);
        }
    }
    assert_true(overwritten > 10 && stations[0].plc.publications > 10);
}

static int set_up(void **state) {
    (void)state;
    world.kept = calloc(KEPT_MAX, sizeof *world.kept);
    return world.kept == NULL;
}

static int tear_down(void **state) {
    (void)state;
    free(world.kept);
    free(world.arena);
    return 0;
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_arguments),
        cmocka_unit_test(test_intrusion_in_the_same_call),
        cmocka_unit_test(test_uncertainty_counts),
        cmocka_unit_test(test_uncertainty_beyond_32_bits),
        cmocka_unit_test(test_out_of_range_latches),
        cmocka_unit_test(test_refused_frames_change_nothing),
        cmocka_unit_test(test_refresh_counts_more_points),
        cmocka_unit_test(test_work_memory_keeps_nothing),
        cmocka_unit_test(test_stale_and_fresh_again),
        cmocka_unit_test(test_spare_time_makes_it_tighter),
        cmocka_unit_test(test_every_interleaving),
        cmocka_unit_test(test_random_lives),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
