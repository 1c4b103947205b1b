/// The cyclic program: readings in, certified envelopes out, one bounded step at a time.
///
/// A station owns a field, a fit, a certificate and the PLC's registers. Readings enter the field as they come, also
/// while a fit is under way; there is room for one field only. canopy_station_step() does a bounded piece of
/// whatever is next: an iteration of a line, a row of the certificate, a cell that rose after it was certified.
///
/// What a published envelope means, in every interleaving of readings, steps and reads:
///   - Its certificate covers exactly the first `points` readings accepted since the scene began: at the moment of
///     publication every covered cell, at the height it has then, lies under the bound. Cells that rise behind the
///     certificate's back are marked and certified again before it is published; a cell that the fit has missed is
///     mended by raising the coefficients around it (canopy_fast_raise), and the next fit is tighter again.
///   - A later reading that raises its cell, or falls into a cell that has risen since the publication, is compared
///     with the published surface in the call that accepts it. If it is not surely on the safe side, status bit 0 is
///     clear and the intrusion bit set before that call returns, until a publication covers it. A reading so far beyond
///     the frame that no envelope can cover it keeps both so until the scene is begun anew. Readings beside the frame
///     are counted as rejected and say nothing.
///   - With a `spare`, what a fit gave is made tighter while the field does not rise, and published under a new
///     sequence once the station itself has certified it. When the field rises then, it is first certified for that as
///     it is; only if it does not hold, or there is an intrusion, the field is fitted anew.
///   - Readings that raise nothing are under the published envelope already: after `refresh_us` it is published again,
///     unchanged, with its new `points`.
///   - A withdrawal by command stands until there is something new to publish: a fit under way, a cell that rises, a
///     refit that is asked for. Readings that raise nothing do not bring the envelope back.
///   - In a frame with turned axes (config.axes, or the axes of the frame given) a reading's uncertainty in z is one of
///     the place, too: every cell in which it may be rises to the highest it may be (lib/cover/turn.h), and it is
///     compared with the least the surface can be over that box. A reading whose z as told is beside the frame is
///     rejected, but what of its uncertainty reaches into the frame counts all the same.
///   - Stale is an age of more than stale_after_us since the last accepted reading. The last envelope stays readable.
///
/// All calls on one station come from one thread. Nothing blocks. Coordinates are whole device units, whichever scalar
/// the solves have. That of config.fit is told in the registers, and says how a PLC's file reads a point: in float, as
/// the float nearest to it. So that it is the point itself, a scene in float is within +- CANOPY_STATION_FLOAT_MOST, or
/// refused; a reading with a z further down than that counts as being there, and one further up, or (turned) anywhere
/// else beyond, is out of range: rejected, and an intrusion. (Up is the unsafe side: down for an envelope below.)
#ifndef CANOPY_STATION_H
#define CANOPY_STATION_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "lib/arena.h"
#include "lib/cover/certify.h"
#include "lib/cover/envelope.h"
#include "lib/cover/fast.h"
#include "lib/cover/field.h"
#include "lib/plc/plc.h"
#include "lib/scan/profile.h"
#include "lib/station/show.h"
#include "lib/status.h"

#define CANOPY_STATION_FLOAT_MOST (1 << 24)  ///< whole numbers up to that are floats

struct canopy_station_config {
    struct canopy_grid grid;
    struct canopy_station_turning *turning;  ///< for turned frames (lib/station/turning.h), else NULL
    int32_t axes[3][3];  ///< of the frames made around a scanner's scene (canopy_axes_*); all 0: x, y and z
    const struct canopy_line_fit *fit;  ///< arithmetic of the solves (canopy_fast_init), and the envelope's scalar
    uint16_t lines;           ///< lines a knot interval of u (canopy_fast_init): 1, or more for tighter and slower
    uint8_t clients;          ///< of the PLC side
    float unit;               ///< of the scene: point = device units * unit
    uint32_t stale_after_us;  ///< readings older than this make the envelope stale
    uint32_t interval_us;     ///< from the beginning of one fit to the next, unless an intrusion is in haste
    uint32_t refresh_us;      ///< until an unchanged envelope is published again with more points
};

enum canopy_station_stage {
    CANOPY_STATION_WAITING,     ///< no scene yet
    CANOPY_STATION_RESTING,     ///< nothing to fit
    CANOPY_STATION_FITTING,     ///< lines and columns
    CANOPY_STATION_CERTIFYING,  ///< rows of cells
    CANOPY_STATION_SETTLING     ///< cells that rose since their row was certified
};

/// Bytes of arena. `cells` is Q. What the certificate works in, and the marks of cells that rise behind its back, stand
/// where the fit was, which is over by then.
#define CANOPY_STATION_ARENA(m, n, cells, lines, clients)                                                              \
    (CANOPY_FIELD_ARENA(m, n, cells, cells) + CANOPY_STATION_MARKS(m, n, cells) +                                      \
     CANOPY_STATION_WORK(m, n, cells, lines) + CANOPY_CERTIFY_TABLES(cells, cells) + CANOPY_PLC_ARENA(m, n, clients))
#define CANOPY_STATION_MARKS(m, n, cells)                                                                              \
    CANOPY_ARENA_ROUND(((size_t)(cells) * (cells) * ((size_t)(m)-1U) * ((size_t)(n)-1U) + 7U) / 8U)
#define CANOPY_STATION_WORK(m, n, cells, lines)                                                                        \
    CANOPY_MAX(CANOPY_FAST_ARENA(m, n, cells, lines), CANOPY_CERTIFY_WORK(n, cells) + CANOPY_STATION_MARKS(m, n, cells))

struct canopy_station;

/// What a station does in turned axes, apart from it so that programs with straight axes link none of it
/// (lib/station/turning.h).
struct canopy_station_turning {
    bool (*turned_are_sound)(const int32_t axes[3][3]);
    /// As canopy_station_begin_box makes a frame; z is uncertain by that much more, up and down.
    enum canopy_status (*turned_frame)(const struct canopy_station_config *config, const int32_t low[3],
                                       const int32_t high[3], uint32_t uncertainty, struct canopy_frame *frame);
    /// Takes a frame that is turned, for the readings that follow; on failure nothing is changed.
    enum canopy_status (*turned_begin)(struct canopy_station_turning *turning, const struct canopy_frame *frame);
    /// As canopy_station_reading.
    enum canopy_status (*turned_reading)(struct canopy_station_turning *turning, struct canopy_station *station,
                                         const int32_t point[3], uint32_t uncertainty);
};

/// What a station may do when nothing else is to be done: make what is published tighter (lib/station/tightening.h is
/// one). One call is one bounded piece of work. It ends, and begins again with the next fit, when the field rises.
struct canopy_station_spare {
    /// Begins with coefficients that are certified and published, m x n in the library's orientation, which it copies.
    /// It may use `certify`, of the station's field, until it begins again. False: it cannot.
    bool (*spare_begin)(struct canopy_station_spare *spare, const struct canopy_field *field,
                        struct canopy_certify *certify, const int32_t *published);
    /// CANOPY_MORE, or anything else when it has ended.
    enum canopy_status (*spare_step)(struct canopy_station_spare *spare);
    /// Gives coefficients that are better than those it began with; false: there are none. The station certifies them.
    bool (*spare_take)(struct canopy_station_spare *spare, int32_t *coefficients);
};

enum canopy_station_spare_stage {
    CANOPY_STATION_SPARE_NOTHING,
    CANOPY_STATION_SPARE_WAITING,
    CANOPY_STATION_SPARE_WORK
};

/// All members are the station's own, but `port`, `scan`, `sensor_faults` and `spare`.
struct canopy_station {
    // small members first: a Cortex-M0+ reaches bytes up to 31, words up to 124, without a constant for the offset
    uint8_t stage;        ///< enum canopy_station_stage
    uint8_t spare_stage;  // enum canopy_station_spare_stage
    bool turned;
    bool have_reading;
    bool risen;              // the field rose since the last fit began
    bool intrusion;          // a reading lies beyond the published envelope …
    bool beyond;             // … and beyond what any envelope of this frame can cover
    bool handed;             // the candidate is what `spare` gave …
    bool kept;               // … or what is published, to be certified for a field that rose
    bool tightened;          // what is published came from `spare`
    uint16_t sensor_faults;  ///< one bit a sensor: silent, stale or refused
    uint16_t heartbeat;
    uint16_t coverage_pct;
    uint64_t start_us, now_us, reading_us, fit_us, publish_us;
    uint32_t points;  ///< readings accepted since the scene began
    uint32_t published_points;
    uint32_t accepted, rejected, intrusions, fits_failed;
    uint32_t scan_errors;  ///< set with `scan`
    uint32_t late_count;
    uint32_t late_at;                    // where settling goes on to look
    uint8_t *risen_cells;                // one bit a cell that rose since the last publication
    uint8_t *late_cells;                 // one bit a cell that rose since its row of the candidate was certified
    int32_t *candidate;                  // coefficients being fitted and certified, in a slot of the PLC's
    struct canopy_station_spare *spare;  ///< set before the first scene, or NULL
    const struct canopy_profile_counters *scan;  ///< the scanner driver's, or NULL
    struct canopy_station_port port;             ///< set by the port, any time
    struct canopy_station_config config;
    void *field_arena, *tables_arena, *work_arena;
    size_t field_bytes, work_bytes;
    struct canopy_plc plc;
    struct canopy_field field;
    struct canopy_fast fast;
    struct canopy_certify certify;
};

/// Makes a station that waits for a scene. `arena`: CANOPY_STATION_ARENA bytes, aligned to 8, the station's as long as
/// it is used. CANOPY_ARGUMENT (also: no fit, axes that are no rotation), CANOPY_UNSUPPORTED: turned axes without
/// config.turning; CANOPY_ARENA_SHORT, CANOPY_ARENA_ALIGN.
enum canopy_status canopy_station_init(struct canopy_station *station, const struct canopy_station_config *config,
                                       void *arena, size_t bytes, uint64_t now_us);

/// Begins a scene: withdraws what is published, forgets all readings, takes the frame. Its size, cells and side must be
/// the configuration's, its axes a rotation (canopy_axes_are_sound; any, whatever config.axes says), its quantum a
/// device unit and its pitches multiples of its cells (else CANOPY_ARGUMENT, nothing changed). CANOPY_RANGE: turned,
/// and 2^32 units wide. CANOPY_UNSUPPORTED: turned, without config.turning.
enum canopy_status canopy_station_begin(struct canopy_station *station, const struct canopy_frame *frame);

/// Begins a scene in the smallest frame that holds what the scanner says of it, all corners of its box; does nothing
/// where that is the frame already. CANOPY_RANGE: with config.axes no frame holds it (canopy_frame_around_turned_fx),
/// or not in float.
enum canopy_status canopy_station_begin_box(struct canopy_station *station, const int32_t low[3],
                                            const int32_t high[3]);

/// The same in the scanner's own unit, which becomes the station's, and with room for its uncertainty in turned axes.
/// CANOPY_ARGUMENT also for a unit that is none.
enum canopy_status canopy_station_begin_scene(struct canopy_station *station, const struct canopy_profile_scene *scene);

/// Takes one valid reading: device units; the true height is within z +- uncertainty. CANOPY_OK: accepted.
/// CANOPY_OUT_OF_FRAME: rejected, beside the frame; CANOPY_RANGE: rejected, and an intrusion: too high for any
/// envelope, or (turned) so uncertain that it may be in more than CANOPY_FIELD_BOX_CELLS cells; CANOPY_EMPTY: no scene
/// yet.
enum canopy_status canopy_station_reading(struct canopy_station *station, const int32_t point[3], uint32_t uncertainty,
                                          uint64_t now_us);

/// Takes up to `most` columns of the driver's complete profile, from column *column on, which it advances; gives the
/// profile back behind its last column. True while columns are left.
bool canopy_station_profile(struct canopy_station *station, struct canopy_profile_driver *driver, uint16_t *column,
                            uint16_t most, uint64_t now_us);

/// One cycle: at most `budget` units of work, each an iteration of a line, a row of cells, or a risen cell; with
/// nothing of that to be done, a piece of the work of `spare`.
void canopy_station_step(struct canopy_station *station, uint32_t budget, uint64_t now_us);

/// Whether the next cycle has work to do beside what readings and time bring.
bool canopy_station_is_working(const struct canopy_station *station);

/// The registers, for Modbus servers.
struct canopy_modbus_bank canopy_station_bank(struct canopy_station *station);

#endif
