/// Surrogates as lib/cover/query takes them, and its answers back in input units.
///
/// The library asks whole steps. Where the coefficients of a file are not whole (or two files count in different
/// steps), the surface is held between two envelopes, one rounded down and one rounded up; answers take the one that
/// keeps them guaranteed. Windows of a question are whole 2^-20 of a knot interval. What is printed is computed in
/// rational numbers and rounded outward once.
#ifndef CANOPY_TOOLS_CANOPY_QUERIED_H
#define CANOPY_TOOLS_CANOPY_QUERIED_H

#include <argp.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/cover/query.h"
#include "lib/cover/query_extreme.h"
#include "lib/cover/query_volume.h"
#include "tools/common/fault.h"
#include "tools/common/surrogate.h"

#define CANOPY_QUERIED_PITCH (1U << 20)  ///< quanta a knot interval of a question

struct canopy_queried {
    const char *path;
    struct canopy_surrogate surrogate;
    struct canopy_envelope low, high;  ///< the surface is nowhere below `low` or above `high`
    int32_t apart;                     ///< steps between them at most; 0: they are the same
    unsigned level;                    ///< the envelopes' pitch is 2^-level of the surrogate's
};

/// Reads a surrogate. Memory as the file, and 8 bytes a coefficient. Needs canopy_queried_free after success and after
/// failure.
bool canopy_queried_read_refined(const char *path, struct canopy_queried *queried, struct canopy_fault *fault);

/// The same for questions about one grid: refinement windows are a fault.
bool canopy_queried_read(const char *path, struct canopy_queried *queried, struct canopy_fault *fault);
void canopy_queried_free(struct canopy_queried *queried);

/// Whether both have one unit and frame; the fault names both files and the first thing that differs.
bool canopy_queried_match(const struct canopy_queried *a, const struct canopy_queried *b, struct canopy_fault *fault);

/// Makes the envelopes of all, on one grid and with one step, which is returned: the finest of their own, times the
/// power of two for which the largest coefficient, or `reach` (device units) if that is larger, has 27 bits. The grid
/// is as fine as the finest refinement window of any (flat.h). 0 if there is no memory for that, never without windows.
double canopy_queried_scale(struct canopy_queried *const queried[], size_t count, double reach);

// ---- What the commands have in common on their command line

struct canopy_queried_options {
    const char *window;
    const char *name;  ///< of the option that gives the window, for faults; NULL: window
    const char *budget;
    bool covered;
};

/// --window and --covered, and with --budget: their input is a struct canopy_queried_options.
extern const struct argp canopy_queried_window_argp;
extern const struct argp canopy_queried_argp;

/// What every help text says of windows and of what is printed.
#define CANOPY_QUERIED_DOC                                                                                             \
    "Numbers are in input units. U and V are coordinates along the surrogate's first and second axis and heights "     \
    "along its third, all from the zero of the input: with axes along x, y, z they are x, y and z. A surrogate with "  \
    "refinement windows is asked as one fine grid, of which the outermost knot intervals are known less closely. "

/// The window in the frame of `queried`, widened to whole 2^-20 of a knot interval; without --window the whole frame.
bool canopy_queried_window(const struct canopy_queried *queried, const struct canopy_queried_options *options,
                           struct canopy_query_rect *rect, struct canopy_fault *fault);

/// A place of the frame as U and V.
void canopy_queried_place(const struct canopy_queried *queried, const uint32_t at[2], double place[2]);

/// steps * step in input units, rounded down or up; with `from_zero` as a height from the zero of the input.
double canopy_queried_height(const struct canopy_queried *queried, int64_t steps, double step, bool from_zero,
                             bool upward);

/// The extremes of surface - minus - plane. `slack`: steps by which the subject itself may be off, either way.
struct canopy_queried_question {
    const struct canopy_queried *surface, *minus;
    const struct canopy_query_plane *plane;
    double step;
    int32_t slack;
};

/// Makes the envelopes of a surface in a step that is good for the plane of height A U + B V + C too, in input units,
/// and both part of the question, whose step is 0 if there is no memory. False: the plane is too far away for any.
bool canopy_queried_scale_plane(struct canopy_queried *surface, const double abc[3],
                                struct canopy_queried_question *question, struct canopy_query_plane *plane);

/// For the envelopes that could not be made. Always returns false.
bool canopy_queried_no_memory(const struct canopy_queried *queried, struct canopy_fault *fault);

/// Finds and prints the highest or the lowest, one line: NAME BOUND attained VALUE at U V.
bool canopy_queried_print(const struct canopy_queried_question *question, const struct canopy_queried_options *options,
                          enum canopy_extreme_kind kind, const char *name, struct canopy_fault *fault);

/// A volume, and the area that it stands on, in input units: between low and high.
struct canopy_queried_volume {
    double low, high, area;
    uint32_t cells;
};

/// The volume of surface - minus over the window, less `height` (an input height along the third axis, from the zero of
/// the input; with `minus` 0) times its area.
bool canopy_queried_find_volume(const struct canopy_queried *surface, const struct canopy_queried *minus, double step,
                                double height, const struct canopy_query_rect *rect, bool covered,
                                struct canopy_queried_volume *volume, struct canopy_fault *fault);

#endif
