#include "lib/scan/profile.h"

#include <string.h>

#include "lib/scan/field.h"

// What the outstanding request is for.
enum phase {
    DESCRIBE,  // the description block
    LOOK,      // the header alone: is there a new profile?
    FIRST,     // the header and the first heights in one read, when a new profile is likely
    HEIGHTS,   // more of `raw`
    TRAILER,   // the second sequence number at its fixed place
    AGAIN,     // the header once more, to see that the sequence number still stands
    HELD       // a complete profile waits for canopy_profile_done()
};

// ---------------------------------------------------------------------------------------------------------------------
// Requests

static bool reserved(const struct canopy_profile_table *table, uint16_t count) {
    return count == table->header.count || count == table->description.count ||
           (table->trailer == CANOPY_SCAN_TRAILER_FIXED && count == canopy_scan_words(table->trailer_type));
}

// Length of the next block of a profile of which `remaining` registers are wanted: shorter than the one before, and
// no reserved length, neither now nor for the rest. When it has fallen to half of what the device gives it starts
// over, so that a very wide profile is not read in ever smaller pieces.
static uint16_t block_length(const struct canopy_profile_driver *driver, uint32_t remaining) {
    const uint16_t most = driver->table->read_max;
    uint16_t count = driver->previous > most / 2 + 1 ? (uint16_t)(driver->previous - 1) : most;
    if (count > remaining)
        count = (uint16_t)remaining;
    while (count > 1) {
        const uint32_t rest = remaining - count;
        const bool rest_reserved = rest > 0 && rest < count && reserved(driver->table, (uint16_t)rest);
        if (!reserved(driver->table, count) && !rest_reserved)
            break;
        count--;
    }
    return count;
}

static void ask(struct canopy_profile_driver *driver, enum phase phase, uint16_t address, uint16_t count,
                uint64_t due_us) {
    driver->phase = (uint8_t)phase;
    driver->attempts = 0;
    driver->request = (struct canopy_profile_request){.unit = driver->unit,
                                                      .function = driver->table->function,
                                                      .address = address,
                                                      .count = count,
                                                      .due_us = due_us};
}

static void ask_description(struct canopy_profile_driver *driver, uint64_t due_us) {
    const struct canopy_scan_block *block = &driver->table->description;
    ask(driver, DESCRIBE, block->address, block->count, due_us);
}

// Registers of `raw` that a profile of the known width fills.
static uint16_t payload(const struct canopy_profile_driver *driver) {
    const struct canopy_profile_table *table = driver->table;
    const unsigned trailer = table->trailer == CANOPY_SCAN_TRAILER_FOLLOWS ? canopy_scan_words(table->trailer_type) : 0;
    return (uint16_t)((unsigned)driver->profile.columns * canopy_scan_words(table->heights_type) + trailer);
}

static void ask_header(struct canopy_profile_driver *driver, uint64_t due_us) {
    const struct canopy_profile_table *table = driver->table;
    const struct canopy_scan_block *header = &table->header;
    driver->previous = 0;
    if (driver->eager && driver->profile.columns > 0 && header->address + header->count == table->heights_address) {
        const uint16_t count = block_length(driver, (uint32_t)header->count + payload(driver));
        if (count > header->count) {
            ask(driver, FIRST, header->address, count, due_us);
            driver->previous = count;
            return;
        }
    }
    ask(driver, LOOK, header->address, header->count, due_us);
}

static void ask_look(struct canopy_profile_driver *driver, uint64_t due_us) {
    driver->eager = false;
    ask_header(driver, due_us);
}

static void ask_heights(struct canopy_profile_driver *driver, uint64_t due_us) {
    const uint16_t count = block_length(driver, (uint32_t)(driver->total - driver->filled));
    ask(driver, HEIGHTS, (uint16_t)(driver->table->heights_address + driver->filled), count, due_us);
    driver->previous = count;
}

// ---------------------------------------------------------------------------------------------------------------------
// Description and header

static bool float_positive(uint32_t bits) { return bits > 0 && bits < 0x7F800000u; }  // no sign, zero, infinity, NaN

static bool scene_equal(const struct canopy_profile_scene *a, const struct canopy_profile_scene *b) {
    return memcmp(a->low, b->low, sizeof a->low) == 0 && memcmp(a->high, b->high, sizeof a->high) == 0 &&
           memcmp(&a->unit, &b->unit, sizeof a->unit) == 0 && a->profiles == b->profiles && a->columns == b->columns &&
           a->uncertainty == b->uncertainty;
}

// Loads what stands in `where` and tells how the heights lie. False if a number is unusable.
static bool load_layout(struct canopy_profile_driver *driver, uint8_t where, const uint16_t *registers) {
    const struct canopy_profile_table *table = driver->table;
    int32_t columns = driver->profile.columns, uncertainty = (int32_t)driver->uncertainty;
    const bool fits = canopy_scan_load(table, &table->columns, where, registers, &columns) &&
                      canopy_scan_load(table, &table->x_start, where, registers, &driver->x_start) &&
                      canopy_scan_load(table, &table->x_step, where, registers, &driver->x_step) &&
                      canopy_scan_load(table, &table->z_offset, where, registers, &driver->z_offset) &&
                      canopy_scan_load(table, &table->z_step, where, registers, &driver->z_step) &&
                      canopy_scan_load(table, &table->uncertainty, where, registers, &uncertainty) &&
                      canopy_scan_load(table, &table->position, where, registers, &driver->profile.y);
    if (!fits || columns < 0 || columns > driver->capacity || uncertainty < 0)
        return false;
    driver->profile.columns = (uint16_t)columns;
    driver->uncertainty = (uint32_t)uncertainty;
    return true;
}

// Once everything is loaded that a height needs.
static bool layout_complete(const struct canopy_profile_driver *driver) {
    return driver->profile.columns > 0 && driver->x_step != 0 && driver->z_step > 0 && driver->z_step <= 1 << 30;
}

// The scene from constants and, if there is one, the description.
static bool load_scene(const struct canopy_profile_driver *driver, const uint16_t *registers,
                       struct canopy_profile_scene *to) {
    const struct canopy_profile_table *table = driver->table;
    memset(to, 0, sizeof *to);
    to->columns = driver->profile.columns;
    to->uncertainty = driver->uncertainty + (table->z_divisor > 1);
    for (uint8_t where = CANOPY_SCAN_CONSTANT; where <= CANOPY_SCAN_DESCRIPTION; where++)
        for (int i = 0; i < 3; i++)
            if (!canopy_scan_load(table, &table->low[i], where, registers, &to->low[i]) ||
                !canopy_scan_load(table, &table->high[i], where, registers, &to->high[i]))
                return false;
    to->profiles = canopy_scan_bits(table, &table->profiles, registers);
    const uint32_t one = 0x3F800000u;  // 1.0f
    const uint32_t unit =
        table->unit.where == CANOPY_SCAN_ABSENT ? one : canopy_scan_bits(table, &table->unit, registers);
    memcpy(&to->unit, &unit, sizeof to->unit);
    return float_positive(unit) && to->low[0] <= to->high[0] && to->low[1] <= to->high[1] && to->low[2] <= to->high[2];
}

static enum canopy_scan_event refuse(struct canopy_profile_driver *driver, uint64_t now_us) {
    const uint64_t later = now_us + driver->table->stale_us;
    driver->counters.refused++;
    if (driver->table->description.count > 0)
        ask_description(driver, later);
    else
        ask_look(driver, later);
    return CANOPY_SCAN_REFUSED;
}

static enum canopy_scan_event take_description(struct canopy_profile_driver *driver, const uint16_t *registers,
                                               uint64_t now_us) {
    const struct canopy_profile_table *table = driver->table;
    struct canopy_profile_scene scene;
    const bool magic = table->magic.where == CANOPY_SCAN_ABSENT ||
                       canopy_scan_bits(table, &table->magic, registers) == table->magic_value;
    if (!magic || !load_layout(driver, CANOPY_SCAN_DESCRIPTION, registers) || !load_scene(driver, registers, &scene) ||
        (table->columns.where != CANOPY_SCAN_HEADER && driver->profile.columns == 0))
        return refuse(driver, now_us);
    const uint32_t id = canopy_scan_bits(table, &table->description_id, registers);
    const bool news = !driver->scene_known || id != driver->description_id || !scene_equal(&scene, &driver->scene);
    if (news)
        driver->started = false;  // another scene: its sequence numbers have nothing to do with the last ones
    driver->scene = scene;
    driver->scene_known = true;
    driver->description_id = id;
    driver->eager = true;
    ask_header(driver, now_us);
    return news ? CANOPY_SCAN_SCENE : CANOPY_SCAN_NOTHING;
}

enum sequence_kind { SAME, OLDER, NEWER };

static uint32_t sequence_mask(const struct canopy_profile_driver *driver) {
    return driver->table->sequence.type == CANOPY_SCAN_U16 ? UINT16_MAX : UINT32_MAX;
}

static enum sequence_kind compare(const struct canopy_profile_driver *driver, uint32_t sequence, uint32_t with) {
    const uint32_t mask = sequence_mask(driver), ahead = (sequence - with) & mask;
    return ahead == 0 ? SAME : ahead <= mask / 2 ? NEWER : OLDER;
}

// An older sequence number is an old frame served again, or a scanner that restarted. It counts as a restart when it
// goes on from there, or stands for the stale limit.
static bool restarted(struct canopy_profile_driver *driver, uint32_t sequence, uint64_t now_us, bool *first_seen) {
    *first_seen = !driver->have_candidate;
    if (!driver->have_candidate) {
        driver->have_candidate = true;
        driver->candidate = sequence;
        driver->standstill_us = now_us;
        driver->counters.stale++;
        return false;
    }
    return compare(driver, sequence, driver->candidate) == NEWER ||
           now_us - driver->standstill_us >= driver->table->stale_us;
}

static enum canopy_scan_event wait(struct canopy_profile_driver *driver, enum canopy_scan_event event,
                                   uint64_t now_us) {
    driver->waited = true;
    ask_look(driver, now_us + driver->table->poll_us);
    return event;
}

// After a torn profile: a scanner that brings profiles at a rate little slower than they are read is read in step with
// it, from the moment a new one appears. The one that stands already is passed over, unless it stands so long that it
// will stand while it is read, too.
static bool in_step(struct canopy_profile_driver *driver, uint32_t sequence, uint64_t now_us) {
    if (!driver->out_of_step)
        return true;
    if (!driver->passing) {
        driver->passing = true;
        driver->passed = sequence;
    }
    if (sequence == driver->passed && now_us < driver->in_step_us)
        return false;
    driver->out_of_step = false;
    return true;
}

// True if a profile is to be read; else *event says why not, and what comes next is already asked for.
static bool wanted(struct canopy_profile_driver *driver, const uint16_t *header, uint64_t now_us,
                   enum canopy_scan_event *event) {
    const struct canopy_profile_table *table = driver->table;
    const uint32_t sequence = canopy_scan_bits(table, &table->sequence, header);
    *event = CANOPY_SCAN_NOTHING;
    if (canopy_scan_bits(table, &table->header_description_id, header) != driver->description_id) {
        ask_description(driver, now_us + table->poll_us);
        return false;
    }
    const bool none = table->sequence_zero_is_none && sequence == 0;
    const enum sequence_kind kind = none              ? SAME
                                    : driver->started ? compare(driver, sequence, driver->last_sequence)
                                                      : NEWER;
    bool first_seen = false;
    if (kind == OLDER && restarted(driver, sequence, now_us, &first_seen)) {
        driver->started = false;
    } else if (kind != NEWER) {
        if (kind == SAME && !none)
            driver->have_candidate = false;
        *event = wait(driver, first_seen ? CANOPY_SCAN_STALE : CANOPY_SCAN_NOTHING, now_us);
        return false;
    }
    if (!in_step(driver, sequence, now_us)) {
        *event = wait(driver, CANOPY_SCAN_NOTHING, now_us);
        return false;
    }
    driver->begin_us = now_us;
    driver->profile.sequence = sequence;
    return true;
}

// ---------------------------------------------------------------------------------------------------------------------
// Readings

static enum canopy_reading_reason height_reason(const struct canopy_profile_table *table, int64_t height) {
    for (unsigned i = 0; i < table->invalid_count; i++)
        if (height == table->invalid[i])
            return CANOPY_READING_NONE;
    if ((table->height_low != 0 || table->height_high != 0) &&
        (height < table->height_low || height > table->height_high))
        return CANOPY_READING_LIMIT;
    return CANOPY_READING_VALID;
}

static int64_t height_at(const struct canopy_profile_driver *driver, uint16_t column) {
    const struct canopy_profile_table *table = driver->table;
    const uint32_t at = (uint32_t)column * canopy_scan_words(table->heights_type);
    return canopy_scan_raw(driver->raw + at, table->heights_type, table->order);
}

// |height| <= 2^32 and z_step <= 2^30, so nothing here leaves 64 bits.
static void place(const struct canopy_profile_driver *driver, uint16_t column, int64_t height,
                  struct canopy_reading *to) {
    const uint32_t divisor = driver->table->z_divisor > 1 ? (uint32_t)driver->table->z_divisor : 1;
    const int64_t x = driver->x_start + (int64_t)column * driver->x_step;
    int64_t z = height * driver->z_step;
    uint32_t inexact = 0;
    if (divisor > 1) {
        const uint64_t size = z < 0 ? -(uint64_t)z : (uint64_t)z, quotient = size / divisor;
        inexact = size != quotient * divisor;
        z = z < 0 ? -(int64_t)quotient - (int64_t)inexact : (int64_t)quotient;  // the floor
    }
    z += driver->z_offset;
    if (x < INT32_MIN || x > INT32_MAX || z < INT32_MIN || z > INT32_MAX - (int64_t)inexact) {
        to->reason = CANOPY_READING_OVERFLOW;
        return;
    }
    *to = (struct canopy_reading){.x = (int32_t)x,
                                  .y = driver->profile.y,
                                  .z = (int32_t)z,
                                  .uncertainty = driver->uncertainty + inexact,
                                  .valid = true,
                                  .reason = CANOPY_READING_VALID};
}

static void decode(const struct canopy_profile_driver *driver, uint16_t column, struct canopy_reading *to) {
    const int64_t height = height_at(driver, column);
    const enum canopy_reading_reason reason = height_reason(driver->table, height);
    *to = (struct canopy_reading){.reason = (uint8_t)reason};
    if (reason == CANOPY_READING_VALID)
        place(driver, column, height, to);
}

bool canopy_profile_reading(const struct canopy_profile_driver *driver, uint16_t column, struct canopy_reading *to) {
    if (driver->phase != HELD || column >= driver->profile.columns) {
        *to = (struct canopy_reading){.reason = CANOPY_READING_NONE};
        return false;
    }
    decode(driver, column, to);
    return true;
}

// ---------------------------------------------------------------------------------------------------------------------
// A profile, block by block

static void count_missed(struct canopy_profile_driver *driver) {
    const uint32_t sequence = driver->profile.sequence, last = driver->last_sequence;
    if (!driver->started)
        return;
    uint32_t passed = ((sequence - last) & sequence_mask(driver)) - 1;
    if (driver->table->sequence_zero_is_none && sequence < last)
        passed--;  // 0 was no profile
    driver->counters.missed += passed;
}

static void deliver(struct canopy_profile_driver *driver, uint16_t valid, uint64_t now_us) {
    count_missed(driver);
    driver->profile.valid = valid;
    driver->profile.time_us = driver->fresh_us = now_us;
    driver->last_sequence = driver->profile.sequence;
    driver->counters.profiles++;
    driver->counters.readings += valid;
    driver->counters.invalid += (uint32_t)(driver->profile.columns - valid);
    driver->started = true;
    driver->have_candidate = driver->stale = false;
    driver->eager = !driver->waited;
    driver->waited = false;
    driver->phase = HELD;
}

// The sequence number has stood: are there as many readings as promised?
static enum canopy_scan_event finish(struct canopy_profile_driver *driver, uint64_t now_us) {
    uint16_t seen = 0, valid = 0;
    for (uint16_t i = 0; i < driver->profile.columns; i++) {
        struct canopy_reading reading;
        decode(driver, i, &reading);
        valid = (uint16_t)(valid + reading.valid);
        seen = (uint16_t)(seen + (reading.valid || reading.reason == CANOPY_READING_OVERFLOW));
    }
    if (driver->table->valid.where != CANOPY_SCAN_ABSENT && seen != driver->promised) {
        driver->counters.short_of++;
        ask_look(driver, now_us + driver->table->poll_us);
        return CANOPY_SCAN_SHORT;
    }
    deliver(driver, valid, now_us);
    return CANOPY_SCAN_PROFILE;
}

static enum canopy_scan_event torn(struct canopy_profile_driver *driver, uint64_t now_us) {
    driver->counters.torn++;
    driver->out_of_step = true;
    driver->passing = false;
    driver->in_step_us = now_us + 2 * (now_us - driver->begin_us);
    ask_look(driver, now_us);
    return CANOPY_SCAN_TORN;
}

static enum canopy_scan_event check_trailer(struct canopy_profile_driver *driver, const uint16_t *registers,
                                            uint64_t now_us) {
    const struct canopy_profile_table *table = driver->table;
    const int64_t copy = canopy_scan_raw(registers, table->trailer_type, table->order);
    const uint32_t mask = table->trailer_type == CANOPY_SCAN_U16 ? UINT16_MAX : UINT32_MAX;
    return (uint32_t)copy == (driver->profile.sequence & mask) ? finish(driver, now_us) : torn(driver, now_us);
}

// Adds registers to the profile and asks for what comes next.
static enum canopy_scan_event take_heights(struct canopy_profile_driver *driver, const uint16_t *registers,
                                           size_t count, uint64_t now_us) {
    const struct canopy_profile_table *table = driver->table;
    const size_t room = (size_t)(driver->total - driver->filled);
    if (count > room)
        count = room;  // the profile became narrower after this block was asked for
    if (count > 0)
        memcpy(driver->raw + driver->filled, registers, count * sizeof *registers);
    driver->filled = (uint16_t)(driver->filled + count);
    if (driver->filled < driver->total) {
        ask_heights(driver, now_us);
        return CANOPY_SCAN_NOTHING;
    }
    switch (table->trailer) {
    case CANOPY_SCAN_TRAILER_FOLLOWS:
        return check_trailer(driver, driver->raw + driver->total - canopy_scan_words(table->trailer_type), now_us);
    case CANOPY_SCAN_TRAILER_FIXED:
        ask(driver, TRAILER, table->trailer_address, canopy_scan_words(table->trailer_type), now_us);
        break;
    default: ask(driver, AGAIN, table->header.address, table->header.count, now_us); break;
    }
    return CANOPY_SCAN_NOTHING;
}

static enum canopy_scan_event take_header(struct canopy_profile_driver *driver, const uint16_t *registers, size_t count,
                                          uint64_t now_us) {
    const struct canopy_profile_table *table = driver->table;
    enum canopy_scan_event event;
    if (!wanted(driver, registers, now_us, &event))
        return event;
    if (!load_layout(driver, CANOPY_SCAN_HEADER, registers) || !layout_complete(driver))
        return refuse(driver, now_us);
    driver->promised = (uint16_t)canopy_scan_bits(table, &table->valid, registers);
    driver->scene.columns = driver->profile.columns;
    driver->filled = 0;
    driver->total = payload(driver);
    return take_heights(driver, registers + table->header.count, count - table->header.count, now_us);
}

static enum canopy_scan_event take_again(struct canopy_profile_driver *driver, const uint16_t *registers,
                                         uint64_t now_us) {
    const struct canopy_profile_table *table = driver->table;
    const bool stood = canopy_scan_bits(table, &table->sequence, registers) == driver->profile.sequence &&
                       canopy_scan_bits(table, &table->header_description_id, registers) == driver->description_id;
    return stood ? finish(driver, now_us) : torn(driver, now_us);
}

// A stale limit without a new profile counts once each time it passes, whatever else happened.
static enum canopy_scan_event watch(struct canopy_profile_driver *driver, enum canopy_scan_event event,
                                    uint64_t now_us) {
    if (driver->phase == HELD || now_us - driver->fresh_us < driver->table->stale_us)
        return event;
    driver->fresh_us = now_us;
    driver->stale = true;
    driver->counters.stale++;
    return event == CANOPY_SCAN_NOTHING ? CANOPY_SCAN_STALE : event;
}

static enum canopy_scan_event take(struct canopy_profile_driver *driver, const uint16_t *registers, size_t count,
                                   uint64_t now_us) {
    switch ((enum phase)driver->phase) {
    case DESCRIBE: return take_description(driver, registers, now_us);
    case LOOK:
    case FIRST: return take_header(driver, registers, count, now_us);
    case HEIGHTS: return take_heights(driver, registers, count, now_us);
    case TRAILER: return check_trailer(driver, registers, now_us);
    case AGAIN: return take_again(driver, registers, now_us);
    case HELD: break;
    }
    return CANOPY_SCAN_NOTHING;
}

// ---------------------------------------------------------------------------------------------------------------------
// The driver as its user sees it

// Whether profiles of up to `columns` fit the device's registers and the driver's numbers.
static bool columns_ok(const struct canopy_profile_table *table, uint16_t columns) {
    const uint32_t length = (uint32_t)columns * canopy_scan_words(table->heights_type) + 2;
    return columns > 0 && length <= UINT16_MAX && (uint32_t)table->heights_address + length <= 0x10000u;
}

enum canopy_status canopy_profile_init(struct canopy_profile_driver *driver, const struct canopy_profile_config *config,
                                       void *arena, size_t bytes, uint64_t now_us) {
    return canopy_scan_table_ok(config->table) ? canopy_profile_init_known(driver, config, arena, bytes, now_us)
                                               : CANOPY_ARGUMENT;
}

enum canopy_status canopy_profile_init_known(struct canopy_profile_driver *driver,
                                             const struct canopy_profile_config *config, void *arena, size_t bytes,
                                             uint64_t now_us) {
    const struct canopy_profile_table *table = config->table;
    if (!columns_ok(table, config->columns))
        return CANOPY_ARGUMENT;
    if (((uintptr_t)arena & 7u) != 0)
        return CANOPY_ARENA_ALIGN;
    if (arena == NULL || bytes < CANOPY_PROFILE_ARENA(config->columns, canopy_scan_words(table->heights_type)))
        return CANOPY_ARENA_SHORT;
    memset(driver, 0, sizeof *driver);
    driver->table = table;
    driver->raw = arena;
    driver->unit = config->unit;
    driver->capacity = config->columns;
    driver->fresh_us = now_us;
    driver->z_step = 1;
    if (!load_layout(driver, CANOPY_SCAN_CONSTANT, NULL))
        return CANOPY_ARGUMENT;
    if (table->description.count > 0) {
        ask_description(driver, now_us);
        return CANOPY_OK;
    }
    if (!load_scene(driver, NULL, &driver->scene))
        return CANOPY_ARGUMENT;
    driver->scene_known = true;
    ask_look(driver, now_us);
    return CANOPY_OK;
}

bool canopy_profile_next(struct canopy_profile_driver *driver, uint64_t now_us,
                         struct canopy_profile_request *request) {
    *request = driver->request;
    if (driver->phase == HELD) {
        request->due_us = CANOPY_PROFILE_NEVER;
        return false;
    }
    if (now_us < request->due_us)
        return false;
    driver->asked = true;
    return true;
}

enum canopy_scan_event canopy_profile_answer(struct canopy_profile_driver *driver, const uint16_t *registers,
                                             size_t count, uint64_t now_us) {
    if (!driver->asked) {
        driver->counters.unexpected++;
        return CANOPY_SCAN_NOTHING;
    }
    if (count != driver->request.count)
        return canopy_profile_failed(driver, CANOPY_SCAN_LENGTH, now_us);
    driver->asked = false;
    return watch(driver, take(driver, registers, count, now_us), now_us);
}

enum canopy_scan_event canopy_profile_failed(struct canopy_profile_driver *driver, enum canopy_scan_failure failure,
                                             uint64_t now_us) {
    if (!driver->asked) {
        driver->counters.unexpected++;
        return CANOPY_SCAN_NOTHING;
    }
    const uint64_t later = now_us + driver->table->retry_us;
    driver->asked = false;
    const enum canopy_scan_failure reason = failure < CANOPY_SCAN_FAILURES ? failure : CANOPY_SCAN_LINK;
    driver->counters.failures[reason]++;
    driver->counters.last_failure = reason + 1U;
    if (driver->attempts < driver->table->retries) {
        driver->attempts++;
        driver->request.due_us = later;
        return watch(driver, CANOPY_SCAN_RETRY, now_us);
    }
    driver->counters.dropped++;
    driver->waited = true;
    if (driver->table->description.count > 0)
        ask_description(driver, later);
    else
        ask_look(driver, later);
    return watch(driver, CANOPY_SCAN_DROPPED, now_us);
}

const struct canopy_profile *canopy_profile_get(const struct canopy_profile_driver *driver) {
    return driver->phase == HELD ? &driver->profile : NULL;
}

void canopy_profile_done(struct canopy_profile_driver *driver) {
    if (driver->phase == HELD)
        ask_header(driver, 0);
}

const struct canopy_profile_scene *canopy_profile_scene(const struct canopy_profile_driver *driver) {
    return driver->scene_known && driver->table->low[0].where != CANOPY_SCAN_ABSENT ? &driver->scene : NULL;
}

bool canopy_profile_stale(const struct canopy_profile_driver *driver, uint64_t now_us) {
    return driver->stale || now_us - driver->fresh_us > driver->table->stale_us;
}

const struct canopy_profile_counters *canopy_profile_counters(const struct canopy_profile_driver *driver) {
    return &driver->counters;
}

uint32_t canopy_profile_errors(const struct canopy_profile_driver *driver) {
    const struct canopy_profile_counters *c = &driver->counters;
    uint32_t sum = c->torn + c->short_of + c->stale + c->refused;
    for (int i = 0; i < CANOPY_SCAN_FAILURES; i++)
        sum += c->failures[i];
    return sum;
}
