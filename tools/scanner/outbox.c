#include "tools/scanner/outbox.h"

#include <errno.h>
#include <unistd.h>

struct outbox_message *outbox_next(struct outbox *box) {
    if (box->count == OUTBOX_MESSAGES)
        return NULL;
    struct outbox_message *message = &box->messages[(box->first + box->count) % OUTBOX_MESSAGES];
    *message = (struct outbox_message){0};
    return message;
}

void outbox_post(struct outbox *box) { box->count++; }

// How many bytes of the message may have left by now.
static size_t allowed(const struct outbox *box, const struct outbox_message *message, uint64_t now_us) {
    if (now_us < message->start_us)
        return 0;
    if (box->byte_us <= 0)
        return message->length;
    // A byte is there when its stop bit is.
    const double bytes = (double)(now_us - message->start_us) / box->byte_us;
    return bytes >= (double)message->length ? message->length : (size_t)bytes;
}

bool outbox_pump(struct outbox *box, int file, uint64_t now_us) {
    while (box->count > 0) {
        struct outbox_message *message = &box->messages[box->first];
        const size_t until = allowed(box, message, now_us);
        if (message->sent < until) {
            const ssize_t done = write(file, message->bytes + message->sent, until - message->sent);
            if (done < 0 && (errno == EAGAIN || errno == EINTR))
                return true;
            if (done < 0)
                return false;
            message->sent += (size_t)done;
        }
        if (message->sent < message->length || now_us < message->start_us)
            return true;
        box->first = (box->first + 1) % OUTBOX_MESSAGES;
        box->count--;
        if (message->hang_up)
            return false;
        // What follows has waited for this one.
        struct outbox_message *follower = &box->messages[box->first];
        if (box->count > 0 && follower->start_us < now_us)
            follower->start_us = now_us;
    }
    return true;
}

uint64_t outbox_due(const struct outbox *box, uint64_t now_us) {
    if (box->count == 0)
        return OUTBOX_NEVER;
    const struct outbox_message *message = &box->messages[box->first];
    if (now_us < message->start_us)
        return message->start_us;
    if (box->byte_us <= 0)
        return now_us + 1000;  // the other side does not take it: look again soon
    return message->start_us + (uint64_t)((double)(message->sent + 1) * box->byte_us) + 1;
}
