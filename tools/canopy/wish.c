#include "tools/canopy/wish.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include <unistd.h>

#include "tools/common/flow.h"
#include "tools/common/number.h"
#include "tools/common/option.h"
#include "tools/common/progress.h"
#include "tools/common/turn.h"

// ---------------------------------------------------------------------------------------------------------------------
// The command line

enum { METHOD = 0x200, SCALAR, UNIT, DIR, PLANE, FIELD, PACKED, FRAME, MEMORY, THREADS };

static const struct argp_option OPTIONS[] = {
    {"grid", 'g', "MxN", 0,
     "coefficients along the frame's first and second axis, 4x4 to 1024x1024; required unless --frame tells it", 0},
    {"method", METHOD, "fast|tight", 0,
     "how to fit: fast (default), or tight: fast tightened to within a few per cent of the least mean gap possible "
     "above all points, or, with --field, above all covered cells; how far it is at most is proved and printed",
     0},
    {"scalar", SCALAR, "f32|fx", 0, "the device's numbers: 32-bit float (default) or 32-bit fixed point", 0},
    {"unit", UNIT, "U", 0,
     "input units a device unit; default 1 for f32, for fx the power of ten that spreads the largest extent over 10^5 "
     "to 10^6 units",
     0},
    {"dir", DIR, "X,Y,Z", 0, "direction from the scene to the viewer (default 0,0,1); heights are measured along it",
     0},
    {"plane", PLANE, "X,Y,Z,X,Y,Z,X,Y,Z", 0,
     "or three points of a plane, in input units: heights are measured at right angles to it and grow towards who sees "
     "the three anticlockwise; the frame's first axis runs from the first to the second",
     0},
    {"field", FIELD, "Q", 0,
     "fit from the bounded streaming field with Q x Q cells a knot interval, 1 to 32, as the device does, instead of "
     "from the points",
     0},
    {"packed", PACKED, NULL, 0,
     "with --field: one byte a cell instead of four, so twice the Q in the same memory, which is tighter; heights are "
     "rounded up to a 2048th of the range or less at the top of each knot cell, and coarser below",
     0},
    {"frame", FRAME, "FILE", 0, "use the frame (and unit) of this surrogate; a point outside it is bad input", 0},
    {"memory", MEMORY, "MB", 0,
     "hold the points in memory only if they take no more than this (12 bytes a point), else read the file again for "
     "each pass, with the same result; default: a quarter of the machine's; 0: never hold them. What looks at points "
     "one by one, tight and --refine without --field, is then done from a field, and says so",
     0},
    {"threads", THREADS, "N", 0, "threads that read, fit and prove, 1 to 64; default: as many as processors, up to 16",
     0},
    {0}};

int canopy_wish_word(struct argp_state *state, const char *option, const char *text, const char *zero,
                     const char *one) {
    if (strcmp(text, zero) != 0 && strcmp(text, one) != 0) {
        argp_error(state, "--%s is %s or %s, not '%s'", option, zero, one, text);
    }
    return strcmp(text, one) == 0;
}

static error_t parse(int key, char *text, struct argp_state *state) {
    struct canopy_wish *a = state->input;
    switch (key) {
    case 'g': a->grid = text; return 0;
    case UNIT: a->unit = text; return 0;
    case DIR: a->dir = text; return 0;
    case PLANE: a->plane = text; return 0;
    case FIELD: a->field = text; return 0;
    case PACKED: a->packed = true; return 0;
    case FRAME: a->frame = text; return 0;
    case MEMORY: a->memory = text; return 0;
    case THREADS: a->threads = text; return 0;
    case SCALAR: a->scalar = canopy_wish_word(state, "scalar", text, "f32", "fx"); return 0;
    case METHOD: a->tight = canopy_wish_word(state, "method", text, "fast", "tight") == 1; return 0;
    case ARGP_KEY_ARG:
        if (a->points) {
            argp_error(state, "give one point file");
        }
        a->points = text;
        return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

const struct argp canopy_wish_argp = {.options = OPTIONS, .parser = parse};

void canopy_wish_end(const struct canopy_wish *wish, struct argp_state *state) {
    if (!wish->points || (!wish->grid && !wish->frame)) {
        argp_error(state, "give a point file and --grid MxN (or --frame, whose grid is taken then)");
    }
    if (wish->packed && !wish->field) {
        argp_error(state, "--packed says how the cells of a field are kept: give --field Q");
    }
    if (wish->frame && (wish->dir || wish->plane)) {
        argp_error(state, "--%s is part of --frame: give one of them", wish->dir ? "dir" : "plane");
    }
    if (wish->dir && wish->plane) {
        argp_error(state, "--dir and --plane are two ways to say the same: give one of them");
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// From words to a wish

static bool read_grid(const char *text, uint16_t size[2], struct canopy_fault *fault) {
    uint32_t given[2];
    if (!canopy_option_grid(text, given) || given[0] < CANOPY_SIZE_MIN || given[1] < CANOPY_SIZE_MIN ||
        given[0] > CANOPY_SIZE_MAX || given[1] > CANOPY_SIZE_MAX) {
        return canopy_fault_set(fault, "--grid %.40s: give MxN, each from %d to %d", text, CANOPY_SIZE_MIN,
                                CANOPY_SIZE_MAX);
    }
    size[0] = (uint16_t)given[0];
    size[1] = (uint16_t)given[1];
    return true;
}

static bool read_field(const char *text, uint16_t *cells, struct canopy_fault *fault) {
    uint64_t q = 0;
    if (!canopy_number_whole(text, 1, CANOPY_CELLS_MAX, &q)) {
        return canopy_fault_set(fault, "--field %.40s: give a whole number of cells a knot interval from 1 to %d", text,
                                CANOPY_CELLS_MAX);
    }
    *cells = (uint16_t)q;
    return true;
}

static bool read_unit(const char *text, double *unit, struct canopy_fault *fault) {
    return canopy_number_positive(text, unit) ||
           canopy_fault_set(fault, "--unit %.40s: give a positive number of input units a device unit", text);
}

static bool read_direction(const char *text, double direction[3], struct canopy_fault *fault) {
    int32_t axes[3][3];
    return (canopy_option_numbers(text, 3, direction) && canopy_turn_axes(direction, axes)) ||
           canopy_fault_set(fault, "--dir %.40s: give three numbers X,Y,Z that are not all zero", text);
}

static bool read_plane(const char *text, struct canopy_surface_wish *wish, struct canopy_fault *fault) {
    int32_t axes[3][3];
    wish->has_plane = true;
    return (canopy_option_numbers(text, 9, wish->plane) && canopy_turn_axes_plane(wish->plane, axes)) ||
           canopy_fault_set(fault, "--plane %.80s: give three points X,Y,Z,X,Y,Z,X,Y,Z that are not on a line", text);
}

/// The frame's surrogate decides unit, axes and, if they are not told, grid and scalar.
static bool read_frame(const struct canopy_wish *a, struct canopy_surrogate *frame, struct canopy_surface_wish *wish,
                       struct canopy_fault *fault) {
    if (!canopy_surrogate_read(a->frame, frame, fault)) {
        return false;
    }
    if (a->unit && wish->unit != frame->unit) {
        return canopy_fault_set(fault, "%s: its unit is %g, not that of --unit: leave --unit out", a->frame,
                                frame->unit);
    }
    if (a->grid && (wish->size[0] != frame->size[0] || wish->size[1] != frame->size[1])) {
        return canopy_fault_set(fault, "%s: its grid is %ux%u: give the same --grid or none", a->frame, frame->size[0],
                                frame->size[1]);
    }
    if (frame->size[0] > CANOPY_SIZE_MAX || frame->size[1] > CANOPY_SIZE_MAX) {
        return canopy_fault_set(fault, "%s: its grid is %ux%u: fits are made up to %dx%d", a->frame, frame->size[0],
                                frame->size[1], CANOPY_SIZE_MAX, CANOPY_SIZE_MAX);
    }
    wish->size[0] = (uint16_t)frame->size[0];
    wish->size[1] = (uint16_t)frame->size[1];
    wish->unit = frame->unit;
    wish->scalar = a->scalar < 0 ? frame->scalar : wish->scalar;
    wish->frame = frame;
    return true;
}

bool canopy_wish_read(const struct canopy_wish *a, struct canopy_surrogate *frame, struct canopy_surface_wish *wish,
                      struct canopy_fault *fault) {
    *wish = (struct canopy_surface_wish){.scalar = a->scalar > 0 ? CANOPY_FX : CANOPY_F32,
                                         .direction = {0.0, 0.0, 1.0},
                                         .fitting = {.tight = a->tight, .packed = a->packed}};
    return (!a->grid || read_grid(a->grid, wish->size, fault)) &&
           (!a->field || read_field(a->field, &wish->fitting.field, fault)) &&
           (!a->unit || read_unit(a->unit, &wish->unit, fault)) &&
           (!a->dir || read_direction(a->dir, wish->direction, fault)) &&
           (!a->plane || read_plane(a->plane, wish, fault)) && (!a->frame || read_frame(a, frame, wish, fault));
}

#define HELD_PART 4  // of the machine's memory that points may take unless told

static bool read_memory(const char *text, uint64_t *most, struct canopy_fault *fault) {
    uint64_t megabytes = 0;
    *most = (uint64_t)sysconf(_SC_PHYS_PAGES) * (uint64_t)sysconf(_SC_PAGE_SIZE) / HELD_PART;
    if (text && !canopy_option_whole("memory", text, 0, UINT64_C(1) << 40, &megabytes, fault)) {
        return false;
    }
    *most = !text ? *most : megabytes > 0 ? megabytes << 20 : 1;
    return true;
}

/// The finest field of 64 MB or less, for points that are too many to be looked at one by one.
static uint16_t field_for(const uint16_t size[2]) {
    uint16_t cells = 16;
    while (cells > 1 && CANOPY_FIELD_ARENA(size[0], size[1], cells, cells) > (64U << 20)) {
        cells /= 2;
    }
    return cells;
}

bool canopy_wish_load(const struct canopy_wish *words, struct canopy_surface_wish *wish, struct canopy_loaded *loaded,
                      struct canopy_fault *fault) {
    struct canopy_load_wish load = {
        .scalar = wish->scalar, .unit = wish->unit, .frame = wish->frame, .threads = canopy_flow_threads()};
    if (!read_memory(words->memory, &load.most, fault) ||
        (words->threads &&
         !canopy_option_whole32("threads", words->threads, 1, CANOPY_THREADS_MAX, &load.threads, fault)) ||
        !canopy_load(words->points, &load, loaded, fault)) {
        return false;
    }
    wish->unit = loaded->unit;
    wish->fitting.threads = load.threads;
    if (!canopy_supply_is_held(&loaded->supply) && wish->fitting.field == 0 &&
        (wish->fitting.tight || wish->refining.count > 0)) {
        wish->fitting.field = field_for(wish->size);
    }
    return true;
}

// ---------------------------------------------------------------------------------------------------------------------
// What came out

/// What to do where floats are coarse: a frame's pitch is a multiple of a 2^22nd of the largest coordinate, or of up
/// to twice that. Where that is more than a hundredth of a knot interval, the grid stands off, and so does the surface.
static const char *advice(const struct canopy_surface_wish *wish, const struct canopy_loaded *loaded) {
    const union canopy_device_point *low = &loaded->supply.low, *high = &loaded->supply.high;
    double extent = 0.0, reach = 0.0;
    for (int k = 0; wish->scalar == CANOPY_F32 && k < 3; k++) {
        extent = fmax(extent, (double)high->f32[k] - (double)low->f32[k]);
        reach = fmax(reach, fmax(fabs((double)high->f32[k]), fabs((double)low->f32[k])));
    }
    const int intervals = (wish->size[0] > wish->size[1] ? wish->size[0] : wish->size[1]) - 1;
    return extent > 0.0 && reach * 0x1p-22 * intervals > extent / 100.0
               ? "; so far from zero floats are coarse for this grid: subtract an origin near the points first"
               : "";
}

void canopy_wish_report(const struct canopy_surface_wish *wish, const struct canopy_loaded *loaded,
                        const struct canopy_surface_report *r, const char *output) {
    char how[140], from[40] = "";
    char windows[80] = "";
    if (r->windows > 0) {
        snprintf(windows, sizeof windows, " with %zu window%s (%zu coefficients)", r->windows,
                 r->windows > 1 ? "s" : "", r->coefficients);
    }
    if (wish->fitting.field) {
        snprintf(from, sizeof from, " from %sfield %u", wish->fitting.packed ? "packed " : "", wish->fitting.field);
    }
    snprintf(how, sizeof how, "fast%s", from);
    if (wish->fitting.tight) {
        snprintf(how, sizeof how, "tight%s (%sat most %.2g%% from the tightest possible%s)", from,
                 r->windows > 0 ? "without windows " : "", 100.0 * r->fitting.excess,
                 r->fitting.paired ? " beside the other" : "");
    }
    canopy_progress_end();
    printf("%" PRIu64 " point%s%s, %ux%u%s %s, %s, %s, unit %g (rounding loses at most %.2g%s), mean gap %.4g%% and "
           "max gap %.3g%% of "
           "%s, certified margin %.3g, %" PRIu32 " iterations, fit %.2f ms, certificate %.2f ms%s%s\n",
           r->result.points, r->result.points == 1 ? "" : "s", canopy_points_skipped(&loaded->info).text, wish->size[0],
           wish->size[1], windows, wish->side == CANOPY_ABOVE ? "above" : "below", how,
           wish->scalar == CANOPY_F32 ? "f32" : "fx", loaded->unit, loaded->loss, advice(wish, loaded),
           canopy_exact_mean_gap(&r->result), canopy_exact_max_gap(&r->result), canopy_exact_gap_base(&r->result),
           r->result.margin * loaded->unit, r->fitting.iterations, r->fit_ms, r->certificate_ms, output ? ", " : "",
           output ? output : "");
}
