// canopy regrid: the same surface on another grid, on the safe side.

#include <argp.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lib/cover/certify.h"
#include "lib/cover/fast.h"
#include "lib/cover/query_regrid.h"
#include "lib/cover/tighten.h"
#include "tools/canopy/command.h"
#include "tools/canopy/queried.h"
#include "tools/canopy/wish.h"
#include "tools/common/option.h"

static const char DOC[] =
    "Writes a surrogate with another grid that is on the safe side of the given one wherever that is covered: above a "
    "surface above, below one below. What the old one was safe for, the new one is, with the same certificate.\v"
    "A grid of half or quarter pitch (2M-1 or 4M-3 coefficients where there were M, of the same box) is the same "
    "spline with more knots: it differs by less than two steps of the file, but for the outermost knot intervals, "
    "where the rule for the coefficients outside the grid makes it differ by up to 1/48 of what neighbouring "
    "coefficients differ. Every other grid is fitted: above the highest that the old surface can be over each cell of "
    "a field (see `canopy window`), and proved so. Coarser grids lose tightness as any fit does.\n\n"
    "Prints one line: the grids, how the new one was made and how far it stands from the old one in the mean, in "
    "input units.\n\n"
    "Exit status: 0; 2 for bad input, with one line that says what to do, and no output file; 64 for wrong usage.";

enum { BOX = 256, METHOD };

static const struct argp_option OPTIONS[] = {
    {"grid", 'g', "MxN", 0, "coefficients along U and V, 4x4 to 1024x1024 (required)", 0},
    {"box", BOX, "U0,U1,V0,V1", 0, "cover this part of the frame only, in input units along the surrogate's axes", 0},
    {"method", METHOD, "fast|tight", 0, "how to fit where the grid is not a finer one: see `canopy fit --help`", 0},
    {"output", 'o', "OUT.json", 0, "write the surrogate here; without it only the line is printed", 0},
    {0}};

struct arguments {
    const char *path, *grid, *output;
    bool tight;
    struct canopy_queried_options box;
};

static error_t parse(int key, char *text, struct argp_state *state) {
    struct arguments *a = state->input;
    switch (key) {
    case 'g': a->grid = text; return 0;
    case BOX:
        a->box.window = text;
        a->box.name = "box";
        return 0;
    case METHOD: a->tight = canopy_wish_word(state, "method", text, "fast", "tight") == 1; return 0;
    case 'o': a->output = text; return 0;
    case ARGP_KEY_ARG:
        if (a->path) {
            argp_error(state, "give one surrogate");
        }
        a->path = text;
        return 0;
    case ARGP_KEY_END:
        if (!a->path || !a->grid) {
            argp_error(state, "give a surrogate and --grid MxN");
        }
        return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

struct job {
    const struct arguments *arguments;
    struct canopy_queried *old;
    double step;
    uint16_t size[2];
    struct canopy_envelope now;  ///< with memory of its own
    struct canopy_surrogate out;
    double distance;  ///< mean, in steps
    struct canopy_fault *fault;
};

// ---------------------------------------------------------------------------------------------------------------------
// Finer: knots are inserted

static bool make_room(struct canopy_envelope *envelope, uint32_t m, uint32_t n, struct canopy_fault *fault) {
    envelope->coefficients = malloc(CANOPY_COEFFICIENTS(m, n) * sizeof *envelope->coefficients);
    envelope->coverage = calloc(CANOPY_COVERAGE_BYTES(m, n), 1);
    return (envelope->coefficients && envelope->coverage) || canopy_fault_no_memory(fault);
}

static void drop(struct canopy_envelope *envelope) {
    free(envelope->coefficients);
    free(envelope->coverage);
    *envelope = (struct canopy_envelope){.coefficients = NULL};
}

static const struct canopy_envelope *outer(const struct job *job) {
    return job->old->surrogate.side == CANOPY_BELOW ? &job->old->low : &job->old->high;
}

/// 2^level, and as often again as an axis is halved, for a pitch.
static double halvings(const struct job *job, int times) { return ldexp(1.0, (int)job->old->level + times); }

static bool copy(const struct canopy_envelope *from, struct canopy_envelope *to, struct canopy_fault *fault) {
    const uint32_t m = from->frame.size[0], n = from->frame.size[1];
    *to = *from;
    if (!make_room(to, m, n, fault)) {
        return false;
    }
    memcpy(to->coefficients, from->coefficients, CANOPY_COEFFICIENTS(m, n) * sizeof *to->coefficients);
    memcpy(to->coverage, from->coverage, CANOPY_COVERAGE_BYTES(m, n));
    return true;
}

/// How often each axis is halved to get from one grid to the other; false if that does not do it.
static bool count_halvings(const struct job *job, int times[2]) {
    bool any = false;
    for (int axis = 0; axis < 2; axis++) {
        const uint32_t intervals = outer(job)->frame.size[axis] - 1U, wanted = job->size[axis] - 1U;
        times[axis] = wanted == intervals ? 0 : wanted == 2 * intervals ? 1 : wanted == 4 * intervals ? 2 : -1;
        // In fixed point a pitch is a whole number of units.
        if (times[axis] < 0 || (job->old->surrogate.scalar == CANOPY_FX &&
                                fmod(job->old->surrogate.pitch[axis], halvings(job, times[axis])) != 0.0)) {
            return false;
        }
        any = any || times[axis] > 0 || job->old->level > 0;
    }
    return any && !job->arguments->box.window;
}

static bool insert_knots(struct job *job, const int times[2]) {
    struct canopy_envelope from = *outer(job);
    bool own = false;
    for (int axis = 0; axis < 2; axis++) {
        for (int k = 0; k < times[axis]; k++) {
            struct canopy_envelope to = {.coefficients = NULL};
            const uint32_t m = from.frame.size[0], n = from.frame.size[1];
            const bool ok = make_room(&to, axis == 0 ? 2 * m - 1 : m, axis == 1 ? 2 * n - 1 : n, job->fault) &&
                            (canopy_regrid_halve(&from, axis, &to) == CANOPY_OK ||
                             canopy_fault_set(job->fault, "its coefficients leave the format: fit the points anew"));
            if (own) {
                drop(&from);
            }
            if (!ok) {
                drop(&to);
                return false;
            }
            from = to;
            own = true;
        }
        job->out.pitch[axis] = job->old->surrogate.pitch[axis] / halvings(job, times[axis]);
    }
    job->now = from;
    return own || copy(outer(job), &job->now, job->fault);
}

// ---------------------------------------------------------------------------------------------------------------------
// Any other grid: in the frame's own quanta, because its pitch is to be a whole number of them

/// The quantum of the new frame: one unit in fixed point; in float the largest power of two that divides the old pitch,
/// made finer as long as the frame's edges keep to 22 bits.
static bool find_quantum(const struct job *job, double *quantum) {
    const struct canopy_surrogate *s = &job->old->surrogate;
    const double pitch[2] = {s->pitch[0] / halvings(job, 0), s->pitch[1] / halvings(job, 0)};
    const double width = fmax(s->pitch[0] * (s->size[0] - 1.0), s->pitch[1] * (s->size[1] - 1.0));
    *quantum = 1.0;
    if (s->scalar == CANOPY_F32) {
        double reach = width;
        for (int k = 0; k < 2; k++) {
            reach = fmax(reach, fabs(s->origin[k]) + width);
        }
        int exponent = 0;
        frexp(reach, &exponent);
        *quantum = ldexp(1.0, exponent - 22);
        while (fmod(pitch[0], *quantum) != 0.0 || fmod(pitch[1], *quantum) != 0.0) {
            *quantum /= 2.0;
        }
    }
    return fmod(pitch[0], *quantum) == 0.0 && fmod(pitch[1], *quantum) == 0.0 && width / *quantum <= 0x1p31;
}

/// Whether a part of the frame has an origin that is a whole quantum too: the axes are coordinate axes.
static bool axes_are_straight(const struct canopy_surrogate *s) {
    for (int i = 0; i < 9; i++) {
        const double c = fabs(s->axes[i / 3][i % 3]);
        if (c != 0.0 && c != 1.0) {
            return false;
        }
    }
    return true;
}

/// The box in quanta of `frame`, outward.
static bool find_box(const struct job *job, const struct canopy_frame *frame, struct canopy_query_rect *box) {
    struct canopy_query_rect asked;
    if (!canopy_queried_window(job->old, &job->arguments->box, &asked, job->fault)) {
        return false;
    }
    for (int axis = 0; axis < 2; axis++) {
        const uint64_t pitch = frame->pitch[axis];
        const uint32_t of = job->old->low.frame.pitch[axis];
        box->low[axis] = (uint32_t)(asked.low[axis] * pitch / of);
        box->high[axis] = (uint32_t)((asked.high[axis] * pitch + of - 1) / of);
    }
    return (box->low[0] == 0 && box->low[1] == 0) || axes_are_straight(&job->old->surrogate) ||
           canopy_fault_set(job->fault, "--box %s: the frame is turned: give a part that begins at its corner",
                            job->arguments->box.window);
}

/// The most cells a knot interval, up to 16, for which the pitch, their multiple, grows the box by at most a fiftieth;
/// else those that grow it least.
static bool choose_frame(const struct canopy_frame *old, const struct canopy_query_rect *box, const uint16_t size[2],
                         struct canopy_frame *frame) {
    double least = HUGE_VAL;
    for (uint16_t cells = 16; cells >= 1; cells--) {
        const struct canopy_grid grid = {.size = {size[0], size[1]}, .cells = cells};
        struct canopy_frame made;
        if (canopy_regrid_frame(old, box, &grid, &made) != CANOPY_OK) {
            return false;
        }
        double growth = 0.0;
        for (int axis = 0; axis < 2; axis++) {
            const double extent = fmax(1.0, (double)(box->high[axis] - box->low[axis]));
            growth = fmax(growth, (double)canopy_frame_width(&made, axis) / extent - 1.0);
        }
        if (growth < least) {
            *frame = made;
            least = growth <= 0.02 ? 0.0 : growth;
        }
    }
    return true;
}

struct arenas {
    size_t bytes[3];
    void *at[3];
};

/// Tightens what stands certified over the field, and stays so. False: no memory.
static bool tighten(const struct canopy_field *field, struct canopy_certify *certify, int32_t *coefficients) {
    const struct canopy_frame *frame = &field->frame;
    const uint16_t m = frame->size[0], n = frame->size[1], cells = frame->cells;
    const struct canopy_tighten_size size = {.cells = {cells, cells}, .rows = (uint32_t)CANOPY_TIGHTEN_ROWS(m, n)};
    const size_t bytes = CANOPY_TIGHTEN_ARENA(m, n, cells, cells, 0, size.rows);
    void *arena = malloc(bytes);
    struct canopy_tighten tighten;
    enum canopy_status status = CANOPY_ARENA_SHORT;
    if (arena) {
        status = canopy_tighten_init(&tighten, frame, &size, arena, bytes);
    }
    status = status == CANOPY_OK ? canopy_tighten_field(&tighten, field, certify) : status;
    status = status == CANOPY_OK ? canopy_tighten_begin(&tighten, coefficients, false) : status;
    while (status == CANOPY_OK && canopy_tighten_step(&tighten, UINT32_MAX) == CANOPY_MORE) {}
    free(arena);
    return status == CANOPY_OK;
}

/// Fits above a field that is filled, as a device does: lines and columns, the certificate, raised where it must be.
static bool fit_field(const struct canopy_field *field, struct canopy_fast *fast, struct canopy_certify *certify,
                      bool tight, struct canopy_envelope *now) {
    enum canopy_status status = canopy_fast_begin(fast, now->coefficients);
    while (status == CANOPY_OK && (status = canopy_fast_step(fast, UINT32_MAX)) == CANOPY_MORE) {
        status = CANOPY_OK;
    }
    if (status != CANOPY_OK) {
        return false;
    }
    canopy_certify_begin(certify, now->coefficients);
    while ((status = canopy_certify_step(certify, UINT32_MAX)) == CANOPY_NOT_SAFE) {
        if (canopy_fast_raise(field, now->coefficients, certify->failed_cell, certify->missing) != CANOPY_OK) {
            return false;
        }
    }
    const bool ok = status == CANOPY_OK && (!tight || tighten(field, certify, now->coefficients));
    canopy_fast_orient(&now->frame, now->coefficients);
    canopy_field_coverage(field, now->coverage);
    return ok;
}

static enum canopy_status fill(const struct canopy_envelope *old, const struct canopy_query_rect *box,
                               struct canopy_field *field) {
    struct canopy_regrid regrid;
    canopy_regrid_begin(&regrid, old, box->low, 0, 6, field);
    return canopy_regrid_step(&regrid, UINT32_MAX);
}

static bool fit_with(struct job *job, const struct canopy_envelope *old, const struct canopy_query_rect *box,
                     const struct arenas *arenas) {
    const struct canopy_frame *frame = &job->now.frame;
    const uint16_t cells[2] = {frame->cells, frame->cells};
    const enum canopy_scalar scalar = job->old->surrogate.scalar;
    struct canopy_field field;
    struct canopy_fast fast;
    struct canopy_certify certify;
    if (canopy_field_init(&field, frame, cells, arenas->at[0], arenas->bytes[0]) != CANOPY_OK ||
        canopy_fast_init(&fast, &field, canopy_line_fit_of(scalar), 1, arenas->at[1], arenas->bytes[1]) != CANOPY_OK ||
        canopy_certify_init(&certify, &field, arenas->at[2], arenas->bytes[2]) != CANOPY_OK) {
        return canopy_fault_no_memory(job->fault);
    }
    const enum canopy_status status = fill(old, box, &field);
    if (status == CANOPY_EMPTY) {
        return canopy_fault_set(job->fault, "%s: nothing of the box is covered by data: give another --box",
                                job->old->path);
    }
    return (status == CANOPY_OK && fit_field(&field, &fast, &certify, job->arguments->tight, &job->now)) ||
           canopy_fault_set(job->fault,
                            "%s: the surface leaves the range of heights that can be fitted: choose "
                            "another --grid, or --method fast",
                            job->old->path);
}

/// The mean distance of the new surface from the old one over what is covered of the old one, in steps.
static double mean_distance(const struct canopy_envelope *old, const struct canopy_envelope *now,
                            const struct canopy_query_rect *box) {
    const struct canopy_query_subject before = {.surface = old, .covered = true}, after = {.surface = now};
    double sum = 0.0, area = 0.0;
    for (uint32_t row = 0; row + 1 < old->frame.size[0]; row++) {
        for (uint32_t column = 0; column + 1 < old->frame.size[1]; column++) {
            const uint32_t cell[2] = {row, column};
            struct canopy_query_rect there, here;
            bool meets = canopy_query_counts(&before, row, column);
            for (int axis = 0; axis < 2; axis++) {
                const uint32_t pitch = old->frame.pitch[axis], low = cell[axis] * pitch;
                there.low[axis] = low > box->low[axis] ? low : box->low[axis];
                there.high[axis] = low + pitch < box->high[axis] ? low + pitch : box->high[axis];
                meets = meets && there.low[axis] < there.high[axis];
                here.low[axis] = there.low[axis] - box->low[axis];
                here.high[axis] = there.high[axis] - box->low[axis];
            }
            struct canopy_volume of_old, of_new;
            if (!meets || canopy_volume_begin(&of_old, &before, &there) != CANOPY_OK ||
                canopy_volume_begin(&of_new, &after, &here) != CANOPY_OK ||
                canopy_volume_step(&of_old, UINT32_MAX) != CANOPY_OK ||
                canopy_volume_step(&of_new, UINT32_MAX) != CANOPY_OK) {
                continue;
            }
            const struct canopy_volume_answer a = canopy_volume_answer(&of_new), b = canopy_volume_answer(&of_old);
            sum += ldexp((double)a.low, a.exponent) - ldexp((double)b.low, b.exponent);
            area += (double)of_old.area;
        }
    }
    return area > 0.0 ? fabs(sum) / area : 0.0;
}

static void place(struct job *job, double quantum, const struct canopy_query_rect *box) {
    const struct canopy_surrogate *s = &job->old->surrogate;
    for (int axis = 0; axis < 2; axis++) {
        job->out.pitch[axis] = quantum * job->now.frame.pitch[axis];
        for (int k = 0; k < 3; k++) {
            job->out.origin[k] += s->axes[axis][k] * quantum * box->low[axis];
        }
    }
}

/// Heights of a field are below 2^25 steps, coefficients may be larger: then the steps become coarser.
static bool make_heights_fit(struct job *job) {
    struct canopy_queried *const all[] = {job->old};
    const size_t count = CANOPY_COEFFICIENTS(outer(job)->frame.size[0], outer(job)->frame.size[1]);
    double largest = 0.0;
    for (size_t i = 0; i < count; i++) {
        largest = fmax(largest, fabs((double)outer(job)->coefficients[i]));
    }
    if (largest > CANOPY_HEIGHT_LIMIT * 0.5) {
        job->step = canopy_queried_scale(all, 1, 16.0 * largest * job->step);
    }
    return job->step > 0.0 || canopy_queried_no_memory(job->old, job->fault);
}

static bool fit_above(struct job *job) {
    struct canopy_envelope old = *outer(job);
    struct canopy_query_rect box = {.low = {0, 0}};
    double quantum;
    if (!find_quantum(job, &quantum)) {
        return canopy_fault_set(job->fault,
                                "%s: its pitch is not on a quantum of 32-bit integers: give a surrogate "
                                "that canopy fit wrote",
                                job->old->path);
    }
    for (int axis = 0; axis < 2; axis++) {
        old.frame.pitch[axis] = (uint32_t)(job->old->surrogate.pitch[axis] / halvings(job, 0) / quantum);
    }
    struct canopy_frame frame;
    if (!find_box(job, &old.frame, &box)) {
        return false;
    }
    if (!choose_frame(&old.frame, &box, job->size, &frame)) {
        return canopy_fault_set(job->fault, "--grid %s: the frame cannot be cut so: give another grid",
                                job->arguments->grid);
    }
    const uint32_t m = frame.size[0], n = frame.size[1];
    struct arenas arenas = {.bytes = {CANOPY_FIELD_ARENA(m, n, frame.cells, frame.cells),
                                      CANOPY_FAST_ARENA(m, n, frame.cells, 1),
                                      CANOPY_CERTIFY_ARENA(n, frame.cells, frame.cells)}};
    bool ok = make_room(&job->now, m, n, job->fault);
    for (int k = 0; k < 3; k++) {
        arenas.at[k] = malloc(arenas.bytes[k]);
    }
    job->now.frame = frame;
    ok = ok && fit_with(job, &old, &box, &arenas);
    for (int k = 0; k < 3; k++) {
        free(arenas.at[k]);
    }
    if (ok) {
        place(job, quantum, &box);
        job->distance = mean_distance(&old, &job->now, &box);
    }
    return ok;
}

// ---------------------------------------------------------------------------------------------------------------------
// The file

static bool store(struct job *job) {
    struct canopy_surrogate *out = &job->out;
    const size_t count = CANOPY_COEFFICIENTS(job->size[0], job->size[1]);
    const size_t cells = (size_t)(job->size[0] - 1) * (size_t)(job->size[1] - 1);
    out->size[0] = job->size[0];
    out->size[1] = job->size[1];
    out->lsb = job->step;
    out->coefficients = malloc(count * sizeof *out->coefficients);
    out->trim = malloc(cells);
    if (!out->coefficients || !out->trim || !job->now.coefficients) {
        return canopy_fault_no_memory(job->fault);
    }
    for (size_t i = 0; i < count; i++) {
        out->coefficients[i] = job->now.coefficients[i];
    }
    for (size_t i = 0; i < cells; i++) {
        out->trim[i] = (uint8_t)(job->now.coverage[i / 8] >> (i % 8) & 1);
    }
    return !job->arguments->output || canopy_surrogate_write(job->arguments->output, out, job->fault);
}

static bool read_grid(struct job *job) {
    uint32_t size[2] = {0, 0};
    if (!canopy_option_grid(job->arguments->grid, size) || size[0] < CANOPY_SIZE_MIN || size[1] < CANOPY_SIZE_MIN ||
        size[0] > CANOPY_SIZE_MAX || size[1] > CANOPY_SIZE_MAX) {
        return canopy_fault_set(job->fault, "--grid %s: give MxN, 4x4 to %dx%d", job->arguments->grid, CANOPY_SIZE_MAX,
                                CANOPY_SIZE_MAX);
    }
    job->size[0] = (uint16_t)size[0];
    job->size[1] = (uint16_t)size[1];
    return true;
}

static bool run(struct job *job) {
    struct canopy_queried *const all[] = {job->old};
    if (!read_grid(job) || !canopy_queried_read_refined(job->arguments->path, job->old, job->fault)) {
        return false;
    }
    const struct canopy_surrogate *s = &job->old->surrogate;
    job->step = canopy_queried_scale(all, 1, 0.0);
    if (!(job->step > 0.0)) {
        return canopy_queried_no_memory(job->old, job->fault);
    }
    int times[2];
    const bool finer = count_halvings(job, times);
    if (!finer && !make_heights_fit(job)) {
        return false;
    }
    job->out = *s;
    job->out.coefficients = NULL;
    job->out.trim = NULL;
    job->out.windows = NULL;
    job->out.window_count = 0;
    if (!(finer ? insert_knots(job, times) : fit_above(job)) || !store(job)) {
        return false;
    }
    printf("%ux%u -> %ux%u, ", s->size[0], s->size[1], job->size[0], job->size[1]);
    if (finer) {
        printf("knots inserted: the same surface but for rounding and the outermost knot intervals\n");
    } else {
        printf("fitted over a field of %u x %u cells a knot interval, mean distance %.4g\n", job->now.frame.cells,
               job->now.frame.cells, job->distance * job->step * s->unit);
    }
    return true;
}

int canopy_command_regrid(int argc, char **argv) {
    struct arguments arguments = {.path = NULL};
    const struct argp argp = {.options = OPTIONS, .parser = parse, .args_doc = "SURROGATE.json", .doc = DOC};
    argp_parse(&argp, argc, argv, 0, NULL, &arguments);
    struct canopy_fault fault;
    struct canopy_queried old = {.path = NULL};
    struct job job = {.arguments = &arguments, .old = &old, .fault = &fault};
    const bool ok = run(&job);
    free(job.out.coefficients);
    free(job.out.trim);
    drop(&job.now);
    canopy_queried_free(&old);
    return ok ? CANOPY_EXIT_OK : canopy_command_fail(&fault);
}
