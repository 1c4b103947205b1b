#include "tools/common/scene.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tools/common/points.h"

#define COLUMNS_WIDE 4096u  // most columns that may be asked for
#define COLUMNS_USUAL 488u  // what four reads of a profile carry
#define PROFILES_MOST 65535u
#define LINES_LEAST 16u
#define PROFILES_USUAL 4096u
#define READINGS_MOST (64u << 20)
#define COUNTS 65534  // the largest height count; 65535 is "no reading"

struct cloud {
    double (*points)[3];
    size_t count, room;
    double low[3], high[3];
    double unit;  // 0 until it is known
};

static bool fits(double value) { return fabs(value) <= (double)INT32_MAX; }

static bool take(void *context, const double point[3], uint64_t where, struct canopy_fault *fault) {
    struct cloud *cloud = context;
    (void)where;  // the reader puts it in front
    if (cloud->count == cloud->room) {
        const size_t room = cloud->room == 0 ? 4096 : cloud->room * 2;
        double(*more)[3] = realloc(cloud->points, room * sizeof *more);
        if (more == NULL)
            return canopy_fault_set(fault, "no memory for more than %zu points: give fewer", cloud->count);
        cloud->points = more;
        cloud->room = room;
    }
    for (int i = 0; i < 3; i++) {
        if (cloud->unit > 0 && !fits(rint(point[i] / cloud->unit)))
            return canopy_fault_set(fault, "%g does not fit 32 bits at a unit of %g: choose a larger --unit", point[i],
                                    cloud->unit);
        if (cloud->count == 0 || point[i] < cloud->low[i])
            cloud->low[i] = point[i];
        if (cloud->count == 0 || point[i] > cloud->high[i])
            cloud->high[i] = point[i];
        cloud->points[cloud->count][i] = point[i];
    }
    cloud->count++;
    return true;
}

double canopy_scene_shortest(float value) {
    char text[32];
    for (int digits = 1; digits <= 9; digits++) {
        snprintf(text, sizeof text, "%.*e", digits - 1, (double)value);
        if (strtof(text, NULL) == value)
            break;
    }
    return strtod(text, NULL);
}

// The power of ten that spreads the largest extent over 10^5 to 10^6 units.
static double usual_unit(const struct cloud *cloud) {
    double extent = 0;
    for (int i = 0; i < 3; i++)
        extent = fmax(extent, cloud->high[i] - cloud->low[i]);
    if (!(extent > 0))
        return 1;
    char text[32];
    snprintf(text, sizeof text, "1e%d", (int)floor(log10(extent)) - 5);
    return strtod(text, NULL);
}

// As the registers carry it: a normal float, and the decimal that stands for it.
static bool choose_unit(const char *path, struct cloud *cloud, struct canopy_fault *fault) {
    const double unit = canopy_scene_shortest((float)(cloud->unit > 0 ? cloud->unit : usual_unit(cloud)));
    if (!(isnormal((float)unit) && unit > 0))
        return canopy_fault_set(fault, "%s: a unit of %g does not fit a 32-bit float: give a --unit", path, unit);
    cloud->unit = unit;
    for (int i = 0; i < 3; i++) {
        const double worst = fmax(fabs(cloud->low[i]), fabs(cloud->high[i]));
        if (!fits(rint(worst / unit)))
            return canopy_fault_set(fault, "%s: %g does not fit 32 bits at a unit of %g: choose a larger --unit", path,
                                    worst, unit);
    }
    return true;
}

static int32_t device(double value, double unit) { return (int32_t)rint(value / unit); }

static int ascending(const void *a, const void *b) {
    const int32_t x = *(const int32_t *)a, y = *(const int32_t *)b;
    return (x > y) - (x < y);
}

// How one axis is cut: first line, distance, number of lines.
struct cut {
    int32_t start, step;
    uint32_t count;
};

// A regular lattice of at most `most` lines along an axis.
static bool lattice(const struct cloud *cloud, int axis, uint32_t most, struct cut *cut) {
    int32_t *values = malloc(cloud->count * sizeof *values);
    if (values == NULL)
        return false;
    for (size_t i = 0; i < cloud->count; i++)
        values[i] = device(cloud->points[i][axis], cloud->unit);
    qsort(values, cloud->count, sizeof *values, ascending);
    size_t count = 1;
    int64_t step = 0;
    bool regular = true;
    for (size_t i = 1; i < cloud->count && regular; i++) {
        const int64_t gap = (int64_t)values[i] - values[i - 1];
        if (gap == 0)
            continue;
        count++;
        regular = (step == 0 || gap == step) && gap <= INT32_MAX && count <= most;
        step = gap;
    }
    *cut = (struct cut){.start = values[0], .step = (int32_t)(step == 0 ? 1 : step), .count = (uint32_t)count};
    free(values);
    return regular;
}

// Cuts [low, high] into at most `count` lines, whole units apart, so that every value is within half a step of one.
static struct cut divide(const struct cloud *cloud, int axis, uint32_t count) {
    const int64_t low = device(cloud->low[axis], cloud->unit), extent = device(cloud->high[axis], cloud->unit) - low;
    int64_t step = count > 1 ? (extent + count - 2) / (count - 1) : extent + 1;
    if (step < 1)
        step = 1;
    if (step > INT32_MAX)
        step = INT32_MAX;
    const uint32_t used = (uint32_t)((extent + step / 2) / step) + 1;
    return (struct cut){.start = (int32_t)low, .step = (int32_t)step, .count = used < count ? used : count};
}

static uint32_t clamp(double value, uint32_t low, uint32_t high) {
    return value < low ? low : value > high ? high : (uint32_t)value;
}

// As many cells as points, in the shape of the scene; a few points get a few lines more.
static void usual_counts(const struct cloud *cloud, uint32_t *columns, uint32_t *profiles) {
    const double width = fmax(cloud->high[0] - cloud->low[0], cloud->unit);
    const double depth = fmax(cloud->high[1] - cloud->low[1], cloud->unit);
    const double n = (double)cloud->count;
    *columns = clamp(sqrt(n * width / depth), LINES_LEAST, 400);
    *profiles = clamp(n / *columns, LINES_LEAST, 400);
}

static void choose_cuts(const struct cloud *cloud, const struct canopy_scene_wish *wish, struct cut cuts[2]) {
    uint32_t count[2];
    struct cut found[2] = {0};
    usual_counts(cloud, &count[0], &count[1]);
    bool regular = lattice(cloud, 0, wish->columns > 0 ? wish->columns : COLUMNS_USUAL, &found[0]) &&
                   lattice(cloud, 1, wish->profiles > 0 ? wish->profiles : PROFILES_USUAL, &found[1]);
    const uint64_t cells = (uint64_t)found[0].count * found[1].count;
    regular = regular && cells <= 4 * (uint64_t)cloud->count;  // else these are a few points with round coordinates
    const uint32_t wished[2] = {wish->columns, wish->profiles};
    for (int axis = 0; axis < 2; axis++) {
        if (regular && (wished[axis] == 0 || wished[axis] == found[axis].count))
            cuts[axis] = found[axis];
        else
            cuts[axis] = divide(cloud, axis, wished[axis] > 0 ? wished[axis] : count[axis]);
    }
}

static bool choose_heights(const char *path, const struct cloud *cloud, double margin, struct canopy_scene *scene,
                           struct canopy_fault *fault) {
    const int64_t room = (int64_t)ceil(fmin(margin / cloud->unit, 1e9));
    int64_t low = (int64_t)device(cloud->low[2], cloud->unit) - room;
    const int64_t extent = (int64_t)device(cloud->high[2], cloud->unit) + room - low;
    low = low < INT32_MIN ? INT32_MIN : low;
    const int64_t step = (extent + COUNTS - 1) / COUNTS;
    if (step > UINT16_MAX)
        return canopy_fault_set(fault, "%s: heights over %g do not fit 16 bits: choose a larger --unit", path,
                                (double)extent * cloud->unit);
    scene->z_offset = (int32_t)low;
    scene->z_step = (uint16_t)(step < 1 ? 1 : step);
    const int64_t most = (INT32_MAX - low) / scene->z_step;
    scene->height_max = (uint16_t)(most > COUNTS ? COUNTS : most);
    return true;
}

static uint32_t line_of(int64_t value, const struct cut *cut) {
    const int64_t line = (value - cut->start + cut->step / 2) / cut->step;
    return line >= cut->count ? cut->count - 1 : (uint32_t)line;
}

// The highest point of every cell, in counts: what is seen from above.
static void look_down(const struct cloud *cloud, const struct cut cuts[2], struct canopy_scene *scene) {
    const size_t cells = (size_t)scene->columns * scene->profiles;
    for (size_t i = 0; i < cells; i++)
        scene->heights[i] = CANOPY_SCENE_NONE;
    for (size_t i = 0; i < cloud->count; i++) {
        const uint32_t column = line_of(device(cloud->points[i][0], cloud->unit), &cuts[0]);
        const uint32_t profile = line_of(device(cloud->points[i][1], cloud->unit), &cuts[1]);
        const int64_t above = (int64_t)device(cloud->points[i][2], cloud->unit) - scene->z_offset;
        int64_t height = (above + scene->z_step / 2) / scene->z_step;
        if (height > scene->height_max)
            height = scene->height_max;
        uint16_t *cell = &scene->heights[(size_t)profile * scene->columns + column];
        if (*cell == CANOPY_SCENE_NONE || height > *cell)
            *cell = (uint16_t)height;
    }
}

static void widen(int32_t *low, int32_t *high, int64_t value) {
    if (value < *low)
        *low = (int32_t)value;
    if (value > *high)
        *high = (int32_t)value;
}

static void find_box(struct canopy_scene *scene, double margin) {
    const uint32_t room = (uint32_t)ceil(fmin(margin / scene->unit / scene->z_step, COUNTS));
    uint32_t lowest = COUNTS, highest = 0;
    for (int i = 0; i < 3; i++) {
        scene->low[i] = INT32_MAX;
        scene->high[i] = INT32_MIN;
    }
    scene->valid = 0;
    for (uint32_t p = 0; p < scene->profiles; p++) {
        for (uint32_t c = 0; c < scene->columns; c++) {
            const uint16_t height = scene->heights[(size_t)p * scene->columns + c];
            if (height == CANOPY_SCENE_NONE)
                continue;
            scene->valid++;
            widen(&scene->low[0], &scene->high[0], scene->start[0] + (int64_t)c * scene->step[0]);
            widen(&scene->low[1], &scene->high[1], scene->start[1] + (int64_t)p * scene->step[1]);
            lowest = height < lowest ? height : lowest;
            highest = height > highest ? height : highest;
        }
    }
    const uint32_t below = lowest < room ? 0 : lowest - room;
    const uint32_t above = highest + room > scene->height_max ? scene->height_max : highest + room;
    widen(&scene->low[2], &scene->high[2], scene->z_offset + (int64_t)below * scene->z_step);
    widen(&scene->low[2], &scene->high[2], scene->z_offset + (int64_t)above * scene->z_step);
}

static bool build(const char *path, const struct cloud *cloud, const struct canopy_scene_wish *wish,
                  struct canopy_scene *scene, struct canopy_fault *fault) {
    struct cut cuts[2];
    choose_cuts(cloud, wish, cuts);
    *scene = (struct canopy_scene){.unit = cloud->unit, .columns = cuts[0].count, .profiles = cuts[1].count};
    for (int i = 0; i < 2; i++) {
        scene->start[i] = cuts[i].start;
        scene->step[i] = cuts[i].step;
        if (cuts[i].start + (int64_t)(cuts[i].count - 1) * cuts[i].step > INT32_MAX)
            return canopy_fault_set(fault, "%s: %s leaves 32 bits at a unit of %g: choose a larger --unit", path,
                                    i == 0 ? "a column" : "a profile", cloud->unit);
    }
    if ((uint64_t)scene->columns * scene->profiles > READINGS_MOST)
        return canopy_fault_set(fault, "%u profiles of %u columns are too many: at most %u readings", scene->profiles,
                                scene->columns, READINGS_MOST);
    if (!choose_heights(path, cloud, wish->margin, scene, fault))
        return false;
    scene->heights = calloc((size_t)scene->columns * scene->profiles, sizeof *scene->heights);
    if (scene->heights == NULL)
        return canopy_fault_set(fault, "%s: no memory for %u x %u readings", path, scene->profiles, scene->columns);
    look_down(cloud, cuts, scene);
    find_box(scene, wish->margin);
    return true;
}

bool canopy_scene_load(const char *path, const struct canopy_scene_wish *wish, struct canopy_scene *scene,
                       struct canopy_fault *fault) {
    if (wish->columns > COLUMNS_WIDE)
        return canopy_fault_set(fault, "--columns %u: at most %u", wish->columns, COLUMNS_WIDE);
    if (wish->profiles > PROFILES_MOST)
        return canopy_fault_set(fault, "--profiles %u: at most %u", wish->profiles, PROFILES_MOST);
    if (wish->unit != 0 && !(wish->unit > 0 && isnormal((float)wish->unit)))
        return canopy_fault_set(fault, "--unit %g: give a positive number that fits a 32-bit float", wish->unit);
    struct cloud cloud = {.unit = wish->unit > 0 ? canopy_scene_shortest((float)wish->unit) : 0};
    struct canopy_points_info info;
    const bool done = canopy_points_read(path, (struct canopy_points_sink){&cloud, take}, &info, fault) &&
                      choose_unit(path, &cloud, fault) && build(path, &cloud, wish, scene, fault);
    free(cloud.points);
    return done;
}

void canopy_scene_free(struct canopy_scene *scene) {
    free(scene->heights);
    scene->heights = NULL;
}
