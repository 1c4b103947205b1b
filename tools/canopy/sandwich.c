// canopy sandwich: a surface above and one below that never cross, and whether two surfaces do.

#include <argp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tools/canopy/command.h"
#include "tools/canopy/operands.h"
#include "tools/canopy/wish.h"
#include "tools/common/crossing.h"

static const char DOC[] =
    "Fits two smooth surfaces of one frame, one above all points and one below, that cross nowhere in it, proves all "
    "three, and writes them as surrogate files OUT.above.json and OUT.below.json.\v" CANOPY_OPERANDS_POINTS
    "Each surface is what `canopy fit` makes. That both are safe does not keep them apart between the points: what "
    "does "
    "is checked over the whole frame, in whole numbers of any length, from the coefficients that are written. "
    "Everything else that uses a surrogate takes either file.\n\n"
    "Prints one line a side, as `canopy fit` does (the milliseconds of the fit are those of both), and one that says "
    "how far the two are apart at least, in input units along the frame's third axis.\n\n"
    "With --check, decides whether two surrogates of one frame cross and prints one line: where they come closest (u, "
    "v in knot intervals) and how close. Whatever this command wrote is decided; of other pairs, those that touch "
    "without crossing may be left open, which counts as crossing.\n\n"
    "Exit status: 0 done; 1 with --check: they cross, or may; 2 bad input, with one line that says where and what to "
    "do, and no output files; 64 wrong usage.";

enum { CHECK = 256 };

static const struct argp_option OPTIONS[] = {
    {"output", 'o', "OUT", 0,
     "write OUT.above.json and OUT.below.json (OUT may end in .json, which is left out); without it only the lines are "
     "printed",
     0},
    {"check", CHECK, "ABOVE.json", 0,
     "fit nothing: do this surrogate and the one that stands in place of POINTS cross?", 0},
    {0}};

struct arguments {
    struct canopy_wish wish;
    const char *output;
    const char *check;
};

/// Nothing but an operand, whatever options there are. Both have been cleared to the last byte.
static bool is_bare(const struct canopy_wish *wish) {
    struct canopy_wish bare;
    memset(&bare, 0, sizeof bare);
    bare.points = wish->points;
    bare.scalar = -1;
    return memcmp(wish, &bare, sizeof bare) == 0;
}

static void end(const struct arguments *a, struct argp_state *state) {
    const struct canopy_wish *w = &a->wish;
    if (!a->check) {
        canopy_wish_end(w, state);
    } else if (!w->points) {
        argp_error(state, "give two surrogates: --check ABOVE.json BELOW.json");
    } else if (a->output || !is_bare(w)) {
        argp_error(state, "--check takes two surrogates and no other option");
    }
}

static error_t parse(int key, char *text, struct argp_state *state) {
    struct arguments *a = state->input;
    switch (key) {
    case ARGP_KEY_INIT: state->child_inputs[0] = &a->wish; return 0;
    case 'o': a->output = text; return 0;
    case CHECK: a->check = text; return 0;
    case ARGP_KEY_END: end(a, state); return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

static void print_crossing(const struct canopy_crossing *c, double unit) {
    const double distance = c->distance * unit;
    if (c->verdict == CANOPY_CROSSING_FOUND) {
        printf("CROSSING: the surface above is below the other one, by up to %.3g", -distance);
    } else if (c->verdict == CANOPY_CROSSING_UNDECIDED) {
        printf("NOT DECIDED: they touch, or cross by no more than %.3g", -distance);
    } else if (c->distance > 0.0) {
        printf("never crossing: everywhere at least %.3g apart", distance);
    } else {
        printf("never crossing: they touch, and cross nowhere");
    }
    printf(", closest at u %.4g, v %.4g\n", c->at[0], c->at[1]);
}

// ---------------------------------------------------------------------------------------------------------------------
// Two files

static bool compare(const char *const paths[2], const struct canopy_surrogate surrogates[2], bool *apart,
                    struct canopy_fault *fault) {
    // Which is which, the files say.
    const int above = surrogates[0].side == CANOPY_ABOVE ? 0 : 1;
    struct canopy_crossing crossing;
    if (!canopy_crossing_find(&surrogates[above], &surrogates[1 - above], &crossing, fault)) {
        return canopy_fault_prefix(fault, "%s, %s", paths[0], paths[1]);
    }
    print_crossing(&crossing, surrogates[0].unit);
    *apart = crossing.verdict == CANOPY_CROSSING_NONE;
    return true;
}

static bool check(const struct arguments *a, bool *apart, struct canopy_fault *fault) {
    const char *const paths[2] = {a->check, a->wish.points};
    struct canopy_surrogate surrogates[2];
    if (!canopy_surrogate_read(paths[0], &surrogates[0], fault)) {
        return false;
    }
    bool ok = canopy_surrogate_read(paths[1], &surrogates[1], fault);
    if (ok) {
        ok = compare(paths, surrogates, apart, fault);
        canopy_surrogate_free(&surrogates[1]);
    }
    canopy_surrogate_free(&surrogates[0]);
    return ok;
}

// ---------------------------------------------------------------------------------------------------------------------
// From points

/// OUT.above.json and OUT.below.json, also of OUT.json, which is how the other commands are told a name.
struct names {
    char *text[2];
};

static bool make_names(const char *output, struct names *names, struct canopy_fault *fault) {
    static const char *const ENDS[2] = {".above.json", ".below.json"};
    size_t length = output ? strlen(output) : 0;
    if (length > 5 && strcmp(output + length - 5, ".json") == 0 && output[length - 6] != '/') {
        length -= 5;
    }
    for (int side = 0; output && side < 2; side++) {
        names->text[side] = malloc(length + strlen(ENDS[side]) + 1);
        if (!names->text[side]) {
            return canopy_fault_no_memory(fault);
        }
        memcpy(names->text[side], output, length);
        strcpy(names->text[side] + length, ENDS[side]);
    }
    return true;
}

static bool fit_and_write(const struct arguments *a, struct canopy_surface_wish *wish, struct canopy_loaded *loaded,
                          const struct names *names, struct canopy_fault *fault) {
    struct canopy_surrogate surrogates[2];
    struct canopy_surface_report reports[2];
    struct canopy_crossing crossing;
    if (!canopy_surface_fit_both_supply(&loaded->supply, wish, surrogates, reports, &crossing, fault)) {
        return canopy_fault_prefix(fault, "%s", a->wish.points);
    }
    const char *const paths[2] = {names->text[0], names->text[1]};
    const bool ok = !a->output || canopy_surrogate_write_both(paths, surrogates, fault);
    for (int side = 0; side < 2; side++) {
        if (ok) {
            wish->side = (enum canopy_side)side;
            canopy_wish_report(wish, loaded, &reports[side], paths[side]);
        }
        canopy_surrogate_free(&surrogates[side]);
    }
    if (ok) {
        print_crossing(&crossing, loaded->unit);
    }
    return ok;
}

static bool run(const struct arguments *a, struct canopy_surrogate *frame, struct names *names,
                struct canopy_fault *fault) {
    struct canopy_surface_wish wish;
    struct canopy_loaded loaded;
    if (a->output && (strcmp(a->output, "-") == 0 || a->output[0] == '\0')) {
        return canopy_fault_set(fault,
                                "-o '%s': cannot write: give -o a name that .above.json and .below.json can "
                                "follow, standard output has the report",
                                a->output);
    }
    if (!make_names(a->output, names, fault) || !canopy_wish_read(&a->wish, frame, &wish, fault) ||
        !canopy_wish_load(&a->wish, &wish, &loaded, fault)) {
        return false;
    }
    const bool ok = fit_and_write(a, &wish, &loaded, names, fault);
    canopy_supply_free(&loaded.supply);
    return ok;
}

int canopy_command_sandwich(int argc, char **argv) {
    struct arguments arguments;
    memset(&arguments, 0, sizeof arguments);
    arguments.wish.scalar = -1;
    const struct argp_child children[] = {{&canopy_wish_argp, 0, NULL, 0}, {0}};
    const struct argp argp = {.options = OPTIONS,
                              .parser = parse,
                              .args_doc = "POINTS\n--check ABOVE.json BELOW.json",
                              .doc = DOC,
                              .children = children};
    argp_parse(&argp, argc, argv, 0, NULL, &arguments);
    struct canopy_fault fault;
    bool apart = true;
    bool ok = false;
    if (arguments.check) {
        ok = check(&arguments, &apart, &fault);
    } else {
        struct canopy_surrogate frame = {0};
        struct names names = {{NULL, NULL}};
        ok = run(&arguments, &frame, &names, &fault);
        canopy_surrogate_free(&frame);
        free(names.text[0]);
        free(names.text[1]);
    }
    if (!ok) {
        return canopy_command_fail(&fault);
    }
    return apart ? CANOPY_EXIT_OK : CANOPY_EXIT_UNSAFE;
}
