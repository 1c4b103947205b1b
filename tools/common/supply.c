#include "tools/common/supply.h"

#include <stdlib.h>
#include <string.h>

struct canopy_supply canopy_supply_of(const struct canopy_device_list *list) {
    return (struct canopy_supply){.scalar = list->scalar, .threads = 1, .count = list->count, .list = *list};
}

void canopy_supply_free(struct canopy_supply *supply) { canopy_device_list_free(&supply->list); }

uint64_t canopy_supply_mark(const union canopy_device_point *points, size_t count) {
    uint64_t mark = count;
    for (size_t i = 0; i < count; i++) {
        uint32_t word[3];
        memcpy(word, &points[i], sizeof word);
        mark = (mark ^ (word[0] | (uint64_t)word[1] << 32)) * UINT64_C(0x9e3779b97f4a7c15);
        mark = ((mark >> 29) ^ mark ^ word[2]) * UINT64_C(0xbf58476d1ce4e5b9);
    }
    return mark;
}

// ---------------------------------------------------------------------------------------------------------------------
// A pass over a file: what stands in it becomes device points, and must be what it was

struct pass {
    const struct canopy_supply *supply;
    const struct canopy_flow *flow;
    uint64_t mark;
};

/// What stands before the result of the flow within.
struct part {
    _Alignas(16) uint64_t mark;
};

static void *inner(const struct canopy_batch *batch) { return (char *)batch->result + sizeof(struct part); }

static bool convert(void *context, unsigned thread, struct canopy_batch *batch, size_t *bad,
                    struct canopy_fault *fault) {
    const struct pass *pass = context;
    const struct canopy_supply *supply = pass->supply;
    struct part *part = batch->result;
    for (size_t i = 0; i < batch->count; i++) {
        if (!canopy_device_point(supply->scalar, supply->unit, batch->raw[i], &batch->points[i], fault)) {
            *bad = i;
            return false;
        }
    }
    part->mark = canopy_supply_mark(batch->points, batch->count);
    struct canopy_batch within = *batch;
    within.result = inner(batch);
    return !pass->flow->work || pass->flow->work(pass->flow->context, thread, &within, bad, fault);
}

static bool gather(void *context, struct canopy_batch *batch, struct canopy_fault *fault) {
    struct pass *pass = context;
    const struct part *part = batch->result;
    pass->mark = canopy_supply_join(pass->mark, part->mark);
    struct canopy_batch within = *batch;
    within.result = inner(batch);
    return !pass->flow->gather || pass->flow->gather(pass->flow->context, &within, fault);
}

bool canopy_supply_pass(const struct canopy_supply *supply, const struct canopy_flow *flow,
                        struct canopy_fault *fault) {
    struct canopy_flow own = *flow;
    own.threads = flow->threads > 0 && flow->threads < supply->threads ? flow->threads : supply->threads;
    if (canopy_supply_is_held(supply)) {
        return canopy_flow_memory(supply->list.points, supply->list.count, &own, fault);
    }
    struct pass pass = {supply, flow, 0};
    struct canopy_points_info info;
    own.context = &pass;
    own.work = convert;
    own.gather = gather;
    own.result_size += sizeof(struct part);
    if (!canopy_flow_file(supply->path, &own, &info, fault)) {
        return false;
    }
    if (supply->info) {
        *supply->info = info;
        return true;
    }
    return (info.count == supply->count && pass.mark == supply->mark) ||
           canopy_fault_set(fault,
                            "%s: changed while it was read: wait until it is complete, or copy it and name the copy",
                            strcmp(supply->path, "-") == 0 ? "standard input" : supply->path);
}

// ---------------------------------------------------------------------------------------------------------------------
// Into memory

static bool keep(void *context, struct canopy_batch *batch, struct canopy_fault *fault) {
    struct canopy_device_list *list = context;
    return canopy_device_list_append(list, batch->points, batch->count) || canopy_fault_no_memory(fault);
}

bool canopy_supply_hold(struct canopy_supply *supply, struct canopy_fault *fault) {
    struct canopy_device_list list = {.scalar = supply->scalar};
    const struct canopy_flow flow = {.stage = "reading", .context = &list, .gather = keep};
    if (!canopy_supply_is_held(supply)) {
        if (!canopy_supply_pass(supply, &flow, fault)) {
            canopy_device_list_free(&list);
            return false;
        }
        supply->list = list;
    }
    return true;
}

// ---------------------------------------------------------------------------------------------------------------------
// The exact verdict

#define TABLE_BYTES_MOST (256U << 20)  // of all threads' tables
#define CELL_BYTES 136U                // what exact.h says of a cell

struct check {
    const struct canopy_surrogate *surrogate;
    struct canopy_exact *exact[CANOPY_THREADS_MAX];
    uint8_t *covered[CANOPY_THREADS_MAX];  ///< by thread; NULL: not wanted
    struct canopy_exact_result *result;
};

static bool check_batch(void *context, unsigned thread, struct canopy_batch *batch, size_t *bad,
                        struct canopy_fault *fault) {
    struct check *check = context;
    (void)bad;
    (void)fault;
    const struct canopy_device_list list = {
        .scalar = check->surrogate->scalar, .count = batch->count, .points = batch->points};
    const struct canopy_cloud cloud = canopy_device_list_cloud(&list);
    struct canopy_exact_result *result = batch->result;
    *result = canopy_exact_begin();
    canopy_exact_add(check->exact[thread], &cloud, result);
    if (check->covered[thread]) {
        canopy_exact_coverage(check->exact[thread], &cloud, check->covered[thread]);
    }
    return true;
}

static bool gather_check(void *context, struct canopy_batch *batch, struct canopy_fault *fault) {
    struct check *check = context;
    (void)fault;
    canopy_exact_merge(check->result, batch->result);
    return true;
}

static bool open_check(struct check *check, unsigned threads, bool covered) {
    const size_t cells = (size_t)(check->surrogate->size[0] - 1) * (check->surrogate->size[1] - 1);
    for (unsigned i = 0; i < threads; i++) {
        check->exact[i] = canopy_exact_open(check->surrogate);
        check->covered[i] = covered ? calloc(cells, 1) : NULL;
        if (!check->exact[i] || (covered && !check->covered[i])) {
            return false;
        }
    }
    return true;
}

bool canopy_supply_check(const struct canopy_supply *supply, const struct canopy_surrogate *surrogate, uint8_t *covered,
                         struct canopy_exact_result *result, struct canopy_fault *fault) {
    const size_t cells = (size_t)(surrogate->size[0] - 1) * (surrogate->size[1] - 1);
    const size_t most = TABLE_BYTES_MOST / CELL_BYTES / cells;
    const unsigned threads = most < 1 ? 1 : most < supply->threads ? (unsigned)most : supply->threads;
    struct check check = {.surrogate = surrogate, .result = result};
    const struct canopy_flow flow = {.stage = "proving",
                                     .threads = threads,
                                     .result_size = sizeof *result,
                                     .context = &check,
                                     .work = check_batch,
                                     .gather = gather_check};
    *result = canopy_exact_begin();
    const bool ok = open_check(&check, threads, covered != NULL) ? canopy_supply_pass(supply, &flow, fault)
                                                                 : canopy_fault_no_memory(fault);
    for (unsigned i = 0; i < threads; i++) {
        for (size_t c = 0; covered && check.covered[i] && c < cells; c++) {
            covered[c] |= check.covered[i][c];
        }
        free(check.covered[i]);
        canopy_exact_close(check.exact[i]);
    }
    return ok;
}

bool canopy_supply_check_file(const char *path, const struct canopy_surrogate *surrogate, unsigned threads,
                              struct canopy_exact_result *result, struct canopy_points_info *info,
                              struct canopy_fault *fault) {
    const struct canopy_supply supply = {
        .scalar = surrogate->scalar, .threads = threads, .path = path, .unit = surrogate->unit, .info = info};
    return canopy_supply_check(&supply, surrogate, NULL, result, fault);
}
