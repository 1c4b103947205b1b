// Heights to verdicts: most at once, what the error bound leaves open one by one, and at the end in rational.c.

#include "tools/common/exact.h"

#include <math.h>

#include "tools/common/exact_parts.h"

struct canopy_exact_result canopy_exact_begin(void) {
    return (struct canopy_exact_result){.first_wrong = UINT64_MAX,
                                        .first_outside = UINT64_MAX,
                                        .margin = HUGE_VAL,
                                        .gap_max = -HUGE_VAL,
                                        .height_min = HUGE_VAL,
                                        .height_max = -HUGE_VAL};
}

static uint64_t first_of(uint64_t have, uint64_t before, uint64_t index) {
    return have != UINT64_MAX || index == UINT64_MAX ? have : before + index;
}

void canopy_exact_merge(struct canopy_exact_result *result, const struct canopy_exact_result *part) {
    result->first_wrong = first_of(result->first_wrong, result->points, part->first_wrong);
    result->first_outside = first_of(result->first_outside, result->points, part->first_outside);
    result->points += part->points;
    result->wrong += part->wrong;
    result->outside += part->outside;
    result->decided_by_gmp += part->decided_by_gmp;
    result->margin = fmin(result->margin, part->margin);
    result->gap_sum += part->gap_sum;
    result->gap_max = fmax(result->gap_max, part->gap_max);
    result->height_min = fmin(result->height_min, part->height_min);
    result->height_max = fmax(result->height_max, part->height_max);
}

// ---------------------------------------------------------------------------------------------------------------------
// The verdict on a block

/// A tie on a flat cell whose numbers are exact in double: whole scenes can be of this kind, so GMP is spared.
static bool decide_flat(const struct canopy_exact *e, const struct canopy_exact_block *b, size_t p,
                        const double point[3], double *margin) {
    if (!e->aligned || e->surrogate->window_count > 0 || !e->ordinary) {
        return false;
    }
    const struct canopy_surrogate *s = e->surrogate;
    const int m = (int)s->size[0];
    const int n = (int)s->size[1];
    const double first = s->coefficients[(size_t)b->hu[p] * (size_t)n + (size_t)b->hv[p]];
    for (int i = b->hu[p] - 1; i <= b->hu[p] + 2; i++) {
        for (int j = b->hv[p] - 1; j <= b->hv[p] + 2; j++) {
            if (s->coefficients[(size_t)canopy_exact_clamp(i, m) * (size_t)n + (size_t)canopy_exact_clamp(j, n)] !=
                first) {
                return false;
            }
        }
    }
    const int k = e->coordinate[2];
    const double height = first * s->lsb;
    if (!canopy_exact_subtracts(point[k], s->origin[k]) || fma(first, s->lsb, -height) != 0.0) {
        return false;
    }
    *margin = (s->side == CANOPY_ABOVE ? height : -height) - b->q[2][p];
    if (*margin != 0.0) {
        *margin = nextafter(*margin, -HUGE_VAL);
    }
    return true;
}

/// A point whose margin the slack leaves open, or that is wrong; or any, where the bound does not hold.
static void decide(const struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first, uint64_t before,
                   const struct canopy_exact_block *b, size_t p, struct canopy_exact_result *result) {
    const double margin = b->surface[p] - b->q[2][p];
    const size_t index = first + b->origin[p];
    double floor = margin - b->slack[p];
    bool wrong = true;
    if (!(e->ordinary && margin + b->slack[p] < 0.0)) {
        double point[3];
        canopy_exact_point(cloud, index, point);
        if (!decide_flat(e, b, p, point, &floor)) {
            result->decided_by_gmp++;
            wrong = canopy_rational_margin(e->rational, point, &floor) < 0;
        } else {
            wrong = floor < 0.0;
        }
    }
    result->wrong += wrong;
    if (wrong && result->first_wrong == UINT64_MAX) {
        result->first_wrong = before + index;
    }
    result->margin = fmin(result->margin, floor);
}

/// Margins, gaps and heights of the block.
static void judge(const struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first, uint64_t before,
                  const struct canopy_exact_block *b, struct canopy_exact_result *result) {
    double sum = 0.0;
    double lowest = HUGE_VAL;
    double most = result->gap_max;
    double height_min = HUGE_VAL;
    double height_max = -HUGE_VAL;
    for (size_t p = 0; p < b->count; p++) {
        const double w = b->q[2][p];
        const double margin = b->surface[p] - w;
        const double floor = margin - b->slack[p];
        sum += margin;
        most = most > margin ? most : margin;
        lowest = lowest < floor ? lowest : floor;
        height_min = height_min < w ? height_min : w;
        height_max = height_max > w ? height_max : w;
    }
    result->gap_sum += sum;
    result->gap_max = most;
    const bool above = e->surrogate->side == CANOPY_ABOVE;
    result->height_min = fmin(result->height_min, above ? height_min : -height_max);
    result->height_max = fmax(result->height_max, above ? height_max : -height_min);
    if (e->ordinary && lowest >= 0.0) {
        result->margin = fmin(result->margin, lowest);
        return;
    }
    for (size_t p = 0; p < b->count; p++) {
        const double floor = b->surface[p] - b->q[2][p] - b->slack[p];
        if (e->ordinary && floor >= 0.0) {
            result->margin = fmin(result->margin, floor);
        } else {
            decide(e, cloud, first, before, b, p, result);
        }
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// What else is wanted of a block

/// Heights of the block's points that are inside; the others keep what is there.
static void write_heights(const struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first,
                          const struct canopy_exact_block *b, double *heights) {
    const struct canopy_surrogate *s = e->surrogate;
    for (size_t p = 0; p < b->count; p++) {
        const double height = s->side == CANOPY_ABOVE ? b->surface[p] : -b->surface[p];
        int cell[2] = {b->hu[p], b->hv[p]};
        const double off = fmin(fmin(b->s[p], 1.0 - b->s[p]), fmin(b->t[p], 1.0 - b->t[p]));
        if (s->trim && off < 1e-9) {
            double point[3];
            canopy_exact_point(cloud, first + b->origin[p], point);
            canopy_rational_inside(e->rational, point, cell);
        }
        if (!s->trim || s->trim[(size_t)cell[0] * (s->size[1] - 1) + (size_t)cell[1]]) {
            heights[b->origin[p]] = height;
        }
    }
}

/// Marks the cells of the block's points, and those across an edge that is very close.
static void mark_cells(const struct canopy_exact *e, const struct canopy_exact_block *b, uint8_t *covered) {
    const int rows = (int)e->surrogate->size[0] - 1;
    const int columns = (int)e->surrogate->size[1] - 1;
    for (size_t p = 0; p < b->count; p++) {
        const int u0 = canopy_exact_clamp(b->hu[p] - (b->s[p] < 1e-9), rows);
        const int u1 = canopy_exact_clamp(b->hu[p] + (b->s[p] > 1.0 - 1e-9), rows);
        const int v0 = canopy_exact_clamp(b->hv[p] - (b->t[p] < 1e-9), columns);
        const int v1 = canopy_exact_clamp(b->hv[p] + (b->t[p] > 1.0 - 1e-9), columns);
        for (int u = u0; u <= u1; u++) {
            for (int v = v0; v <= v1; v++) {
                covered[(size_t)u * (size_t)columns + (size_t)v] = 1;
            }
        }
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// A cloud in blocks

/// What is wanted of a block: heights if `heights` is set, cells if `covered` is, else a verdict.
struct purpose {
    struct canopy_exact_result *result;
    double *heights;
    uint8_t *covered;
};

/// A whole block of memory, of which the first `count` points are meant.
static void add_block(struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first, size_t count,
                      uint64_t before, const struct purpose *purpose) {
    struct canopy_exact_block b;
    b.count = count;
    canopy_exact_load(e, cloud, first, &b);
    canopy_exact_keep_inside(e, cloud, first, before, &b, purpose->result);
    if (purpose->covered) {
        mark_cells(e, &b, purpose->covered);
        return;
    }
    canopy_exact_evaluate(e, &b);
    if (purpose->heights) {
        write_heights(e, cloud, first, &b, purpose->heights + before + first);
    } else if (b.count > 0) {
        if (!e->aligned) {
            canopy_exact_add_turned_slack(e, &b);
        }
        judge(e, cloud, first, before, &b, purpose->result);
    }
}

/// The last points, filled up with copies to a whole block.
static void add_rest(struct canopy_exact *e, const struct canopy_cloud *cloud, size_t first, uint64_t before,
                     const struct purpose *purpose) {
    union {
        float f32[3][CANOPY_EXACT_BLOCK];
        int32_t fx[3][CANOPY_EXACT_BLOCK];
    } copy;
    const size_t count = cloud->count - first;
    for (int k = 0; k < 3; k++) {
        for (size_t p = 0; p < CANOPY_EXACT_BLOCK; p++) {
            const size_t at = (first + (p < count ? p : count - 1)) * cloud->stride;
            if (cloud->scalar == CANOPY_F32) {
                copy.f32[k][p] = ((const float *)cloud->axis[k])[at];
            } else {
                copy.fx[k][p] = ((const int32_t *)cloud->axis[k])[at];
            }
        }
    }
    const struct canopy_cloud rest = {
        .scalar = cloud->scalar, .count = count, .stride = 1, .axis = {copy.fx[0], copy.fx[1], copy.fx[2]}};
    add_block(e, &rest, 0, count, before + first, purpose);
}

static void add(struct canopy_exact *e, const struct canopy_cloud *cloud, const struct purpose *purpose) {
    const uint64_t before = purpose->result->points;
    size_t first = 0;
    for (; first + CANOPY_EXACT_BLOCK <= cloud->count; first += CANOPY_EXACT_BLOCK) {
        add_block(e, cloud, first, CANOPY_EXACT_BLOCK, before, purpose);
    }
    if (first < cloud->count) {
        add_rest(e, cloud, first, before, purpose);
    }
    purpose->result->points += cloud->count;
}

void canopy_exact_add(struct canopy_exact *exact, const struct canopy_cloud *cloud,
                      struct canopy_exact_result *result) {
    add(exact, cloud, &(struct purpose){.result = result});
}

void canopy_exact_heights(struct canopy_exact *exact, const struct canopy_cloud *cloud, double *heights) {
    for (size_t i = 0; i < cloud->count; i++) {
        heights[i] = nan("");
    }
    struct canopy_exact_result unused = canopy_exact_begin();
    add(exact, cloud, &(struct purpose){.result = &unused, .heights = heights});
}

void canopy_exact_coverage(struct canopy_exact *exact, const struct canopy_cloud *cloud, uint8_t *covered) {
    struct canopy_exact_result unused = canopy_exact_begin();
    add(exact, cloud, &(struct purpose){.result = &unused, .covered = covered});
}

bool canopy_exact_check(const struct canopy_surrogate *surrogate, const struct canopy_cloud *cloud,
                        struct canopy_exact_result *result) {
    struct canopy_exact *exact = canopy_exact_open(surrogate);
    if (!exact) {
        return false;
    }
    *result = canopy_exact_begin();
    canopy_exact_add(exact, cloud, result);
    canopy_exact_close(exact);
    return true;
}

static double height_range(const struct canopy_exact_result *result) {
    const double range = result->height_max - result->height_min;
    return range > 0.0 ? range : 1.0;
}

const char *canopy_exact_gap_base(const struct canopy_exact_result *result) {
    return result->height_max > result->height_min ? "the height range"
                                                   : "one device unit (all points are at one height)";
}

double canopy_exact_mean_gap(const struct canopy_exact_result *result) {
    const uint64_t inside = result->points - result->outside;
    return inside ? 100.0 * result->gap_sum / (double)inside / height_range(result) : 0.0;
}

double canopy_exact_max_gap(const struct canopy_exact_result *result) {
    return result->points > result->outside ? 100.0 * result->gap_max / height_range(result) : 0.0;
}
