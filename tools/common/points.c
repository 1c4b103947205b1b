#include "tools/common/points.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "tools/common/las.h"
#include "tools/common/number.h"
#include "tools/common/pcd.h"
#include "tools/common/ply.h"
#include "tools/common/source.h"

static const struct {
    const char *ending;
    const char *start;
    canopy_points_reader *read;
} FORMATS[] = {{".ply", "ply\n", canopy_ply_read},  {".ply", "ply\r", canopy_ply_read},
               {".pcd", "# .PCD", canopy_pcd_read}, {".pcd", "VERSION", canopy_pcd_read},
               {".las", "LASF", canopy_las_read},   {".laz", "LASF", canopy_las_read}};

static bool ends_in(const char *path, const char *ending) {
    const size_t length = strlen(path);
    return length >= strlen(ending) && strcasecmp(path + length - strlen(ending), ending) == 0;
}

bool canopy_points_place(struct canopy_fault *fault, const char *path, bool by_line, uint64_t where) {
    const char *name = strcmp(path, "-") == 0 ? "standard input" : path;
    return by_line ? canopy_fault_prefix(fault, "%s:%" PRIu64, name, where)
                   : canopy_fault_prefix(fault, "%s: point %" PRIu64, name, where);
}

struct canopy_points_note canopy_points_skipped(const struct canopy_points_info *info) {
    struct canopy_points_note note = {""};
    if (info->skipped > 0) {
        snprintf(note.text, sizeof note.text, " (%" PRIu64 " more in the file %s)", info->skipped, info->why);
    }
    return note;
}

static const char *skip_blanks(const char *p) {
    while (*p == ' ' || *p == '\t' || *p == '\r' || *p == '\v' || *p == '\f') {
        p++;
    }
    return p;
}

/// A column separator: blanks with at most one comma or semicolon among them, which is the `mark`, ' ' if there is
/// none. Returns `p` itself if there is no separator.
static const char *skip_separator(const char *p, char *mark) {
    p = skip_blanks(p);
    *mark = ' ';
    if (*p == ',' || *p == ';') {
        *mark = *p;
        p = skip_blanks(p + 1);
    }
    return p;
}

static bool at_end(const char *p) { return *p == '\0' || *p == '#'; }

static bool bad_column(const char *field, enum canopy_number what, int column, struct canopy_fault *fault) {
    if (at_end(field)) {
        return canopy_fault_set(fault, "%d column%s: give x, y and z on every line", column, column == 1 ? "" : "s");
    }
    const int width = (int)strcspn(field, " \t,;#\r");
    return canopy_fault_set(fault, "'%.*s' in column %d %s: give three decimal numbers, or start a comment with #",
                            width > 40 ? 40 : width, field, column + 1, canopy_number_complaint(what));
}

/// The first three columns of a line that is not blank. Two separators on one line mean decimal commas (1,5;2,5;3,5 or
/// 1,5 2,5 3,5): read as columns they would be a wrong scene without a complaint.
static bool read_columns(const char *p, double point[3], struct canopy_fault *fault) {
    char first = ' ';
    for (int column = 0; column < 3; column++) {
        const char *end = p;
        char mark = ' ';
        const enum canopy_number what = canopy_number_read(p, &end, &point[column]);
        const char *next = skip_separator(end, &mark);
        if (what != CANOPY_NUMBER_OK || (next == end && !at_end(end))) {
            return bad_column(p, what == CANOPY_NUMBER_OK ? CANOPY_NUMBER_NONE : what, column, fault);
        }
        if (column == 0) {
            first = mark;
        } else if (mark != first && !at_end(next) && !(column == 2 && mark == ' ')) {
            return canopy_fault_set(fault, "two kinds of separator: give numbers with a decimal point, not a comma");
        }
        p = next;
    }
    return true;
}

/// One line, NUL-terminated at `end`.
static bool parse_line(const char *line, const char *end, uint64_t number, struct canopy_points_sink sink,
                       struct canopy_fault *fault) {
    double point[3];
    if (end - line > CANOPY_LINE_LIMIT) {
        return canopy_fault_set(fault, "line longer than %d bytes: this is not a text file of points",
                                CANOPY_LINE_LIMIT);
    }
    if (memchr(line, 0, (size_t)(end - line))) {
        return canopy_fault_set(fault, "a zero byte: this is not a text file of points (binary files are named .ply, "
                                       ".pcd or .las)");
    }
    const char *p = skip_blanks(line);
    return at_end(p) || (read_columns(p, point, fault) && sink.take(sink.context, point, number, fault));
}

bool canopy_points_parse(char *text, size_t size, bool first, struct canopy_points_sink sink, uint64_t *lines,
                         struct canopy_fault *fault) {
    char *const stop = text + size;
    *lines = 0;
    if (first && size >= 3 && memcmp(text, "\xef\xbb\xbf", 3) == 0) {
        text += 3;  // a byte order mark, as spreadsheets write it
    }
    while (text < stop) {
        char *end = memchr(text, '\n', (size_t)(stop - text));
        end = end ? end : stop;
        *end = '\0';
        ++*lines;
        if (!parse_line(text, end, *lines, sink, fault)) {
            return false;
        }
        text = end + 1;
    }
    return true;
}

struct counted {
    struct canopy_points_sink sink;
    uint64_t before;  ///< lines of the file before the text
    uint64_t count;
};

static bool take_counted(void *context, const double point[3], uint64_t where, struct canopy_fault *fault) {
    struct counted *counted = context;
    counted->count++;
    return counted->sink.take(counted->sink.context, point, counted->before + where, fault);
}

static bool read_text(struct canopy_source *source, struct canopy_points_sink sink, struct canopy_points_info *info,
                      struct canopy_fault *fault) {
    struct counted counted = {.sink = sink};
    char *text = NULL;
    size_t size = 0;
    enum canopy_source_state state;
    while ((state = canopy_source_lines(source, &text, &size, fault)) == CANOPY_SOURCE_OK) {
        uint64_t lines = 0;
        const bool first = source->offset == size;
        const bool ok =
            canopy_points_parse(text, size, first, (struct canopy_points_sink){&counted, take_counted}, &lines, fault);
        counted.before += lines;
        if (!ok) {
            return canopy_points_place(fault, source->name, true, counted.before);
        }
    }
    info->count = counted.count;
    source->line = counted.before;
    return state == CANOPY_SOURCE_END;
}

/// By its name, else by its first bytes.
bool canopy_points_find_reader(struct canopy_source *source, const char *path, canopy_points_reader **read,
                               struct canopy_fault *fault) {
    const size_t count = sizeof FORMATS / sizeof FORMATS[0];
    *read = NULL;
    for (size_t i = 0; i < count; i++) {
        if (ends_in(path, FORMATS[i].ending)) {
            *read = FORMATS[i].read;
            return true;
        }
    }
    size_t have = 8;
    const unsigned char *start = canopy_source_peek(source, &have, fault);
    for (size_t i = 0; start && !*read && i < count; i++) {
        const size_t length = strlen(FORMATS[i].start);
        *read = have >= length && memcmp(start, FORMATS[i].start, length) == 0 ? FORMATS[i].read : NULL;
    }
    return start != NULL;
}

bool canopy_points_none(const char *path, const struct canopy_points_info *info, uint64_t lines,
                        struct canopy_fault *fault) {
    canopy_fault_set(fault, info->skipped ? "no points but such as were not measured or are withheld: give others"
                                          : "no points: give a file with at least one");
    return canopy_points_place(fault, path, info->by_line, lines);
}

bool canopy_points_read(const char *path, struct canopy_points_sink sink, struct canopy_points_info *info,
                        struct canopy_fault *fault) {
    struct canopy_source source;
    canopy_points_reader *read = NULL;
    *info = (struct canopy_points_info){.count = 0, .by_line = true};
    if (!canopy_source_open(&source, path, fault)) {
        return false;
    }
    const bool ok =
        canopy_points_find_reader(&source, path, &read, fault) && (read ? read : read_text)(&source, sink, info, fault);
    const uint64_t line = source.line;
    canopy_source_close(&source);
    return ok && (info->count > 0 || canopy_points_none(path, info, line, fault));
}
