/// The options of a fit, the same for one side and for both: what to fit, and how.
#ifndef CANOPY_TOOLS_CANOPY_WISH_H
#define CANOPY_TOOLS_CANOPY_WISH_H

#include <argp.h>
#include <stdbool.h>

#include "tools/common/load.h"
#include "tools/common/surface.h"

/// What stands on the command line: pointers into it, NULL where nothing is told.
struct canopy_wish {
    const char *points;
    const char *grid;
    const char *unit;
    const char *dir;
    const char *plane;
    const char *field;
    bool packed;
    const char *frame;
    const char *memory;
    const char *threads;
    int scalar;  ///< -1: not told
    bool tight;
};

/// --grid, --method, --scalar, --unit, --dir, --plane, --field and --frame, and the point file: a child of a command's
/// own parser, which gives it a struct canopy_wish as child_inputs[0]. Whether points and grid are there, the command
/// says, and tells canopy_wish_end.
extern const struct argp canopy_wish_argp;

/// One of two words, or wrong usage: 0 or 1.
int canopy_wish_word(struct argp_state *state, const char *option, const char *text, const char *zero, const char *one);

/// At the end of the command line: points and a grid (its own or --frame's) must be there, and options that exclude
/// each other not.
void canopy_wish_end(const struct canopy_wish *wish, struct argp_state *state);

/// From words to a wish. `frame` receives the surrogate of --frame, whose memory the caller frees.
bool canopy_wish_read(const struct canopy_wish *words, struct canopy_surrogate *frame, struct canopy_surface_wish *wish,
                      struct canopy_fault *fault);

/// Loads the points for the wish, and gives it their unit; and where they are not held and the method would have to
/// look at them one by one, a field. loaded->supply needs canopy_supply_free after success.
bool canopy_wish_load(const struct canopy_wish *words, struct canopy_surface_wish *wish, struct canopy_loaded *loaded,
                      struct canopy_fault *fault);

/// Prints the line that says what came out; `output` is where it was written, or NULL.
void canopy_wish_report(const struct canopy_surface_wish *wish, const struct canopy_loaded *loaded,
                        const struct canopy_surface_report *report, const char *output);

#endif
