#include "tools/common/sweep.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "lib/scan/generic.h"
#include "tools/common/random.h"
#include "tools/common/scene.h"

#define ILLEGAL_ADDRESS 2

// What is noted of each register of the profile, a client each.
enum { OFFERED = 1, DOUBTFUL = 2 };

// What a read was, until its answer's fate is known.
struct pending {
    uint32_t first, count;  // registers of the profile block
    bool counts;            // offering it brings the profile forward
};

struct frame {
    uint16_t sequence;  // 0: none
    uint16_t *image;    // header, heights, trailer
};

struct canopy_sweep {
    struct canopy_sweep_options options;
    struct canopy_scene scene;
    struct canopy_sweep_status status;
    uint16_t description[CANOPY_GENERIC_D_COUNT];
    uint32_t length;  // registers of a profile
    struct frame now, before;
    uint32_t current;  // profile that stands in `now`
    uint16_t current_valid;
    bool *through;    // profiles that are through in this round
    uint32_t lowest;  // all below are through
    FILE *log;
    bool started;
    bool complete;         // `now` was offered completely to someone
    bool promising;        // `now` promises one reading too many
    uint32_t stale_looks;  // looks that still see an old frame
    bool older;            // namely the one before
    bool stale_drawn;      // it was decided whether `now` goes stale
    uint32_t tear_after;   // reads after which `now` is replaced; 0: never
    uint64_t next_us;      // when the clock brings the next profile
    uint64_t faults;       // random stream
    uint8_t *offered[CANOPY_SWEEP_CLIENTS];
    uint32_t covered[CANOPY_SWEEP_CLIENTS];
    struct pending pending[CANOPY_SWEEP_CLIENTS];
};

// ---------------------------------------------------------------------------------------------------------------------
// Registers

static void put32(uint16_t *to, int32_t value) {
    to[0] = (uint16_t)((uint32_t)value >> 16);
    to[1] = (uint16_t)((uint32_t)value & 0xFFFFu);
}

static void describe(struct canopy_sweep *sweep) {
    const struct canopy_scene *scene = &sweep->scene;
    uint16_t *d = sweep->description;
    const float unit = (float)scene->unit;
    int32_t unit_bits;
    memcpy(&unit_bits, &unit, sizeof unit_bits);
    put32(d + CANOPY_GENERIC_D_MAGIC, (int32_t)CANOPY_GENERIC_MAGIC);
    d[CANOPY_GENERIC_D_VERSION] = CANOPY_GENERIC_VERSION;
    d[CANOPY_GENERIC_D_COLUMNS] = (uint16_t)scene->columns;
    d[CANOPY_GENERIC_D_PROFILES] = (uint16_t)scene->profiles;
    put32(d + CANOPY_GENERIC_D_X_START, scene->start[0]);
    put32(d + CANOPY_GENERIC_D_X_STEP, scene->step[0]);
    put32(d + CANOPY_GENERIC_D_Z_OFFSET, scene->z_offset);
    d[CANOPY_GENERIC_D_Z_STEP] = scene->z_step;
    d[CANOPY_GENERIC_D_UNCERTAINTY] = sweep->options.uncertainty;
    for (int i = 0; i < 3; i++) {
        put32(d + CANOPY_GENERIC_D_LOW + 2 * i, scene->low[i]);
        put32(d + CANOPY_GENERIC_D_HIGH + 2 * i, scene->high[i]);
    }
    put32(d + CANOPY_GENERIC_D_UNIT, unit_bits);
    uint64_t id = sweep->options.seed;
    for (int i = 0; i < CANOPY_GENERIC_D_COUNT; i++)
        id = canopy_random_mix(id + d[i] + 1);
    d[CANOPY_GENERIC_D_ID] = (uint16_t)(id & 0xFFFFu);
}

// A normal deviate, cut at 4 sigma (Box and Muller 1958).
static double normal(uint64_t *state) {
    const double radius = sqrt(-2 * log(1 - canopy_random_unit(state)));
    const double value = radius * cos(6.283185307179586 * canopy_random_unit(state));
    return fmax(-4, fmin(4, value));
}

// What the scanner measures at a column in this round.
static uint16_t measure(const struct canopy_sweep *sweep, uint32_t profile, uint32_t column) {
    const struct canopy_scene *scene = &sweep->scene;
    const uint16_t height = scene->heights[(size_t)profile * scene->columns + column];
    const uint64_t cell = ((uint64_t)profile << 32) + column;
    uint64_t state = canopy_random_mix(sweep->options.seed ^ canopy_random_mix(cell + sweep->status.rounds * 0x9E37u));
    if (height == CANOPY_SCENE_NONE || canopy_random_chance(&state, sweep->options.dropouts))
        return CANOPY_SCENE_NONE;
    if (!(sweep->options.noise > 0))
        return height;
    const double noisy = height + rint(normal(&state) * sweep->options.noise / scene->unit / scene->z_step);
    return (uint16_t)fmax(0, fmin(noisy, scene->height_max));
}

static void forget_offers(struct canopy_sweep *sweep) {
    for (uint8_t client = 0; client < CANOPY_SWEEP_CLIENTS; client++)
        canopy_sweep_forget(sweep, client);
    sweep->complete = false;
}

// Puts profile `profile` into `now` under the next sequence number; what stood there is `before`.
static void expose(struct canopy_sweep *sweep, uint32_t profile) {
    const struct frame old = sweep->before;
    uint32_t sequence = sweep->now.sequence == 0 && sweep->options.sequence > 0 ? sweep->options.sequence
                                                                                : (uint32_t)sweep->now.sequence + 1;
    if (sweep->started && canopy_random_chance(&sweep->faults, sweep->options.lost)) {
        sequence += 1 + canopy_random_below(&sweep->faults, 3);
        sweep->status.lost++;
    }
    sequence = sequence > UINT16_MAX ? sequence - UINT16_MAX : sequence;
    sweep->before = sweep->now;
    sweep->now = (struct frame){.sequence = (uint16_t)sequence, .image = old.image};
    sweep->current = profile;
    uint16_t *image = sweep->now.image, valid = 0;
    for (uint32_t c = 0; c < sweep->scene.columns; c++) {
        const uint16_t height = measure(sweep, profile, c);
        image[CANOPY_GENERIC_P_COUNT + c] = height;
        valid = (uint16_t)(valid + (height != CANOPY_SCENE_NONE));
    }
    sweep->promising = canopy_random_chance(&sweep->faults, sweep->options.short_of);
    sweep->current_valid = valid;
    image[CANOPY_GENERIC_P_SEQUENCE] = image[sweep->length - 1] = sweep->now.sequence;
    image[CANOPY_GENERIC_P_ID] = sweep->description[CANOPY_GENERIC_D_ID];
    put32(image + CANOPY_GENERIC_P_POSITION,
          (int32_t)(sweep->scene.start[1] + (int64_t)profile * sweep->scene.step[1]));
    image[CANOPY_GENERIC_P_VALID] = (uint16_t)(valid + sweep->promising);
    sweep->stale_drawn = false;
    const bool tears = canopy_random_chance(&sweep->faults, sweep->options.torn);
    sweep->tear_after = tears ? 1 + canopy_random_below(&sweep->faults, 3) : 0;
    sweep->status.sequence = sweep->now.sequence;
    forget_offers(sweep);
}

// ---------------------------------------------------------------------------------------------------------------------
// The sweep

// The lowest profile that is not through and not the one that stands; false if there is none.
static bool find_next(struct canopy_sweep *sweep, uint32_t *profile) {
    while (sweep->lowest < sweep->scene.profiles && sweep->through[sweep->lowest])
        sweep->lowest++;
    for (uint32_t p = sweep->lowest; p < sweep->scene.profiles; p++) {
        if (!sweep->through[p] && (!sweep->started || p != sweep->current)) {
            *profile = p;
            return true;
        }
    }
    return false;
}

static void mark_through(struct canopy_sweep *sweep) {
    if (sweep->through[sweep->current])
        return;
    sweep->through[sweep->current] = true;
    sweep->status.profile++;
    if (sweep->status.profile == sweep->scene.profiles) {
        sweep->status.rounds++;
        sweep->status.over = !sweep->options.loop;
    }
}

static void begin_round(struct canopy_sweep *sweep) {
    memset(sweep->through, 0, sweep->scene.profiles * sizeof *sweep->through);
    sweep->status.profile = 0;
    sweep->lowest = 0;
}

// Brings the next profile. False when the sweep is over.
static bool advance(struct canopy_sweep *sweep) {
    uint32_t profile = 0;
    if (!find_next(sweep, &profile)) {
        if (!sweep->options.loop || !sweep->complete)
            return false;
        begin_round(sweep);
        profile = 0;
    }
    expose(sweep, profile);
    sweep->started = true;
    return true;
}

static void serve_readings(struct canopy_sweep *sweep) {
    const struct canopy_scene *scene = &sweep->scene;
    const double unit = scene->unit;
    sweep->status.served += sweep->current_valid;
    if (sweep->log == NULL)
        return;
    const double y = (double)scene->start[1] + (double)sweep->current * scene->step[1];
    for (uint32_t c = 0; c < scene->columns; c++) {
        const uint16_t height = sweep->now.image[CANOPY_GENERIC_P_COUNT + c];
        if (height == CANOPY_SCENE_NONE)
            continue;
        const double x = (double)scene->start[0] + (double)c * scene->step[0];
        const double z = (double)scene->z_offset + (double)height * scene->z_step;
        fprintf(sweep->log, "%.17g %.17g %.17g\n", x * unit, y * unit, z * unit);
    }
    fflush(sweep->log);
}

static bool any_doubt(const struct canopy_sweep *sweep, uint8_t client) {
    for (uint32_t i = 0; i < sweep->length; i++)
        if ((sweep->offered[client][i] & DOUBTFUL) != 0)
            return true;
    return false;
}

// The master must have refused a profile that promised too much: the same one again, as it is.
static bool mend_promise(struct canopy_sweep *sweep) {
    if (!sweep->promising)
        return false;
    sweep->promising = false;
    sweep->status.short_of++;
    sweep->now.image[CANOPY_GENERIC_P_VALID] = sweep->current_valid;
    forget_offers(sweep);
    return true;
}

// All of `now` was offered to `client`. While there is doubt it may still be offered again, without.
static void completed(struct canopy_sweep *sweep, uint8_t client) {
    if (sweep->complete || any_doubt(sweep, client) || mend_promise(sweep))
        return;
    sweep->complete = true;
    mark_through(sweep);
    serve_readings(sweep);
}

// The master moves on: what it was offered with doubts it has taken, or given up.
static void settle_doubts(struct canopy_sweep *sweep, uint8_t client) {
    if (sweep->complete || sweep->covered[client] < sweep->length || mend_promise(sweep))
        return;
    sweep->complete = true;
    mark_through(sweep);
    sweep->status.doubtful += sweep->current_valid;
}

// The clock: each period brings the next profile, read or not.
static void tick(struct canopy_sweep *sweep, uint64_t now_us) {
    const uint64_t period_us = (uint64_t)(1e6 / sweep->options.rate_hz);
    while (sweep->started && now_us >= sweep->next_us && !sweep->status.over) {
        sweep->next_us += period_us > 0 ? period_us : 1;
        if (sweep->stale_looks > 0)
            continue;
        if (!sweep->complete) {
            sweep->status.missed += sweep->current_valid;
            mark_through(sweep);
            sweep->complete = true;  // so that the next round may begin
        }
        advance(sweep);
    }
}

static bool begin_stale(struct canopy_sweep *sweep) {
    const bool drawn = sweep->stale_drawn;
    sweep->stale_drawn = true;
    if (drawn || !canopy_random_chance(&sweep->faults, sweep->options.stale))
        return false;
    sweep->stale_looks = 3 + canopy_random_below(&sweep->faults, 10);
    sweep->older = sweep->before.sequence != 0 && canopy_random_below(&sweep->faults, 2) == 1;
    sweep->status.stale++;
    return true;
}

// The master looks at the sequence number.
static void look(struct canopy_sweep *sweep, uint8_t client, uint64_t now_us) {
    if (!sweep->started) {
        advance(sweep);
        sweep->next_us = now_us + (uint64_t)(sweep->options.rate_hz > 0 ? 1e6 / sweep->options.rate_hz : 0);
        return;
    }
    if (sweep->stale_looks > 0) {
        sweep->stale_looks--;
        if (sweep->stale_looks > 0)
            return;
        sweep->older = false;
        if (sweep->options.rate_hz <= 0)
            advance(sweep);
        return;
    }
    settle_doubts(sweep, client);
    if (!sweep->complete || begin_stale(sweep))
        return;
    if (sweep->options.rate_hz <= 0)
        advance(sweep);
}

// A read inside the profile: perhaps the next one takes over just now. The torn one comes again.
static void tear(struct canopy_sweep *sweep) {
    uint32_t other = 0;
    if (sweep->tear_after == 0 || sweep->complete || --sweep->tear_after > 0 || !find_next(sweep, &other))
        return;
    sweep->status.torn++;
    expose(sweep, other);
    sweep->tear_after = 0;
}

// ---------------------------------------------------------------------------------------------------------------------
// The sweep as its users see it

static uint16_t shown(const struct canopy_sweep *sweep, uint32_t address) {
    const struct frame *frame = sweep->older ? &sweep->before : &sweep->now;
    if (address < CANOPY_GENERIC_D_COUNT)
        return sweep->description[address];
    if (address < CANOPY_GENERIC_PROFILE || frame->sequence == 0)
        return 0;
    return frame->image[address - CANOPY_GENERIC_PROFILE];
}

uint8_t canopy_sweep_read(struct canopy_sweep *sweep, uint8_t client, uint16_t address, uint16_t count, uint16_t *to,
                          uint64_t now_us) {
    const uint32_t end = (uint32_t)address + count, limit = CANOPY_GENERIC_PROFILE + sweep->length;
    if (client >= CANOPY_SWEEP_CLIENTS || count == 0 || end > limit)
        return ILLEGAL_ADDRESS;
    if (sweep->options.rate_hz > 0)
        tick(sweep, now_us);
    if (address <= CANOPY_GENERIC_PROFILE && end > CANOPY_GENERIC_PROFILE)
        look(sweep, client, now_us);
    else if (address > CANOPY_GENERIC_PROFILE)
        tear(sweep);
    for (uint32_t i = 0; i < count; i++)
        to[i] = shown(sweep, address + i);
    struct pending *pending = &sweep->pending[client];
    pending->first = address > CANOPY_GENERIC_PROFILE ? address - CANOPY_GENERIC_PROFILE : 0;
    pending->count = end > CANOPY_GENERIC_PROFILE ? end - CANOPY_GENERIC_PROFILE - pending->first : 0;
    pending->counts = sweep->stale_looks == 0;
    return 0;
}

void canopy_sweep_offered(struct canopy_sweep *sweep, uint8_t client, bool doubtful) {
    if (client >= CANOPY_SWEEP_CLIENTS)
        return;
    const struct pending pending = sweep->pending[client];
    uint8_t *offered = sweep->offered[client];
    sweep->pending[client] = (struct pending){0};
    if (!pending.counts || pending.count == 0)
        return;
    // What a master read before it saw the sequence number belongs to a profile that it has dropped.
    if (pending.first == 0 && offered[0] == 0) {
        memset(offered, 0, sweep->length);
        sweep->covered[client] = 0;
    }
    for (uint32_t i = pending.first; i < pending.first + pending.count; i++) {
        sweep->covered[client] += offered[i] == 0;
        if (!doubtful)
            offered[i] = OFFERED;
        else if (offered[i] == 0)
            offered[i] = OFFERED | DOUBTFUL;
    }
    if (sweep->covered[client] == sweep->length)
        completed(sweep, client);
}

void canopy_sweep_log(struct canopy_sweep *sweep, FILE *file) { sweep->log = file; }

void canopy_sweep_forget(struct canopy_sweep *sweep, uint8_t client) {
    if (client >= CANOPY_SWEEP_CLIENTS)
        return;
    memset(sweep->offered[client], 0, sweep->length);
    sweep->covered[client] = 0;
    sweep->pending[client] = (struct pending){0};
}

static bool probability(const char *name, double p, struct canopy_fault *fault) {
    return (p >= 0 && p <= 1) || canopy_fault_set(fault, "--%s %g: give a probability from 0 to 1", name, p);
}

static bool options_ok(const struct canopy_sweep_options *o, struct canopy_fault *fault) {
    if (!(o->rate_hz >= 0 && o->rate_hz <= 1e6))
        return canopy_fault_set(fault, "--rate %g: give profiles a second, up to 1000000", o->rate_hz);
    if (!(o->noise >= 0 && isfinite(o->noise)))
        return canopy_fault_set(fault, "--noise %g: give a standard deviation, 0 or more", o->noise);
    return probability("dropouts", o->dropouts, fault) && probability("torn", o->torn, fault) &&
           probability("stale", o->stale, fault) && probability("lost", o->lost, fault) &&
           probability("short", o->short_of, fault);
}

static bool allocate(struct canopy_sweep *sweep) {
    sweep->through = calloc(sweep->scene.profiles, sizeof *sweep->through);
    sweep->now.image = calloc(sweep->length, sizeof *sweep->now.image);
    sweep->before.image = calloc(sweep->length, sizeof *sweep->before.image);
    bool there = sweep->through != NULL && sweep->now.image != NULL && sweep->before.image != NULL;
    for (int i = 0; i < CANOPY_SWEEP_CLIENTS; i++) {
        sweep->offered[i] = calloc(sweep->length, 1);
        there = there && sweep->offered[i] != NULL;
    }
    return there;
}

struct canopy_sweep *canopy_sweep_open(const char *path, const struct canopy_sweep_options *options,
                                       struct canopy_fault *fault) {
    const struct canopy_scene_wish wish = {.profiles = options->profiles,
                                           .columns = options->columns,
                                           .unit = options->unit,
                                           .margin = 4 * options->noise};
    if (!options_ok(options, fault))
        return NULL;
    struct canopy_sweep *sweep = calloc(1, sizeof *sweep);
    if (sweep == NULL) {
        canopy_fault_set(fault, "no memory");
        return NULL;
    }
    sweep->options = *options;
    sweep->faults = canopy_random_mix(options->seed + 1);
    if (!canopy_scene_load(path, &wish, &sweep->scene, fault)) {
        canopy_sweep_close(sweep);
        return NULL;
    }
    sweep->length = CANOPY_GENERIC_P_COUNT + sweep->scene.columns + 1;
    sweep->status.profiles = sweep->scene.profiles;
    sweep->status.columns = sweep->scene.columns;
    sweep->status.readings = sweep->scene.valid;
    if (!allocate(sweep)) {
        canopy_fault_set(fault, "no memory");
        canopy_sweep_close(sweep);
        return NULL;
    }
    describe(sweep);
    return sweep;
}

void canopy_sweep_close(struct canopy_sweep *sweep) {
    if (sweep == NULL)
        return;
    for (int i = 0; i < CANOPY_SWEEP_CLIENTS; i++)
        free(sweep->offered[i]);
    free(sweep->now.image);
    free(sweep->before.image);
    free(sweep->through);
    canopy_scene_free(&sweep->scene);
    free(sweep);
}

double canopy_sweep_unit(const struct canopy_sweep *sweep) { return sweep->scene.unit; }

struct canopy_sweep_status canopy_sweep_status(const struct canopy_sweep *sweep) {
    return sweep->status;
}
