// canopy plot: a picture, drawn by matplotlib in a script of its own that is given checked data.

#include <argp.h>
#include <errno.h>
#include <limits.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tools/canopy/command.h"
#include "tools/canopy/operands.h"
#include "tools/common/output.h"
#include "tools/common/points.h"
#include "tools/common/surrogate.h"

#define PYTHON "/usr/bin/python3"
#define SCRIPT "plot_surrogate.py"

// Exit statuses of the script, which leaves the words to its caller.
enum { EXIT_UNWRITABLE = 3, EXIT_MISSING = 4 };

static const char DOC[] =
    "Draws a surrogate, with its points if they are given: the surface in space and one cross-section.\v"
    "The picture is a PNG. Points are in the formats of `canopy fit --help`. Drawing needs Debian's "
    "python3-matplotlib; the script is looked for beside the program, in ../share/canopy, and as tools/" SCRIPT
    " in the directories above the program.\n\n"
    "Exit status: 0 done, 2 bad input or no matplotlib, and no output file.";

static const struct argp_option OPTIONS[] = {{"output", 'o', "OUT.png", 0, "write the picture here (required)", 0},
                                             {0}};

struct arguments {
    struct canopy_operands operands;
    const char *output;
};

static error_t parse(int key, char *text, struct argp_state *state) {
    struct arguments *a = state->input;
    switch (key) {
    case 'o': a->output = text; return 0;
    case ARGP_KEY_ARG:
        canopy_operands_take(&a->operands, text, state, "give one surrogate and at most one point file");
        return 0;
    case ARGP_KEY_END:
        if (!a->operands.surrogate || !a->output) {
            argp_error(state, "give a surrogate and -o OUT.png");
        }
        return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

static bool try_script(char path[PATH_MAX], const char *directory, const char *below) {
    return snprintf(path, PATH_MAX, "%s/%s" SCRIPT, directory, below) < PATH_MAX && access(path, R_OK) == 0;
}

/// The script, looked for from where the program is: an installed one first, then the source tree it was built in.
static bool find_script(char path[PATH_MAX], struct canopy_fault *fault) {
    char directory[PATH_MAX];
    const ssize_t length = readlink("/proc/self/exe", directory, sizeof directory - 1);
    directory[length > 0 ? length : 0] = '\0';
    char *slash = strrchr(directory, '/');
    if (slash) {
        *slash = '\0';
        if (try_script(path, directory, "") || try_script(path, directory, "../share/canopy/")) {
            return true;
        }
    }
    for (; slash; slash = strrchr(directory, '/')) {
        *slash = '\0';
        if (try_script(path, directory, "tools/")) {
            return true;
        }
    }
    return try_script(path, ".", "tools/") ||
           canopy_fault_set(fault, "the script " SCRIPT
                                   " is not beside the program nor in tools/ above it: run canopy from its build tree");
}

/// A child that reads points on its standard input.
static FILE *start(const char *script, const char *surrogate, const char *output, const char *name, bool points,
                   pid_t *child) {
    int ends[2];
    if (pipe(ends) != 0) {
        return NULL;
    }
    *child = fork();
    if (*child == 0) {
        dup2(ends[0], STDIN_FILENO);
        close(ends[0]);
        close(ends[1]);
        execl(PYTHON, PYTHON, script, surrogate, output, name, points ? "points" : "", (char *)NULL);
        _exit(EXIT_MISSING);
    }
    close(ends[0]);
    if (*child < 0) {
        close(ends[1]);
        return NULL;
    }
    return fdopen(ends[1], "wb");
}

static bool send_point(void *context, const double point[3], uint64_t where, struct canopy_fault *fault) {
    (void)where;
    (void)fault;
    FILE *to = context;
    fwrite(point, sizeof(double), 3, to);  // a child that has died says so by its exit status
    return true;
}

/// Why a child that has ended has drawn nothing.
static bool explain(int status, const struct arguments *a, struct canopy_fault *fault) {
    switch (WIFEXITED(status) ? WEXITSTATUS(status) : -1) {
    case EXIT_UNWRITABLE:
        return canopy_fault_set(fault, "%s: cannot write: give -o a file in a directory that exists and has room",
                                a->output);
    case EXIT_MISSING: return canopy_fault_set(fault, PYTHON " has no matplotlib: install python3-matplotlib");
    default: return canopy_fault_set(fault, "%s: the picture could not be drawn", a->operands.surrogate);
    }
}

static bool draw(const struct arguments *a, const char *script, const char *to, struct canopy_fault *fault) {
    pid_t child = -1;
    FILE *pipe_end = start(script, a->operands.surrogate, to, a->operands.points ? a->operands.points : "",
                           a->operands.points != NULL, &child);
    if (!pipe_end) {
        return canopy_fault_set(fault, "cannot start " PYTHON ": %s: free some memory or processes", strerror(errno));
    }
    struct canopy_points_info info;
    const bool ok =
        !a->operands.points ||
        canopy_points_read(a->operands.points, (struct canopy_points_sink){pipe_end, send_point}, &info, fault);
    if (!ok) {
        kill(child, SIGTERM);
    }
    fclose(pipe_end);
    int status = 0;
    while (waitpid(child, &status, 0) < 0 && errno == EINTR) {}
    return ok && ((WIFEXITED(status) && WEXITSTATUS(status) == 0) || explain(status, a, fault));
}

int canopy_command_plot(int argc, char **argv) {
    struct arguments arguments = {{NULL, NULL}, NULL};
    const struct argp argp = {.options = OPTIONS, .parser = parse, .args_doc = "SURROGATE.json [POINTS]", .doc = DOC};
    argp_parse(&argp, argc, argv, 0, NULL, &arguments);
    struct canopy_fault fault;
    struct canopy_surrogate surrogate;
    if (!canopy_surrogate_read(arguments.operands.surrogate, &surrogate, &fault)) {
        return canopy_command_fail(&fault);
    }
    canopy_surrogate_free(&surrogate);  // it was read to check it; the script reads it again
    char script[PATH_MAX];
    struct canopy_output output;
    signal(SIGPIPE, SIG_IGN);
    if (!find_script(script, &fault) || !canopy_output_open(&output, arguments.output, &fault)) {
        return canopy_command_fail(&fault);
    }
    if (!draw(&arguments, script, output.temporary ? output.temporary : arguments.output, &fault)) {
        canopy_output_abandon(&output);
        return canopy_command_fail(&fault);
    }
    return canopy_output_commit(&output, &fault) ? CANOPY_EXIT_OK : canopy_command_fail(&fault);
}
