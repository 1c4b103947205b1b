/// What can go wrong between a scanner and its master, done on purpose to the bytes of a reply.
#ifndef CANOPY_TOOLS_SCANNER_MISCHIEF_H
#define CANOPY_TOOLS_SCANNER_MISCHIEF_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "tools/scanner/outbox.h"

#define MISCHIEF_PERIODS 16

/// Each probability is for one reply; at most one of them strikes.
struct mischief_options {
    double silence;     ///< no reply
    double truncate;    ///< the reply stops somewhere (on TCP the connection then ends)
    double bad_crc;     ///< one to three bits of it are flipped (on TCP: of the header, its only check)
    double exception;   ///< "busy" instead of the reply
    double garbage;     ///< up to 20 random bytes before the reply (on TCP: nothing, the stream would be lost)
    double delay;       ///< the reply comes late
    uint32_t delay_us;  ///< by so much
    unsigned period_count;
    struct {
        double start_s, length_s;
    } periods[MISCHIEF_PERIODS];  ///< of silence, in seconds from the first request
};

/// What became of a reply.
enum mischief_fate {
    MISCHIEF_SENT,      ///< it goes out as it is
    MISCHIEF_DOUBTFUL,  ///< it goes out as it is, but so that the master may not take it
    MISCHIEF_SPOILT     ///< it does not go out, or not as a valid reply
};

struct mischief {
    struct mischief_options options;
    uint64_t random;
    uint64_t first_us;                                                  ///< of the first request; 0: none yet
    uint64_t silenced, truncated, flipped, excepted, garbled, delayed;  ///< what was done
};

/// Puts the reply, treated, into `message`; a length of 0 there means silence. `rtu`: the frame has unit, PDU and CRC,
/// else it is Modbus TCP. `length` is at most 260.
enum mischief_fate mischief_do(struct mischief *mischief, bool rtu, const uint8_t *reply, size_t length,
                               uint64_t now_us, struct outbox_message *message);

#endif
