/// The surrogate file, read and written on a host: JSON through jansson, every number an IEEE double.
///
/// What it means (docs and `canopy fit --help`): for a device point p, q = axes (p - origin), u = q0 / pitch[0] in [0,
/// m-1], v = q1 / pitch[1] in [0, n-1], height q2. The surface is S(u,v) = sum b_ij N(u-i) N(v-j) with N the uniform
/// cubic B-spline centred on 0 and the outermost coefficients repeated once; a window of level k in {1, 2} adds sum
/// d_ij N(2^k u - i0 - i) N(2^k v - j0 - j), not repeated. The height of the surface is S * lsb.
#ifndef CANOPY_TOOLS_COMMON_SURROGATE_H
#define CANOPY_TOOLS_COMMON_SURROGATE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/cover/frame.h"
#include "tools/common/fault.h"

struct canopy_window {
    int level;             ///< 1 or 2
    int32_t first[2];      ///< knot of the first coefficient, in 2^-level knot intervals
    uint32_t size[2];      ///< rows and columns, at least 1
    double *coefficients;  ///< size[0] * size[1], row order
};

struct canopy_surrogate {
    enum canopy_side side;
    enum canopy_scalar scalar;
    double unit;           ///< input units a device unit, > 0
    double origin[3];      ///< device units
    double axes[3][3];     ///< rows; orthonormal within 1e-6, right-handed
    double pitch[2];       ///< device units a knot interval, > 0
    uint32_t size[2];      ///< m, n: at least 4
    double *coefficients;  ///< m * n, row (u) order
    double lsb;            ///< > 0
    size_t window_count;
    struct canopy_window *windows;
    uint8_t *trim;   ///< (m-1) * (n-1), 1 where the knot cell is covered; NULL if the file has none
    bool certified;  ///< the file has a certificate
    double margin;   ///< as the certificate states it: heights in device units
    double points;
};

#define CANOPY_SURROGATE_GRID_MAX 4096  ///< largest m and n this reader and the fits accept

/// Reads and validates. Unknown or missing keys, wrong types, sizes that do not match, numbers that are not finite,
/// axes that are no rotation: each is a fault that names the file and the key (or the line, where it is not JSON).
/// `*surrogate` needs canopy_surrogate_free after success only.
bool canopy_surrogate_read(const char *path, struct canopy_surrogate *surrogate, struct canopy_fault *fault);

/// Writes to `path` with 17 significant digits, whole or not at all (output.h).
bool canopy_surrogate_write(const char *path, const struct canopy_surrogate *surrogate, struct canopy_fault *fault);

/// Writes two that belong together: either both are there or neither.
bool canopy_surrogate_write_both(const char *const paths[2], const struct canopy_surrogate surrogates[2],
                                 struct canopy_fault *fault);

/// Frees what the surrogate points to.
void canopy_surrogate_free(struct canopy_surrogate *surrogate);

#endif
