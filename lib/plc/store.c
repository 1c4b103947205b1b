#include "lib/plc/store.h"

#include <string.h>

#include "lib/num/crc32.h"

#define MAGIC 0x43535231U
#define HEADER 16U
#define BLANK 0xFFU

enum stage { IDLE, ASSURE, ERASE_FIRST, WRITE_FIRST, SEAL_FIRST, ERASE_SECOND, WRITE_SECOND, SEAL_SECOND };

// What a page was read as, once.
struct copy {
    uint32_t generation;
    bool intact;  // the CRC is right
    bool sealed;
    bool blank;
};

static void put(uint8_t *to, uint32_t value) {
    for (unsigned i = 0; i < 4; i++) {
        to[i] = (uint8_t)(value >> (24U - 8U * i));
    }
}

static uint32_t get(const uint8_t *from) {
    return (uint32_t)from[0] << 24 | (uint32_t)from[1] << 16 | (uint32_t)from[2] << 8 | from[3];
}

static uint32_t whole_units(const struct canopy_flash *flash, uint32_t bytes) {
    const uint32_t unit = flash->program_bytes;
    return (bytes + unit - 1) / unit * unit;
}

static bool is_usable(const struct canopy_flash *flash) {
    return flash->page_count >= 2 && flash->program_bytes >= 1 && flash->program_bytes <= CANOPY_STORE_UNIT &&
           flash->page_bytes >= whole_units(flash, CANOPY_STORE_RECORD) + whole_units(flash, 4);
}

static uint16_t length_of(const uint8_t *record) { return (uint16_t)get(record + 4); }

static bool is_intact(const uint8_t *record) {
    const uint32_t length = length_of(record);
    return get(record) == MAGIC && length <= CANOPY_STORE_PAYLOAD && get(record + 8) != 0 &&
           canopy_crc32(canopy_crc32(0, record, HEADER - 4), record + HEADER, length) == get(record + HEADER - 4);
}

static bool is_blank(const uint8_t *bytes, size_t count) {
    while (count > 0 && bytes[count - 1] == BLANK) {
        count--;
    }
    return count == 0;
}

// Reads the record of a page, and what it is worth. False: the memory failed.
static bool look(const struct canopy_flash *flash, uint32_t page, uint8_t *record, struct copy *copy) {
    uint8_t seal[4];
    if (flash->read(flash->context, page, 0, record, CANOPY_STORE_RECORD) != CANOPY_OK ||
        flash->read(flash->context, page, whole_units(flash, CANOPY_STORE_RECORD), seal, sizeof seal) != CANOPY_OK) {
        return false;
    }
    copy->intact = is_intact(record);
    copy->sealed = !is_blank(seal, sizeof seal);
    copy->blank = !copy->sealed && is_blank(record, CANOPY_STORE_RECORD);
    copy->generation = copy->intact && copy->sealed ? get(record + 8) : 0;
    return true;
}

// Zeros at the beginning of the seal, or of the record.
static bool clear(const struct canopy_flash *flash, uint32_t page, uint32_t offset, uint8_t *unit) {
    const uint32_t length = whole_units(flash, 4);
    memset(unit, BLANK, length);
    memset(unit, 0, 4);
    return flash->program(flash->context, page, offset, unit, length) == CANOPY_OK;
}

static bool seal(const struct canopy_flash *flash, uint32_t page, uint8_t *unit) {
    return clear(flash, page, whole_units(flash, CANOPY_STORE_RECORD), unit);
}

// ---- Reading

// The copy with the newest record, or 2.
static unsigned newest(const struct copy copies[2]) {
    if (copies[0].generation == 0 && copies[1].generation == 0) {
        return 2;
    }
    // generations go round
    const bool second = copies[0].generation == 0 ||
                        (copies[1].generation != 0 && (int32_t)(copies[1].generation - copies[0].generation) > 0);
    return second ? 1 : 0;
}

// Makes last what has been decided about copies that do not agree.
static bool settle(const struct canopy_flash *flash, const struct copy copies[2], unsigned chosen, uint8_t *unit) {
    for (unsigned page = 0; page < 2; page++) {
        if (copies[page].intact && !copies[page].sealed && !clear(flash, page, 0, unit)) {
            return false;
        }
    }
    return chosen == 2 || seal(flash, chosen, unit);
}

struct canopy_store_record canopy_store_open(struct canopy_store *store, const struct canopy_flash *flash,
                                             uint8_t *scratch) {
    struct canopy_store_record found = {.state = CANOPY_STORE_NOWHERE};
    struct copy copies[2];
    *store = (struct canopy_store){.flash = flash};
    if (!is_usable(flash) || !look(flash, 0, scratch, &copies[0]) ||
        !look(flash, 1, scratch + CANOPY_STORE_RECORD, &copies[1])) {
        return found;
    }
    const unsigned chosen = newest(copies);
    const bool agree = copies[0].generation == copies[1].generation;
    if ((!agree || chosen == 2) && !settle(flash, copies, chosen, scratch + 2U * CANOPY_STORE_RECORD)) {
        return found;
    }
    if (chosen == 2) {
        found.state = copies[0].blank && copies[1].blank ? CANOPY_STORE_EMPTY : CANOPY_STORE_CORRUPT;
        return found;
    }
    const uint8_t *record = scratch + (size_t)chosen * CANOPY_STORE_RECORD;
    store->generation = copies[chosen].generation;
    found.state = agree ? CANOPY_STORE_GOOD : CANOPY_STORE_ONE;
    found.version = (uint16_t)(get(record + 4) >> 16);
    found.length = length_of(record);
    found.payload = record + HEADER;
    return found;
}

// ---- Writing

bool canopy_store_begin(struct canopy_store *store) {
    if (store->flash == NULL || !is_usable(store->flash)) {
        return false;
    }
    store->stage = ASSURE;
    return true;
}

bool canopy_store_is_writing(const struct canopy_store *store) { return store->stage != IDLE; }

static bool erase(const struct canopy_store *store, uint32_t page) {
    return store->flash->erase(store->flash->context, page) == CANOPY_OK;
}

// Chooses the copy to give up first, not the only one that is in force, and makes the other one's seal last.
static bool assure(struct canopy_store *store, uint8_t *scratch) {
    struct copy copy;
    if (!look(store->flash, 1, scratch, &copy)) {
        return false;
    }
    store->first = copy.generation == store->generation ? 0 : 1;
    return store->generation == 0 || seal(store->flash, 1U - store->first, scratch);
}

// The record in the scratch, padded, is programmed and read back.
static bool program(const struct canopy_store *store, uint32_t page, uint8_t *record) {
    const struct canopy_flash *flash = store->flash;
    const uint32_t length = whole_units(flash, CANOPY_STORE_RECORD);
    uint8_t back[16];
    memset(record + CANOPY_STORE_RECORD, BLANK, length - CANOPY_STORE_RECORD);
    if (flash->program(flash->context, page, 0, record, length) != CANOPY_OK) {
        return false;
    }
    for (uint32_t at = 0; at < CANOPY_STORE_RECORD; at += sizeof back) {
        if (flash->read(flash->context, page, at, back, sizeof back) != CANOPY_OK ||
            memcmp(back, record + at, sizeof back) != 0) {
            return false;
        }
    }
    return true;
}

static uint32_t next_generation(const struct canopy_store *store) {
    return store->generation == UINT32_MAX ? 1 : store->generation + 1;
}

static bool write_first(const struct canopy_store *store, uint16_t version, const uint8_t *payload, uint16_t length,
                        uint8_t *record) {
    memset(record, BLANK, CANOPY_STORE_RECORD);
    put(record, MAGIC);
    put(record + 4, (uint32_t)version << 16 | length);
    put(record + 8, next_generation(store));
    memcpy(record + HEADER, payload, length);
    put(record + HEADER - 4, canopy_crc32(canopy_crc32(0, record, HEADER - 4), record + HEADER, length));
    return program(store, store->first, record);
}

static bool seal_first(struct canopy_store *store, uint8_t *unit) {
    if (!seal(store->flash, store->first, unit)) {
        return false;
    }
    store->generation = next_generation(store);
    return true;
}

static bool write_second(const struct canopy_store *store, uint8_t *record) {
    struct copy copy;
    return look(store->flash, store->first, record, &copy) && copy.generation == store->generation &&
           program(store, 1U - store->first, record);
}

enum canopy_status canopy_store_step(struct canopy_store *store, uint16_t version, const uint8_t *payload,
                                     uint16_t length, uint8_t *scratch) {
    bool good = false;
    if (length > CANOPY_STORE_PAYLOAD) {
        return CANOPY_ARGUMENT;
    }
    switch ((enum stage)store->stage) {
    case ASSURE: good = assure(store, scratch); break;
    case ERASE_FIRST: good = erase(store, store->first); break;
    case WRITE_FIRST: good = write_first(store, version, payload, length, scratch); break;
    case SEAL_FIRST: good = seal_first(store, scratch); break;
    case ERASE_SECOND: good = erase(store, 1U - store->first); break;
    case WRITE_SECOND: good = write_second(store, scratch); break;
    case SEAL_SECOND: good = seal(store->flash, 1U - store->first, scratch); break;
    default: return CANOPY_ARGUMENT;
    }
    const bool last = store->stage == SEAL_SECOND;
    store->stage = (uint8_t)(good && !last ? store->stage + 1U : IDLE);
    return !good ? CANOPY_RANGE : last ? CANOPY_OK : CANOPY_MORE;
}
