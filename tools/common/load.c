#include "tools/common/load.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "tools/common/number.h"
#include "tools/common/points.h"
#include "tools/common/rational.h"

struct loader {
    const struct canopy_load_wish *wish;
    struct canopy_loaded *loaded;
    struct canopy_rational *rational;  ///< of the frame, if there is one
    // for a unit that is yet to be found
    double (*raw)[3];
    size_t count;
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

static bool is_in_frame(struct loader *loader, const union canopy_device_point *p, struct canopy_fault *fault) {
    const bool f32 = loader->wish->scalar == CANOPY_F32;
    double point[3];
    for (int k = 0; k < 3; k++) {
        point[k] = f32 ? (double)p->f32[k] : (double)p->fx[k];
    }
    return well_inside(loader->wish->frame, point) || canopy_rational_inside(loader->rational, point, NULL) ||
           canopy_fault_set(fault,
                            "the point is outside the frame of --frame: give a larger frame or leave the point out");
}

static bool add(struct loader *loader, const double point[3], struct canopy_fault *fault) {
    struct canopy_loaded *to = loader->loaded;
    union canopy_device_point device;
    if (!canopy_device_point(loader->wish->scalar, to->unit, point, &device, fault)) {
        return false;
    }
    for (int k = 0; k < 3; k++) {
        const double back = loader->wish->scalar == CANOPY_F32 ? (double)device.f32[k] : (double)device.fx[k];
        to->loss = fmax(to->loss, fabs(back * to->unit - point[k]));
    }
    if (loader->wish->frame && !is_in_frame(loader, &device, fault)) {
        return false;
    }
    return canopy_device_list_add(&to->list, &device) || no_memory(fault);
}

static bool take(void *context, const double point[3], uint64_t where, struct canopy_fault *fault) {
    (void)where;
    return add(context, point, fault);
}

/// Keeps the point as it is, and what the unit depends on.
static bool take_raw(void *context, const double point[3], uint64_t where, struct canopy_fault *fault) {
    struct loader *loader = context;
    if (loader->count == loader->room) {
        const size_t room = loader->room ? loader->room * 2 : 65536;
        double(*raw)[3] = realloc(loader->raw, room * sizeof *raw);
        if (!raw) {
            return no_memory(fault);
        }
        loader->raw = raw;
        loader->room = room;
    }
    for (int k = 0; k < 3; k++) {
        loader->raw[loader->count][k] = point[k];
        loader->low[k] = loader->count == 0 ? point[k] : fmin(loader->low[k], point[k]);
        loader->high[k] = loader->count == 0 ? point[k] : fmax(loader->high[k], point[k]);
        if (fabs(point[k]) > loader->largest) {
            loader->largest = fabs(point[k]);
            loader->largest_at = where;
        }
    }
    loader->count++;
    return true;
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

static bool read_with_unit(const char *path, struct loader *loader, struct canopy_fault *fault) {
    return canopy_points_read(path, (struct canopy_points_sink){loader, take}, &loader->loaded->info, fault);
}

static bool read_and_find_unit(const char *path, struct loader *loader, struct canopy_fault *fault) {
    const struct canopy_points_info *info = &loader->loaded->info;
    if (!canopy_points_read(path, (struct canopy_points_sink){loader, take_raw}, &loader->loaded->info, fault)) {
        return false;
    }
    loader->loaded->unit = unit_for(loader);
    for (size_t i = 0; i < loader->count; i++) {
        if (!add(loader, loader->raw[i], fault)) {
            // Whatever overflows first, the largest coordinate overflows too, and its place is known.
            canopy_fault_set(
                fault,
                "%g overflows 32-bit fixed point at unit %g, which the points' extent asks for: give a larger "
                "--unit or move the origin",
                loader->largest, loader->loaded->unit);
            return canopy_points_place(fault, path, info->by_line, loader->largest_at);
        }
    }
    return true;
}

bool canopy_load(const char *path, const struct canopy_load_wish *wish, struct canopy_loaded *loaded,
                 struct canopy_fault *fault) {
    *loaded = (struct canopy_loaded){.list = {.scalar = wish->scalar}, .unit = wish->unit};
    struct loader loader = {.wish = wish, .loaded = loaded};
    if (wish->unit == 0.0 && wish->scalar == CANOPY_F32) {
        loaded->unit = 1.0;
    }
    if (wish->frame) {
        loader.rational = canopy_rational_open(wish->frame);
        if (!loader.rational) {
            return no_memory(fault);
        }
    }
    const bool ok =
        loaded->unit > 0.0 ? read_with_unit(path, &loader, fault) : read_and_find_unit(path, &loader, fault);
    canopy_rational_close(loader.rational);
    free(loader.raw);
    if (!ok) {
        canopy_device_list_free(&loaded->list);
    }
    return ok;
}
