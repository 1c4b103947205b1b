/// A station's spare time spent on tightening: what the fast method published is made nearly as tight as the field
/// allows (lib/cover/tighten.h), in background, on any chip: the float part is a proposal only, in software where there
/// is no hardware for it. What comes of it is published in whole steps once the station's own exact certificate holds.
///
///     static CANOPY_ARENA_DECLARE(arena, CANOPY_STATION_TIGHTENING_ARENA(M, N, Q, ROWS));
///     canopy_station_tightening_init(&tightening, &config.grid, ROWS, arena, sizeof arena);
///     station.spare = &tightening.spare;
///
/// Arena for 10 x 10, Q = 4 with CANOPY_TIGHTEN_ROWS_FEW: 33 KB, of which 14 KB are the matrix; 20 x 20: 178 KB. A
/// piece of work is a unit of canopy_tighten_step or of canopy_tighten_field_step (docs/tightening.md has how long).
#ifndef CANOPY_STATION_TIGHTENING_H
#define CANOPY_STATION_TIGHTENING_H

#include <stddef.h>
#include <stdint.h>

#include "lib/arena.h"
#include "lib/cover/frame.h"
#include "lib/cover/tighten.h"
#include "lib/station/station.h"
#include "lib/status.h"

/// Bytes of arena for a station of m x n coefficients and Q = `cells`, with `rows` constraints in use
/// (CANOPY_TIGHTEN_ROWS_FEW(m, n) or more).
#define CANOPY_STATION_TIGHTENING_ARENA(m, n, cells, rows)                                                             \
    (CANOPY_ARENA_ROUND(4U * (size_t)(m) * (size_t)(n)) + CANOPY_TIGHTEN_ARENA(m, n, cells, cells, 0U, rows))

struct canopy_station_tightening {
    struct canopy_station_spare spare;  ///< for the station
    struct canopy_tighten tighten;      ///< what it is at: canopy_tighten_excess says how near
    struct canopy_tighten_size size;
    int32_t *b;
    void *arena;
    size_t bytes;
};

/// Prepares for the scenes of a station with this grid. CANOPY_ARGUMENT, CANOPY_ARENA_SHORT, CANOPY_ARENA_ALIGN.
enum canopy_status canopy_station_tightening_init(struct canopy_station_tightening *tightening,
                                                  const struct canopy_grid *grid, uint32_t rows, void *arena,
                                                  size_t bytes);

#endif
