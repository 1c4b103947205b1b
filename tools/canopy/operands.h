/// What stands on the command line of a sub-command that looks at a surrogate: its file, and a file of points.
#ifndef CANOPY_TOOLS_CANOPY_OPERANDS_H
#define CANOPY_TOOLS_CANOPY_OPERANDS_H

#include <argp.h>

/// The formats of a point file, for help texts.
#define CANOPY_OPERANDS_POINTS                                                                                         \
    "POINTS is .xyz or .csv (three numbers a line, separated by blanks, comma, semicolon or tab; more are ignored; # " \
    "begins a comment), .ply or .pcd (ASCII or binary), .las, or - for standard input, where the first bytes tell "    \
    "the format. docs/files.md says more.\n\n"

struct canopy_operands {
    const char *surrogate;
    const char *points;
};

/// Takes one more. A third is wrong usage, in the words of `too_many`.
void canopy_operands_take(struct canopy_operands *operands, char *text, struct argp_state *state, const char *too_many);

/// Reads a command line that has both and nothing else; `doc` is argp's. Wrong usage ends the program.
struct canopy_operands canopy_operands_both(int argc, char **argv, const char *doc);

#endif
