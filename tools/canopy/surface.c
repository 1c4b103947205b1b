// The library fits in frames whose axes are x, y and z. Points are therefore turned into the frame's axes first,
// rounded to the scalar, and fitted there; the frame that is published is the turned one, and what the turning's
// rounding moved is made good at the end, where exact.c measures the true margin of every true point and the surface is
// shifted by it.

#include "tools/canopy/surface.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "lib/cover/certify.h"
#include "lib/cover/fast.h"
#include "lib/cover/field.h"

#define FROM_POINTS_CELLS 4           // the frame's Q when fitting from points
#define FIELD_BYTES_MOST (64U << 20)  // of a field that a fit from points chooses itself

struct job {
    const struct canopy_device_list *points;
    const struct canopy_surface_wish *wish;
    struct canopy_fault *fault;
    int32_t axes[3][3];
    bool along;  ///< every axis is plus or minus a coordinate axis: turning is exact
    const union canopy_device_point *turned;
    union canopy_device_point *turned_memory;
    union canopy_device_point low, high;  ///< box of the turned points
    struct canopy_frame frame;            ///< in turned coordinates, axes x, y, z
    int32_t *coefficients;                ///< in the library's orientation until they are stored
    uint32_t iterations;
    uint32_t unsettled;
    double field_ms;
};

static double now_ms(void) {
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);  // whatever else the machine does
    return 1e3 * (double)t.tv_sec + 1e-6 * (double)t.tv_nsec;
}

static bool no_memory(struct canopy_fault *fault) {
    return canopy_fault_set(fault, "out of memory: choose a smaller --grid or --field, or fewer points");
}

// ---------------------------------------------------------------------------------------------------------------------
// Axes and turning

static bool normalise(double v[3]) {
    const double most = fmax(fabs(v[0]), fmax(fabs(v[1]), fabs(v[2])));
    if (!(most > 0.0 && isfinite(most))) {
        return false;
    }
    for (int k = 0; k < 3; k++) {
        v[k] /= most;  // so that squares neither overflow nor vanish
    }
    const double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (int k = 0; k < 3; k++) {
        v[k] /= length;
    }
    return true;
}

bool canopy_surface_axes(const double direction[3], int32_t axes[3][3]) {
    double a[3][3] = {{0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}, {direction[0], direction[1], direction[2]}};
    if (!normalise(a[2])) {
        return false;
    }
    const int start = fabs(a[2][0]) > 0.9 ? 1 : 0;
    for (int k = 0; k < 3; k++) {
        a[0][k] = (k == start ? 1.0 : 0.0) - a[2][start] * a[2][k];
    }
    normalise(a[0]);
    for (int k = 0; k < 3; k++) {
        const int p = (k + 1) % 3;
        const int q = (k + 2) % 3;
        a[1][k] = a[2][p] * a[0][q] - a[2][q] * a[0][p];
    }
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            axes[i][k] = (int32_t)lrint(a[i][k] * CANOPY_AXIS_ONE);
        }
    }
    return true;
}

static bool are_along(int32_t axes[3][3]) {
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            if (axes[i][k] != 0 && abs(axes[i][k]) != CANOPY_AXIS_ONE) {
                return false;
            }
        }
    }
    return true;
}

static bool are_identity(int32_t axes[3][3]) {
    return axes[0][0] == CANOPY_AXIS_ONE && axes[1][1] == CANOPY_AXIS_ONE && axes[2][2] == CANOPY_AXIS_ONE;
}

static bool turn_point(const struct job *job, const union canopy_device_point *p, union canopy_device_point *to) {
    const bool f32 = job->points->scalar == CANOPY_F32;
    for (int i = 0; i < 3; i++) {
        double sum = 0.0;
        for (int k = 0; k < 3; k++) {
            sum += (double)job->axes[i][k] / CANOPY_AXIS_ONE * (f32 ? (double)p->f32[k] : (double)p->fx[k]);
        }
        if (f32) {
            to->f32[i] = (float)sum;
        } else if (fabs(rint(sum)) < 0x1p31) {
            to->fx[i] = (int32_t)rint(sum);
        } else {
            return canopy_fault_set(job->fault,
                                    "coordinates turned to --dir overflow 32-bit fixed point: choose a larger --unit");
        }
    }
    return true;
}

static bool turn(struct job *job) {
    if (are_identity(job->axes)) {
        job->turned = job->points->points;
        return true;
    }
    job->turned_memory = malloc(job->points->count * sizeof *job->turned_memory);
    if (!job->turned_memory) {
        return no_memory(job->fault);
    }
    for (size_t i = 0; i < job->points->count; i++) {
        if (!turn_point(job, &job->points->points[i], &job->turned_memory[i])) {
            return false;
        }
    }
    job->turned = job->turned_memory;
    return true;
}

// Four points a turn, coordinate lane % 3 in each lane: what compilers make vectors of.
#define LANES 12

static void box_f32(const float *values, size_t count, float low[3], float high[3]) {
    float least[LANES];
    float most[LANES];
    for (size_t lane = 0; lane < LANES; lane++) {
        least[lane] = most[lane] = values[lane % 3];
    }
    size_t i = 0;
    for (; i + LANES <= 3 * count; i += LANES) {
        for (size_t lane = 0; lane < LANES; lane++) {
            const float x = values[i + lane];
            least[lane] = x < least[lane] ? x : least[lane];
            most[lane] = x > most[lane] ? x : most[lane];
        }
    }
    for (; i < 3 * count; i++) {
        const float x = values[i];
        least[i % 3] = x < least[i % 3] ? x : least[i % 3];
        most[i % 3] = x > most[i % 3] ? x : most[i % 3];
    }
    for (size_t lane = 0; lane < LANES; lane++) {
        low[lane % 3] = least[lane] < low[lane % 3] ? least[lane] : low[lane % 3];
        high[lane % 3] = most[lane] > high[lane % 3] ? most[lane] : high[lane % 3];
    }
}

static void box_fx(const int32_t *values, size_t count, int32_t low[3], int32_t high[3]) {
    int32_t least[LANES];
    int32_t most[LANES];
    for (size_t lane = 0; lane < LANES; lane++) {
        least[lane] = most[lane] = values[lane % 3];
    }
    size_t i = 0;
    for (; i + LANES <= 3 * count; i += LANES) {
        for (size_t lane = 0; lane < LANES; lane++) {
            const int32_t x = values[i + lane];
            least[lane] = x < least[lane] ? x : least[lane];
            most[lane] = x > most[lane] ? x : most[lane];
        }
    }
    for (; i < 3 * count; i++) {
        const int32_t x = values[i];
        least[i % 3] = x < least[i % 3] ? x : least[i % 3];
        most[i % 3] = x > most[i % 3] ? x : most[i % 3];
    }
    for (size_t lane = 0; lane < LANES; lane++) {
        low[lane % 3] = least[lane] < low[lane % 3] ? least[lane] : low[lane % 3];
        high[lane % 3] = most[lane] > high[lane % 3] ? most[lane] : high[lane % 3];
    }
}

static void find_box(struct job *job) {
    union canopy_device_point low = job->turned[0];
    union canopy_device_point high = job->turned[0];
    if (job->points->scalar == CANOPY_F32) {
        box_f32(job->turned[0].f32, job->points->count, low.f32, high.f32);
    } else {
        box_fx(job->turned[0].fx, job->points->count, low.fx, high.fx);
    }
    job->low = low;
    job->high = high;
}

// ---------------------------------------------------------------------------------------------------------------------
// The frame

static enum canopy_status frame_around(struct job *job, const union canopy_device_point *low,
                                       const union canopy_device_point *high) {
    const struct canopy_surface_wish *wish = job->wish;
    const struct canopy_grid grid = {.size = {wish->size[0], wish->size[1]},
                                     .cells = wish->field ? wish->field : FROM_POINTS_CELLS,
                                     .side = (uint8_t)wish->side};
    return job->points->scalar == CANOPY_F32 ? canopy_frame_around_f32(&job->frame, &grid, low->f32, high->f32)
                                             : canopy_frame_around_fx(&job->frame, &grid, low->fx, high->fx);
}

/// The box grown sideways by `quanta` on each side.
static bool grow(const struct job *job, int quanta, union canopy_device_point *low, union canopy_device_point *high) {
    *low = job->low;
    *high = job->high;
    for (int a = 0; a < 2; a++) {
        if (job->points->scalar == CANOPY_F32) {
            const float by = ldexpf((float)quanta, job->frame.quantum_log2);
            low->f32[a] -= by;
            high->f32[a] += by;
            if (!isfinite(low->f32[a]) || !isfinite(high->f32[a])) {
                return false;
            }
        } else {
            if (low->fx[a] < INT32_MIN + quanta || high->fx[a] > INT32_MAX - quanta) {
                return false;
            }
            low->fx[a] -= quanta;
            high->fx[a] += quanta;
        }
    }
    return true;
}

static bool own_frame(struct job *job, int quanta) {
    enum canopy_status status = frame_around(job, &job->low, &job->high);
    if (status == CANOPY_OK && quanta > 0) {
        union canopy_device_point low;
        union canopy_device_point high;
        status = grow(job, quanta, &low, &high) ? frame_around(job, &low, &high) : CANOPY_RANGE;
    }
    return status == CANOPY_OK ||
           canopy_fault_set(
               job->fault,
               "no frame of this --grid and --field holds the points: grids are 4x4 to %dx%d, fields 1 to %d, "
               "coordinates below 2^31 units",
               CANOPY_SIZE_MAX, CANOPY_SIZE_MAX, CANOPY_CELLS_MAX);
}

/// The published frame from the job's own: the origin turned back and put on the quantum.
static void store_own_frame(const struct job *job, struct canopy_surrogate *s) {
    const double quantum = ldexp(1.0, job->frame.quantum_log2);
    for (int k = 0; k < 3; k++) {
        double quanta = 0.0;
        for (int i = 0; i < 3; i++) {
            quanta += (double)job->axes[i][k] / CANOPY_AXIS_ONE * (double)job->frame.origin[i];
        }
        s->origin[k] = rint(quanta) * quantum;
    }
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            s->axes[i][k] = (double)job->axes[i][k] / CANOPY_AXIS_ONE;
        }
    }
    s->pitch[0] = (double)job->frame.pitch[0] * quantum;
    s->pitch[1] = (double)job->frame.pitch[1] * quantum;
}

/// The largest power of two that divides a double (a large one for zero).
static int divisor_log2(double x) {
    int exponent = 0;
    double mantissa = frexp(fabs(x), &exponent);
    if (x == 0.0) {
        return 1024;
    }
    while (mantissa != floor(mantissa)) {
        mantissa *= 2.0;
        exponent--;
    }
    while (fmod(mantissa, 2.0) == 0.0) {
        mantissa /= 2.0;
        exponent++;
    }
    return exponent;
}

static int smaller(int a, int b) { return a < b ? a : b; }

/// The job's frame from the one of a file: its pitch exactly, its origin to a quantum.
static bool foreign_frame(struct job *job) {
    const struct canopy_surrogate *f = job->wish->frame;
    const uint16_t cells = job->wish->field ? job->wish->field : FROM_POINTS_CELLS;
    const bool f32 = job->points->scalar == CANOPY_F32;
    double origin[3] = {0.0, 0.0, 0.0};
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            origin[i] += f->axes[i][k] * f->origin[k];
        }
    }
    // Turned axes turn the origin into something without a divisor; then a quantum of the pitch is near enough.
    int log2 = smaller(divisor_log2(f->pitch[0] / cells), divisor_log2(f->pitch[1] / cells));
    log2 = job->along ? smaller(log2, smaller(divisor_log2(origin[0]), divisor_log2(origin[1]))) : log2;
    const double reach[2] = {fabs(origin[0]) + ((double)f->size[0] - 1.0) * f->pitch[0],
                             fabs(origin[1]) + ((double)f->size[1] - 1.0) * f->pitch[1]};
    log2 = f32 ? log2 : 0;
    while (f32 && log2 < 1024 && fmax(ldexp(reach[0], -log2), ldexp(reach[1], -log2)) >= 0x1p30) {
        log2++;
    }
    for (int a = 0; a < 2; a++) {
        const double pitch = ldexp(f->pitch[a], -log2);
        if (!(pitch >= 1.0 && pitch == floor(pitch) && ldexp(reach[a], -log2) < 0x1p31)) {
            return canopy_fault_set(job->fault,
                                    "the pitch of --frame is not on a quantum of 32-bit integers: give a file "
                                    "that canopy fit wrote");
        }
        job->frame.pitch[a] = (uint32_t)pitch;
        job->frame.origin[a] = (int32_t)rint(ldexp(origin[a], -log2));
    }
    const double base = ldexp(origin[2], -log2);
    job->frame.origin[2] = fabs(base) < 0x1p30 ? (int32_t)floor(base) : 0;
    const double zero = ldexp((double)job->frame.origin[2], log2);
    const double low = f32 ? (double)job->low.f32[2] : (double)job->low.fx[2];
    const double high = f32 ? (double)job->high.f32[2] : (double)job->high.fx[2];
    int highest = -100;  // as lib/cover/frame_f32.c has it
    frexp(fmax(fabs(high - zero), fabs(low - zero)), &highest);
    job->frame.lsb_log2 = (int16_t)((highest > -100 ? highest : -100) - CANOPY_RANGE_LOG2 - log2);
    job->frame.quantum_log2 = (int16_t)log2;
    job->frame.size[0] = job->wish->size[0];
    job->frame.size[1] = job->wish->size[1];
    job->frame.cells = cells;
    job->frame.side = (uint8_t)job->wish->side;
    for (int i = 0; i < 3; i++) {
        job->frame.axis[i][i] = CANOPY_AXIS_ONE;
    }
    return true;
}

static void store_foreign_frame(const struct job *job, struct canopy_surrogate *s) {
    memcpy(s->origin, job->wish->frame->origin, sizeof s->origin);
    memcpy(s->axes, job->wish->frame->axes, sizeof s->axes);
    memcpy(s->pitch, job->wish->frame->pitch, sizeof s->pitch);
}

// ---------------------------------------------------------------------------------------------------------------------
// The fit

/// How finely a fit looks: field cells a knot interval and lines a knot interval of u.
struct resolution {
    uint16_t cells[2];
    uint16_t lines;
};

/// From the points: the paper's construction, one line a knot interval of u that takes every point of the two intervals
/// beside it, with v told apart to 1/32 of an interval, or to what the pitch and memory leave.
static struct resolution choose(const struct job *job) {
    const struct canopy_frame *f = &job->frame;
    if (job->wish->field) {
        return (struct resolution){.cells = {job->wish->field, job->wish->field},
                                   .lines = job->wish->lines ? job->wish->lines : 1};
    }
    uint16_t cells = CANOPY_CELLS_MAX;
    while (cells > 1 &&
           (cells > f->pitch[1] || CANOPY_FIELD_ARENA(f->size[0], f->size[1], 1, cells) > FIELD_BYTES_MOST)) {
        cells /= 2;
    }
    return (struct resolution){.cells = {1, cells}, .lines = 1};
}

static size_t feed(const struct job *job, struct canopy_field *field) {
    // The union's two members share their representation with the arrays that the library takes.
    return job->points->scalar == CANOPY_F32
               ? canopy_field_feed_f32(field, (const float(*)[3]) & job->turned[0].f32, job->points->count)
               : canopy_field_feed_fx(field, (const int32_t(*)[3]) & job->turned[0].fx, job->points->count);
}

/// As the device does it: the field's own certificate, coefficients raised where it finds something missing.
static bool certify_field(struct job *job, const struct canopy_field *field) {
    const double start = now_ms();
    const size_t bytes = CANOPY_CERTIFY_ARENA(job->frame.size[1], field->axis[0].cells, field->axis[1].cells);
    void *arena = malloc(bytes);
    struct canopy_certify certify;
    enum canopy_status status = arena ? canopy_certify_init(&certify, field, arena, bytes) : CANOPY_ARENA_SHORT;
    if (status == CANOPY_OK) {
        canopy_certify_begin(&certify, job->coefficients);
        while ((status = canopy_certify_step(&certify, UINT32_MAX)) == CANOPY_NOT_SAFE) {
            status = canopy_fast_raise(field, job->coefficients, certify.failed_cell, certify.missing);
            if (status != CANOPY_OK) {
                break;
            }
        }
    }
    free(arena);
    job->field_ms = now_ms() - start;
    return status == CANOPY_OK ||
           canopy_fault_set(job->fault, "the field's certificate failed: choose another --grid or --field");
}

static bool fit(struct job *job) {
    const uint16_t m = job->frame.size[0];
    const uint16_t n = job->frame.size[1];
    const struct resolution r = choose(job);
    const size_t field_bytes = CANOPY_FIELD_ARENA(m, n, r.cells[0], r.cells[1]);
    const size_t fast_bytes = CANOPY_FAST_ARENA(m, n, r.cells[1], r.lines);
    void *field_arena = malloc(field_bytes);
    void *fast_arena = malloc(fast_bytes);
    struct canopy_field field;
    struct canopy_fast fast;
    bool ok = field_arena && fast_arena;
    if (!ok) {
        no_memory(job->fault);
    } else if (canopy_field_init(&field, &job->frame, r.cells, field_arena, field_bytes) != CANOPY_OK ||
               canopy_fast_init(&fast, &field, job->wish->scalar, r.lines, fast_arena, fast_bytes) != CANOPY_OK) {
        ok = canopy_fault_set(job->fault,
                              "the frame has no room for this many cells: choose a smaller --unit or --field");
    } else {
        feed(job, &field);
        ok = canopy_fast_begin(&fast, job->coefficients) == CANOPY_OK ||
             canopy_fault_set(job->fault, "no point reaches the field: choose another --frame");
    }
    if (ok) {
        while (canopy_fast_step(&fast, UINT32_MAX) == CANOPY_MORE) {}
        job->iterations = fast.solves;
        job->unsettled = fast.unsettled;
        ok = !job->wish->field || !field.exact || certify_field(job, &field);
        canopy_fast_orient(&job->frame, job->coefficients);
    }
    free(field_arena);
    free(fast_arena);
    return ok;
}

// ---------------------------------------------------------------------------------------------------------------------
// From coefficients to a certified surrogate

static bool store(const struct job *job, struct canopy_surrogate *s) {
    const size_t count = (size_t)job->frame.size[0] * job->frame.size[1];
    s->side = job->wish->side;
    s->scalar = job->wish->scalar;
    s->unit = job->wish->unit;
    s->size[0] = job->frame.size[0];
    s->size[1] = job->frame.size[1];
    s->lsb = ldexp(1.0, job->frame.lsb_log2 + job->frame.quantum_log2);
    if (job->wish->frame) {
        store_foreign_frame(job, s);
    } else {
        store_own_frame(job, s);
    }
    s->coefficients = malloc(count * sizeof *s->coefficients);
    s->trim = calloc((size_t)(s->size[0] - 1) * (s->size[1] - 1), 1);
    if (!s->coefficients || !s->trim) {
        return no_memory(job->fault);
    }
    for (size_t i = 0; i < count; i++) {
        s->coefficients[i] = (double)job->coefficients[i];
    }
    return true;
}

static bool certify(const struct job *job, struct canopy_surrogate *s, struct canopy_surface_report *report) {
    const struct canopy_cloud cloud = canopy_device_list_cloud(job->points);
    const double start = now_ms();
    const bool ok = canopy_exact_check(s, &cloud, &report->result);
    report->certificate_ms = now_ms() - start;
    return ok || no_memory(job->fault);
}

/// Shifts all coefficients by whole steps so that the smallest margin is as small as can be without being negative: the
/// B-splines sum to one, so the surface moves by exactly that. A fit from a field is lifted but never lowered: its
/// cells are promises about points to come.
static bool shift(const struct job *job, struct canopy_surrogate *s, const struct canopy_exact_result *result) {
    double steps = -floor(result->margin / s->lsb);
    if (job->wish->field && steps < 0.0) {
        steps = 0.0;
    }
    if (s->side == CANOPY_BELOW) {
        steps = -steps;
    }
    for (size_t i = 0; i < (size_t)s->size[0] * s->size[1]; i++) {
        s->coefficients[i] += steps;
    }
    return steps != 0.0;
}

/// One attempt with the frame grown by `quanta`. `*outside`: points were outside the frame, try a larger one.
static bool attempt(struct job *job, int quanta, struct canopy_surrogate *s, struct canopy_surface_report *report,
                    bool *outside) {
    const double start = now_ms();
    *outside = false;
    find_box(job);
    if (job->wish->frame ? !foreign_frame(job) : !own_frame(job, quanta)) {
        return false;
    }
    if (!fit(job) || !store(job, s)) {
        return false;
    }
    report->fit_ms = now_ms() - start;
    report->iterations = job->iterations;
    report->unsettled = job->unsettled;
    report->field_ms = job->field_ms;
    if (!certify(job, s, report)) {
        return false;
    }
    *outside = report->result.outside > 0;
    if (!*outside && shift(job, s, &report->result)) {
        return certify(job, s, report);
    }
    return true;
}

static bool finish(const struct job *job, struct canopy_surrogate *s, const struct canopy_surface_report *report) {
    if (!canopy_exact_is_safe(&report->result) || !(report->result.margin >= 0.0)) {
        return canopy_fault_set(job->fault,
                                "no safe surface came out; nothing was written: please report this with the points");
    }
    struct canopy_exact *exact = canopy_exact_open(s);
    if (!exact) {
        return no_memory(job->fault);
    }
    const struct canopy_cloud cloud = canopy_device_list_cloud(job->points);
    canopy_exact_coverage(exact, &cloud, s->trim);
    canopy_exact_close(exact);
    s->certified = true;
    s->margin = report->result.margin;
    s->points = (double)report->result.points;
    return true;
}

bool canopy_surface_fit(const struct canopy_device_list *points, const struct canopy_surface_wish *wish,
                        struct canopy_surrogate *surrogate, struct canopy_surface_report *report,
                        struct canopy_fault *fault) {
    struct job job = {.points = points, .wish = wish, .fault = fault};
    bool ok = canopy_surface_axes(wish->direction, job.axes) ||
              canopy_fault_set(fault, "--dir without length: give the direction from the scene to the viewer");
    for (int i = 0; wish->frame && i < 9; i++) {
        job.axes[i / 3][i % 3] = (int32_t)lrint(wish->frame->axes[i / 3][i % 3] * CANOPY_AXIS_ONE);
    }
    job.along = are_along(job.axes);
    job.coefficients = malloc((size_t)wish->size[0] * wish->size[1] * sizeof *job.coefficients);
    ok = ok && (job.coefficients || no_memory(fault)) && turn(&job);
    bool outside = ok;
    memset(surrogate, 0, sizeof *surrogate);
    // Turned points are rounded, so the frame needs a quantum or two more than their box.
    for (int quanta = job.along ? 0 : 2; ok && outside && quanta <= 1 << 20; quanta = quanta ? quanta * 4 : 1) {
        canopy_surrogate_free(surrogate);
        ok = attempt(&job, quanta, surrogate, report, &outside);
    }
    ok = ok && finish(&job, surrogate, report);
    free(job.coefficients);
    free(job.turned_memory);
    if (!ok) {
        canopy_surrogate_free(surrogate);
    }
    return ok;
}
