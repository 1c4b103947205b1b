/// A scene on a lattice whose every height tells its place, as a point file for a simulated scanner: a reading from
/// another profile, another column or a torn block cannot look right.
#ifndef CANOPY_HOSTTEST_LATTICE_H
#define CANOPY_HOSTTEST_LATTICE_H

#include <inttypes.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include <cmocka.h>

#include "lib/scan/profile.h"

#define LATTICE_COLUMNS_MOST 488

struct lattice {
    char path[32];
    uint32_t columns, profiles, valid;
};

/// What a driver delivered of it.
struct lattice_tally {
    uint64_t readings, wrong, profiles;
    bool *seen;  ///< of each profile; the test's
};

static inline bool lattice_hole(int64_t column, int64_t profile) { return (column * 5 + profile * 3) % 17 == 0; }

static inline int32_t lattice_height(int64_t column, int64_t profile) {
    return (int32_t)((profile * 977 + column * 61) % 60000);
}

/// Writes the file; unlink its path when done.
static inline void lattice_make(struct lattice *scene, uint32_t columns, uint32_t profiles) {
    *scene = (struct lattice){.path = "/tmp/canopy-scan-XXXXXX", .columns = columns, .profiles = profiles};
    const int file = mkstemp(scene->path);
    assert_true(file >= 0);
    FILE *out = fdopen(file, "w");
    assert_non_null(out);
    for (uint32_t p = 0; p < profiles; p++)
        for (uint32_t c = 0; c < columns; c++)
            if (!lattice_hole(c, p)) {
                fprintf(out, "%u %u %" PRId32 "\n", c * 7, p * 3, lattice_height(c, p));
                scene->valid++;
            }
    fclose(out);
}

/// Counts the profile that the driver holds.
static inline void lattice_check(const struct lattice *scene, const struct canopy_profile_driver *driver,
                                 struct lattice_tally *tally) {
    const struct canopy_profile *profile = canopy_profile_get(driver);
    assert_int_equal(profile->columns, scene->columns);
    const int64_t p = profile->y / 3;
    tally->profiles++;
    assert_true(profile->y >= 0 && profile->y % 3 == 0 && p < scene->profiles);
    tally->seen[p] = true;
    for (uint16_t c = 0; c < profile->columns; c++) {
        struct canopy_reading reading;
        assert_true(canopy_profile_reading(driver, c, &reading));
        tally->readings += reading.valid;
        if (reading.valid)
            tally->wrong += lattice_hole(c, p) || reading.x != 7 * c || reading.y != profile->y ||
                            reading.z != lattice_height(c, p);
    }
}

static inline unsigned lattice_seen(const struct lattice *scene, const struct lattice_tally *tally) {
    unsigned seen = 0;
    for (uint32_t p = 0; p < scene->profiles; p++)
        seen += tally->seen[p];
    return seen;
}

#endif
