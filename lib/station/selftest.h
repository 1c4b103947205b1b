/// A device's tests of itself: its RAM, its flash, and the mathematics that it is for.
///
/// RAM is marched through in the background, a window of 32 bytes a step: four words and, in turn, the four words whose
/// address differs in one bit, so that after 16 passes every address line has been told from the others. The window's
/// contents are saved, marched over (lib/station/march.h; the pattern is another one each pass) and put back with
/// interrupts masked, for about 1,300 instructions (1,800 on an ARMv6-M). All RAM that the program uses is walked
/// through but the part of the stack that is in use by the step itself and whoever called it. No other core and no DMA
/// may use the window meanwhile.
///
/// Flash is read in the background too, 64 bytes a step, about 3,000 instructions (4,700 on an ARMv6-M), and its CRC-32
/// compared with the one that the build has placed behind it.
///
/// The certificate of a built-in scene is made once, at start, in memory that is not in use yet: a small field is fed,
/// fitted and certified by what the station uses. The result must be what is known, bit for bit; lowered as far as it
/// is still safe it must be certified, and one step further it must be refused. It is not repeated later, when the
/// memory is the station's: then the code that it tests is under the CRC, and its memory under the march.
///
/// A test that has failed stays failed until the next start.
#ifndef CANOPY_STATION_SELFTEST_H
#define CANOPY_STATION_SELFTEST_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/arena.h"
#include "lib/cover/certify.h"
#include "lib/cover/fast.h"
#include "lib/cover/field.h"
#include "lib/cover/line.h"
#include "lib/port.h"

#define CANOPY_SELFTEST_FLASH_BYTES 64U  ///< a step

struct canopy_selftest {
    const struct canopy_memory *memory;
    uint32_t ram_at, flash_at;  // bytes from the beginning
    uint32_t crc;               // of the flash so far
    uint32_t ram_passes, flash_passes;
    uint32_t flash_crc;  ///< of the last pass, right or wrong; 0 before
    bool ram_failed, flash_failed;
};

/// `memory` must outlive the test.
void canopy_selftest_init(struct canopy_selftest *test, const struct canopy_memory *memory);

/// Tests the next window of RAM, or steps over one that is in use.
void canopy_selftest_ram(struct canopy_selftest *test);

/// Reads the next bytes of the flash.
void canopy_selftest_flash(struct canopy_selftest *test);

/// What the built-in scene is known to give, by the arithmetic of the fit.
struct canopy_selftest_known {
    const struct canopy_line_fit *fit;
    uint32_t crc;    ///< CRC-32 of the coefficients in memory, low byte first
    int32_t margin;  ///< certified
    int32_t fall;    ///< by so many steps lower it is refused, by one less it is not
};
extern const struct canopy_selftest_known canopy_selftest_fx, canopy_selftest_f32;

// Of the built-in scene: coefficients each way, and field cells a knot interval
#define CANOPY_SELFTEST_SIZE 4
#define CANOPY_SELFTEST_CELLS 1

struct canopy_selftest_scene {
    struct canopy_field field;
    struct canopy_fast fast;
    struct canopy_certify certify;
    int32_t coefficients[CANOPY_SELFTEST_SIZE * CANOPY_SELFTEST_SIZE];
};

/// Bytes of arena for the certificate.
#define CANOPY_SELFTEST_ARENA                                                                                          \
    (CANOPY_ARENA_ROUND(sizeof(struct canopy_selftest_scene)) +                                                        \
     CANOPY_FIELD_ARENA(CANOPY_SELFTEST_SIZE, CANOPY_SELFTEST_SIZE, CANOPY_SELFTEST_CELLS, CANOPY_SELFTEST_CELLS) +    \
     CANOPY_FAST_ARENA(CANOPY_SELFTEST_SIZE, CANOPY_SELFTEST_SIZE, CANOPY_SELFTEST_CELLS, 1) +                         \
     CANOPY_CERTIFY_ARENA(CANOPY_SELFTEST_SIZE, CANOPY_SELFTEST_CELLS, CANOPY_SELFTEST_CELLS))

/// Makes the certificate by one of the two, in `arena`: CANOPY_SELFTEST_ARENA bytes, aligned to 8, which are
/// nobody's afterwards. False: something of it is not as it must be, or the arena is too small.
bool canopy_selftest_certificate(const struct canopy_selftest_known *known, void *arena, size_t bytes);

#endif
