#include "tools/common/output.h"

#include <errno.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/// What a signal has to remove.
static char *volatile pending;

static void remove_and_die(int number) {
    if (pending) {
        unlink(pending);
    }
    signal(number, SIG_DFL);
    raise(number);
}

static void guard(bool on) {
    static const int NUMBERS[] = {SIGINT, SIGTERM, SIGHUP};
    for (size_t i = 0; i < sizeof NUMBERS / sizeof NUMBERS[0]; i++) {
        struct sigaction now;
        if (sigaction(NUMBERS[i], NULL, &now) == 0 && now.sa_handler != SIG_IGN) {
            signal(NUMBERS[i], on ? remove_and_die : SIG_DFL);
        }
    }
}

static bool failed(struct canopy_output *output, struct canopy_fault *fault) {
    const int why = errno;
    canopy_fault_set(fault, "%s: cannot write: %s: give -o a file in a directory that exists and has room",
                     output->path, strerror(why));
    canopy_output_abandon(output);
    return false;
}

bool canopy_output_open(struct canopy_output *output, const char *path, struct canopy_fault *fault) {
    *output = (struct canopy_output){.path = path};
    struct stat status;
    if (strcmp(path, "-") == 0) {
        return canopy_fault_set(fault, "-: cannot write: give -o the name of a file, standard output has the report");
    }
    if (lstat(path, &status) == 0 && !S_ISREG(status.st_mode)) {
        output->file = fopen(path, "wb");  // /dev/stdout, /dev/null, a pipe, a link: nothing that may be replaced
        return output->file || failed(output, fault);
    }
    const size_t length = strlen(path);
    output->temporary = malloc(length + 8);
    if (!output->temporary) {
        return failed(output, fault);
    }
    memcpy(output->temporary, path, length);
    memcpy(output->temporary + length, ".XXXXXX", 8);
    const int descriptor = mkstemp(output->temporary);
    if (descriptor < 0) {
        const int why = errno;
        free(output->temporary);
        output->temporary = NULL;
        errno = why;
        return failed(output, fault);
    }
    pending = output->temporary;
    guard(true);
    const mode_t mask = umask(0);  // mkstemp makes it private; give it what an ordinary file would have
    umask(mask);
    if (fchmod(descriptor, 0666 & ~mask) == 0) {
        output->file = fdopen(descriptor, "wb");
    }
    if (!output->file) {
        const int why = errno;
        close(descriptor);
        errno = why;
        return failed(output, fault);
    }
    return true;
}

bool canopy_output_commit(struct canopy_output *output, struct canopy_fault *fault) {
    const bool written = fflush(output->file) == 0 && !ferror(output->file);
    const bool closed = fclose(output->file) == 0;
    output->file = NULL;
    if (!written || !closed || (output->temporary && rename(output->temporary, output->path) != 0)) {
        return failed(output, fault);
    }
    guard(false);
    pending = NULL;
    free(output->temporary);
    output->temporary = NULL;
    return true;
}

void canopy_output_abandon(struct canopy_output *output) {
    if (output->file) {
        fclose(output->file);
        output->file = NULL;
    }
    if (output->temporary) {
        unlink(output->temporary);
        guard(false);
        pending = NULL;
        free(output->temporary);
        output->temporary = NULL;
    }
}
