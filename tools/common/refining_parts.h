/// What the files of refining share. Nobody else includes this.
///
///     refining.c         what was asked for, where that is, and one window after the other
///     refining_points.c  windows from the points
///     refining_field.c   windows from a field
#ifndef CANOPY_TOOLS_COMMON_REFINING_PARTS_H
#define CANOPY_TOOLS_COMMON_REFINING_PARTS_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/cover/refine.h"
#include "tools/common/fault.h"
#include "tools/common/refining.h"
#include "tools/common/surrogate.h"

/// Windows in the library's own form, with memory of their own.
struct canopy_refining_windows {
    uint32_t count;
    struct canopy_refinement list[CANOPY_REFINEMENTS_MAX];
};

/// The grid a request is placed on: where its knots are, in input units.
struct canopy_refining_ground {
    struct canopy_frame frame;
    double origin[2];
    double pitch[2];
};

/// Where gaps and constraints come from: the points or the field.
struct canopy_refining_supply {
    void *context;
    bool (*gaps)(void *context, const struct canopy_refining_windows *windows, uint32_t *gaps,
                 struct canopy_fault *fault);
    /// Fits the last of the windows.
    bool (*fit)(void *context, struct canopy_refining_windows *windows, const struct canopy_refining_request *request,
                struct canopy_fault *fault);
};

/// The grid of a surrogate.
struct canopy_refining_ground canopy_refining_survey(const struct canopy_surrogate *surrogate);

/// Its coefficients in the library's orientation, which the caller frees; NULL after a fault.
int32_t *canopy_refining_coefficients(const struct canopy_surrogate *surrogate, struct canopy_fault *fault);

/// All that was asked for, coarse levels first. The windows need canopy_refining_free, also after false.
bool canopy_refining_add(const struct canopy_refining *refining, const struct canopy_refining_ground *ground,
                         const struct canopy_refining_supply *supply, struct canopy_refining_windows *windows,
                         struct canopy_fault *fault);
void canopy_refining_free(struct canopy_refining_windows *windows);

/// Begins a fit whose constraints are there, and goes as far as it goes. A window without data stays zero: CANOPY_OK.
enum canopy_status canopy_refining_run(struct canopy_refine *refine);

/// Whether a fit went well, or what is wrong with the request.
bool canopy_refining_conclude(enum canopy_status status, const struct canopy_refining_request *request,
                              struct canopy_fault *fault);

/// The last of the windows into the surrogate, of its side. False: no memory.
bool canopy_refining_store(const struct canopy_refining_windows *windows, struct canopy_surrogate *surrogate);

#endif
