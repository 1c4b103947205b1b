// canopy trim: the outline of what a surrogate covers, for other software.

#include <argp.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "tools/canopy/command.h"
#include "tools/common/outline.h"
#include "tools/common/output.h"

static const char DOC[] =
    "The outline of what a surrogate covers, along and diagonal to its knot cells.\v"
    "Covered cells, the 1s of the file's \"trim\", are inside, whole; a cell without data between two covered "
    "neighbours that share a corner is cut along its diagonal, so that staircases end in straight lines. Without a "
    "\"trim\" the outline is that of the frame.\n\n"
    "Prints one corner a line under a heading: the number of its polygon from 1, whether that is a hole (1) or not "
    "(0), "
    "the knot it is at, and its place along the surrogate's first and second axis in input units, measured from the "
    "zero "
    "of the input: with axes along x, y, z it is x and y. The surface's height there is what `canopy eval` says. "
    "Polygons are closed and simple; outer ones are anticlockwise, holes clockwise. With -o OUT.svg a drawing of the "
    "same, in input units.\n\n"
    "Exit status: 0, 2 for bad input and no output file, 64 for wrong usage.";

enum { CLOSE = 256, CLEAN };

static const struct argp_option OPTIONS[] = {
    {"output", 'o', "OUT", 0, "write it here, a drawing if the name ends in .svg, else comma-separated numbers", 0},
    {"close", CLOSE, 0, 0, "close holes of one cell", 0},
    {"clean", CLEAN, 0, 0, "leave out cells none of whose eight neighbours is covered", 0},
    {0}};

struct arguments {
    const char *surrogate;
    const char *output;
    bool close;
    bool clean;
};

static error_t parse(int key, char *text, struct argp_state *state) {
    struct arguments *a = state->input;
    switch (key) {
    case 'o': a->output = text; return 0;
    case CLOSE: a->close = true; return 0;
    case CLEAN: a->clean = true; return 0;
    case ARGP_KEY_ARG:
        if (a->surrogate) {
            argp_error(state, "give one surrogate");
        }
        a->surrogate = text;
        return 0;
    case ARGP_KEY_END:
        if (!a->surrogate) {
            argp_error(state, "give a surrogate");
        }
        return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

/// A knot's place along an axis, input units from the zero of the input.
static double place(const struct canopy_surrogate *s, int axis, double knot) {
    const double *a = s->axes[axis];
    return (knot * s->pitch[axis] + a[0] * s->origin[0] + a[1] * s->origin[1] + a[2] * s->origin[2]) * s->unit;
}

static void write_numbers(FILE *to, const struct canopy_surrogate *s, const struct canopy_trim_outline *trace) {
    fputs("polygon,hole,u,v,x,y\n", to);
    for (uint32_t p = 0; p < trace->polygon_count; p++) {
        const struct canopy_trim_polygon *polygon = &trace->polygons[p];
        for (uint32_t k = 0; k < polygon->count; k++) {
            const struct canopy_trim_corner c = trace->corners[polygon->first + k];
            fprintf(to, "%" PRIu32 ",%d,%u,%u,%.17g,%.17g\n", p + 1, polygon->twice_area < 0, c.u, c.v,
                    place(s, 0, c.u), place(s, 1, c.v));
        }
    }
}

/// The frame as a thin rectangle and the trim as one filled path, whose holes the winding leaves open. y grows upward.
static void write_drawing(FILE *to, const struct canopy_surrogate *s, const struct canopy_trim_outline *trace) {
    const double x = place(s, 0, 0.0);
    const double y = place(s, 1, 0.0);
    const double width = place(s, 0, s->size[0] - 1.0) - x;
    const double height = place(s, 1, s->size[1] - 1.0) - y;
    const double stroke = 0.002 * fmax(width, height);
    const double edge = 4.0 * stroke;
    fprintf(to, "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"%.17g %.17g %.17g %.17g\">\n", x - edge,
            -y - height - edge, width + 2.0 * edge, height + 2.0 * edge);
    fprintf(to, "<g transform=\"scale(1,-1)\" stroke-width=\"%.3g\">\n", stroke);
    fprintf(to, "<rect x=\"%.17g\" y=\"%.17g\" width=\"%.17g\" height=\"%.17g\" fill=\"none\" stroke=\"#999999\"/>\n",
            x, y, width, height);
    fputs("<path fill=\"#bfdbfe\" fill-rule=\"nonzero\" stroke=\"#1d4ed8\" d=\"", to);
    for (uint32_t p = 0; p < trace->polygon_count; p++) {
        const struct canopy_trim_polygon *polygon = &trace->polygons[p];
        for (uint32_t k = 0; k < polygon->count; k++) {
            const struct canopy_trim_corner c = trace->corners[polygon->first + k];
            fprintf(to, "%c%.17g %.17g", k == 0 ? 'M' : 'L', place(s, 0, c.u), place(s, 1, c.v));
        }
        fputs("Z\n", to);
    }
    fputs("\"/>\n</g>\n</svg>\n", to);
}

static bool write_file(const struct arguments *a, const struct canopy_surrogate *s,
                       const struct canopy_trim_outline *trace, struct canopy_fault *fault) {
    struct canopy_output output;
    if (!canopy_output_open(&output, a->output, fault)) {
        return false;
    }
    const size_t length = strlen(a->output);
    const bool drawing = length >= 4 && strcmp(a->output + length - 4, ".svg") == 0;
    (drawing ? write_drawing : write_numbers)(output.file, s, trace);
    return canopy_output_commit(&output, fault);
}

int canopy_command_trim(int argc, char **argv) {
    struct arguments arguments = {.surrogate = NULL};
    const struct argp argp = {.options = OPTIONS, .parser = parse, .args_doc = "SURROGATE.json", .doc = DOC};
    argp_parse(&argp, argc, argv, 0, NULL, &arguments);
    struct canopy_fault fault;
    struct canopy_surrogate surrogate;
    if (!canopy_surrogate_read(arguments.surrogate, &surrogate, &fault)) {
        return canopy_command_fail(&fault);
    }
    struct canopy_outline outline;
    bool ok = canopy_outline_make(&surrogate, arguments.close, arguments.clean, &outline, &fault);
    if (ok && arguments.output) {
        ok = write_file(&arguments, &surrogate, &outline.trace, &fault);
    } else if (ok) {
        write_numbers(stdout, &surrogate, &outline.trace);
    }
    if (ok) {
        canopy_outline_free(&outline);
    }
    canopy_surrogate_free(&surrogate);
    return ok ? CANOPY_EXIT_OK : canopy_command_fail(&fault);
}
