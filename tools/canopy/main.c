// canopy: fits, checks, evaluates and draws safe surrogates.

#include <argp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lib/version.h"
#include "tools/canopy/command.h"
#include "tools/common/progress.h"

static const struct {
    const char *name;
    int (*run)(int argc, char **argv);
    const char *what;
} COMMANDS[] = {
    {"fit", canopy_command_fit, "fit one safe surrogate to points"},
    {"sandwich", canopy_command_sandwich, "fit a surface above and one below that never cross; do two files cross?"},
    {"check", canopy_command_check, "is every point on the safe side? exact; exit status 0 or 1"},
    {"info", canopy_command_info, "what a surrogate file holds: grid, frame, heights, windows, certificate"},
    {"eval", canopy_command_eval, "the height of the surface over each point"},
    {"trim", canopy_command_trim, "the outline of what a surface covers, as numbers or a drawing"},
    {"window", canopy_command_window, "the guaranteed highest and lowest of the surface over a window"},
    {"clearance", canopy_command_clearance, "the guaranteed distance between two surfaces, or to a plane"},
    {"ray", canopy_command_ray, "where rays first hit the surface; which segments are surely free"},
    {"volume", canopy_command_volume, "the volume between a surface and a height, or another surface"},
    {"diff", canopy_command_diff, "what changed between two surfaces: rise, fall, coverage"},
    {"regrid", canopy_command_regrid, "the same surface on a finer or coarser grid, on the safe side"},
    {"plot", canopy_command_plot, "a picture: surface and points, map of the gap, cross-section; also of two surfaces"},
};

#define COMMAND_COUNT (sizeof COMMANDS / sizeof COMMANDS[0])

static void print_help(FILE *to) {
    fprintf(to, "Usage: canopy COMMAND ...\n"
                "Smooth surfaces proved to lie on one side of everything scanned.\n\n");
    for (size_t i = 0; i < COMMAND_COUNT; i++) {
        fprintf(to, "  %-9s %s\n", COMMANDS[i].name, COMMANDS[i].what);
    }
    fprintf(to,
            "\n`canopy COMMAND --help` is the manual of a command. Exit status: 0 done, 1 not safe (check) or\n"
            "crossing (sandwich --check), 2 bad input (one line on standard error says where and what to do),\n"
            "64 wrong usage.\n"
            "What a file holds and what an option is given as numbers is input: wrong numbers are status 2. Unknown\n"
            "options, words that an option does not have, and what is missing are wrong usage.\n");
}

int canopy_command_fail(const struct canopy_fault *fault) {
    canopy_progress_end();
    fflush(stdout);
    fprintf(stderr, "canopy: %s\n", fault->text);
    return CANOPY_EXIT_INPUT;
}

/// Results that did not reach the reader of standard output are a failure too.
static int finish(int status) {
    if (fflush(stdout) != 0 || ferror(stdout)) {
        fprintf(stderr, "canopy: standard output: cannot be written: give it room, or read it to the end\n");
        return CANOPY_EXIT_INPUT;
    }
    return status;
}

static bool is_help(const char *word) {
    return strcmp(word, "--help") == 0 || strcmp(word, "-h") == 0 || strcmp(word, "-?") == 0;
}

static char HELP[] = "--help";

int main(int argc, char **argv) {
    argp_err_exit_status = CANOPY_EXIT_USAGE;
    if (argc >= 3 && strcmp(argv[1], "help") == 0) {
        argv[1] = argv[2];
        argv[2] = HELP;
    }
    if (argc >= 2 && (is_help(argv[1]) || strcmp(argv[1], "help") == 0)) {
        print_help(stdout);
        return finish(CANOPY_EXIT_OK);
    }
    if (argc >= 2 && (strcmp(argv[1], "--version") == 0 || strcmp(argv[1], "-V") == 0)) {
        puts("canopy " CANOPY_VERSION);
        return finish(CANOPY_EXIT_OK);
    }
    for (size_t i = 0; argc >= 2 && i < COMMAND_COUNT; i++) {
        if (strcmp(argv[1], COMMANDS[i].name) == 0) {
            static char name[32];
            snprintf(name, sizeof name, "canopy %s", COMMANDS[i].name);
            argv[1] = name;
            if (argc >= 3 && is_help(argv[2])) {
                argv[2] = HELP;  // argp knows no -h
            }
            return finish(COMMANDS[i].run(argc - 1, argv + 1));
        }
    }
    if (argc >= 2) {
        fprintf(stderr, "canopy: '%s' is not a command; try `canopy --help`\n", argv[1]);
    } else {
        print_help(stderr);
    }
    return CANOPY_EXIT_USAGE;
}
