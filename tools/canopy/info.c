// canopy info: what a surrogate file holds, for people.

#include <argp.h>
#include <inttypes.h>
#include <stdio.h>

#include "tools/canopy/command.h"
#include "tools/common/surrogate.h"

static const char DOC[] =
    "What does this surrogate file hold?\v"
    "Prints a line each: side, scalar and unit; grid and lsb; where the frame stands, in input units; its axes unless "
    "they are x, y and z; the lowest and highest coefficient, between which the whole surface lies (without windows); "
    "windows; how much of it the trim covers; and the certificate as the file states it. Only `canopy check` proves "
    "anything.\n\n"
    "Exit status: 0, or 2 for bad input.";

static error_t parse(int key, char *text, struct argp_state *state) {
    const char **path = state->input;
    switch (key) {
    case ARGP_KEY_ARG:
        if (*path) {
            argp_error(state, "give one surrogate");
        }
        *path = text;
        return 0;
    case ARGP_KEY_END:
        if (!*path) {
            argp_error(state, "give a surrogate");
        }
        return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

static void print_vector(const double *v, double scale) {
    printf("(%.9g, %.9g, %.9g)", v[0] * scale, v[1] * scale, v[2] * scale);
}

static bool is_straight(const struct canopy_surrogate *s) {
    for (int a = 0; a < 3; a++) {
        for (int k = 0; k < 3; k++) {
            if (s->axes[a][k] != (a == k ? 1.0 : 0.0)) {
                return false;
            }
        }
    }
    return true;
}

static void print_frame(const struct canopy_surrogate *s) {
    printf("frame        origin ");
    print_vector(s->origin, s->unit);
    printf(", %.9g by %.9g, knots %.9g and %.9g apart\n", (s->size[0] - 1.0) * s->pitch[0] * s->unit,
           (s->size[1] - 1.0) * s->pitch[1] * s->unit, s->pitch[0] * s->unit, s->pitch[1] * s->unit);
    if (!is_straight(s)) {
        printf("axes        ");
        for (int a = 0; a < 3; a++) {
            putchar(' ');
            print_vector(s->axes[a], 1.0);
        }
        putchar('\n');
    }
}

static void print_heights(const struct canopy_surrogate *s) {
    const size_t count = (size_t)s->size[0] * s->size[1];
    double low = s->coefficients[0], high = low;
    for (size_t k = 1; k < count; k++) {
        low = s->coefficients[k] < low ? s->coefficients[k] : low;
        high = s->coefficients[k] > high ? s->coefficients[k] : high;
    }
    const double scale = s->lsb * s->unit;
    printf("coefficients %.9g to %.9g along the height axis from the origin\n", low * scale, high * scale);
}

static void print_windows(const struct canopy_surrogate *s) {
    for (size_t k = 0; k < s->window_count; k++) {
        const struct canopy_window *w = &s->windows[k];
        printf("window       level %d, %" PRIu32 "x%" PRIu32 " from knot %.4g, %.4g\n", w->level, w->size[0],
               w->size[1], (double)w->first[0] / (1 << w->level), (double)w->first[1] / (1 << w->level));
    }
}

static void print_trim(const struct canopy_surrogate *s) {
    if (!s->trim) {
        return;
    }
    const size_t cells = (size_t)(s->size[0] - 1) * (s->size[1] - 1);
    size_t covered = 0;
    for (size_t k = 0; k < cells; k++) {
        covered += s->trim[k];
    }
    printf("trim         %zu of %zu knot cells covered\n", covered, cells);
}

static void print_certificate(const struct canopy_surrogate *s) {
    if (s->certified) {
        printf("certificate  margin %.9g, %.0f point%s\n", s->margin * s->unit, s->points, s->points == 1 ? "" : "s");
    } else {
        puts("certificate  none");
    }
}

int canopy_command_info(int argc, char **argv) {
    const char *path = NULL;
    const struct argp argp = {.parser = parse, .args_doc = "SURROGATE.json", .doc = DOC};
    argp_parse(&argp, argc, argv, 0, NULL, &path);
    struct canopy_surrogate surrogate;
    struct canopy_fault fault;
    if (!canopy_surrogate_read(path, &surrogate, &fault)) {
        return canopy_command_fail(&fault);
    }
    printf("surrogate    %s all points, %s, unit %.9g\n", surrogate.side == CANOPY_ABOVE ? "above" : "below",
           surrogate.scalar == CANOPY_F32 ? "f32" : "fx", surrogate.unit);
    printf("grid         %" PRIu32 "x%" PRIu32 " coefficients, lsb %.9g\n", surrogate.size[0], surrogate.size[1],
           surrogate.lsb);
    print_frame(&surrogate);
    print_heights(&surrogate);
    print_windows(&surrogate);
    print_trim(&surrogate);
    print_certificate(&surrogate);
    canopy_surrogate_free(&surrogate);
    return CANOPY_EXIT_OK;
}
