/// What the free coefficients of a surrogate are set to (lib/cover/free.h): those that no covered knot cell can see.
#ifndef CANOPY_TOOLS_COMMON_FILLING_H
#define CANOPY_TOOLS_COMMON_FILLING_H

#include <stdbool.h>

#include "tools/common/fault.h"
#include "tools/common/surrogate.h"

enum canopy_filling {
    CANOPY_FILLING_OWN = 0,  ///< as the method has left them: fast straight, tight bent
    CANOPY_FILLING_NEAREST,
    CANOPY_FILLING_STRAIGHT,
    CANOPY_FILLING_BENT
};

/// The rule of that name: nearest, straight or bent; CANOPY_FILLING_OWN if there is none.
enum canopy_filling canopy_filling_named(const char *name);

/// Sets the free coefficients of a surrogate whose coefficients are whole and whose trim says what is covered. The
/// surface over covered cells, and so its certificate, does not change.
bool canopy_filling_apply(struct canopy_surrogate *surrogate, enum canopy_filling rule, struct canopy_fault *fault);

#endif
