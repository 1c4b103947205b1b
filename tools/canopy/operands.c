#include "tools/canopy/operands.h"

void canopy_operands_take(struct canopy_operands *operands, char *text, struct argp_state *state,
                          const char *too_many) {
    if (state->arg_num == 0) {
        operands->surrogate = text;
    } else if (state->arg_num == 1) {
        operands->points = text;
    } else {
        argp_error(state, "%s", too_many);
    }
}

static error_t parse(int key, char *text, struct argp_state *state) {
    switch (key) {
    case ARGP_KEY_ARG:
        canopy_operands_take(state->input, text, state, "give one surrogate and one point file");
        return 0;
    case ARGP_KEY_END:
        if (state->arg_num < 2) {
            argp_error(state, "give a surrogate and a point file");
        }
        return 0;
    default: return ARGP_ERR_UNKNOWN;
    }
}

struct canopy_operands canopy_operands_both(int argc, char **argv, const char *doc) {
    struct canopy_operands operands = {NULL, NULL};
    const struct argp argp = {.parser = parse, .args_doc = "SURROGATE.json POINTS", .doc = doc};
    argp_parse(&argp, argc, argv, 0, NULL, &operands);
    return operands;
}
