#include "tools/common/load.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "tools/common/flow.h"
#include "tools/common/number.h"
#include "tools/common/rational.h"
#include "tools/common/turn.h"

struct loader {
    const struct canopy_load_wish *wish;
    struct canopy_loaded *loaded;
    struct canopy_rational *rational[CANOPY_THREADS_MAX];  ///< of the frame, if there is one; by thread
    uint64_t most;                                         ///< bytes that points may take
    // for a unit that is yet to be found
    double (*raw)[3];
    uint64_t count;
    size_t room;
    double low[3];
    double high[3];
    double largest;       ///< largest coordinate in size …
    uint64_t largest_at;  ///< … and where it is
};

static bool no_memory(struct canopy_fault *fault) {
    return canopy_fault_set(fault, "out of memory: give fewer points");
}

/// Whether double arithmetic tells that the point is well inside the frame.
static bool well_inside(const struct canopy_surrogate *frame, const double p[3]) {
    double d[3];
    double reach = 0.0;
    for (int k = 0; k < 3; k++) {
        d[k] = p[k] - frame->origin[k];
        reach += fabs(d[k]);
    }
    for (int i = 0; i < 2; i++) {
        const double u =
            (frame->axes[i][0] * d[0] + frame->axes[i][1] * d[1] + frame->axes[i][2] * d[2]) / frame->pitch[i];
        const double room = 1e-12 * (reach / frame->pitch[i] + (double)frame->size[i]);
        if (!(u > room && u < (double)frame->size[i] - 1.0 - room)) {
            return false;
        }
    }
    return true;
}

static bool is_in_frame(const struct loader *loader, unsigned thread, const union canopy_device_point *p,
                        struct canopy_fault *fault) {
    const bool f32 = loader->wish->scalar == CANOPY_F32;
    double point[3];
    for (int k = 0; k < 3; k++) {
        point[k] = f32 ? (double)p->f32[k] : (double)p->fx[k];
    }
    return well_inside(loader->wish->frame, point) || canopy_rational_inside(loader->rational[thread], point, NULL) ||
           canopy_fault_set(fault,
                            "the point is outside the frame of --frame: give a larger frame or leave the point out");
}

// ---------------------------------------------------------------------------------------------------------------------
// To device points

/// What a batch of them comes to.
struct part {
    double loss;
    uint64_t mark;
    union canopy_device_point box[2];
};

static bool convert(const struct loader *loader, unsigned thread, const double (*raw)[3], size_t count,
                    union canopy_device_point *points, struct part *part, size_t *bad, struct canopy_fault *fault) {
    const enum canopy_scalar scalar = loader->wish->scalar;
    const double unit = loader->loaded->unit;
    for (size_t i = 0; i < count; i++) {
        *bad = i;
        if (!canopy_device_point(scalar, unit, raw[i], &points[i], fault)) {
            return false;
        }
        for (int k = 0; k < 3; k++) {
            const double back = scalar == CANOPY_F32 ? (double)points[i].f32[k] : (double)points[i].fx[k];
            part->loss = fmax(part->loss, fabs(back * unit - raw[i][k]));
        }
        if (loader->wish->frame && !is_in_frame(loader, thread, &points[i], fault)) {
            return false;
        }
    }
    const struct canopy_turned all = {.scalar = scalar, .count = count, .points = points};
    canopy_turned_box(&all, &part->box[0], &part->box[1]);
    part->mark = canopy_supply_mark(points, count);
    return true;
}

/// Holds the points as long as they take no more memory than they may.
static bool keep(struct loader *loader, const union canopy_device_point *points, size_t count, const struct part *part,
                 struct canopy_fault *fault) {
    struct canopy_loaded *to = loader->loaded;
    struct canopy_supply *supply = &to->supply;
    union canopy_device_point box[2] = {supply->count ? supply->low : part->box[0],
                                        supply->count ? supply->high : part->box[1]};
    const bool held = to->list.count == supply->count;
    canopy_turned_widen(supply->scalar, box, part->box);
    supply->low = box[0];
    supply->high = box[1];
    supply->mark = canopy_supply_join(supply->mark, part->mark);
    supply->count += count;
    to->loss = fmax(to->loss, part->loss);
    if (held && supply->count * sizeof *points <= loader->most) {
        return canopy_device_list_append(&to->list, points, count) || no_memory(fault);
    }
    canopy_device_list_free(&to->list);
    return true;
}

static bool convert_batch(void *context, unsigned thread, struct canopy_batch *batch, size_t *bad,
                          struct canopy_fault *fault) {
    return convert(context, thread, batch->raw, batch->count, batch->points, batch->result, bad, fault);
}

static bool gather_points(void *context, struct canopy_batch *batch, struct canopy_fault *fault) {
    return keep(context, batch->points, batch->count, batch->result, fault);
}

static bool read_with_unit(const char *path, struct loader *loader, struct canopy_fault *fault) {
    const struct canopy_flow flow = {.stage = "reading",
                                     .threads = loader->wish->threads ? loader->wish->threads : 1,
                                     .result_size = sizeof(struct part),
                                     .context = loader,
                                     .work = convert_batch,
                                     .gather = gather_points};
    return canopy_flow_file(path, &flow, &loader->loaded->info, fault);
}

// ---------------------------------------------------------------------------------------------------------------------
// To a unit

struct extent {
    double low[3];
    double high[3];
    double largest;
    uint64_t largest_at;
};

static bool measure_batch(void *context, unsigned thread, struct canopy_batch *batch, size_t *bad,
                          struct canopy_fault *fault) {
    struct extent *extent = batch->result;
    (void)context;
    (void)thread;
    (void)bad;
    (void)fault;
    memcpy(extent->low, batch->raw[0], sizeof extent->low);
    memcpy(extent->high, batch->raw[0], sizeof extent->high);
    for (size_t i = 0; i < batch->count; i++) {
        for (int k = 0; k < 3; k++) {
            const double x = batch->raw[i][k];
            extent->low[k] = fmin(extent->low[k], x);
            extent->high[k] = fmax(extent->high[k], x);
            if (fabs(x) > extent->largest) {
                extent->largest = fabs(x);
                extent->largest_at = batch->where[i];
            }
        }
    }
    return true;
}

/// Keeps the points as they are, as long as there is memory for them.
static bool keep_raw(struct loader *loader, const struct canopy_batch *batch, struct canopy_fault *fault) {
    const uint64_t count = loader->count + batch->count;
    if (count * (sizeof *loader->raw + sizeof(union canopy_device_point)) > loader->most) {
        free(loader->raw);
        loader->raw = NULL;
        return true;
    }
    if (count > loader->room) {
        const size_t room = 2 * (size_t)count + 65536;
        double(*raw)[3] = realloc(loader->raw, room * sizeof *raw);
        if (!raw) {
            return no_memory(fault);
        }
        loader->raw = raw;
        loader->room = room;
    }
    memcpy(loader->raw + loader->count, batch->raw, batch->count * sizeof *loader->raw);
    return true;
}

static bool gather_extent(void *context, struct canopy_batch *batch, struct canopy_fault *fault) {
    struct loader *loader = context;
    const struct extent *extent = batch->result;
    for (int k = 0; k < 3; k++) {
        loader->low[k] = loader->count == 0 ? extent->low[k] : fmin(loader->low[k], extent->low[k]);
        loader->high[k] = loader->count == 0 ? extent->high[k] : fmax(loader->high[k], extent->high[k]);
    }
    if (extent->largest > loader->largest) {
        loader->largest = extent->largest;
        loader->largest_at = batch->before + extent->largest_at;
    }
    const bool ok = (loader->count > 0 && !loader->raw) || keep_raw(loader, batch, fault);
    loader->count += batch->count;
    return ok;
}

static double power_of_ten(int exponent) {
    char text[16];
    snprintf(text, sizeof text, "1e%d", exponent);
    return strtod(text, NULL);  // the double nearest to it, as a file would have it
}

static double unit_for(const struct loader *loader) {
    double extent = 0.0;
    for (int k = 0; k < 3; k++) {
        extent = fmax(extent, loader->high[k] - loader->low[k]);
    }
    extent = extent > 0.0 ? extent : loader->largest;
    if (!(extent > 0.0)) {
        return 1.0;
    }
    extent = fmin(fmax(extent, 1e-300), 1e300);
    int exponent = (int)floor(log10(extent)) - 5;
    exponent += extent / power_of_ten(exponent) >= 1e6 * (1.0 - 1e-12);  // log10 and the quotient are rounded
    exponent -= extent / power_of_ten(exponent) < 1e5 * (1.0 - 1e-12);
    return power_of_ten(exponent);
}

/// Whatever overflows first, the largest coordinate overflows too, and its place is known.
static bool largest_fits(const char *path, const struct loader *loader, struct canopy_fault *fault) {
    const struct canopy_loaded *loaded = loader->loaded;
    const double point[3] = {loader->largest, 0.0, 0.0};
    union canopy_device_point device;
    if (canopy_device_point(loader->wish->scalar, loaded->unit, point, &device, fault)) {
        return true;
    }
    canopy_fault_set(fault,
                     "%g overflows 32-bit fixed point at unit %g, which the points' extent asks for: give a larger "
                     "--unit or move the origin",
                     loader->largest, loaded->unit);
    return canopy_points_place(fault, path, loaded->info.by_line, loader->largest_at);
}

static bool read_and_find_unit(const char *path, struct loader *loader, struct canopy_fault *fault) {
    struct canopy_loaded *loaded = loader->loaded;
    const struct canopy_flow flow = {.stage = "reading for the unit",
                                     .threads = loader->wish->threads ? loader->wish->threads : 1,
                                     .result_size = sizeof(struct extent),
                                     .context = loader,
                                     .work = measure_batch,
                                     .gather = gather_extent};
    if (!canopy_flow_file(path, &flow, &loaded->info, fault)) {
        return false;
    }
    loaded->unit = unit_for(loader);
    loaded->supply.unit = loaded->unit;
    if (!largest_fits(path, loader, fault)) {
        return false;
    }
    if (!loader->raw) {
        return read_with_unit(path, loader, fault);
    }
    for (uint64_t at = 0; at < loader->count;) {
        union canopy_device_point points[1024];
        const size_t count = loader->count - at < 1024 ? (size_t)(loader->count - at) : 1024;
        struct part part = {.loss = 0.0};
        size_t bad = 0;
        // Without the point's line: with a --frame the unit is known, and nothing but the largest overflows.
        if (!convert(loader, 0, (const double(*)[3])loader->raw + at, count, points, &part, &bad, fault) ||
            !keep(loader, points, count, &part, fault)) {
            return false;
        }
        at += count;
    }
    return true;
}

// ---------------------------------------------------------------------------------------------------------------------
// All together

/// Whether the file can be read a second time.
static bool is_lasting(const char *path) {
    struct stat status;
    return (strcmp(path, "-") == 0 ? fstat(STDIN_FILENO, &status) : stat(path, &status)) == 0 &&
           S_ISREG(status.st_mode);
}

bool canopy_load(const char *path, const struct canopy_load_wish *wish, struct canopy_loaded *loaded,
                 struct canopy_fault *fault) {
    *loaded = (struct canopy_loaded){.list = {.scalar = wish->scalar}, .unit = wish->unit};
    struct loader loader = {.wish = wish, .loaded = loaded};
    const unsigned threads = wish->threads ? wish->threads : 1;
    loader.most = wish->most && is_lasting(path) ? wish->most : UINT64_MAX;
    if (wish->unit == 0.0 && wish->scalar == CANOPY_F32) {
        loaded->unit = 1.0;
    }
    loaded->supply =
        (struct canopy_supply){.scalar = wish->scalar, .threads = threads, .path = path, .unit = loaded->unit};
    bool ok = true;
    for (unsigned i = 0; ok && wish->frame && i < threads; i++) {
        loader.rational[i] = canopy_rational_open(wish->frame);
        ok = loader.rational[i] || no_memory(fault);
    }
    ok = ok && (loaded->unit > 0.0 ? read_with_unit(path, &loader, fault) : read_and_find_unit(path, &loader, fault));
    for (unsigned i = 0; i < threads; i++) {
        canopy_rational_close(loader.rational[i]);
    }
    free(loader.raw);
    if (!ok) {
        canopy_device_list_free(&loaded->list);
    }
    loaded->supply.list = loaded->list;
    return ok;
}
