/// One record kept without power in two copies: whenever the power goes, the next start finds the old record or the
/// new.
///
/// A copy is a page of the flash (struct canopy_flash, lib/port.h), the first or the second. It holds, high byte first,
///
///     0   magic 0x43535231
///     4   version, then length of the payload, 16 bits each
///     8   generation, never 0
///     12  CRC-32 of bytes 0 to 11 and the payload
///     16  payload, at most CANOPY_STORE_PAYLOAD bytes, then 0xFF
///     S   the seal: 4 bytes of 0; S is 128, rounded up to the unit of programming
///
/// A copy counts if its CRC is right and it is sealed: one bit of the seal that is not 1 is enough. Writing goes in
/// this order, at most one erasure or one programming a step:
///
///   1. program the seal of a copy that is in force once more
///   2. erase the other copy
///   3. program its record, and read it back
///   4. program its seal: from here on the new record is in force
///   5. to 7. the same with the copy of 1, its record read from the other
///
/// Why that is enough, for memory in which whatever was interrupted may read as anything, and as something else each
/// time: in 1 to 3 the copy in force is whole, and once 3 has begun the other one's seal is surely blank. In 4 the
/// record is whole, so it does not matter what the seal reads as; but what a start has decided must stay, so the start
/// makes it last: it programs the seal of the copy it takes, and wipes a record without one. From 5 on the first copy
/// is whole and sealed, and of the second one an older record or the same is all that may be read; its seal, the last
/// to be programmed, is what 1 is for. Programming may clear bits again that are clear. That a torn page has the CRC of
/// a record that never was is left to chance, 2^-32.
///
/// Nothing is kept in RAM but the generation in force and how far writing is.
#ifndef CANOPY_STORE_H
#define CANOPY_STORE_H

#include <stdbool.h>
#include <stdint.h>

#include "lib/port.h"
#include "lib/status.h"

#define CANOPY_STORE_RECORD 128U
#define CANOPY_STORE_PAYLOAD (CANOPY_STORE_RECORD - 16U)
#define CANOPY_STORE_UNIT 256U  ///< the largest unit of programming

enum canopy_store_state {
    CANOPY_STORE_EMPTY,    ///< both copies are blank: nothing was ever stored
    CANOPY_STORE_GOOD,     ///< both copies hold the record
    CANOPY_STORE_ONE,      ///< one copy holds it; the other one is damaged, unfinished or older
    CANOPY_STORE_CORRUPT,  ///< neither copy holds a record, and one at least is not blank
    CANOPY_STORE_NOWHERE   ///< no memory, one that cannot be used for this (below), or it failed
};

/// What was found.
struct canopy_store_record {
    enum canopy_store_state state;
    uint16_t version, length;
    const uint8_t *payload;  ///< in the buffer; `length` bytes, with GOOD and ONE only
};

struct canopy_store {
    const struct canopy_flash *flash;
    uint32_t generation;  ///< of the record in force; 0: none
    uint8_t stage;        // of writing
    uint8_t first;        // the copy that is written first
};

/// Bytes of scratch for opening and for a step. They need no alignment.
#define CANOPY_STORE_OPEN_SCRATCH (2U * CANOPY_STORE_RECORD + CANOPY_STORE_UNIT)
#define CANOPY_STORE_STEP_SCRATCH CANOPY_STORE_UNIT

/// Opens the store and finds its record. The flash must outlive the store and needs two pages, a unit of programming of
/// at most CANOPY_STORE_UNIT bytes, and room for S and a unit in a page; else the state is NOWHERE and nothing can be
/// stored. Programs at most three units, and only where the power was cut while storing.
struct canopy_store_record canopy_store_open(struct canopy_store *store, const struct canopy_flash *flash,
                                             uint8_t *scratch);

/// Begins to store; what was begun before is begun anew. False: there is nowhere to.
bool canopy_store_begin(struct canopy_store *store);

/// Whether canopy_store_step has something to do.
bool canopy_store_is_writing(const struct canopy_store *store);

/// One step of storing `length` bytes, at most CANOPY_STORE_PAYLOAD, as `version`: it erases or programs once and takes
/// as long as the memory does. The same payload belongs to all steps; it is looked at in one of them only. CANOPY_MORE;
/// CANOPY_OK: stored in both copies. CANOPY_RANGE: the memory failed, or what was read back was not what was written:
/// the record in force is the old one or the new, as `generation` says. CANOPY_ARGUMENT: too long, or not begun.
enum canopy_status canopy_store_step(struct canopy_store *store, uint16_t version, const uint8_t *payload,
                                     uint16_t length, uint8_t *scratch);

#endif
