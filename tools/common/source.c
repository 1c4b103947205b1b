#include "tools/common/source.h"

#include <errno.h>
#include <inttypes.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#define BUFFER_SIZE (1024 * 1024)

/// Standard input that is a file is read from where it stood when the program began, however often.
static void rewind_standard(void) {
    static off_t begin = -1;
    if (begin < 0) {
        begin = ftello(stdin);
    } else {
        fseeko(stdin, begin, SEEK_SET);
    }
}

bool canopy_source_open(struct canopy_source *source, const char *path, struct canopy_fault *fault) {
    const bool standard = strcmp(path, "-") == 0;
    memset(source, 0, sizeof *source);
    source->name = standard ? "standard input" : path;
    source->file = standard ? stdin : fopen(path, "rb");
    if (!source->file) {
        return canopy_fault_set(fault, "%s: %s: give a point file that exists and can be read, or - for standard input",
                                path, strerror(errno));
    }
    struct stat status = {.st_mode = 0};
    if (fstat(fileno(source->file), &status) == 0 && S_ISDIR(status.st_mode)) {
        canopy_source_close(source);
        return canopy_fault_set(fault, "%s: is a directory: give a file in it", path);
    }
    if (standard && S_ISREG(status.st_mode)) {
        rewind_standard();
    }
    source->size = S_ISREG(status.st_mode) ? (double)status.st_size : 0.0;
    source->buffer = malloc(BUFFER_SIZE);
    if (!source->buffer) {
        canopy_source_close(source);
        return canopy_fault_set(fault, "%s: out of memory: close other programs", path);
    }
    return true;
}

void canopy_source_close(struct canopy_source *source) {
    if (source->file && source->file != stdin) {
        fclose(source->file);
    }
    free(source->buffer);
    source->file = NULL;
    source->buffer = NULL;
}

/// Moves what is left to the front and reads more behind it. One byte stays free for a terminating NUL.
static bool refill(struct canopy_source *source, struct canopy_fault *fault) {
    memmove(source->buffer, source->buffer + source->begin, source->end - source->begin);
    source->end -= source->begin;
    source->begin = 0;
    const size_t got = fread(source->buffer + source->end, 1, BUFFER_SIZE - 1 - source->end, source->file);
    source->end += got;
    if (got == 0) {
        source->ended = true;
        if (ferror(source->file)) {
            return canopy_fault_set(fault,
                                    "%s: byte %" PRIu64 ": %s: the file cannot be read any further; copy it anew",
                                    source->name, source->offset, strerror(errno));
        }
    }
    return true;
}

enum canopy_source_state canopy_source_line(struct canopy_source *source, char **line, struct canopy_fault *fault) {
    size_t searched = 0;
    char *stop = NULL;
    for (;;) {
        char *start = source->buffer + source->begin;
        const size_t have = source->end - source->begin;
        stop = memchr(start + searched, '\n', have - searched);
        searched = have;
        if (stop || source->ended || have > CANOPY_LINE_LIMIT) {
            break;
        }
        if (!refill(source, fault)) {
            return CANOPY_SOURCE_FAULT;
        }
    }
    char *start = source->buffer + source->begin;
    if (!stop && searched == 0) {
        return CANOPY_SOURCE_END;
    }
    const size_t length = stop ? (size_t)(stop - start) : searched;
    source->line++;
    if (length > CANOPY_LINE_LIMIT) {
        canopy_fault_set(fault, "%s:%" PRIu64 ": line longer than %d bytes: this is not a text file of points",
                         source->name, source->line, CANOPY_LINE_LIMIT);
        return CANOPY_SOURCE_FAULT;
    }
    if (memchr(start, 0, length)) {
        canopy_fault_set(fault,
                         "%s:%" PRIu64
                         ": a zero byte: this is not a text file of points (binary files are named .ply, .pcd or .las)",
                         source->name, source->line);
        return CANOPY_SOURCE_FAULT;
    }
    start[length] = '\0';
    if (length > 0 && start[length - 1] == '\r') {
        start[length - 1] = '\0';
    }
    source->begin += length + (stop != NULL);
    source->offset += length + (stop != NULL);
    *line = start;
    return CANOPY_SOURCE_OK;
}

enum canopy_source_state canopy_source_lines(struct canopy_source *source, char **lines, size_t *size,
                                             struct canopy_fault *fault) {
    while (!source->ended && source->end - source->begin < BUFFER_SIZE - 1) {
        if (!refill(source, fault)) {
            return CANOPY_SOURCE_FAULT;
        }
    }
    char *start = source->buffer + source->begin;
    const size_t have = source->end - source->begin;
    const char *stop = source->ended ? NULL : memrchr(start, '\n', have);
    if (have == 0) {
        return CANOPY_SOURCE_END;
    }
    *size = stop ? (size_t)(stop + 1 - start) : have;
    *lines = start;
    source->begin += *size;
    source->offset += *size;
    return CANOPY_SOURCE_OK;
}

double canopy_source_part(const struct canopy_source *source) {
    return source->size > 0.0 ? (double)source->offset / source->size : -1.0;
}

const unsigned char *canopy_source_bytes(struct canopy_source *source, size_t count, struct canopy_fault *fault) {
    while (source->end - source->begin < count) {
        if (!source->ended && !refill(source, fault)) {
            return NULL;
        }
        if (source->ended && source->end - source->begin < count) {
            canopy_fault_set(fault, "%s: byte %" PRIu64 ": the file ends too early: it is truncated, copy it anew",
                             source->name, source->offset + (source->end - source->begin));
            return NULL;
        }
    }
    const unsigned char *bytes = (const unsigned char *)source->buffer + source->begin;
    source->begin += count;
    source->offset += count;
    return bytes;
}

bool canopy_source_skip(struct canopy_source *source, uint64_t count, struct canopy_fault *fault) {
    while (count > 0) {
        const size_t part = count < CANOPY_LINE_LIMIT ? (size_t)count : CANOPY_LINE_LIMIT;
        if (!canopy_source_bytes(source, part, fault)) {
            return false;
        }
        count -= part;
    }
    return true;
}

const unsigned char *canopy_source_peek(struct canopy_source *source, size_t *count, struct canopy_fault *fault) {
    while (!source->ended && source->end - source->begin < *count) {
        if (!refill(source, fault)) {
            return NULL;
        }
    }
    const size_t have = source->end - source->begin;
    *count = have < *count ? have : *count;
    return (const unsigned char *)source->buffer + source->begin;
}
