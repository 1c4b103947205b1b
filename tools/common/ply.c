#include "tools/common/ply.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "tools/common/number.h"
#include "tools/common/value.h"

#define MAX_ELEMENTS 64
#define MAX_PROPERTIES 256
#define NAME_SIZE 64

static const struct {
    const char *name;
    const char *alias;
} TYPES[] = {{"char", "int8"}, {"uchar", "uint8"}, {"short", "int16"},   {"ushort", "uint16"},
             {"int", "int32"}, {"uint", "uint32"}, {"float", "float32"}, {"double", "float64"}};

struct property {
    enum canopy_value type;
    enum canopy_value count_type;  ///< CANOPY_NO_VALUE for a scalar
    int axis;                      ///< 0, 1, 2 for a vertex's x, y, z; else -1
};

struct element {
    char name[NAME_SIZE];
    uint64_t count;
    unsigned first;  ///< its properties in the header's table
    unsigned properties;
    bool points;  ///< this is the vertex element
};

struct header {
    enum { UNKNOWN, ASCII, LITTLE, BIG } format;
    struct element elements[MAX_ELEMENTS];
    unsigned element_count;
    struct property properties[MAX_PROPERTIES];
    unsigned property_count;
};

struct reader {
    struct canopy_source *source;
    struct canopy_points_sink sink;
    struct header header;
    struct canopy_fault *fault;
};

static enum canopy_value type_of(const char *word) {
    for (unsigned i = 0; i < sizeof TYPES / sizeof TYPES[0]; i++) {
        if (strcmp(word, TYPES[i].name) == 0 || strcmp(word, TYPES[i].alias) == 0) {
            return (enum canopy_value)i;
        }
    }
    return CANOPY_NO_VALUE;
}

static bool header_fault(struct reader *reader, const char *what) {
    canopy_fault_set(reader->fault, "%s", what);
    return canopy_points_place(reader->fault, reader->source->name, true, reader->source->line);
}

static bool add_format(struct reader *reader, char *const *words, int count) {
    if (count != 3 || strcmp(words[2], "1.0") != 0 || reader->header.format != UNKNOWN) {
        return header_fault(reader,
                            "PLY format line: give one 'format ascii|binary_little_endian|binary_big_endian 1.0'");
    }
    reader->header.format = strcmp(words[1], "ascii") == 0                  ? ASCII
                            : strcmp(words[1], "binary_little_endian") == 0 ? LITTLE
                            : strcmp(words[1], "binary_big_endian") == 0    ? BIG
                                                                            : UNKNOWN;
    return reader->header.format != UNKNOWN ||
           header_fault(reader, "unknown PLY format: give ascii, binary_little_endian or binary_big_endian");
}

static bool add_element(struct reader *reader, char *const *words, int count) {
    struct header *header = &reader->header;
    if (count != 3 || strlen(words[1]) >= NAME_SIZE || header->element_count == MAX_ELEMENTS) {
        return header_fault(reader, "PLY element line: give 'element NAME COUNT', at most 64 of them");
    }
    char *end = NULL;
    const uint64_t number = strtoull(words[2], &end, 10);
    if (*end || words[2][0] < '0' || words[2][0] > '9' || number > UINT32_MAX) {
        return header_fault(reader, "PLY element count: give a whole number below 4294967296");
    }
    struct element *element = &header->elements[header->element_count++];
    *element = (struct element){.count = number, .first = header->property_count};
    strcpy(element->name, words[1]);
    element->points = strcmp(words[1], "vertex") == 0;
    for (const struct element *other = header->elements; other < element; other++) {
        if (strcmp(other->name, element->name) == 0) {
            return header_fault(reader, "PLY element declared twice: give each element one name of its own");
        }
    }
    return true;
}

static bool add_property(struct reader *reader, char *const *words, int count) {
    struct header *header = &reader->header;
    const bool list = count == 5 && strcmp(words[1], "list") == 0;
    if (header->element_count == 0 || (!list && count != 3) || header->property_count == MAX_PROPERTIES) {
        return header_fault(reader, "PLY property line: give 'property TYPE NAME' or 'property list TYPE TYPE NAME' "
                                    "after an element, at most 256");
    }
    const enum canopy_value type = type_of(words[list ? 3 : 1]);
    const enum canopy_value count_type = list ? type_of(words[2]) : CANOPY_NO_VALUE;
    if (type == CANOPY_NO_VALUE || (list && count_type >= CANOPY_FLOAT32)) {
        return header_fault(
            reader,
            "unknown PLY type: give char uchar short ushort int uint float double, a list's count as a whole number");
    }
    struct element *element = &header->elements[header->element_count - 1];
    struct property *property = &header->properties[header->property_count++];
    *property = (struct property){.type = type, .count_type = count_type, .axis = -1};
    const char *name = words[list ? 4 : 2];
    if (element->points && strlen(name) == 1 && *name >= 'x' && *name <= 'z') {
        property->axis = *name - 'x';
        for (unsigned i = 0; i < element->properties; i++) {
            if (header->properties[element->first + i].axis == property->axis) {
                return header_fault(reader, "vertex property declared twice: give x, y and z once each");
            }
        }
        if (list) {
            return header_fault(reader, "vertex property x, y or z is a list: give scalars");
        }
    }
    element->properties++;
    return true;
}

static int split(char *line, char *words[], int limit) {
    int count = 0;
    char *state = NULL;
    for (char *word = strtok_r(line, " \t", &state); word; word = strtok_r(NULL, " \t", &state)) {
        if (count < limit) {
            words[count] = word;
        }
        count++;
    }
    return count;
}

/// One header line; `*done` after end_header.
static bool header_line(struct reader *reader, char *line, bool *done) {
    char *words[6] = {NULL};
    const int count = split(line, words, 6);
    if (count == 0 || strcmp(words[0], "comment") == 0 || strcmp(words[0], "obj_info") == 0) {
        return true;
    }
    if (strcmp(words[0], "format") == 0) {
        return add_format(reader, words, count);
    }
    if (strcmp(words[0], "element") == 0) {
        return add_element(reader, words, count);
    }
    if (strcmp(words[0], "property") == 0) {
        return add_property(reader, words, count);
    }
    *done = strcmp(words[0], "end_header") == 0;
    return *done ||
           header_fault(reader, "unknown PLY header line: give format, element, property, comment or end_header");
}

/// The vertex element must have its three coordinates.
static bool check_vertices(struct reader *reader) {
    const struct header *header = &reader->header;
    unsigned found = 0;
    for (unsigned i = 0; i < header->property_count; i++) {
        found += header->properties[i].axis >= 0;
    }
    if (header->format == UNKNOWN) {
        return header_fault(reader, "PLY header without a format line: give 'format ascii 1.0' or a binary one");
    }
    return found == 3 ||
           header_fault(reader, "PLY without x, y and z in an element 'vertex': export it as a point cloud");
}

static bool read_header(struct reader *reader) {
    char *line = NULL;
    bool done = false;
    enum canopy_source_state state = canopy_source_line(reader->source, &line, reader->fault);
    if (state == CANOPY_SOURCE_END) {
        return canopy_fault_set(reader->fault, "%s:0: empty file: give a PLY file with vertices", reader->source->name);
    }
    if (state == CANOPY_SOURCE_OK && strcmp(line, "ply") != 0) {
        return header_fault(reader, "does not begin with 'ply': name text points .xyz or .csv");
    }
    while (state == CANOPY_SOURCE_OK && !done) {
        state = canopy_source_line(reader->source, &line, reader->fault);
        if (state == CANOPY_SOURCE_OK && !header_line(reader, line, &done)) {
            return false;
        }
    }
    if (state == CANOPY_SOURCE_END) {
        return header_fault(reader, "PLY header without end_header: the file is truncated, copy it anew");
    }
    return state == CANOPY_SOURCE_OK && check_vertices(reader);
}

static bool binary_fault(struct reader *reader, const struct element *element, uint64_t index) {
    const struct canopy_fault why = *reader->fault;
    return canopy_fault_set(reader->fault, "%s (in %s %" PRIu64 " of %" PRIu64 ")", why.text, element->name, index + 1,
                            element->count);
}

/// One instance of an element; point[] is set where the element has coordinates.
static bool binary_instance(struct reader *reader, const struct element *element, double point[3]) {
    const bool big = reader->header.format == BIG;
    const struct property *property = &reader->header.properties[element->first];
    for (const struct property *last = property + element->properties; property < last; property++) {
        const bool list = property->count_type != CANOPY_NO_VALUE;
        const enum canopy_value type = list ? property->count_type : property->type;
        const unsigned char *bytes = canopy_source_bytes(reader->source, canopy_value_size(type), reader->fault);
        if (!bytes) {
            return false;
        }
        const double value = canopy_value_real(bytes, type, big);
        if (list) {
            if (value < 0) {
                return canopy_fault_set(
                    reader->fault, "%s: byte %" PRIu64 ": a list of negative length: the file is damaged, copy it anew",
                    reader->source->name, reader->source->offset);
            }
            if (!canopy_source_skip(reader->source, (uint64_t)value * canopy_value_size(property->type),
                                    reader->fault)) {
                return false;
            }
        } else if (property->axis >= 0) {
            point[property->axis] = value;
        }
    }
    return true;
}

static bool take(struct reader *reader, const double point[3], uint64_t where, bool by_line) {
    if (!isfinite(point[0]) || !isfinite(point[1]) || !isfinite(point[2])) {
        canopy_fault_set(reader->fault, "a coordinate is not finite: remove the vertices without a measurement");
    } else if (reader->sink.take(reader->sink.context, point, where, reader->fault)) {
        return true;
    }
    return canopy_points_place(reader->fault, reader->source->name, by_line, where);
}

static bool read_binary(struct reader *reader, const struct element *element, uint64_t *count) {
    for (uint64_t i = 0; i < element->count; i++) {
        double point[3] = {0.0, 0.0, 0.0};
        if (!binary_instance(reader, element, point)) {
            return binary_fault(reader, element, i);
        }
        if (element->points) {
            if (!take(reader, point, i + 1, false)) {
                return false;
            }
            ++*count;
        }
    }
    return true;
}

/// The next number of an ASCII line; `*text` moves behind it.
static bool ascii_number(struct reader *reader, const char **text, double *value) {
    const char *p = *text + strspn(*text, " \t");
    const char *end = p;
    const enum canopy_number what = canopy_number_read(p, &end, value);
    const bool closed = *end == '\0' || *end == ' ' || *end == '\t';
    if (what == CANOPY_NUMBER_OK && closed) {
        *text = end;
        return true;
    }
    if (*p == '\0') {
        return header_fault(
            reader, "fewer values than the PLY header declares: the file is truncated or damaged, copy it anew");
    }
    const int width = (int)strcspn(p, " \t");
    canopy_fault_set(reader->fault, "'%.*s' %s: give decimal numbers", width > 40 ? 40 : width, p,
                     canopy_number_complaint(what == CANOPY_NUMBER_OK ? CANOPY_NUMBER_NONE : what));
    return canopy_points_place(reader->fault, reader->source->name, true, reader->source->line);
}

static bool ascii_instance(struct reader *reader, const struct element *element, const char *line, double point[3]) {
    const struct property *property = &reader->header.properties[element->first];
    for (const struct property *last = property + element->properties; property < last; property++) {
        double value = 0.0;
        if (!ascii_number(reader, &line, &value)) {
            return false;
        }
        if (property->count_type != CANOPY_NO_VALUE) {
            for (double left = value; left >= 1.0; left -= 1.0) {
                if (!ascii_number(reader, &line, &value)) {
                    return false;
                }
            }
        } else if (property->axis >= 0) {
            point[property->axis] = value;
        }
    }
    line += strspn(line, " \t");
    return *line == '\0' ||
           header_fault(reader, "more values than the PLY header declares: the file is damaged, copy it anew");
}

static bool read_ascii(struct reader *reader, const struct element *element, uint64_t *count) {
    for (uint64_t i = 0; i < element->count; i++) {
        char *line = NULL;
        enum canopy_source_state state = CANOPY_SOURCE_OK;
        do {
            state = canopy_source_line(reader->source, &line, reader->fault);
        } while (state == CANOPY_SOURCE_OK && element->properties > 0 && line[strspn(line, " \t")] == '\0');
        if (state == CANOPY_SOURCE_END) {
            canopy_fault_set(reader->fault,
                             "the file ends after %s %" PRIu64 " of %" PRIu64 ": it is truncated, copy it anew",
                             element->name, i, element->count);
            return canopy_points_place(reader->fault, reader->source->name, true, reader->source->line);
        }
        double point[3] = {0.0, 0.0, 0.0};
        if (state == CANOPY_SOURCE_FAULT || !ascii_instance(reader, element, line, point)) {
            return false;
        }
        if (element->points) {
            if (!take(reader, point, reader->source->line, true)) {
                return false;
            }
            ++*count;
        }
    }
    return true;
}

bool canopy_ply_read(struct canopy_source *source, struct canopy_points_sink sink, struct canopy_points_info *info,
                     struct canopy_fault *fault) {
    struct reader reader = {.source = source, .sink = sink, .fault = fault};
    if (!read_header(&reader)) {
        return false;
    }
    info->by_line = reader.header.format == ASCII;
    for (unsigned i = 0; i < reader.header.element_count; i++) {
        const struct element *element = &reader.header.elements[i];
        if (element->properties == 0) {
            continue;  // nothing of it is in the file, however many the header counts
        }
        if (!(info->by_line ? read_ascii : read_binary)(&reader, element, &info->count)) {
            return false;
        }
    }
    return true;
}
