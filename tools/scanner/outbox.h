/// Replies on their way to the wire, each with its time, and perhaps at the speed of a real wire.
#ifndef CANOPY_TOOLS_SCANNER_OUTBOX_H
#define CANOPY_TOOLS_SCANNER_OUTBOX_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define OUTBOX_MESSAGES 8
#define OUTBOX_BYTES 320  ///< the longest message: garbage and a TCP frame
#define OUTBOX_NEVER UINT64_MAX

struct outbox_message {
    uint64_t start_us;  ///< not before
    size_t length, sent;
    bool hang_up;  ///< the connection ends behind it
    uint8_t bytes[OUTBOX_BYTES];
};

struct outbox {
    double byte_us;  ///< what a byte takes on the wire; 0: nothing
    unsigned first, count;
    struct outbox_message messages[OUTBOX_MESSAGES];
};

/// A place for the next message, behind all others, or NULL when the box is full. Fill it in; outbox_post() sends it.
struct outbox_message *outbox_next(struct outbox *box);
void outbox_post(struct outbox *box);

/// Writes to `file` what is due. False when the connection has ended: by an error, or because a message said so.
bool outbox_pump(struct outbox *box, int file, uint64_t now_us);

/// When there is something to write; OUTBOX_NEVER if the box is empty.
uint64_t outbox_due(const struct outbox *box, uint64_t now_us);

#endif
