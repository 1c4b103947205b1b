#include "boards/linux/options.h"

#include <argp.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "lib/cover/frame.h"
#include "lib/plc/plc.h"
#include "lib/version.h"
#include "tools/common/number.h"
#include "tools/common/option.h"
#include "tools/common/turn.h"

static const char DOC[] =
    "Covers what a scanner sees by a surface proved to lie on one side of it, and serves that to PLCs by Modbus."
    "\vScanners: sim:POINTS[,profiles=N,rate=HZ,loop], modbus-rtu:DEVICE,BAUD,8E1,UNIT[,driver=NAME][,rs485], "
    "modbus-tcp:HOST:PORT[,driver=NAME][,unit=U].\n"
    "PLCs: tcp:HOST:PORT (port 0: any free one, see the log), rtu:DEVICE,BAUD,8E1,UNIT[,rs485].\n\n"
    "Prints `ready' when it serves and logs to standard error; SIGINT and SIGTERM end it with status 0. Bad input: "
    "status 2 and one line that says what and where. Wrong usage: 64. Every key is explained in docs/canopyd.md.";

enum { METHOD = 0x100, SETTINGS };  // without a letter

static const struct argp_option OPTIONS[] = {
    {"config", 'c', "FILE", 0, "read options from a file of `key = value' lines, the keys being these names", 0},
    {"scanner", 's', "URL", 0, "where the readings come from", 1},
    {"modbus", 'm', "URL", 0, "where PLCs are served; may be given up to 16 times", 1},
    {"grid", 'g', "MxN", 0, "coefficients along x and y (20x20, or the frame's)", 2},
    {"side", 'd', "above|below", 0, "which side of the readings the surface is on (above)", 2},
    {"unit", 'u', "U", 0, "input units a device unit (as canopy fit; a scanner that tells its own must agree)", 2},
    {"frame", 'f', "FILE", 0, "keep to the frame of this surrogate file", 2},
    {"dir", 'x', "X,Y,Z", 0, "measure heights along this direction, from the scene to the viewer (0,0,1)", 2},
    {"plane", 'p', "X,Y,Z,X,Y,Z,X,Y,Z", 0,
     "or at right angles to the plane of three points, towards who sees them anticlockwise", 2},
    {"field", 'q', "Q", 0, "field cells a knot interval, 1 to 32 (4)", 2},
    {"method", METHOD, "fast|tight", 0,
     "tight: while the scene rests, spend spare time on making the surface nearly as tight as the field allows (fast)",
     2},
    {"lines", 'l', "L", 0, "lines a knot interval; divides Q; more is tighter and slower (1)", 2},
    {"stale-after", 'a', "MS", 0, "without a reading for so long the envelope is stale (5000)", 3},
    {"interval", 'i', "MS", 0, "from the beginning of one fit to the next, unless an intrusion is in haste (200)", 3},
    {"refresh", 'r', "MS", 0, "until an unchanged envelope is published again with more points (500)", 3},
    {"idle", 'o', "MS", 0, "a TCP client without a request for so long is dropped; 0: never (60000)", 3},
    {"timeout", 't', "MS", 0, "a scanner's answer must begin within this time (500)", 3},
    {"settings", SETTINGS, "FILE", 0,
     "keep the settings that PLCs store in this file, made where there is none; they take the place of these options",
     3},
    {0},
};

// ---- One key

// "MxN"
static bool read_grid(const char *value, struct canopyd_options *options, struct canopy_fault *fault) {
    uint32_t size[2];
    if (!canopy_option_grid(value, size)) {
        return canopy_fault_set(fault, "'%s' is not MxN: give one such as 20x20", value);
    }
    if (size[0] < CANOPY_SIZE_MIN || size[1] < CANOPY_SIZE_MIN || size[0] > CANOPY_SIZE_MAX ||
        size[1] > CANOPY_SIZE_MAX || size[0] * size[1] > CANOPY_PLC_CAPACITY_MAX) {
        return canopy_fault_set(fault,
                                "%s: give M and N from %d to %d, and M times N at most %d, the room in the registers",
                                value, CANOPY_SIZE_MIN, CANOPY_SIZE_MAX, CANOPY_PLC_CAPACITY_MAX);
    }
    options->size[0] = (uint16_t)size[0];
    options->size[1] = (uint16_t)size[1];
    options->size_given = true;
    return true;
}

static bool read_side(const char *value, struct canopyd_options *options, struct canopy_fault *fault) {
    const bool above = strcmp(value, "above") == 0;
    options->side = above ? CANOPY_ABOVE : CANOPY_BELOW;
    return above || strcmp(value, "below") == 0 || canopy_fault_set(fault, "'%s' is neither above nor below", value);
}

static bool read_unit(const char *value, struct canopyd_options *options, struct canopy_fault *fault) {
    return (canopy_number_positive(value, &options->unit) && options->unit >= 1.2e-38 && options->unit <= 3.4e38) ||
           canopy_fault_set(fault, "'%s': give a positive number that fits a 32-bit float, such as 0.001", value);
}

static bool read_whole(const char *value, uint32_t low, uint32_t high, uint32_t *to, struct canopy_fault *fault) {
    return canopy_number_whole32(value, low, high, to) ||
           canopy_fault_set(fault, "'%s': give a whole number from %u to %u", value, low, high);
}

static bool read_small(const char *value, uint16_t *to, struct canopy_fault *fault) {
    uint32_t number;
    if (!read_whole(value, 1, CANOPY_CELLS_MAX, &number, fault)) {
        return false;
    }
    *to = (uint16_t)number;
    return true;
}

static bool read_frame(const char *value, struct canopyd_options *options, struct canopy_fault *fault) {
    free(options->frame);
    options->frame = strdup(value);
    return options->frame != NULL || canopy_fault_set(fault, "no memory");
}

static bool read_settings(const char *value, struct canopyd_options *options, struct canopy_fault *fault) {
    free(options->settings);
    options->settings = strdup(value);
    return options->settings != NULL || canopy_fault_set(fault, "no memory");
}

static bool read_dir(const char *value, struct canopyd_options *options, struct canopy_fault *fault) {
    double direction[3];
    options->dir_given = true;
    return (canopy_option_numbers(value, 3, direction) && canopy_turn_axes(direction, options->axes)) ||
           canopy_fault_set(fault, "'%s': give three numbers X,Y,Z that are not all zero", value);
}

static bool read_plane(const char *value, struct canopyd_options *options, struct canopy_fault *fault) {
    double points[9];
    options->plane_given = true;
    return (canopy_option_numbers(value, 9, points) && canopy_turn_axes_plane(points, options->axes)) ||
           canopy_fault_set(fault, "'%s': give three points X,Y,Z,X,Y,Z,X,Y,Z that are not on a line", value);
}

static bool read_method(const char *value, struct canopyd_options *options, struct canopy_fault *fault) {
    options->tight = strcmp(value, "tight") == 0;
    return options->tight || strcmp(value, "fast") == 0 ||
           canopy_fault_set(fault, "'%s' is neither fast nor tight", value);
}

static bool read_modbus(const char *value, struct canopyd_options *options, struct canopy_fault *fault) {
    if (options->modbus_count == CANOPYD_MODBUS_MAX) {
        return canopy_fault_set(fault, "%s: more than %d are not served: leave some out", value, CANOPYD_MODBUS_MAX);
    }
    return canopyd_modbus_url(value, &options->modbus[options->modbus_count++], fault);
}

static bool set_key(int key, const char *value, struct canopyd_options *options, struct canopy_fault *fault) {
    switch (key) {
    case 's': return canopyd_scanner_url(value, &options->scanner, fault);
    case 'm': return read_modbus(value, options, fault);
    case 'g': return read_grid(value, options, fault);
    case 'd': return read_side(value, options, fault);
    case 'u': return read_unit(value, options, fault);
    case 'f': return read_frame(value, options, fault);
    case 'x': return read_dir(value, options, fault);
    case 'p': return read_plane(value, options, fault);
    case 'q': return read_small(value, &options->field, fault);
    case 'l': return read_small(value, &options->lines, fault);
    case METHOD: return read_method(value, options, fault);
    case SETTINGS: return read_settings(value, options, fault);
    case 'a': return read_whole(value, 10, 4000000, &options->stale_after_ms, fault);
    case 'i': return read_whole(value, 0, 4000000, &options->interval_ms, fault);
    case 'r': return read_whole(value, 0, 4000000, &options->refresh_ms, fault);
    case 'o': return read_whole(value, 0, 4000000, &options->idle_ms, fault);
    default: return read_whole(value, 1, 60000, &options->timeout_ms, fault);
    }
}

// ---- The file

static int key_of(const char *name) {
    for (const struct argp_option *option = OPTIONS; option->name != NULL; option++) {
        if (strcmp(option->name, name) == 0 && option->key != 'c') {
            return option->key;
        }
    }
    return 0;
}

// Without blanks around it and without a comment: # at the beginning or behind a blank.
static char *trim(char *text) {
    for (char *at = text; *at != '\0'; at++) {
        if (*at == '#' && (at == text || at[-1] == ' ' || at[-1] == '\t')) {
            *at = '\0';
            break;
        }
    }
    text += strspn(text, " \t");
    for (size_t length = strlen(text); length > 0 && strchr(" \t\r\n", text[length - 1]) != NULL; length--) {
        text[length - 1] = '\0';
    }
    return text;
}

static bool read_config_line(char *line, struct canopyd_options *options, struct canopy_fault *fault) {
    char *text = trim(line);
    if (*text == '\0') {
        return true;
    }
    char *equals = strchr(text, '=');
    if (equals == NULL) {
        return canopy_fault_set(fault, "'%s' is not of the form key = value", text);
    }
    *equals = '\0';
    const char *name = trim(text), *value = trim(equals + 1);
    const int key = key_of(name);
    if (key == 0) {
        return canopy_fault_set(fault, "'%s' is no key: they are the long options of canopyd --help", name);
    }
    if (*value == '\0') {
        return canopy_fault_set(fault, "%s has no value: give one or leave the line out", name);
    }
    return set_key(key, value, options, fault) || canopy_fault_prefix(fault, "%s", name);
}

static bool read_config(const char *path, struct canopyd_options *options, struct canopy_fault *fault) {
    FILE *file = fopen(path, "re");
    if (file == NULL) {
        return canopy_fault_set(fault, "%s: %s: give a readable configuration file", path, strerror(errno));
    }
    char *line = NULL;
    size_t room = 0;
    bool good = true;
    for (unsigned number = 1; good && getline(&line, &room, file) >= 0; number++) {
        good = read_config_line(line, options, fault) || canopy_fault_prefix(fault, "%s:%u", path, number);
    }
    if (good && ferror(file)) {
        good = canopy_fault_set(fault, "%s: cannot be read: give a file", path);
    }
    free(line);
    fclose(file);
    return good;
}

// ---- The command line

struct given {
    const char *config;
    struct {
        int key;
        const char *value;
    } items[64];
    unsigned count;
};

static error_t take(int key, char *value, struct argp_state *state) {
    struct given *given = state->input;
    if (key == 'c') {
        given->config = value;
        return 0;
    }
    if (key == ARGP_KEY_ARG) {
        argp_error(state, "'%s' is not expected", value);
        return EINVAL;
    }
    if (value == NULL) {
        return ARGP_ERR_UNKNOWN;
    }
    if (given->count == sizeof given->items / sizeof given->items[0]) {
        argp_error(state, "too many options");
        return EINVAL;
    }
    given->items[given->count].key = key;
    given->items[given->count++].value = value;
    return 0;
}

static const char *name_of(int key) {
    const struct argp_option *option = OPTIONS;
    while (option->key != key) {
        option++;
    }
    return option->name;
}

// A URL or a word that means nothing is wrong usage; a number that cannot be is bad input, as with canopy fit.
static int apply(const struct given *given, struct canopyd_options *options, struct canopy_fault *fault) {
    for (unsigned i = 0; i < given->count; i++) {
        if (given->items[i].key == 'm') {
            options->modbus_count = 0;  // the command line's replace the file's
        }
    }
    for (unsigned i = 0; i < given->count; i++) {
        const int key = given->items[i].key;
        if (!set_key(key, given->items[i].value, options, fault)) {
            canopy_fault_prefix(fault, "--%s", name_of(key));
            return key == 's' || key == 'm' || key == 'd' || key == METHOD ? CANOPYD_EXIT_USAGE : CANOPYD_EXIT_INPUT;
        }
    }
    return CANOPYD_EXIT_OK;
}

// What only makes sense together.
static bool agree(const struct canopyd_options *options, struct canopy_fault *fault) {
    if (options->field % options->lines != 0) {
        return canopy_fault_set(fault, "lines %u does not divide field %u: choose one that does", options->lines,
                                options->field);
    }
    if (options->dir_given + options->plane_given + (options->frame != NULL) > 1) {
        return canopy_fault_set(fault, "dir, plane and frame each say where heights are measured: give one of them");
    }
    return true;
}

static int complain(int status, const struct canopy_fault *fault) {
    fprintf(stderr, "canopyd: %s\n", fault->text);
    return status;
}

int canopyd_options_read(int argc, char **argv, struct canopyd_options *options) {
    static const struct argp argp = {.options = OPTIONS, .parser = take, .doc = DOC};
    argp_program_version = "canopyd " CANOPY_VERSION;
    argp_err_exit_status = CANOPYD_EXIT_USAGE;
    *options = (struct canopyd_options){.size = {20, 20},
                                        .side = CANOPY_ABOVE,
                                        .field = 4,
                                        .lines = 1,
                                        .stale_after_ms = 5000,
                                        .interval_ms = 200,
                                        .refresh_ms = 500,
                                        .idle_ms = 60000,
                                        .timeout_ms = 500};
    struct given given = {.config = NULL};
    struct canopy_fault fault;
    if (argp_parse(&argp, argc, argv, 0, NULL, &given) != 0) {
        return CANOPYD_EXIT_USAGE;
    }
    if (given.config != NULL && !read_config(given.config, options, &fault)) {
        return complain(CANOPYD_EXIT_INPUT, &fault);
    }
    const int status = apply(&given, options, &fault);
    if (status != CANOPYD_EXIT_OK) {
        return complain(status, &fault);
    }
    if (!agree(options, &fault)) {
        return complain(CANOPYD_EXIT_INPUT, &fault);
    }
    if (options->scanner.kind == CANOPYD_NO_SCANNER || options->modbus_count == 0) {
        canopy_fault_set(&fault, "no %s: give one by --%s URL or in a --config FILE; try canopyd --help",
                         options->scanner.kind == CANOPYD_NO_SCANNER ? "scanner" : "PLC side",
                         options->scanner.kind == CANOPYD_NO_SCANNER ? "scanner" : "modbus");
        return complain(CANOPYD_EXIT_USAGE, &fault);
    }
    return CANOPYD_EXIT_OK;
}

void canopyd_options_free(struct canopyd_options *options) {
    free(options->frame);
    free(options->settings);
    options->frame = options->settings = NULL;
}
