#include "tools/common/points.h"

#include <inttypes.h>
#include <string.h>
#include <strings.h>

#include "tools/common/number.h"
#include "tools/common/ply.h"
#include "tools/common/source.h"

static bool ends_in_ply(const char *path) {
    const size_t length = strlen(path);
    return length >= 4 && strcasecmp(path + length - 4, ".ply") == 0;
}

bool canopy_points_place(struct canopy_fault *fault, const char *path, bool by_line, uint64_t where) {
    const char *name = strcmp(path, "-") == 0 ? "standard input" : path;
    return by_line ? canopy_fault_prefix(fault, "%s:%" PRIu64, name, where)
                   : canopy_fault_prefix(fault, "%s: vertex %" PRIu64, name, where);
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

static bool read_text(struct canopy_source *source, struct canopy_points_sink sink, uint64_t *count,
                      struct canopy_fault *fault) {
    char *line = NULL;
    enum canopy_source_state state = canopy_source_line(source, &line, fault);
    if (state == CANOPY_SOURCE_OK && strncmp(line, "\xef\xbb\xbf", 3) == 0) {
        line += 3;  // a byte order mark, as spreadsheets write it
    }
    for (; state == CANOPY_SOURCE_OK; state = canopy_source_line(source, &line, fault)) {
        const char *p = skip_blanks(line);
        if (at_end(p)) {
            continue;
        }
        double point[3];
        if (!read_columns(p, point, fault) || !sink.take(sink.context, point, source->line, fault)) {
            return canopy_points_place(fault, source->name, true, source->line);
        }
        ++*count;
    }
    return state == CANOPY_SOURCE_END;
}

bool canopy_points_read(const char *path, struct canopy_points_sink sink, struct canopy_points_info *info,
                        struct canopy_fault *fault) {
    struct canopy_source source;
    *info = (struct canopy_points_info){.count = 0, .by_line = true};
    if (!canopy_source_open(&source, path, fault)) {
        return false;
    }
    const bool ok =
        ends_in_ply(path) ? canopy_ply_read(&source, sink, info, fault) : read_text(&source, sink, &info->count, fault);
    const uint64_t line = source.line;
    canopy_source_close(&source);
    if (ok && info->count == 0) {
        return canopy_fault_set(fault, "%s:%" PRIu64 ": no points: give a file with at least one line of x y z",
                                strcmp(path, "-") == 0 ? "standard input" : path, line);
    }
    return ok;
}
