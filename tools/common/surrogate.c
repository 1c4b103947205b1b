#include "tools/common/surrogate.h"

#include <errno.h>
#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "tools/common/output.h"

// ---------------------------------------------------------------------------------------------------------------------
// Reading. Every helper returns false after filling the fault with what is wrong; canopy_surrogate_read adds the file.

static bool complain(struct canopy_fault *fault, const char *key, const char *what) {
    return canopy_fault_set(fault, "\"%s\" %s: write the file anew with canopy fit", key, what);
}

/// Every key of `object` is in `keys`, and the first `required` of them are there.
static bool check_keys(const json_t *object, const char *const *keys, size_t count, size_t required, const char *name,
                       struct canopy_fault *fault) {
    if (!json_is_object(object)) {
        return complain(fault, name, "is not an object");
    }
    for (size_t i = 0; i < required; i++) {
        if (!json_object_get(object, keys[i])) {
            return complain(fault, keys[i], "is missing");
        }
    }
    for (void *at = json_object_iter((json_t *)(uintptr_t)object); at;
         at = json_object_iter_next((json_t *)(uintptr_t)object, at)) {
        size_t i = 0;
        while (i < count && strcmp(json_object_iter_key(at), keys[i]) != 0) {
            i++;
        }
        if (i == count) {
            return complain(fault, json_object_iter_key(at), "is not a key of this format");
        }
    }
    return true;
}

static bool get_number(const json_t *value, const char *key, double *to, struct canopy_fault *fault) {
    if (!json_is_number(value) || !isfinite(json_number_value(value))) {
        return complain(fault, key, "is not a finite number");
    }
    *to = json_number_value(value);
    return true;
}

static bool get_positive(const json_t *value, const char *key, double *to, struct canopy_fault *fault) {
    return get_number(value, key, to, fault) && (*to > 0.0 || complain(fault, key, "is not positive"));
}

static bool get_vector(const json_t *value, const char *key, size_t count, double *to, struct canopy_fault *fault) {
    if (!json_is_array(value) || json_array_size(value) != count) {
        return complain(fault, key, "has the wrong number of values");
    }
    for (size_t i = 0; i < count; i++) {
        if (!get_number(json_array_get(value, i), key, &to[i], fault)) {
            return false;
        }
    }
    return true;
}

static bool get_word(const json_t *value, const char *key, const char *zero, const char *one, int *to,
                     struct canopy_fault *fault) {
    const char *word = json_string_value(value);
    if (!word || (strcmp(word, zero) != 0 && strcmp(word, one) != 0)) {
        return canopy_fault_set(fault, "\"%s\" is neither \"%s\" nor \"%s\": write the file anew with canopy fit", key,
                                zero, one);
    }
    *to = strcmp(word, one) == 0;
    return true;
}

static bool get_size(const json_t *value, const char *key, json_int_t least, uint32_t to[2],
                     struct canopy_fault *fault) {
    if (!json_is_array(value) || json_array_size(value) != 2) {
        return complain(fault, key, "is not two whole numbers");
    }
    for (size_t i = 0; i < 2; i++) {
        const json_t *item = json_array_get(value, i);
        if (!json_is_integer(item) || json_integer_value(item) < least ||
            json_integer_value(item) > CANOPY_SURROGATE_GRID_MAX) {
            return canopy_fault_set(fault, "\"%s\" is not two whole numbers from %d to %d: fit with another --grid",
                                    key, (int)least, CANOPY_SURROGATE_GRID_MAX);
        }
        to[i] = (uint32_t)json_integer_value(item);
    }
    return true;
}

/// A matrix as a list of rows.
static bool get_matrix(const json_t *value, const char *key, const uint32_t size[2], double **to,
                       struct canopy_fault *fault) {
    const size_t rows = size[0];
    const size_t columns = size[1];
    if (!json_is_array(value) || json_array_size(value) != rows) {
        return complain(fault, key, "does not have as many rows as the size says");
    }
    double *matrix = calloc(rows * columns, sizeof *matrix);
    if (!matrix) {
        return complain(fault, key, "does not fit into memory");
    }
    *to = matrix;  // freed with the surrogate, also on a fault below
    for (size_t i = 0; i < rows; i++) {
        if (!get_vector(json_array_get(value, i), key, columns, matrix + i * columns, fault)) {
            return false;
        }
    }
    return true;
}

static bool get_trim(const json_t *value, struct canopy_surrogate *s, struct canopy_fault *fault) {
    const uint32_t size[2] = {s->size[0] - 1, s->size[1] - 1};
    const size_t count = (size_t)size[0] * size[1];
    double *cells = NULL;
    bool ok = get_matrix(value, "trim", size, &cells, fault) && cells;
    uint8_t *trim = malloc(count);
    s->trim = trim;
    if (!ok || !trim) {
        free(cells);
        return ok && complain(fault, "trim", "does not fit into memory");
    }
    for (size_t i = 0; ok && i < count; i++) {
        ok = cells[i] == 0.0 || cells[i] == 1.0 || complain(fault, "trim", "holds something else than 0 and 1");
        trim[i] = cells[i] == 1.0;
    }
    free(cells);
    return ok;
}

static bool get_window(const json_t *value, struct canopy_window *window, struct canopy_fault *fault) {
    static const char *const KEYS[] = {"level", "first", "size", "coefficients"};
    if (!check_keys(value, KEYS, 4, 4, "windows", fault)) {
        return false;
    }
    const json_t *level = json_object_get(value, "level");
    const json_t *first = json_object_get(value, "first");
    if (!json_is_integer(level) || json_integer_value(level) < 1 || json_integer_value(level) > 2) {
        return complain(fault, "level", "of a window is neither 1 nor 2");
    }
    window->level = (int)json_integer_value(level);
    for (size_t i = 0; i < 2; i++) {
        const json_t *item = json_array_get(first, i);
        if (json_array_size(first) != 2 || !json_is_integer(item) || llabs(json_integer_value(item)) > 1000000) {
            return complain(fault, "first", "of a window is not two whole numbers within a million");
        }
        window->first[i] = (int32_t)json_integer_value(item);
    }
    return get_size(json_object_get(value, "size"), "size", 1, window->size, fault) &&
           get_matrix(json_object_get(value, "coefficients"), "coefficients", window->size, &window->coefficients,
                      fault);
}

static bool get_windows(const json_t *value, struct canopy_surrogate *s, struct canopy_fault *fault) {
    if (!json_is_array(value)) {
        return complain(fault, "windows", "is not a list");
    }
    const size_t count = json_array_size(value);
    s->windows = calloc(count ? count : 1, sizeof *s->windows);
    if (!s->windows) {
        return complain(fault, "windows", "does not fit into memory");
    }
    s->window_count = count;
    for (size_t i = 0; i < count; i++) {
        if (!get_window(json_array_get(value, i), &s->windows[i], fault)) {
            return false;
        }
    }
    return true;
}

/// Orthonormal within 1e-6 and right-handed.
static bool is_rotation(const double axes[3][3]) {
    double worst = 0.0;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            const double dot = axes[i][0] * axes[j][0] + axes[i][1] * axes[j][1] + axes[i][2] * axes[j][2];
            const double off = fabs(dot - (i == j));
            worst = off <= worst ? worst : off;  // keeps a NaN
        }
    }
    const double determinant = axes[0][0] * (axes[1][1] * axes[2][2] - axes[1][2] * axes[2][1]) -
                               axes[0][1] * (axes[1][0] * axes[2][2] - axes[1][2] * axes[2][0]) +
                               axes[0][2] * (axes[1][0] * axes[2][1] - axes[1][1] * axes[2][0]);
    return worst < 1e-6 && determinant > 0.0;
}

static bool get_frame(const json_t *value, struct canopy_surrogate *s, struct canopy_fault *fault) {
    static const char *const KEYS[] = {"origin", "axes", "pitch"};
    if (!check_keys(value, KEYS, 3, 3, "frame", fault) ||
        !get_vector(json_object_get(value, "origin"), "origin", 3, s->origin, fault) ||
        !get_vector(json_object_get(value, "pitch"), "pitch", 2, s->pitch, fault)) {
        return false;
    }
    const json_t *axes = json_object_get(value, "axes");
    if (!json_is_array(axes) || json_array_size(axes) != 3) {
        return complain(fault, "axes", "is not three vectors");
    }
    for (size_t i = 0; i < 3; i++) {
        if (!get_vector(json_array_get(axes, i), "axes", 3, s->axes[i], fault)) {
            return false;
        }
    }
    if (!(s->pitch[0] > 0.0 && s->pitch[1] > 0.0)) {
        return complain(fault, "pitch", "is not positive");
    }
    return is_rotation((const double(*)[3])s->axes) ||
           complain(fault, "axes", "is not a right-handed orthonormal frame");
}

static bool get_certificate(const json_t *value, struct canopy_surrogate *s, struct canopy_fault *fault) {
    static const char *const KEYS[] = {"margin", "points"};
    s->certified = true;
    return check_keys(value, KEYS, 2, 2, "certificate", fault) &&
           get_number(json_object_get(value, "margin"), "margin", &s->margin, fault) &&
           get_number(json_object_get(value, "points"), "points", &s->points, fault);
}

static bool get_document(const json_t *document, struct canopy_surrogate *s, struct canopy_fault *fault) {
    static const char *const KEYS[] = {"format", "version",      "side", "scalar",  "unit", "frame",
                                       "size",   "coefficients", "lsb",  "windows", "trim", "certificate"};
    const char *format = json_string_value(json_object_get(document, "format"));
    const json_t *version = json_object_get(document, "version");
    if (!format || strcmp(format, "canopy-surrogate") != 0 || !json_is_integer(version) ||
        json_integer_value(version) != 1) {
        return canopy_fault_set(fault, "not a canopy-surrogate file of version 1: give what canopy fit wrote");
    }
    int side = 0;
    int scalar = 0;
    if (!check_keys(document, KEYS, 12, 8, "file", fault) ||
        !get_word(json_object_get(document, "side"), "side", "above", "below", &side, fault) ||
        !get_word(json_object_get(document, "scalar"), "scalar", "f32", "fx", &scalar, fault) ||
        !get_positive(json_object_get(document, "unit"), "unit", &s->unit, fault) ||
        !get_frame(json_object_get(document, "frame"), s, fault) ||
        !get_size(json_object_get(document, "size"), "size", 4, s->size, fault) ||
        !get_matrix(json_object_get(document, "coefficients"), "coefficients", s->size, &s->coefficients, fault)) {
        return false;
    }
    s->side = (enum canopy_side)side;
    s->scalar = (enum canopy_scalar)scalar;
    s->lsb = 1.0;
    const json_t *lsb = json_object_get(document, "lsb");
    const json_t *windows = json_object_get(document, "windows");
    const json_t *trim = json_object_get(document, "trim");
    const json_t *certificate = json_object_get(document, "certificate");
    return (!lsb || get_positive(lsb, "lsb", &s->lsb, fault)) && (!windows || get_windows(windows, s, fault)) &&
           (!trim || get_trim(trim, s, fault)) && (!certificate || get_certificate(certificate, s, fault));
}

bool canopy_surrogate_read(const char *path, struct canopy_surrogate *surrogate, struct canopy_fault *fault) {
    memset(surrogate, 0, sizeof *surrogate);
    FILE *file = fopen(path, "rb");
    struct stat status;
    if (!file || (fstat(fileno(file), &status) == 0 && S_ISDIR(status.st_mode))) {
        const int why = file ? EISDIR : errno;
        if (file) {
            fclose(file);
        }
        return canopy_fault_set(fault, "%s: %s: give a surrogate file that canopy fit wrote", path, strerror(why));
    }
    json_error_t error;
    json_t *document = json_loadf(file, JSON_REJECT_DUPLICATES, &error);
    fclose(file);
    if (!document) {
        return canopy_fault_set(fault, "%s:%d: not JSON: %s: give a surrogate file that canopy fit wrote", path,
                                error.line, error.text);
    }
    const bool ok = get_document(document, surrogate, fault);
    json_decref(document);
    if (!ok) {
        canopy_surrogate_free(surrogate);
        return canopy_fault_prefix(fault, "%s", path);
    }
    return true;
}

void canopy_surrogate_free(struct canopy_surrogate *surrogate) {
    for (size_t i = 0; i < surrogate->window_count; i++) {
        free(surrogate->windows[i].coefficients);
    }
    free(surrogate->windows);
    free(surrogate->coefficients);
    free(surrogate->trim);
    memset(surrogate, 0, sizeof *surrogate);
}

// ---------------------------------------------------------------------------------------------------------------------
// Writing

static json_t *number(double value) {
    // Whole numbers as JSON integers: shorter, and exact.
    return fabs(value) < 9e15 && value == floor(value) && !(value == 0.0 && signbit(value))
               ? json_integer((json_int_t)value)
               : json_real(value);
}

static json_t *vector(const double *values, size_t count) {
    json_t *list = json_array();
    for (size_t i = 0; i < count; i++) {
        json_array_append_new(list, number(values[i]));
    }
    return list;
}

static json_t *matrix(const double *values, size_t rows, size_t columns) {
    json_t *list = json_array();
    for (size_t i = 0; i < rows; i++) {
        json_array_append_new(list, vector(values + i * columns, columns));
    }
    return list;
}

static json_t *frame(const struct canopy_surrogate *s) {
    json_t *object = json_object();
    json_object_set_new(object, "origin", vector(s->origin, 3));
    json_object_set_new(object, "axes", matrix(&s->axes[0][0], 3, 3));
    json_object_set_new(object, "pitch", vector(s->pitch, 2));
    return object;
}

static json_t *windows(const struct canopy_surrogate *s) {
    json_t *list = json_array();
    for (size_t i = 0; i < s->window_count; i++) {
        const struct canopy_window *w = &s->windows[i];
        json_array_append_new(list, json_pack("{s:i, s:[i,i], s:[i,i], s:o}", "level", w->level, "first", w->first[0],
                                              w->first[1], "size", (int)w->size[0], (int)w->size[1], "coefficients",
                                              matrix(w->coefficients, w->size[0], w->size[1])));
    }
    return list;
}

static json_t *trim(const struct canopy_surrogate *s) {
    json_t *list = json_array();
    for (size_t i = 0; i + 1 < s->size[0]; i++) {
        json_t *row = json_array();
        for (size_t j = 0; j + 1 < s->size[1]; j++) {
            json_array_append_new(row, json_integer(s->trim[i * (s->size[1] - 1) + j]));
        }
        json_array_append_new(list, row);
    }
    return list;
}

static json_t *document(const struct canopy_surrogate *s) {
    json_t *object =
        json_pack("{s:s, s:i, s:s, s:s, s:o, s:o, s:[i,i], s:o, s:o}", "format", "canopy-surrogate", "version", 1,
                  "side", s->side == CANOPY_ABOVE ? "above" : "below", "scalar", s->scalar == CANOPY_F32 ? "f32" : "fx",
                  "unit", number(s->unit), "frame", frame(s), "size", (int)s->size[0], (int)s->size[1], "coefficients",
                  matrix(s->coefficients, s->size[0], s->size[1]), "lsb", number(s->lsb));
    if (object && s->window_count > 0) {
        json_object_set_new(object, "windows", windows(s));
    }
    if (object && s->trim) {
        json_object_set_new(object, "trim", trim(s));
    }
    if (object && s->certified) {
        json_object_set_new(object, "certificate",
                            json_pack("{s:o, s:o}", "margin", number(s->margin), "points", number(s->points)));
    }
    return object;
}

/// Opens and fills; nothing has its name yet.
static bool dump(const char *path, const struct canopy_surrogate *surrogate, struct canopy_output *output,
                 struct canopy_fault *fault) {
    if (!canopy_output_open(output, path, fault)) {
        return false;
    }
    json_t *object = document(surrogate);
    const int status = object ? json_dumpf(object, output->file, JSON_REAL_PRECISION(17) | JSON_COMPACT) : -1;
    json_decref(object);
    if (status != 0 || fputc('\n', output->file) == EOF) {
        canopy_output_abandon(output);
        return canopy_fault_set(fault, "%s: cannot write the surrogate: give -o a file system with room", path);
    }
    return true;
}

bool canopy_surrogate_write(const char *path, const struct canopy_surrogate *surrogate, struct canopy_fault *fault) {
    struct canopy_output output;
    return dump(path, surrogate, &output, fault) && canopy_output_commit(&output, fault);
}

bool canopy_surrogate_write_both(const char *const paths[2], const struct canopy_surrogate surrogates[2],
                                 struct canopy_fault *fault) {
    struct canopy_output first;
    struct canopy_output second;
    struct canopy_output *const both[2] = {&first, &second};
    if (!dump(paths[0], &surrogates[0], &first, fault)) {
        return false;
    }
    if (!dump(paths[1], &surrogates[1], &second, fault)) {
        canopy_output_abandon(&first);
        return false;
    }
    return canopy_output_commit_all(both, 2, fault);
}
