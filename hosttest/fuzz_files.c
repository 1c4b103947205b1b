// libFuzzer on the files a user gives: points as text, PLY, PCD and LAS, and surrogates, chosen by the first byte. A
// surrogate that is accepted is also checked against a few points and written and read again.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "tools/common/exact.h"
#include "tools/common/points.h"
#include "tools/common/surrogate.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static char path[64];

static const char *write_file(const char *ending, const uint8_t *data, size_t size) {
    snprintf(path, sizeof path, "/dev/shm/canopy-fuzz-%ld%s", (long)getpid(), ending);
    FILE *file = fopen(path, "wb");
    if (!file || fwrite(data, 1, size, file) != size || fclose(file) != 0)
        abort();
    return path;
}

static void need(bool good) {
    if (!good)
        abort();
}

static bool take(void *context, const double point[3], uint64_t where, struct canopy_fault *fault) {
    uint64_t *count = context;
    need(isfinite(point[0]) && isfinite(point[1]) && isfinite(point[2]));
    need(where >= 1);
    ++*count;
    return *count < 1000 || canopy_fault_set(fault, "enough");
}

// A fault is one printable line that names the file.
static void check_fault(const struct canopy_fault *fault) {
    need(strstr(fault->text, "canopy-fuzz") != NULL);
    for (const char *p = fault->text; *p; p++)
        need((unsigned char)*p >= ' ');
}

static void read_points(const char *name) {
    uint64_t count = 0;
    struct canopy_points_info info;
    struct canopy_fault fault = {""};
    if (canopy_points_read(name, (struct canopy_points_sink){&count, take}, &info, &fault))
        need(count > 0 && info.count == count);
    else
        check_fault(&fault);
}

static void read_surrogate(const char *name) {
    struct canopy_surrogate first, second;
    struct canopy_fault fault = {""};
    if (!canopy_surrogate_read(name, &first, &fault)) {
        check_fault(&fault);
        return;
    }
    static const float points[] = {0, 0, 0, 1, 2, 3, -1e30F, 1e30F, 1e-30F, 5, 5, -5};
    static const int32_t whole[] = {0, 0, 0, 1, 2, 3, INT32_MIN, INT32_MAX, 7, 5, 5, -5};
    struct canopy_cloud cloud = {.scalar = first.scalar, .count = 4, .stride = 3};
    for (size_t k = 0; k < 3; k++)
        cloud.axis[k] = first.scalar == CANOPY_F32 ? (const void *)(points + k) : (const void *)(whole + k);
    struct canopy_exact_result before, after;
    need(canopy_exact_check(&first, &cloud, &before));
    need(canopy_surrogate_write(name, &first, &fault));
    need(canopy_surrogate_read(name, &second, &fault));
    need(canopy_exact_check(&second, &cloud, &after));
    need(before.wrong == after.wrong && before.outside == after.outside);
    canopy_surrogate_free(&first);
    canopy_surrogate_free(&second);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    if (size < 1)
        return 0;
    switch (data[0] % 5) {
    case 0: read_points(write_file(".xyz", data + 1, size - 1)); break;
    case 1: read_points(write_file(".ply", data + 1, size - 1)); break;
    case 2: read_points(write_file(".pcd", data + 1, size - 1)); break;
    case 3: read_points(write_file(".las", data + 1, size - 1)); break;
    default: read_surrogate(write_file(".json", data + 1, size - 1)); break;
    }
    unlink(path);
    return 0;
}
