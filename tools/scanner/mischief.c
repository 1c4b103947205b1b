#include "tools/scanner/mischief.h"

#include <string.h>

#include "lib/modbus/crc.h"
#include "tools/common/random.h"

#define BUSY 6

static bool in_silent_period(const struct mischief *mischief, uint64_t now_us) {
    const double at_s = (double)(now_us - mischief->first_us) * 1e-6;
    for (unsigned i = 0; i < mischief->options.period_count; i++) {
        const double start_s = mischief->options.periods[i].start_s;
        if (at_s >= start_s && at_s < start_s + mischief->options.periods[i].length_s)
            return true;
    }
    return false;
}

static void flip_bits(struct mischief *mischief, uint8_t *bytes, size_t length) {
    // Distinct bits of the first `length` bytes; one to three of them are always seen by CRC-16.
    const uint32_t count = 1 + canopy_random_below(&mischief->random, 3), bits = (uint32_t)length * 8;
    uint32_t bit = canopy_random_below(&mischief->random, bits);
    for (uint32_t i = 0; i < count; i++) {
        bytes[bit / 8] = (uint8_t)(bytes[bit / 8] ^ (1u << bit % 8));
        bit = (bit + 1 + canopy_random_below(&mischief->random, bits / 3)) % bits;
    }
}

static void make_busy(bool rtu, struct outbox_message *message) {
    uint8_t *frame = message->bytes;
    uint8_t *pdu = rtu ? frame + 1 : frame + 7;
    pdu[0] = (uint8_t)(pdu[0] | 0x80u);
    pdu[1] = BUSY;
    message->length = (size_t)(pdu - frame) + 2;
    if (rtu) {
        message->length = canopy_modbus_crc_append(frame, message->length);
    } else {  // unit, function, code
        frame[4] = 0;
        frame[5] = 3;
    }
}

static void put_garbage(struct mischief *mischief, struct outbox_message *message) {
    const size_t count = 1 + canopy_random_below(&mischief->random, 20);
    memmove(message->bytes + count, message->bytes, message->length);
    for (size_t i = 0; i < count; i++)
        message->bytes[i] = (uint8_t)(canopy_random_next(&mischief->random) & 0xFFu);
    message->length += count;
}

static enum mischief_fate spoil(struct mischief *mischief, bool rtu, struct outbox_message *message) {
    const struct mischief_options *o = &mischief->options;
    uint64_t *random = &mischief->random;
    if (canopy_random_chance(random, o->silence)) {
        mischief->silenced++;
        message->length = 0;
    } else if (canopy_random_chance(random, o->truncate)) {
        mischief->truncated++;
        message->length = 1 + canopy_random_below(random, (uint32_t)message->length - 1);
        message->hang_up = !rtu;
    } else if (canopy_random_chance(random, o->bad_crc)) {
        mischief->flipped++;
        flip_bits(mischief, message->bytes, rtu ? message->length : 4);  // transaction and protocol
    } else if (canopy_random_chance(random, o->exception)) {
        mischief->excepted++;
        make_busy(rtu, message);
    } else if (rtu && canopy_random_chance(random, o->garbage)) {
        mischief->garbled++;
        put_garbage(mischief, message);
        return MISCHIEF_DOUBTFUL;
    } else if (canopy_random_chance(random, o->delay)) {
        mischief->delayed++;
        message->start_us += o->delay_us;
        return MISCHIEF_DOUBTFUL;
    } else {
        return MISCHIEF_SENT;
    }
    return MISCHIEF_SPOILT;
}

enum mischief_fate mischief_do(struct mischief *mischief, bool rtu, const uint8_t *reply, size_t length,
                               uint64_t now_us, struct outbox_message *message) {
    if (mischief->first_us == 0)
        mischief->first_us = now_us;
    memcpy(message->bytes, reply, length);
    message->length = length;
    if (in_silent_period(mischief, now_us)) {
        mischief->silenced++;
        message->length = 0;
        return MISCHIEF_SPOILT;
    }
    return spoil(mischief, rtu, message);
}
