#include "tools/common/pcd.h"

#include <inttypes.h>
#include <liblzf/lzf.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tools/common/number.h"
#include "tools/common/value.h"

#define MAX_FIELDS 256
#define MAX_COUNT 65536  // values of one field; histograms have some hundreds

struct field {
    unsigned size;
    enum canopy_value kind;
    uint32_t count;
    uint32_t offset;  ///< of its first byte in a point, or of its first column in ASCII
    int axis;         ///< 0, 1, 2 for x, y, z; else -1
};

enum data { UNKNOWN, ASCII, BINARY, COMPRESSED };

struct reader {
    struct canopy_source *source;
    struct canopy_points_sink sink;
    struct canopy_points_info *info;
    struct canopy_fault *fault;
    struct field fields[MAX_FIELDS];
    unsigned field_count;
    bool has_fields, has_size, has_type, has_width, has_height, has_points;
    uint64_t width, height, points;
    enum data data;
    uint32_t bytes;    ///< of a point
    uint32_t columns;  ///< of a point
    unsigned at[3];    ///< the fields of x, y and z
};

// ---------------------------------------------------------------------------------------------------------------------
// Header

static bool line_fault(struct reader *reader, const char *what) {
    canopy_fault_set(reader->fault, "%s", what);
    return canopy_points_place(reader->fault, reader->source->name, true, reader->source->line);
}

/// The next word of a header line; NULL at its end.
static char *next_word(char **state) { return strtok_r(NULL, " \t", state); }

static bool read_fields(struct reader *reader, char **state) {
    if (reader->has_fields) {
        return line_fault(reader, "FIELDS twice in a PCD header: the file is damaged, write it anew");
    }
    for (char *word = next_word(state); word; word = next_word(state)) {
        if (reader->field_count == MAX_FIELDS) {
            return line_fault(reader, "more than 256 FIELDS: leave some out");
        }
        struct field *field = &reader->fields[reader->field_count++];
        *field = (struct field){.kind = CANOPY_NO_VALUE, .count = 1, .axis = -1};
        if (strlen(word) == 1 && *word >= 'x' && *word <= 'z') {
            field->axis = *word - 'x';
            reader->at[field->axis] = reader->field_count - 1;
        }
        for (const struct field *other = reader->fields; other < field; other++) {
            if (field->axis >= 0 && other->axis == field->axis) {
                return line_fault(reader, "a coordinate twice in FIELDS: give x, y and z once each");
            }
        }
    }
    reader->has_fields = true;
    return true;
}

/// SIZE, TYPE or COUNT: a word for each field.
static bool read_for_fields(struct reader *reader, char **state, const char *name) {
    unsigned i = 0;
    const char *word = next_word(state);
    for (; word && i < reader->field_count; word = next_word(state), i++) {
        struct field *field = &reader->fields[i];
        uint64_t number = 0;
        if (*name == 'T') {
            if (strlen(word) != 1 || !strchr("IUF", *word)) {
                return line_fault(reader, "unknown PCD TYPE: give I, U or F for each field");
            }
            field->kind = *word == 'I' ? CANOPY_INT8 : *word == 'U' ? CANOPY_UINT8 : CANOPY_FLOAT32;
        } else if (!canopy_number_whole(word, 1, *name == 'S' ? 8 : MAX_COUNT, &number) ||
                   (*name == 'S' && (number & (number - 1)) != 0)) {
            return line_fault(reader, *name == 'S' ? "bad PCD SIZE: give 1, 2, 4 or 8 for each field"
                                                   : "bad PCD COUNT: give a whole number from 1 to 65536 for each "
                                                     "field");
        } else if (*name == 'S') {
            field->size = (unsigned)number;
        } else {
            field->count = (uint32_t)number;
        }
    }
    reader->has_size = reader->has_size || *name == 'S';
    reader->has_type = reader->has_type || *name == 'T';
    return (i == reader->field_count && i > 0 && !word) ||
           line_fault(reader, "PCD header: give one value for each of the FIELDS, which come first");
}

static bool read_number(struct reader *reader, char **state, bool *has, uint64_t *to) {
    const char *word = next_word(state);
    const bool good = !*has && word && canopy_number_whole(word, 0, UINT32_MAX, to) && !next_word(state);
    *has = true;
    return good || line_fault(reader, "PCD WIDTH, HEIGHT or POINTS: give each once, a whole number below 4294967296");
}

static bool read_data(struct reader *reader, char **state) {
    const char *word = next_word(state);
    reader->data = !word                                    ? UNKNOWN
                   : strcmp(word, "ascii") == 0             ? ASCII
                   : strcmp(word, "binary") == 0            ? BINARY
                   : strcmp(word, "binary_compressed") == 0 ? COMPRESSED
                                                            : UNKNOWN;
    return (reader->data != UNKNOWN && !next_word(state)) ||
           line_fault(reader, "unknown PCD DATA: give ascii, binary or binary_compressed");
}

static bool read_version(struct reader *reader, char **state) {
    const char *word = next_word(state);
    const char *digit = word ? word + (*word == '0') : "";
    return (strcmp(digit, ".5") == 0 || strcmp(digit, ".6") == 0 || strcmp(digit, ".7") == 0) ||
           line_fault(reader, "PCD VERSION: .5, .6 and .7 are known: write the file anew as .7");
}

/// One header line; DATA is the last.
static bool header_line(struct reader *reader, char *line) {
    char *state = NULL;
    const char *word = strtok_r(line, " \t", &state);
    if (!word || *word == '#' || strcmp(word, "VIEWPOINT") == 0) {
        return true;
    }
    if (strcmp(word, "VERSION") == 0) {
        return read_version(reader, &state);
    }
    if (strcmp(word, "FIELDS") == 0 || strcmp(word, "COLUMNS") == 0) {
        return read_fields(reader, &state);
    }
    if (strcmp(word, "SIZE") == 0 || strcmp(word, "TYPE") == 0 || strcmp(word, "COUNT") == 0) {
        return read_for_fields(reader, &state, word);
    }
    if (strcmp(word, "WIDTH") == 0) {
        return read_number(reader, &state, &reader->has_width, &reader->width);
    }
    if (strcmp(word, "HEIGHT") == 0) {
        return read_number(reader, &state, &reader->has_height, &reader->height);
    }
    if (strcmp(word, "POINTS") == 0) {
        return read_number(reader, &state, &reader->has_points, &reader->points);
    }
    return strcmp(word, "DATA") == 0
               ? read_data(reader, &state)
               : line_fault(reader, "unknown PCD header line: give VERSION, FIELDS, SIZE, TYPE, COUNT, WIDTH, HEIGHT, "
                                    "VIEWPOINT, POINTS and DATA");
}

/// From what a field's TYPE and SIZE say apart to its kind.
static enum canopy_value kind_of(const struct field *field) {
    static const enum canopy_value WHOLE[9] = {
        [1] = CANOPY_INT8, [2] = CANOPY_INT16, [4] = CANOPY_INT32, [8] = CANOPY_INT64};
    if (field->kind == CANOPY_FLOAT32) {
        return field->size == 4 ? CANOPY_FLOAT32 : field->size == 8 ? CANOPY_FLOAT64 : CANOPY_NO_VALUE;
    }
    return (enum canopy_value)(WHOLE[field->size] + (field->kind == CANOPY_UINT8));
}

/// What the header says must make sense as a whole.
static bool check_header(struct reader *reader) {
    unsigned found = 0;
    if (!reader->has_fields || !reader->has_size || !reader->has_type || !reader->has_width) {
        return line_fault(reader, "PCD header without FIELDS, SIZE, TYPE or WIDTH before DATA: write the file anew");
    }
    for (unsigned i = 0; i < reader->field_count; i++) {
        struct field *field = &reader->fields[i];
        field->kind = kind_of(field);
        field->offset = reader->data == ASCII ? reader->columns : reader->bytes;
        found += field->axis >= 0 && field->count == 1;
        reader->bytes += field->size * field->count;
        reader->columns += field->count;
        if (field->kind == CANOPY_NO_VALUE) {
            return line_fault(reader, "a PCD field of TYPE F and SIZE 1 or 2: give 4 or 8");
        }
    }
    reader->height = reader->has_height ? reader->height : 1;
    if (!reader->has_points) {
        reader->points = reader->width * reader->height;
    }
    if (found != 3) {
        return line_fault(reader, "PCD without single fields x, y and z: export it as a point cloud");
    }
    if (reader->width * reader->height != reader->points || reader->points > UINT32_MAX) {  // each below 2^32
        return line_fault(reader, "PCD POINTS is not WIDTH times HEIGHT, or beyond 4294967295: the file is damaged, "
                                  "write it anew");
    }
    return reader->bytes <= CANOPY_LINE_LIMIT ||
           line_fault(reader, "a PCD point of more than 65536 bytes: leave some fields out");
}

static bool read_header(struct reader *reader) {
    enum canopy_source_state state = CANOPY_SOURCE_OK;
    while (state == CANOPY_SOURCE_OK && reader->data == UNKNOWN) {
        char *line = NULL;
        state = canopy_source_line(reader->source, &line, reader->fault);
        if (state == CANOPY_SOURCE_OK && !header_line(reader, line)) {
            return false;
        }
    }
    if (state == CANOPY_SOURCE_END) {
        return line_fault(reader, "PCD header without a DATA line: the file is truncated, or no PCD");
    }
    return state == CANOPY_SOURCE_OK && check_header(reader);
}

// ---------------------------------------------------------------------------------------------------------------------
// Points

static bool take(struct reader *reader, const double point[3], uint64_t where) {
    if (!isfinite(point[0]) || !isfinite(point[1]) || !isfinite(point[2])) {
        reader->info->skipped++;
        return true;
    }
    reader->info->count++;
    return reader->sink.take(reader->sink.context, point, where, reader->fault) ||
           canopy_points_place(reader->fault, reader->source->name, reader->info->by_line, where);
}

/// A coordinate from its bytes. A whole number that no double holds is not rounded in silence.
static bool coordinate(struct reader *reader, const unsigned char *bytes, int axis, uint64_t where, double *to) {
    const enum canopy_value kind = reader->fields[reader->at[axis]].kind;
    *to = canopy_value_real(bytes, kind, false);
    if ((kind == CANOPY_INT64 || kind == CANOPY_UINT64) && !(fabs(*to) <= 0x1p53)) {
        canopy_fault_set(reader->fault, "%.17g is beyond 2^53, where doubles are no longer exact: move the origin",
                         *to);
        return canopy_points_place(reader->fault, reader->source->name, false, where);
    }
    return true;
}

static bool read_binary(struct reader *reader) {
    for (uint64_t i = 0; i < reader->points; i++) {
        const unsigned char *bytes = canopy_source_bytes(reader->source, reader->bytes, reader->fault);
        double point[3];
        if (!bytes) {
            const struct canopy_fault why = *reader->fault;
            return canopy_fault_set(reader->fault, "%s (in point %" PRIu64 " of %" PRIu64 ")", why.text, i + 1,
                                    reader->points);
        }
        for (int k = 0; k < 3; k++) {
            if (!coordinate(reader, bytes + reader->fields[reader->at[k]].offset, k, i + 1, &point[k])) {
                return false;
            }
        }
        if (!take(reader, point, i + 1)) {
            return false;
        }
    }
    return true;
}

/// `count` bytes of the source in memory of their own, which grows with what is there, not with what is announced.
static unsigned char *read_whole(struct reader *reader, uint64_t count) {
    unsigned char *whole = NULL;
    size_t room = 0;
    for (size_t have = 0; have < count;) {
        const size_t part = count - have < CANOPY_LINE_LIMIT ? (size_t)(count - have) : CANOPY_LINE_LIMIT;
        const unsigned char *bytes = canopy_source_bytes(reader->source, part, reader->fault);
        if (bytes && have + part > room) {
            room = room ? room * 2 : (size_t)CANOPY_LINE_LIMIT * 4;
            unsigned char *larger = realloc(whole, room);
            if (!larger) {
                canopy_fault_set(reader->fault, "%s: out of memory: write it as DATA binary, which needs none",
                                 reader->source->name);
                bytes = NULL;
            }
            whole = larger ? larger : whole;
        }
        if (!bytes) {
            free(whole);
            return NULL;
        }
        memcpy(whole + have, bytes, part);
        have += part;
    }
    return whole;
}

/// All values of the first field, then all of the second, and so on.
static bool take_unpacked(struct reader *reader, const unsigned char *unpacked) {
    for (uint64_t i = 0; i < reader->points; i++) {
        double point[3];
        for (int k = 0; k < 3; k++) {
            const struct field *field = &reader->fields[reader->at[k]];
            if (!coordinate(reader, unpacked + field->offset * reader->points + i * field->size, k, i + 1, &point[k])) {
                return false;
            }
        }
        if (!take(reader, point, i + 1)) {
            return false;
        }
    }
    return true;
}

static bool read_compressed(struct reader *reader) {
    const unsigned char *sizes = canopy_source_bytes(reader->source, 8, reader->fault);
    if (!sizes) {
        return false;
    }
    const uint64_t packed_size = canopy_value_whole(sizes, 4, false);
    const uint64_t size = canopy_value_whole(sizes + 4, 4, false);
    // Three bytes of LZF unpack to 264 at most: no damaged number asks for more memory than that.
    if (size != reader->bytes * reader->points || size > packed_size * 88 || packed_size == 0) {
        return canopy_fault_set(reader->fault,
                                "%s: byte %" PRIu64 ": %" PRIu64 " packed bytes for %" PRIu64 " of %" PRIu64
                                " points: the file is damaged, write it anew",
                                reader->source->name, reader->source->offset, packed_size, size, reader->points);
    }
    unsigned char *packed = read_whole(reader, packed_size);
    unsigned char *unpacked = packed ? malloc((size_t)size) : NULL;
    bool ok = packed != NULL;
    if (ok && !unpacked) {
        ok = canopy_fault_set(reader->fault, "%s: out of memory: write it as DATA binary, which needs none",
                              reader->source->name);
    } else if (ok && lzf_decompress(packed, (unsigned)packed_size, unpacked, (unsigned)size) != size) {
        ok = canopy_fault_set(reader->fault,
                              "%s: byte %" PRIu64 ": the compressed points cannot be unpacked: the file is damaged, "
                              "write it anew",
                              reader->source->name, reader->source->offset - packed_size);
    }
    free(packed);
    ok = ok && take_unpacked(reader, unpacked);
    free(unpacked);
    return ok;
}

/// A line's columns: those of x, y and z must be numbers, nan or inf.
static bool ascii_point(struct reader *reader, char *line, double point[3]) {
    char *state = NULL;
    uint32_t column = 0;
    for (char *word = strtok_r(line, " \t", &state); word; word = next_word(&state), column++) {
        for (int k = 0; k < 3; k++) {
            if (column != reader->fields[reader->at[k]].offset) {
                continue;
            }
            const char *end = word;
            const enum canopy_number what = canopy_number_read(word, &end, &point[k]);
            if (what == CANOPY_NUMBER_NOT_FINITE) {
                point[k] = nan("");
            } else if (what != CANOPY_NUMBER_OK || *end != '\0') {
                canopy_fault_set(reader->fault, "'%.40s' %s: give decimal numbers, or nan where nothing was measured",
                                 word, canopy_number_complaint(what == CANOPY_NUMBER_OK ? CANOPY_NUMBER_NONE : what));
                return canopy_points_place(reader->fault, reader->source->name, true, reader->source->line);
            }
        }
    }
    return column == reader->columns ||
           line_fault(reader, column < reader->columns
                                  ? "fewer values than the PCD header declares: the file is truncated or damaged"
                                  : "more values than the PCD header declares: the file is damaged, copy it anew");
}

static bool read_ascii(struct reader *reader) {
    for (uint64_t i = 0; i < reader->points;) {
        char *line = NULL;
        double point[3] = {0.0, 0.0, 0.0};
        const enum canopy_source_state state = canopy_source_line(reader->source, &line, reader->fault);
        if (state == CANOPY_SOURCE_END) {
            canopy_fault_set(reader->fault,
                             "the file ends after point %" PRIu64 " of %" PRIu64 ": it is truncated, copy it anew", i,
                             reader->points);
            return canopy_points_place(reader->fault, reader->source->name, true, reader->source->line);
        }
        if (state == CANOPY_SOURCE_FAULT) {
            return false;
        }
        if (line[strspn(line, " \t")] == '\0') {
            continue;
        }
        if (!ascii_point(reader, line, point) || !take(reader, point, reader->source->line)) {
            return false;
        }
        i++;
    }
    return true;
}

bool canopy_pcd_read(struct canopy_source *source, struct canopy_points_sink sink, struct canopy_points_info *info,
                     struct canopy_fault *fault) {
    struct reader *reader = calloc(1, sizeof *reader);
    if (!reader) {
        return canopy_fault_set(fault, "%s: out of memory: close other programs", source->name);
    }
    *reader = (struct reader){.source = source, .sink = sink, .info = info, .fault = fault};
    info->why = "were not measured";
    bool ok = read_header(reader);
    if (ok) {
        info->by_line = reader->data == ASCII;
        ok = reader->points == 0 || (reader->data == ASCII    ? read_ascii(reader)
                                     : reader->data == BINARY ? read_binary(reader)
                                                              : read_compressed(reader));
    }
    free(reader);
    return ok;
}
