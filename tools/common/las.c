#include "tools/common/las.h"

#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "tools/common/value.h"

#define HEADER_SIZE 227     // of LAS 1.0 to 1.2, in bytes
#define HEADER_SIZE_14 375  // of LAS 1.4

// Where the header has what is used of it (LAS 1.4 R15, table 3)
enum {
    AT_MINOR = 25,
    AT_HEADER_SIZE = 94,
    AT_DATA = 96,
    AT_FORMAT = 104,
    AT_RECORD = 105,
    AT_COUNT = 107,
    AT_SCALE = 131,
    AT_OFFSET = 155,
    AT_COUNT_14 = 247
};

struct reader {
    struct canopy_source *source;
    struct canopy_fault *fault;
    unsigned format;
    uint32_t record;  ///< bytes of a point
    uint64_t count;
    double scale[3];
    double offset[3];
};

static bool file_fault(const struct reader *reader, const char *what) {
    return canopy_fault_set(reader->fault, "%s: %s", reader->source->name, what);
}

/// Fewest bytes of a point of each format.
static const unsigned char RECORD[] = {20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67};

static bool read_scales(struct reader *reader, const unsigned char *header) {
    for (unsigned k = 0; k < 3; k++) {
        reader->scale[k] = canopy_value_real(header + AT_SCALE + 8 * k, CANOPY_FLOAT64, false);
        reader->offset[k] = canopy_value_real(header + AT_OFFSET + 8 * k, CANOPY_FLOAT64, false);
        if (!isfinite(reader->scale[k]) || !isfinite(reader->offset[k]) || reader->scale[k] == 0.0) {
            return file_fault(reader,
                              "byte 131: a LAS scale of zero, or a scale or offset that is not finite: the file "
                              "is damaged, copy it anew");
        }
    }
    return true;
}

/// The first 227 bytes, which all versions have. `*size` and `*data`: bytes of the header, and where points begin.
static bool read_common(struct reader *reader, const unsigned char *header, uint32_t *size, uint32_t *data) {
    if (memcmp(header, "LASF", 4) != 0) {
        return file_fault(reader, "byte 0: does not begin with 'LASF': name text points .xyz or .csv");
    }
    if (header[AT_MINOR - 1] != 1 || header[AT_MINOR] > 4) {
        return file_fault(reader, "byte 24: an unknown version of LAS: write the file anew as 1.4");
    }
    reader->format = header[AT_FORMAT];
    if (reader->format & 0xc0U) {
        return file_fault(reader, "byte 104: compressed (LAZ), which no library of Debian 12 unpacks: unpack it with "
                                  "'laszip -i IN.laz -o OUT.las' or 'pdal translate IN.laz OUT.las'");
    }
    if (reader->format >= sizeof RECORD) {
        return file_fault(reader, "byte 104: an unknown LAS point format: 0 to 10 are known");
    }
    reader->record = (uint32_t)canopy_value_whole(header + AT_RECORD, 2, false);
    reader->count = canopy_value_whole(header + AT_COUNT, 4, false);
    *size = (uint32_t)canopy_value_whole(header + AT_HEADER_SIZE, 2, false);
    *data = (uint32_t)canopy_value_whole(header + AT_DATA, 4, false);
    const uint32_t least = header[AT_MINOR] == 4 ? HEADER_SIZE_14 : HEADER_SIZE;
    if (*size < least || *data < *size || reader->record < RECORD[reader->format]) {
        return file_fault(reader, "byte 94: LAS sizes of header, start of points or point that cannot be: the file is "
                                  "damaged, copy it anew");
    }
    return read_scales(reader, header);
}

/// Up to the first point.
static bool read_header(struct reader *reader) {
    uint32_t size = 0;
    uint32_t data = 0;
    const unsigned char *header = canopy_source_bytes(reader->source, HEADER_SIZE, reader->fault);
    if (!header) {
        return false;
    }
    const bool new = header[AT_MINOR] == 4;
    if (!read_common(reader, header, &size, &data)) {
        return false;
    }
    uint64_t at = HEADER_SIZE;
    if (new) {
        const unsigned char *more = canopy_source_bytes(reader->source, HEADER_SIZE_14 - HEADER_SIZE, reader->fault);
        if (!more) {
            return false;
        }
        at = HEADER_SIZE_14;
        reader->count = canopy_value_whole(more + AT_COUNT_14 - HEADER_SIZE, 8, false);
    }
    return canopy_source_skip(reader->source, data - at, reader->fault);
}

/// Whether the point is marked as deleted.
static bool is_withheld(const struct reader *reader, const unsigned char *record) {
    return reader->format < 6 ? record[15] & 0x80U : record[15] & 0x04U;
}

bool canopy_las_read(struct canopy_source *source, struct canopy_points_sink sink, struct canopy_points_info *info,
                     struct canopy_fault *fault) {
    struct reader reader = {.source = source, .fault = fault};
    info->by_line = false;
    info->why = "are withheld";
    if (!read_header(&reader)) {
        return false;
    }
    for (uint64_t i = 0; i < reader.count; i++) {
        const unsigned char *record = canopy_source_bytes(source, reader.record, fault);
        if (!record) {
            const struct canopy_fault why = *fault;
            return canopy_fault_set(fault, "%s (in point %" PRIu64 " of %" PRIu64 ")", why.text, i + 1, reader.count);
        }
        if (is_withheld(&reader, record)) {
            info->skipped++;
            continue;
        }
        double point[3];
        for (unsigned k = 0; k < 3; k++) {
            point[k] = canopy_value_real(record + 4 * k, CANOPY_INT32, false) * reader.scale[k] + reader.offset[k];
        }
        if (!isfinite(point[0]) || !isfinite(point[1]) || !isfinite(point[2])) {
            canopy_fault_set(fault, "a coordinate beyond IEEE double: the file is damaged, copy it anew");
            return canopy_points_place(fault, source->name, false, i + 1);
        }
        info->count++;
        if (!sink.take(sink.context, point, i + 1, fault)) {
            return canopy_points_place(fault, source->name, false, i + 1);
        }
    }
    return true;
}
