// canopy ray: where rays first meet a surface, and which segments surely do not.

#include <argp.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "tools/canopy/beam.h"
#include "tools/canopy/command.h"
#include "tools/common/number.h"
#include "tools/common/option.h"
#include "tools/common/points.h"
#include "tools/common/source.h"

static const char DOC[] =
    "Where each ray first meets the surface; with --occluded, whether the way between two points is surely free.\v"
    "A ray starts at a point and goes on without end: six numbers, its start and its direction, in input units (the "
    "direction's length is the unit of t). Give one with --from and --dir (or --to, a point on it), or many in RAYS, a "
    "text file with six numbers a line, separated by blanks, comma, semicolon or tab; # begins a comment; - is "
    "standard input. With --occluded the last three numbers are the other end of a segment (--from and --to).\n\n"
    "Free is the side of the surface without data: above a surrogate above, below one below. Prints a line of 13 "
    "columns for each ray, in order:\n\n"
    "  outcome  t  x y z  nx ny nz  i j  s r  covered\n\n"
    "t: how far along, in directions (of a segment: 0 to 1); x y z: the place; nx ny nz: the surface's unit normal on "
    "the free side; i j: the knot cell, from 0; s r: the place in the cell, 0 to 1; covered: 1, or 0 where the cell "
    "has no data and the surface is only a continuation. The outcome is one of\n\n"
    "  hit           free up to here, where it meets the surface (or may)\n"
    "  starts-under  it starts in the frame, not free: there\n"
    "  enters-under  it comes in from beside the frame, not free: there\n"
    "  miss          it crosses the frame, free all along\n"
    "  beside        it never enters the frame\n"
    "  too-far       it starts too far away for its place to be told\n\n"
    "where the last three have nan and - in the other columns. Outside its frame a surrogate says nothing. With "
    "--occluded there is `free` in place of miss and beside: surely free. No answer is on the wrong side: no hit is "
    "missed, none is later than the true one, nothing is called free that is not, whatever is rounded. A ray that only "
    "touches is a hit. A surrogate with refinement windows is asked as one fine grid on its safe side: it stands "
    "off in the outermost knot intervals alone.\n\n"
    "For example: where does a plumb line from (1, 2, 50) meet the lid, and is the way from one point to another "
    "free?\n\n"
    "  canopy ray lid.json --from 1,2,50 --dir 0,0,-1\n"
    "  canopy ray lid.json --from 1,2,50 --to 3,1,20 --occluded\n\n"
    "Exit status: 0, 2 for bad input (lines before the fault are printed), 64 for wrong usage.";

enum { FROM = 256, TO, DIR, OCCLUDED };

static const struct argp_option OPTIONS[] = {
    {"from", FROM, "X,Y,Z", 0, "where the ray starts", 0},
    {"dir", DIR, "X,Y,Z", 0, "its direction", 0},
    {"to", TO, "X,Y,Z", 0, "or a point that it goes through, at t = 1; with --occluded the segment's other end", 0},
    {"occluded", OCCLUDED, NULL, 0, "segments instead of rays: is the way surely free?", 0},
    {0}};

struct arguments {
    const char *surrogate, *rays, *from, *to, *dir;
    bool occluded;
};

static void check_usage(const struct arguments *a, struct argp_state *state) {
    if (!a->surrogate) {
        argp_error(state, "give a surrogate");
    }
    const bool one = a->from || a->to || a->dir;
    if ((a->rays != NULL) == one) {
        argp_error(state, "give a file of rays, or one with --from and --dir or --to");
    }
    if (one && (!a->from || (a->to != NULL) == (a->dir != NULL))) {
        argp_error(state, "give --from and one of --dir and --to");
    }
    if (a->occluded && a->dir) {
        argp_error(state, "--occluded is about segments: give --from and --to");
    }
}

static error_t parse(int key, char *text, struct argp_state *state) {
    struct arguments *a = state->input;
    switch (key) {
    case FROM: a->from = text; return 0;
    case TO: a->to = text; return 0;
    case DIR: a->dir = text; return 0;
    case OCCLUDED: a->occluded = true; return 0;
    case ARGP_KEY_ARG:
        if (state->arg_num > 1) {
            argp_error(state, "give one surrogate and one file of rays");
        }
        *(state->arg_num == 0 ? &a->surrogate : &a->rays) = text;
        return 0;
    case ARGP_KEY_END: check_usage(a, state); return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

// ---------------------------------------------------------------------------------------------------------------------
// Answers

static const char *word_of(enum canopy_ray_outcome outcome, bool occluded) {
    switch (outcome) {
    case CANOPY_RAY_FREE: return occluded ? "free" : "miss";
    case CANOPY_RAY_BESIDE: return occluded ? "free" : "beside";
    case CANOPY_RAY_HIT: return "hit";
    case CANOPY_RAY_STARTS_UNDER: return "starts-under";
    case CANOPY_RAY_ENTERS_UNDER: return "enters-under";
    default: return "too-far";
    }
}

static void print(const struct canopy_beam *beam, bool occluded) {
    const struct canopy_ray_hit *hit = &beam->hit;
    fputs(word_of((enum canopy_ray_outcome)hit->outcome, occluded), stdout);
    if (!canopy_ray_is_hit(hit)) {
        puts(" nan nan nan nan nan nan nan - - nan nan -");
        return;
    }
    printf(" %.17g", beam->t);
    for (int k = 0; k < 3; k++) {
        printf(" %.17g", beam->point[k]);
    }
    for (int k = 0; k < 3; k++) {
        printf(" %.9g", beam->normal[k]);
    }
    printf(" %" PRIu32 " %" PRIu32 " %.10g %.10g %d\n", beam->cell[0], beam->cell[1], beam->local[0], beam->local[1],
           hit->covered);
}

static bool answer(struct canopy_beam_target *target, const double numbers[6], bool occluded,
                   struct canopy_fault *fault) {
    const double *from = numbers, *second = numbers + 3;
    if (!occluded && second[0] == 0.0 && second[1] == 0.0 && second[2] == 0.0) {
        return canopy_fault_set(fault, "a direction of 0 0 0: give one with a length");
    }
    struct canopy_beam beam;
    canopy_beam_cast(target, from, second, occluded, &beam);
    if (beam.hit.outcome == CANOPY_RAY_BAD_ENVELOPE) {
        return canopy_fault_set(fault, "a surrogate that is no envelope: write the file anew with canopy fit");
    }
    print(&beam, occluded);
    return true;
}

// ---------------------------------------------------------------------------------------------------------------------
// Questions

static bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\r'; }

static const char *skip_blanks(const char *p) {
    while (is_blank(*p)) {
        p++;
    }
    return p;
}

/// Six numbers, and nothing behind them but a comment.
static bool read_numbers(const char *p, double numbers[6], struct canopy_fault *fault) {
    for (int column = 0; column < 6; column++) {
        const char *end = p;
        const enum canopy_number what = canopy_number_read(p, &end, &numbers[column]);
        if (what != CANOPY_NUMBER_OK) {
            return canopy_fault_set(fault, "column %d %s: give six decimal numbers, start and direction", column + 1,
                                    *p == '\0' || *p == '#' ? "is missing" : canopy_number_complaint(what));
        }
        p = skip_blanks(end);
        const bool mark = *p == ',' || *p == ';', last = column == 5;
        if (p == end && !mark && *p != '\0' && *p != '#') {
            return canopy_fault_set(fault, "'%.20s' after column %d: give six decimal numbers, start and direction", p,
                                    column + 1);
        }
        p = mark && !last ? skip_blanks(p + 1) : p;
    }
    return *p == '\0' || *p == '#' ||
           canopy_fault_set(fault, "'%.20s' after six numbers: give start and direction and no more", p);
}

static bool answer_file(struct canopy_beam_target *target, const char *path, bool occluded,
                        struct canopy_fault *fault) {
    struct canopy_source source;
    char *line = NULL;
    if (!canopy_source_open(&source, path, fault)) {
        return false;
    }
    bool ok = true;
    uint64_t count = 0;
    enum canopy_source_state state = CANOPY_SOURCE_OK;
    while (ok && (state = canopy_source_line(&source, &line, fault)) == CANOPY_SOURCE_OK) {
        double numbers[6];
        const char *p = skip_blanks(line);
        if (*p == '\0' || *p == '#') {
            continue;
        }
        count++;
        ok = (read_numbers(p, numbers, fault) && answer(target, numbers, occluded, fault)) ||
             canopy_points_place(fault, path, true, source.line);
    }
    canopy_source_close(&source);
    if (ok && state == CANOPY_SOURCE_END && count == 0) {
        return canopy_fault_set(fault, "%s: no rays: give at least one line of six numbers", path);
    }
    return ok && state == CANOPY_SOURCE_END;
}

static bool read_option(const char *name, const char *text, double to[3], struct canopy_fault *fault) {
    return canopy_option_numbers(text, 3, to) ||
           canopy_fault_set(fault, "--%s %.40s: give three numbers X,Y,Z", name, text);
}

static bool answer_one(struct canopy_beam_target *target, const struct arguments *a, struct canopy_fault *fault) {
    double numbers[6];
    if (!read_option("from", a->from, numbers, fault) ||
        !read_option(a->to ? "to" : "dir", a->to ? a->to : a->dir, numbers + 3, fault)) {
        return false;
    }
    for (int k = 0; a->to && !a->occluded && k < 3; k++) {
        numbers[3 + k] -= numbers[k];
    }
    return answer(target, numbers, a->occluded, fault);
}

int canopy_command_ray(int argc, char **argv) {
    struct arguments arguments = {.occluded = false};
    const struct argp argp = {.options = OPTIONS, .parser = parse, .args_doc = "SURROGATE.json [RAYS]", .doc = DOC};
    argp_parse(&argp, argc, argv, 0, NULL, &arguments);
    struct canopy_fault fault;
    struct canopy_queried queried;
    struct canopy_beam_target target;
    bool ok = canopy_queried_read_refined(arguments.surrogate, &queried, &fault);
    ok = ok && (canopy_beam_open(&target, &queried) ||
                canopy_fault_set(&fault, "%s: out of memory: close other programs", arguments.surrogate));
    if (ok) {
        ok = arguments.rays ? answer_file(&target, arguments.rays, arguments.occluded, &fault)
                            : answer_one(&target, &arguments, &fault);
        canopy_beam_close(&target);
    }
    canopy_queried_free(&queried);
    return ok ? CANOPY_EXIT_OK : canopy_command_fail(&fault);
}
