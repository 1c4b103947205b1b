/// The sub-commands of `canopy`: each takes its own argument vector (argv[0] is "canopy NAME") and returns the exit
/// status.
#ifndef CANOPY_TOOLS_CANOPY_COMMAND_H
#define CANOPY_TOOLS_CANOPY_COMMAND_H

#include "tools/common/fault.h"

enum {
    CANOPY_EXIT_OK = 0,
    CANOPY_EXIT_UNSAFE = 1,  ///< a point is on the wrong side or outside (check), surfaces cross (sandwich --check)
    CANOPY_EXIT_INPUT = 2,   ///< bad input: one line on standard error, no output file
    CANOPY_EXIT_USAGE = 64   ///< wrong usage (sysexits EX_USAGE, argp's own)
};

int canopy_command_fit(int argc, char **argv);
int canopy_command_sandwich(int argc, char **argv);
int canopy_command_check(int argc, char **argv);
int canopy_command_info(int argc, char **argv);
int canopy_command_eval(int argc, char **argv);
int canopy_command_trim(int argc, char **argv);
int canopy_command_window(int argc, char **argv);
int canopy_command_clearance(int argc, char **argv);
int canopy_command_volume(int argc, char **argv);
int canopy_command_diff(int argc, char **argv);
int canopy_command_ray(int argc, char **argv);
int canopy_command_regrid(int argc, char **argv);
int canopy_command_plot(int argc, char **argv);

/// Prints "canopy: text" on standard error and returns CANOPY_EXIT_INPUT.
int canopy_command_fail(const struct canopy_fault *fault);

#endif
