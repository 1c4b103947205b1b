#include "port/linux/log.h"

#include <poll.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

enum { LINE_MAX_BYTES = 400 };

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static const char *log_name = "canopy";
static unsigned long dropped;

void canopy_linux_log_name(const char *name) { log_name = name; }

// A pipe that is writable takes at least PIPE_BUF bytes, which is more than a line.
static bool put(const char *line, size_t length) {
    struct pollfd fd = {.fd = STDERR_FILENO, .events = POLLOUT};
    return poll(&fd, 1, 0) == 1 && (fd.revents & POLLOUT) != 0 && write(STDERR_FILENO, line, length) == (ssize_t)length;
}

static size_t finish(char *line, int length, size_t room) {
    size_t end = length < 0 ? 0 : (size_t)length < room - 1 ? (size_t)length : room - 2;
    for (size_t i = 0; i < end; i++) {
        line[i] = (unsigned char)line[i] < ' ' || line[i] == 0x7F ? '?' : line[i];
    }
    line[end] = '\n';
    return end + 1;
}

// In one piece with what has to be said of earlier lines.
static bool put_with_note(const char *line, size_t length) {
    char both[2 * LINE_MAX_BYTES];
    size_t noted = 0;
    if (dropped > 0) {
        const int text =
            snprintf(both, LINE_MAX_BYTES, "%s: %lu lines dropped: standard error was full", log_name, dropped);
        noted = finish(both, text, LINE_MAX_BYTES);
    }
    memcpy(both + noted, line, length);
    return put(both, noted + length);
}

void canopy_linux_log(const char *format, ...) {
    char line[LINE_MAX_BYTES];
    const int prefix = snprintf(line, sizeof line, "%s: ", log_name);
    if (prefix < 0 || (size_t)prefix >= sizeof line / 2) {
        return;
    }
    va_list arguments;
    va_start(arguments, format);
    const int text = vsnprintf(line + prefix, sizeof line - (size_t)prefix, format, arguments);
    va_end(arguments);
    const size_t length = finish(line, text < 0 ? text : prefix + text, sizeof line);
    pthread_mutex_lock(&lock);
    dropped = put_with_note(line, length) ? 0 : dropped + 1;
    pthread_mutex_unlock(&lock);
}
