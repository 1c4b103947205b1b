// canopy plot: a picture, drawn by matplotlib in a script of its own that is given checked data.

#include <argp.h>
#include <errno.h>
#include <inttypes.h>
#include <limits.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/wait.h>
#include <unistd.h>

#include "tools/canopy/command.h"
#include "tools/common/option.h"
#include "tools/common/output.h"
#include "tools/common/points.h"
#include "tools/common/surrogate.h"

#define PYTHON "/usr/bin/python3"
#define SCRIPT "plot_surrogate.py"
#define PIXELS_LEAST 200
#define PIXELS_MOST 10000

// Exit statuses of the script, which leaves the words to its caller.
enum { EXIT_UNWRITABLE = 3, EXIT_MISSING = 4 };

static const char DOC[] =
    "Draws a surrogate, with its points if they are given: the surface in space, a map of its gap, and a cross-section "
    "through the worst place. With two surrogates of one frame, both.\v"
    "OUT ends in .png, .svg or .pdf. POINTS are in the formats of `canopy fit --help`; a second operand that ends in "
    ".json is a surrogate:\n\n"
    "  canopy plot lid.json scan.xyz -o lid.png\n"
    "  canopy plot part.above.json part.below.json scan.xyz -o part.png\n"
    "  canopy plot before.json after.json -o change.svg\n\n"
    "One above and one below are a sandwich: the map shows its thickness. Two of one side are compared: the map shows "
    "how far the second is above the first, or with points the gap of each on one scale. Without points the map of a "
    "single surface shows its height.\n\n"
    "The gap is the distance from a point to the surface along the frame's third axis; the map shows its mean in each "
    "tile, in input units and in per cent of the points' height range. On every map: the outline of what is covered "
    "by data (nothing is claimed elsewhere), refinement windows (dashed), the line of the cross-section (A to B) and "
    "the largest gap (a cross). The cross-section runs through that place along the longer side of the frame, or "
    "where --at says; its points are those near the line. Axes are those of the frame: x, y, z, or with `canopy fit "
    "--dir` u, v and height with their directions; all lengths are input units.\n\n"
    "The numbers in the title count every point. Of large clouds a part is drawn, and the picture says so. Drawing "
    "needs Debian's python3-matplotlib; the script is looked for beside the program, in ../share/canopy, and as "
    "tools/" SCRIPT " in the directories above the program.\n\n"
    "Exit status: 0 done; 2 bad input or no matplotlib, with one line that says where and what to do, and no output "
    "file; 64 wrong usage.";

enum { AT = 256, SHOW, SIZE };

static const struct argp_option OPTIONS[] = {
    {"output", 'o', "OUT", 0, "write the picture here: .png, .svg or .pdf (required)", 0},
    {"at", AT, "WHERE", 0,
     "the cross-section: u=NUMBER or v=NUMBER (x= and y= are the same), where the frame's first or second axis has "
     "that value; or U0,V0,U1,V1, from one point to another; in input units",
     0},
    {"show", SHOW, "surface|gap|section|trim|all", 0,
     "one panel alone, or the first three (default). trim: the knot cells that hold data and their outline", 0},
    {"size", SIZE, "WxH", 0, "width and height in pixels (.svg, .pdf: 100 to an inch), 200 to 10000", 0},
    {0}};

static const char *const SHOWN[] = {"all", "surface", "gap", "section", "trim"};
static const char *const FORMATS[] = {"png", "svg", "pdf"};

struct arguments {
    const char *surrogates[2];  ///< the second may be NULL
    const char *points;         ///< or NULL
    const char *output;
    const char *format;  ///< of the output, by its name
    const char *at;      ///< as it was given, or NULL
    const char *show;
    const char *size;  ///< as it was given, or NULL
};

static const char *one_of(const char *const *words, size_t count, const char *text) {
    for (size_t i = 0; i < count; i++) {
        if (strcasecmp(words[i], text) == 0) {
            return words[i];
        }
    }
    return NULL;
}

static bool ends_in(const char *text, const char *suffix) {
    const size_t length = strlen(text), tail = strlen(suffix);
    return length >= tail && strcasecmp(text + length - tail, suffix) == 0;
}

/// The first operand is a surrogate; of those behind it, a second one by its name, and points.
static void take(struct arguments *a, const char *text, struct argp_state *state) {
    if (!a->surrogates[0]) {
        a->surrogates[0] = text;
    } else if (!a->surrogates[1] && !a->points && ends_in(text, ".json")) {
        a->surrogates[1] = text;
    } else if (!a->points) {
        a->points = text;
    } else {
        argp_error(state, "give one surrogate or two, and at most one point file behind them");
    }
}

static error_t parse(int key, char *text, struct argp_state *state) {
    struct arguments *a = state->input;
    switch (key) {
    case 'o': a->output = text; return 0;
    case AT: a->at = text; return 0;
    case SIZE: a->size = text; return 0;
    case SHOW:
        a->show = one_of(SHOWN, sizeof SHOWN / sizeof SHOWN[0], text);
        if (!a->show) {
            argp_error(state, "--show is surface, gap, section, trim or all, not '%s'", text);
        }
        return 0;
    case ARGP_KEY_ARG: take(a, text, state); return 0;
    case ARGP_KEY_END:
        if (!a->surrogates[0] || !a->output) {
            argp_error(state, "give a surrogate and -o OUT.png");
        }
        return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// What is asked for, checked against the surrogate

/// A place along an axis, input units from the zero of the input, in knots. What is a hair outside the frame, as a
/// number read off a printed one is, counts as its edge.
static bool knot_of(const struct canopy_surrogate *s, int axis, double place, const char *text, double *knot,
                    struct canopy_fault *fault) {
    const double *a = s->axes[axis];
    const double zero = (a[0] * s->origin[0] + a[1] * s->origin[1] + a[2] * s->origin[2]) * s->unit;
    const double pitch = s->pitch[axis] * s->unit, end = s->size[axis] - 1.0;
    const double k = (place - zero) / pitch;
    if (!(k >= -1e-3 * end && k <= end * (1.0 + 1e-3))) {
        return canopy_fault_set(fault, "--at %.60s: outside the frame, whose %s axis goes from %.9g to %.9g", text,
                                axis == 0 ? "first" : "second", zero, zero + end * pitch);
    }
    *knot = fmin(fmax(k, 0.0), end);
    return true;
}

static bool blame_at(const char *text, struct canopy_fault *fault) {
    return canopy_fault_set(fault,
                            "--at %.60s: give u=NUMBER, v=NUMBER, or U0,V0,U1,V1 for two different points, in input "
                            "units along the frame's first and second axis",
                            text);
}

/// The ends of the cross-section, u and v of each, in knots.
static bool read_at(const char *text, const struct canopy_surrogate *s, double line[4], struct canopy_fault *fault) {
    double places[4];
    const bool first = text[0] == 'u' || text[0] == 'x', second = text[0] == 'v' || text[0] == 'y';
    if ((first || second) && text[1] == '=') {
        const int axis = first ? 0 : 1;
        if (!canopy_option_numbers(text + 2, 1, places)) {
            return blame_at(text, fault);
        }
        line[1 - axis] = 0.0;
        line[3 - axis] = s->size[1 - axis] - 1.0;
        if (!knot_of(s, axis, places[0], text, &line[axis], fault)) {
            return false;
        }
        line[2 + axis] = line[axis];
        return true;
    }
    if (!canopy_option_numbers(text, 4, places)) {
        return blame_at(text, fault);
    }
    for (int i = 0; i < 4; i++) {
        if (!knot_of(s, i % 2, places[i], text, &line[i], fault)) {
            return false;
        }
    }
    return hypot(line[2] - line[0], line[3] - line[1]) > 1e-6 || blame_at(text, fault);
}

static bool read_output(struct arguments *a, struct canopy_fault *fault) {
    const char *dot = strrchr(a->output, '.');
    a->format = dot ? one_of(FORMATS, sizeof FORMATS / sizeof FORMATS[0], dot + 1) : NULL;
    return a->format ||
           canopy_fault_set(fault, "%s: not a kind of picture: give -o a name that ends in .png, .svg or .pdf",
                            a->output);
}

static bool same_frame(const struct arguments *a, const struct canopy_surrogate *s, const struct canopy_surrogate *t,
                       struct canopy_fault *fault) {
    return (s->unit == t->unit && memcmp(s->size, t->size, sizeof s->size) == 0 &&
            memcmp(s->pitch, t->pitch, sizeof s->pitch) == 0 && memcmp(s->axes, t->axes, sizeof s->axes) == 0 &&
            memcmp(s->origin, t->origin, sizeof s->origin) == 0) ||
           canopy_fault_set(fault,
                            "%s and %s: two surrogates are drawn together if they have one frame: fit one with --frame "
                            "of the other",
                            a->surrogates[0], a->surrogates[1]);
}

/// The options of the script that depend on what was asked for, as text.
struct wording {
    char line[128];
    char size[64];
};

static bool word(const struct arguments *a, const struct canopy_surrogate *s, struct wording *wording,
                 struct canopy_fault *fault) {
    double line[4] = {0.0, 0.0, 0.0, 0.0};
    uint32_t size[2] = {0, 0};
    if (a->at && !read_at(a->at, s, line, fault)) {
        return false;
    }
    if (a->size && (!canopy_option_grid(a->size, size) || size[0] < PIXELS_LEAST || size[1] < PIXELS_LEAST ||
                    size[0] > PIXELS_MOST || size[1] > PIXELS_MOST)) {
        return canopy_fault_set(fault, "--size %.60s: give WxH in pixels, each from %d to %d", a->size, PIXELS_LEAST,
                                PIXELS_MOST);
    }
    snprintf(wording->line, sizeof wording->line, a->at ? "--line=%.17g,%.17g,%.17g,%.17g" : "--line=", line[0],
             line[1], line[2], line[3]);
    snprintf(wording->size, sizeof wording->size, "--size=%" PRIu32 "x%" PRIu32, size[0], size[1]);
    return true;
}

/// Reads the surrogates, which checks them; the script reads them again.
static bool check(const struct arguments *a, struct wording *wording, struct canopy_fault *fault) {
    struct canopy_surrogate first, second;
    if (!canopy_surrogate_read(a->surrogates[0], &first, fault)) {
        return false;
    }
    bool ok = word(a, &first, wording, fault);
    if (ok && a->surrogates[1]) {
        ok = canopy_surrogate_read(a->surrogates[1], &second, fault);
        if (ok) {
            ok = same_frame(a, &first, &second, fault);
            canopy_surrogate_free(&second);
        }
    }
    canopy_surrogate_free(&first);
    return ok;
}

// ---------------------------------------------------------------------------------------------------------------------
// The script

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

static void run_script(const struct arguments *a, const char *script, const char *to, const struct wording *wording) {
    const char *const words[] = {PYTHON,
                                 "-B",
                                 "-W",
                                 "ignore",
                                 script,
                                 "--output",
                                 to,
                                 "--format",
                                 a->format,
                                 "--show",
                                 a->show,
                                 wording->line,
                                 wording->size,
                                 "--points",
                                 a->points ? a->points : "",
                                 "--",
                                 a->surrogates[0],
                                 a->surrogates[1],
                                 NULL};
    char *copy[sizeof words / sizeof words[0]];
    memcpy(copy, words, sizeof words);  // execv takes no const
    execv(PYTHON, copy);
    _exit(EXIT_MISSING);
}

/// A child that reads points on its standard input.
static FILE *start(const struct arguments *a, const char *script, const char *to, const struct wording *wording,
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
        run_script(a, script, to, wording);
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
    default:
        return canopy_fault_set(fault, "%s: the picture could not be drawn: give it more memory, or fewer points",
                                a->surrogates[0]);
    }
}

static bool draw(const struct arguments *a, const char *script, const char *to, const struct wording *wording,
                 struct canopy_fault *fault) {
    pid_t child = -1;
    FILE *pipe_end = start(a, script, to, wording, &child);
    if (!pipe_end) {
        return canopy_fault_set(fault, "cannot start " PYTHON ": %s: free some memory or processes", strerror(errno));
    }
    struct canopy_points_info info;
    const bool ok =
        !a->points || canopy_points_read(a->points, (struct canopy_points_sink){pipe_end, send_point}, &info, fault);
    if (!ok) {
        kill(child, SIGTERM);
    }
    fclose(pipe_end);
    int status = 0;
    while (waitpid(child, &status, 0) < 0 && errno == EINTR) {}
    return ok && ((WIFEXITED(status) && WEXITSTATUS(status) == 0) || explain(status, a, fault));
}

int canopy_command_plot(int argc, char **argv) {
    struct arguments arguments = {.show = SHOWN[0]};
    const struct argp argp = {
        .options = OPTIONS, .parser = parse, .args_doc = "SURROGATE.json [SURROGATE.json] [POINTS]", .doc = DOC};
    argp_parse(&argp, argc, argv, 0, NULL, &arguments);
    struct canopy_fault fault;
    struct wording wording;
    char script[PATH_MAX];
    struct canopy_output output;
    signal(SIGPIPE, SIG_IGN);
    if (!read_output(&arguments, &fault) || !check(&arguments, &wording, &fault)) {
        return canopy_command_fail(&fault);
    }
    if (strcmp(arguments.show, "gap") == 0 && !arguments.surrogates[1] && !arguments.points) {
        canopy_fault_set(&fault, "--show gap: the gap is that of points: give POINTS, or a second surrogate");
        return canopy_command_fail(&fault);
    }
    if (!find_script(script, &fault) || !canopy_output_open(&output, arguments.output, &fault)) {
        return canopy_command_fail(&fault);
    }
    if (!draw(&arguments, script, output.temporary ? output.temporary : arguments.output, &wording, &fault)) {
        canopy_output_abandon(&output);
        return canopy_command_fail(&fault);
    }
    return canopy_output_commit(&output, &fault) ? CANOPY_EXIT_OK : canopy_command_fail(&fault);
}
