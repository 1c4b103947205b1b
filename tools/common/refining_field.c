// Windows from a field, as a device fits them: certified for every cell.

#include <stdlib.h>

#include "lib/cover/certify.h"
#include "tools/common/fielding.h"
#include "tools/common/refining_parts.h"

struct from_field {
    struct canopy_surrogate *surrogate;
    struct canopy_fielding cells;
    const int32_t *b;  ///< in the library's orientation
    struct canopy_certify base;
    struct canopy_refine_certify certify;
    void *arena[2];
};

static bool gaps_of_field(void *context, const struct canopy_refining_windows *windows, uint32_t *gaps,
                          struct canopy_fault *fault) {
    struct from_field *from = context;
    (void)fault;
    canopy_refine_gaps(&from->cells.field, from->b, windows->list, windows->count, gaps);
    return true;
}

static bool fit_to_field(void *context, struct canopy_refining_windows *windows,
                         const struct canopy_refining_request *request, struct canopy_fault *fault) {
    struct from_field *from = context;
    const struct canopy_refinement *window = &windows->list[windows->count - 1];
    const size_t rows = CANOPY_REFINE_NODES(window->size[0], window->size[1], from->cells.field.axis[0].cells,
                                            from->cells.field.axis[1].cells, window->level);
    const size_t bytes = CANOPY_REFINE_ARENA(window->size[0], window->size[1], rows);
    void *arena = malloc(bytes);
    if (!arena) {
        return canopy_fault_no_memory(fault);
    }
    struct canopy_refine refine;
    enum canopy_status status = canopy_refine_init(&refine, &from->cells.field.frame, from->b, windows->list,
                                                   windows->count, rows, arena, bytes);
    if (status == CANOPY_OK) {
        status = canopy_refine_field(&refine, &from->certify);
    }
    if (status == CANOPY_OK) {
        status = canopy_refining_run(&refine);
    }
    free(arena);
    return canopy_refining_conclude(status, request, fault) &&
           (canopy_refining_store(windows, from->surrogate) || canopy_fault_no_memory(fault));
}

/// The base's own certificate, which is known to hold, and the windows'.
static bool certify_base(struct from_field *from, uint16_t cells, struct canopy_fault *fault) {
    const size_t base = CANOPY_CERTIFY_ARENA(from->cells.field.frame.size[1], cells, cells);
    const size_t windows = CANOPY_REFINE_CERTIFY_ARENA(cells, cells);
    from->arena[0] = malloc(base);
    from->arena[1] = malloc(windows);
    if (!from->arena[0] || !from->arena[1]) {
        return canopy_fault_no_memory(fault);
    }
    if (canopy_certify_init(&from->base, &from->cells.field, from->arena[0], base) != CANOPY_OK ||
        canopy_refine_certify_init(&from->certify, &from->cells.field, &from->base, from->arena[1], windows) !=
            CANOPY_OK) {
        return canopy_fault_set(fault, "--refine needs a field whose cells are whole quanta: leave --frame or --field "
                                       "out");
    }
    canopy_certify_begin(&from->base, from->b);
    return canopy_certify_step(&from->base, UINT32_MAX) == CANOPY_OK ||
           canopy_fault_set(fault, "the field's certificate failed: choose another --grid or --field");
}

/// The whole list once more, as it is published.
static bool certify_all(struct from_field *from, const struct canopy_refining_windows *windows,
                        struct canopy_fault *fault) {
    return (canopy_refine_certify_begin(&from->certify, from->b, windows->list, windows->count) == CANOPY_OK &&
            canopy_refine_certify_step(&from->certify, UINT32_MAX) == CANOPY_OK) ||
           canopy_fault_set(fault, "the windows' certificate failed: choose another --refine");
}

bool canopy_refining_field(const struct canopy_refining *refining, const struct canopy_turned *turned,
                           const struct canopy_frame *frame, uint16_t cells, bool packed,
                           struct canopy_surrogate *surrogate, struct canopy_fault *fault) {
    struct from_field from = {.surrogate = surrogate};
    struct canopy_refining_ground ground = canopy_refining_survey(surrogate);
    struct canopy_refining_windows windows = {0};
    const struct canopy_refining_supply supply = {&from, gaps_of_field, fit_to_field};
    bool ok = true;
    for (uint32_t k = 0; ok && k < refining->count; k++) {
        const uint32_t step = 1U << refining->requests[k].level;
        ok = cells % step == 0 || canopy_fault_set(fault, "--refine %.60s: give a --field that is a multiple of %u",
                                                   refining->requests[k].text, step);
    }
    int32_t *b = ok ? canopy_refining_coefficients(surrogate, fault) : NULL;
    from.b = b;
    ok = b && canopy_fielding_open(&from.cells, turned, frame, (const uint16_t[2]){cells, cells}, packed, fault) &&
         certify_base(&from, cells, fault) && canopy_refining_add(refining, &ground, &supply, &windows, fault) &&
         certify_all(&from, &windows, fault);
    canopy_refining_free(&windows);
    free(b);
    for (int k = 0; k < 2; k++) {
        free(from.arena[k]);
    }
    canopy_fielding_close(&from.cells);
    return ok;
}
